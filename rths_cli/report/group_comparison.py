"""`--group-by`: means and ratios of groups of results as tables; statistics, also for repeats."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result
from rths_cli.report.numbers import six_wide
from rths_cli.report.text_layout import Cell, Row, Table
from rths_cli.rigs.description import adjective

COVERED = 0.95  # probability of the confidence interval


@dataclass(frozen=True)
class Statistics:
    """Statistics of a metric over runs."""

    n: int  # number of runs
    mean: float
    std: float  # standard deviation of one run, with n - 1; NaN for one run
    minimum: float
    maximum: float
    low: float  # lower end of the 95 % confidence interval of the mean; NaN for one run
    high: float  # upper end


def statistics(values: Sequence[float]) -> Statistics:
    """Return the statistics of one or more values; the interval is mean +- t std / sqrt(n), with Student's t."""
    n = len(values)
    mean = math.fsum(values) / n
    if n == 1:
        return Statistics(1, mean, math.nan, values[0], values[0], math.nan, math.nan)
    std = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (n - 1))
    half = student(n - 1) * std / math.sqrt(n)
    return Statistics(n, mean, std, min(values), max(values), mean - half, mean + half)


@cache
def student(freedom: int) -> float:
    """Return t with P(|T| < t) = 95 % for Student's distribution with `freedom` degrees of freedom."""
    from scipy.special import stdtrit  # here: most reports need no statistics

    return float(stdtrit(freedom, 0.5 * (1.0 + COVERED)))


NAMES = {
    "case": "case_name",
    "controller": "controller",
    "damping": "damping_name",
    "method": "method",
    "record": "record_name",
    "rig": "rig",
    "rig_kind": "rig_kind",
    "scaling": "scaling",
    "seed": "seed",
}
MADE: dict[str, Callable[[Result], str]] = {
    "folder": lambda result: str(result.path.parent),
    "software": lambda result: software(result),
}
NAMING = {"case_name", "controller", "damping_name", "record_name", "rig", "scaling"}  # another one, another case name
PLACE = ("rig", "rig_kind", "record", "scaling", "damping", "controller", "method", "software")
SHOWN = (
    "shake_table.tracking_max_m_s2",
    "shake_table.tracking_rms_m_s2",
    "exp_rths.tracking_max_m_s2",
    "exp_rths.tracking_rms_m_s2",
    "sim_delay.rms_error_m_s2",
    "exp_rths.rms_error_m_s2",
)
OTHERS = 2  # groups beside the first one in a table of text
COLUMN = 12
Place = tuple[str, int | None]


@dataclass(frozen=True)
class Compared:
    """Results that agree in all keys but those of the groups."""

    where: str  # common values in words
    common: dict[str, str]  # common values by key
    groups: dict[str, tuple[Result, ...]]  # results by name of the group


def software(result: Result) -> str:
    """Return the version of rths that made a result, with the commit if it is known."""
    commit = str(result.attributes.get("git_commit") or "")[:7]
    return f"{result.attributes.get('rths_version') or '-'}{f' {commit}' if commit else ''}"


def value_of(result: Result, key: str) -> str:
    """Return the value of a result for a key of `--group-by`, "-" if it states none."""
    if key in MADE:
        return MADE[key](result)
    value = result.attributes.get(NAMES.get(key, key), "")
    return f"{value:g}" if isinstance(value, float) else str(value) or "-"


def check_keys(keys: Sequence[str], results: Sequence[Result]) -> None:
    """Raise InputError with a sentence for each key that no result states."""
    stated = {name for result in results for name in result.attributes} | NAMES.keys() | MADE.keys()
    unknown = [key for key in keys if key not in stated]
    if unknown:
        known = ", ".join(sorted((*NAMES, *MADE)))
        advice = f"use one of {known}, or an attribute of the result files"
        raise InputError(*(f"--group-by {key}: no result states it; {advice}." for key in unknown))


def group_name(result: Result, keys: Sequence[str]) -> str:
    """Return the name of a result's group, made of its values for the keys."""
    return ", ".join(value_of(result, key) for key in keys)


def compare(results: Sequence[Result], keys: Sequence[str]) -> list[Compared]:
    """Return the results with equal values of the other keys together, by group; also those of a single group."""
    stated = {NAMES.get(key, key) for key in keys}
    rest = [key for key in PLACE if NAMES.get(key, key) not in stated]
    rest += [] if stated & NAMING else ["case"]
    names = dict.fromkeys(group_name(result, keys) for result in results)
    places: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        places.setdefault(tuple(value_of(result, key) for key in rest), []).append(result)
    found = []
    for place, members in places.items():
        common = dict(zip(rest, place, strict=True))
        groups = {name: tuple(r for r in members if group_name(r, keys) == name) for name in names}
        found.append(Compared(_where(common), common, groups))
    return found


def _where(common: dict[str, str]) -> str:
    """Return the common values of results in words."""
    parts = dict(common)
    scaling, kind = parts.pop("scaling", ""), parts.pop("rig_kind", "")
    percent = f"{100 * float(scaling):g} % " if scaling.replace(".", "", 1).isdigit() else ""
    told = []
    for key, value in parts.items():
        if key == "record":
            told.append(percent + value)
        elif key == "rig":
            told.append(f"{adjective(kind)}rig {value}")
        else:
            told.append(f"{key} {value}")
    return ", ".join(told)


def flat(result: Result) -> dict[Place, float]:
    """Return the finite metrics of a result by path and, for metrics with several values, number from 1."""
    found: dict[Place, float] = {}
    for path, value in result.metrics.items():
        values = np.asarray(value, dtype=float)
        if values.ndim == 0:
            found[path, None] = float(values)
        else:
            found |= {(path, number): float(item) for number, item in enumerate(values.ravel(), 1)}
    return {place: item for place, item in found.items() if math.isfinite(item)}


def place_name(place: Place) -> str:
    """Return the name of a metric as in `accept`."""
    return place[0] if place[1] is None else f"{place[0]}[{place[1]}]"


def in_order(found: Iterable[Place]) -> list[Place]:
    """Return the metrics that the tables show, in the order of the paper's tables."""
    return sorted((place for place in found if place[0] in SHOWN), key=lambda p: (SHOWN.index(p[0]), p[1] or 0))


def complete(results: Sequence[Result]) -> list[Result]:
    """Return the results whose runs ended as planned."""
    return [result for result in results if result.attributes.get("status", "complete") == "complete"]


def over_runs(results: Sequence[Result]) -> dict[Place, Statistics]:
    """Return the statistics of each metric over the complete results."""
    values: dict[Place, list[float]] = {}
    for result in complete(results):
        for place, value in flat(result).items():
            values.setdefault(place, []).append(value)
    return {place: statistics(items) for place, items in values.items()}


def group_tables(found: Sequence[Compared], keys: Sequence[str]) -> Iterator[Table]:
    """Yield the comparison as tables: the mean of each group, and its ratio to the first; OTHERS groups per table."""
    names = list(found[0].groups)
    for start in range(1, max(len(names), 2), OTHERS):
        chosen = [names[0], *names[start : start + OTHERS]]
        letters = {
            name: chr(ord("A") + names.index(name)) if len(names) <= 26 else str(1 + names.index(name))
            for name in chosen
        }
        heads = [name if len(name) < COLUMN else letters[name] for name in chosen]
        ratios = [f"{head} / {heads[0]}" if len(head) + len(heads[0]) < COLUMN - 3 else "ratio" for head in heads[1:]]
        told = [f"{letters[name]}: {name}." for name in chosen if len(name) >= COLUMN]
        notes = (
            *told,
            "Mean over the complete runs of a group, ratio of means; * not all runs of the group are complete.",
        )
        cells = tuple(map(Cell, (*heads, *ratios)))
        rows = tuple(row for place in found for row in _rows(place, chosen))
        title = f"Comparison by {', '.join(keys)} (m/s^2, test band, measured)"
        yield Table(title, "figure", (len(heads), *([len(ratios)] if ratios else [])), COLUMN, (cells,), rows, notes)


def _rows(place: Compared, names: Sequence[str]) -> Iterator[Row]:
    runs = [place.groups[name] for name in names]
    means = [over_runs(members) for members in runs]
    counts = ", ".join(str(len(members)) for members in runs)
    yield Row(f"{place.where} (runs: {counts}{_mixed(runs)})")
    wanted = in_order({item for found in means for item in found})
    if not wanted:
        yield Row("no figure", (*(_cell(members, None) for members in runs), *[Cell("-")] * (len(runs) - 1)))
    for item in wanted:
        cells = [_cell(members, found.get(item)) for members, found in zip(runs, means, strict=True)]
        first = means[0].get(item)
        ratios = [Cell(_ratio(found.get(item), first)) for found in means[1:]]
        yield Row(place_name(item), (*cells, *ratios))


def _mixed(runs: Sequence[Sequence[Result]]) -> str:
    """Return a warning if a group contains several cases, whose mean may be meaningless."""
    named = [sorted({value_of(result, "case") for result in members}) for members in runs]
    several = [f"{', '.join(names[:3])}{', ...' if len(names) > 3 else ''}" for names in named if len(names) > 1]
    return f"; several cases in one group: {'; '.join(several)}" if several else ""


def _cell(members: Sequence[Result], found: Statistics | None) -> Cell:
    ended = [str(result.attributes.get("status", "complete")) for result in members]
    other = [status for status in ended if status != "complete"]
    if found is None:
        return Cell(other[0] if other else "-")
    return Cell(six_wide(found.mean), mark="*" if other else " ")


def _ratio(above: Statistics | None, below: Statistics | None) -> str:
    if above is None or below is None or below.mean == 0:
        return "-"
    return six_wide(above.mean / below.mean)
