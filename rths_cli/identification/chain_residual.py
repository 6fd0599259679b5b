"""How well a chain of storeys explains what the channels show: one linear equation per storey, weighted by its noise.

A storey carries the inertia of the floors above it:

    sum over j >= i of m_j a_j + k_i (x_i - x_(i-1)) + sum over all storeys of c_ij (v_j - v_(j-1)) = 0,

with x = a / s^2 and v = a / s. Fourier lines of a whole stretch of record are multiplied by the conjugate lines of the
command and added in narrow groups. The command is free of noise, so that noise averages out; the equation holds at each
line, so that the width of a group does no harm to it, however light the damping. What the stretch's ends add is a sum
of powers of 1 / s with free factors. The stiffness k_i of a storey minimises

    sum of |equation|^2 / variance,

where the variance of the equation is that of its channels' noise, resolution and unlinearity, each with its own factor:
an orthogonal regression, with no bias where a drift is hardly above the noise (W. A. Fuller, Measurement Error Models,
section 1.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rths_cli.identification.channel_signals import channel_noise
from rths_cli.identification.least_squares import covariance, linear, parts
from rths_cli.identification.records import Record
from rths_cli.identification.specimen_fit import modal
from rths_cli.numerics.lti import Array, ComplexArray, integral_share
from rths_cli.rigs.description import RigInfo

GROUP_SHARE, LEAST_LINES = 0.01, 6  # width of a group over its frequency; lines in it
LEAST_POWER = 1e-4  # of the median power of the command's second derivative, below which a group is not excited
UNLINEARITY = 0.003  # of a channel's motion: what is not held against a chain
ENDS = 4  # powers of 1 / s that the ends of a stretch add
ROUNDS = 5  # of weighting by the stiffness found last
BELOW, BEYOND = 0.1, 3.0  # times the band's ends: own frequencies of storeys too soft and too stiff to be seen
RATIOS = (1e-3, 0.5)  # damping ratios that a finer fit may start from
RIGID = 30.0  # a storey whose own frequency is so many times the highest line is rigid


@dataclass(frozen=True)
class Grouped:
    """Groups of lines (g,) of records: accelerations, velocities and displacements (c, g) of table and floors, and the
    variance of the channels' noise (c, g). `further` (p, g): what the ends of the records add, and velocity and
    displacement of the staircase's alias in the table's acceleration. `masses_kg` (c - 1,)."""

    omega: Array
    accel: ComplexArray
    velocity: ComplexArray
    displacement: ComplexArray
    further: ComplexArray
    noise: Array
    masses_kg: Array

    def permuted(self, order: Sequence[int]) -> Grouped:
        """Return the same with channels in another order."""
        at = list(order)
        return replace(
            self, accel=self.accel[at], velocity=self.velocity[at], displacement=self.displacement[at],
            noise=self.noise[at],
        )  # fmt: skip

    def multiplied(self, factors: Array | ComplexArray) -> Grouped:
        """Return the same with channels multiplied by factors (c, 1) or (c, g)."""
        return replace(
            self, accel=factors * self.accel, velocity=factors * self.velocity,
            displacement=factors * self.displacement, noise=np.abs(factors) ** 2 * self.noise,
        )  # fmt: skip


@dataclass(frozen=True)
class Explained:
    """How well a chain explains the channels: sum of squares over variances `chi_square` of each storey (n,) and how
    many are added there (n,), the storeys' stiffnesses (n,) in N/m, 0 where no positive one helps, infinite where the
    storey is rigid as far as the data tell, their relative standard errors (n,), and the dashpots c_ij (n, n) in N s/m.
    """

    chi_square: Array
    count: Array
    stiffness_n_per_m: Array
    relative_error: Array
    dashpots_n_s_per_m: Array

    @property
    def misfit(self) -> Array:
        """Return the rms of the equations over their standard deviation, (n,): 1 when noise is all that is left."""
        return np.sqrt(self.chi_square / self.count)


def grouped(
    records: Sequence[Record], info: RigInfo, masses_kg: Array, band_hz: tuple[float, float], raw: bool = False
) -> Grouped:
    """Return the groups of lines in a band of the excited parts of records; masses (c - 1,) in kg.

    `raw`: every line by itself and as it is, with all that is in it beside the answer to the command.
    """
    parts = [_of_record(record, info, np.asarray(masses_kg, dtype=float), band_hz, raw) for record in records]
    apart = [[part.further * float(row is part) for part in parts] for row in parts]
    return Grouped(
        np.concatenate([part.omega for part in parts]),
        np.hstack([part.accel for part in parts]),
        np.hstack([part.velocity for part in parts]),
        np.hstack([part.displacement for part in parts]),
        np.block(apart),
        np.hstack([part.noise for part in parts]),
        parts[0].masses_kg,
    )


def _of_record(record: Record, info: RigInfo, masses_kg: Array, band_hz: tuple[float, float], raw: bool) -> Grouped:
    """Return the groups of lines of one record."""
    noise = record.parts.noise
    n = noise.stop - noise.start
    frequency = np.arange(n // 2 + 1) / (n * info.dt_s)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    s = 2j * np.pi * frequency[inside]
    bent = np.diff(record.command_v, 2, prepend=[record.command_v[0]] * 2)[noise]
    given = np.fft.rfft(np.hanning(n) * bent)[inside]
    accel = record.accel_m_s2[:, noise]
    lines = np.fft.rfft(accel - accel.mean(axis=1, keepdims=True))[:, inside]
    alias = np.fft.rfft(_staircase(record.command_v, info)[noise])[inside]
    starts = list(range(len(s))) if raw else _group_starts(frequency[inside])
    power = _summed(np.abs(given) ** 2, starts)
    counts = np.diff(np.append(starts, len(s)))
    excited = power / counts > LEAST_POWER * np.median(power / counts)
    size = np.sqrt(power)[excited]

    def added(rows: ComplexArray) -> ComplexArray:
        if raw:
            return rows[:, excited]
        return np.asarray(_summed(np.conj(given) * rows, starts)[:, excited] / size)

    together = added(lines)
    return Grouped(
        np.sqrt(_summed(np.abs(s) ** 2, starts) / counts)[excited],
        together,
        added(lines / s),
        added(lines / s**2),
        added(np.array([*(s**-power for power in range(ENDS)), alias / s, alias / s**2])),
        n * channel_noise(record, info)[:, None] ** 2 + (UNLINEARITY * np.abs(together)) ** 2,
        masses_kg,
    )


def _summed(values: Any, starts: Sequence[int]) -> Any:
    """Return sums (..., g) of values (..., m) over groups that begin at so many of them."""
    return np.add.reduceat(values, starts, axis=-1)


def _staircase(command_v: Array, info: RigInfo) -> Array:
    """Return the last change of the held command at each sample (n,), with what undoing an AC coupling adds to it."""
    late = max(info.latency_samples, 1)
    moved = np.concatenate([np.zeros(late + 1), command_v - command_v[0]])
    now, before = moved[1 : len(command_v) + 1], moved[: len(command_v)]
    return np.asarray(now - before + integral_share(info.channels[0].high_pass_hz, info.dt_s) * (now + before))


def _group_starts(frequency_hz: Array) -> list[int]:
    """Return where groups of lines begin, each GROUP_SHARE of its frequency wide and of LEAST_LINES at least."""
    starts: list[int] = []
    at = 0
    step = frequency_hz[1] - frequency_hz[0]
    while at + LEAST_LINES <= len(frequency_hz):
        starts.append(at)
        at += max(LEAST_LINES, int(GROUP_SHARE * frequency_hz[at] / step))
    return starts


def explained(chain: Grouped) -> Explained:
    """Return how well a chain with free stiffnesses and dashpots explains grouped lines."""
    found = [_storey(chain, i) for i in range(1, len(chain.masses_kg) + 1)]
    count = 2.0 * len(chain.omega) - len(chain.accel) - len(chain.further)
    return Explained(
        np.array([storey.chi_square for storey in found]),
        np.full(len(found), count),
        np.array([storey.stiffness for storey in found]),
        np.array([storey.relative_error for storey in found]),
        np.array([storey.dashpots for storey in found]).reshape(len(found), len(found)),
    )


def first_values(chain: Grouped) -> tuple[Array, Array]:
    """Return stiffnesses in N/m and modal damping ratios (n,) of a chain that explains grouped lines, for a finer fit.

    A storey whose stiffness the data do not tell gets one far outside the band, on the side where it must be.
    """
    found, masses = explained(chain), chain.masses_kg
    above = np.cumsum(masses[::-1])[::-1]
    stiffness = np.where(found.stiffness_n_per_m > 0.0, found.stiffness_n_per_m, above * (BELOW * chain.omega[0]) ** 2)
    stiffness = np.where(np.isfinite(stiffness), stiffness, above * (BEYOND * chain.omega[-1]) ** 2)
    omega, shapes = modal(masses, stiffness)
    drifts = np.diff(shapes, axis=0, prepend=0.0)
    ratios = np.einsum("ir,ij,jr->r", drifts, found.dashpots_n_s_per_m, drifts) / (2.0 * omega)
    return stiffness, ratios.clip(*RATIOS)


@dataclass(frozen=True)
class _Storey:
    """Sum of squares over variances, stiffness, its relative standard error and dashpots (n,) of one storey."""

    chi_square: float
    stiffness: float
    relative_error: float
    dashpots: Array


def _storey(chain: Grouped, i: int) -> _Storey:
    """Return what explains storey i, from 1, best: a stiffness, none, or rigidity."""
    inertia = chain.masses_kg[i - 1 :] @ chain.accel[i:]
    drift = chain.displacement[i] - chain.displacement[i - 1]
    damping = np.diff(chain.velocity, axis=0)
    columns = np.array([drift, *damping, *chain.further])
    n, stiffness = len(damping), 0.0
    for _ in range(ROUNDS):
        stiffness = max(_solved(chain, i, inertia, columns, stiffness).factors[0], 0.0)
    found = _solved(chain, i, inertia, columns, stiffness)
    best = _Storey(found.chi_square, float(found.factors[0]), found.first_error(), found.factors[1 : n + 1])
    if found.factors[0] <= 0.0:
        found = _solved(chain, i, inertia, columns[1:], 0.0)
        best = _Storey(found.chi_square, 0.0, float("inf"), found.factors[:n])
    rigid = float(chain.masses_kg[i - 1 :].sum()) * (RIGID * float(chain.omega.max())) ** 2
    found = _solved(chain, i, inertia + rigid * drift, columns[1:], rigid)
    stiff = _Storey(found.chi_square, float("inf"), float("inf"), found.factors[:n])
    return stiff if stiff.chi_square < best.chi_square else best


@dataclass(frozen=True)
class _Solved:
    """Sum of squares over variances and the factors (k,) of a storey's columns; the weighted columns (k, 2 g), each of
    length 1, and the factors (k,) of those."""

    chi_square: float
    factors: Array
    rows: Array
    of_rows: Array

    def first_error(self) -> float:
        """Return the relative standard error of the first factor."""
        spread = float(covariance(self.rows, max(self.chi_square / self.rows.shape[1], 1.0))[0, 0])
        return float(np.sqrt(spread) / max(abs(self.of_rows[0]), 1e-300))


def _solved(chain: Grouped, i: int, wanted: ComplexArray, columns: ComplexArray, stiffness: float) -> _Solved:
    """Return the factors of columns (k, g) that add up to what is wanted (g,), for weights of a stiffness."""
    weight = np.sqrt(2.0 / _variance(chain, i, stiffness))
    rows = parts(columns * weight)
    target = parts(-wanted * weight)
    size = np.linalg.norm(rows, axis=1)
    size[size == 0.0] = 1.0
    rows /= size[:, None]
    found = linear(rows, target)
    left = target - found @ rows
    return _Solved(float(left @ left), np.asarray(found / size), rows, found)


def _variance(chain: Grouped, i: int, stiffness: float) -> Array:
    """Return the variance (g,) of a storey's equation: every channel's, by its factor in it squared."""
    per_accel = stiffness / chain.omega**2
    own = (chain.masses_kg[i - 1] - per_accel) ** 2 * chain.noise[i] + per_accel**2 * chain.noise[i - 1]
    return np.asarray(own + chain.masses_kg[i:] ** 2 @ chain.noise[i + 1 :])
