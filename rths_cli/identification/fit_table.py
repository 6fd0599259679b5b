"""The table's model: a stable, minimum-phase rational function fitted to the measured H1 of command to table.

The table follows displacement, so that the double zero at the origin is given, not fitted. A sample of the table
also carries an alias of the hold's staircase (`ripple`), of first order in s: it is fitted jointly, because no pole
or zero can stand for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.factors import Layout, pack, response_and_slopes, zeros_poles_gain
from rths_cli.lti import Array, ComplexArray, Frf, Model, staircase

LEAST_ERROR = 1e-3  # no line counts as known better than this
LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING, LAG_S = (7.0, 14.0, 26.0), (0.35, 0.7), (1.0, 3.0), 2e-3
START_LINES = 200
STARTS_KEPT = 4
PULL = 1e-4  # of a parameter's logarithm to its start, against a relative error of the fit
LATENCY_START_HZ, FAR_ZERO_START_HZ = 150.0, 250.0


@dataclass(frozen=True)
class FitError:
    """Relative error |fit / FRF - 1| of a model: rms and largest in 0.7-11 Hz, rms in 2-10 Hz."""

    rms: float
    largest: float
    rms_mid: float


@dataclass(frozen=True)
class _Problem:
    """Data of one fit: lines s (m,), FRF, weights, alias (None: not fitted) and the sign of the gain."""

    layout: Layout
    s: ComplexArray
    measured: ComplexArray
    weight: Array
    alias: ComplexArray | None
    sign: float

    def residual(self, theta: Array) -> Array:
        """Return weighted fit / FRF - 1, real parts then imaginary parts, (2 m,)."""
        value, _ = response_and_slopes(self.layout, theta, self.s)
        value *= self.sign
        if self.alias is not None:
            value += theta[-1] * self.alias
        return _stacked(self.weight * (value / self.measured - 1.0))

    def jacobian(self, theta: Array) -> Array:
        """Return the derivative of the residual, (2 m, n_parameters)."""
        value, slopes = response_and_slopes(self.layout, theta, self.s)
        slopes *= (self.sign * value)[:, None]
        if self.alias is not None:
            slopes = np.column_stack([slopes, self.alias])
        return _stacked((self.weight / self.measured)[:, None] * slopes)


def _stacked(values: ComplexArray) -> Array:
    return np.concatenate([values.real, values.imag])


def fit_error(model: Model, frf: Frf) -> FitError:
    """Compare a model's sampled response with a measured FRF: |fit / FRF - 1|."""
    f = frf.frequency_hz
    error = np.abs(model.sampled_response(f) / frf.response - 1.0)
    band, mid = (f >= 0.7) & (f <= 11.0), (f >= 2.0) & (f <= 10.0)
    return FitError(
        float(np.sqrt(np.mean(error[band] ** 2))), float(error[band].max()), float(np.sqrt(np.mean(error[mid] ** 2)))
    )


def fit_best(
    frf: Frf, modes: tuple[Array, Array], latency_samples: int, dt_s: float, band_hz: tuple[float, float]
) -> Model:
    """Fit 2 n + 3 poles, 2 n finite zeros, the declared delay (latency + half a sample) and the ripple.

    `modes`: natural frequencies in Hz and damping ratios (n,) of the specimen, where the zeros are looked for.
    Raises InputError when the band holds too few lines.
    """
    floors = len(modes[0])
    layout = Layout(floors + 1, 1, floors, (latency_samples + 0.5) * dt_s)
    problem = _problem(frf, layout, band_hz, staircase(frf.frequency_hz, latency_samples, dt_s))
    theta = _solve(problem, _best_start(problem, modes))
    return _best_model(problem, theta, latency_samples, dt_s, band_hz)


def _best_model(
    problem: _Problem, theta: Array, latency_samples: int, dt_s: float, band_hz: tuple[float, float]
) -> Model:
    zeros, poles, gain = zeros_poles_gain(problem.layout, theta[:-1], problem.sign)
    return Model(zeros, poles, gain, problem.layout.delay_s, band_hz, float(theta[-1]), latency_samples, dt_s)


def refit_best(frf: Frf, model: Model) -> Model:
    """Fit the best model again, to another FRF of the same table, starting from the model it had."""
    floors = len(model.zeros) // 2 - 1
    layout = Layout(floors + 1, 1, floors, model.delay_s)
    alias = staircase(frf.frequency_hz, model.latency_samples, model.dt_s)
    problem = _problem(frf, layout, model.band_hz, alias)
    gain, pairs, corner, zero_pairs = _factors_of(model)
    start = np.append(pack(gain, pairs, corner, zero_pairs), model.ripple_m_s2_per_v)
    return _best_model(problem, _solve(problem, start), model.latency_samples, model.dt_s, model.band_hz)


def fit_paper(frf: Frf, best: Model, band_hz: tuple[float, float]) -> Model:
    """Fit the paper's model: 2 n + 4 poles and as many zeros, two at the origin, no delay and no ripple.

    The extra pole and the extra zeros stand for the latency, and make the inverse proper. It starts from the
    best model.
    """
    floors = len(best.zeros) // 2 - 1
    layout = Layout(floors + 2, 0, floors + 1, 0.0)
    problem = _problem(frf, layout, band_hz, None)
    theta = _solve(problem, _paper_start(best))
    zeros, poles, gain = zeros_poles_gain(layout, theta, problem.sign)
    return Model(zeros, poles, gain, 0.0, band_hz, 0.0, best.latency_samples, best.dt_s)


def _problem(frf: Frf, layout: Layout, band_hz: tuple[float, float], alias: ComplexArray | None) -> _Problem:
    """Return the lines of a band, weighted by one over their relative error."""
    inside = (frf.frequency_hz >= band_hz[0]) & (frf.frequency_hz <= band_hz[1])
    if inside.sum() < 4 * layout.size:
        raise InputError(
            f"table model: {inside.sum()} lines in {band_hz[0]:g}-{band_hz[1]:g} Hz are too few to fit "
            f"{layout.size} parameters; excite for longer or widen the band"
        )
    s = (2j * np.pi * frf.frequency_hz[inside]).astype(complex)
    measured = frf.response[inside]
    weight = 1.0 / np.hypot(frf.relative_error[inside], LEAST_ERROR)
    weight /= np.sqrt(2.0 * np.sum(weight**2))
    low = slice(0, max(5, len(s) // 100))
    sign = float(np.sign(np.median((measured[low] / s[low] ** 2).real)))
    return _Problem(layout, s, measured, weight, None if alias is None else alias[inside], sign or 1.0)


def _thinned(problem: _Problem) -> _Problem:
    """Return about 200 of the lines, evenly spaced in log frequency, for the search of a start."""
    wanted = np.geomspace(abs(problem.s[0]), abs(problem.s[-1]), START_LINES)
    lines = np.unique(np.searchsorted(np.abs(problem.s), wanted).clip(max=len(problem.s) - 1))
    alias = None if problem.alias is None else problem.alias[lines]
    return _Problem(
        problem.layout, problem.s[lines], problem.measured[lines], problem.weight[lines], alias, problem.sign
    )


def _best_start(problem: _Problem, modes: tuple[Array, Array]) -> Array:
    """Return the best of several structured starts (loop frequency and damping), each improved on few lines."""
    few = _thinned(problem)
    low = slice(0, 10)
    gain = float(np.median(np.abs(few.measured[low] / few.s[low] ** 2)))
    specimen = np.column_stack([2.0 * np.pi * modes[0], modes[1]])
    starts = []
    for loop in product(LOOP_HZ, LOOP_RATIO, LOOP_STIFFENING):
        pair, corner = _loop_roots(*loop)
        starts.append(np.append(pack(gain, np.vstack([specimen * [0.99, 1.05], [pair]]), corner, specimen), 0.0))
    starts.sort(key=lambda theta: float(np.sum(few.residual(theta) ** 2)))
    improved = [_solve(few, theta, 30) for theta in starts[:STARTS_KEPT]]
    return min(improved, key=lambda theta: float(np.sum(few.residual(theta) ** 2)))


def _loop_roots(frequency_hz: float, ratio: float, stiffening: float) -> tuple[tuple[float, float], Array]:
    """Return pair (w, zeta) and corner (1,) in rad/s of a displacement loop closed around a lagging actuator.

    LAG_S s^3 + s^2 + r (2 zeta w s + w^2) = 0; r is above 1 when the loop was set for more mass than moves.
    """
    omega = 2.0 * np.pi * frequency_hz
    found: ComplexArray = np.roots([LAG_S, 1.0, stiffening * 2.0 * ratio * omega, stiffening * omega**2]).astype(
        complex
    )
    found = found[np.argsort(np.abs(found.imag))]  # a real root first
    return _pair_of(found[1:]), np.abs(found[:1])


def _factors_of(best: Model) -> tuple[float, Array, Array, Array]:
    """Return low-frequency gain, pole pairs (w, zeta), corner of the single pole and zero pairs of a best model."""
    pairs = np.array([_pair_of(best.poles[i : i + 2]) for i in range(0, len(best.poles) - 1, 2)])
    zeros = np.array([_pair_of(best.zeros[i : i + 2]) for i in range(2, len(best.zeros), 2)]).reshape(-1, 2)
    corner = np.abs(best.poles[-1:])
    gain = best.gain * np.prod(zeros[:, 0]) ** 2 / (np.prod(pairs[:, 0]) ** 2 * corner[0])
    return float(gain), pairs, corner, zeros


def _paper_start(best: Model) -> Array:
    """Return the best model with its lag and delay as a pair of far poles, and a farther pair of zeros."""
    gain, pairs, corner, zeros = _factors_of(best)
    far, far_zero = 2.0 * np.pi * LATENCY_START_HZ, [2.0 * np.pi * FAR_ZERO_START_HZ, 0.7]
    lag = 1.0 / corner[0] + best.delay_s + 2.0 * far_zero[1] / far_zero[0]
    return pack(gain, np.vstack([pairs, [[far, 0.5 * lag * far]]]), np.zeros(0), np.vstack([zeros, [far_zero]]))


def _pair_of(two: ComplexArray) -> tuple[float, float]:
    """Return w and zeta of two roots in the left half plane."""
    omega = float(np.sqrt(abs(two[0] * two[1])))
    return omega, float(-np.real(two[0] + two[1]) / (2.0 * omega))


def _solve(problem: _Problem, start: Array, evaluations: int = 100) -> Array:
    """Return the parameters of least weighted squares, reached from a start by Levenberg-Marquardt.

    A weak pull to the start (PULL) keeps parameters that the band does not determine from running away.
    """
    from scipy.optimize import least_squares

    pull = PULL * np.eye(len(start))
    return least_squares(
        lambda theta: np.concatenate([problem.residual(theta), pull @ (theta - start)]),
        start,
        lambda theta: np.vstack([problem.jacobian(theta), pull]),
        method="lm",
        max_nfev=evaluations,
        ftol=1e-8,
        xtol=1e-8,
    ).x
