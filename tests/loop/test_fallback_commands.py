"""What is told of the commands to come: against a step that gets no samples, and within every limit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits
from test_realtime_loop import Wired, conducted

from rths_cli.loop import fallback_commands, guard, realtime_run
from rths_cli.loop.fallback_commands import Foresight, foresight_of
from rths_cli.loop.guard import GuardLimits, GuardState
from rths_cli.loop.realtime_run import Performance
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import EXCITATION, NUMERICAL, RECORD, Step
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array

UNTIL, POINTS, SPACING_S = 900, 14, 8e-3


@entry
def foreseen(f: Foresight, s: Step, drive: Array, k: int, last: int) -> None:
    f, s, drive = borrowed((f, s, drive))
    fallback_commands.foresee(f, s, drive, k, last, 1.0)


@entry
def foreseen_in_ramp(f: Foresight, s: Step, drive: Array, k: int, last: int, share: float) -> None:
    f, s, drive = borrowed((f, s, drive))
    fallback_commands.foresee(f, s, drive, k, last, share)


@entry
def foreseen_to_rest(f: Foresight, limits: GuardLimits, g: GuardState) -> None:
    f, limits, g = borrowed((f, limits, g))
    fallback_commands.foresee_rest(f, limits, g)


def played(dt_s: float, source: int, drive: Array) -> Performance:
    """Return a run with samples up to step UNTIL."""
    rig = Wired()
    rig.info = replace(rig.info, dt_s=dt_s)
    blocks = replace(best_like(rig_info(dt_s=dt_s)), shaping_step_v=rig.info.converters.step_v)
    run = realtime_run.prepare(rig_info(dt_s=dt_s), blocks, source, drive, open_limits(rig.info), ramp_s=0.0)
    samples = rig.arm().copy()
    for k in range(UNTIL):
        told = (run.course, run.step, run.limits, run.guard, run.drive, run.log, samples, 0, k)
        samples = rig.exchange(conducted(*told)).copy()
    foresight_here = foresight_of(blocks, source, dt_s)
    return replace(run, course=run.course._replace(foresight=foresight_here))


def go_on_without_samples(run: Performance, steps: int) -> Array:
    """Return the commands (steps,) of the steps after UNTIL, none of which gets samples."""
    for k in range(UNTIL, UNTIL + steps):
        nothing = np.full(3, 9.0)
        conducted(run.course, run.step, run.limits, run.guard, run.drive, run.log, nothing, 1, k)
    return signals(run.log, sizes_of(run.step)).command_v[UNTIL : UNTIL + steps]


def wave(count: int, dt_s: float, source: int) -> Array:
    """Return a drive (n, 3) of sines: acceleration, velocity and displacement, or a command in the first column."""
    if source == EXCITATION:
        return np.outer(np.random.default_rng(5).uniform(-0.3, 0.3, count), [1.0, 0.0, 0.0])
    omega, amplitude = 2.0 * np.pi * np.array([[1.0], [4.0], [9.0]]), np.array([[1.0], [2.0], [0.5]])
    phase = omega * dt_s * np.arange(count) + np.array([[0.0], [1.0], [2.0]])
    parts = np.sin(phase), -np.cos(phase) / omega, -np.sin(phase) / omega**2
    drive = np.column_stack([np.sum(amplitude * each, axis=0) for each in parts])
    return np.asarray(drive * np.minimum(np.arange(count) * dt_s, 1.0)[:, None])


@pytest.mark.campaign
@pytest.mark.parametrize("source", [NUMERICAL, RECORD, EXCITATION])
@pytest.mark.parametrize("dt_s", [2e-3, 1e-3, 2.5e-4])
def test_the_points_are_what_the_step_commands_without_samples(dt_s: float, source: int) -> None:
    """To a bit and a half, of which one is rounding; a command that stood still would be off by a hundred."""
    drive = wave(2000, dt_s, source)
    run = played(dt_s, source, drive)
    f, before = run.course.foresight, signals(run.log, sizes_of(run.step)).command_v[UNTIL - 1]
    assert f.points == POINTS and f.spacing == max(round(SPACING_S / dt_s), 1)
    foreseen(f, run.step, run.drive, UNTIL, len(drive) - 1)
    commands = go_on_without_samples(run, f.points * f.spacing)[f.spacing - 1 :: f.spacing]
    assert np.abs(f.made[:POINTS] - commands).max() < 1.5 * run.info.converters.step_v
    assert np.abs(commands - before).max() > 100 * run.info.converters.step_v


@pytest.mark.campaign
def test_the_drive_stands_still_after_the_last_row_of_the_record() -> None:
    drive = wave(2000, 1e-3, EXCITATION)
    run = played(1e-3, EXCITATION, drive)
    foreseen(run.course.foresight, run.step, run.drive, UNTIL, UNTIL + 20)
    assert run.course.foresight.made[:POINTS] == pytest.approx(
        drive[np.minimum(UNTIL - 1 + 8 * np.arange(1, 15), UNTIL + 20), 0], abs=1e-15
    )


@pytest.mark.campaign
def test_a_run_goes_on_alike_from_a_copy_of_its_flat_state() -> None:
    """Whatever a step remembers is in that array: nothing of the first continuation reaches the second."""
    run = played(2e-3, NUMERICAL, wave(2000, 2e-3, NUMERICAL))
    state, marks = run.step.state.copy(), run.course.drift.copy()
    once = go_on_without_samples(run, 100)
    run.step.state[:], run.course.drift[:] = state, marks
    again = go_on_without_samples(run, 100)
    assert (once == again).all() and np.ptp(once) > 1e-3


@pytest.mark.campaign
def test_in_the_ramp_a_share_of_it_is_foreseen() -> None:
    drive = wave(2000, 2e-3, EXCITATION)
    run = played(2e-3, EXCITATION, drive)
    foreseen(run.course.foresight, run.step, run.drive, UNTIL, 1999)
    whole = run.course.foresight.made[:POINTS].copy()
    foreseen_in_ramp(run.course.foresight, run.step, run.drive, UNTIL, 1999, 0.25)
    assert run.course.foresight.made[:POINTS] == pytest.approx(0.25 * whole) and np.abs(whole).max() > 0.1


@pytest.mark.campaign
def test_while_the_test_ends_the_way_of_the_guard_is_foreseen() -> None:
    run = played(1e-3, NUMERICAL, wave(2000, 1e-3, NUMERICAL))
    run = replace(run, limits=run.limits._replace(acceleration_m_s2=45.0, stroke_m=0.079))
    run.guard.flags[:2], run.guard.motion[:] = (guard.BRAKING, guard.OPERATOR), (0.004, 0.15)
    foreseen_to_rest(run.course.foresight, run.limits, run.guard)
    made = run.course.foresight.made[:POINTS].copy()
    assert tuple(run.guard.motion) == (0.004, 0.15) and run.guard.flags[0] == guard.BRAKING
    commands = go_on_without_samples(run, 112)[7::8]
    assert made == pytest.approx(commands, rel=1e-12)
    assert commands[0] > 0.004 / run.limits.gain_m_per_v and run.guard.flags[0] == guard.RETURNING
