"""From a case to all that is known before the table moves: ground motion, building, rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.lti import Array
from rths_cli.record import GroundMotion, prepare
from rths_cli.rig_info import STANDARD_GRAVITY_M_S2, Channel, Converters, Limits, RigInfo
from rths_cli.structure import Building, build

if TYPE_CHECKING:
    from rths_cli.case.models import Case

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Setup:
    """What a case means in arrays; `floor_masses_kg` (n_exp,) are weighed; `overrides` as given by --override."""

    case: Case
    motion: GroundMotion
    record_sha256: str
    building: Building
    rig: RigInfo
    floor_masses_kg: Array
    overrides: tuple[str, ...] = ()


def make_setup(case: Case, overrides: tuple[str, ...] = ()) -> Setup:
    """Read the record, build the building and the rig's description; raises InputError."""
    _check_payload(case)
    accelerogram = read_accelerogram(case.record.path, case.record.unit, case.record.dt_s)
    motion = prepare(
        accelerogram,
        case.scaling,
        case.sample_rate_hz,
        corner_hz=case.record_filter.corner_hz,
        order=case.record_filter.order,
    )
    building = build(case.structure, case.damping)
    masses = np.asarray(case.structure.experimental.masses_kg, dtype=float)
    return Setup(case, motion, accelerogram.sha256, building, rig_info(case), masses, overrides)


def _check_payload(case: Case) -> None:
    """Refuse a specimen that is heavier than the data sheet of the table permits."""
    weight = sum(case.structure.experimental.masses_kg) + case.structure.interface_experimental_mass_kg
    if weight > case.table.nominal.payload_kg:
        raise InputError(
            f"{case.path}: structure: the specimen weighs {weight:g} kg, rig {case.table.name} carries at most "
            f"{case.table.nominal.payload_kg:g} kg (nominal.payload_kg); put fewer storeys on the table"
        )


def rig_info(case: Case) -> RigInfo:
    """Return what a laboratory knows of the case's rig before it has measured anything."""
    table = case.table
    numerical = len(case.structure.numerical.masses_kg)
    floors = [f"floor_{numerical + 1 + i}" for i in range(len(case.structure.experimental.masses_kg))]
    channels = tuple(
        Channel(
            name,
            table.sensors.sensitivity_mv_per_g / 1000.0 / STANDARD_GRAVITY_M_S2,
            table.sensors.range_g * STANDARD_GRAVITY_M_S2,
            table.sensors.high_pass_hz,
            table.sensors.low_pass_hz,
        )
        for name in ("table", *floors)
    )
    limits = table.limits
    return RigInfo(
        name=table.name,
        kind=table.kind,
        dt_s=1.0 / case.sample_rate_hz,
        channels=channels,
        converters=Converters(table.converters.bits, table.converters.range_v),
        latency_samples=table.converters.latency_samples,
        limits=Limits(limits.stroke_m, limits.velocity_m_s, limits.acceleration_m_s2, limits.force_n),
        gain_m_per_v=table.nominal.gain_m_per_v,
        moving_mass_kg=table.nominal.moving_mass_kg + case.structure.interface_experimental_mass_kg,
        payload_kg=float(sum(case.structure.experimental.masses_kg)),
    )
