"""A run in real time: the same step as offline, a ramp before and after, orders and losses that end it."""

from __future__ import annotations

import socket
import time
from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, rig_info, specimen
from hybrid import best_like, ground, open_limits
from scipy.linalg import expm

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.loop import guard as g
from rths_cli.loop import realtime_loop, realtime_run
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.realtime_loop import overrun, run_udp, too_late_for
from rths_cli.loop.run_log import Log, Signals, signals, sizes_of
from rths_cli.loop.simulated_time_run import play
from rths_cli.loop.step_arrays import NUMERICAL, Step
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp.link import fresh_link
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant


class Wired:
    """A virtual rig behind the bare interface, its command one sample under way, that may misbehave."""

    def __init__(self, spoil=lambda k, samples: samples) -> None:
        self.info = rig_info()
        self.rig = VirtualRig(self.info, build_plant(self.info, VirtualPhysics(), specimen(), 3e-4), (1, 3))
        self.spoil, self.k, self.commands = spoil, 0, []

    def open(self) -> None: ...

    def arm(self) -> Array:
        return self.rig.arm()

    def exchange(self, command_v: float) -> Array:
        self.k += 1
        self.commands.append(command_v)
        return self.spoil(self.k, self.rig.exchange(command_v).copy())

    def rest(self) -> None: ...

    def close(self) -> None: ...


def prepared(info, drive, **options):
    limits = options.pop("limits", open_limits(info))
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    return blocks, realtime_run.prepare(info, blocks, NUMERICAL, drive, limits, **options)


def test_the_steps_are_those_of_an_offline_run_byte_for_byte() -> None:
    rig, drive = Wired(), ground(3000)
    blocks, run = prepared(rig.info, drive, ramp_s=0.0)
    assert realtime_run.perform(rig, run) == ""
    offline = play(rig.rig, rig.info, blocks, NUMERICAL, drive, open_limits(rig.info))
    live = signals(run.log, sizes_of(run.step))
    for name in ("command_v", "desired", "corrected", "estimated", "base_shear_n"):
        assert getattr(live, name)[..., :3000].tobytes() == getattr(offline.log, name).tobytes(), name


def test_after_the_record_the_table_is_led_to_rest_within_two_seconds() -> None:
    rig, drive = Wired(), ground(3000)
    _, run = prepared(rig.info, drive, ramp_s=0.25)
    realtime_run.perform(rig, run)
    state = signals(run.log, sizes_of(run.step)).state[: run.log.done[0]]
    assert run.guard.flags[1] == g.END
    assert rig.commands[-1] == 0.0
    assert [int((state == number).sum()) for number in (2, 3)] == [500, 3000]
    assert (state == 4).sum() * rig.info.dt_s < 2.0
    assert state[-1] == realtime_loop.AT_REST


def test_the_command_fades_in() -> None:
    info = rig_info()
    noise = lambda k, samples: samples + 0.05 * np.sin(0.05 * k)  # noqa: E731 what a sensor of a shaken floor shows
    fading, whole = Wired(noise), Wired(noise)
    realtime_run.perform(fading, prepared(info, ground(500), ramp_s=0.5)[1])
    realtime_run.perform(whole, prepared(info, np.vstack([np.zeros((1000, 3)), ground(500)]), ramp_s=0.0)[1])
    first, other = (np.abs(rig.commands[:200]).max() for rig in (fading, whole))
    assert other > 0.01
    assert first < 0.25 * other


@pytest.mark.parametrize(
    ("order", "reason"), [(1, g.OPERATOR), (2, g.INTERRUPT), (3, g.TERMINATION), (4, g.LOG_FAILED)]
)
def test_an_order_leads_to_rest_and_says_whose_it_was(order: int, reason: int) -> None:
    orders = np.zeros(1, dtype=np.int64)

    def spoil(k: int, samples: Array) -> Array:
        orders[0] = order if k >= 1500 else 0
        return samples

    rig = Wired(spoil)
    _, run = prepared(rig.info, ground(20000), ramp_s=0.0, orders=orders)
    realtime_run.perform(rig, run)
    assert tuple(run.guard.flags[:2]) == (g.STOPPED, reason)
    assert rig.k - 1500 < 2.0 / rig.info.dt_s
    assert rig.commands[-1] == 0.0
    assert g.OPERATOR + 3 == g.LOG_FAILED


WATCHED_S = 0.5


def steps_at_rest(rig: Wired, *, order_at: int = 0) -> int:
    """Return how many steps a rig was watched at rest after its run; `order_at`: exchange that brings an order."""
    orders, spoil = np.zeros(1, dtype=np.int64), rig.spoil

    def ordered(k: int, samples: Array) -> Array:
        orders[0] = order_at and int(k >= order_at)
        return spoil(k, samples)

    rig.spoil = ordered
    _, run = prepared(rig.info, ground(3000), ramp_s=0.0, orders=orders, still_s=(0.0, WATCHED_S))
    realtime_run.perform(rig, run)
    state = signals(run.log, sizes_of(run.step)).state[: run.log.done[0]]
    return int((state == realtime_loop.AT_REST).sum())


@pytest.mark.campaign
def test_after_a_whole_record_the_table_is_watched_at_rest() -> None:
    rig = Wired()
    watched = round(WATCHED_S / rig.info.dt_s)
    assert steps_at_rest(rig) == 1 + watched  # the first is the one that comes to rest
    assert steps_at_rest(Wired(), order_at=rig.k - watched + 50) == 1 + 50  # an order ends the watching
    broken = Wired(lambda k, samples: samples * (np.nan if k == 1500 else 1.0))
    assert steps_at_rest(broken) == 1  # after a run that ended early nothing is watched


def test_signs_and_zeros_are_those_of_the_channels() -> None:
    info = rig_info()
    upside = replace(info, channels=tuple(replace(channel, sign=-1.0) for channel in info.channels))
    zeros = np.array([0.05, -0.02, 0.01])
    right, turned = Wired(), Wired(lambda k, samples: zeros - samples)
    runs = [prepared(info, ground(400), ramp_s=0.0)[1], prepared(upside, ground(400), ramp_s=0.0, zeros_v=zeros)[1]]
    arm = turned.arm
    turned.arm = lambda: zeros - arm()
    for rig, run in zip((right, turned), runs, strict=True):
        realtime_run.perform(rig, run)
    np.testing.assert_allclose(turned.commands, right.commands, rtol=0.0, atol=1e-9)


def test_a_rehearsal_moves_nothing_and_tells_how_late_each_step_was() -> None:
    info = rig_info(dt_s=2e-3)
    _, run = prepared(info, ground(1000))
    late, took = realtime_run.rehearse(run, 0.2)
    assert late.shape == took.shape == (99,)
    assert (late >= 0.0).all()
    assert (took > 0.0).all()


@entry
def look(course: realtime_loop.Course, state: g.GuardState, number: int, tolerance_ns: int) -> int:
    """Call `overrun` with what `too_late_for` finds."""
    course, state = borrowed((course, state))
    return overrun(course, state, too_late_for(course, number, tolerance_ns))


@pytest.mark.parametrize(
    ("policy", "tolerance", "missed"),
    [
        (realtime_loop.HOLD, 100, 3),
        (realtime_loop.HOLD, 0, 4),
        (realtime_loop.SKIP, 12, 4),
        (realtime_loop.SKIP, 60, 3),
    ],
)
def test_a_missed_interval_is_counted_once_where_the_record_waits(policy: int, tolerance: int, missed: int) -> None:
    """Intervals of 100 s: exchange 2 was due 350 s ago, 3 was 250 s ago, 4 150 s, 5 50 s."""
    _, run = prepared(rig_info(), ground(100))
    course = run.course._replace(dt_ns=100_000_000_000, policy=policy)
    course.marks[realtime_loop.START_NS] = time.monotonic_ns() - 550_000_000_000
    waits = policy == realtime_loop.HOLD
    assert look(course, run.guard, 2, tolerance * 1_000_000_000) == (0 if waits else missed)
    assert course.marks[realtime_loop.OVERRUNS] == missed
    look(course, run.guard, 2, tolerance * 1_000_000_000)
    assert course.marks[realtime_loop.OVERRUNS] == (missed if waits else 2 * missed)


def test_an_exchange_that_is_due_later_is_not_missed() -> None:
    _, run = prepared(rig_info(), ground(100))
    course = run.course._replace(dt_ns=100_000_000_000, policy=realtime_loop.SKIP)
    course.marks[realtime_loop.START_NS] = time.monotonic_ns()
    assert look(course, run.guard, 5, 0) == look(course, run.guard, 0, 12_000_000_000) == 0
    assert course.marks[realtime_loop.OVERRUNS] == 0


@entry
def conducted(
    course: realtime_loop.Course, s: Step, limits: GuardLimits, state: g.GuardState, drive: Array, log: Log,
    samples: Array, lost: int, k: int,
) -> float:  # fmt: skip
    """Call `conduct`."""
    course, s, limits, state, drive, log, samples = borrowed((course, s, limits, state, drive, log, samples))
    return realtime_loop.conduct(course, s, limits, state, drive, log, samples, lost, k)


def with_losses(lost: Array) -> Signals:
    """Return the signals of a hybrid test on the virtual table of which some steps get no samples, (n,)."""
    rig = Wired()
    blocks = replace(best_like(rig.info), shaping_step_v=rig.info.converters.step_v)
    limits = open_limits(rig.info)
    run = realtime_run.prepare(rig.info, blocks, NUMERICAL, 10.0 * ground(len(lost)), limits, ramp_s=0.0)
    samples = rig.arm().copy()
    for k, missing in enumerate(lost):
        shown = np.full(3, 9.0) if missing else samples  # what stands there must not matter
        told = (run.course, run.step, limits, run.guard, run.drive, run.log, shown, int(missing), k)
        samples = rig.exchange(conducted(*told)).copy()
    return signals(run.log, sizes_of(run.step))


@pytest.fixture(scope="module")
def whole() -> Signals:
    return with_losses(np.zeros(1500))


GAP = slice(900, 912)


@pytest.fixture(scope="module")
def gap() -> Signals:
    lost = np.zeros(1500)
    lost[GAP] = 1
    return with_losses(lost)


@pytest.mark.campaign
def test_where_no_samples_came_the_table_is_as_desired(gap: Signals) -> None:
    """Corrected for sensor and staircase it is what was desired for t_k, two samples before."""
    wanted = gap.desired[0, GAP.start - 2 : GAP.stop - 2]
    assert np.abs(wanted).max() > 0.1
    assert gap.corrected[0, GAP] == pytest.approx(wanted, rel=1e-12, abs=1e-12)


def test_where_no_samples_came_the_specimen_goes_on_by_itself(gap: Signals) -> None:
    """Its motion from the last estimate on, by the matrix exponential of Eq. 2.5 under a straight line of the table."""
    parts = specimen()
    inverse = 1.0 / parts.masses_kg[:, None]
    lower = np.hstack([-inverse * parts.K, -inverse * parts.C])
    chain = np.zeros((6, 6))
    chain[:2, 2:4], chain[2:4, :4], chain[2:4, 4], chain[4, 5] = np.eye(2), lower, -1.0, 1.0
    moved = expm(chain * DT_S)
    motion, table = gap.estimated[:4, GAP.start], gap.corrected[0]
    for k in range(GAP.start + 1, GAP.stop):
        motion = moved[:4] @ [*motion, table[k - 1], (table[k] - table[k - 1]) / DT_S]
        assert gap.estimated[:4, k] == pytest.approx(motion, rel=3e-3)
        assert gap.corrected[1:, k] == pytest.approx(lower @ motion, rel=3e-3)
        assert gap.corrected[1:, k] == pytest.approx(gap.estimated[4:6, k], rel=1e-9)


@pytest.mark.campaign
def test_what_is_lost_changes_what_is_desired_by_little(whole: Signals, gap: Signals) -> None:
    wanted = whole.desired[0, :1500]
    change = gap.desired[0, :1500] - wanted
    assert 0.0 < np.abs(change).max() < 2e-3 * np.abs(wanted).max()


def test_a_run_whose_first_exchange_is_late_logs_numbers() -> None:
    """Every exchange of so fast a clock is late, the first one too; nothing is sent."""
    info = rig_info()
    _, run = prepared(info, ground(400), ramp_s=0.0)
    course = run.course._replace(dt_ns=1, spin_ns=0, lost_samples=1 << 40)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        link = fresh_link(door, np.zeros(2, dtype=np.uint64), len(info.channels))
        run_udp(link, course, run.step, run.limits, run.guard, run.drive, run.log, False)
    live = signals(run.log, sizes_of(run.step))
    done = slice(0, int(run.log.done[0]))
    assert (live.lost[done] == 2).any()
    assert np.isfinite(live.command_v[done]).all()
    assert run.guard.flags[1] != g.NOT_A_NUMBER
