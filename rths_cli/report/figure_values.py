"""Values of figures with their intervals: as text for a table or list, and as plain numbers for JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.quantities import Interval


def listed(value: ArrayLike, interval: Interval | None, as_text: Callable[[float], str], between: str = " ") -> str:
    """Return the numbers of a figure as text, each with its interval in brackets, then the probability in percent."""
    texts = [as_text(item) for item in np.atleast_1d(np.asarray(value, dtype=float))]
    if interval is None:
        return between.join(texts)
    ends = ([_end(item, as_text) for item in np.atleast_1d(end)] for end in (interval.low, interval.high))
    bracketed = (f"{text} [{low}, {high}]" for text, low, high in zip(texts, *ends, strict=True))
    return f"{between.join(bracketed)} ({percent(interval.probability)})"


def _end(value: float, as_text: Callable[[float], str]) -> str:
    return ("-inf" if value < 0.0 else "inf") if math.isinf(value) else as_text(value)


def percent(probability: float) -> str:
    """Return a probability in whole percent, rounded down: a statement that claims no more than is known."""
    return f"{math.floor(round(100.0 * probability, 6))} %"


def json_value(value: object) -> Any:
    """Return a number or a list of numbers, with None for each that is not finite."""
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim:
        return [json_value(item) for item in numbers]
    return float(numbers) if np.isfinite(numbers) else None


def intervals_json(intervals: Mapping[str, Interval]) -> dict[str, dict[str, Any]]:
    """Return the ends and the probability of intervals by path; an end that is not finite is None."""
    return {
        path: {"low": json_value(one.low), "high": json_value(one.high), "probability": one.probability}
        for path, one in intervals.items()
    }
