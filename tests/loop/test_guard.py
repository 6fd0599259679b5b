"""The guard: whatever is asked, what leaves it is bounded, and every limit says its name."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info, specimen
from hybrid import best_like, ground, open_limits
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control import feedback, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import no_force
from rths_cli.control.state_space import static
from rths_cli.loop import guard as g
from rths_cli.loop.guard import (
    AT_REST_M,
    FORGET_HZ,
    STOPPED,
    GuardLimits,
    GuardState,
    check_energy,
    check_errors,
    fresh_guard,
    guard,
)
from rths_cli.loop.simulated_time_run import Outcome, Stillness, play
from rths_cli.loop.step_arrays import EXCITATION, RECORD
from rths_cli.loop.stop_reasons import reason_of
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import Limits, RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

DT_S = 5e-4
NOISE = np.random.default_rng(0).standard_normal((30000, 3)) * 1e-3


@entry
def ask(
    limits: GuardLimits,
    state: GuardState,
    asked: Array,
    samples: Array,
    accel: Array,
    expected: Array,
    sent: Array,
    phase: Array,
) -> None:
    """Send every asked command (n,) through the guard; note what leaves it and its phase."""
    limits, state, asked, samples, accel, expected, sent, phase = borrowed(
        (limits, state, asked, samples, accel, expected, sent, phase)
    )
    still = np.zeros((3, 1))
    for k in range(asked.size):
        sent[k] = asked[k]
        guard(limits, state, sent[k : k + 1], True, samples[k], accel[k], expected, still[0], True, still, still[0])
        phase[k] = state.flags[0]


@entry
def listening(limits: GuardLimits, state: GuardState, came: Array, samples: Array, expected: Array) -> None:
    """Give the guard samples (n, c) in V, of which not all came (n,), and what they must show (n, 2, c)."""
    limits, state, came, samples, expected = borrowed((limits, state, came, samples, expected))
    command, still = np.zeros(1), np.zeros((3, 1))
    for k in range(came.size):
        command[0], here = 0.0, samples[k]
        guard(limits, state, command, came[k] > 0.0, here, here, expected[k], still[0], True, still, still[0])


def limits(
    stroke_m: float = 0.079, velocity_m_s: float = 1.0, acceleration_m_s2: float = 45.0, force_n: float = 445.0
) -> GuardLimits:
    return GuardLimits(
        stroke_m,
        velocity_m_s,
        acceleration_m_s2,
        force_n,
        10.0,
        np.inf,
        0.0079,
        DT_S,
        np.full(3, 7.0),
        np.full(3, 4.99),
        np.full(3, 0.03),
        np.full(3, acceleration_m_s2),
    )


def answer(lim: GuardLimits, asked: Array, samples: Array | None = None) -> tuple[Array, Array]:
    """Return what leaves the guard and its phases when these commands are followed by zeros for a long time."""
    asked = np.concatenate([asked, np.zeros(20000)])
    noise = NOISE[: asked.size].copy()
    if samples is not None:
        noise[: len(samples)] = samples
    sent, phase = np.zeros(asked.size), np.zeros(asked.size)
    ask(lim, fresh_guard(3), asked, noise, noise * 9.80665, np.zeros((2, 3)), sent, phase)
    return sent, phase


def bad_number(size: float) -> st.SearchStrategy[float]:
    return st.one_of(st.floats(-size, size), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, 10.0, -10.0]))


@st.composite
def demands(draw: st.DrawFn) -> Array:
    """A few pieces: constants, ramps, sines, noise, and single wild values among them."""
    pieces = []
    for _ in range(draw(st.integers(1, 4))):
        size, count = draw(st.floats(-12.0, 12.0)), draw(st.integers(1, 400))
        shape = draw(st.sampled_from(["constant", "ramp", "sine", "noise"]))
        k = np.arange(count)
        pieces.append(
            {
                "constant": np.full(count, size),
                "ramp": size * k / count,
                "sine": size * np.sin(k * DT_S * 2.0 * np.pi * draw(st.floats(0.1, 60.0))),
                "noise": size * np.random.default_rng(7).standard_normal(count),
            }[shape]
        )
        pieces.append(np.array(draw(st.lists(bad_number(12.0), max_size=2))))
    return np.concatenate(pieces)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    asked=demands(),
    stroke=st.floats(0.002, 0.15),
    velocity=st.floats(0.05, 2.0),
    acceleration=st.floats(1.0, 60.0),
    broken=st.one_of(st.none(), st.tuples(st.integers(0, 300), bad_number(20.0))),
)
def test_whatever_is_asked_what_leaves_is_bounded_and_comes_to_rest(
    asked: Array, stroke: float, velocity: float, acceleration: float, broken: tuple[int, float] | None
) -> None:
    lim = limits(stroke, velocity, acceleration)
    samples = None
    if broken is not None:
        samples = NOISE[: broken[0] + 1].copy()
        samples[-1, 1] = broken[1]
    sent, phase = answer(lim, asked, samples)
    place = lim.gain_m_per_v * sent
    speed = np.diff(place, prepend=0.0) / DT_S
    assert np.isfinite(sent).all()
    assert np.abs(sent).max() <= 10.0
    assert np.abs(place).max() <= stroke * (1.0 + 1e-12)
    assert np.abs(speed).max() <= velocity * (1.0 + 1e-9) + AT_REST_M / DT_S
    stopped = np.flatnonzero(phase > 0)
    if stopped.size:
        first = stopped[0]
        assert (np.diff(phase[first:]) >= 0).all()
        change = np.abs(np.diff(speed[max(first - 1, 0) :])) / DT_S
        last_jump = 2.0 * AT_REST_M / DT_S**2  # the final step to exactly zero, less than half a bit
        assert change.max(initial=0.0) <= max(0.46 * acceleration, last_jump)
        assert phase[-1] == STOPPED
        assert sent[-1] == 0.0
        assert (sent[phase == STOPPED] == 0.0).all()


def test_with_the_shipped_limits_the_table_rests_two_seconds_after_braking() -> None:
    asked = np.concatenate([np.linspace(0.0, 9.0, 2000), [math.nan]])
    sent, phase = answer(limits(), asked)
    speed = np.diff(0.0079 * sent, prepend=0.0) / DT_S
    braking = np.count_nonzero(phase == 1) * DT_S
    assert braking == pytest.approx(speed[1999] / (0.45 * 45.0), abs=2.0 * DT_S)
    rest = (np.flatnonzero(phase == STOPPED)[0] - 2000) * DT_S
    assert 1.0 < rest < 2.0 + braking


@pytest.mark.parametrize(("velocity", "acceleration"), [(0.05, 45.0), (1.0, 2.0)])
def test_the_way_back_from_far_out_keeps_tight_limits(velocity: float, acceleration: float) -> None:
    """Unhindered, the return from 63 mm would take 0.17 m/s and 3.6 m/s^2."""
    asked = np.concatenate([np.linspace(0.0, 8.0, 4000), [math.nan]])
    sent, phase = answer(limits(0.079, velocity, acceleration), asked)
    speed = np.diff(0.0079 * sent, prepend=0.0) / DT_S
    returning = np.flatnonzero(phase == 2)
    assert returning.size * DT_S > 2.0
    assert np.abs(speed).max() <= velocity
    assert np.abs(np.diff(speed[returning])).max() / DT_S <= 0.46 * acceleration
    assert sent[-1] == 0.0


def test_what_is_allowed_passes_unchanged() -> None:
    asked = 5.0 * np.sin(2.0 * np.pi * 1.5 * np.arange(4000) * DT_S)
    sent, phase = answer(limits(), asked)
    assert np.array_equal(sent[:4000], asked)
    assert phase[:4000].max() == 0


def excitation_blocks(info: RigInfo) -> Blocks:
    c, dt = len(info.channels), info.dt_s
    nothing = [static(np.zeros(s), dt, "none", (), ()) for s in ((1, c), (3, 2), (1, 3))]
    return Blocks(
        sensor_correction.correction(info.channels, dt),
        *nothing,
        feedback.none(dt),
        no_force(c),
    )


class Scripted:
    """A rig that reports what it is told to."""

    def __init__(self, info: RigInfo, samples: Array) -> None:
        self.info, self.samples, self.commands = info, samples, []

    def open(self) -> None: ...

    def arm(self) -> Array:
        return self.samples[0]

    def exchange(self, command_v: float) -> Array:
        self.commands.append(command_v)
        return self.samples[min(len(self.commands), len(self.samples) - 1)]

    def rest(self) -> None: ...

    def close(self) -> None: ...


def scripted(samples: Array, command: Array, source: int = EXCITATION, **changes: float) -> tuple[Outcome, Scripted]:
    """Play a command against scripted samples (n, c) with the shipped limits, some of them changed."""
    info = rig_info(high_pass_hz=0.0, low_pass_hz=0.0)
    drive = np.zeros((len(command), 3))
    drive[:, 0] = command
    rig = Scripted(info, samples)
    return play(rig, info, excitation_blocks(info), source, drive, limits()._replace(**changes)), rig


def quiet(count: int) -> Array:
    return np.random.default_rng(2).integers(-3, 4, (count, 3)) * 20.0 / 65536.0


def with_sample(index: int, channel: int, value: float) -> Array:
    samples = quiet(6000)
    samples[index, channel] = value
    return samples


SINE = 3.0 * np.sin(2.0 * np.pi * 1.0 * np.arange(6000) * DT_S)
RAMP = np.concatenate([np.linspace(0.0, 10.0, 3000), np.zeros(3000)])
JUMP = np.where(np.arange(6000) < 700, 0.0, 1.0)
BEYOND = np.where(np.arange(6000) < 700, 0.0, 10.001)
CASES = {
    r"displacement .* stroke limit \(0\.05\d* m, limits\.stroke_m is 0\.05\)": (quiet(6000), RAMP, {"stroke_m": 0.05}),
    r"velocity .* its limit \(15\.8 m/s, limits\.velocity_m_s is 1\)": (quiet(6000), JUMP, {}),
    r"measured acceleration .*\(channel channel_2, 46\.09 m/s\^2, limits\.acceleration_m_s2 is 45\)": (
        with_sample(700, 2, 4.7),
        SINE,
        {},
    ),
    r"actuator force .* its limit \(45\d\.?\d* N, limits\.force_n is 445\)": (
        quiet(6000) + np.where(np.arange(6000) < 700, 0.0, 2.2)[:, None],
        SINE,
        {},
    ),
    r"command beyond the converter's range \(10 V, converters\.range_v is 10\)": (
        quiet(6000),
        BEYOND,
        {"velocity_m_s": np.inf, "stroke_m": 1.0},
    ),
    r"not a number \(channel channel_1; check its cable and power\)": (with_sample(700, 1, np.nan), SINE, {}),
    r"not a number \(rths check tells": (quiet(6000), np.where(np.arange(6000) == 700, np.nan, SINE), {}),
    r"saturated \(channel channel_1, 5 V, its range is 4.99; check its cable": (with_sample(700, 1, -5.0), SINE, {}),
}


@pytest.mark.parametrize("reason", CASES)
def test_each_limit_stops_and_says_which_and_when(reason: str) -> None:
    samples, command, changes = CASES[reason]
    outcome, rig = scripted(samples, command, **changes)
    assert re.search(reason, outcome.stopped_by_limit)
    taken_over = round(outcome.stopped_at_s / DT_S)
    if reason.startswith("displacement"):
        # 50 mm less the room to brake from the ramp's speed at 0.45 * 45 m/s^2
        speed = 0.0079 * 10.0 / (2999 * DT_S)
        assert taken_over == math.floor((0.05 - speed**2 / 40.5) / (0.0079 * 10.0 / 2999)) + 1
    else:
        assert taken_over == 700
    assert np.array_equal(outcome.log.command_v[:taken_over], command[:taken_over])
    assert outcome.steps < 6000
    assert outcome.log.command_v[outcome.steps - 1] == 0.0
    assert len(rig.commands) == outcome.steps


def test_the_tracking_error_has_its_limit() -> None:
    info = rig_info(high_pass_hz=0.0, low_pass_hz=0.0)
    drive = np.zeros((3000, 3))
    drive[700:, 0] = 0.9
    rig = Scripted(info, quiet(3000))
    outcome = play(rig, info, excitation_blocks(info), RECORD, drive, limits()._replace(tracking_error=0.8))
    assert outcome.reason == g.TRACKING
    assert ": tracking error beyond its limit (" in outcome.stopped_by_limit
    assert outcome.stopped_at_s == pytest.approx(700 * DT_S)


@pytest.mark.parametrize(("desired_m_s2", "stops"), [(0.031, True), (0.029, False)])
def test_a_stuck_sensor_is_one_that_misses_ten_bits_for_half_a_second(desired_m_s2: float, stops: bool) -> None:
    """Channel 1 keeps its code from sample 100 on; the desired acceleration moves by 10 bits, or not quite."""
    info = rig_info(high_pass_hz=0.0, low_pass_hz=0.0)
    samples, drive = quiet(3000), np.zeros((3000, 3))
    samples[100:, 1] = 1e-3
    drive[300:, 0] = desired_m_s2
    outcome = play(Scripted(info, samples), info, excitation_blocks(info), RECORD, drive, limits())
    assert outcome.stopped_by_limit.startswith("a sensor is stuck (channel channel_1, 0.031 m/s^2, the motion") == stops
    if stops:
        assert outcome.stopped_at_s == pytest.approx((100 + 1000) * DT_S)  # 0.5 s after the code came
    else:
        assert outcome.steps == 3000


def stuck_after(by_desired: float, by_measured: float, lost_every: int = 0) -> int:
    """Return how many steps after channel 2 kept its code the guard calls it stuck, -1 where it does not.

    By the desired motion of the table and by the measured one the floor must move by so much, 0.1 s after that.
    """
    count = 1500
    samples, expected, came = NOISE[:count].copy(), np.zeros((count, 2, 3)), np.ones(count)
    samples[100:, 2] = 1e-3
    expected[300:, 0, 2], expected[300:, 1, 2] = by_desired, by_measured
    if lost_every:
        came[::lost_every], samples[::lost_every, 2] = 0.0, 0.5
    state = fresh_guard(3)
    listening(limits(), state, came, samples, expected)
    if state.flags[1] == g.NONE:
        return -1
    assert state.flags[1] == g.STUCK and state.flags[2] == 2
    return int(state.flags[3]) - 100


@pytest.mark.parametrize(
    ("by_desired", "by_measured", "stops"),
    [(0.031, 0.031, True), (0.029, 0.031, False), (0.031, 0.029, False), (-0.031, 0.031, True)],
)
def test_a_floor_is_stuck_if_it_must_move_by_the_desired_and_by_the_measured_motion(
    by_desired: float, by_measured: float, stops: bool
) -> None:
    assert stuck_after(by_desired, by_measured) == (1000 if stops else -1)


def test_samples_that_never_came_are_not_judged_and_do_not_hide_a_stuck_sensor() -> None:
    """Every tenth sample is lost; what stands in its place changes, is beyond no limit, and belongs to no sensor."""
    assert stuck_after(0.031, 0.031, lost_every=10) == pytest.approx(1000 * 10 / 9, abs=2)


@pytest.mark.parametrize("clipped_v", [4.995, -4.995])
def test_a_clipped_sensor_whose_zero_was_taken_off_is_saturated(clipped_v: float) -> None:
    """Channel 1 shows 0.4 V at rest; at step 700 of the record it shows the end of its range."""
    info = rig_info(high_pass_hz=0.0, low_pass_hz=0.0)
    samples = np.zeros((3000, 3))
    samples[:, 1] = 0.4
    samples[1700, 1] = clipped_v
    outcome = play(
        Scripted(info, samples), info, excitation_blocks(info), EXCITATION, np.zeros((1900, 3)),
        limits(acceleration_m_s2=1e3), still=Stillness(before=1000),
    )  # fmt: skip
    assert outcome.stopped_by_limit.startswith("a sensor is saturated (channel channel_1")
    assert outcome.stopped_at_s == pytest.approx(700 * DT_S)


def test_a_virtual_run_beyond_the_stroke_is_stopped_before_the_end_stop() -> None:
    info = rig_info()
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (0,))
    drive = np.zeros((8000, 3))
    drive[:, 0] = 9.0 * np.sin(2.0 * np.pi * 0.5 * np.arange(8000) * DT_S) * np.arange(8000) / 4000.0
    outcome = play(rig, info, excitation_blocks(info), EXCITATION, drive, limits())
    assert outcome.stopped_by_limit.startswith("displacement")
    assert outcome.rig_fault == ""
    assert np.nanmax(np.abs(outcome.log.true_displacement_m)) < 0.079 * 1.05
    assert np.isnan(outcome.log.command_v[outcome.steps :]).all()


def test_an_end_stop_is_a_fault_of_the_rig_in_both_ways_to_play() -> None:
    info = replace(rig_info(), limits=replace(rig_info().limits, stroke_m=0.01))
    drive = np.zeros((3000, 3))
    drive[:, 0] = 2.0
    outcomes = []
    for wrap in (False, True):
        rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 0.0), (0,))
        played = Wrapped(rig) if wrap else rig
        outcomes.append(play(played, info, excitation_blocks(info), EXCITATION, drive, open_limits(info)))
    assert "end stop" in outcomes[0].rig_fault
    assert "end stop" in outcomes[1].rig_fault
    assert outcomes[0].steps == outcomes[1].steps < 3000
    assert outcomes[0].stopped_by_limit == ""


class Wrapped:
    """A virtual rig that `play` cannot recognise."""

    def __init__(self, rig: VirtualRig) -> None:
        self.info, self.open, self.arm, self.exchange, self.rest, self.close = (
            rig.info, rig.open, rig.arm, rig.exchange, rig.rest, rig.close,
        )  # fmt: skip


def test_a_run_of_the_best_method_passes_the_shipped_guard() -> None:
    info = rig_info()
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (0,))
    outcome = play(rig, info, best_like(info), RECORD, 0.3 * ground(6000), limits())
    assert outcome.stopped_by_limit == ""
    assert outcome.steps == 6000


@entry
def watch(
    limits: GuardLimits, state: GuardState, errors: Array, motion: Array, force: Array, of_accel: bool
) -> int:  # fmt: skip
    """Return the step at which tracking errors (n, i) stop the test, or -1; interface motion (3, i) and force (i,)."""
    for k in range(errors.shape[0]):
        if check_energy(limits, state, errors[k], motion, force, of_accel) != 0:
            return k
    return -1


def moving(*velocities_m_s: float) -> Array:
    """Return an interface motion (3, i) of constant velocities."""
    return np.outer([0.0, 1.0, 0.0], velocities_m_s)


@pytest.mark.parametrize(("ratio", "shear"), [(0.1, 10.0), (0.4, 10.0), (0.1, -10.0)])
def test_energy_that_errors_add_is_the_integral_of_force_and_error_of_velocity(ratio: float, shear: float) -> None:
    """An error of 0.2 m/s^2 becomes a velocity w(t) = 0.2 (1 - exp(-a t)) / a: f w is added, |f v| exchanged."""
    lim = limits()._replace(energy_ratio=ratio, energy_floor_j=0.05)
    step = watch(lim, fresh_guard(3), np.full((20000, 1), 0.2), moving(0.1), np.array([shear]), True)
    if shear < 0.0:  # the error takes energy away
        assert step == -1
        return
    rate = 2.0 * math.pi * FORGET_HZ

    def less(t: float) -> float:
        added = shear * 0.2 / rate * (t - (1.0 - math.exp(-rate * t)) / rate)
        return added - ratio * (abs(shear) * 0.1 * t + 0.05)

    assert step * DT_S == pytest.approx(brentq(less, 1e-3, 10.0), rel=2e-3, abs=1.5 * DT_S)


@pytest.mark.parametrize("of_accel", [True, False])
def test_the_energy_of_several_degrees_of_freedom_is_their_sum(of_accel: bool) -> None:
    """One adds what the other takes away, unless it pushes the other way; each alone is as a run of its own."""
    lim = limits()._replace(energy_ratio=0.1, energy_floor_j=0.05)
    ramp = np.linspace(0.0, 0.4, 8000)[:, None]
    alone = watch(lim, fresh_guard(3), ramp, moving(0.1), np.array([10.0]), of_accel)
    assert alone > 0

    def both(second_n: float, second_m_s: float) -> int:
        state, force = fresh_guard(3, axes=2), np.array([10.0, second_n])
        return watch(lim, state, np.hstack([ramp, ramp]), moving(0.1, second_m_s), force, of_accel)

    assert both(0.0, 0.1) == alone
    assert both(-10.0, 0.1) == -1
    assert 0 < both(10.0, 0.0) < alone


def test_an_error_of_displacement_is_an_error_of_velocity_by_its_change() -> None:
    """A displacement that lags by 0.02 t adds f 0.02 t; f 0.1 t is exchanged: 0.2 t < 0.1 (1 t + 0.05) until 0.05 s."""
    lim = limits()._replace(energy_ratio=0.1, energy_floor_j=0.05)
    lag = 1.0 + 0.02 * DT_S * np.arange(2000)[:, None]  # an offset adds nothing
    state = fresh_guard(3)
    state.slip[1] = 1.0
    step = watch(lim, state, lag, moving(0.1), np.array([10.0]), False)
    assert step == pytest.approx(0.05 / DT_S, abs=2)


@pytest.mark.parametrize("axis", [0, 1])
def test_every_degree_of_freedom_has_its_tracking_error_watched(axis: int) -> None:
    lim, errors = limits()._replace(tracking_error=3.0), np.zeros(2)
    errors[axis] = 3.5
    state = fresh_guard(3, axes=2)
    assert judged(lim, state, errors) == g.TRACKING and state.seen[0] == 3.5
    errors[axis] = math.nan
    assert judged(lim, state, errors) == g.NOT_A_NUMBER
    assert judged(lim, state, np.array([2.9, -2.9])) == g.NONE


@entry
def judged(limits: GuardLimits, state: GuardState, errors: Array) -> int:
    """Return what the guard says of tracking errors (i,)."""
    return check_errors(limits, state, errors)


def test_a_fast_command_stops_by_its_rate_before_its_velocity() -> None:
    slow = limits()._replace(command_rate_v_s=50.0)
    assert answer(slow, 49.0 * DT_S * np.arange(100))[1][99] == 0
    sent, phase = answer(slow, 51.0 * DT_S * np.arange(100))
    assert phase[1] != 0
    assert np.abs(np.diff(sent)).max() <= 50.0 * DT_S * (1.0 + 1e-9)


@pytest.mark.parametrize("limit", ["reach_m", "deviation_m"])
def test_a_command_stops_where_the_run_at_hand_needs_no_more(limit: str) -> None:
    """A ramp of 79 mm/s beside a desired displacement of zero."""
    own = limits()._replace(**{limit: 5e-3})
    ramp = 10.0 * DT_S * np.arange(300)
    assert 0.0079 * ramp[-1] > 5e-3
    sent, phase = answer(own, ramp)
    first = int(np.flatnonzero(phase)[0])
    room_m = 0.079**2 / 40.5 if limit == "reach_m" else 0.0
    assert 0.0079 * ramp[first] == pytest.approx(5e-3 - room_m, abs=1.01 * 0.0079 * 10.0 * DT_S)
    assert 0.0079 * np.abs(sent).max() <= 5e-3 + 0.079**2 / 40.5
    assert answer(own, 0.9 * ramp[:first])[1][first - 1] == 0


def test_a_channel_stops_at_its_own_level() -> None:
    lim = limits()._replace(abort=np.array([45.0, 45.0, 0.5]))
    samples = NOISE[:10].copy()
    samples[5, 1] = 0.06  # V: 0.59 m/s^2 on a channel that may
    assert answer(lim, np.zeros(10), samples)[1][9] == 0
    samples[5, 2] = 0.06
    assert answer(lim, np.zeros(10), samples)[1][5] != 0


def test_a_reason_names_what_was_seen_its_limit_and_key_and_what_to_do() -> None:
    """Those that only a loop in real time, or a rig file's own levels, can give."""
    info = rig_info(limits=Limits(0.079, 1.0, 45.0, 445.0, tracking_error_m_s2=3.0))
    info = replace(info, channels=(info.channels[0], replace(info.channels[1], abort=20.0), info.channels[2]))
    lim = limits()._replace(
        tracking_error=3.0, command_rate_v_s=100.0, energy_ratio=0.1, abort=np.array([45.0, 20.0, 45.0])
    )

    def told(reason: int, seen: float = np.nan, channel: int = -1, source: int = RECORD, about: RigInfo = info) -> str:
        state = fresh_guard(3)
        state.flags[1:3], state.seen[0] = (reason, channel), seen
        return reason_of(about, lim, state, source)

    assert told(g.NONE) == told(g.END) == ""
    assert told(g.VELOCITY, 1.2).endswith("(1.2 m/s, limits.velocity_m_s is 1; lower scaling)")
    assert told(g.VELOCITY, 1.2, source=EXCITATION).endswith("(1.2 m/s, limits.velocity_m_s is 1)")
    assert told(g.ACCELERATION, 21.0, 1).endswith("(channel channel_1, 21 m/s^2, its abort_m_s2 is 20; lower scaling)")
    assert told(g.RATE, 120.0).endswith("(120 V/s, limits.command_rate_v_s is 100; lower scaling)")
    assert "(3.5 m/s^2, limits.tracking_error_m_s2 is 3; identify the rig anew" in told(g.TRACKING, 3.5)
    assert "(0.25, limits.energy_ratio is 0.1; identify the rig anew" in told(g.ENERGY, 0.25)
    said = told(g.LOST, 6.0)
    assert "(6, limits.lost_samples is 5; check target (one on this computer stalls with it) and cable, lower" in said
    assert said.endswith("or raise limits.lost_samples of the rig)")
    assert "(9, limits.lost_samples is 5; end other programs, lower sample_rate_hz" in told(g.OVERRUN, 9.0)
    assert "(1, overrun is stop; end other programs, lower sample_rate_hz" in told(
        g.OVERRUN, 1.0, about=replace(info, overrun="stop")
    )
    assert told(g.OPERATOR) == "stopped by the operator"
    lim = lim._replace(reach_m=0.0134, deviation_m=0.01, tracking_error=0.5, abort=np.full(3, 2.0))
    assert "(0.014 m, the limit by the planned motion is 0.0134; rths check tells" in told(g.PLANNED_REACH, 0.014)
    assert "(0.012 m, the limit by the planned motion is 0.01; rths check tells" in told(g.DEVIATION, 0.012)
    assert "(0.6 m/s^2, the limit by the planned motion is 0.5; identify" in told(g.TRACKING, 0.6)
    assert "2.1 m/s^2, the limit by the planned motion is 2; lower" in told(g.ACCELERATION, 2.1, 1)
    short = reason_of(info, lim._replace(command_v=5.0), _at(g.STROKE, 0.04), EXCITATION)
    assert short.endswith("(0.04 m, converters.range_v by nominal.gain_m_per_v is 0.0395)")


def _at(reason: int, seen: float) -> GuardState:
    state = fresh_guard(3)
    state.flags[1:3], state.seen[0] = (reason, -1), seen
    return state
