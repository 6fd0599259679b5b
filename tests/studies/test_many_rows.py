"""Rows of a large study: memory per row when planned and tabulated, and the table that comes out."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from campaigns.synthetic_study import Tabulated, one_point, tabulate

from rths_cli.files import sweep_file

ROWS = 6_400
MOST_BYTES_PER_ROW = 700  # a million rows and the process itself then stay below 1 GB


def test_memory_grows_by_less_than_1_gb_per_million_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_file, "BATCH_VALUES", ROWS)
    alone = one_point()
    tabulate(80, tmp_path, alone)  # imports
    peaks = {}
    for rows in (ROWS // 4, ROWS):
        tracemalloc.start()
        found = tabulate(rows, tmp_path, alone)
        peaks[rows] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    grown = (peaks[ROWS] - peaks[ROWS // 4]) / (ROWS - ROWS // 4)
    assert grown < MOST_BYTES_PER_ROW, f"{grown:.0f} bytes per row"
    agree(found)


def agree(found: Tabulated) -> None:
    """The table that is read is the one that was written, and a row in it that of the plan."""
    plan, sweep = found.plan, found.sweep
    assert plan.variants == len(sweep.seed) == ROWS
    for variant in (0, 7, ROWS - 1):
        values = dict(zip((axis.key for axis in plan.axes), plan.values(variant // 2), strict=True))
        assert {key: column[variant] for key, column in sweep.varied.items()} == values
    figure = sweep.figures["exp_rths.tracking_rms_m_s2"].values
    friction = np.asarray(sweep.varied["table.after_identification.coulomb_factor"])
    assert np.isnan(figure[::10]).all() and figure[11] == 2 * friction[11]
    assert f"Of {ROWS} runs: {ROWS * 9 // 10} complete (90 %), {ROWS // 10} refused (10 %)." in found.text
