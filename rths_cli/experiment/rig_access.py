"""Open the rig of a setup, and the limits of its guard."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.rig_schema import DEFAULT_ENERGY_RATIO
from rths_cli.control.load_cell import cell_reads
from rths_cli.experiment.session import wants_session_record
from rths_cli.rigs.from_case import driver, virtual_driver

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.rigs.description import RigInfo
    from rths_cli.rigs.interface import Rig
    from rths_cli.rigs.virtual.virtual_rig import VirtualRig

# noise streams: dropping one run changes no other
IDENTIFICATION, SHAKE_TABLE, EXP_RTHS, PROBE, VERIFICATION = 1, 2, 3, 4, 5
BEFORE = (IDENTIFICATION, PROBE)
AT_REST_SHARE = 0.02  # fraction of the velocity limit above the apparent velocity of a specimen at rest due to noise


def open_rig(setup: Setup, stream: tuple[int, ...], seed: int) -> Rig:
    """Return the case's rig without opening it: nothing is connected, nothing moves.

    On a virtual rig `stream` and `seed` select the noise of one run, and whether the run comes before or after the
    change that the rig file states under `after_identification`. Raises InputError or RigError if a plug-in cannot
    create its rig.
    """
    named = (seed, *stream)
    return driver(
        setup.case, setup.declared_rig or setup.rig, setup.building, named, _changed(stream),
        session_of(setup, stream, seed),
    )  # fmt: skip


def open_virtual(setup: Setup, stream: tuple[int, ...], seed: int) -> VirtualRig:
    """Return the case's virtual rig with the noise stream of one run."""
    return virtual_driver(
        setup.case, setup.declared_rig or setup.rig, setup.building, (seed, *stream), _changed(stream),
        session_of(setup, stream, seed),
    )  # fmt: skip


def session_of(setup: Setup, stream: tuple[int, ...], seed: int) -> tuple[int, ...]:
    """Return what names the session of a run, within which a virtual laboratory's sensors do not drift: probe and
    excitation of an identification are one, the record before a case's table runs and these runs are another, all
    repetitions in a sweep included."""
    if not _changed(stream):
        return (seed, IDENTIFICATION)
    return (setup.session if wants_session_record(setup) else seed, EXP_RTHS)


def _changed(stream: tuple[int, ...]) -> bool:
    """Return whether a run comes after the change that a rig file states under `after_identification`."""
    return bool(stream) and stream[0] not in BEFORE


def guard_limits(setup: Setup) -> GuardLimits:
    """Return the guard's constants for the case's rig."""
    from rths_cli.loop.guard import SATURATED_SHARE, STUCK_BITS, GuardLimits, further_limits

    rig = setup.rig
    bits = np.array([rig.converters.step_v / c.sensitivity_v_per_unit for c in rig.channels])
    saturation = [min(c.range_v, rig.converters.range_v) for c in rig.channels]
    mass = setup.building.interface_experimental_mass_kg
    return GuardLimits(
        stroke_m=rig.limits.stroke_m,
        velocity_m_s=rig.limits.velocity_m_s,
        acceleration_m_s2=rig.limits.acceleration_m_s2,
        force_n=rig.limits.force_n,
        command_v=rig.converters.range_v,
        tracking_error=rig.limits.tracking_error_m_s2,
        gain_m_per_v=rig.gain_m_per_v,
        dt_s=rig.dt_s,
        force_weights=np.concatenate([[rig.moving_mass_kg], setup.floor_masses_kg]),
        saturation_v=SATURATED_SHARE * np.array(saturation),
        stuck=np.where(bits > 0.0, STUCK_BITS * bits, math.inf),
        abort=np.array([min(c.abort, rig.limits.acceleration_m_s2) for c in rig.channels]),
        command_rate_v_s=rig.limits.command_rate_v_s,
        energy_ratio=_energy_ratio(rig),
        further=further_limits(rig, cell_reads(setup.floor_masses_kg, mass, 0.0)),
        energy_floor_j=0.5 * rig.specimen_mass_kg * (AT_REST_SHARE * rig.limits.velocity_m_s) ** 2,
    )


def _energy_ratio(rig: RigInfo) -> float:
    """Return the permitted ratio of added to exchanged energy; infinite on a virtual rig that states none."""
    if math.isfinite(rig.limits.energy_ratio) or not rig.can.moves_hardware:
        return rig.limits.energy_ratio
    return DEFAULT_ENERGY_RATIO
