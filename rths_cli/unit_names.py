"""The unit in a name's ending: `stroke_m`, `sensitivity_mv_per_g`."""

from __future__ import annotations

ENDINGS = (
    ("zeta_s", "1"), ("_n_per_m3", "N/m^3"), ("_m_per_s", "m/s"), ("_v_per_sqrt_s", "V/s^0.5"),
    ("_drift_per_s", "1/s"), ("_kg_m2", "kg*m^2"),
    ("_mv_per_g", "mV/g"), ("_v_per_m_s2", "V/(m/s^2)"), ("_n_s_per_m", "N*s/m"), ("_n_per_m", "N/m"),
    ("_m_per_v", "m/V"), ("_v_s", "V/s"), ("_m_s2", "m/s^2"), ("_m_s", "m/s"), ("_hz", "Hz"), ("_kg", "kg"),
    ("_m", "m"), ("_n", "N"), ("_v", "V"), ("_s", "s"), ("_g", "g"),
)  # fmt: skip


def unit_of_name(name: str, without: str = "1") -> str:
    """Return the unit that a name ends with, `without` where it has none."""
    return next((unit for ending, unit in ENDINGS if name.endswith(ending)), without)
