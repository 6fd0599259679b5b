"""How commands come back to what is computed, from where the rig went on to while none left."""

from __future__ import annotations

import numpy as np
import pytest
from bench import rig_info
from hybrid import open_limits

from rths_cli.loop import fallback_commands
from rths_cli.loop.fallback_commands import OFF_V, RATE, STANDS_V, WANTED_V, fresh_drift
from rths_cli.loop.guard import GuardLimits
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array

GAIN_M_PER_V, DT_S, BIT_V = 0.0079, 1e-3, 20.0 / 2**16
HARDEST_M_S2 = 0.45 * 45.0  # the guard's braking


def limits_of(**other: float) -> GuardLimits:
    usual = {"velocity_m_s": 1.0, "gain_m_per_v": GAIN_M_PER_V, "dt_s": DT_S, "stroke_m": 0.079, "command_v": 10.0}
    return open_limits(rig_info())._replace(**{**usual, "acceleration_m_s2": 45.0, **other})


@entry
def gone(drift: Array, limits: GuardLimits, stands: float) -> None:
    drift, limits = borrowed((drift, limits))
    fallback_commands.drift_to(drift, limits, stands)


@entry
def came(drift: Array, limits: GuardLimits, bit_v: float, commands: Array, left: Array) -> None:
    drift, limits, commands, left = borrowed((drift, limits, commands, left))
    for k in range(commands.size):
        left[k] = fallback_commands.rejoin(drift, limits, bit_v, commands[k])


@entry
def off(drift: Array, intervals: float) -> float:
    return fallback_commands.off_after(drift, intervals)


def apart(wanted: Array, stood: Array, limits: GuardLimits) -> Array:
    """Return the drift of a rig that stood there in intervals in which these commands would have left."""
    drift = fresh_drift()
    for command, place in zip(wanted, stood, strict=True):
        drift[WANTED_V] = command
        gone(drift, limits, place)
    return drift


def left_of(drift: Array, limits: GuardLimits, commands: Array, bit_v: float = 0.0) -> Array:
    left = np.zeros(len(commands))
    came(drift, limits, bit_v, commands, left)
    return left


def test_without_a_stall_what_is_computed_leaves() -> None:
    commands = np.random.default_rng(1).uniform(-0.05, 0.05, 500)
    assert (left_of(fresh_drift(), limits_of(), commands) == commands).all()


@pytest.mark.parametrize("metres", [1e-5, 1e-4, 1e-3, 0.01, 0.04])
def test_a_table_that_stood_still_comes_back_no_harder_than_the_guard_brakes(metres: float) -> None:
    """From rest, at rest: monotone, at most 1.5 e-fold slower than the time sqrt(x / a) and 4 ms allow."""
    volts, limits = metres / GAIN_M_PER_V, limits_of()
    left = left_of(apart(np.zeros(2), np.full(2, volts), limits), limits, np.zeros(2000))
    path = GAIN_M_PER_V * np.concatenate([[volts] * 2, left])
    assert np.abs(np.diff(path, 2)).max() / DT_S**2 <= HARDEST_M_S2
    assert (np.diff(path) <= 0.0).all() and path[-1] == 0.0
    fastest = max(4e-3, np.sqrt(2.0 * metres / HARDEST_M_S2))
    assert path[2 + int(5.0 * fastest / DT_S)] < 0.05 * metres


@pytest.mark.parametrize("held", [10, 40])
def test_a_table_that_held_while_the_building_moved_on_is_caught_up_with_smoothly(held: int) -> None:
    """Commands move on at 0.2 m/s; the one that comes back must first be as fast as they are."""
    limits, step = limits_of(), 0.2 * DT_S / GAIN_M_PER_V
    drift = apart(step * np.arange(1.0, held + 1), np.zeros(held), limits)
    commands = step * np.arange(held + 1.0, 390.0)
    path = GAIN_M_PER_V * np.concatenate([[0.0, 0.0], left_of(drift, limits, commands)])
    assert np.abs(np.diff(path, 2)).max() / DT_S**2 <= HARDEST_M_S2
    assert np.abs(np.diff(path)).max() / DT_S < 0.6
    assert path[-1] == pytest.approx(GAIN_M_PER_V * commands[-1], abs=1e-4)


@pytest.mark.parametrize("towards", [1.0, -1.0])
@pytest.mark.parametrize(
    ("other", "steepest_m_s"),
    [({"velocity_m_s": 0.15}, 0.15), ({"command_rate_v_s": 12.0}, 12.0 * GAIN_M_PER_V), ({}, 1.0)],
)
def test_no_step_and_no_place_is_beyond_a_limit(towards: float, other: dict[str, float], steepest_m_s: float) -> None:
    limits, random = limits_of(stroke_m=0.02, **other), np.random.default_rng(2)
    for _ in range(50):
        place, wanted = towards * random.uniform(1.5, 0.02 / GAIN_M_PER_V), towards * random.uniform(2.0, 3.0)
        drift = apart(np.full(3, -place), np.full(3, place), limits)
        left = left_of(drift, limits, np.full(300, wanted))
        path = np.concatenate([[place], left])
        assert np.abs(np.diff(path)).max() * GAIN_M_PER_V / DT_S <= steepest_m_s * (1.0 + 1e-12)
        assert np.abs(path).max() * GAIN_M_PER_V <= 0.02 * (1.0 + 1e-12)


def test_what_leaves_is_on_the_bits_of_the_converter() -> None:
    limits = limits_of()
    commands = BIT_V * np.round(np.sin(0.01 * np.arange(500)) / BIT_V)
    left = left_of(apart(np.zeros(3), np.array([0.1, 0.11, 0.12]), limits), limits, commands, BIT_V)
    assert (left / BIT_V) == pytest.approx(np.round(left / BIT_V), abs=1e-9)
    assert np.abs(left - commands)[:3].min() > 0.1 and (left[300:] == commands[300:]).all()


def test_what_is_told_of_the_return_is_what_leaves_later() -> None:
    limits = limits_of()
    drift = apart(np.zeros(4), np.array([0.1, 0.105, 0.11, 0.115]), limits)
    left_of(drift, limits, np.zeros(1))
    told = [off(drift, float(n)) for n in range(1, 30)]
    assert left_of(drift, limits, np.zeros(29)) == pytest.approx(told, rel=1e-12, abs=1e-15)
    assert 0.0 < drift[OFF_V] < 0.115 and 0.0 < drift[RATE] <= 0.25


@pytest.mark.parametrize("dt_s", [1e-3, 2.5e-4])
def test_a_bit_of_rounding_is_not_taken_for_a_velocity(dt_s: float) -> None:
    """A command rounded up by half a bit leaves; an interval later the rig stands where it should, and so on."""
    limits, drift = limits_of(dt_s=dt_s), fresh_drift()
    drift[WANTED_V] = 99.5 * BIT_V
    assert left_of(drift, limits, np.array([100.0 * BIT_V]), BIT_V) == 100.0 * BIT_V
    drift[WANTED_V] = 100.5 * BIT_V
    gone(drift, limits, 101.0 * BIT_V)
    left = left_of(drift, limits, 102.0 * BIT_V * np.ones(60), BIT_V)
    assert np.abs(left / BIT_V - 102.0).max() <= 1.001


@pytest.mark.parametrize("towards", [1.0, -1.0])
def test_a_rig_is_not_believed_to_be_beyond_its_stroke(towards: float) -> None:
    drift, limits = fresh_drift(), limits_of(stroke_m=5.0 * GAIN_M_PER_V)
    gone(drift, limits, towards * 5.1)
    assert drift[STANDS_V] == pytest.approx(towards * 5.0)
