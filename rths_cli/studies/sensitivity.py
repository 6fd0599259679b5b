"""Sobol indices of the figures of a study that was sampled for them (`samples.method: sobol_indices`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.numerics.lti import Array

RESAMPLES = 200  # an uncertainty is then known to 5 %


@dataclass(frozen=True)
class SobolIndices:
    """First-order and total indices (n_axes,) of one figure, each with its standard error (n_axes,)."""

    first: Array
    total: Array
    first_error: Array
    total_error: Array


def sobol_indices(figures: Array, axes: int, seed: int = 0) -> SobolIndices:
    """Return the indices of a figure, given (count (axes + 2),) in the order of `sampling.unit_samples`.

    The estimators are scipy's (Saltelli et al., Computer Physics Communications 181, 2010). The standard errors are
    those of a bootstrap over the `count` base samples, which takes them for independent: for a Sobol sequence it is
    too large rather than too small. Raises InputError for a run without a figure, or a figure that never changes.
    """
    count, rest = divmod(len(figures), axes + 2)
    if rest or count < 2 or count & (count - 1):
        raise InputError(f"Sobol indices of {axes} axes need a power of 2 times {axes + 2} runs, got {len(figures)}")
    missing = int(np.count_nonzero(~np.isfinite(figures)))
    if missing:
        raise InputError(f"Sobol indices need the figure of every run, {missing} of {len(figures)} have none")
    if np.ptp(figures) == 0:
        raise InputError("Sobol indices need a figure that changes, this one is the same in every run")
    blocks = figures.reshape(axes + 2, count)
    rng = np.random.default_rng(seed)
    drawn = [_indices(blocks[:, rng.integers(count, size=count)]) for _ in range(RESAMPLES)]
    first_error, total_error = np.std(drawn, axis=0, ddof=1)
    return SobolIndices(*_indices(blocks), first_error, total_error)


def _indices(blocks: Array) -> tuple[Array, Array]:
    """Return first-order and total indices (n_axes,) of the figures of A, B and A with each axis of B, (n_axes + 2,
    count)."""
    from scipy import stats

    evaluated = {"f_A": blocks[0:1], "f_B": blocks[1:2], "f_AB": blocks[2:, np.newaxis]}
    found = stats.sobol_indices(func=evaluated, n=blocks.shape[1])
    return np.ravel(found.first_order), np.ravel(found.total_order)
