"""Fit a chain of storeys to the accelerations of table and floors, with weighed floor masses.

The discrete Fourier transform of a stretch of record obeys, for the motion of every floor, Y(s) = H(s) A(s) + sum over
modes of phi (alpha + beta s) / (s^2 + 2 zeta w s + w^2). H is the transmissibility and A the table's acceleration.
alpha and beta represent the state at the stretch's start minus that at its end. If they are free parameters, there is
no leakage however light the damping, and the same equation holds for noise and free vibration.

The linear parameters (alpha, beta, a slow drift) are eliminated by variable projection, with the slopes of L. Kaufman,
BIT 15 (1975) 49.

Output error in the frequency domain over whole records and over stretches of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.least_squares import Solution, covariance, least_squares, parts
from rths_cli.identification.results import SpecimenFit
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.structure import Specimen, above_rounding, modal_damping_matrix, storey_matrix

ROUNDING = float(np.finfo(float).eps)
LOST = 1e-12  # smaller singular values of the linear terms, relative to the largest, count as zero


@dataclass(frozen=True)
class Lines:
    """Fourier lines s (m,) in rad/s of the accelerations of table (m,) and floors (n, m), and of the table's staircase
    (m,) where it is known.

    `weight` (n, m): by what residuals of the floors are multiplied before their squares are summed; None: 1.
    """

    s: ComplexArray
    table: ComplexArray
    floors: ComplexArray
    staircase: ComplexArray | None = None
    weight: ComplexArray | None = None

    def weighted(self, values: ComplexArray) -> ComplexArray:
        """Return values (..., n, m) of the floors times their weight."""
        return values if self.weight is None else values * self.weight


def modal(masses_kg: Array, stiffness_n_per_m: Array) -> tuple[Array, Array]:
    """Return natural frequencies in rad/s, ascending, (n,) and mass-normalised mode shapes (n, n)."""
    return modes_of(masses_kg, storey_matrix(stiffness_n_per_m))


def modes_of(masses_kg: Array, K: Array) -> tuple[Array, Array]:
    """Return the same of a stiffness matrix (n, n).

    The top floor, which no mode of a chain leaves at rest, moves to the positive side in all shapes: what couples two
    modes changes its sign with the shape of either.
    """
    root = np.sqrt(masses_kg)
    eigenvalues, shapes = np.linalg.eigh(K / np.outer(root, root))
    return np.sqrt(above_rounding(eigenvalues)), np.where(shapes[-1] < 0.0, -1.0, 1.0) * shapes / root[:, None]


def frequency_slopes(omega: Array, shapes: Array, stiffness_n_per_m: Array) -> Array:
    """Return d w_r / d log k_j in rad/s, (n modes, n storeys)."""
    return stiffness_slopes(shapes, stiffness_n_per_m).diagonal().T / (2.0 * omega[:, None])


def stiffness_slopes(shapes: Array, stiffness_n_per_m: Array) -> Array:
    """Return phi_q^T (d K / d log k_j) phi_r, (n modes q, n modes r, n storeys j)."""
    drift = np.diff(shapes, axis=0, prepend=0.0)
    return np.einsum("jq,jr,j->qrj", drift, drift, stiffness_n_per_m)


def evaluated(
    lines: Sequence[Lines], masses_kg: Array, theta: Array, beside: Array | None = None
) -> tuple[Array, Array]:
    """Return the residual of the floors' lines and its slopes (2 n + k + 1, ...).

    `theta` (2 n + k,): logarithms of the storeys' stiffnesses and of the modal damping ratios, and how much there is of
    each stiffness matrix `beside` (k, n, n) the chain's; None: k is 0. The residual is the floors' lines minus
    transmissibility and linear terms. The last slope is that by a delay of the table's signal in s.
    """
    each = [_evaluated(part, masses_kg, theta, beside) for part in lines]
    return np.concatenate([residual for residual, _ in each]), np.hstack([slopes for _, slopes in each])


def without_time(both: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return residual and slopes without the slope by the table's delay."""
    return both[0], both[1][:-1]


def residual_of(lines: Lines, masses_kg: Array, theta: Array, beside: Array | None = None) -> Array:
    """Return the residual (2 n m,) of one set of lines as `evaluated` does, without its slopes, much faster."""
    return ChainResponse(lines, masses_kg, theta, beside).residual


def residual_change(
    lines: Lines, masses_kg: Array, theta: Array, beside: Array, tables: ComplexArray, floors: ComplexArray
) -> Array:
    """Return the changes (k, 2 n m) of `residual_of`, which is linear in the lines, by those of the table's lines
    (k, m) and of the floors' (k, n, m)."""
    at = ChainResponse(lines, masses_kg, theta, beside)
    left = lines.weighted(floors - at.shapes @ (at.participation * at.through * tables[:, None]))
    return at.without_linear_terms(parts(left).reshape(len(floors), lines.floors.size * 2))


def _evaluated(lines: Lines, masses_kg: Array, theta: Array, beside: Array | None) -> tuple[Array, Array]:
    """Return the residual (2 n m,) of one set of lines and its slopes (2 n + k + 1, 2 n m)."""
    at = ChainResponse(lines, masses_kg, theta, beside)
    s, omega, carried = lines.s, at.omega, at.carried
    free = (at.found[: 2 * len(omega)] / at.size).reshape(2, len(omega), 1)
    moved = at.participation * carried + np.sum(free * at.state, axis=0)
    pulled = (at.participation * lines.table - moved) * at.under
    basis = parts(np.concatenate([moved, carried, pulled, s * pulled, s * carried]))
    changes = stiffness_slopes(at.shapes, at.stiffness)
    if beside is not None:
        changes = np.dstack([changes, np.einsum("iq,kij,jr->qrk", at.shapes, beside, at.shapes)])
    weights = _weights(masses_kg, changes, at.ratios, omega, at.shapes)
    slopes = -(weights @ basis).reshape(len(theta) + 1, len(omega), -1)
    if lines.weight is not None:
        slopes = parts(slopes.view(complex) * lines.weight)
    return at.residual, at.without_linear_terms(slopes.reshape(len(theta) + 1, -1))


class ChainResponse:
    """The modes (n,) of a chain with what stiffness is beside it, their response at lines (m,), and what it leaves of
    the floors' lines.

    `residual` (2 n m,); `found` are the factors of the linear terms.
    """

    def __init__(self, lines: Lines, masses_kg: Array, theta: Array, beside: Array | None) -> None:
        self.stiffness, self.ratios = np.split(np.exp(theta[: 2 * len(masses_kg)]), 2)
        self.omega, self.shapes = modes_with(masses_kg, theta, beside)
        s, omega = lines.s, self.omega
        self.participation = (masses_kg @ self.shapes)[:, None]
        given = (2.0 * self.ratios * omega)[:, None] * s + (omega**2)[:, None]
        self.under = 1.0 / (s**2 + given)
        self.through = given * self.under
        self.carried = self.through * lines.table
        self.state = np.stack([(omega**2)[:, None] * self.under, omega[:, None] * s * self.under])
        left = lines.weighted(lines.floors - self.shapes @ (self.participation * self.carried))
        terms, self.size = _linear_terms(self.state, self.shapes, omega[0] / s, lines.weight)
        self.directions, self.by_direction = orthonormal_rows(terms)
        found = self.directions @ parts(left).reshape(-1)
        self.residual, self.found = parts(left).reshape(-1) - found @ self.directions, found @ self.by_direction

    def without_linear_terms(self, values: Array) -> Array:
        """Return values (k, 2 n m) without what the linear terms can make of them."""
        return np.asarray(values - (values @ self.directions.T) @ self.directions)


def modes_with(masses_kg: Array, theta: Array, beside: Array | None) -> tuple[Array, Array]:
    """Return natural frequencies and shapes of a chain with `theta` and `beside` as in `evaluated`."""
    n = len(masses_kg)
    K = storey_matrix(np.exp(theta[:n]))
    return modes_of(masses_kg, K if beside is None else K + np.tensordot(theta[2 * n :], beside, axes=1))


def _linear_terms(
    state: ComplexArray, shapes: Array, drift: ComplexArray, weight: ComplexArray | None
) -> tuple[Array, Array]:
    """Return the rows (3 n, 2 n m) of the linear terms, scaled to length 1, and the original lengths of the first 2 n.

    The first 2 n rows belong to the states at both ends of the stretch, the others to a slow drift of each floor's
    channel.
    """
    n = len(shapes)
    if weight is None:
        of_modes = shapes.T[None, :, :, None] * parts(state)[:, :, None, :]
        of_floors = np.eye(n)[:, :, None] * parts(drift)
    else:
        of_modes = parts(shapes.T[None, :, :, None] * state[:, :, None, :] * weight)
        of_floors = parts(np.eye(n)[:, :, None] * drift * weight)
    rows = np.concatenate([of_modes.reshape(2 * n, -1), of_floors.reshape(n, -1)])
    size = np.sqrt(np.sum(rows**2, axis=1))
    return np.asarray(rows / size[:, None]), np.asarray(size[: 2 * n])


def orthonormal_rows(rows: Array) -> tuple[Array, Array]:
    """Return orthonormal rows (q, m) that span the rows (p, m), which may depend on each other, and how the rows make
    them (q, p)."""
    from scipy.linalg import qr

    orthonormal, triangle = qr(rows.T, mode="economic", check_finite=False)
    left, values, right = np.linalg.svd(triangle, full_matrices=False)
    kept = values > LOST * values[0]
    return (orthonormal @ left[:, kept]).T, right[kept] / values[kept, None]


def _weights(masses_kg: Array, changes: Array, ratios: Array, omega: Array, shapes: Array) -> Array:
    """Return the coefficients of the model's slopes (2 n + k + 1 parameters, n floors) in a basis of 5 n rows.

    A change K_j of the stiffness, here phi_q^T K_j phi_r (n, n, n + k), the storeys' first, changes shapes and
    frequencies: d phi_r = sum over q of phi_q phi_q^T K_j phi_r / (w_r^2 - w_q^2). A change of log zeta_r changes the
    damping of one mode. The slope by the table's delay is -s times the response.
    """
    n, count = len(omega), changes.shape[2]
    apart = np.subtract.outer(-(omega**2), -(omega**2))  # w_r^2 - w_q^2, q first
    apart = np.copysign(np.maximum(np.abs(apart), ROUNDING * omega[-1] ** 2), apart) + np.diag(np.full(n, np.inf))
    turned = np.einsum("iq,qrj->jir", shapes, changes / apart[:, :, None])
    faster = (changes.diagonal() / (2.0 * omega)).reshape(count, 1, n)  # d w_r / d j, (j, 1, r)
    weights, stiffer = np.zeros((n + count + 1, n, 5, n)), np.r_[:n, 2 * n : n + count]
    weights[stiffer, :, 0] = turned
    weights[stiffer, :, 1] = shapes * np.einsum("i,jir->jr", masses_kg, turned)[:, None]
    weights[stiffer, :, 2] = shapes * (2.0 * omega) * faster
    weights[stiffer, :, 3] = shapes * (2.0 * ratios) * faster
    weights[n : 2 * n, :, 3] = np.eye(n)[:, None] * (shapes * 2.0 * ratios * omega)
    weights[-1, :, 4] = -shapes * (masses_kg @ shapes)
    return weights.reshape(n + count + 1, n, 5 * n)


ABOVE_HIGHEST = 1.6  # the lines used end at this multiple of the highest natural frequency
MISFIT, USUAL_RATIO = 0.01, 0.02  # residual over the floors' motion from which a fit is repeated; its damping ratio
FIRST_CYCLES, LONGER = 6.0, 3  # cycles of the lowest mode in the shortest stretch; factor from one stretch to the next
NEAR_RATIOS = 1e-3, 0.5  # damping ratios outside which the slopes do not lead to the solution
LEAST_LINES = 12  # lines of a stretch in the band of the fit
STIFFNESS_REACH, RATIO_REACH = 1e4, 1e3  # factors by which stiffness and damping ratio may differ from their start
CLOCK = 20e-6  # relative uncertainty of a converter's clock
SKEW = 0.01  # uncertainty of the channels' common sampling instant, in samples
NOISE_STRETCHES, FREE_SHARE = 5, 0.8  # stretches of an excitation; energy in the first stretch of a free vibration
TOLERANCE = 1e-9  # of the fit
ALIVE_SIGMA, REST_SHARE = 5.0, 8  # vibration over noise up to which it is used; the last 1/8 of a hold is its rest


@dataclass(frozen=True)
class Motion:
    """Accelerations in m/s^2 of table (n,), without the staircase alias, and floors (c, n) over a stretch.

    `staircase` (n,) in V: that alias per unit of the model's ripple; None: not known.
    """

    table: Array
    floors: Array
    staircase: Array | None = None

    def cut(self, part: slice) -> Motion:
        """Return a part of the stretch."""
        staircase = None if self.staircase is None else self.staircase[part]
        return Motion(self.table[part], self.floors[:, part], staircase)

    @property
    def shows_floors(self) -> bool:
        """Tell whether a floor moves by a bit of its channel or more, in the samples that `transform` uses."""
        used = self.floors[:, : _fast_length(len(self.table) - 1) + 1]
        return bool((np.ptp(used, axis=1) > 0.0).any())


@dataclass(frozen=True)
class Start:
    """First values of storey stiffnesses in N/m and modal damping ratios, each (n,)."""

    stiffness_n_per_m: Array
    damping_ratio: Array


def fit_specimen(motions: Sequence[Motion], dt_s: float, masses_kg: Array, low_hz: float, start: Start) -> SpecimenFit:
    """Fit storey stiffnesses and modal damping ratios to one or several motions of equal weight.

    `masses_kg` (c,) are the weighed masses; lines from `low_hz` up are used. If more than MISFIT of the motion stays
    unexplained, the fit is repeated from a start found with short stretches. Their lines are wide, so that the fit
    converges from a more distant frequency.
    """
    masses = np.asarray(masses_kg, dtype=float)
    band = _band(low_hz, masses, start)
    found = _fitted([transform(motion, dt_s, band) for motion in motions], masses, start)
    if found.size > MISFIT * np.sqrt(len(motions)):
        near = _approached(motions, dt_s, masses, low_hz, start)
        band = _band(low_hz, masses, start, near)
        again = _fitted([transform(motion, dt_s, band) for motion in motions], masses, near)
        found = min(found, again, key=lambda each: each.size)
    return _described(masses, found, len(motions))


def _fitted(lines: Sequence[Lines], masses: Array, start: Start) -> Solution:
    """Return the fit to lines from a start."""
    theta = np.log(np.concatenate([start.stiffness_n_per_m, start.damping_ratio]))
    return least_squares(
        lambda at: without_time(evaluated(lines, masses, at)), theta, TOLERANCE, reach=reach_of(len(masses))
    )


def reach_of(floors: int) -> Array:
    """Return the largest change (2 n,) of the logarithms of stiffnesses and damping ratios in a fit."""
    return np.log(np.repeat([STIFFNESS_REACH, RATIO_REACH], floors))


def _band(low_hz: float, masses: Array, *starts: Start) -> tuple[float, float]:
    """Return the band in Hz of the lines of a fit; it ends above the highest mode of all given starts.

    Several starts are given so that a poor fit to one stretch does not remove lines that the next one needs.
    """
    highest = max(float(modal(masses, start.stiffness_n_per_m)[0][-1]) for start in starts)
    return low_hz, ABOVE_HIGHEST * highest / (2.0 * np.pi)


def _approached(motions: Sequence[Motion], dt_s: float, masses: Array, low_hz: float, start: Start) -> Start:
    """Return a start from stretches of increasing length, each fitted from the result of the one before.

    The width of a line is the inverse of its stretch's length. A start that is many resonance widths off for a long
    stretch is therefore close for a short one. The first stretch lasts FIRST_CYCLES of the lowest mode and starts with
    damping ratios of USUAL_RATIO. A stretch in which the floors' channels are constant is skipped.
    """
    omega = modal(masses, start.stiffness_n_per_m)[0]
    length = int(FIRST_CYCLES * 2.0 * np.pi / (omega[0] * dt_s))
    near = Start(start.stiffness_n_per_m, np.full(len(masses), USUAL_RATIO))
    whole = min(len(motion.table) for motion in motions)
    while length < whole:
        length = max(length, least_samples(omega / (2.0 * np.pi), dt_s, low_hz))
        band = _band(low_hz, masses, start, near)
        parts = [motion.cut(_middle(len(motion.table), length)) for motion in motions]
        length *= LONGER
        if not all(part.shows_floors for part in parts):
            continue
        theta = _fitted([transform(part, dt_s, band) for part in parts], masses, near).parameters
        stiffness, ratios = np.split(np.exp(theta), 2)
        first = start.stiffness_n_per_m
        near = Start(stiffness.clip(first / STIFFNESS_REACH, first * STIFFNESS_REACH), ratios.clip(*NEAR_RATIOS))
    return near


def _middle(samples: int, length: int) -> slice:
    """Return the slice of `length` samples in the middle of a stretch."""
    first = max((samples - length) // 2, 0)
    return slice(first, min(first + length, samples))


def fit_stretches(
    motions: Sequence[Motion], dt_s: float, masses_kg: Array, low_hz: float, start: Start, free: bool
) -> SpecimenFit:
    """Fit whole motions, with uncertainties that are consistent with the scatter of their stretches.

    The random error is that of the fit, widened by the Birge ratio if the stretches scatter more than their own errors
    predict (friction, amplitude). Systematic errors that no record shows are added: the converter's clock (20 ppm of a
    frequency) and the channels' skew (1 % of a sample, which is w dt / 200 of a damping ratio). Motions too short to be
    divided have no scatter (NaN), and their errors are not widened.
    """
    whole = fit_specimen(motions, dt_s, masses_kg, low_hz, start)
    first = Start(whole.stiffness_n_per_m, whole.damping_ratio)
    least = least_samples(whole.natural_frequency_hz, dt_s, low_hz)
    parts = [motion.cut(part) for motion in motions for part in stretches_of(motion.floors, free, least)]
    pieces = [piece for piece in parts if piece.shows_floors]
    if len(pieces) < 2:
        return _trusted(whole, np.ones(len(whole.damping_ratio)), np.ones(len(whole.damping_ratio)), dt_s)
    fits = [fit_specimen([piece], dt_s, masses_kg, low_hz, first) for piece in pieces]
    hz, ratio = (np.array([getattr(f, name) for f in fits]) for name in ("natural_frequency_hz", "damping_ratio"))
    widened = birge(hz, np.array([found.frequency_error_hz for found in fits]))
    damping_widened = birge(ratio, np.array([found.damping_error for found in fits]))
    return replace(
        _trusted(whole, widened, damping_widened, dt_s),
        frequency_scatter_hz=hz.std(axis=0, ddof=1),
        damping_scatter=ratio.std(axis=0, ddof=1),
    )


def _trusted(whole: SpecimenFit, widened: Array, damping_widened: Array, dt_s: float) -> SpecimenFit:
    """Return a fit with its random errors multiplied by factors (n,), and the errors of clock and skew added."""
    skew = np.pi * whole.natural_frequency_hz * SKEW * dt_s
    return replace(
        whole,
        frequency_error_hz=np.hypot(whole.frequency_error_hz * widened, CLOCK * whole.natural_frequency_hz),
        damping_error=np.hypot(whole.damping_error * damping_widened, skew),
        stiffness_error_n_per_m=np.hypot(
            whole.stiffness_error_n_per_m * widened.max(), 2.0 * CLOCK * whole.stiffness_n_per_m
        ),
    )


def birge(values: Array, errors: Array) -> Array:
    """Return the Birge ratio (n,): scatter of estimates (k, n) over the scatter that their errors predict, at least 1.

    Source: R.T. Birge, Phys. Rev. 40, 207 (1932).
    """
    weight = 1.0 / errors**2
    mean = np.sum(weight * values, axis=0) / np.sum(weight, axis=0)
    return np.sqrt(np.maximum(np.sum(weight * (values - mean) ** 2, axis=0) / (len(values) - 1), 1.0))


def least_samples(frequency_hz: Array, dt_s: float, low_hz: float) -> int:
    """Return the least length of a stretch in samples: it must have LEAST_LINES lines from `low_hz` to the band's end.

    The end of the band follows from the natural frequencies (n,) in Hz.
    """
    width = max(ABOVE_HIGHEST * float(frequency_hz[-1]) - low_hz, low_hz)
    return int(np.ceil(LEAST_LINES / (width * dt_s))) + 1


def stretches_of(floor_accel: Array, free: bool, least: int = 2) -> tuple[slice, ...]:
    """Return the stretches into which a record (c, n) of the floors is divided.

    An excitation has five stretches of equal length. A free vibration has two, the first with 0.8 of the energy. The
    result is () if a stretch would be shorter than `least` samples.
    """
    n = floor_accel.shape[1]
    if not free:
        length = n // NOISE_STRETCHES
        return tuple(slice(i * length, (i + 1) * length) for i in range(NOISE_STRETCHES)) if length >= least else ()
    if n < 2 * least:
        return ()
    energy = np.cumsum(np.sum((floor_accel - floor_accel[:, -1:]) ** 2, axis=0))
    middle = int(np.searchsorted(energy, FREE_SHARE * energy[-1]))
    middle = min(max(middle, least), n - least)
    return slice(0, middle), slice(middle, n)


def alive(floor_accel: Array, noise_m_s2: Array) -> slice:
    """Return the part of a free vibration (c, n) up to its last sample above the channels' noise (c,)."""
    rest = np.median(floor_accel[:, -max(floor_accel.shape[1] // REST_SHARE, 1) :], axis=1)
    over = np.abs(floor_accel - rest[:, None]) > ALIVE_SIGMA * noise_m_s2[:, None]
    return slice(0, int(np.max(np.flatnonzero(over.any(axis=0)), initial=-1)) + 1)


def transform(motion: Motion, dt_s: float, band_hz: tuple[float, float]) -> Lines:
    """Return the Fourier lines of a stretch within a band, scaled so that the floors' sum of squares is 1.

    The first sample is replaced by the mean of both ends, so that the sum over samples is the trapezoidal rule.
    """
    count = _fast_length(len(motion.table) - 1)
    known = [] if motion.staircase is None else [motion.staircase]
    signals = np.vstack([motion.table, motion.floors, *known])[:, : count + 1]
    signals = np.hstack([0.5 * (signals[:, :1] + signals[:, -1:]), signals[:, 1:-1]])
    frequency = np.arange(count // 2 + 1) / (count * dt_s)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    spectra: ComplexArray = np.fft.rfft(signals)[:, inside]
    floors = len(motion.floors)
    size = float(np.linalg.norm(spectra[1 : 1 + floors]))
    if not size > 0.0:
        raise InputError(
            f"specimen: the floors do not move in {band_hz[0]:.3g}-{band_hz[1]:.3g} Hz for {count * dt_s:.3g} s of the "
            "record; excite louder, and look at the floors' channels"
        )
    spectra /= size
    s = (2j * np.pi * frequency[inside]).astype(complex)
    return Lines(s, spectra[0], spectra[1 : 1 + floors], spectra[1 + floors] if known else None)


@cache
def _fast_length(most: int) -> int:
    """Return the largest length up to `most` that has only small prime factors, for a fast Fourier transform."""
    from scipy.fft import next_fast_len

    length = next_fast_len(most // 2, real=True)
    while (longer := next_fast_len(length + 1, real=True)) <= most:
        length = longer
    return length


def _described(masses: Array, found: Solution, motions: int) -> SpecimenFit:
    """Return the fit with its standard errors, converted from the logarithms to frequencies and damping ratios."""
    stiffness, ratios = np.split(np.exp(found.parameters), 2)
    omega, shapes = modal(masses, stiffness)
    n, residual = len(masses), found.residual
    variance = float(residual @ residual) / max(len(residual) - (2 + 3 * motions) * n, 1)
    spread = covariance(found.slopes, variance)
    drift = np.diff(shapes, axis=0, prepend=np.zeros((1, n)))
    slope = frequency_slopes(omega, shapes, stiffness)
    K = storey_matrix(stiffness)
    unknown = np.full(n, np.nan)
    return SpecimenFit(
        specimen=Specimen(masses, K, modal_damping_matrix(masses, K, ratios)),
        stiffness_n_per_m=stiffness,
        dashpots_n_s_per_m=np.asarray(np.linalg.lstsq(drift.T**2, 2.0 * ratios * omega, rcond=None)[0], dtype=float),
        natural_frequency_hz=omega / (2.0 * np.pi),
        damping_ratio=ratios,
        mode_shapes=shapes / shapes[np.argmax(np.abs(shapes), axis=0), np.arange(n)],
        stiffness_error_n_per_m=stiffness * np.sqrt(np.diag(spread)[:n]),
        frequency_error_hz=np.sqrt(np.diag(slope @ spread[:n, :n] @ slope.T)) / (2.0 * np.pi),
        damping_error=ratios * np.sqrt(np.diag(spread)[n:]),
        frequency_scatter_hz=unknown,
        damping_scatter=unknown,
        residual=float(np.linalg.norm(residual) / np.sqrt(motions)),
    )
