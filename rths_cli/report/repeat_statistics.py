"""Table of mean and scatter over repeats: complete runs of the same case, method, software and rig."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.files.result_reader import Result
from rths_cli.report.group_comparison import (
    PLACE,
    Place,
    Statistics,
    group_name,
    in_order,
    over_runs,
    place_name,
    value_of,
)
from rths_cli.report.numbers import six_wide
from rths_cli.report.text_layout import Cell, Row, Table
from rths_cli.rigs.description import adjective, capabilities_of

HEADS = ("n", "mean", "std", "min", "max", "95 % from", "95 % to")
COLUMN = 9


@dataclass(frozen=True)
class Repeats:
    """The repeated runs of one case."""

    case: str  # name
    where: str  # method and rig in words
    runs: int  # number of results
    ends: dict[str, int]  # number of results by status
    same_seed: int  # results that repeat seed and metrics of another one on a virtual rig, not counted
    seeds: tuple[str, ...]
    figures: dict[Place, Statistics]  # of each metric, over the complete runs that are counted


def repeats(results: Sequence[Result], keys: Sequence[str] = ()) -> list[Repeats]:
    """Return the cases that were run more than once.

    A run with the seed and metrics of another one on a virtual rig is no repeat. Results that differ in one of the
    `--group-by` keys, except the seed, are not repeats of each other: they may be different cases of the same name.
    """
    apart = [key for key in keys if key != "seed"]
    places: dict[tuple[str, ...], list[Result]] = {}
    for result in results:
        where = [value_of(result, key) for key in ("case", *PLACE)]
        places.setdefault((*where, group_name(result, apart)), []).append(result)
    return [_repeats(members) for members in places.values() if len(members) > 1 and len(_once(members)) > 1]


def _repeats(members: Sequence[Result]) -> Repeats:
    once = _once(members)
    a = members[0].attributes
    virtual = adjective(str(a.get("rig_kind", "")))
    where = f"method {a.get('method', '-')}, {virtual}rig {a.get('rig', '-')}"
    ends = Counter(str(result.attributes.get("status", "complete")) for result in members)
    seeds = tuple(dict.fromkeys(value_of(result, "seed") for result in members))
    case = str(a.get("case_name") or "-")
    return Repeats(
        case, where, len(members), dict(sorted(ends.items())), len(members) - len(once), seeds, over_runs(once)
    )


def _once(members: Sequence[Result]) -> list[Result]:
    """Return the results without those on a virtual rig that repeat seed and metrics of another one."""
    found: list[Result] = []
    for result in members:
        alike = [other for other in found if other.attributes.get("seed") == result.attributes.get("seed")]
        can = capabilities_of(str(result.attributes.get("rig_kind", "")))
        if not can.counts_steps or not any(_equal(result, other) for other in alike):
            found.append(result)
    return found


def _equal(one: Result, other: Result) -> bool:
    return one.metrics.keys() == other.metrics.keys() and all(
        np.array_equal(value, other.metrics[path], equal_nan=True) for path, value in one.metrics.items()
    )


def repeats_tables(found: Sequence[Repeats]) -> Iterator[Table]:
    """Yield one table with the statistics of the paper's metrics over repeats; nothing without repeats."""
    if found:
        rows = tuple(row for one in found for row in _rows(one))
        notes = (
            "n: complete runs; std: of one run, over n - 1; 95 %: interval of the mean by Student's distribution, for "
            "runs that scatter independently.",
        )
        title = "Statistics over repeats (m/s^2, test band, measured)"
        yield Table(title, "figure", (1, 4, 2), COLUMN, (tuple(map(Cell, HEADS)),), rows, notes)


def _rows(one: Repeats) -> Iterator[Row]:
    ends = ", ".join(f"{count} {status}" for status, count in one.ends.items())
    twice = f"; {one.same_seed} with the seed and figures of another, counted once" if one.same_seed else ""
    yield Row(f"{one.case}, {one.where}: {ends}{twice}")
    for place in in_order(one.figures):
        found = one.figures[place]
        yield Row(place_name(place), (Cell(str(found.n)), *(Cell(_text(value)) for value in _values(found))))


def _values(found: Statistics) -> tuple[float, ...]:
    return found.mean, found.std, found.minimum, found.maximum, found.low, found.high


def _text(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return six_wide(value) if value >= 0 else f"-{six_wide(-value)}"
