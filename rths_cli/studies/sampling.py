"""Draw samples: points of the unit cube, their correlation by a Gaussian copula, and quantiles of distributions.

Latin hypercubes and Sobol sequences are scipy's (`scipy.stats.qmc`), the rows for Sobol indices are SALib's; all depend
on the seed alone. A Gaussian copula (Nelsen, An Introduction to Copulas, 2006, section 2.3) puts correlations in: the
samples become normal variables, are mixed by the Cholesky factor of their correlations, and become samples of the unit
cube again. Their distributions stay what they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.study_schema import (
    LognormalAxis,
    Method,
    NormalAxis,
    Strict,
    TruncatedNormalAxis,
    UniformAxis,
)
from rths_cli.errors import InputError
from rths_cli.studies.sensitivity import index_samples

if TYPE_CHECKING:
    from rths_cli.numerics.lti import Array

INSIDE = 1 - 1e-10  # of the unit interval, about its middle: a quantile at its ends would be infinite


def unit_samples(method: Method, count: int, axes: int, seed: int) -> Array:
    """Return samples (n, axes) in (0, 1); n is `count`, for `sobol_indices` count (axes + 2).

    `count` is a power of 2 for both Sobol methods. Raises InputError where a package for the method is missing.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    if method == "latin_hypercube":
        found = qmc.LatinHypercube(axes, seed=rng).random(count)
    elif method == "sobol":
        found = qmc.Sobol(axes, seed=rng).random_base2(count.bit_length() - 1)
    else:
        found = index_samples(count, axes, rng)
    return np.asarray(0.5 + INSIDE * (found - 0.5))


def normal_correlation(rank: float) -> float:
    """Return the correlation of two normal variables with a rank correlation (Spearman's) of `rank`."""
    return 2.0 * math.sin(math.pi * rank / 6.0)


def correlated(samples: Array, pairs: Mapping[tuple[int, int], float]) -> Array:
    """Return samples (n, axes) of the unit cube with the normal correlations of pairs of axes, the others zero.

    Raises InputError where no variables have these correlations: their matrix is not positive definite.
    """
    from scipy.special import ndtr, ndtri

    matrix = np.eye(samples.shape[1])
    for (first, second), value in pairs.items():
        matrix[first, second] = matrix[second, first] = value
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        least = float(np.linalg.eigvalsh(matrix)[0])
        raise InputError(
            "correlations: no variables are correlated like this: the smallest eigenvalue of the matrix is "
            f"{least:.3g} and must be > 0; weaken a correlation"
        ) from None
    mixed = ndtr(ndtri(samples) @ factor.T)
    return np.asarray(np.clip(mixed, (1 - INSIDE) / 2, (1 + INSIDE) / 2))


def quantiles(of: Strict, shares: Array) -> Array:
    """Return the values (n,) of a distribution below which `shares` (n,) of it lie."""
    from scipy import stats

    if isinstance(of, NormalAxis):
        found = stats.norm(of.mean, of.std).ppf(shares)
    elif isinstance(of, LognormalAxis):
        found = stats.lognorm(math.sqrt(math.log1p(of.cov**2)), scale=of.median).ppf(shares)
    elif isinstance(of, UniformAxis):
        found = of.low + (of.high - of.low) * shares
    else:
        assert isinstance(of, TruncatedNormalAxis)
        ends = (of.low - of.mean) / of.std, (of.high - of.mean) / of.std
        found = stats.truncnorm(*ends, loc=of.mean, scale=of.std).ppf(shares)
    return np.asarray(found, dtype=float)


def chosen(count: int, shares: Array) -> Array:
    """Return which of `count` values, each as likely, the `shares` (n,) of the unit interval stand for."""
    return np.asarray(np.minimum((shares * count).astype(np.int64), count - 1))
