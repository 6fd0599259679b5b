"""The way that is told: as wanted where it may be, nowhere beyond a limit, and at rest at its end."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bench import rig_info
from hybrid import open_limits
from hypothesis import given, settings
from hypothesis import strategies as st
from portfolio import parametrize_first
from smooth_way import smooth_way

from rths_cli.loop import fallback_commands
from rths_cli.loop.fallback_commands import OFF_V, RATE, STEP_V, Foresight, fresh_drift, no_foresight
from rths_cli.loop.guard import GuardLimits
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp.late_command_trajectory import Way, fresh_way

GAIN_M_PER_V, DT_S, HARDEST_M_S2, SPACING, POINTS = 0.0079, 1e-3, 0.45 * 45.0, 8, 14
STROKE_M, END = 0.03, SPACING * POINTS


@entry
def laid(way: Way, f: Foresight, limits: GuardLimits, drift: Array) -> None:
    way, f, limits, drift = borrowed((way, f, limits, drift))
    fallback_commands.lay_way(way, f, limits, drift)


def limits_of(**other: float) -> GuardLimits:
    usual = {"velocity_m_s": 1.0, "gain_m_per_v": GAIN_M_PER_V, "dt_s": DT_S, "stroke_m": STROKE_M, "command_v": 10.0}
    return open_limits(rig_info())._replace(**{**usual, "acceleration_m_s2": 45.0, **other})


def path(
    wanted: Array, limits: GuardLimits, start_v: float = 0.0, step_v: float = 0.0, drift: Array | None = None
) -> Array:
    """Return where a rig goes, in m, that stands at `start_v` after a step and whose points are wanted to be there."""
    f = no_foresight(3)._replace(points=POINTS, spacing=SPACING, made=np.append(wanted, np.zeros(2)))
    way, drift = fresh_way(), fresh_drift() if drift is None else drift
    way.volts[0], drift[STEP_V] = start_v, step_v
    laid(way, f, limits, drift)
    return GAIN_M_PER_V * smooth_way(way.volts, SPACING, END + 30)


def straight(velocity_m_s: float) -> Array:
    return velocity_m_s / GAIN_M_PER_V * DT_S * SPACING * np.arange(1.0, POINTS + 1)


def test_what_may_be_is_laid_as_wanted() -> None:
    t = DT_S * SPACING * np.arange(POINTS + 1)
    wave = 0.004 * np.sin(12.0 * t) / GAIN_M_PER_V
    assert path(wave[1:], limits_of())[: END - SPACING] == pytest.approx(
        GAIN_M_PER_V * smooth_way(wave, SPACING, END - SPACING), abs=1e-12
    )


@parametrize_first(
    2,
    "other",
    [{}, {"velocity_m_s": 0.2}, {"command_rate_v_s": 30.0}, {"acceleration_m_s2": 5.0}, {"acceleration_m_s2": 400.0}],
)
def test_no_place_and_no_step_on_the_way_is_beyond_a_limit(other: dict[str, float]) -> None:
    """Whatever is wanted: 500 ways to random points, as far apart as the range is wide, or all in one place."""
    limits, random = limits_of(**other), np.random.default_rng(3)
    fastest = min(limits.velocity_m_s, GAIN_M_PER_V * limits.command_rate_v_s)
    for _ in range(500):
        wanted = random.uniform(-12.0, 12.0, POINTS if random.random() < 0.5 else 1) * np.ones(POINTS)
        went = path(
            wanted, limits, random.uniform(-3.7, 3.7), random.uniform(-1.0, 1.0) * fastest / GAIN_M_PER_V * DT_S
        )
        assert np.abs(np.diff(went)).max() / DT_S <= fastest * (1.0 + 1e-9)
        assert np.abs(went).max() <= STROKE_M * (1.0 + 1e-12)


def any_volts() -> st.SearchStrategy[float]:
    return st.one_of(st.floats(-12.0, 12.0), st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e300]))


@pytest.mark.campaign
@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    wanted=st.lists(any_volts(), min_size=POINTS, max_size=POINTS),
    start=st.floats(-1.0, 1.0),
    step=st.floats(-1.0, 1.0),
    off=st.floats(-2.0, 2.0),
    velocity=st.floats(0.05, 2.0),
    acceleration=st.floats(1.0, 400.0),
    rate_v_s=st.one_of(st.just(math.inf), st.floats(5.0, 500.0)),
)
def test_from_every_state_the_way_is_finite_within_all_limits_and_begins_as_the_command_moves(
    wanted: list[float], start: float, step: float, off: float, velocity: float, acceleration: float, rate_v_s: float
) -> None:
    """From every place up to where the curve may still turn (`start`, a share of that), after every step within the
    limits (`step`)."""
    limits = limits_of(velocity_m_s=velocity, acceleration_m_s2=acceleration, command_rate_v_s=rate_v_s)
    fastest = min(velocity, GAIN_M_PER_V * rate_v_s)
    outermost, steepest = STROKE_M / GAIN_M_PER_V, fastest * DT_S / GAIN_M_PER_V
    corner = fallback_commands.CORNER * fallback_commands.CHANGE * SPACING * steepest
    drift = fresh_drift()
    drift[OFF_V], drift[RATE] = off, 0.1
    went = path(np.array(wanted), limits, start * (outermost - corner), step * steepest, drift)
    assert np.isfinite(went).all()
    assert np.abs(np.diff(went)).max() <= fastest * DT_S * (1.0 + 1e-9)
    assert np.abs(went).max() <= STROKE_M * (1.0 + 1e-12)
    first = (went[SPACING] - went[0]) / (SPACING * DT_S) - np.clip(
        step, -fallback_commands.LINE, fallback_commands.LINE
    ) * fastest
    slows_down = 0.45 * acceleration * SPACING * DT_S
    room = STROKE_M - abs(went[0]) > fastest**2 / (0.9 * acceleration) + 4.0 * fastest * SPACING * DT_S
    assert abs(first) <= slows_down * (1.0 + 1e-9) or not room  # at the end of the stroke it must turn faster


@pytest.mark.parametrize("towards", [1.0, -1.0])
@pytest.mark.parametrize("velocity_m_s", [0.05, 0.2, 0.45, 0.6, 0.8])
def test_it_goes_as_fast_as_wanted_and_comes_to_rest_about_as_hard_as_the_guard_brakes(
    velocity_m_s: float, towards: float
) -> None:
    step = towards * velocity_m_s / GAIN_M_PER_V * DT_S  # it moves like that already
    went = towards * path(towards * straight(velocity_m_s), limits_of(stroke_m=0.079), 0.0, step)
    assert np.diff(went)[:SPACING] == pytest.approx(velocity_m_s * DT_S, rel=1e-6)  # it does not brake before it must
    assert np.abs(np.diff(went, 2)).max() / DT_S**2 <= 1.5 * HARDEST_M_S2
    assert (went[END:] == went[-1]).all()


def test_a_rig_too_fast_to_stop_in_time_brakes_evenly() -> None:
    """0.4 m/s, and a guard that brakes with 2.25 m/s^2: 0.178 s, of which 0.112 are told."""
    limits = limits_of(acceleration_m_s2=5.0, stroke_m=0.079)
    went = path(straight(0.4), limits, 0.0, 0.4 * DT_S / GAIN_M_PER_V)
    assert np.diff(went)[0] == pytest.approx(0.4 * DT_S, rel=0.05)
    assert np.abs(np.diff(went, 2)).max() / DT_S**2 <= 1.6 * 0.4 / 0.112
    assert (went[END:] == went[-1]).all()


@pytest.mark.parametrize("velocity_m_s", [0.2, 0.5])
def test_it_slows_down_before_the_end_of_the_stroke(velocity_m_s: float) -> None:
    """From where the guard would still let it go on: the way to brake, and 2 mm."""
    limits = limits_of()
    start = STROKE_M - 0.002 - velocity_m_s**2 / (2.0 * HARDEST_M_S2)
    step = velocity_m_s / GAIN_M_PER_V * DT_S
    went = path(start / GAIN_M_PER_V + straight(velocity_m_s), limits, start / GAIN_M_PER_V, step)
    assert STROKE_M - 5e-4 < went.max() <= STROKE_M
    assert np.abs(np.diff(went, 2)).max() / DT_S**2 <= 1.6 * HARDEST_M_S2


def test_where_the_rig_is_off_the_way_back_is_told() -> None:
    drift = fresh_drift()
    drift[OFF_V], drift[RATE] = 0.02, 0.1
    went = path(np.zeros(POINTS), limits_of(), 0.02, 0.0, drift)
    t = 0.1 * SPACING * np.arange(POINTS)
    assert went[:END:SPACING] == pytest.approx(GAIN_M_PER_V * 0.02 * (1.0 + t) * np.exp(-t), rel=1e-9)
