"""The compiled step against the step in plain numpy: the same samples in, the same signals and commands out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bare_rig import BareRig
from bench import DT_S, LINEAR, ideal_info, rig_info, specimen
from hybrid import best_like, ground, open_limits, paper_like, reacting
from portfolio import parametrize_first

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.loop.reference_step import ReferenceStep
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL, RECORD
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

Make = Callable[..., Blocks]


def played(info: RigInfo, blocks: Blocks, drive: Array, source: int, interface_mass_kg: float) -> tuple[Outcome, Array]:
    """Return a run by the compiled step, and the samples (n, c) that it was given."""
    plant = build_plant(info, LINEAR, specimen(), 0.0, interface_mass_kg=interface_mass_kg)
    rig = BareRig(VirtualRig(info, plant, (0,)))
    outcome = play(rig, info, blocks, source, drive, open_limits(info))
    assert outcome.steps == len(drive) and outcome.stopped_by_limit == ""
    return outcome, np.array(rig.samples[: len(drive)])


def nothing(motion: Array) -> Array:
    return np.zeros(1)


def by_reference(
    blocks: Blocks, samples: Array, drive: Array, numerical: bool, added: Callable[[Array], Array] = nothing
) -> dict[str, Array]:
    """Return what the reference step makes of samples (n, c) and a source (n, 3), as a run's log names it; `added`
    gives a command (1,) that is added to it for the desired motion (3, 1)."""
    step, rows = ReferenceStep(blocks), []
    for now, source in zip(samples, drive, strict=True):
        command = step(now, source, numerical)
        command = command + added(step.interface)
        step.note_sent(command)
        rows.append((*command, *step.force_n, *step.corrected, *step.interface.ravel(), *step.estimated))
    columns, axes = np.array(rows).T, step.force_n.size
    ends = np.cumsum([command.size, axes, len(step.corrected), 3 * axes])
    names = ("command_v", "base_shear_n", "corrected", "desired", "estimated")
    return dict(zip(names, np.split(columns, ends), strict=True))


def difference(outcome: Outcome, wanted: dict[str, Array]) -> float:
    """Return the largest difference of any signal from the reference, relative to the signal's peak."""
    pairs = [(np.atleast_2d(getattr(outcome.log, name)), expected) for name, expected in wanted.items()]
    assert all(found.shape == expected.shape for found, expected in pairs)
    peaks = [np.maximum(np.abs(expected).max(axis=1), 1e-6) for _, expected in pairs]
    rows = [np.abs(found - expected).max(axis=1) / peak for (found, expected), peak in zip(pairs, peaks, strict=True)]
    return float(np.concatenate(rows).max())


@parametrize_first(2, "latency", [0, 1, 2])
@parametrize_first(2, "interface_mass", [0.0, 1.2])
@parametrize_first(2, "make", [paper_like, best_like, reacting])
def test_linear_blocks_give_the_same_to_a_few_roundings(make: Make, interface_mass: float, latency: int) -> None:
    info, drive = ideal_info(latency_samples=latency), ground(2000)
    blocks = make(info, interface_mass)
    outcome, samples = played(info, blocks, drive, NUMERICAL, interface_mass)
    assert difference(outcome, by_reference(blocks, samples, drive, numerical=True)) <= 1e-12
    assert np.abs(outcome.log.command_v).max() > 0.01


@pytest.mark.campaign
def test_the_computed_storeys_may_be_many() -> None:
    """Their modes are exact to a rounding of A, which adds up from step to step."""
    info, drive = ideal_info(), ground(6000)
    blocks = best_like(info, 1.2, numerical_storeys=8)
    outcome, samples = played(info, blocks, drive, NUMERICAL, 1.2)
    assert difference(outcome, by_reference(blocks, samples, drive, numerical=True)) <= 1e-11


def test_friction_is_countered_at_the_velocity_to_come() -> None:
    """On a table without friction: the command for it, and what it moves, are in every signal."""
    info, drive = ideal_info(), ground(2000)
    blocks = best_like(info, 1.2)
    kappa, scale, slope, lead = 0.02, 0.004, 25.0, 0.003
    counters = FrictionFeedforward(blocks.feedforward.linearised(), kappa, scale, slope, lead, left=0.0)

    def added(motion: Array) -> Array:
        coming = motion[1] + lead * motion[0]
        return np.asarray(kappa * (np.tanh(coming / scale) - slope * coming))

    outcome, samples = played(info, replace(blocks, feedforward=counters), drive, NUMERICAL, 1.2)
    assert difference(outcome, by_reference(blocks, samples, drive, numerical=True, added=added)) <= 1e-12
    np.testing.assert_allclose(counters.added_v(outcome.log.desired), added(outcome.log.desired), rtol=1e-12)
    velocity, accel = np.abs(outcome.log.desired[1]), np.abs(outcome.log.desired[0])
    assert velocity.min() < 0.2 * scale and velocity.max() > 2.0 * scale and lead * accel.max() > 0.1 * scale


def test_a_table_that_follows_a_record_has_the_same_command() -> None:
    info, drive = ideal_info(), 0.3 * ground(6000)
    blocks = best_like(info)
    outcome, samples = played(info, blocks, drive, RECORD, 0.0)
    assert difference(outcome, by_reference(blocks, samples, drive, numerical=False)) <= 1e-12


@pytest.mark.campaign
def test_a_limited_feedback_is_told_the_same() -> None:
    """A shaking that pushes it to both limits and back in every period."""
    info, rate, time_s = ideal_info(), 2.0 * np.pi * 4.0, DT_S * np.arange(3000)
    sine, cosine = np.sin(rate * time_s), np.cos(rate * time_s)
    drive = 0.01 * np.column_stack([-(rate**2) * sine, rate * cosine, sine])
    blocks = replace(best_like(info, 1.2), feedback_limit_v=0.03, command_limit_v=1.0)
    outcome, samples = played(info, blocks, drive, NUMERICAL, 1.2)
    assert difference(outcome, by_reference(blocks, samples, drive, numerical=True)) <= 1e-12
    inputs = np.hstack([blocks.feedback.B[:, :1], np.zeros((len(blocks.feedback.A), 1))])
    untold = replace(blocks, feedback=replace(blocks.feedback, B=inputs))
    other = by_reference(untold, samples, drive, numerical=True)["command_v"]
    assert np.abs(outcome.log.command_v - other).max() > 0.01


@pytest.mark.campaign
def test_a_command_is_rounded_to_the_same_bits() -> None:
    info, drive = rig_info(), ground(6000)
    blocks = replace(best_like(info, 1.2), shaping_step_v=20.0 / 2**16)
    outcome, samples = played(info, blocks, drive, NUMERICAL, 1.2)
    assert difference(outcome, by_reference(blocks, samples, drive, numerical=True)) <= 1e-12
