"""SIM-DELAY line by line: its errors before a run, without solving it in time."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.lines import Lines
from rths_cli.lti import Array, ComplexArray
from rths_cli.metrics import rms
from rths_cli.structure import Building


def delayed_rms(
    lines: Lines, building: Building, floors: ComplexArray, ground: ComplexArray, sim: ComplexArray, delay_s: float
) -> Array:
    """Return the RMS errors (n_storeys,) in m/s^2, test band, of a building whose base shear comes `delay_s` late.

    `floors` (1 + n, m): accelerations of table (one) and floors per table acceleration; `ground` (m,) acceleration and
    `sim` (n_storeys, m) on lines. Numerical part: Eq. 2.3, base shear: Eq. 2.6. The delay must be below the critical.
    """
    numerical, s = building.numerical, 2j * np.pi * lines.frequency_hz[:, None, None]
    count = len(numerical.masses_kg)
    masses = np.concatenate([[building.interface_experimental_mass_kg], building.specimen.masses_kg])
    late = -(masses @ floors) * np.exp(-2j * np.pi * lines.frequency_hz * delay_s)
    stiffness = s**2 * np.diag(numerical.masses_kg) + s * numerical.C + numerical.K
    pushed = -numerical.masses_kg * ground[:, None]
    pushed[:, -1] += late * ground
    stiffness[:, -1, -1] -= late * s[:, 0, 0] ** 2
    relative = np.linalg.solve(stiffness, pushed[..., None])[..., 0].T
    storeys = ground + s[:, 0, 0] ** 2 * relative
    whole = np.vstack([storeys, floors[1:] * storeys[count - 1]])
    return rms(lines.series((sim - whole) * lines.test_band()))
