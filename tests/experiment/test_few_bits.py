"""The error of a motion of a few bits is predicted, and its bound holds (short form of benchmarks/few_bits.py)."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest
from campaigns.few_bits import laboratory, summary

SHORT = 1, 5  # a laboratory of 15 bits, and how many of its tests


@pytest.mark.campaign
def test_a_motion_of_a_few_bits_is_predicted_and_its_bound_holds(tmp_path: Path) -> None:
    rows = list(islice(laboratory(SHORT[0], tmp_path), SHORT[1]))
    played = [row for row in rows if not row.refused]
    assert len(played) >= 3, [row.refused for row in rows]
    assert all(row.right and row.true_over_bound < 1.0 for row in played), summary(rows)
    assert max(row.size for row in played) > 0.1  # a motion that its converters hardly show
