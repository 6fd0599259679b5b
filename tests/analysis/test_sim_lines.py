"""SIM on lines against SIM in time."""

from __future__ import annotations

import numpy as np
from bench import specimen
from hybrid import storeys

from rths_cli.analysis.fourier_lines import lines_for, sim_lines
from rths_cli.analysis.sim import simulate
from rths_cli.structure import Building, assemble

DT_S = 2e-3


def test_the_lines_are_those_of_the_building_that_rings_on() -> None:
    """A pulse at the end of a record: in time, SIM of the same pulse and the silence after it."""
    below = storeys(2, dashpot_n_s_per_m=150.0)
    building = Building(below, specimen(), 0.7, *assemble(below, specimen(), 0.7), ())
    lines = lines_for(4000, DT_S, 24.0)
    accel = np.zeros(4000)
    accel[3000:3900] = np.hanning(900) * np.sin(2.0 * np.pi * 1.7 * DT_S * np.arange(900))
    whole = np.concatenate([accel, np.zeros(lines.padded - 4000)])
    exact = simulate(building, DT_S, whole).abs_accel_m_s2
    assert np.abs(exact[:, 4000:4500]).max() > 0.1 * np.abs(exact).max()
    assert np.abs(exact[:, -100:]).max() < 1e-4 * np.abs(exact).max()
    found = sim_lines(building, lines, lines.of(accel))
    wanted = np.fft.rfft(exact)[:, : lines.count]
    assert np.abs(found - wanted).max() < 1e-4 * np.abs(wanted).max()
    assert not np.allclose(lines.of(exact[:, :4000]), wanted, atol=1e-2 * np.abs(wanted).max())
