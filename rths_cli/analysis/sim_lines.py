"""SIM line by line: the whole building's response beside the hybrid test's, on the same Fourier lines."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.lines import Lines
from rths_cli.analysis.sim import state_equation
from rths_cli.control.realise import discretise
from rths_cli.lti import ComplexArray, StateSpace
from rths_cli.structure import Building


def sim_lines(building: Building, lines: Lines, ground: ComplexArray) -> ComplexArray:
    """Return the absolute accelerations (n_storeys, m) in m/s^2 for lines of the ground acceleration (m,), which is a
    straight line between samples (Eq. 2.1).

    The building rings on after the record, as the hybrid test's lines do: a series that breaks off there would put the
    difference through the test band's filter, back into the record's last tenth of a second.
    """
    n = len(building.M)
    a, b = state_equation(building.M, building.C, building.K)
    block = discretise(StateSpace(a, b, a[n:], np.zeros((n, 1))), lines.dt_s, "foh", "sim", (), ())
    return np.asarray(block.response(lines.frequency_hz)[:, 0] * ground)
