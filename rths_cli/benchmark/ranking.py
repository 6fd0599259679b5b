"""The order of a benchmark's compensators, with its confidence."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.benchmark.campaign import Benchmarked, BenchmarkRow
from rths_cli.benchmark.displacement import SAFE
from rths_cli.numerics.lti import Array

RANKED = "error_percent"
CONFIDENCE = 0.95
ROUNDING = 1e-6  # of an error in %


@dataclass(frozen=True)
class Standing:
    """A compensator in the order of a benchmark.

    `error_percent`: mean over cases and plants of the error of the displacement itself, `half_percent` half of its
    95 % interval over the plants (NaN: one plant). `rank` is shared with the first of that rank where the difference
    from it, on the same plants with the same noise, is not significant. Those with a `failed` run come last.
    """

    compensator: str
    rank: int
    error_percent: float
    half_percent: float
    tracking_percent: float
    worst_percent: float
    failed: int
    runs: int
    verdict: str


def standings(made: Benchmarked) -> list[Standing]:
    """Return the compensators, the best first; those of which a run failed come last."""
    labels = [one.label for one in made.bench.spec.compensators]
    of = {label: [row for row in made.rows if row.compensator == label] for label in labels}
    by_plant = {label: _by_plant(of[label], RANKED) for label in labels}
    failed = {label: sum(map(has_failed, of[label])) for label in labels}
    order = sorted(labels, key=lambda label: (failed[label] > 0, _or_inf(_mean(by_plant[label])), failed[label]))
    found: list[Standing] = []
    first = order[0]
    for place, label in enumerate(order):
        tied = place > 0 and not failed[label] and _same(by_plant[label] - by_plant[first])
        first = first if tied else label
        found.append(Standing(
            label, found[-1].rank if tied else place + 1, _mean(by_plant[label]), half_interval(by_plant[label]),
            _mean(_by_plant(of[label], made.bench.tracked)), float(np.max([row.figures[RANKED] for row in of[label]])),
            failed[label], len(of[label]), verdict(of[label], label in made.adapting),
        ))  # fmt: skip
    return found


def has_failed(row: BenchmarkRow) -> bool:
    """Return whether a run diverged, was refused, or is one of an unstable loop that only the limit of the force
    holds."""
    return is_diverged(row) or row.figures["radius"] > SAFE


def is_diverged(row: BenchmarkRow) -> bool:
    """Return whether a run ended before its record."""
    return math.isnan(row.figures[RANKED])


def verdict(rows: Sequence[BenchmarkRow], adapts: bool) -> str:
    """Return what the linear loop, within the limits, says of the plants that were run."""
    radii = np.array([row.figures["radius"] for row in rows])
    if np.isnan(radii).any():
        return "not judged"
    unstable = int(np.sum(radii > SAFE))
    if unstable:
        return f"unstable in {unstable} of {len(rows)}"
    return "safe at its start, adapts" if adapts else "safe"


def contradicted(rows: Iterable[BenchmarkRow], adapting: frozenset[str]) -> list[BenchmarkRow]:
    """Return the runs that diverged although their linear loop is stable."""
    diverged = (row for row in rows if is_diverged(row) and not row.outcome)
    return [row for row in diverged if row.figures["radius"] <= SAFE and row.compensator not in adapting]


def _by_plant(rows: Sequence[BenchmarkRow], name: str) -> Array:
    """Return the mean of a figure over the cases, (plants,)."""
    plants = sorted({row.plant for row in rows})
    return np.array([np.mean([row.figures[name] for row in rows if row.plant == plant]) for plant in plants])


def _or_inf(value: float) -> float:
    return math.inf if math.isnan(value) else value


def _mean(values: Array) -> float:
    return float(np.mean(values))


def half_interval(values: Array) -> float:
    """Return half of the 95 % interval of the mean of values (n,) by Student's t, NaN for fewer than two."""
    from scipy.stats import t

    if len(values) < 2:
        return math.nan
    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, len(values) - 1) * np.std(values, ddof=1) / math.sqrt(len(values)))


def _same(difference: Array) -> bool:
    """Return whether the mean of a difference in % is not significant, or is one of rounding."""
    return len(difference) > 1 and abs(_mean(difference)) <= max(half_interval(difference), ROUNDING)
