"""Which single fault of a channel, a mass or the floors' order explains channels that a chain as declared does not.

Each fault is a change of the data (channels multiplied or exchanged) or of the masses, under which the equations of the
storeys are tried anew (chain_residual.py). A fault is named only when the channels as declared cannot be explained,
when it explains them, and when it is large enough to be one; faults that explain them alike are named together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from rths_cli.identification.chain_residual import Explained, Grouped, explained
from rths_cli.numerics.lti import ComplexArray

FITS = 2.0  # standard deviations of the worst storey that are no evidence against a chain as declared
CURED = 0.4  # of the misfit that a fault may leave
ALIKE = 1.3  # times the least misfit of a fault: another one explains the channels as well
RANGE = (0.3, 3.0)  # of a sensitivity or mass
LEAST_REVERSED = 4  # channels: up to three floors are reversed by exchanging two
LATEST = 3.0  # samples between one channel and the others
SIGN, GAIN, SWAP, REVERSED, MASS, LATE = "sign", "gain", "swap", "reversed", "mass", "late"


@dataclass(frozen=True)
class Suspect:
    """A fault of channels (by index, the table's is 0) or of floors' masses (by index of the floor's channel).

    `size`: what a channel reads over what is true, the true mass over the given one, or by how many samples a channel
    is late. `misfit`: rms of the storeys' equations over their standard deviation that it leaves.
    """

    kind: str
    channels: tuple[int, ...]
    size: float
    misfit: float


@dataclass(frozen=True)
class Diagnosis:
    """`misfit` of the channels as declared, `fits` when nothing is wrong; the faults that explain them alike, the best
    first, () where there is none or no single one does."""

    misfit: float
    fits: bool
    suspects: tuple[Suspect, ...]


def diagnose(chain: Grouped, dt_s: float) -> Diagnosis:
    """Return which single faults explain grouped lines that a chain with the given masses does not."""
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
    """Return the rms over all storeys of the equations over their standard deviation."""
    return float(np.sqrt(found.chi_square.sum() / found.count.sum()))


def _whole(chain: Grouped) -> Iterator[Suspect]:
    """Yield the faults that are there or not, each with the misfit that it leaves: signs and places of channels."""
    count = len(chain.accel)
    for index in range(count):
        yield Suspect(SIGN, (index,), -1.0, _misfit(explained(chain.multiplied(_only(count, index, -1.0)))))
    for pair in combinations(range(count), 2):
        order = list(range(count))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        yield Suspect(SWAP, pair, 1.0, _misfit(explained(chain.permuted(order))))
    if count > LEAST_REVERSED:
        order = [0, *range(count - 1, 0, -1)]
        yield Suspect(REVERSED, tuple(range(1, count)), 1.0, _misfit(explained(chain.permuted(order))))


def _sized(chain: Grouped, dt_s: float) -> Iterator[Suspect]:
    """Yield the faults that have a size, each with the one that leaves the least misfit: sensitivities, masses, times.

    With one floor its mass only scales the stiffness.
    """
    count = len(chain.accel)
    factors = float(np.log(RANGE[0])), float(np.log(RANGE[1]))
    for at in range(count):
        size, left = _least(partial(_reading, chain, at), factors)
        yield Suspect(GAIN, (at,), float(np.exp(size)), left)
        yield Suspect(LATE, (at,), *_least(partial(_late, chain, at, dt_s), (-LATEST, LATEST)))
    for at in range(1, count) if count > 2 else ():
        size, left = _least(partial(_weighing, chain, at), factors)
        yield Suspect(MASS, (at,), float(np.exp(size)), left)


def _reading(chain: Grouped, index: int, size: float) -> Grouped:
    """Return the data if a channel reads exp(size) times what is true."""
    return chain.multiplied(_only(len(chain.accel), index, np.exp(-size)))


def _late(chain: Grouped, index: int, dt_s: float, samples: float) -> Grouped:
    """Return the data if a channel is late by so many samples."""
    return chain.multiplied(_only(len(chain.accel), index, np.exp(1j * chain.omega * dt_s * samples)))


def _weighing(chain: Grouped, index: int, size: float) -> Grouped:
    """Return the data if a floor weighs exp(size) times what is given."""
    masses = chain.masses_kg.copy()
    masses[index - 1] *= np.exp(size)
    return replace(chain, masses_kg=masses)


def _only(count: int, index: int, factor: float | ComplexArray) -> ComplexArray:
    """Return factors (count, 1) or (count, g) of channels, 1 for all but one."""
    factors = np.ones((count, np.size(factor)), dtype=complex)
    factors[index] = factor
    return factors


def _least(changed: Callable[[float], Grouped], bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the size within bounds that leaves the least misfit, and that misfit."""
    from scipy.optimize import minimize_scalar  # takes half a second, and only channels with a fault come here

    found = minimize_scalar(
        lambda size: _misfit(explained(changed(float(size)))), bounds=bounds, method="bounded", options={"xatol": 1e-3}
    )
    return float(found.x), float(found.fun)
