"""Name the fault that explains the channels: swapped or scaled channel, wrong mass, wrong order of floors.

Each fault is a change of the data (channels multiplied or exchanged) or of the masses. The storeys' equations are
solved again with that change (chain_residual.py). A fault is reported only if the declared channels cannot be
explained, the fault explains them, and it is large enough. Faults that explain the channels equally well are reported
together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from operator import itemgetter

import numpy as np

from rths_cli.identification.chain_residual import Explained, Grouped, explained
from rths_cli.numerics.lti import ComplexArray

FITS = 2.0  # largest misfit of a storey, in standard deviations, at which the declared chain is accepted
CURED = 0.4  # a fault explains the channels if it leaves at most this fraction of the misfit
ALIKE = 1.3  # faults with up to this multiple of the least misfit explain the channels equally well
RANGE = (0.3, 3.0)  # tried factors of a mass
# tried factors of a sensitivity, range by range; a channel that is in g where m/s^2 are declared is among them
READINGS = (0.05, 0.3, 3.0, 20.0)
LEAST_REVERSED = 4  # channels; with up to three floors, exchanging two floors already reverses their order
LATEST = 3.0  # tried delays of one channel against the others, in samples, either way
SIGN, GAIN, SWAP, REVERSED, MASS, LATE = "sign", "gain", "swap", "reversed", "mass", "late"


@dataclass(frozen=True)
class Suspect:
    """A possible fault of channels or of floor masses."""

    kind: str
    channels: tuple[int, ...]  # indices of the channels concerned, 0 for the table; of a mass, the floor's channel
    size: float  # reading over true value, true over given mass, or delay of a channel in samples
    misfit: float  # rms of the storeys' residuals over their standard deviation if this fault is assumed


@dataclass(frozen=True)
class Diagnosis:
    """Whether the declared channels fit a chain, and the single faults that would explain them if they do not."""

    misfit: float  # of the channels as declared
    fits: bool  # whether the declared channels fit
    suspects: tuple[Suspect, ...]  # faults that explain the channels equally well, the best first; () if none does


def diagnose(chain: Grouped, dt_s: float) -> Diagnosis:
    """Return the single faults that explain grouped lines, if a chain with the given masses does not explain them."""
    declared = explained(chain)
    misfit = _misfit(declared)
    if float(declared.misfit.max(initial=0.0)) < FITS:
        return Diagnosis(misfit, True, ())
    tried = sorted((*_whole(chain), *_sized(chain, dt_s)), key=lambda suspect: suspect.misfit)
    best = tried[0].misfit
    if best > CURED * misfit:
        return Diagnosis(misfit, False, ())
    return Diagnosis(misfit, False, tuple(each for each in tried if each.misfit <= ALIKE * best))


def _misfit(found: Explained) -> float:
    """Return the rms, over all storeys, of the residuals over their standard deviation."""
    return float(np.sqrt(found.chi_square.sum() / found.count.sum()))


def _whole(chain: Grouped) -> Iterator[Suspect]:
    """Yield the faults without a size, each with its misfit: reversed signs, exchanged channels, reversed order."""
    count = len(chain.accel)
    for index in range(count):
        yield Suspect(
            SIGN, (index,), -1.0, _misfit(explained(chain.multiplied(_only(count, index, -1.0)), errors=False))
        )
    for pair in combinations(range(count), 2):
        order = list(range(count))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        yield Suspect(SWAP, pair, 1.0, _misfit(explained(chain.permuted(order), errors=False)))
    if count > LEAST_REVERSED:
        order = [0, *range(count - 1, 0, -1)]
        yield Suspect(REVERSED, tuple(range(1, count)), 1.0, _misfit(explained(chain.permuted(order), errors=False)))


def _sized(chain: Grouped, dt_s: float) -> Iterator[Suspect]:
    """Yield the faults with a size (sensitivity, delay, mass), each with the size that leaves the least misfit.

    Masses are tried for two floors or more: with one floor its mass only scales the stiffness.
    """
    count = len(chain.accel)
    factors = float(np.log(RANGE[0])), float(np.log(RANGE[1]))
    readings = list(pairwise(np.log(READINGS).tolist()))
    for at in range(count):
        size, left = min((_least(partial(_reading, chain, at), bounds) for bounds in readings), key=itemgetter(1))
        yield Suspect(GAIN, (at,), float(np.exp(size)), left)
        yield Suspect(LATE, (at,), *_least(partial(_late, chain, at, dt_s), (-LATEST, LATEST)))
    for at in range(1, count) if count > 2 else ():
        size, left = _least(partial(_weighing, chain, at), factors)
        yield Suspect(MASS, (at,), float(np.exp(size)), left)


def _reading(chain: Grouped, index: int, size: float) -> Grouped:
    """Return the data corrected under the assumption that a channel reads exp(size) times the true value."""
    return chain.multiplied(_only(len(chain.accel), index, np.exp(-size)))


def _late(chain: Grouped, index: int, dt_s: float, samples: float) -> Grouped:
    """Return the data corrected under the assumption that a channel is `samples` samples late."""
    return chain.multiplied(_only(len(chain.accel), index, np.exp(1j * chain.omega * dt_s * samples)))


def _weighing(chain: Grouped, index: int, size: float) -> Grouped:
    """Return the data with the mass of a floor changed to exp(size) times the given one."""
    masses = chain.masses_kg.copy()
    masses[index - 1] *= np.exp(size)
    return replace(chain, masses_kg=masses)


def _only(count: int, index: int, factor: float | ComplexArray) -> ComplexArray:
    """Return factors (count, 1) or (count, g) of the channels: `factor` for one channel, 1 for the others."""
    factors = np.ones((count, np.size(factor)), dtype=complex)
    factors[index] = factor
    return factors


def _least(changed: Callable[[float], Grouped], bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the size within bounds that leaves the least misfit, and that misfit."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda size: _misfit(explained(changed(float(size)), errors=False)),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(found.x), float(found.fun)
