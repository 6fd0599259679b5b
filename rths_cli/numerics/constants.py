"""Physical constants, and the units in which quantities are read from files and options."""

STANDARD_GRAVITY_M_S2 = 9.80665

FACTORS = {
    "acceleration": {
        "m/s^2": 1.0, "cm/s^2": 0.01, "gal": 0.01, "g": STANDARD_GRAVITY_M_S2, "mm/s^2": 0.001, "in/s^2": 0.0254,
        "ft/s^2": 0.3048, "mg": 0.001 * STANDARD_GRAVITY_M_S2, "%g": 0.01 * STANDARD_GRAVITY_M_S2,
    },
    "displacement": {"m": 1.0, "mm": 1e-3},
    "force": {"N": 1.0, "kN": 1e3},
    "strain": {"1": 1.0, "um/m": 1e-6},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "mass": {"kg": 1.0, "g": 1e-3},
}  # fmt: skip
"""The units of each quantity, each with its size in the first one."""
