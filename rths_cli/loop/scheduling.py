"""Real-time scheduling of a thread: priority, processor, locked memory; and how late this machine wakes up."""

from __future__ import annotations

import ctypes
import gc
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.files.machine_rates import P99_SHARE
from rths_cli.numerics.clock import IntArray, monotonic_ns, require_real_time, sleep_until, spin_of
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.rigs.description import RigInfo

PUNCTUAL = 0.125  # latest sending of a command over the interval if steps are caught up; a later one is not sent
PRIORITY = 80  # above the system's threaded interrupts (50), below its own watchdogs (99)
CPU_LATENCY = Path("/dev/cpu_dma_latency")
ISOLATED = Path("/sys/devices/system/cpu/isolated")
LIMITS_FILE = "/etc/security/limits.d/rths.conf"
MLOCK_CURRENT = 1
LAST, NEXT_TO_LAST = -1, -2  # places in the row of processors, the isolated ones at its end
SET_TIMER_SLACK, GET_TIMER_SLACK = 29, 30


@dataclass(frozen=True)
class Granted:
    """Real-time properties that the system granted to a thread."""

    memory_locked: bool
    fifo_priority: int  # 0: not granted
    cpu: int  # processor of its own; -1: not granted
    cpu_latency_held: bool  # whether deep sleep of the processors is off
    refused: tuple[str, ...]  # one sentence with a remedy for each property that was refused


@contextmanager
def real_time(priority: int = PRIORITY, place: int | None = LAST) -> Iterator[Granted]:
    """Give the calling thread real-time properties, as far as the system permits; restore the former ones at the end.

    The present memory is locked, the thread runs under SCHED_FIFO on a processor of its own, and deep sleep of the
    processors and Python's garbage collection are off. Threads that it starts inherit its processor but not its
    priority: start them before. `place`: index of the processor in the list of all; None: any processor.
    Raises InputError if real time is not possible at all.
    """
    require_real_time()
    with ExitStack() as stack:
        refused: list[str] = []
        _no_garbage_collection(stack)
        _no_timer_slack(stack)
        memory = _lock_memory(stack, refused)
        cpu = -1 if place is None else _take_cpu(stack, refused, place)
        latency = _hold_cpu_latency(stack, refused)
        given = _take_priority(stack, refused, priority)
        yield Granted(memory, given, cpu, latency, tuple(refused))


@contextmanager
def at_leisure() -> Iterator[None]:
    """Give up the real-time priority of the calling thread for a while, and keep its other real-time properties."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    _schedule(os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        _schedule(*before)


def _schedule(policy: int, parameters: os.sched_param) -> None:
    """Set a scheduling policy that the calling thread had before, or a lower one."""
    try:
        os.sched_setscheduler(0, policy, parameters)
    except PermissionError:  # only root may take back that a thread's children get no priority (sched(7))
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, parameters)


def _no_garbage_collection(stack: ExitStack) -> None:
    if gc.isenabled():
        gc.disable()
        stack.callback(gc.enable)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


def _no_timer_slack(stack: ExitStack) -> None:
    """Let timers of this thread expire without slack; without SCHED_FIFO Linux may add 50 us."""
    prctl = _libc().prctl
    before = prctl(GET_TIMER_SLACK, 0, 0, 0, 0)
    if before > 0 and prctl(SET_TIMER_SLACK, ctypes.c_ulong(1), 0, 0, 0) == 0:
        stack.callback(prctl, SET_TIMER_SLACK, ctypes.c_ulong(before), 0, 0, 0)


def _lock_memory(stack: ExitStack, refused: list[str]) -> bool:
    """Lock the present memory of the process in RAM; memory allocated later is not locked."""
    libc = _libc()
    if libc.mlockall(MLOCK_CURRENT) == 0:
        stack.callback(libc.munlockall)
        return True
    why = os.strerror(ctypes.get_errno())
    refused.append(f"memory is not locked ({why}): put '@realtime - memlock unlimited' into {LIMITS_FILE}")
    return False


def _take_cpu(stack: ExitStack, refused: list[str], place: int) -> int:
    """Move this thread to one processor; return its number, -1 for none."""
    before, isolated = os.sched_getaffinity(0), isolated_cpus()
    choice = [*sorted(before - isolated), *sorted(isolated)]
    if len(choice) < 2:
        refused.append("the thread has no processor of its own: there is one only, and the system needs it")
        return -1
    cpu = choice[place]
    if not _tried(lambda: os.sched_setaffinity(0, {cpu}), f"processor {cpu} was not given", "ask for it", refused):
        return -1
    stack.callback(os.sched_setaffinity, 0, before)
    return cpu


def isolated_cpus() -> set[int]:
    """Return the processors that the kernel was started with `isolcpus=` for."""
    try:
        return parse_cpu_list(ISOLATED.read_text())
    except OSError:
        return set()


def parse_cpu_list(text: str) -> set[int]:
    """Return the numbers of a kernel's list of processors, for instance 1,4-6."""
    ranges = [part.partition("-") for part in text.strip().split(",") if part]
    return {n for first, _, last in ranges for n in range(int(first), int(last or first) + 1)}


def _hold_cpu_latency(stack: ExitStack, refused: list[str]) -> bool:
    """Keep the processors out of deep sleep, from which they wake up late."""
    return _tried(
        lambda: _write_zero(stack),
        "the processors may fall into deep sleep",
        f'let the group realtime write to {CPU_LATENCY} (a udev rule: KERNEL=="cpu_dma_latency", GROUP="realtime")',
        refused,
    )


def _write_zero(stack: ExitStack) -> None:
    descriptor = os.open(CPU_LATENCY, os.O_WRONLY)
    stack.callback(os.close, descriptor)  # the kernel keeps the wish as long as it is open
    os.write(descriptor, bytes(4))  # 0 us


def _take_priority(stack: ExitStack, refused: list[str], wanted: int) -> int:
    """Put this thread under SCHED_FIFO, at most as high as its limit permits; return the priority, 0 for none."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    for priority in dict.fromkeys((wanted, min(wanted, _priority_limit()))):
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except (OSError, ValueError):
            continue
        stack.callback(_schedule, *before)
        return priority
    refused.append(
        f"SCHED_FIFO {wanted} was refused: put '@realtime - rtprio {wanted}' into {LIMITS_FILE}, join the group "
        "realtime and log in again"
    )
    return 0


def _priority_limit() -> int:
    import resource

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    return 99 if limit == resource.RLIM_INFINITY else limit


def _tried(action: Callable[[], object], what: str, remedy: str, refused: list[str]) -> bool:
    """Call `action`, which the system may refuse; return whether it succeeded, else add a sentence to `refused`."""
    try:
        action()
    except OSError as error:
        refused.append(f"{what} ({error.strerror}): {remedy}")
        return False
    return True


CHUNK_S = 0.25  # interval at which signals are handled


@entry
def wait_periodically(interval_ns: int, spin_ns: int, late_ns: IntArray, scratch: IntArray) -> None:
    """Wait for late_ns.size deadlines, one per interval; write the delay of each wake-up in ns to `late_ns` (n,).

    Deadlines that passed while it waited for another one are skipped. `scratch` is (2,) int64.
    """
    late_ns, scratch = borrowed((late_ns, scratch))
    deadline = monotonic_ns(scratch) + interval_ns
    for k in range(late_ns.size):
        late_ns[k] = sleep_until(deadline, spin_ns, scratch)
        deadline += interval_ns * (1 + late_ns[k] // interval_ns)


def wake_up_delays(rate_hz: float, seconds: float, spins: bool = True) -> IntArray:
    """Return the delay (n,) in ns of every wake-up at a rate; `spins`: watch the clock before each deadline."""
    interval_ns = round(1e9 / rate_hz)
    spin_ns = spin_of(interval_ns) if spins else 0
    steps, chunk = max(round(seconds * rate_hz), 1), max(round(CHUNK_S * rate_hz), 1)
    late_ns, scratch = np.zeros(steps, dtype=np.int64), np.zeros(2, dtype=np.int64)
    for first in range(0, steps, chunk):
        wait_periodically(interval_ns, spin_ns, late_ns[first : first + chunk], scratch)
    return late_ns


def wake_share(info: RigInfo) -> float:
    """Return the fraction of an interval within which a step must wake up.

    It is smaller if the loop's own clock sets the pace and missed steps are caught up, because a later command is then
    not sent.
    """
    return PUNCTUAL if info.can.takes_trajectories and info.overrun == "skip" else P99_SHARE
