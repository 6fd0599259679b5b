"""Fit the table's model to its response: starts, factors that stay stable, least squares.

G(s) = gain s^2 prod(1 + 2 zeta s / w + s^2 / w^2) / prod(...) exp(-s T): each pair of roots is a frequency and a
damping ratio (above 1: two real roots), each single pole a corner. The parameters are their logarithms.

The table follows displacement, so that the double zero at the origin is given, not fitted. A sample of the table
also carries an alias of the hold's staircase (`ripple`), of first order in s: it is fitted jointly, because no pole
or zero can stand for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.least_squares import covariance, least_squares, parts
from rths_cli.identification.results import FitError
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model, hold_size, staircase


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
        values = np.exp(parameters[: self._roots])  # what may follow, a ripple, is no logarithm
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


LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING, LAG_S = (7.0, 14.0, 26.0), (0.35, 0.7), (1.0, 3.0), 2e-3
START_LINES = 200
STARTS_KEPT = 4


def first_fit(frf: Frf, modes: tuple[Array, Array], timing: Timing, band_hz: tuple[float, float]) -> Fit:
    """Fit 2 n + 3 poles, the declared delay and the ripple, from the best of many starts, with 2 n finite zeros held.

    `modes`: natural frequencies in Hz and damping ratios (n,) of the specimen on a fixed base. The table cannot move at
    them whatever drives it: they are its zeros.
    Raises InputError when the band holds too few lines.
    """
    floors = len(modes[0])
    layout = Layout(floors + 1, 1, floors, timing.delay_s)
    problem = problem_of(frf, layout, timing, band_hz, ripple=True)
    return fit(frf, layout, best_start(problem, modes), timing, band_hz, ripple=True, held_zeros=floors)


def best_start(problem: Problem, modes: tuple[Array, Array]) -> Array:
    """Return the best of several structured starts (loop frequency and damping), each improved on few lines."""
    few = thinned(problem)
    low = slice(0, 10)
    gain = float(np.median(np.abs(few.measured[low] / few.s[low] ** 2)))
    specimen = np.column_stack([2.0 * np.pi * modes[0], modes[1]])
    starts = []
    for loop in product(LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING):
        pair, corner = _loop_roots(*loop)
        starts.append(np.append(pack(gain, np.vstack([specimen * [0.99, 1.05], [pair]]), corner, specimen), 0.0))
    return best_of(few, starts, few.layout.zeros(few.layout.zero_pairs))


def best_of(few: Problem, starts: list[Array], held: slice | None = None) -> Array:
    """Return the start of least error after a few steps from each of the four that begin best."""
    starts = sorted(starts, key=lambda theta: float(np.sum(few.evaluated(theta)[0] ** 2)))
    improved = [solve(few, theta, 30, held)[0] for theta in starts[:STARTS_KEPT]]
    return min(improved, key=lambda theta: float(np.sum(few.evaluated(theta)[0] ** 2)))


def thinned(problem: Problem) -> Problem:
    """Return about 200 of the lines, evenly spaced in log frequency, for the search of a start."""
    wanted = np.geomspace(abs(problem.s[0]), abs(problem.s[-1]), START_LINES)
    lines = np.unique(np.searchsorted(np.abs(problem.s), wanted).clip(max=len(problem.s) - 1))
    alias = None if problem.alias is None else problem.alias[lines]
    return replace(
        problem,
        s=problem.s[lines],
        measured=problem.measured[lines],
        weight=problem.weight[lines],
        alias=alias,
        hold=problem.hold[lines],
    )


def _loop_roots(frequency_hz: float, ratio: float, stiffening: float) -> tuple[tuple[float, float], Array]:
    """Return pair (w, zeta) and corner (1,) in rad/s of a displacement loop closed around a lagging actuator.

    LAG_S s^3 + s^2 + r (2 zeta w s + w^2) = 0; r is above 1 when the loop was set for more mass than moves.
    """
    omega = 2.0 * np.pi * frequency_hz
    found: ComplexArray = np.roots([LAG_S, 1.0, stiffening * 2.0 * ratio * omega, stiffening * omega**2]).astype(
        complex
    )
    found = found[np.argsort(np.abs(found.imag))]  # a real root first
    two = found[1:]
    size = float(np.sqrt(abs(two[0] * two[1])))
    return (size, float(-np.real(two[0] + two[1]) / (2.0 * size))), np.abs(found[:1])


LEAST_ERROR = 1e-3  # no line counts as known better than this
PULL = 1e-4  # of a parameter's logarithm to its start, against a relative error of the fit
HOLD = 30.0
REACH = 1e4  # factor by which a root or the gain may leave its start
LATENCY_START_HZ, FAR_ZERO_START_HZ = 150.0, 250.0
LINES_PER_PARAMETER = 2
MOST_EVALUATIONS = 400  # of the response, in a fit; the paper's takes up to 300
SCATTER = 2.0  # standard errors of a line that are not held against a model
COMPARED_HZ, MID_HZ = (0.7, 11.0), (2.0, 10.0)


@dataclass(frozen=True)
class Timing:
    """When commands act: the loop's declared latency in samples of `dt_s`, and what a link adds; and the corner of the
    AC coupling that the table's samples are corrected for (0: none)."""

    latency_samples: int
    dt_s: float
    transport_s: float = 0.0
    coupling_hz: float = 0.0

    @property
    def delay_s(self) -> float:
        """Return the declared transport delay: latency, half a sample of hold, and the link's."""
        return (self.latency_samples + 0.5) * self.dt_s + self.transport_s


def timing_of(model: Model) -> Timing:
    """Return the timing that a model was fitted with, without what its link adds."""
    return Timing(model.latency_samples, model.dt_s, coupling_hz=model.coupling_hz)


@dataclass(frozen=True)
class Fit:
    """A model and what a further fit starts from: layout, parameters (with the ripple last, where it is fitted), their
    covariance, from the weighted residual and the lines' bandwidth, and how many zero pairs are held, where the
    specimen's modes are."""

    model: Model
    layout: Layout
    parameters: Array
    covariance: Array
    held_zeros: int = 0


@dataclass(frozen=True)
class Problem:
    """Data of one fit: lines s (m,), FRF, weights, alias (None: not fitted), size of the hold, sign of the gain."""

    layout: Layout
    s: ComplexArray
    measured: ComplexArray
    weight: Array
    alias: ComplexArray | None
    hold: Array
    sign: float

    def evaluated(self, theta: Array) -> tuple[Array, Array]:
        """Return weighted fit / FRF - 1, real and imaginary part of a line side by side, (2 m,), and its slopes
        (n_parameters, 2 m)."""
        value, slopes = response_and_slopes(self.layout, theta, self.s)
        over = self.weight / self.measured
        value *= self.sign * self.hold * over
        slopes *= value
        if self.alias is not None:
            alias = self.alias * over
            value = value + theta[-1] * alias
            slopes = np.vstack([slopes, alias])
        return parts(value - self.weight), parts(slopes)


def fit_error(model: Model, frf: Frf) -> FitError:
    """Compare a model's sampled response with a measured FRF: |fit / FRF - 1|."""
    f = frf.frequency_hz
    error = np.abs(model.sampled_response(f) / frf.response - 1.0)
    band, mid = within(f, COMPARED_HZ), within(f, MID_HZ)
    return FitError(rms(error[band]), float(error[band].max()), rms(error[mid]))


def beyond_scatter(model: Model, frf: Frf) -> FitError:
    """Return what of a model's error its data can tell: |fit / FRF - 1| beyond two standard errors of each line, and
    what the scatter of all lines in a band leaves uncertain of the model itself, two standard errors of its mean.

    A model of p parameters has the variance of p of the lines' errors, spread over them: p / sum of 1 / error^2.
    """
    f = frf.frequency_hz
    error = np.abs(model.sampled_response(f) / frf.response - 1.0)
    excess = np.maximum(error - SCATTER * frf.relative_error, 0.0)
    parameters = len(model.poles) + len(model.zeros) - 1  # two zeros are given, the gain is not
    found = []
    for band in (COMPARED_HZ, MID_HZ):
        inside = within(f, band)
        known = float(np.sum(1.0 / frf.relative_error[inside] ** 2))
        uncertain = SCATTER * np.sqrt(parameters * frf.bandwidth_lines / known)
        found.append((float(np.hypot(rms(excess[inside]), uncertain)), float(excess[inside].max())))
    (wide, largest), (mid, _) = found
    return FitError(wide, largest, mid)


def within(frequency_hz: Array, band_hz: tuple[float, float]) -> np.ndarray:
    """Tell which frequencies (m,) lie in a band, (m,)."""
    return (frequency_hz >= band_hz[0] - 1e-9) & (frequency_hz <= band_hz[1] + 1e-9)


def rms(values: Array) -> float:
    """Return the root mean square of values (m,)."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def fit(
    frf: Frf, layout: Layout, start: Array, timing: Timing, band_hz: tuple[float, float], ripple: bool,
    held_zeros: int = 0,
) -> Fit:  # fmt: skip
    """Fit a layout's roots, and the ripple, to a response in a band.

    `start`: parameters of the layout, with the ripple last where it is fitted; the first `held_zeros` pairs of
    zeros stay where they start. Raises InputError when the band holds too few lines.
    """
    problem = problem_of(frf, layout, timing, band_hz, ripple)
    theta, spread = solve(problem, start, held=layout.zeros(held_zeros))
    zeros, poles, gain = zeros_poles_gain(layout, theta, problem.sign)
    staircase_share = float(theta[-1]) if ripple else 0.0
    delay = layout.delay(theta)
    sampling = (timing.latency_samples, timing.dt_s, timing.coupling_hz)
    model = Model(zeros, poles, gain, delay, band_hz, staircase_share, *sampling)
    return Fit(model, layout, theta, frf.bandwidth_lines * spread, held_zeros)


def refit(frf: Frf, before: Fit) -> Fit:
    """Fit the same layout to another response of the same table, starting from what was found."""
    ripple, model = len(before.parameters) > before.layout.size, before.model
    return fit(frf, before.layout, before.parameters, timing_of(model), model.band_hz, ripple, before.held_zeros)


def fit_paper(frf: Frf, best: Fit, band_hz: tuple[float, float]) -> Fit:
    """Fit the paper's model: 2 n + 4 poles and as many zeros for n modes, two at the origin, no delay and no ripple.

    The extra pole and the extra zeros stand for the latency, and make the inverse proper. It starts from the best
    model of 2 n + 3 poles.
    """
    layout, start = rational_latency(best)
    return fit(frf, layout, start, timing_of(best.model), band_hz, ripple=False)


def rational_latency(best: Fit) -> tuple[Layout, Array]:
    """Return layout and start of a model whose roots carry the delay: a pair of far poles, a farther pair of zeros."""
    pairs, corner, zeros = best.layout.pairs(best.parameters)
    far, far_zero = 2.0 * np.pi * LATENCY_START_HZ, [2.0 * np.pi * FAR_ZERO_START_HZ, 0.7]
    lag = float(np.sum(1.0 / corner)) + best.model.delay_s + 2.0 * far_zero[1] / far_zero[0]
    gain = float(np.exp(best.parameters[0]))
    start = pack(gain, np.vstack([pairs, [[far, 0.5 * lag * far]]]), np.zeros(0), np.vstack([zeros, [far_zero]]))
    return Layout(best.layout.pole_pairs + 1, 0, best.layout.zero_pairs + 1, 0.0), start


def problem_of(frf: Frf, layout: Layout, timing: Timing, band_hz: tuple[float, float], ripple: bool) -> Problem:
    """Return the lines of a band, weighted by one over their relative error."""
    inside = within(frf.frequency_hz, band_hz)
    if inside.sum() < LINES_PER_PARAMETER * layout.size:
        raise InputError(
            f"table model: {inside.sum()} lines in {band_hz[0]:g}-{band_hz[1]:g} Hz are too few to fit "
            f"{layout.size} parameters; excite for longer or widen the band"
        )
    s = (2j * np.pi * frf.frequency_hz[inside]).astype(complex)
    measured = frf.response[inside]
    weight = 1.0 / np.hypot(frf.relative_error[inside], LEAST_ERROR)
    weight /= np.sqrt(2.0 * np.sum(weight**2))
    f = frf.frequency_hz[inside]
    alias = staircase(f, timing.latency_samples, timing.dt_s, timing.coupling_hz) if ripple else None
    hold = hold_size(f, timing.dt_s)
    return Problem(layout, s, measured, weight, alias, hold, _sign(s, measured))


def _sign(s: ComplexArray, measured: ComplexArray) -> float:
    """Return the sign of the displacement at the lowest lines."""
    low = slice(0, max(5, len(s) // 100))
    return float(np.sign(np.median((measured[low] / s[low] ** 2).real))) or 1.0


def solve(
    problem: Problem, start: Array, evaluations: int = MOST_EVALUATIONS, held: slice | None = None
) -> tuple[Array, Array]:
    """Return parameters of least weighted squares, reached by Levenberg-Marquardt, and their covariance.

    A weak pull to the start (PULL) keeps parameters that the band does not determine from running away; those that are
    `held` hardly leave it.
    """
    strength = np.full(len(start), PULL)
    if held is not None:
        strength[held] = HOLD
    pull = np.diag(strength)

    def pulled(theta: Array) -> tuple[Array, Array]:
        residual, slopes = problem.evaluated(theta)
        return np.concatenate([residual, strength * (theta - start)]), np.hstack([slopes, pull])

    reach = np.where(np.arange(len(start)) < problem.layout.size, np.log(REACH), np.inf)  # the ripple is no logarithm
    found = least_squares(pulled, start, evaluations=evaluations, reach=reach)
    left = found.residual[: -len(start)]
    variance = float(left @ left) / max(len(left) - len(start), 1)
    known = np.concatenate([np.ones(len(left)), strength == HOLD])  # the weak pull is no knowledge
    return found.parameters, covariance(found.slopes * known, variance)
