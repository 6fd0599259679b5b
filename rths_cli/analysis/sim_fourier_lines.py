"""SIM and SIM-DELAY on Fourier lines, for predicted_error.py and the check."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.fourier_lines import Lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.sim import state_equation
from rths_cli.control.numerical_substructure import state_space
from rths_cli.control.state_space import discretise
from rths_cli.numerics.lti import Array, ComplexArray, StateSpace
from rths_cli.structure import Building


def sim_lines(building: Building, lines: Lines, ground: ComplexArray) -> ComplexArray:
    """Return the absolute accelerations (n_storeys, m) in m/s^2 for lines (m,) of the ground acceleration (Eq. 2.1).

    The ground acceleration is linear between samples. The building continues to vibrate after the record, like the
    lines of the hybrid test. If only one of the two broke off there, the test band's filter would spread their
    difference into the record's last tenth of a second.
    """
    n = len(building.M)
    a, b = state_equation(building.M, building.C, building.K)
    block = discretise(StateSpace(a, b, a[n:], np.zeros((n, 1))), lines.dt_s, "foh", "sim", (), ())
    return np.asarray(block.response(lines.frequency_hz)[:, 0] * ground)


def delayed_rms(
    lines: Lines, building: Building, floors: ComplexArray, ground: ComplexArray, sim: ComplexArray, delay_s: float
) -> Array:
    """Return the RMS errors (n_storeys,) in m/s^2, test band, of a building whose base shear comes `delay_s` late.

    `floors` (1 + n, m): accelerations of table (one) and floors per table acceleration; `ground` (m,) acceleration and
    `sim` (n_storeys, m) on lines. Numerical part: Eq. 2.3, base shear: Eq. 2.6. The delay must be below the critical.
    """
    p = len(building.numerical.masses_kg)
    masses = np.concatenate([[building.interface_experimental_mass_kg], building.specimen.masses_kg])
    late = -(masses @ floors) * np.exp(-2j * np.pi * lines.frequency_hz * delay_s)  # base shear per interface's accel
    system = state_space(building.numerical)
    accels = StateSpace(system.A, system.B, system.C[2 * p :], system.D[2 * p :]).response(lines.frequency_hz)
    interface = accels[-1, 0] * ground / (1.0 - accels[-1, 1] * late)
    storeys = accels[:, 0] * ground + accels[:, 1] * late * interface
    whole = np.vstack([storeys, floors[1:] * interface])
    return rms(lines.evaluated(sim - whole))
