"""`Interval`: a metric's value with the interval that holds it with a stated probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from rths_cli.quantities.declaration import Values


@dataclass(frozen=True, eq=False)
class Interval:
    """A metric's value, and the interval from `low` to `high` that holds the true one with at least `probability`.

    The three have the shape of the metric, a number or one per storey, mode, ...; `high` is infinite where nothing is
    known to limit it, both ends are NaN where nothing is known. As an array it is its value, so that whatever takes a
    value of a metric takes an interval too.
    """

    value: ArrayLike
    low: ArrayLike
    high: ArrayLike
    probability: float

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[np.float64]:
        """Return the value."""
        return np.array(self.value, dtype=dtype or np.float64)


def coverage(samples: int) -> float:
    """Return the probability with which the range of a number of equally likely samples holds a further one.

    Of n + 1 equally likely values each is the smallest, or the largest, with the probability 1 / (n + 1): the range
    of n of them leaves out the last one with 2 / (n + 1), whatever their distribution.
    """
    return (samples - 1) / (samples + 1)


def over_samples(values: Values, samples: Sequence[Values]) -> dict[str, ArrayLike]:
    """Return values with the range of each over themselves and the same values of equally likely samples.

    A value that is the same in every sample stays as it is, and so do all without samples. A NaN among the samples
    makes the ends NaN. Raises KeyError for a sample that lacks a value.
    """
    found: dict[str, ArrayLike] = {}
    for path, value in values.items():
        every = np.array([np.asarray(each, dtype=float) for each in (value, *(sample[path] for sample in samples))])
        same = np.array_equal(every, np.broadcast_to(every[0], every.shape), equal_nan=True)
        ends = every.min(axis=0), every.max(axis=0)
        found[path] = value if same else Interval(value, *ends, coverage(len(samples)))
    return found


def intervals_of(values: Values) -> dict[str, Interval]:
    """Return those of the values that carry an interval, by path."""
    return {path: value for path, value in values.items() if isinstance(value, Interval)}
