"""Fit the table model to its frequency response: starting values, stable factors, least squares.

G(s) = gain s^2 prod(1 + 2 zeta s / w + s^2 / w^2) / prod(...) exp(-s T). Each pair of roots has a frequency and a
damping ratio (above 1: two real roots), each single pole has a corner frequency. The parameters are their logarithms.

The table follows displacement, so that the double zero at the origin is given and not fitted. The table's samples also
contain an alias of the hold's staircase (`ripple`), of first order in s. It is fitted together with the roots, because
no pole or zero can represent it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.least_squares import covariance, least_squares, parts
from rths_cli.identification.results import FitError
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model, hold_size, staircase


@dataclass(frozen=True)
class Layout:
    """Structure of a table model: number of pole pairs, single poles and pairs of finite zeros; `delay_s` is T.

    The parameters are log |gain|, then (log w, log zeta) of each pole pair, log corner of each single pole, (log w, log
    zeta) of each zero pair, and with `fits_delay` the log of a delay beyond T; w and corners in rad/s.
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
        """Return the slice of the parameters that belong to the first `pairs` zero pairs."""
        first = self._roots - 2 * self.zero_pairs
        return slice(first, first + 2 * pairs)

    def delay(self, parameters: Array) -> float:
        """Return the whole delay in s."""
        return self.delay_s + (float(np.exp(parameters[self._roots])) if self.fits_delay else 0.0)

    def pairs(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Return pole pairs (m, 2), corners of the single poles (k,) and zero pairs (n, 2), not as logarithms."""
        values = np.exp(parameters[: self._roots])  # a ripple may follow, which is not a logarithm
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
    """Return the factors 1 + 2 zeta s / w + s^2 / w^2 (n, m) of pairs (n, 2), and their slopes.

    The slopes (2 n, m) are those of minus the factor's logarithm, by log w and log zeta of each pair.
    """
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


# starts of the first fit; frequencies and lag belong to the usual compared band
LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING, LAG_S = (7.0, 14.0, 26.0), (0.35, 0.7), (1.0, 3.0), 2e-3
DECK_HZ, DECK_RATIO = (25.0, 50.0, 100.0, 200.0), 0.1  # resonance of a deck on a flexible drive, with the drive free
START_LINES = 200
STARTS_KEPT = 4


def first_fit(
    frf: Frf, modes: tuple[Array, Array], timing: Timing, band_hz: tuple[float, float], compared: ComparedBand = USUAL,
    flexible: bool = False,
) -> Fit:  # fmt: skip
    """Fit 2 n + 3 poles and the ripple, with the declared delay, 2 n fixed finite zeros and the best of many starts.

    A `flexible` drive adds a pole pair and no zero, because a spring between coil and deck has a force at every
    frequency. `modes`: natural frequencies in Hz and damping ratios (n,) of the specimen on a fixed base. The table
    cannot move at these frequencies, whatever drives it; they are its zeros. Raises InputError if the band has too few
    lines.
    """
    floors = len(modes[0])
    layout = Layout(floors + 1 + flexible, 1, floors, timing.delay_s)
    problem = problem_of(frf, layout, timing, band_hz, ripple=True)
    return fit(frf, layout, best_start(problem, modes, compared), timing, band_hz, ripple=True, held_zeros=floors)


def best_start(problem: Problem, modes: tuple[Array, Array], compared: ComparedBand = USUAL) -> Array:
    """Return the best of several starts (loop frequency, damping, stiffness), each improved with few lines."""
    few = thinned(problem)
    low = slice(0, 10)
    gain = float(np.median(np.abs(few.measured[low] / few.s[low] ** 2)))
    specimen = np.column_stack([2.0 * np.pi * modes[0], modes[1]])
    decks = [np.zeros((0, 2))]
    if few.layout.pole_pairs > len(specimen) + 1:
        decks = [np.array([[2.0 * np.pi * compared.with_high(deck_hz), DECK_RATIO]]) for deck_hz in DECK_HZ]
    starts = []
    for hz, ratio, stiffening, deck in product(LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING, decks):
        pair, corner = _loop_roots(hz, ratio, stiffening, compared.with_high(1.0))
        pairs = np.vstack([specimen * [0.99, 1.05], [pair], deck])
        starts.append(np.append(pack(gain, pairs, corner, specimen), 0.0))
    return best_of(few, starts, few.layout.zeros(few.layout.zero_pairs))


def best_of(few: Problem, starts: list[Array], held: slice | None = None) -> Array:
    """Return the start with the least error, after a few steps from each of the four best ones."""
    starts = sorted(starts, key=lambda theta: float(np.sum(few.evaluated(theta)[0] ** 2)))
    improved = [solve(few, theta, 30, held)[0] for theta in starts[:STARTS_KEPT]]
    return min(improved, key=lambda theta: float(np.sum(few.evaluated(theta)[0] ** 2)))


def thinned(problem: Problem) -> Problem:
    """Return the problem with about 200 of its lines, evenly spaced in log frequency, for the search of a start."""
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


def _loop_roots(usual_hz: float, ratio: float, stiffening: float, faster: float) -> tuple[tuple[float, float], Array]:
    """Return pair (w, zeta) and corner (1,) in rad/s of a displacement loop closed around a lagging actuator.

    LAG_S s^3 + s^2 + r (2 zeta w s + w^2) = 0; r is above 1 if the loop was tuned for more mass than the moving one.
    `faster` is the factor by which the roots are faster than those of the usual band.
    """
    omega = 2.0 * np.pi * faster * usual_hz
    found: ComplexArray = np.roots(
        [LAG_S / faster, 1.0, stiffening * 2.0 * ratio * omega, stiffening * omega**2]
    ).astype(complex)
    found = found[np.argsort(np.abs(found.imag))]  # a real root first
    two = found[1:]
    size = float(np.sqrt(abs(two[0] * two[1])))
    return (size, float(-np.real(two[0] + two[1]) / (2.0 * size))), np.abs(found[:1])


LEAST_ERROR = 1e-3  # smallest relative error assumed for a line
PULL = 1e-4  # weight of a parameter's change (logarithm) from its start, against a relative error of the fit
HOLD = 30.0  # the same weight for a parameter that is fixed
REACH = 1e4  # largest factor between a root or the gain and its start
LATENCY_START_HZ, FAR_ZERO_START_HZ = 150.0, 250.0  # with the usual compared band
LINES_PER_PARAMETER = 2
MOST_EVALUATIONS = 400  # evaluations of the response in a fit; the fit of the paper's model takes up to 300
SCATTER = 2.0  # standard errors of a line that are subtracted from a model's error


@dataclass(frozen=True)
class Timing:
    """Timing of the commands, and the AC coupling that was corrected in the table's samples."""

    latency_samples: int  # declared latency of the loop
    dt_s: float
    transport_s: float = 0.0  # further delay of a link
    coupling_hz: float = 0.0  # corner of the corrected AC coupling; 0: none

    @property
    def delay_s(self) -> float:
        """Return the declared transport delay: latency, half a sample of hold, and the link's."""
        return (self.latency_samples + 0.5) * self.dt_s + self.transport_s


def timing_of(model: Model) -> Timing:
    """Return the timing with which a model was fitted, without the delay of its link."""
    return Timing(model.latency_samples, model.dt_s, coupling_hz=model.coupling_hz)


@dataclass(frozen=True)
class Fit:
    """A fitted model, with the values from which a further fit starts."""

    model: Model
    layout: Layout
    parameters: Array  # (n,) of the layout, with the ripple last if it is fitted
    covariance: Array  # (n, n) of the parameters, from the weighted residual and the lines' bandwidth
    held_zeros: int = 0  # number of zero pairs that are fixed at the specimen's modes


@dataclass(frozen=True)
class Problem:
    """Data of one fit, on m lines."""

    layout: Layout
    s: ComplexArray  # (m,) rad/s
    measured: ComplexArray  # (m,) FRF
    weight: Array  # (m,)
    alias: ComplexArray | None  # (m,) of the staircase for a ripple of 1; None: no ripple is fitted
    hold: Array  # (m,) gain of the hold
    sign: float  # of the table's gain

    def evaluated(self, theta: Array) -> tuple[Array, Array]:
        """Return the residual (2 m,), weighted fit / FRF - 1, and its slopes (n_parameters, 2 m).

        Real and imaginary part of a line are neighbours.
        """
        value, slopes = response_and_slopes(self.layout, theta, self.s)
        over = self.weight / self.measured
        value *= self.sign * self.hold * over
        slopes *= value
        if self.alias is not None:
            alias = self.alias * over
            value = value + theta[-1] * alias
            slopes = np.vstack([slopes, alias])
        return parts(value - self.weight), parts(slopes)


def fit_error(model: Model, frf: Frf, compared: ComparedBand = USUAL) -> FitError:
    """Compare a model's sampled response with a measured FRF: |fit / FRF - 1|."""
    f = frf.frequency_hz
    error = np.abs(model.sampled_response(f) / frf.response - 1.0)
    band, mid = within(f, compared.hz), within(f, compared.mid_hz)
    return FitError(rms(error[band]), float(error[band].max()), rms(error[mid]))


def beyond_scatter(model: Model, frf: Frf, compared: ComparedBand = USUAL) -> FitError:
    """Return a model's error |fit / FRF - 1| beyond the scatter of its data, with the uncertainty of the model added.

    Two standard errors are subtracted from the error of each line. To the rms in a band, two standard errors of the
    model itself are added in quadrature. The variance of a model with p parameters, averaged over the band, is
    p / sum of 1 / error^2 over the lines.
    """
    f = frf.frequency_hz
    error = np.abs(model.sampled_response(f) / frf.response - 1.0)
    excess = np.maximum(error - SCATTER * frf.relative_error, 0.0)
    parameters = len(model.poles) + len(model.zeros) - 1  # roots and gain, without the two zeros at the origin
    found = []
    for band in (compared.hz, compared.mid_hz):
        inside = within(f, band)
        known = float(np.sum(1.0 / frf.relative_error[inside] ** 2))
        uncertain = SCATTER * np.sqrt(parameters * frf.bandwidth_lines / known)
        found.append((float(np.hypot(rms(excess[inside]), uncertain)), float(excess[inside].max())))
    (wide, largest), (mid, _) = found
    return FitError(wide, largest, mid)


def within(frequency_hz: Array, band_hz: tuple[float, float]) -> np.ndarray:
    """Return which of the frequencies (m,) are in a band, (m,) bool."""
    return (frequency_hz >= band_hz[0] - 1e-9) & (frequency_hz <= band_hz[1] + 1e-9)


def rms(values: Array) -> float:
    """Return the root mean square of values (m,)."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def fit(
    frf: Frf, layout: Layout, start: Array, timing: Timing, band_hz: tuple[float, float], ripple: bool,
    held_zeros: int = 0,
) -> Fit:  # fmt: skip
    """Fit a layout's roots, and the ripple, to a response in a band.

    `start`: parameters of the layout, with the ripple last if it is fitted; the first `held_zeros` zero pairs stay at
    their start. Raises InputError if the band has too few lines.
    """
    problem = problem_of(frf, layout, timing, band_hz, ripple)
    theta, spread = solve(problem, start, held=layout.zeros(held_zeros))
    zeros, poles, gain = zeros_poles_gain(layout, theta, problem.sign)
    staircase_share = float(theta[-1]) if ripple else 0.0
    delay = layout.delay(theta)
    sampling = (timing.latency_samples, timing.dt_s, timing.coupling_hz)
    model = Model(zeros, poles, gain, delay, band_hz, staircase_share, *sampling)
    return Fit(model, layout, theta, frf.bandwidth_lines * spread, held_zeros)


def without_fastest_pair(found: Fit) -> Fit:
    """Return a fit as the start of one without its fastest pole pair; model and covariance stay those of the fit."""
    pairs = found.layout.pairs(found.parameters)[0]
    first = 1 + 2 * int(np.argmax(pairs[:, 0]))
    layout = replace(found.layout, pole_pairs=found.layout.pole_pairs - 1)
    return replace(found, layout=layout, parameters=np.delete(found.parameters, [first, first + 1]))


def refit(frf: Frf, before: Fit) -> Fit:
    """Fit the same layout to another response of the same table, starting from an earlier fit."""
    ripple, model = len(before.parameters) > before.layout.size, before.model
    return fit(frf, before.layout, before.parameters, timing_of(model), model.band_hz, ripple, before.held_zeros)


def fit_paper(frf: Frf, best: Fit, band_hz: tuple[float, float], compared: ComparedBand = USUAL) -> Fit:
    """Fit the paper's model: 2 n + 4 poles and as many zeros for n modes, two at the origin, no delay and no ripple.

    The extra pole and the extra zeros represent the latency and make the inverse proper. The fit starts from the best
    model of 2 n + 3 poles.
    """
    layout, start = rational_latency(best, compared)
    return fit(frf, layout, start, timing_of(best.model), band_hz, ripple=False)


def rational_latency(best: Fit, compared: ComparedBand = USUAL) -> tuple[Layout, Array]:
    """Return layout and start of a model whose roots represent the delay by far poles and still farther zeros."""
    pairs, corner, zeros = best.layout.pairs(best.parameters)
    pole_hz, zero_hz = (compared.with_high(hz) for hz in (LATENCY_START_HZ, FAR_ZERO_START_HZ))
    far, far_zero = 2.0 * np.pi * pole_hz, [2.0 * np.pi * zero_hz, 0.7]
    lag = float(np.sum(1.0 / corner)) + best.model.delay_s + 2.0 * far_zero[1] / far_zero[0]
    gain = float(np.exp(best.parameters[0]))
    start = pack(gain, np.vstack([pairs, [[far, 0.5 * lag * far]]]), np.zeros(0), np.vstack([zeros, [far_zero]]))
    return Layout(best.layout.pole_pairs + 1, 0, best.layout.zero_pairs + 1, 0.0), start


def problem_of(frf: Frf, layout: Layout, timing: Timing, band_hz: tuple[float, float], ripple: bool) -> Problem:
    """Return the lines of a band, weighted by one over their relative error.

    Raises InputError if they are too few.
    """
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
    """Return the sign of the displacement's response at the lowest lines."""
    low = slice(0, max(5, len(s) // 100))
    return float(np.sign(np.median((measured[low] / s[low] ** 2).real))) or 1.0


def solve(
    problem: Problem, start: Array, evaluations: int = MOST_EVALUATIONS, held: slice | None = None
) -> tuple[Array, Array]:
    """Return the parameters with the least weighted squares, by Levenberg-Marquardt, and their covariance.

    A weak regularisation towards the start (PULL) keeps parameters bounded that the band does not determine. A strong
    one (HOLD) fixes the parameters in the slice `held`.
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
    known = np.concatenate([np.ones(len(left)), strength == HOLD])  # the weak regularisation is no information
    return found.parameters, covariance(found.slopes * known, variance)
