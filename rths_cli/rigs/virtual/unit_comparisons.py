"""What the numbers of a virtual table's physics must agree with: the data sheet and the limits of the same rig file."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi
from typing import TYPE_CHECKING

from rths_cli.case.unit_comparison import Comparison

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import VirtualRigSpec

PHYSICS, SHEET, LIMITS = "table.physics", "table.nominal", "table.limits"


def of_physics(rig: VirtualRigSpec) -> Iterator[Comparison]:
    """Yield what the physics of a virtual rig is compared with; 0 switches a part of it off and is not compared."""
    hidden, sheet, limits, changed = rig.physics, rig.nominal, rig.limits, rig.after_identification
    loop_hz, drag_n = hidden.loop_frequency_hz, hidden.viscous_n_s_per_m * limits.velocity_m_s
    own = (
        ("gain_m_per_v", hidden.gain_m_per_v, "m/V", sheet.gain_m_per_v, "the data sheet", 0.6, 1.7,
         f"{SHEET}.gain_m_per_v"),
        ("moving_mass_kg", hidden.moving_mass_kg, "kg", sheet.moving_mass_kg, "the data sheet", 0.5, 2.0,
         f"{SHEET}.moving_mass_kg"),
        ("force_limit_n", hidden.force_limit_n, "N", limits.force_n, "the force limit", 0.5, 2.1, f"{LIMITS}.force_n"),
        ("loop_specimen_mass_kg", hidden.loop_specimen_mass_kg, "kg", sheet.payload_kg, "the payload", 0.08, 1.3,
         f"{SHEET}.payload_kg"),
        ("coulomb_n", hidden.coulomb_n, "N", limits.force_n, "the force limit", 1e-6, 0.2, f"{LIMITS}.force_n"),
        ("coulomb_velocity_m_s", hidden.coulomb_velocity_m_s, "m/s", limits.velocity_m_s, "the velocity limit",
         1e-4, 0.03, f"{LIMITS}.velocity_m_s"),
        ("loop_frequency_hz", loop_hz, "Hz", 15.0, "the usual one of shake tables", 0.1, 7.0, ""),
        ("loop_damping_ratio", hidden.loop_damping_ratio, "", 0.7, "the usual one", 0.2, 3.0, ""),
        ("actuator_time_constant_s", hidden.actuator_time_constant_s, "s", 1.0 / (2.0 * pi * loop_hz),
         "the period of the loop over 2 pi", 0.02, 0.8, f"{PHYSICS}.loop_frequency_hz"),
    )  # fmt: skip
    for key, value, unit, figure, against, low, high, other in own:
        if value > 0.0:
            yield Comparison(f"{PHYSICS}.{key}", value, unit, against, figure, low, high, tuple(filter(None, (other,))))
    if drag_n > 0.0:
        yield Comparison(
            f"{PHYSICS}.viscous_n_s_per_m", drag_n, "N", "the force limit", limits.force_n, 1e-6, 1.0,
            (f"{LIMITS}.force_n", f"{LIMITS}.velocity_m_s"), "its force at the velocity limit", "is it in N s/m?",
        )  # fmt: skip
    factors = (("specimen_stiffness_factor", 0.3, 2.0), ("payload_factor", 0.3, 2.0), ("coulomb_factor", 0.1, 10.0))
    for key, low, high in factors:
        if (value := getattr(changed, key)) > 0.0:
            yield Comparison(f"table.after_identification.{key}", value, "", "no change", 1.0, low, high)
