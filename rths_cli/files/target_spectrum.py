"""A response spectrum in a file of two columns: periods in s, and pseudo-accelerations with their unit."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2
from rths_cli.files.durable_files import read_whole
from rths_cli.files.measured_data.text_tables import text_contents
from rths_cli.files.measured_data.units import unit_of
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import shortened

MAX_BYTES = 1_000_000
LARGEST_M_S2 = 1000.0
NAMED = "name the columns with their units, as period_s,sa_g"
_PERIOD = re.compile(r"(t|tn|periods?)(\W*(s|sec|secs|seconds))?\W*", re.IGNORECASE)


def read_spectrum(path: Path) -> tuple[Array, Array]:
    """Return the periods (p,) in s, which grow, and the pseudo-accelerations (p,) in m/s^2 of a file.

    Raises InputError, with the line, where the columns are not named period and acceleration with a unit, and for
    periods that do not grow, accelerations that are not positive or above 1000 m/s^2, and fewer than two of them.
    """
    data = read_whole(path, MAX_BYTES, "a spectrum", "name a file with the columns period_s and sa_g")
    if b"\0" in data:
        raise InputError(f"{path}: is a binary file; give text columns, period_s and sa_g")
    contents = text_contents(path, data.decode("utf-8-sig", errors="replace"))
    line_of = contents.line_of or (lambda row: row + 1)
    found = [(c, unit_of(c.name, c.unit)[0]) for c in contents.columns]
    periods = [c for c, _ in found if _PERIOD.fullmatch(c.name.replace("_", " "))]
    accels = [(c, unit) for c, unit in found if unit in FACTORS_M_S2]
    if len(periods) != 1 or len(accels) != 1:
        told = ", ".join(shortened(c.name, 30) for c in contents.columns[:8])
        wanted = "a period" if len(periods) != 1 else "an acceleration with a unit"
        count = "several columns are" if periods and accels else "no column is"
        raise InputError(f"{path}: {count} {wanted} ({told}); {NAMED}")
    period, accel = periods[0].values, accels[0][0].values * FACTORS_M_S2[accels[0][1]]
    if period.size < 2:
        raise InputError(f"{path}: holds {period.size} period, a spectrum needs at least 2")
    faults = (
        (~(np.diff(period, prepend=-1e-300 if period[0] == 0.0 else 0.0) > 0.0), "the period must be above the last"),
        (~((accel > 0.0) & (accel <= LARGEST_M_S2)), f"the acceleration must be > 0 and <= {LARGEST_M_S2:g} m/s^2"),
    )
    for wrong, what in faults:
        if wrong.any():
            row = int(wrong.argmax())
            raise InputError(f"{path}:{line_of(row)}: {what}, got {period[row]:g} s, {accel[row]:g} m/s^2")
    return period, accel
