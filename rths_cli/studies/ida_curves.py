"""What an incremental dynamic analysis says of itself, which runs a hunt plays next, and what follows from its sweep:
response curves, fractiles, outcomes of its limits."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rths_cli.analysis.fragility import Fragility, of_capacities, of_stripes
from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.files.sweep_file import Sweep
    from rths_cli.numerics.lti import Array
    from rths_cli.studies.grid_points import Points
    from rths_cli.studies.sweep_table import Table

FILE, COMPONENT, LEVEL = "record.file", "record.component", "record.scale_to.value"
SIM, RUN = "sim", "exp_rths"
FRACTILES = (16, 50, 84)
ABOUT = "ida"  # attribute of the file


@dataclass(frozen=True)
class Limit:
    """A limit on a response: its name as it was typed, the last part of the metric's path, the value."""

    name: str
    metric: str
    value: float


@dataclass(frozen=True)
class About:
    """What a file says of its analysis: measure with its unit and, for `sa_t1`, the first period in s (else 0)."""

    measure: str
    unit: str
    period_s: float
    limits: tuple[Limit, ...]
    runs: tuple[str, ...]
    hunt: bool


def as_data(about: About) -> dict[str, Any]:
    """Return it as JSON holds it."""
    limits = [[one.name, one.metric, one.value] for one in about.limits]
    return {**vars(about), "limits": limits, "runs": list(about.runs)}


def about_of(attributes: Mapping[str, Any]) -> About | None:
    """Return what a sweep's file says of an incremental dynamic analysis, None of another sweep or where it is
    damaged."""
    try:
        data = json.loads(str(attributes[ABOUT]))
        limits = tuple(Limit(str(name), str(metric), float(value)) for name, metric, value in data.pop("limits"))
        return About(**{**data, "limits": limits, "runs": tuple(data["runs"])})
    except (KeyError, TypeError, ValueError):
        return None


def hunt(points: Points, rows: Table) -> NDArray[np.int64]:
    """Return the next run of every record that has not all its limits between two neighbouring levels yet."""
    plan, about = points.plan, about_of(points.planned.about)
    assert about is not None
    levels = plan.lengths[-1]
    run, found = about.runs[0], rows.figures
    played = np.zeros(plan.points, dtype=bool)
    played[rows.played] = True
    complete = np.array(rows.texts["status"]) == "complete"
    next_ones: set[int] = set()
    for limit in about.limits:
        response = _largest(found[f"{run}.{limit.metric}"])
        ended = (response > limit.value) | ~np.isfinite(response) | ((run == RUN) & ~complete)
        for first in range(0, plan.points, levels):
            record = slice(first, first + levels)
            place = _next(played[record], ended[record])
            next_ones |= set() if place is None else {first + place}
    one_a_record = {number // levels: number for number in sorted(next_ones, reverse=True)}
    return np.array(sorted(one_a_record.values()), dtype=np.int64)


def _next(played: NDArray[np.bool_], ended: NDArray[np.bool_]) -> int | None:
    """Return the level (l,) to run next: up in growing steps, then halfway in the gap; None where nothing is left."""
    above = np.flatnonzero(played & ended)
    top = above[0] if above.size else len(played)
    below = np.flatnonzero(played[:top])
    last = int(below[-1]) if below.size else -1
    if above.size:
        return None if top - last <= 1 else (last + int(top)) // 2
    return None if last == len(played) - 1 else min(last + max(int(played.sum()), 1), len(played) - 1)


def _largest(values: Array) -> Array:
    """Return the largest magnitude over the storeys (n,) of a metric (n,) or (n, n_storeys); NaN without one."""
    rows = np.abs(values.reshape(len(values), -1))
    known = np.isfinite(rows).any(axis=1)
    return np.where(known, np.where(np.isfinite(rows), rows, -np.inf).max(axis=1), np.nan)


@dataclass(frozen=True)
class Curves:
    """One response of one run over records (r,) and levels (l,): `response` (r, l), NaN where none was computed;
    `row` (r, l) its row in the sweep, -1 where none was asked for."""

    records: tuple[str, ...]
    levels: Array
    response: Array
    row: NDArray[np.int64]

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Return which points (r, l) were asked for and have no response."""
        return np.asarray((self.row >= 0) & ~np.isfinite(self.response))

    def at_levels(self) -> Array:
        """Return the responses (r, l), between levels that were run on straight lines from zero; inf above the last."""
        found = np.full(self.response.shape, np.inf)
        for place, row in enumerate(self.response):
            known = np.isfinite(row)
            x, y = np.concatenate([[0.0], self.levels[known]]), np.concatenate([[0.0], row[known]])
            inside = self.levels <= x[-1]
            found[place, inside] = np.interp(self.levels[inside], x, y)
        return found

    def fractiles(self) -> Array:
        """Return the FRACTILES (3, l) of the response over the records, NaN where one is above all that was run."""
        values = np.percentile(self.at_levels(), FRACTILES, axis=0, method="inverted_cdf")
        return np.where(np.isfinite(values), values, np.nan)


def curves_of(sweep: Sweep, run: str, metric: str) -> Curves:
    """Return the curves of a sweep that `rths ida` played."""
    names = _names(sweep)
    records = tuple(dict.fromkeys(names))
    level = np.asarray(sweep.varied[LEVEL], dtype=float)
    levels = np.unique(level)
    response, row = np.full((len(records), len(levels)), np.nan), np.full((len(records), len(levels)), -1)
    values = _largest(sweep.figures[f"{run}.{metric}"].values)
    for number, (name, at) in enumerate(zip(names, level, strict=True)):
        place = records.index(name), int(np.searchsorted(levels, at))
        row[place] = number
        if run != RUN or sweep.texts["status"][number] == "complete":
            response[place] = values[number]
    return Curves(records, levels, response, row)


def _names(sweep: Sweep) -> list[str]:
    """Return the record of each run by a short name: its file's, with what else tells it from others."""
    from rths_cli.studies.plan import as_text  # pydantic, which a report of results does not need

    keys = [key for key in sweep.varied if key != LEVEL]
    short = [
        " ".join([Path(str(values[0])).stem, *(as_text(value) for value in values[1:])])
        for values in zip(*(sweep.varied[key] for key in keys), strict=True)
    ]
    whole = [" ".join(map(as_text, values)) for values in zip(*(sweep.varied[key] for key in keys), strict=True)]
    return short if len(set(short)) == len(set(whole)) else whole


@dataclass(frozen=True)
class Outcome:
    """What an analysis says of one limit in one run: the fragility, or `why` there is none; how many points exceed the
    limit, and how many are missing; of a hunt the records that reach it, and those that do not."""

    run: str
    limit: Limit
    fragility: Fragility | None
    why: str
    exceeded: int
    missing: int
    censored: int


def outcome_of(curves: Curves, run: str, limit: Limit, hunted: bool) -> Outcome:
    """Return the fragility of one limit, from stripes, or from capacities where the levels were hunted."""
    capacity, above, lost = _capacities(curves, limit.value)
    exceeded = np.where(np.isfinite(curves.response), curves.response > limit.value, np.nan)
    found: Fragility | None = None
    why = ""
    try:
        found = of_capacities(capacity, above, lost) if hunted else of_stripes(curves.levels, exceeded)
    except InputError as error:
        why = str(error)
    counts = int(np.nansum(exceeded)), int(curves.missing.sum()), len(above) if hunted else 0
    return Outcome(run, limit, found, why, *counts)


def _capacities(curves: Curves, limit: float) -> tuple[Array, Array, int]:
    """Return the intensities (m,) at which records reach a limit, straight between levels, those (k,) up to which
    others were run, and how many of all records were refused or stopped before."""
    reached: list[float] = []
    above: list[float] = []
    lost = 0
    for response, missing in zip(curves.response, curves.missing, strict=True):
        known = np.flatnonzero(np.isfinite(response))
        over = known[response[known] > limit]
        below = known[known < over[0]] if over.size else known
        x0, y0 = (curves.levels[below[-1]], response[below[-1]]) if below.size else (0.0, 0.0)
        if over.size:
            reached.append(x0 + (curves.levels[over[0]] - x0) * (limit - y0) / (response[over[0]] - y0))
            continue
        lost += bool(missing.any())
        if below.size:
            above.append(x0)
    return np.array(reached), np.array(above), lost
