"""Judge one `accept` limit of a case: parse the path (`exp_rths.rms_error_m_s2[3]`), compare value and limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Judged:
    """Hold one limit of a case, the figure it judges (None: not computed) and whether it is met."""

    path: str
    limit: float
    value: float | None
    met: bool


def judge(path: str, limit: float, values: ArrayLike) -> Judged:
    """Judge a figure's values, one or one per storey: the one that the path names, as in `a.b[2]`, or the largest.

    A signed figure is limited either way; one that is not a number does not meet its limit.
    """
    given = np.atleast_1d(np.asarray(values, dtype=float))
    index = place(path)
    if index is not None:
        given = given[index - 1 : index] if index > 0 else given[:0]
    if given.size == 0:
        return Judged(path, limit, None, False)
    value = float(given[np.argmax(np.abs(given))])
    return Judged(path, limit, value, abs(value) <= limit)


def figure(path: str) -> str:
    """Return the path of the figure that a limit's path is about."""
    return path.partition("[")[0]


def place(path: str) -> int | None:
    """Return which of its values a limit's path names, counted from 1; None: no certain one."""
    index = path.partition("[")[2]
    return int(index[:-1]) if index else None
