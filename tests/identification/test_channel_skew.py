"""Floors out of step with the table: the delay put in comes out, on motions integrated in time."""

from __future__ import annotations

import numpy as np
import pytest
from made_records import make_specimen
from portfolio import parametrize_first
from test_specimen_fit import DT, floors, table_motion

from rths_cli.identification.identify_specimen import skew
from rths_cli.identification.specimen_fit import Motion, Start
from rths_cli.structure import storey_values


@parametrize_first(1, "late", [-2, 0, 1, 3])
def test_delay_of_whole_samples_is_found(late: int) -> None:
    specimen, table = make_specimen(), table_motion()
    moved = np.roll(floors(specimen, table), late, axis=1)
    cut = slice(10, len(table) - 10)
    start = Start(storey_values(specimen.K), np.array([0.043, 0.039]))
    found, error = skew([Motion(table, moved).cut(cut)], DT, specimen.masses_kg, 0.5, start)
    assert found == pytest.approx(late, abs=0.02)
    assert error < 0.01


def test_what_no_delay_explains_is_not_called_one() -> None:
    specimen, table = make_specimen(), table_motion()
    moved = floors(specimen, table) * np.array([[1.0], [1.1]])
    start = Start(storey_values(specimen.K), np.array([0.043, 0.039]))
    assert skew([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start) == (0.0, 0.0)


def test_a_delay_that_leaves_a_tenth_of_the_motion_is_none() -> None:
    """Channels that show little but noise (0.2 of the motion) fit no chain at any delay, though one may fit better."""
    specimen, table = make_specimen(), table_motion()
    moved = np.roll(floors(specimen, table), 20, axis=1)
    moved = moved + 0.2 * np.roll(moved, 4000, axis=1)
    start = Start(storey_values(specimen.K), np.array([0.043, 0.039]))
    assert skew([Motion(table, moved)], DT, specimen.masses_kg, 0.5, start) == (0.0, 0.0)
