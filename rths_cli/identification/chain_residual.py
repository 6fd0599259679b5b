"""Residual of the channels against a chain of storeys of any stiffness: one linear equation per storey.

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

The table's samples carry an alias of the held command, in m/s^2 S (b_0 + b_1 s + b_2 s^2 + ...) with the staircase S.
Spring and dashpot of the lowest storey turn it into

    S (k / s^2 + c / s) (b_0 + b_1 s + b_2 s^2 + b_3 s^3).

b_0 is free. The others are bounded, because four free terms would hide a wrong sensitivity of the table. The alias is
the table's response near multiples of the sample rate, delayed by less than a sample; over s it changes by no more than
its size within T, the sample interval and the lag of the table sensor's low pass. The size of b_1 is max(|b_0|, H / 2),
H the table's largest response in the band, because b_0 vanishes at some delays: |b_1| <= T max(|b_0|, H / 2),
|b_2| <= T^2 |b_0|, |b_3| <= T^3 |b_0|. The lowest floor's own alias passes its dashpot and adds up to
c T^(n - 1) max(|b_0|, H / 2) / (2 pi) to k b_n, n = 2 and 3. Higher storeys see the table through dashpots only; their
first three terms are free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from rths_cli.identification.channel_signals import channel_noise
from rths_cli.identification.least_squares import covariance, linear, parts
from rths_cli.identification.record_parts import Record
from rths_cli.identification.specimen_fit import modal
from rths_cli.numerics.hysteresis import slid
from rths_cli.numerics.lti import Array, ComplexArray, integral_share
from rths_cli.rigs.description import RigInfo

GROUP_SHARE, LEAST_LINES = 0.01, 6  # width of a group over its frequency; least number of lines in it
LEAST_POWER = 1e-4  # a group with less of the command's median power (second derivative) is not excited
UNLINEARITY = 0.003  # tolerated nonlinearity, as a fraction of a channel's motion
ENDS = 4  # number of powers of 1 / s that represent the ends of a stretch
ROUNDS = 5  # iterations of the weights, each with the stiffness found before
BELOW, BEYOND = 0.1, 3.0  # assumed frequency of a storey too soft or too stiff to be seen, over the band's ends
RATIOS = (1e-3, 0.5)  # smallest and largest damping ratio from which a finer fit may start
STICKS = (0.01, 0.03, 0.06, 0.1, 0.2, 0.4)  # rms drifts over which joints stick before they slide
ALIASES = 5  # number of powers of s that represent the alias
SEEN = 1e-6  # least part of a bounded column that the free ones do not represent
RIGID = 30.0  # frequency of a rigid storey over the highest line


@dataclass(frozen=True)
class Grouped:
    """Fourier lines of records in g groups, for the c channels of table and floors."""

    omega: Array  # (g,) rad/s
    accel: ComplexArray  # (c, g)
    velocity: ComplexArray  # (c, g)
    displacement: ComplexArray  # (c, g)
    further: ComplexArray  # (p, g) terms of the records' ends
    alias: ComplexArray  # (r, ALIASES, g) S (T s)^n / s^2 of each of r records, n from 0
    command: ComplexArray  # (g,) in V
    alias_s: float  # T, the time in which an alias changes by no more than its size
    noise: Array  # (c, g) variance of the channels' noise
    masses_kg: Array  # (c - 1,) floors
    joints: ComplexArray  # (c - 1, k, g) forces of joints in each storey that stick and slide at 1 N; k may be 0

    def permuted(self, order: Sequence[int]) -> Grouped:
        """Return the same groups with the channels in another order."""
        at = list(order)
        return replace(
            self, accel=self.accel[at], velocity=self.velocity[at], displacement=self.displacement[at],
            noise=self.noise[at],
        )  # fmt: skip

    def multiplied(self, factors: Array | ComplexArray) -> Grouped:
        """Return the same groups with the channels multiplied by factors (c, 1) or (c, g)."""
        return replace(
            self, accel=factors * self.accel, velocity=factors * self.velocity,
            displacement=factors * self.displacement, noise=np.abs(factors) ** 2 * self.noise,
        )  # fmt: skip


@dataclass(frozen=True)
class Explained:
    """How well a chain of n storeys explains the channels."""

    chi_square: Array  # (n,) sum of squared residuals over their variances, per storey
    count: Array  # (n,) number of terms in that sum
    stiffness_n_per_m: Array  # (n,) 0 if no positive stiffness helps, infinite if the data show a rigid storey
    relative_error: Array  # (n,) relative standard error of the stiffnesses
    dashpots_n_s_per_m: Array  # (n, n) c_ij

    @property
    def misfit(self) -> Array:
        """Return the rms of the residuals over their standard deviation, (n,): 1 if they are noise alone."""
        return np.sqrt(self.chi_square / self.count)


def grouped(
    records: Sequence[Record], info: RigInfo, masses_kg: Array, band_hz: tuple[float, float], raw: bool = False,
    joints: bool = False,
) -> Grouped:  # fmt: skip
    """Return the grouped lines of the excited parts of records in a band; masses (c - 1,) in kg.

    `raw`: each line forms its own group and is not correlated with the command, so that noise is not averaged out.
    `joints`: a storey may have friction as well.
    """
    parts = [_of_record(record, info, np.asarray(masses_kg, dtype=float), band_hz, raw, joints) for record in records]
    return Grouped(
        np.concatenate([part.omega for part in parts]),
        np.hstack([part.accel for part in parts]),
        np.hstack([part.velocity for part in parts]),
        np.hstack([part.displacement for part in parts]),
        _apart([part.further for part in parts]),
        _apart([part.alias[0] for part in parts]).reshape(len(parts), ALIASES, -1),
        np.concatenate([part.command for part in parts]),
        parts[0].alias_s,
        np.hstack([part.noise for part in parts]),
        parts[0].masses_kg,
        np.concatenate([part.joints for part in parts], axis=-1),
    )


def _apart(rows: Sequence[ComplexArray]) -> ComplexArray:
    """Return the rows (p, g) of each record as rows of all records, zero in the others."""
    return np.asarray(np.block([[part * float(row is part) for part in rows] for row in rows]))


def _of_record(
    record: Record, info: RigInfo, masses_kg: Array, band_hz: tuple[float, float], raw: bool, joints: bool
) -> Grouped:
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

    together, late = added(lines), _alias_s(info)
    rubbed = _joints(lines / s**2, inside, n) if joints else np.zeros((len(lines) - 1, 0, len(s)), dtype=complex)
    return Grouped(
        np.sqrt(_summed(np.abs(s) ** 2, starts) / counts)[excited],
        together,
        added(lines / s),
        added(lines / s**2),
        added(np.array([s**-power for power in range(ENDS)])),
        added(np.array([alias * (late * s) ** n / s**2 for n in range(ALIASES)]))[None],
        added(np.fft.rfft(record.command_v[noise] - record.command_v[noise].mean())[None, inside])[0],
        late,
        n * channel_noise(record, info)[:, None] ** 2 + (UNLINEARITY * np.abs(together)) ** 2,
        masses_kg,
        np.array([added(forces) for forces in rubbed]),
    )


def _joints(displacements: ComplexArray, inside: np.ndarray, count: int) -> ComplexArray:
    """Return the lines (n, k, m) of the forces of joints in each storey, from the lines (c, m) of displacements.

    `inside` (count // 2 + 1,) tells which lines of a series of `count` samples they are.
    """
    drifts = np.zeros((len(displacements) - 1, len(inside)), dtype=complex)
    drifts[:, inside] = np.diff(displacements, axis=0)
    series = np.fft.irfft(drifts, count)
    forces = [[slid(drift, share * float(drift.std())) for share in STICKS] for drift in series]
    return np.asarray(np.fft.rfft(forces)[..., inside])


def _summed(values: Any, starts: Sequence[int]) -> Any:
    """Return sums (..., g) of values (..., m) over groups that begin at the given indices (g,)."""
    return np.add.reduceat(values, starts, axis=-1)


def _staircase(command_v: Array, info: RigInfo) -> Array:
    """Return the last change of the held command at each sample (n,), with the part that the AC correction adds."""
    late = max(info.latency_samples, 1)
    moved = np.concatenate([np.zeros(late + 1), command_v - command_v[0]])
    now, before = moved[1 : len(command_v) + 1], moved[: len(command_v)]
    return np.asarray(now - before + integral_share(info.channels[0].high_pass_hz, info.dt_s) * (now + before))


def _alias_s(info: RigInfo) -> float:
    """Return the time in s in which the staircase's alias changes by no more than its size."""
    low_pass = info.channels[0].low_pass_hz
    return info.dt_s + (1.0 / (2.0 * np.pi * low_pass) if low_pass > 0.0 else 0.0)


def _group_starts(frequency_hz: Array) -> list[int]:
    """Return the first line of each group; a group is GROUP_SHARE of its frequency wide and has LEAST_LINES or more."""
    starts: list[int] = []
    at = 0
    step = frequency_hz[1] - frequency_hz[0]
    while at + LEAST_LINES <= len(frequency_hz):
        starts.append(at)
        at += max(LEAST_LINES, int(GROUP_SHARE * frequency_hz[at] / step))
    return starts


def explained(chain: Grouped, errors: bool = True) -> Explained:
    """Return how well a chain with free stiffnesses and dashpots explains grouped lines.

    Without `errors` the standard errors are left out, not a number.
    """
    found = [_storey(chain, i, errors) for i in range(1, len(chain.masses_kg) + 1)]
    freed = len(chain.accel) + len(chain.further) + 3 * len(chain.alias) + 1 + chain.joints.shape[1]
    count = 2.0 * len(chain.omega) - freed
    return Explained(
        np.array([storey.chi_square for storey in found]),
        np.full(len(found), count),
        np.array([storey.stiffness for storey in found]),
        np.array([storey.relative_error for storey in found]),
        np.array([storey.dashpots for storey in found]).reshape(len(found), len(found)),
    )


def first_values(chain: Grouped) -> tuple[Array, Array]:
    """Return stiffnesses in N/m and modal damping ratios, each (n,), as start values of a finer fit.

    A storey whose stiffness the data do not determine gets a frequency far outside the band: below it if the storey is
    soft, above it if the storey is stiff.
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


def _storey(chain: Grouped, i: int, errors: bool) -> _Storey:
    """Return the best fit of storey i (from 1): with a finite stiffness, without stiffness, or rigid."""
    inertia = chain.masses_kg[i - 1 :] @ chain.accel[i:]
    drift = chain.displacement[i] - chain.displacement[i - 1]
    damping = np.diff(chain.velocity, axis=0)
    columns = np.array([drift, *damping, *chain.further, *chain.joints[i - 1]])
    n, stiffness = len(damping), 0.0
    found = _solved(chain, i, inertia, columns, stiffness)
    for _ in range(ROUNDS):
        before, stiffness = stiffness, max(float(found.factors[0]), 0.0)
        if stiffness == before:
            break
        dashpot_s = max(float(found.factors[1]), 0.0) / stiffness if i == 1 and stiffness > 0.0 else float("nan")
        found = _solved(chain, i, inertia, columns, stiffness, dashpot_s)
    error = found.first_error() if errors else float("nan")
    best = _Storey(found.chi_square, float(found.factors[0]), error, found.factors[1 : n + 1])
    if found.factors[0] <= 0.0:
        found = _solved(chain, i, inertia, columns[1:], 0.0)
        best = _Storey(found.chi_square, 0.0, float("inf"), found.factors[:n])
    rigid = float(chain.masses_kg[i - 1 :].sum()) * (RIGID * float(chain.omega.max())) ** 2
    found = _solved(chain, i, inertia + rigid * drift, columns[1:], rigid, 0.0 if i == 1 else float("nan"))
    stiff = _Storey(found.chi_square, float("inf"), float("inf"), found.factors[:n])
    return stiff if stiff.chi_square < best.chi_square else best


@dataclass(frozen=True)
class _Solved:
    """Least-squares solution of a storey's equation."""

    chi_square: float  # sum of squared residuals over their variances
    factors: Array  # (k,) of the columns
    rows: Array  # (k, 2 g) weighted columns, each scaled to length 1; then the bounded ones that are free
    of_rows: Array  # (k,) factors of the scaled columns

    def first_error(self) -> float:
        """Return the relative standard error of the first factor."""
        spread = float(covariance(self.rows, max(self.chi_square / self.rows.shape[1], 1.0))[0, 0])
        return float(np.sqrt(spread) / max(abs(self.of_rows[0]), 1e-300))


def _solved(
    chain: Grouped, i: int, wanted: ComplexArray, columns: ComplexArray, stiffness: float,
    dashpot_s: float = float("nan"),
) -> _Solved:  # fmt: skip
    """Solve the equation of storey i by least squares: columns (k, g), `wanted` (g,) and the alias add up to zero.

    The weights are those for a given stiffness. `dashpot_s`: dashpot over stiffness in s, not a number where the table
    is seen through dashpots alone. |b_0|, by which the alias's other terms are bounded, is that found without them.
    """
    weight = np.sqrt(2.0 / _variance(chain, i, stiffness))
    free, bounded, share = _aliases(chain, dashpot_s)
    rows = parts(np.vstack([columns, free.reshape(-1, free.shape[-1])]) * weight)
    size = np.linalg.norm(rows, axis=1)
    size[size == 0.0] = 1.0
    rows /= size[:, None]
    both = parts(np.vstack([-wanted, bounded]) * weight)
    found = linear(rows, both.T)
    left = both - found.T @ rows
    free_size = float(np.abs(found[:, 0] / size)[len(columns) :].max())
    largest = max(free_size, 0.5 * stiffness * float(np.abs(chain.accel[0] / chain.command).max()))
    most = share @ (free_size, largest)
    shares, inside = _within(left, np.linalg.norm(both, axis=1), most)
    residual, factors = left[0] - shares @ left[1:], found[:, 0] - found[:, 1:] @ shares
    used = both[1:][inside]
    rows = np.vstack([rows, used / np.linalg.norm(used, axis=1)[:, None]])
    return _Solved(float(residual @ residual), np.asarray(factors / size), rows, factors)


def _aliases(chain: Grouped, dashpot_s: float) -> tuple[ComplexArray, ComplexArray, Array]:
    """Return the alias's terms with free factors (r, f, g), those with bounded ones (b, g), and the bounds (b, 2).

    Bounds are per |b_0|, and per max(|b_0|, H / 2); through dashpots alone, per largest free factor.
    """
    terms = chain.alias
    if not np.isfinite(dashpot_s):
        return terms[:, :3], terms[:, 3:4].sum(axis=0), np.array([[1.0, 0.0]])
    through = dashpot_s / chain.alias_s
    made = terms[:, :-1] + through * terms[:, 1:]
    of_floor = through / (2.0 * np.pi)
    return made[:, :1], made[:, 1:].sum(axis=0), np.array([[0.0, 1.0], [1.0, of_floor], [1.0, of_floor]])


def _within(left: Array, size: Array, most: Array) -> tuple[Array, np.ndarray]:
    """Return the factors (b,) of the rows left[1:] that best represent left[0], none beyond +-most (b,).

    Also returned is which factors (b,) are free, inside that bound. A row with less than SEEN of its `size` (b + 1,)
    left gets no factor.
    """
    from scipy.optimize import lsq_linear

    length = np.linalg.norm(left[1:], axis=1)
    seen, shares = (length > SEEN * size[1:]) & (most > 0.0), np.zeros(len(most))
    if seen.any():
        bound, rows = most[seen] * length[seen], left[1:][seen] / length[seen, None]
        shares[seen] = lsq_linear(rows.T, left[0], (-bound, bound), method="bvls").x / length[seen]
    return shares, seen & (np.abs(shares) < most)


def _variance(chain: Grouped, i: int, stiffness: float) -> Array:
    """Return the variance (g,) of a storey's equation: the channels' variances times their squared factors in it."""
    per_accel = stiffness / chain.omega**2
    own = (chain.masses_kg[i - 1] - per_accel) ** 2 * chain.noise[i] + per_accel**2 * chain.noise[i - 1]
    return np.asarray(own + chain.masses_kg[i:] ** 2 @ chain.noise[i + 1 :])
