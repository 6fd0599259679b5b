"""Pre-flight: judge a case from what was identified, without moving anything."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis import preflight
from rths_cli.analysis.critical_delay import critical_delay
from rths_cli.analysis.identified_rig import identified_rig
from rths_cli.analysis.lines import lines_for
from rths_cli.analysis.loop_response import loop_response
from rths_cli.analysis.prediction import Known, Prediction, predict
from rths_cli.analysis.sim import simulate
from rths_cli.control.estimator import specimen_state_space
from rths_cli.control.numerical import all_storeys
from rths_cli.structure import Building, assemble

if TYPE_CHECKING:
    from rths_cli.analysis.identified_rig import IdentifiedRig
    from rths_cli.identification.evaluate import Identification
    from rths_cli.lti import Block
    from rths_cli.structure import Specimen
    from rths_cli.workflows.controllers import Design
    from rths_cli.workflows.setup import Setup

RINGS = 7.0  # time constants after which a motion has died out
LONGEST_S = 300.0


def preflight_of(setup: Setup, identified: Identification, design: Design) -> preflight.Preflight:
    """Return the verdict on a case's hybrid test, from the rig as identified and the blocks as designed."""
    specimen = _specimen(identified)
    building = as_identified(setup, specimen)
    rig = identified_rig(identified.best, specimen, setup.rig, setup.removes_sensors)
    storeys = all_storeys(building.numerical, setup.rig.dt_s, setup.case.integration)
    samples = len(setup.motion.time_s)
    found = preflight.stability(rig, design.blocks, storeys, identified.best, identified.frfs[0], samples)
    known = known_of(setup, identified, design, rig, storeys, found.radius)
    prediction = predict(known)
    masses = np.concatenate([[setup.rig.moving_mass_kg], setup.floor_masses_kg])
    rows = preflight.reach(known, prediction, setup.rig, masses)
    stable = prediction if found.radius < 1.0 else None
    critical = critical_delay(building)
    return preflight.judge(critical, found, rows, setup.case.scaling, stable, setup.rig.dt_s)


def _specimen(identified: Identification) -> Specimen:
    assert identified.specimen is not None  # every case has experimental storeys
    return identified.specimen.specimen


def as_identified(setup: Setup, specimen: Specimen) -> Building:
    """Return the building of the numerical part and the specimen as identified."""
    numerical, mass = setup.building.numerical, setup.building.interface_experimental_mass_kg
    return Building(numerical, specimen, mass, *assemble(numerical, specimen, mass), ())


def known_of(
    setup: Setup, identified: Identification, design: Design, rig: IdentifiedRig, storeys: Block, radius: float
) -> Known:
    """Return what the prediction of errors starts from."""
    dt, motion, specimen = setup.rig.dt_s, setup.motion, _specimen(identified)
    building = as_identified(setup, specimen)
    ring = RINGS * dt / -math.log(radius) if radius < 1.0 else LONGEST_S
    lines = lines_for(len(motion.time_s), dt, min(ring, LONGEST_S))
    sim = simulate(building, dt, motion.accel_m_s2)
    floors = specimen_state_space(specimen).response(lines.frequency_hz)[:, 0]
    interface = len(building.numerical.masses_kg) - 1
    return Known(
        loop=loop_response(rig, design.blocks, storeys, lines.z),
        lines=lines,
        model=identified.best,
        measured=identified.frfs[0],
        friction=identified.friction,
        floors=np.vstack([np.ones((1, lines.count)), floors]),
        ground=lines.of_motion(motion.accel_m_s2, motion.velocity_m_s, motion.displacement_m),
        sim=lines.of(sim.abs_accel_m_s2),
        velocity_m_s=sim.rel_vel_m_s[interface] + motion.velocity_m_s,
        noise_m_s2=np.array([channel.rest_rms_m_s2 or 0.0 for channel in identified.channels]),
        rig=setup.rig,
        correction=design.blocks.correction,
        shaped=design.blocks.shaping_step_v > 0.0,
        summed_m_s2_per_v=rig.summed_m_s2_per_v,
    )


__all__ = ["Prediction", "as_identified", "known_of", "preflight_of"]
