"""Judge one `accept` limit of a case: parse the path (`exp_rths.rms_error_m_s2[3]`), compare value and limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.quantities import METRICS


@dataclass(frozen=True)
class Judged:
    """One limit of a case, judged."""

    path: str  # of the metric, as in the case's `accept`, with an index if stated
    limit: float  # in the metric's unit
    value: float | None  # value of the metric that was compared; None: not computed
    met: bool


def judge(path: str, limit: float, values: ArrayLike) -> Judged:
    """Judge a metric against its limit; `values`: one number, or one per storey (n_storeys,).

    If the path states an index, as in `a.b[2]`, that value is compared, else the one with the largest absolute value.
    The absolute value is compared, so a signed metric is limited in both directions. A limit is not met if the value is
    NaN or the index does not exist. Of a metric that not every storey has, those that have it count.
    """
    given = np.atleast_1d(np.asarray(values, dtype=float))
    declared = METRICS.get(figure(path))
    index = place(path)
    if index is not None:
        given = given[index - 1 : index] if index > 0 else given[:0]
    elif declared is not None and declared.partial and not np.isnan(given).all():
        given = given[~np.isnan(given)]
    if given.size == 0:
        return Judged(path, limit, None, False)
    value = float(given[np.argmax(np.abs(given))])
    return Judged(path, limit, value, abs(value) <= limit)


def figure(path: str) -> str:
    """Return the path of the metric that a limit's path names, without the index."""
    return path.partition("[")[0]


def place(path: str) -> int | None:
    """Return the index in a limit's path, counted from 1; None if it states none."""
    index = path.partition("[")[2]
    return int(index[:-1]) if index else None
