"""Physical constants."""

STANDARD_GRAVITY_M_S2 = 9.80665
