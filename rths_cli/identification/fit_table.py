"""The table's model: a stable, minimum-phase rational function fitted to the measured response of command to table.

The table follows displacement, so that the double zero at the origin is given, not fitted. A sample of the table
also carries an alias of the hold's staircase (`ripple`), of first order in s: it is fitted jointly, because no pole
or zero can stand for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.factors import Layout, pack, response_and_slopes, zeros_poles_gain
from rths_cli.identification.found import FitError
from rths_cli.identification.least_squares import covariance, least_squares, parts
from rths_cli.lti import Array, ComplexArray, Frf, Model, hold_size, staircase

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
