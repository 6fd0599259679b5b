"""What a real-time thread is given, as the kernel itself tells it, and that all of it is given back."""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import resource
import sys
import time
from pathlib import Path

import pytest

from rths_cli.errors import InputError
from rths_cli.loop import scheduling
from rths_cli.loop.scheduling import parse_cpu_list, real_time

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only")


def locked_kb() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))


def slack_ns() -> int:
    return ctypes.CDLL(None).prctl(scheduling.GET_TIMER_SLACK, 0, 0, 0, 0)


def seen() -> tuple[object, ...]:
    """Return all that real_time may change, as the system tells it."""
    files = sum(
        os.readlink(link) == "/dev/cpu_dma_latency" for link in Path("/proc/self/fd").iterdir() if link.exists()
    )
    priority = os.sched_getparam(0).sched_priority
    return os.sched_getscheduler(0), priority, os.sched_getaffinity(0), locked_kb(), gc.isenabled(), slack_ns(), files


def test_what_is_granted_is_what_the_kernel_says_and_all_is_given_back() -> None:
    end = time.monotonic() + 20.0
    while locked_kb() > 0 and time.monotonic() < end:  # a thread of an earlier test may still be at its end
        time.sleep(0.05)
    before = seen()
    with pytest.raises(ZeroDivisionError), real_time() as granted:
        policy, priority, cpus, locked, collects, slack, files = seen()
        assert priority == granted.fifo_priority and (policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO) == (
            priority > 0
        )
        assert cpus == ({granted.cpu} if granted.cpu >= 0 else before[2])
        assert (locked > before[3]) == granted.memory_locked
        assert (files == 1) == granted.cpu_latency_held == os.access(scheduling.CPU_LATENCY, os.W_OK)
        assert not collects and (slack == 1 or priority)
        given = [granted.fifo_priority > 0, granted.cpu >= 0, granted.memory_locked, granted.cpu_latency_held]
        assert len(granted.refused) == given.count(False)
        _ = 1 / 0
    assert seen() == before


def test_a_thread_started_inside_has_no_priority() -> None:
    import threading

    policies: list[int] = []
    with real_time():
        thread = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert policies == [os.SCHED_OTHER]


def test_without_rights_every_refusal_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    for name in ("sched_setscheduler", "sched_setaffinity"):
        monkeypatch.setattr(os, name, refuse)
    monkeypatch.setattr(scheduling, "CPU_LATENCY", Path("/nowhere/cpu_dma_latency"))
    monkeypatch.setattr(scheduling, "isolated_cpus", lambda: {62, 63})
    monkeypatch.setattr(scheduling, "MLOCK_CURRENT", 1 << 20)  # a flag that does not exist
    before = seen()
    with real_time(75) as granted:
        assert seen()[:4] == before[:4]
    assert (granted.fifo_priority, granted.cpu, granted.memory_locked, granted.cpu_latency_held) == (
        0,
        -1,
        False,
        False,
    )
    text = "\n".join(granted.refused)
    assert len(granted.refused) == 4
    for word in ("memlock unlimited", "rtprio 75", "processor 63", "udev", "(No such file or directory)"):
        assert word in text
    assert seen() == before


def test_a_lower_priority_is_taken_where_the_limit_is_lower(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def at_most_20(_: int, policy: int, param: os.sched_param) -> None:
        asked.append(param.sched_priority)
        if param.sched_priority > 20:
            raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", at_most_20)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (20, 20))
    with real_time(80, place=None) as granted:
        assert (granted.fifo_priority, granted.cpu) == (20, -1)
    assert asked[:2] == [80, 20]
    assert not any("SCHED_FIFO" in text for text in granted.refused)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("isolated", "last", "next_to_last"), [(set(), 7, 6), ({2}, 2, 7), ({2, 3}, 3, 2), ({8}, 8, 7)]
)
def test_isolated_processors_come_first_and_a_second_thread_takes_another(
    monkeypatch: pytest.MonkeyPatch, isolated: set[int], last: int, next_to_last: int
) -> None:
    taken: list[set[int]] = []
    monkeypatch.setattr(scheduling, "isolated_cpus", lambda: isolated)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(os, "sched_setaffinity", lambda _, cpus: taken.append(set(cpus)))
    with real_time() as first, real_time(place=scheduling.NEXT_TO_LAST) as second:
        assert (first.cpu, second.cpu) == (last, next_to_last)
    assert taken == [{last}, {next_to_last}, set(range(8)), set(range(8))]


def test_one_processor_is_left_to_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with real_time() as granted:
        assert granted.cpu == -1
    assert any("one only" in text for text in granted.refused)


def test_other_systems_are_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from rths_cli.numerics import clock

    monkeypatch.setattr(clock, "REAL_TIME", False)
    with pytest.raises(InputError, match="real time needs Linux"), real_time():
        pass


@pytest.mark.parametrize(("text", "wanted"), [("", set()), ("1\n", {1}), ("1,4-6", {1, 4, 5, 6}), ("0-1", {0, 1})])
def test_the_kernels_lists_of_processors_are_read(text: str, wanted: set[int]) -> None:
    assert parse_cpu_list(text) == wanted
