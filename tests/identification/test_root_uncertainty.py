"""Shifts of roots that no scatter shows, against the fit made again to a response distorted by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_records import make_specimen, true_response

from rths_cli.identification.results import LevelBand
from rths_cli.identification.root_uncertainty import shifts
from rths_cli.identification.specimen_fit import SKEW
from rths_cli.identification.table_fit import Timing, first_fit, refit
from rths_cli.identification.verdict import SHORTFALL
from rths_cli.numerics.bands import USUAL
from rths_cli.numerics.lti import Frf

DT, RATIO = 5e-4, 5.0


@pytest.fixture(scope="module")
def frf() -> Frf:
    f = np.arange(0.5, 60.0, 0.05)
    size = np.full(len(f), 1e-3)
    return Frf(f, true_response(make_specimen(), f), np.ones(len(f)), size, 10)


def levels(change: complex) -> tuple[LevelBand, ...]:
    """Return the same change of the response at low level in every band."""
    return tuple(LevelBand(low, high, 1.0 + change, 1e-6) for low, high in pairwise(USUAL.edges_hz))


def test_shifts_are_those_of_a_fit_to_a_distorted_response(frf: Frf) -> None:
    modes = (np.array([3.2, 8.4]), np.array([0.043, 0.039]))
    found = refit(frf, first_fit(frf, modes, Timing(1, DT), (0.5, 60.0)))
    late = np.exp(-2j * np.pi * frf.frequency_hz * SKEW * DT)
    by_delay = refit(replace(frf, response=frf.response * late), found).parameters - found.parameters
    change = 0.004 * (1.0 - 0.5j)
    share = SHORTFALL * change / (RATIO - 1.0)
    by_friction = refit(replace(frf, response=frf.response * (1.0 + share)), found).parameters - found.parameters
    got = shifts(found, frf, levels(change), RATIO)
    free = np.ones(len(got), dtype=bool)
    free[found.layout.zeros(found.held_zeros)] = False
    assert got[free] == pytest.approx(np.hypot(by_delay, by_friction)[free], rel=0.05, abs=2e-6)
    assert np.all(got[~free] < 1e-4)  # held
    assert np.all(shifts(found, frf, (), RATIO) <= got + 1e-12)
