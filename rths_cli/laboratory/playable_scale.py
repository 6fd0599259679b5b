"""The largest scale at which a table can play a record, and what limits it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rths_cli.analysis.stability_check import RESERVE
from rths_cli.experiment.ground_motion import CORNER_HZ, peaks, prepare
from rths_cli.files.accelerograms import Accelerogram

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import RigSpec

RATE_HZ = 2000.0  # at which the motion is prepared, or the record's own where that is higher


@dataclass(frozen=True)
class Playable:
    """The largest scale of a record on a table, and what limits it: stroke, command range, velocity, acceleration, or
    force with the whole payload."""

    rig: str
    largest_scale: float
    limited_by: str


def playable(record: Accelerogram, rig: RigSpec) -> Playable:
    """Return the largest scale at which a table plays a record through the usual high pass and keeps the reserve of the
    check to every limit of its rig file. Raises InputError for a record that is too short for the high pass."""
    limits, nominal = rig.limits, rig.nominal
    found = peaks(prepare(record, 1.0, max(RATE_HZ, 1.0 / record.dt_s), CORNER_HZ))
    force_m_s2 = limits.force_n / (nominal.moving_mass_kg + nominal.payload_kg)
    scales = {
        "stroke": limits.stroke_m / found.displacement_m,
        "command range": nominal.gain_m_per_v * rig.converters.range_v / found.displacement_m,
        "velocity": limits.velocity_m_s / found.velocity_m_s,
        "acceleration": limits.acceleration_m_s2 / found.accel_m_s2,
        "force with the whole payload": force_m_s2 / found.accel_m_s2,
    }
    limited_by = min(scales, key=lambda name: scales[name])
    return Playable(rig.name or "", (1.0 - RESERVE) * scales[limited_by], limited_by)
