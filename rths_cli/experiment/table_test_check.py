"""The check of a shake-table test: table with feedforward and feedback, no building, and the ground motion as desired.

Its loop is judged like that of the hybrid test, and so are its predicted peaks (analysis/stability_check.py).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import irfft, rfft

from rths_cli.analysis import stability_check as preflight
from rths_cli.analysis.closed_loop_matrix import closed_loop_matrix, slow_roots
from rths_cli.analysis.closed_loop_response import hybrid, loop_response
from rths_cli.analysis.critical_delay import CriticalDelay
from rths_cli.analysis.fourier_lines import lines_for
from rths_cli.analysis.predicted_error import Errors, Known, Prediction
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.experiment.check import LONGEST_S, RINGS, as_identified, noise_before_correction, shown_zeros
from rths_cli.experiment.loop_stability_of_case import (
    loop_faults,
    loop_parts,
    loop_stability,
    required_delay_s,
    table_alone,
)
from rths_cli.experiment.lowest_reliable_frequency import lowest_reliable_hz
from rths_cli.experiment.tangent_verdicts import REACTION_RANGE, stated_ends
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.structure import Specimen
from rths_cli.structure.tangents import with_specimen

if TYPE_CHECKING:
    from rths_cli.analysis.stability_check import Fault, Preflight, Stability
    from rths_cli.control.designed_blocks import Blocks
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification
    from rths_cli.numerics.lti import Array

NO_BUILDING = CriticalDelay(math.inf, math.nan, 0.0)


def judge_table_test(
    setup: Setup, identified: Identification, design: Design, shared: SharedValues | None = None
) -> Preflight:
    """Return the check of a case's shake-table test with the designed blocks, over all samples of the model."""
    shared = shared or SharedValues()
    nominal, *samples = (_judge_one(setup, one, design, shared) for one in (identified, *identified.samples))
    return preflight.over_samples(nominal, samples) if samples else nominal


def _judge_one(setup: Setup, identified: Identification, design: Design, shared: SharedValues) -> Preflight:
    setup, blocks = setup.calibrated(identified), design.blocks
    found = loop_stability(setup, identified, blocks, shared, alone=True)
    known = _known(setup, identified, blocks, found)
    nominal = Prediction({}, NO_ERRORS, np.zeros(0), hybrid(known.loop, known.ground, np.zeros_like(known.floors)))
    masses = np.concatenate([[setup.rig.moving_mass_kg], setup.floor_masses_kg])
    rows = preflight.reach(known, nominal, setup.rig, masses, preflight.strays(known, found))
    further = _faults_at_ends(setup, identified, blocks, shared)
    feedback, least_s = setup.case.controller.kind == "FF+FB", required_delay_s(setup, identified, blocks)
    return preflight.judge(NO_BUILDING, found, rows, setup.case.scaling, None, further, feedback, least_s, alone=True)


NO_ERRORS = Errors(np.zeros(0), 0.0)


def _faults_at_ends(
    setup: Setup, identified: Identification, blocks: Blocks, shared: SharedValues
) -> tuple[Fault, ...]:
    """Return why the loop is not safe at an end of the specimen's stiffness; the loop does not contain the specimen
    unless the feedforward counters its reaction."""
    if not blocks.counters_reaction:
        return ()
    specimen, found = _specimen(identified), []
    for factor in stated_ends(setup.case, True) or REACTION_RANGE:
        if factor != 1.0:
            there = with_specimen(as_identified(setup, specimen), factor).specimen
            for fault in loop_faults(setup, identified, blocks, shared, there, alone=True):
                text = f"with the specimen at {100.0 * factor:.3g} % of its stiffness: {fault.text}"
                found.append(replace(fault, cause=f"specimen {fault.cause}", text=text))
    return tuple(found)


def _specimen(identified: Identification) -> Specimen:
    assert identified.specimen is not None  # every case has experimental storeys
    return identified.specimen.specimen


def _known(setup: Setup, identified: Identification, blocks: Blocks, found: Stability) -> Known:
    """Return what the peaks of the shake-table test follow from."""
    dt, motion, specimen = setup.rig.dt_s, setup.motion, _specimen(identified)
    rig, _ = loop_parts(setup, identified)
    linear, storey = table_alone(blocks)
    ring = RINGS * dt / -math.log(found.radius) if found.radius < 1.0 else LONGEST_S
    lines = lines_for(len(motion.time_s), dt, min(ring, LONGEST_S), lowest_reliable_hz(setup), setup.case.test_band_hz)
    ground = lines.of_motion(motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m)
    floors = np.vstack([np.ones(lines.count), specimen_state_space(specimen).response(lines.frequency_hz)[:, 0]])
    return Known(
        loop=loop_response(rig, linear, storey, lines.z),
        lines=lines,
        model=identified.best,
        measured=identified.frfs[0],
        friction=identified.friction,
        floors=floors,
        ground=ground,
        sim=floors * ground[0],
        velocity_m_s=motion.velocity_m_s,
        noise_m_s2=noise_before_correction(identified, linear.correction, setup),
        rig=setup.rig,
        correction=linear.correction,
        shaped=linear.shaping_step_v > 0.0,
        excess=rig.excess,
        compared=setup.compared,
        specimen=specimen,
        peaks_m_s2=_peaks(setup, specimen, lines.padded),
        zero_m_s2=shown_zeros(identified, setup),
        slow_roots=slow_roots(closed_loop_matrix(rig, linear), dt, lines.padded * dt),
    )


def _peaks(setup: Setup, specimen: Specimen, padded: int) -> Array:
    """Return the peaks (c,) in m/s^2 of table and floors on a table that follows the ground exactly, at all
    frequencies."""
    accel, dt = setup.motion.accel_m_s2, setup.rig.dt_s
    response = specimen_state_space(specimen).response(np.arange(padded // 2 + 1) / (padded * dt))[:, 0]
    floors = irfft(response * rfft(accel, padded), padded)[:, : len(accel)]
    return np.abs(np.vstack([accel, floors])).max(axis=1)
