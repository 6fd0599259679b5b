"""Open the rig a setup names, and the limits its guard holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.rigs.virtual.opening import virtual_rig

if TYPE_CHECKING:
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.rigs.virtual.rig import VirtualRig
    from rths_cli.workflows.setup import Setup

# noise streams: dropping one run changes no other
IDENTIFICATION, SHAKE_TABLE, EXP_RTHS, PROBE, VERIFICATION = 1, 2, 3, 4, 5
BEFORE = (IDENTIFICATION, PROBE)


def open_rig(setup: Setup, stream: tuple[int, ...], seed: int) -> VirtualRig:
    """Return the case's virtual rig with the noise stream of one run, before or after the change that the rig file
    states under `after_identification`."""
    building = setup.building
    return virtual_rig(
        setup.case.table,
        setup.rig,
        building.specimen,
        building.interface_experimental_mass_kg,
        seed=(seed, *stream),
        after_identification=stream[0] not in BEFORE,
    )


def guard_limits(setup: Setup) -> GuardLimits:
    """Return the guard's constants for the case's rig."""
    from rths_cli.loop.guard import STUCK_BITS, GuardLimits

    rig = setup.rig
    sensor = rig.channels[0]
    bit = rig.converters.step_v / sensor.sensitivity_v_per_m_s2
    saturation = [min(c.range_m_s2 * c.sensitivity_v_per_m_s2, rig.converters.range_v) for c in rig.channels]
    return GuardLimits(
        stroke_m=rig.limits.stroke_m,
        velocity_m_s=rig.limits.velocity_m_s,
        acceleration_m_s2=rig.limits.acceleration_m_s2,
        force_n=rig.limits.force_n,
        command_v=rig.converters.range_v,
        tracking_error_m_s2=math.inf,
        gain_m_per_v=rig.gain_m_per_v,
        dt_s=rig.dt_s,
        masses_kg=np.concatenate([[rig.moving_mass_kg], setup.floor_masses_kg]),
        saturation_v=0.999 * np.array(saturation),
        stuck_m_s2=STUCK_BITS * bit if bit > 0.0 else math.inf,
        abort_m_s2=np.full(len(rig.channels), rig.limits.acceleration_m_s2),
    )
