"""Sobol indices of the figures of a study that was sampled for them (`samples.method: sobol_indices`), by SALib."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.errors import InputError

if TYPE_CHECKING:
    from rths_cli.numerics.lti import Array

INSTALL = "pip install 'rths-cli[studies]'"
RESAMPLES = 100  # of the bootstrap: an uncertainty is then known to 7 %
WITHIN_ONE_ERROR = 0.6826894921370859  # level of confidence whose half width is one standard error


@dataclass(frozen=True)
class SobolIndices:
    """First-order and total indices (n_axes,) of one figure, each with its standard error (n_axes,)."""

    first: Array
    total: Array
    first_error: Array
    total_error: Array


def index_samples(count: int, axes: int, rng: np.random.Generator) -> Array:
    """Return samples (count (axes + 2), axes) of the unit cube from which Sobol indices are estimated.

    Of each of `count` base samples the row of A, for each axis that row with the axis from B, and the row of B; A and B
    are the halves of one scrambled Sobol sequence (Saltelli et al., Computer Physics Communications 181, 2010, table
    2). Raises InputError where SALib is not installed.
    """
    sampler, _ = _salib()
    return np.asarray(sampler.sample(_problem(axes), count, calc_second_order=False, seed=rng))


def sobol_indices(figures: Array, axes: int, seed: int = 0) -> SobolIndices:
    """Return the indices of a figure, given (count (axes + 2),) in the order of `index_samples`.

    The estimators are those of Saltelli et al. (2010). The standard errors are those of a bootstrap over the `count`
    base samples, which takes them for independent: for a Sobol sequence it is too large rather than too small. Raises
    InputError for a run without a figure, a figure that never changes, or where SALib is not installed.
    """
    count, rest = divmod(len(figures), axes + 2)
    if rest or count < 2:
        raise InputError(f"Sobol indices of {axes} axes need a multiple of {axes + 2} runs, got {len(figures)}")
    missing = int(np.count_nonzero(~np.isfinite(figures)))
    if missing:
        raise InputError(f"Sobol indices need the figure of every run, {missing} of {len(figures)} have none")
    if np.ptp(figures) == 0:
        raise InputError("Sobol indices need a figure that changes, this one is the same in every run")
    _, analyzer = _salib()
    found = analyzer.analyze(
        _problem(axes),
        figures,
        calc_second_order=False,
        num_resamples=RESAMPLES,
        conf_level=WITHIN_ONE_ERROR,
        seed=seed + 1,  # 0 is no seed to SALib
    )
    return SobolIndices(*(np.asarray(found[name]) for name in ("S1", "ST", "S1_conf", "ST_conf")))


def _problem(axes: int) -> dict[str, Any]:
    """Return the unit cube as SALib describes it."""
    return {"num_vars": axes, "names": [f"axis {k + 1}" for k in range(axes)], "bounds": [[0.0, 1.0]] * axes}


def _salib() -> tuple[Any, Any]:
    """Return SALib's sampler and analyser of Sobol indices; raises InputError where it is not installed."""
    try:
        from SALib.analyze import sobol as analyzer
        from SALib.sample import sobol as sampler
    except ImportError as error:
        raise InputError(f"Sobol indices: the package SALib is missing; install it: {INSTALL}") from error
    return sampler, analyzer
