"""Rows of a large study: memory per row when planned and tabulated, and the table that comes out."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from campaigns.synthetic_study import Tabulated, kept_rows, one_point, planned, tabulate, written_parts
from portfolio import parametrize_first

from rths_cli.files import sweep_file
from rths_cli.files.sweep_file import Sweep, rows_path
from rths_cli.report.sweep_page import page
from rths_cli.studies.merge import merge_parts
from rths_cli.studies.sweep_output import take_rows
from rths_cli.studies.sweep_table import Table

T = TypeVar("T")
ROWS = 6_400
MOST_BYTES_PER_ROW = 700  # a million rows and the process itself then stay below 1 GB


@pytest.mark.campaign
def test_memory_grows_by_less_than_1_gb_per_million_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_file, "BATCH_VALUES", ROWS)
    alone = one_point()
    found, grown = growth(lambda rows: partial(tabulate, rows, tmp_path, alone))
    assert grown < MOST_BYTES_PER_ROW, f"{grown:.0f} bytes per row"
    agree(found)


@pytest.mark.campaign
@parametrize_first(1, "count", [2, 8])
def test_parts_are_joined_in_less_memory_than_that(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(sweep_file, "BATCH_VALUES", ROWS)
    alone = one_point()

    def ready(rows: int) -> Callable[[], tuple[Sweep, Path, bool]]:
        paths = written_parts(rows, count, tmp_path, alone)
        return lambda: merge_parts(paths[::-1], tmp_path / "many.h5", True, "test", force=True)

    (merged, written, replaced), grown = growth(ready)
    assert replaced and written == tmp_path / "many.h5"
    assert grown < MOST_BYTES_PER_ROW, f"{grown:.0f} bytes per row"
    agree(Tabulated(planned(ROWS, tmp_path, alone).plan, merged, page(merged, tmp_path / "many.h5")))


@pytest.mark.campaign
def test_kept_rows_are_taken_one_at_a_time(tmp_path: Path) -> None:
    alone = one_point()
    tables: list[Table] = []

    def ready(rows: int) -> Callable[[], None]:
        begun, table = kept_rows(rows, tmp_path, alone)
        tables.append(table)
        rows_path(begun.path).replace(rows_path(tmp_path / f"{rows}.h5"))
        return lambda: take_rows(replace(begun, path=tmp_path / f"{rows}.h5"), table)

    _, grown = growth(ready)
    assert tables[-1].left == 10 and grown < 20, f"{grown:.0f} bytes per row beside the table"


def growth(ready: Callable[[int], Callable[[], T]]) -> tuple[T, float]:
    """Return what a call for ROWS rows returns, and by how many bytes per row the largest memory of it grows."""
    ready(80)()  # imports
    peaks = {}
    for rows in (ROWS // 4, ROWS):
        call = ready(rows)
        tracemalloc.start()
        found = call()
        peaks[rows] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return found, (peaks[ROWS] - peaks[ROWS // 4]) / (ROWS - ROWS // 4)


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
