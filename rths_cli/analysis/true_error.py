"""What an imperfect calibration lets a hybrid test be wrong by, although everything that is measured looks right.

A loop holds its *measured* table at the desired motion and feeds the shear of *measured* floors back. Where the sensors
or masses differ from what is taken for true by relative amounts d, the true table moves by 1 - d_table times the
desired motion, and the computed storeys feel a force that is wrong by m (d_floor - d_table - d_mass) times each floor's
acceleration. To first order the error is a sum over the parameters of the calibration, each a motion of the undivided
building under such a force, and with the calibration's covariance it has a distribution. The reference is the computed
storeys with the specimen as it is.

What the table's sensor reads of the held command's staircase (its alias) is identified beside the table, and looks like
a wrong corner: both are a velocity. So it takes up most of what a wrong corner does to the table's samples, and the
step, which takes the alias out, takes that out too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.analysis.fourier_lines import Lines
from rths_cli.analysis.sim import state_equation
from rths_cli.identification.results import Calibration
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model, StateSpace
from rths_cli.structure import Building

DRAWS, SEED = 4000, 22
LEAST_LINES = 8  # in the band of the table's model, of which its alias can be told from gain, delay and curvature
LEAST_ERROR = 1e-4  # of a measured response, relative: with less no line is weighed more
PREDICTION = 0.4  # standard uncertainty of the logarithm of what is predicted without regard to calibration
MEASURED = 0.05  # the same of the loop's error as a run shows it
BOUND = 0.95
WORTH = 0.95  # of the bound, to which a measurement must lower it to be advised
BETTER_GAIN, BETTER_MASS = 0.002, 0.001  # what a comparison of sensors, and a good balance, attain


@dataclass(frozen=True)
class OwnError:
    """RMS errors (n_storeys,) in m/s^2 of a test with a perfect calibration."""

    loop: Array  # as predicted
    changed: Array  # if the specimen's stiffness is off by one standard uncertainty; proportional to what it is off by
    pitch: Array | None = None  # by pitch of the specimen's base, where that of the reference is rigid; None: not seen
    pitch_error: float = 0.0  # relative standard uncertainty of how much it pitches


@dataclass(frozen=True)
class MeasuredError:
    """What a run showed of its errors, RMS (n_storeys,) in m/s^2 in the test band unless stated otherwise."""

    loop: Array  # of the loop (measured_error.py), with what sensors add to the motions that they report
    beside: Array  # (n_storeys, p) mean products of the loop's error and those per unit of the calibration's parameters
    read: Array  # expected of noise and rounding in `loop`
    true: Array  # expected of noise and rounding in the true motions
    changed: Array  # change of `loop` by what the run does not tell of the specimen: one standard uncertainty
    pitch: Array | None = None  # as in OwnError
    pitch_error: float = 0.0


@dataclass(frozen=True)
class TrueError:
    """The distribution of a test's true RMS errors in m/s^2 in the test band, by storey (n_storeys,)."""

    median: Array
    bound: Array  # not exceeded with 95 %
    calibration: Array  # root mean square of the part by the calibration
    pitch: Array | None  # the part by pitch of the specimen's base; None: none is seen
    drawn: Array  # (draws, n_storeys) of the distribution

    def rank(self, error: Array) -> Array:
        """Return the probability (n_storeys,) of a smaller error than `error` (n_storeys,) in m/s^2."""
        return np.asarray(np.mean(self.drawn < error, axis=0))


@dataclass(frozen=True)
class Remedy:
    """One measurement that would lower the bound: of which parameter of the calibration, to which uncertainty."""

    parameter: int
    error: float
    bound: Array  # (n_storeys,) in m/s^2 after it


@dataclass(frozen=True)
class Sensitivities:
    """Errors of true and of measured accelerations by the parameters of a calibration.

    `gram` (n_storeys, p, p) mean products of the true errors per unit of each parameter, in the test band, in
    (m/s^2)^2; `measured` (n_storeys, p, p) those of the errors that the sensors themselves show, of parameters that
    change after the identification.
    """

    gram: Array
    measured: Array

    def measured_rms(self, covariance: Array) -> Array:
        """Return the root mean square (n_storeys,) in m/s^2 of what the sensors show of parameters that changed with
        this covariance after the identification."""
        return np.asarray(np.sqrt(np.maximum(np.einsum("spq,pq->s", self.measured, covariance), 0.0)))

    def drawn(self, covariance: Array, own: OwnError) -> Array:
        """Return RMS errors (draws, n_storeys) in m/s^2, with `own` those of a perfect calibration.

        The draws are the same for every covariance, so that two of them can be compared.
        """
        random = np.random.default_rng(SEED)
        values, vectors = np.linalg.eigh(covariance)
        parameters = random.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        squares = np.einsum("dp,spq,dq->ds", parameters, self.gram, parameters, optimize=True)
        loop = own.loop * np.exp(PREDICTION * random.standard_normal((DRAWS, 1)))
        changed = own.changed * random.standard_normal((DRAWS, 1))
        squares = np.maximum(squares, 0.0) + loop**2 + changed**2
        if own.pitch is not None:
            squares += (own.pitch * (1.0 + own.pitch_error * random.standard_normal((DRAWS, 1)))) ** 2
        return np.asarray(np.sqrt(squares))


def sensitivities(
    building: Building, lines: Lines, sim: ComplexArray, corners_hz: Array, table: Model, measured: Frf
) -> Sensitivities:
    """Return the errors by each parameter of a calibration, in the order of its covariance.

    `sim` (n_storeys, m): accelerations of SIM of the building as identified; `corners_hz` (c,) of the AC couplings;
    `table` as identified from its response `measured`.
    """
    errors, shown = errors_by_calibration(building, lines, sim, corners_hz, table, measured)
    return Sensitivities(gram(lines, errors), gram(lines, shown))


def errors_by_calibration(
    building: Building, lines: Lines, sim: ComplexArray, corners_hz: Array, table: Model, measured: Frf
) -> tuple[list[ComplexArray], list[ComplexArray]]:
    """Return the true errors (n_storeys, m) per unit of each parameter, and those that the sensors show of it."""
    p, masses = len(building.numerical.masses_kg), building.specimen.masses_kg
    floors = len(masses)
    to_force = _per_interface_force(building, lines.frequency_hz)
    there = sim[p - 1 :]  # interface and floors
    held = np.vstack([np.zeros((p - 1, lines.count)), there])
    readings = _readings(lines.frequency_hz, corners_hz)
    if table.ripple_m_s2_per_v != 0.0:
        readings[:, 0] -= _taken_up(lines.frequency_hz, float(corners_hz[0]), table, measured)
    errors, shown = list[ComplexArray](), list[ComplexArray]()
    for reading in readings:
        for channel in range(1 + floors):
            share = np.zeros((1 + floors, lines.count), dtype=complex)
            if channel == 0:
                share[1:] -= reading[0]
            else:
                share[channel] = reading[channel]
            shear = -(masses @ (share[1:] * there[1:]))
            errors.append(to_force * shear - (reading[0] * held if channel == 0 else 0.0))
            read = np.zeros_like(held)
            read[p - 1 + channel] = reading[channel] * there[channel]
            shown.append(errors[-1] + read)
    of_masses = [to_force * masses[floor] * there[1 + floor] for floor in range(floors)]
    return [*errors, *of_masses], [*shown, *of_masses]


def _readings(frequency_hz: Array, corners_hz: Array) -> ComplexArray:
    """Return what channels (c,) read beyond the truth, relative (3, c, m), per log gain, log corner and s of lag."""
    s, w = 2j * np.pi * frequency_hz, 2.0 * np.pi * np.asarray(corners_hz)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        coupling = np.where(np.abs(s + w) > 0.0, -w / (s + w), 0.0)
    ones = np.ones_like(coupling)
    return np.array([ones, coupling, -s * ones])


def _taken_up(frequency_hz: Array, corner_hz: float, table: Model, measured: Frf) -> ComplexArray:
    """Return the part (3, m) of the table's own readings that its alias takes up when the table is identified.

    Least squares over the measured lines, weighed by their scatter as in that fit; gain, delay and curvature of
    the model take up what they can, too, and to that the loop holds the table as it does to the readings.
    """
    f = measured.frequency_hz
    inside = (f >= table.band_hz[0]) & (f <= table.band_hz[1]) & np.isfinite(measured.relative_error)
    if np.count_nonzero(inside) < LEAST_LINES:
        return np.zeros((3, len(frequency_hz)), dtype=complex)
    alias, weight = _alias(f[inside], table), 1.0 / np.hypot(measured.relative_error[inside], LEAST_ERROR)
    s = 2j * np.pi * f[inside] / table.band_hz[1]
    wanted = _readings(f[inside], np.array([corner_hz]))[:, 0] * weight
    rows = np.array([alias, np.ones(len(s)), s, s**2]) * weight
    columns, sides = (np.hstack([each.real, each.imag]).T for each in (rows, wanted))
    found = np.linalg.lstsq(columns, sides, rcond=None)[0][0]
    there = (frequency_hz >= table.band_hz[0]) & (frequency_hz <= table.band_hz[1])
    share = np.zeros(len(frequency_hz), dtype=complex)
    share[there] = _alias(frequency_hz[there], table)
    return found[:, None] * share


def _alias(frequency_hz: Array, table: Model) -> ComplexArray:
    return table.alias(frequency_hz) / table.response(frequency_hz)


def gram(lines: Lines, errors: Sequence[ComplexArray]) -> Array:
    """Return the mean products (n_storeys, p, p) of errors (n_storeys, m) in the test band."""
    series = lines.evaluated(np.array(errors))
    return np.asarray(np.einsum("psn,qsn->spq", series, series, optimize=True) / series.shape[-1])


def _per_interface_force(building: Building, frequency_hz: Array) -> ComplexArray:
    """Return the accelerations (n_storeys, m) of the undivided building per force on its interface floor."""
    n, p = len(building.M), len(building.numerical.masses_kg)
    a, b = state_equation(building.M, building.C, building.K)
    b = np.zeros_like(b)
    b[n:, 0] = np.linalg.solve(building.M, np.eye(n)[p - 1])
    return np.asarray(StateSpace(a, b, a[n:], b[n:]).response(frequency_hz)[:, 0])


def true_error(known: Sensitivities, found: Calibration, own: OwnError) -> TrueError:
    """Return the distribution of the true errors; `own` are those without regard to calibration."""
    drawn = known.drawn(found.covariance, own)
    parts = np.einsum("spq,pq->s", known.gram, found.covariance)
    return TrueError(
        np.median(drawn, axis=0), np.quantile(drawn, BOUND, axis=0), np.sqrt(np.maximum(parts, 0.0)), own.pitch,
        drawn,
    )  # fmt: skip


def true_error_of_run(of_calibration: Array, covariance: Array, run: MeasuredError) -> TrueError:
    """Return the distribution of the true errors of a run, whose loop's error is measured and not predicted.

    `of_calibration` (n_storeys, p, p): mean products of the true errors per unit of the calibration's parameters.

    The error of the loop is a known series, so that an error of the calibration may add to it or take it away.
    """
    random = np.random.default_rng(SEED)
    values, vectors = np.linalg.eigh(covariance)
    parameters = random.standard_normal((DRAWS, len(values))) @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    squares = np.einsum("dp,spq,dq->ds", parameters, of_calibration, parameters, optimize=True)
    squares += 2.0 * parameters @ run.beside.T
    louder = np.exp(PREDICTION * random.standard_normal((DRAWS, 1)))  # noise than predicted
    certain = np.maximum(run.loop**2 - (louder * run.read) ** 2, 0.0) * np.exp(
        2.0 * MEASURED * random.standard_normal((DRAWS, 1))
    )
    squares = np.maximum(squares + certain, 0.0) + (louder * run.true) ** 2
    squares += (run.changed * random.standard_normal((DRAWS, 1))) ** 2
    if run.pitch is not None:
        squares += (run.pitch * (1.0 + run.pitch_error * random.standard_normal((DRAWS, 1)))) ** 2
    drawn, parts = np.sqrt(squares), np.einsum("spq,pq->s", of_calibration, covariance)
    return TrueError(
        np.median(drawn, axis=0), np.quantile(drawn, BOUND, axis=0), np.sqrt(np.maximum(parts, 0.0)), run.pitch, drawn
    )


def products(lines: Lines, errors: Sequence[ComplexArray], other: ComplexArray) -> Array:
    """Return the mean products (n_storeys, p) in the test band of errors and another one, all (n_storeys, m)."""
    series, beside = lines.evaluated(np.array(errors)), lines.evaluated(other)
    return np.asarray(np.einsum("psn,sn->sp", series, beside) / series.shape[-1])


def best_remedy(known: Sensitivities, found: Calibration, own: OwnError) -> Remedy | None:
    """Return the one further measurement of a gain or a mass that lowers the largest bound most; None if none lowers it
    to WORTH of what it is."""
    channels = len(found.gain)
    candidates = [(place, BETTER_GAIN) for place in range(channels)]
    candidates += [(3 * channels + floor, BETTER_MASS) for floor in range(len(found.mass))]
    found_now = float(np.quantile(known.drawn(found.covariance, own), BOUND, axis=0).max())
    best: Remedy | None = None
    for place, error in candidates:
        column = found.covariance[:, place]
        if column[place] <= error**2:
            continue
        after = found.covariance - np.outer(column, column) / (column[place] + error**2)
        bound = np.quantile(known.drawn(after, own), BOUND, axis=0)
        if float(bound.max()) < (float(best.bound.max()) if best else WORTH * found_now):
            best = Remedy(place, error, bound)
    return best
