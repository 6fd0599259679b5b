"""Hostile, damaged and disordered frames on the plain link: what they may do at the target's and the runner's end."""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hybrid import best_like
from plain_peer import ASK, AT_REST, BEGIN, COMMAND, FRAME, REST, RUNNING, OwnTarget

from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.laboratory.serve import PlainServer, describe
from rths_cli.loop import realtime_run
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.rigs.udp.session import bound

pytestmark = pytest.mark.real_time
SHORT, LONG = 4000, 100_000
CHUNK = 40
EXAMPLE = Path(__file__).parents[2] / "examples" / "plain_target.c"
RANGE_V, CHANNELS = 10.0, 3
RESTS_S = 2.0  # the page's
WATCHDOG_S = 1.0
LEFT = struct.Struct("<4s5I2d")


@dataclass
class Rules:
    """What the page says that a target keeps, as far as frames alone decide it."""

    session: int = 0
    last: int = 0
    running: bool = False
    obeyable: tuple[int, ...] = (0,)  # numbers of this session that may act

    def count(self, data: bytes) -> bool:
        """Let a frame count; return whether the target answers it."""
        if len(data) != 40 or data[:4] != b"RPC1":
            return False
        _, session, number, _, order, _, _, volts = FRAME.unpack(data)
        if order > REST:
            return False
        if order == BEGIN and not self.running and session == self.session + 1 and number == 0:
            self.session, self.last, self.running, self.obeyable = session, 0, True, (0,)
        elif order in (COMMAND, REST) and session == self.session and number > self.last:
            self.last = number
            if self.running and order == COMMAND and abs(volts) <= RANGE_V:
                self.obeyable = (*self.obeyable[-200:], number)
            elif self.running:
                self.running = False
        return True


def hostile(random: np.random.Generator, rules: Rules) -> bytes:
    """Return a frame that nobody who means well sends; some are well-formed commands of this very session."""
    volts = float(random.choice([0.0, 1.0, -3.0, 9.99, -9.99, 10.01, 1e300, -np.inf, np.inf, np.nan]))
    volts = float(random.uniform(-10.0, 10.0)) if random.random() < 0.7 else volts
    session = rules.session + int(random.choice([0, 0, 0, 0, 0, 0, -1, 1, 2, 2**30])) & 0xFFFFFFFF
    step = int(random.choice([1, 1, 1, 2, 5, 0, -1, -3]))
    number = max(rules.last + step, 0)
    order = int(random.choice([COMMAND] * 30 + [ASK, BEGIN, REST, 4, 255]))
    if order == BEGIN and random.random() < 0.8:
        session, number = rules.session + 1, 0
    frame = FRAME.pack(b"RPC1", session, number, 7, order, 0, float(random.uniform()), volts)
    kind = random.random()
    if kind < 0.05:
        return bytes(random.integers(0, 256, int(random.integers(0, 600)), np.uint8))
    if kind < 0.10:
        return frame[: int(random.integers(0, 40))] if random.random() < 0.5 else frame + bytes(8)
    if kind < 0.15:
        at = int(random.integers(0, 24))  # a bit of the whole numbers falls over
        return frame[:at] + bytes([frame[at] ^ 1 << int(random.integers(8))]) + frame[at + 1 :]
    return frame


class Cable:
    """The runner's end in a stranger's hands."""

    def __init__(self, port: int, own_port: int) -> None:
        self.door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.door.bind(("127.0.0.1", own_port))
        self.door.connect(("127.0.0.1", port))
        self.door.settimeout(10.0)

    def answer(self) -> tuple[Any, ...]:
        data = self.door.recv(2048)
        assert data[:4] == b"RPS1" and len(data) == 40 + 8 * CHANNELS
        return LEFT.unpack_from(data)


@pytest.fixture
def served_end() -> Iterator[tuple[int, int, float]]:
    """Serve the virtual table; yield both ports and its velocity limit in V/s."""
    rig = describe("aps400_virtual", "three_storey", ("sample_rate_hz=250",), 0)
    here, there = bound("127.0.0.1", 0), bound("127.0.0.1", 0)
    own_port = there.getsockname()[1]
    here.connect(("127.0.0.1", own_port))
    there.close()
    server = PlainServer(here, False, rig, round(1e9 * WATCHDOG_S), lambda told: None)
    server.start()
    thread = threading.Thread(target=server.run_for, args=(None,))
    thread.start()
    limits = rig.setup.rig.limits
    yield here.getsockname()[1], own_port, limits.velocity_m_s / rig.setup.rig.gain_m_per_v
    server.end()
    thread.join(10)
    here.close()


@pytest.fixture
def c_end(tmp_path: Path) -> Iterator[tuple[int, int, float]]:
    """Start the example in C; yield the same."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no C compiler here")
    program = tmp_path / "plain_target"
    subprocess.run([compiler, "-std=c99", "-O1", f"-DWATCHDOG_S={WATCHDOG_S}", "-o", program, EXAMPLE], check=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        own_port = free.getsockname()[1]
    words = [program, "127.0.0.1:0", f"127.0.0.1:{own_port}", "runner"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    yield int(process.stdout.readline().split()[-1]), own_port, 130.0
    process.kill()
    process.wait()
    process.stdout.close()


def attack(cable: Cable, count: int, fastest_v_s: float) -> tuple[int, int]:
    """Send frames and hold each answer against the page; return how many were answered, and how many sessions began.

    Every frame that the rules let pass is answered, so that none is lost here and the answers come in order.
    """
    random, rules, answered, stalls, sent = np.random.default_rng(20261128), Rules(), 0, 0, 0
    old: list[bytes] = []
    begun_s = time.monotonic()
    while sent < count:
        frames: list[bytes] = []
        expected: list[Rules] = []
        was_running = rules.running
        while len(frames) < CHUNK and (rules.running or not was_running):  # how soon a table rests, frames cannot tell
            again = bool(old) and random.random() < 0.15
            frame = old[int(random.integers(len(old)))] if again else hostile(random, rules)
            old = [*old[-500:], frame]
            frames.append(frame)
            if rules.count(frame):
                expected.append(replace(rules))
            was_running = was_running or rules.running
        before_s, begun_s = begun_s, time.monotonic()
        for frame in frames:
            cable.door.send(frame)
        sent += len(frames)
        shown = [cable.answer() for _ in expected]
        stalled = time.monotonic() - before_s > 0.8 * WATCHDOG_S  # the watchdog may have acted in the midst
        stalls += stalled
        for told, must in zip(shown, expected, strict=True):
            _, session, number, echo, state, faults, _, output_v = told
            assert abs(output_v) <= RANGE_V and not faults & ~(1 | 8)
            if not stalled:
                assert (session, number) == (must.session, must.last)
                assert echo in must.obeyable or echo < must.obeyable[0] or not must.running
                assert state != RUNNING or must.running
        if shown:
            passed_s = shown[-1][6] - shown[0][6] + 0.02  # what one command may make up for after a pause
            assert abs(shown[-1][7] - shown[0][7]) <= fastest_v_s * passed_s
            rules.running = rules.running and shown[-1][4] == RUNNING
            if stalled:
                rules = Rules(*shown[-1][1:3], shown[-1][4] == RUNNING, (2**32,))  # any number may act
            answered += len(shown)
            if shown[-1][4] != RUNNING:
                rested(cable)
                begun_s = time.monotonic()
    assert stalls < 3 + sent // (10 * CHUNK)
    return answered, rules.session


def rested(cable: Cable) -> None:
    """Wait until the table is at rest, which it must be within the page's time."""
    begun = time.monotonic()
    state = 0
    while state != AT_REST:
        assert time.monotonic() < begun + RESTS_S + 1.0
        cable.door.send(FRAME.pack(b"RPC1", 0, 0, 0, ASK, 0, 0.0, 0.0))
        state = cable.answer()[4]
        time.sleep(0.002)


def attacked_end(end: tuple[int, int, float], count: int) -> None:
    port, own_port, fastest_v_s = end
    cable = Cable(port, own_port)
    answered, sessions = attack(cable, count, fastest_v_s)
    assert answered > 0.5 * count and sessions > count // 2000
    silent = time.monotonic()
    time.sleep(WATCHDOG_S)
    rested(cable)
    assert time.monotonic() - silent < WATCHDOG_S + RESTS_S + 1.0
    cable.door.send(FRAME.pack(b"RPC1", 0, 0, 0, ASK, 0, 0.0, 0.0))
    assert cable.answer()[7] == 0.0
    cable.door.close()


@pytest.mark.campaign
def test_hostile_frames_at_a_served_table(served_end: tuple[int, int, float]) -> None:
    attacked_end(served_end, SHORT)


def test_hostile_frames_at_the_example_in_c(c_end: tuple[int, int, float]) -> None:
    attacked_end(c_end, SHORT)


@pytest.mark.campaign
@pytest.mark.parametrize("end", ["served_end", "c_end"])
def test_a_hundred_thousand_hostile_frames(request: pytest.FixtureRequest, end: str) -> None:
    attacked_end(request.getfixturevalue(end), LONG)


def wild(random: np.random.Generator, frame: bytes) -> list[bytes]:
    """Return what comes for one frame of the target: hostile ones before and after it, some with its own number."""
    made = []
    for _ in range(int(random.integers(0, 200))):
        volts = random.uniform(-12.0, 12.0, CHANNELS)
        volts[random.random(CHANNELS) < 0.1] = random.choice([np.nan, np.inf, 1e300])
        number = struct.unpack_from("<I", frame, 8)[0] + int(random.choice([-2, -1, 1, 2, 1000, 2**31]))
        other = [frame[4:8], struct.pack("<I", int(random.integers(2**32)))][int(random.random() < 0.3)]
        made.append(frame[:4] + other + struct.pack("<I", number & 0xFFFFFFFF) + frame[12:40] + volts.tobytes())
        if random.random() < 0.1:
            made[-1] = bytes(random.integers(0, 256, int(random.integers(0, 100)), np.uint8))
    if random.random() < 0.02:  # the right number, state and session, before the target's own
        made.append(frame[:40] + random.uniform(-1.0, 1.0, CHANNELS).tobytes())
    at = int(random.integers(0, len(made) + 1))
    return [*made[:at], frame, *made[at:]]


def run_among_strangers(steps: int) -> tuple[OwnTarget, realtime_run.Performance, int]:
    """Play a hybrid test whose target's frames arrive among hostile ones; return target, run and number of these."""
    rig = describe("aps400_virtual", "three_storey", ("sample_rate_hz=250",), 0)
    info = replace(
        rig.setup.rig, kind="udp_plain", limits=replace(rig.setup.rig.limits, lost_samples=60)
    )  # fmt: skip
    random, sent = np.random.default_rng(7), [0]
    target = OwnTarget(lambda volts: [0.001 * (volts or 0.0)] * CHANNELS, CHANNELS, None, 1.0, RANGE_V + 1.0)
    plain = target.rig(info, 1.0, 0.1)
    plain.open()
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    time_s = info.dt_s * np.arange(steps)
    drive = np.column_stack([np.sin(12.0 * time_s), -np.cos(12.0 * time_s) / 12.0, -np.sin(12.0 * time_s) / 144.0])
    run = realtime_run.prepare(info, blocks, NUMERICAL, 0.2 * drive, guard_limits(rig.setup), ramp_s=0.2)

    def spoil(number: int, frame: bytes) -> list[bytes]:
        if number == 0:
            return [frame]
        made = wild(random, frame)
        sent[0] += len(made) - 1
        return made

    target.spoil = spoil
    realtime_run.perform(plain, run)
    target.spoil = lambda number, frame: [frame]
    plain.rest()
    assert plain.at_rest
    plain.close()
    target.kill()
    return target, run, sent[0]


def kept_by_the_guard(target: OwnTarget, run: realtime_run.Performance) -> None:
    """Assert that no command left beyond the guard's limits of displacement and velocity."""
    limits, dt_s = run.limits, run.info.dt_s
    numbers = np.array([number for _, number, _ in target.obeyed])
    volts = np.array([volt for _, _, volt in target.obeyed])
    assert np.isfinite(volts).all() and np.abs(volts).max() <= limits.stroke_m / limits.gain_m_per_v + 1e-9
    fastest_v = limits.velocity_m_s / limits.gain_m_per_v * dt_s * np.diff(numbers)
    assert (np.abs(np.diff(volts)) <= fastest_v * (1.0 + 1e-6) + run.info.converters.step_v).all()
    assert target.state == AT_REST and target.output_v == 0.0


@pytest.mark.campaign
def test_a_run_among_hostile_frames_stays_within_its_guard() -> None:
    target, run, sent = run_among_strangers(150)
    kept_by_the_guard(target, run)
    assert sent > 1000


@pytest.mark.campaign
def test_a_hundred_thousand_hostile_frames_at_the_runner() -> None:
    sent = 0
    while sent < LONG:
        target, run, more = run_among_strangers(2000)
        kept_by_the_guard(target, run)
        sent += more
