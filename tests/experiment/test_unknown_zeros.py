"""How far a hybrid test goes aside because a channel's zero is known to a part of a bit only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rths_cli.analysis.stability_check import aside_v, reach
from rths_cli.case.load import load_cases
from rths_cli.experiment.check import judge
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.loop_stability_of_case import loop_parts
from rths_cli.experiment.rig_access import guard_limits
from rths_cli.experiment.setup import make_setup
from rths_cli.experiment.simulated_test import _without_limits
from rths_cli.identification.results import Identification
from rths_cli.loop.identified_rig_run import Disturbed, play_identified, seen_by_model
from rths_cli.numerics.lti import Array


@pytest.mark.parametrize("corner_hz", [0.05, 0.3])
def test_a_constant_offset_moves_the_command_as_far_as_the_check_says(
    default_identification: Identification, corner_hz: float
) -> None:
    """The step itself, on the identified rig without ground motion: each channel is half a bit off from the start, of
    which the correction of its coupling makes a line (that rig has no coupling)."""
    settings = ["controller={kind: FF+FB, reaction_feedforward: false}"]
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])
    coupled = tuple(replace(channel, high_pass_hz=corner_hz) for channel in setup.rig.channels)
    setup = replace(setup, rig=replace(setup.rig, channels=coupled))
    design = design_blocks(setup, default_identification)
    known = judge(setup, default_identification, design).known
    assert known is not None
    rig, _ = loop_parts(setup, default_identification)
    blocks = replace(seen_by_model(rig, design.blocks, setup.rig, setup.removes_sensors), shaping_step_v=0.0)
    rows, bit = len(setup.motion.time_s) + design.blocks.lead_samples, setup.rig.converters.step_v

    def command(channel: int) -> Array:
        added = np.zeros((rows, len(setup.rig.channels)))
        added[:, channel] = 0.5 * bit * (1.0 + 2.0 * np.pi * corner_hz * setup.rig.dt_s * np.arange(rows))
        limits = _without_limits(guard_limits(setup))
        played = play_identified(rig.plant, setup.rig, blocks, np.zeros((rows, 3)), limits, Disturbed(added))
        return played.log.command_v[: played.steps]

    paths = [np.abs(command(channel)).max() for channel in range(len(setup.rig.channels))]
    silent = replace(known, noise_m_s2=np.zeros(len(paths)))
    two_sigma = 2.0 / np.sqrt(3.0) * np.linalg.norm(paths)  # half a bit is sqrt(3) standard deviations
    assert aside_v(silent) == pytest.approx(min(two_sigma, sum(paths)), rel=0.02)
    bits = bit / np.array([channel.sensitivity_v_per_unit for channel in setup.rig.channels])
    assert aside_v(replace(known, noise_m_s2=bits)) < 1e-3 * aside_v(silent)
    prediction = judge(setup, default_identification, design).preflight.prediction
    still, moved = (reach(silent, prediction, setup.rig, np.ones(len(bits)), far) for far in (0.0, 0.5))
    gain = setup.rig.gain_m_per_v
    assert [after.peak - before.peak for before, after in zip(still, moved, strict=True)] == pytest.approx(
        [0.5 * gain, 0.0, 0.0, 0.0, 0.0, 0.5], abs=1e-12
    )
