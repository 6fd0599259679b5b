"""A test that the target's own computer steps: the log arrives whole, and what is lost is told by name."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bench import rig_info, specimen
from campaigns.exported_step import bench_step
from hybrid import best_like, ground, open_limits
from test_realtime_loop import Wired

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import RigError
from rths_cli.laboratory.serve_step import SteppingTarget
from rths_cli.loop import realtime_run
from rths_cli.loop.guard import END, OPERATOR, RIG_FAULT, SATURATED
from rths_cli.loop.realtime_loop import IN_RAMP_DOWN, conduct_once
from rths_cli.loop.realtime_run import STOP_KEY, Performance, order, prepare
from rths_cli.loop.run_log import column_names, signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.rigs.stepped_test import Designed
from rths_cli.rigs.udp.plain_rig import Cable
from rths_cli.rigs.udp.stepping_frames import ASK, BEGIN, RECORD, Order, answer_of, order_of
from rths_cli.rigs.udp.stepping_rig import SteppingRig
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

pytestmark = pytest.mark.real_time
STEPS, STILL_S = 300, (1.0, 3.0)
Spoil = Callable[[bytes], list[bytes]]


class Coarse(Wired):
    """The wired rig at 500 Hz."""

    def __init__(self, spoil: Callable[[int, Any], Any] = lambda k, one: one) -> None:
        super().__init__(spoil)
        self.info = rig_info(dt_s=2e-3)
        self.rig = VirtualRig(self.info, build_plant(self.info, VirtualPhysics(), specimen(), 3e-4), (1, 3))


class Spoiled:
    """A connected socket whose datagrams pass `spoil` before they are sent."""

    def __init__(self, door: socket.socket) -> None:
        self.door, self.spoil = door, (lambda data: [data])

    def fileno(self) -> int:
        return self.door.fileno()

    def recv(self, size: int) -> bytes:
        return self.door.recv(size)

    def send(self, data: bytes) -> None:
        for one in self.spoil(data):
            self.door.send(one)


class Bench:
    """A target in a thread, as fast as it can step, and the host's rig at the other end."""

    def __init__(self, samples: Callable[[int, Any], Any], watchdog_s: float = 30.0) -> None:
        here, there = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in "12")
        for one in (here, there):
            one.bind(("127.0.0.1", 0))
        own_port = there.getsockname()[1]
        here.connect(("127.0.0.1", own_port))
        there.close()
        self.wired = Coarse(samples)
        self.info = replace(self.wired.info, kind="target", latency_samples=1)
        self.blocks = replace(best_like(self.info), shaping_step_v=self.info.converters.step_v)
        self.drive = ground(STEPS)
        self.limits = open_limits(self.info)._replace(saturation_v=np.full(3, 9.99))
        step = bench_step(self.info, self.blocks, self.limits, self.drive)
        self.door = Spoiled(here)
        self.target = SteppingTarget(self.door, step, self.wired, watchdog_s, lambda _: None, 0.0)  # type: ignore[arg-type]
        self.thread = threading.Thread(target=self.target.serve)
        self.thread.start()
        cable = Cable("127.0.0.1", own_port, "127.0.0.1", here.getsockname()[1], True)
        self.rig = SteppingRig(self.info, cable, watchdog_s)
        self.rig.open()

    def prepared(self) -> Performance:
        return prepare(self.info, self.blocks, NUMERICAL, self.drive, self.limits, still_s=STILL_S)

    def end(self) -> None:
        self.target.ends = True
        self.thread.join(20)
        self.rig.close()
        self.door.door.close()


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(samples: Callable[[int, Any], Any] = lambda k, one: one, watchdog_s: float = 30.0) -> Bench:
        made.append(Bench(samples, watchdog_s))
        return made[-1]

    yield make
    for one in made:
        one.end()


def test_the_log_is_that_of_the_same_run_stepped_here(bench: Callable[..., Bench]) -> None:
    """Every column but the times of computing, bit by bit, though every fiftieth frame is lost."""
    there, sent = bench(), [0]

    def lossy(data: bytes) -> list[bytes]:
        sent[0] += 1
        return [] if sent[0] % 50 == 0 else [data]

    there.door.spoil = lossy
    run = there.prepared()
    assert realtime_run.perform(there.rig, run) == "" and run.guard.flags[1] == END
    rig = Coarse()
    at_rest = [rig.arm().copy()]
    at_rest += [rig.exchange(0.0).copy() for _ in range(there.target.step.zero_steps)]
    zeros_v, given = np.mean(at_rest[:-1], axis=0), at_rest[-1]
    alone = prepare(there.info, there.blocks, NUMERICAL, there.drive, there.limits, zeros_v, still_s=STILL_S)
    done = int(run.log.done[0])
    for _ in range(done):
        conduct_once(alone.course, alone.step, alone.limits, alone.guard, alone.drive, alone.log, given)
        given = rig.exchange(float(alone.step.command[0])).copy()
    assert done > STEPS + 1000
    np.testing.assert_array_equal(run.log.columns[:-1, :done], alone.log.columns[:-1, :done])
    assert {2.0, 3.0, 4.0, 5.0} == set(signals(run.log, sizes_of(run.step)).state[:done])
    assert run.course.zeros_v == pytest.approx(zeros_v, abs=1e-3)


def test_the_operator_stops_it_and_a_new_session_begins_at_rest(bench: Callable[..., Bench]) -> None:
    there = bench()
    for session in (1, 2):
        run = there.prepared()
        order(run, STOP_KEY)
        assert realtime_run.perform(there.rig, run) == "" and run.guard.flags[1] == OPERATOR
        assert there.target.session == session and there.target.state == 5


def test_its_own_guard_stops_it_and_the_reason_arrives(bench: Callable[..., Bench]) -> None:
    there = bench(lambda k, one: one + (9.9999 if k > 1000 else 0.0))
    run = there.prepared()
    assert realtime_run.perform(there.rig, run) == ""
    assert run.guard.flags[1] == SATURATED and run.guard.flags[2] == 0
    assert signals(run.log, sizes_of(run.step)).state[run.guard.flags[3]] == IN_RAMP_DOWN


def test_a_table_at_its_end_stop_ends_the_test(bench: Callable[..., Bench]) -> None:
    def fails(k: int, one: Any) -> Any:
        if k == 900:
            raise RigError("the table ran into its end stop")
        return one

    there = bench(fails)
    run = there.prepared()
    assert "fault 2" in realtime_run.perform(there.rig, run) and run.guard.flags[1] == RIG_FAULT
    assert there.target.state == 5


def test_a_channel_that_does_not_rest_is_told_by_its_name(bench: Callable[..., Bench]) -> None:
    there = bench(lambda k, one: one + np.array([0.0, 1.5, 0.0]))
    run = there.prepared()
    told = realtime_run.perform(there.rig, run)
    assert f"channel {there.info.channels[1].name} does not rest" in told and run.log.done[0] == 0
    assert run.guard.flags[1] == RIG_FAULT


def test_a_target_that_dies_ends_the_run_with_what_came(bench: Callable[..., Bench]) -> None:
    there = bench()
    run = there.prepared()

    def until(data: bytes) -> list[bytes]:
        return [] if there.target.run.log.done[0] > 700 else [data]

    there.door.spoil = until
    told = realtime_run.perform(there.rig, run)
    assert "was silent for 2 s; look at its table" in told and run.guard.flags[1] == RIG_FAULT
    assert f"the first {run.log.done[0]} steps of its log were stored" in told
    assert np.isfinite(run.log.columns[0, : run.log.done[0]]).all()


def test_a_host_that_dies_leaves_a_table_at_rest(bench: Callable[..., Bench]) -> None:
    there = bench(watchdog_s=0.2)
    there.target.interval_s = 1e-3
    there.rig.begin(there.prepared().drive[1000:1300][: len(there.drive)])
    end = time.monotonic() + 20.0
    while there.target.moves:
        assert time.monotonic() < end
        time.sleep(0.02)
    assert there.target.faults == 1 and there.target.state == 5
    assert there.wired.commands[-1] == 0.0
    found = there.rig.fetch(0, False)
    assert found.state == 5 and found.faults == 1


def test_rows_that_are_gone_are_told_by_their_numbers(bench: Callable[..., Bench]) -> None:
    there = bench()
    there.target.kept = 40
    run = there.prepared()

    def hiccup(data: bytes) -> list[bytes]:
        done = there.target.run.log.done[0]
        return [] if 400 < done < 600 else [data]

    there.door.spoil = hiccup
    told = realtime_run.perform(there.rig, run)
    assert "of its log are lost: they were not fetched in time" in told and run.guard.flags[1] == RIG_FAULT
    assert np.isnan(run.log.columns[0, : run.log.done[0]]).any()


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"case_number": 1.0}, "another case"), ({"model_number": 1.0}, "another model"), ({"columns": 3}, "columns")],
)
def test_the_step_of_another_case_is_refused(bench: Callable[..., Bench], changed: dict[str, float], said: str) -> None:
    there = bench()
    columns = len(column_names(sizes_of(there.prepared().step)))
    there.rig.agree(Designed(0.0, 0.0, columns))
    with pytest.raises(RigError, match=said):
        there.rig.agree(replace(Designed(0.0, 0.0, columns), **changed))  # type: ignore[arg-type]
    with pytest.raises(RigError, match="takes no command"):
        there.rig.arm()


def test_hostile_frames_begin_and_end_nothing(bench: Callable[..., Bench]) -> None:
    there, random = bench(), np.random.default_rng(48)
    real = there.rig.fetch(0, False)
    for _ in range(3000):
        data = bytes(random.integers(0, 256, int(random.integers(0, 1500)), np.uint8))
        frame = Order(int(random.integers(0, 4)), int(random.integers(2**31)), int(random.choice([ASK, BEGIN, RECORD])),
                      random.normal(size=(int(random.integers(0, 50)), 3))).packed()  # fmt: skip
        for one in (data, frame, frame[: int(random.integers(len(frame)))]):
            found = order_of(one)
            if found is not None:
                there.target.count(found)
            assert answer_of(one) is None
    assert there.target.session == 0 and not there.target.moves and real.session == 0
