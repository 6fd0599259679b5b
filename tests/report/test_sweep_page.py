"""The summary of a sweep: per grid point the statistics of hand-made errors, best and worst run, what was not run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rths_cli.files.sweep_file import Figure, Sweep
from rths_cli.report.sweep_page import document, label, page, points_of

TRACKING, STOREYS = "exp_rths.tracking_rms_m_s2", "exp_rths.rms_error_m_s2"
PATH = Path("results/x.h5")


def made(
    varied: dict[str, tuple[object, ...]], seeds: int, statuses: tuple[str, ...], reasons: dict[int, str]
) -> Sweep:
    """Return a sweep whose run k (from 1) errs by k mm/s^2 in tracking, 10 k in storey 1, 5 k in storey 2."""
    runs = np.arange(1.0, len(statuses) + 1) / 1000.0
    runs[[status != "complete" for status in statuses]] = np.nan
    return Sweep(
        {
            "case_name": "x", "rig": "r", "rig_kind": "virtual", "seeds": "0:1", "status": "complete",
            "plan_sha256": "0",
        },
        "", "", seeds, varied, np.arange(len(statuses)) % seeds,
        {"status": statuses, "reason": tuple(reasons.get(k, "") for k in range(len(statuses)))},
        {TRACKING: Figure(runs, "m/s^2", "t"), STOREYS: Figure(np.outer(runs, [10.0, 5.0]), "m/s^2", "s")},
    )  # fmt: skip


def in_mm(errors: dict[str, Any]) -> dict[str, list[float | None]]:
    """Return statistics in mm/s^2, rounded."""
    flat = {name: [found[TRACKING], *found[STOREYS]] for name, found in errors.items()}
    return {name: [None if one is None else round(1e3 * one, 9) for one in found] for name, found in flat.items()}


def test_each_point_has_the_statistics_of_its_runs_that_reached_the_end() -> None:
    statuses = ("complete",) * 5 + ("complete", "refused", "aborted", "complete", "complete")
    sweep = made({"scaling": (0.2,) * 5 + (0.3,) * 5}, 5, statuses, {6: "unsafe: a", 7: "stopped"})
    first, second = document(sweep, PATH)["points"]
    assert first["varied"] == {"scaling": 0.2} and first["runs"] == {"complete": 5}
    assert in_mm(first["errors"]) == {"median": [3, 30, 15], "95 %": [4.8, 48, 24], "largest": [5, 50, 25]}
    assert second["runs"] == {"complete": 3, "refused": 1, "aborted": 1}
    assert in_mm(second["errors"])["largest"] == [10, 100, 50]
    assert in_mm(second["errors"])["median"] == [9, 90, 45]  # of runs 6, 9, 10
    text = page(sweep, PATH)
    assert "scaling=0.3: 1 aborted, 3 complete, 1 refused" in " ".join(text.replace("|", " ").split())
    assert "smallest error: 10.000 mm/s^2 (storey 1) at scaling=0.2, seed 0, run 1" in text
    assert "largest error: 100.00 mm/s^2 (storey 1) at scaling=0.3, seed 4, run 10" in text
    assert "1 refused: unsafe: a" in text and "1 aborted: stopped" in text
    assert max(len(line) for line in text.splitlines()) <= 100
    table = [line for line in text.splitlines() if line.endswith("|")]
    assert len({len(line) for line in table}) == 1


def test_one_run_of_a_point_is_one_line() -> None:
    sweep = made({"k": (1, 2)}, 1, ("complete", "refused"), {1: "unsafe"})
    lines = [line.replace("|", " ").split() for line in page(sweep, PATH).splitlines()]
    assert ["k=1", "1.0000", "10.000", "5.0000"] in lines
    assert any(line[:1] == ["k=2"] and "refused" in line for line in lines)


def test_nothing_played_is_told_without_figures() -> None:
    sweep = made({}, 2, ("refused", "refused"), {0: "unsafe", 1: "unsafe"})
    text = page(sweep, PATH)
    assert "2 refused: unsafe" in text and "smallest" not in text
    assert document(sweep, PATH)["points"] == [{"varied": {}, "runs": {"refused": 2}, "errors": {}}]
    json.dumps(document(sweep, PATH), allow_nan=False)


def test_a_storey_that_a_building_has_not_is_no_number_in_json() -> None:
    sweep = made({}, 2, ("complete", "complete"), {})
    sweep.figures[STOREYS].values[:, 1] = np.nan
    assert in_mm(document(sweep, PATH)["points"][0]["errors"])["median"] == [1.5, 15, None]
    assert "smallest error: 10.000 mm/s^2 (storey 1) at seed 0" in page(sweep, PATH)


def test_many_points_are_cut_and_the_rest_is_counted() -> None:
    sweep = made({"k": tuple(range(45))}, 1, ("complete",) * 45, {})
    text = page(sweep, PATH)
    assert "5 more grid points" in text and "k=39 " in text and "k=40 " not in text
    assert len(list(points_of(sweep))) == 45


@pytest.mark.parametrize(
    ("varied", "text"),
    [
        ({}, "the case as it is"),
        ({"scaling": 1 / 3}, "scaling=0.333333"),
        ({"table.physics.coulomb_n": 0.9}, "coulomb_n=0.9"),
        ({"kalman.q": 1, "q": 2}, "kalman.q=1, q=2"),
        ({"a.b.c": 1, "d.b.c": 2, "e.c": 3}, "a.b.c=1, d.b.c=2, e.c=3"),
        ({"controller": {"kind": "FF"}, "m": "best"}, "controller={kind: FF}, m=best"),
    ],
)
def test_a_point_is_named_by_the_ends_of_its_keys(varied: dict[str, object], text: str) -> None:
    assert label(varied) == text


def test_a_sweep_of_a_scaled_model_states_its_scale() -> None:
    plain_one = made({"scaling": (0.2, 0.3)}, 1, ("complete",) * 2, {})
    scale = {"scale_length": 4.0, "scale_acceleration": 1.0, "scale_mass": 16.0}
    scaled = replace(plain_one, attributes=plain_one.attributes | scale)
    varied = replace(scaled, varied={"scale.length": (2.0, 4.0)})
    assert "Model scale; prototype over model: length 4, time 2," in page(scaled, PATH)
    assert document(scaled, PATH)["scale"]["factors"]["time"] == 2.0
    assert "Model scale, which the sweep varies" in page(varied, PATH) and "scale" not in document(varied, PATH)
    assert "scale;" not in page(plain_one, PATH) and "scale" not in document(plain_one, PATH)
