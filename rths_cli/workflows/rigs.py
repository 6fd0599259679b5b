"""Open the rig a setup names, and the limits its guard holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.models_rig import DEFAULT_ENERGY_RATIO, VirtualRigSpec
from rths_cli.case.models_rig_real import NiRigSpec, PluginRigSpec, UdpRigSpec
from rths_cli.errors import RigError
from rths_cli.rigs.virtual.opening import virtual_rig

if TYPE_CHECKING:
    from rths_cli.loop.guard import GuardLimits
    from rths_cli.rig_info import RigInfo
    from rths_cli.rigs.interface import Rig
    from rths_cli.rigs.ni.rig import NiRig
    from rths_cli.rigs.udp.rig import UdpRig
    from rths_cli.rigs.virtual.rig import VirtualRig
    from rths_cli.workflows.setup import Setup

# noise streams: dropping one run changes no other
IDENTIFICATION, SHAKE_TABLE, EXP_RTHS, PROBE, VERIFICATION = 1, 2, 3, 4, 5
BEFORE = (IDENTIFICATION, PROBE)
AT_REST_SHARE = 0.02  # of the velocity limit: noise moves a specimen at rest by less


def open_rig(setup: Setup, stream: tuple[int, ...], seed: int) -> Rig:
    """Return the case's rig, made but not opened: nothing is connected, nothing moves.

    On a virtual rig `stream` and `seed` name the noise of one run, before or after the change that the rig file states
    under `after_identification`. Raises InputError or RigError when a plug-in cannot make its rig.
    """
    table = setup.case.table
    if isinstance(table, VirtualRigSpec):
        return open_virtual(setup, stream, seed)
    if isinstance(table, UdpRigSpec):
        return _udp(setup, table)
    if isinstance(table, NiRigSpec):
        return _ni(setup, table)
    if isinstance(table, PluginRigSpec):
        from rths_cli.rigs.plugins import open_plugin

        return open_plugin(setup.rig, table.options)
    raise RigError(f"rig {setup.rig.name}: there is no driver for rigs of kind {setup.rig.kind}")


def open_virtual(setup: Setup, stream: tuple[int, ...], seed: int) -> VirtualRig:
    """Return the case's virtual rig with the noise stream of one run."""
    table, building = setup.case.table, setup.building
    assert isinstance(table, VirtualRigSpec)
    return virtual_rig(
        table,
        setup.rig,
        building.specimen,
        building.interface_experimental_mass_kg,
        seed=(seed, *stream),
        after_identification=stream[0] not in BEFORE,
    )


def _udp(setup: Setup, table: UdpRigSpec) -> UdpRig:
    """Return the rig behind UDP that a rig file describes."""
    from rths_cli.rigs.udp.rig import UdpRig, UdpTarget

    there, rig = table.udp, setup.rig
    target = UdpTarget(
        there.host, there.port, there.key_file, there.timeout_s, table.watchdog_s, rig.limits.lost_samples
    )  # fmt: skip
    return UdpRig(rig, target)


def _ni(setup: Setup, table: NiRigSpec) -> NiRig:
    """Return the rig on an NI card that a rig file describes."""
    from rths_cli.rigs.ni.daqmx import Wiring
    from rths_cli.rigs.ni.rig import NiRig

    card, rig = table.ni, setup.rig
    terminals = tuple(channel.terminal for channel in rig.channels)
    wiring = Wiring(
        card.device, card.command_channel, terminals, card.enable_line or "", card.wiring,
        rig.converters.range_v, 1.0 / rig.dt_s, card.timeout_s,
    )  # fmt: skip
    return NiRig(rig, wiring)


def guard_limits(setup: Setup) -> GuardLimits:
    """Return the guard's constants for the case's rig."""
    from rths_cli.loop.guard import STUCK_BITS, GuardLimits

    rig = setup.rig
    bits = np.array([rig.converters.step_v / c.sensitivity_v_per_m_s2 for c in rig.channels])
    saturation = [min(c.range_m_s2 * c.sensitivity_v_per_m_s2, rig.converters.range_v) for c in rig.channels]
    return GuardLimits(
        stroke_m=rig.limits.stroke_m,
        velocity_m_s=rig.limits.velocity_m_s,
        acceleration_m_s2=rig.limits.acceleration_m_s2,
        force_n=rig.limits.force_n,
        command_v=rig.converters.range_v,
        tracking_error_m_s2=rig.limits.tracking_error_m_s2,
        gain_m_per_v=rig.gain_m_per_v,
        dt_s=rig.dt_s,
        masses_kg=np.concatenate([[rig.moving_mass_kg], setup.floor_masses_kg]),
        saturation_v=0.999 * np.array(saturation),
        stuck_m_s2=np.where(bits > 0.0, STUCK_BITS * bits, math.inf),
        abort_m_s2=np.array([min(c.abort_m_s2, rig.limits.acceleration_m_s2) for c in rig.channels]),
        command_rate_v_s=rig.limits.command_rate_v_s,
        energy_ratio=_energy_ratio(rig),
        energy_floor_j=0.5 * rig.specimen_mass_kg * (AT_REST_SHARE * rig.limits.velocity_m_s) ** 2,
    )


def _energy_ratio(rig: RigInfo) -> float:
    """Return how much energy the table's errors may add, of that exchanged; off on a virtual rig that states none."""
    if math.isfinite(rig.limits.energy_ratio) or rig.kind == "virtual":
        return rig.limits.energy_ratio
    return DEFAULT_ENERGY_RATIO
