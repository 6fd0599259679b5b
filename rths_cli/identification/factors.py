"""A rational response as a product of factors whose roots cannot leave the left half plane, with its slopes.

G(s) = gain s^2 prod(1 + 2 zeta s / w + s^2 / w^2) / prod(...) exp(-s T): each pair of roots is a frequency and a
damping ratio (above 1: two real roots), each single pole a corner. The parameters are their logarithms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.lti import Array, ComplexArray


@dataclass(frozen=True)
class Layout:
    """How many pairs of poles, single poles and pairs of finite zeros; `delay_s` is the declared T.

    Parameters: log |gain|, then (log w, log zeta) of each pole pair, log corner of each single pole,
    (log w, log zeta) of each zero pair, and log of a delay beyond T where one is fitted; w and corners in rad/s.
    """

    pole_pairs: int
    single_poles: int
    zero_pairs: int
    delay_s: float
    fits_delay: bool = False

    @property
    def size(self) -> int:
        """Return the number of parameters."""
        return self._roots + self.fits_delay

    @property
    def _roots(self) -> int:
        """Return the number of parameters without a fitted delay."""
        return 1 + 2 * (self.pole_pairs + self.zero_pairs) + self.single_poles

    def zeros(self, pairs: int) -> slice:
        """Return which parameters are those of the first so many zero pairs."""
        first = self._roots - 2 * self.zero_pairs
        return slice(first, first + 2 * pairs)

    def delay(self, parameters: Array) -> float:
        """Return the whole delay in s."""
        return self.delay_s + (float(np.exp(parameters[self._roots])) if self.fits_delay else 0.0)

    def pairs(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Return pole pairs (m, 2), corners of the single poles (k,) and zero pairs (n, 2), no logarithms."""
        values = np.exp(parameters)
        end = 1 + 2 * self.pole_pairs
        poles, single, zeros = np.split(values[1 : self._roots], [end - 1, end - 1 + self.single_poles])
        return poles.reshape(-1, 2), single, zeros.reshape(-1, 2)


def pack(gain: float, pole_pairs: Array, single_poles: Array, zero_pairs: Array) -> Array:
    """Return the parameters of |gain|, pairs (w, zeta) and corners in rad/s."""
    return np.log(np.concatenate([[abs(gain)], np.ravel(pole_pairs), np.ravel(single_poles), np.ravel(zero_pairs)]))


def response_and_slopes(layout: Layout, parameters: Array, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return |G| exp(j phase) for a positive gain at s (m,) and d log G / d parameter, (size, m)."""
    poles, single, zeros = layout.pairs(parameters)
    slopes = np.ones((layout.size, len(s)), dtype=complex)
    delay = layout.delay(parameters)
    factors, of_pairs = _pairs(np.concatenate([poles, zeros]), s)
    corners = 1.0 + s / single[:, None]
    below = np.prod(factors[: len(poles)], axis=0) * np.prod(corners, axis=0)
    value = np.exp(parameters[0]) * s**2 * np.exp(-s * delay) * np.prod(factors[len(poles) :], axis=0) / below
    end, first_zero = 2 * len(poles), 1 + 2 * len(poles) + len(single)
    slopes[1 : 1 + end] = of_pairs[:end]
    slopes[1 + end : first_zero] = 1.0 - 1.0 / corners
    slopes[first_zero : first_zero + 2 * len(zeros)] = -of_pairs[end:]
    if layout.fits_delay:
        slopes[-1] = -s * (delay - layout.delay_s)
    return value, slopes


def _pairs(pairs: Array, s: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return 1 + 2 zeta s / w + s^2 / w^2 of pairs (n, 2), (n, m), and minus its logarithm's slopes by log w and
    log zeta, (2 n, m)."""
    omega, zeta = pairs[:, :1], pairs[:, 1:]
    over = s / omega
    damping, inertia = 2.0 * zeta * over, over * over
    factor = 1.0 + damping + inertia
    share = damping / factor
    by_frequency = 2.0 - 2.0 / factor - share  # (damping + 2 inertia) / factor
    return factor, np.stack([by_frequency, -share], axis=1).reshape(2 * len(pairs), len(s))


def roots(pairs: Array) -> ComplexArray:
    """Return the roots (2 n,) of pairs (w, zeta), conjugates side by side; real ones where zeta is 1 or more."""
    omega, zeta = pairs[:, 0], pairs[:, 1]
    fast = -omega * (zeta + np.sqrt((zeta**2 - 1.0).astype(complex)))
    return np.ravel(np.column_stack([fast, omega**2 / fast]))


def zeros_poles_gain(layout: Layout, parameters: Array, sign: float) -> tuple[ComplexArray, ComplexArray, float]:
    """Return the roots in rad/s, the double zero at the origin first, and the gain of prod(s - z) / prod(s - p)."""
    pole_pairs, single, zero_pairs = layout.pairs(parameters)
    scale = np.prod(pole_pairs[:, 0]) ** 2 * np.prod(single) / np.prod(zero_pairs[:, 0]) ** 2
    zeros = np.concatenate([np.zeros(2, dtype=complex), roots(zero_pairs)])
    poles = np.concatenate([roots(pole_pairs), (-single).astype(complex)])
    return zeros, poles, float(sign * np.exp(parameters[0]) * scale)
