"""The summary of a sweep over all its runs: shares of how they ended and of the check's verdicts, percentiles of each
metric; text and JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from rths_cli.files.sweep_file import NEEDED, Figure, Sweep
from rths_cli.numerics.lti import Array
from rths_cli.report.numbers import json_value, six_wide, three
from rths_cli.report.text_layout import Cell, Row, Table, render

PERCENTILES = (5, 16, 50, 84, 95)
MOST_METRICS = 10  # printed; with more, those that every sweep has
COLUMN = 9
SMALL = 0.01  # below it four decimals are fewer than three digits


def summary(sweep: Sweep) -> dict[str, Any]:
    """Return the summary for JSON.

    `statuses` and `verdicts`: runs and share of all runs; `metrics`: by path the unit, the number of runs that have it,
    and its percentiles over these, per storey where it has one value for each.
    """
    runs = len(sweep.seed)
    return {
        "runs": runs,
        "statuses": _shares(sweep.texts["status"], runs),
        "verdicts": _shares(sweep.texts.get("verdict", ()), runs),
        "metrics": {path: _of_metric(figure) for path, figure in sweep.figures.items()},
    }


def percentiles(values: Array) -> Array:
    """Return PERCENTILES (5, m) of values (n_runs, m) over the runs that have one, NaN where none has.

    Linear between runs; where some are infinite the lower run's.
    """
    found = np.full((len(PERCENTILES), values.shape[1]), np.nan)
    for column, numbers in enumerate(values.T):
        held = numbers[~np.isnan(numbers)]
        if held.size:
            way = "linear" if np.isfinite(held).all() else "lower"
            found[:, column] = np.percentile(held, PERCENTILES, method=way)  # type: ignore[call-overload]
    return found


def summary_text(sweep: Sweep) -> list[str]:
    """Return the summary of a study as text, nothing for another sweep."""
    if not sweep.study_yaml:
        return []
    found = summary(sweep)
    runs = found["runs"]
    ends = [f"Of {runs} runs: {_told(found['statuses'])}."]
    verdicts = {name: share for name, share in found["verdicts"].items() if name}
    ends += [f"Verdict of the check: {_told(verdicts)}."] if verdicts else []
    whole = len(sweep.figures) <= MOST_METRICS
    shown = {path: figure for path, figure in sweep.figures.items() if whole or path in NEEDED}
    heads = tuple(Cell(f"{share} %") for share in PERCENTILES)
    title = "Percentiles over the runs that have the metric; units as in its name"
    table = Table(
        title, "metric", (len(heads),), COLUMN, (heads,),
        tuple(row for path, figure in shown.items() for row in _rows(path, figure)),
    )  # fmt: skip
    more = [] if whole else ["Percentiles of the other metrics: --json."]
    return ["", *ends, "", render(table), *more]


def _rows(path: str, figure: Figure) -> Iterator[Row]:
    values = figure.values if figure.values.ndim > 1 else figure.values[:, np.newaxis]
    for place, column in enumerate(percentiles(values).T, 1):
        storey = f"[{place}]" if figure.values.ndim > 1 else ""
        yield Row(f"{path}{storey}", tuple(Cell(_shown(one)) for one in column))


def _shown(value: float) -> str:
    """Return a number with three digits at least, "-" for none."""
    return six_wide(value) if math.isfinite(value) and abs(value) >= SMALL else three(value)


def _shares(texts: tuple[str, ...], runs: int) -> dict[str, dict[str, float]]:
    return {name: {"runs": count, "share": count / runs} for name, count in sorted(Counter(texts).items())}


def _told(shares: Mapping[str, Mapping[str, float]]) -> str:
    return ", ".join(f"{one['runs']} {name} ({100 * one['share']:.3g} %)" for name, one in shares.items())


def _of_metric(figure: Figure) -> dict[str, Any]:
    one = figure.values.ndim == 1
    values = figure.values[:, np.newaxis] if one else figure.values
    found = percentiles(values)
    counts = (~np.isnan(values)).sum(axis=0).tolist()
    rows = {str(share): [json_value(x) for x in row] for share, row in zip(PERCENTILES, found, strict=True)}
    return {
        "units": figure.units,
        "runs": counts[0] if one else counts,
        "percentiles": {share: row[0] if one else row for share, row in rows.items()},
    }
