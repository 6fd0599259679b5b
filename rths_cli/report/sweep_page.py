"""The output of `rths sweep` and `rths report SWEEP`: errors over the seeds of each grid point, failures; text and
JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.files.sweep_file import Sweep
from rths_cli.numerics.lti import Array
from rths_cli.report.numbers import json_value, six_wide
from rths_cli.report.result_scale import MODEL, stored_scale
from rths_cli.report.study_indices import indices_document, indices_text
from rths_cli.report.sweep_metric import STOREYS, as_text, short_key
from rths_cli.report.sweep_summary import summary, summary_text
from rths_cli.report.text_layout import WIDTH, Cell, Row, Table, render, wrapped
from rths_cli.structure.similitude import factors_text

TRACKING = "exp_rths.tracking_rms_m_s2"
STATISTICS = {"median": 50.0, "95 %": 95.0, "largest": 100.0}
POINTS_SHOWN = 40
REASONS_SHOWN = 5
COLUMN = 9
MM_PER_M = 1e3
MOST_STOREYS = (WIDTH - 40) // COLUMN


@dataclass(frozen=True)
class Point:
    """One grid point of a sweep."""

    label: str  # varied values as text
    varied: dict[str, Any]  # varied values by key
    statuses: dict[str, int]  # number of runs by status
    errors: Array  # (n_runs, 1 + n_storeys) RMS errors in m/s^2 of the complete runs: tracking, then each storey


def points_of(sweep: Sweep) -> Iterator[Point]:
    """Yield the grid points of a sweep."""
    size = sweep.seeds_per_point
    table = np.column_stack([sweep.figures[TRACKING].values, sweep.figures[STOREYS].values])
    for start in range(0, len(sweep.seed), size):
        runs = slice(start, start + size)
        varied = {key: values[start] for key, values in sweep.varied.items()}
        whole = np.array([status == "complete" for status in sweep.texts["status"][runs]])
        yield Point(label(varied), varied, dict(Counter(sweep.texts["status"][runs])), table[runs][whole])


def label(varied: dict[str, Any]) -> str:
    """Return varied values as text KEY=VALUE, each key shortened to an end that no other key has."""
    told = [f"{short_key(key, list(varied))}={as_text(value)}" for key, value in varied.items()]
    return ", ".join(told) or "the case as it is"


def statistics(errors: Array) -> dict[str, Array]:
    """Return median, 95 % quantile and largest of errors (n_runs, m), each (m,); {} without runs."""
    if len(errors) == 0:
        return {}
    return {name: np.percentile(errors, share, axis=0) for name, share in STATISTICS.items()}


def page(sweep: Sweep, path: Path) -> str:
    """Return the summary of a sweep as text, of a part how its runs ended."""
    return grid_points(sweep) + page_without_grid_points(sweep, path)


def grid_points(sweep: Sweep) -> str:
    """Return the errors of each grid point of a sweep as text, of a part nothing."""
    if sweep.numbers is not None:
        return ""
    return _text([render(_table(sweep)), *_scale(sweep), *_more_points(sweep)])


def page_without_grid_points(sweep: Sweep, path: Path) -> str:
    """Return what stands below the grid points in the summary of a sweep: extremes, ends, percentiles, indices."""
    if sweep.numbers is not None:
        return _text([_of_part(sweep), *_not_run(sweep), *_explained(sweep, path)])
    told = [*_extremes(sweep), *_not_run(sweep), *summary_text(sweep), *indices_text(sweep), *_explained(sweep, path)]
    return _text(told)


def _text(parts: list[str]) -> str:
    return wrapped([line for part in parts for line in part.split("\n")], 2) + "\n"


def document(sweep: Sweep, path: Path) -> dict[str, Any]:
    """Return the summary of a sweep for JSON: every grid point with its runs and the statistics of its errors.

    Of a part, whose grid points may lack runs, no grid point.
    """
    points = []
    for point in points_of(sweep) if sweep.numbers is None else ():
        found = {
            name: {TRACKING: json_value(row[0]), STOREYS: [json_value(value) for value in row[1:]]}
            for name, row in statistics(point.errors).items()
        }
        points.append({"varied": point.varied, "runs": point.statuses, "errors": found})
    about: dict[str, Any] = {
        name: sweep.attributes[name] for name in ("case_name", "rig", "rig_kind", "seeds", "status", "plan_sha256")
    }
    about |= {} if sweep.numbers is None else {"part": sweep.attributes["part"]}
    scale = stored_scale(sweep.attributes)
    about |= {} if scale is None or _varies(sweep) else {"scale": {"reported_in": MODEL, "factors": scale.factors}}
    indices = indices_document(sweep) if sweep.numbers is None else {}
    about |= {"sobol_indices": indices} if indices else {}
    return {"sweep": str(path), **about, "runs": len(sweep.seed), "summary": summary(sweep), "points": points}


def _scale(sweep: Sweep) -> list[str]:
    """Return the line on the scale of the model, [] where the case states none."""
    scale = stored_scale(sweep.attributes)
    if _varies(sweep):
        return ["Model scale, which the sweep varies: every error is that of the model in the laboratory."]
    return [] if scale is None else [f"Model scale; prototype over model: {factors_text(scale.factors)}."]


def _varies(sweep: Sweep) -> bool:
    return any(key == "scale" or key.startswith("scale.") for key in sweep.varied)


def _of_part(sweep: Sweep) -> str:
    part, case = sweep.attributes["part"], sweep.attributes["case_name"]
    return f"{case}: part {part} of a sweep, {_runs(len(sweep.seed))} of EXP-RTHS; rths merge joins all parts"


def _runs(count: int) -> str:
    return f"{count} run" if count == 1 else f"{count} runs"


def _table(sweep: Sweep) -> Table:
    storeys = sweep.figures[STOREYS].values.shape[1]
    shown = min(storeys, MOST_STOREYS)
    heads = (Cell("tracking"), *(Cell(f"storey {1 + k}") for k in range(shown)))
    rows = [row for _, point in zip(range(POINTS_SHOWN), points_of(sweep), strict=False) for row in _rows(point, shown)]
    title = (
        f"{sweep.attributes['case_name']}: RMS errors (mm/s^2, test band, measured) of {_runs(len(sweep.seed))} of "
        f"EXP-RTHS; virtual shake table {sweep.attributes['rig']}"
    )
    corner = "grid point" if sweep.seeds_per_point == 1 else "over the seeds"
    return Table(title, corner, (1, shown), COLUMN, (heads,), tuple(rows))


def _rows(point: Point, storeys: int) -> Iterator[Row]:
    """Yield the rows of a grid point: one row for a single run, else a heading and a row per statistic."""
    runs = sum(point.statuses.values())
    ends = ", ".join(f"{count} {status}" for status, count in sorted(point.statuses.items()))
    found = statistics(MM_PER_M * point.errors[:, : 1 + storeys])
    if runs == 1:
        yield Row(point.label, _cells(found["largest"]) if found else (Cell(ends[2:], 1 + storeys),))
        return
    yield Row(f"{point.label}: {ends}")
    for name, row in found.items():
        yield Row(name, _cells(row))


def _cells(errors: Array) -> tuple[Cell, ...]:
    return tuple(Cell(six_wide(value) if np.isfinite(value) else "-") for value in errors)


def _more_points(sweep: Sweep) -> list[str]:
    """Return a line if there are more grid points or storeys than shown."""
    points = len(sweep.seed) // sweep.seeds_per_point
    storeys = sweep.figures[STOREYS].values.shape[1]
    lines = [f"{points - POINTS_SHOWN} more grid points stand in the file."] if points > POINTS_SHOWN else []
    return lines + (["More storeys stand in the file."] if storeys > MOST_STOREYS else [])


def _extremes(sweep: Sweep) -> list[str]:
    """Return the lines on the runs with the smallest and the largest error; each run counts by its worst storey."""
    errors = sweep.figures[STOREYS].values
    played = np.flatnonzero(np.isfinite(errors).any(axis=1))
    if played.size < 2:
        return []
    worst = np.nanmax(errors[played], axis=1)
    lines = [""]
    for name, place in (("smallest", int(np.argmin(worst))), ("largest", int(np.argmax(worst)))):
        run = int(played[place])
        varied = {key: values[run] for key, values in sweep.varied.items()}
        where = f"{label(varied)}, seed {sweep.seed[run]}" if varied else f"seed {sweep.seed[run]}"
        storey = 1 + int(np.nanargmax(errors[run]))
        lines.append(
            f"{name} error: {six_wide(MM_PER_M * worst[place])} mm/s^2 (storey {storey}) at {where}, run {run + 1}"
        )
    return lines


def _not_run(sweep: Sweep) -> list[str]:
    """Return the lines on runs that are not complete and accepted: number, status and most frequent reasons."""
    ends = Counter(zip(sweep.texts["status"], sweep.texts["reason"], strict=True))
    told = [(status, reason, count) for (status, reason), count in ends.most_common() if reason]
    lines = [f"{count} {status}: {reason}" for status, reason, count in told[:REASONS_SHOWN]]
    more = sum(count for _, _, count in told[REASONS_SHOWN:])
    lines += [f"{more} more with other reasons, which stand in the file"] if more else []
    return ["", *lines] if lines else []


def _explained(sweep: Sweep, path: Path) -> list[str]:
    counts = Counter(sweep.texts["status"])
    ends = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
    return ["", f"{ends}; every run with its figures: {path}"]
