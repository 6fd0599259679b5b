"""Figures over runs of one case: how many, mean, spread, and how well the mean is known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

COVERED = 0.95


@dataclass(frozen=True)
class Statistics:
    """Hold number of runs, mean, standard deviation (of one run, n - 1), smallest, largest, and the 95 % interval of
    the mean; deviation and interval are NaN for one run."""

    n: int
    mean: float
    std: float
    minimum: float
    maximum: float
    low: float
    high: float


def statistics(values: Sequence[float]) -> Statistics:
    """Return the statistics of values, one at least; the interval is Student's: mean +- t std / sqrt(n)."""
    n = len(values)
    mean = math.fsum(values) / n
    if n == 1:
        return Statistics(1, mean, math.nan, values[0], values[0], math.nan, math.nan)
    std = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (n - 1))
    half = student(n - 1) * std / math.sqrt(n)
    return Statistics(n, mean, std, min(values), max(values), mean - half, mean + half)


@lru_cache(maxsize=256)
def student(freedom: int) -> float:
    """Return t within which Student's distribution of `freedom` degrees holds 95 %, found by bisection to rounding."""
    low, high = 0.0, 16.0
    while (middle := 0.5 * (low + high)) not in (low, high):
        low, high = (middle, high) if _within(middle, freedom) < COVERED else (low, middle)
    return middle


def _within(t: float, freedom: int) -> float:
    """Return the probability of |T| < t. Source: Abramowitz and Stegun, 26.7.3 and 26.7.4."""
    angle = math.atan(t / math.sqrt(freedom))
    square, odd = math.cos(angle) ** 2, freedom % 2
    term = math.cos(angle) if odd else 1.0
    total = 0.0
    for k in range(freedom // 2):
        total += term
        term *= square * ((2 * k + 2) / (2 * k + 3) if odd else (2 * k + 1) / (2 * k + 2))
    return 2.0 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total
