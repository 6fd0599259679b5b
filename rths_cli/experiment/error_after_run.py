"""The true error of a hybrid test after its run: median and 95 % bound, by what the run itself measured.

The true error is the RMS in the test band of the true accelerations against SIM of the declared computed storeys below
the specimen that stood there during the run. It is made of the loop's error, which the run shows whatever the specimen
is, of what sensors cannot show (the calibration's covariance), of pitch, and of what the
run does not tell of its specimen. That one is fitted to the run's own table and floors; where it is another one than
the identified, by more than both uncertainties and the level explain, it is the reference's.

The error of the loop: put the measured motion of table and floors into the equations of the computed storeys: with the
shear of the measured floors they should move as

    x = N(ground, F),    F = -(sum of masses times measured accelerations).

What the test moved otherwise, r = reported - N(ground, F), is all that the loop did wrong: tracking errors, latency,
friction, noise in the command, held commands, dropouts, saturation and the integration scheme. The specimen obeys its
own equations in the test as in the ideal one, S. So the interface is wrong by e = r + N_F S e, the motion of the
undivided building by a kinematic error r of the specimen's base. A specimen that differs from the one in S by some
percent changes e by some percent of itself, while it changes SIM by far more.

Errors of sensors and masses are not in it: the motion and F are those that the sensors show (true_error.py has them).
Of noise in the floors' samples nothing is in r, because F has it, too; it moves the table nevertheless.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.error_budget import at_full_rate
from rths_cli.analysis.fourier_lines import sim_lines
from rths_cli.analysis.predicted_error import noise_shown_and_true, white_noise_m_s2
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import state_equation
from rths_cli.analysis.true_error import (
    MeasuredError,
    TrueError,
    errors_by_calibration,
    gram,
    products,
    true_error_of_run,
)
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.control.state_space import discretise
from rths_cli.errors import InputError
from rths_cli.experiment import run_metrics
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.identification.identify_specimen import without_staircase
from rths_cli.identification.specimen_fit import Motion, Start, fit_stretches, least_samples
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.lost_samples import MIXED, without_samples
from rths_cli.numerics.lti import Array, ComplexArray, StateSpace
from rths_cli.structure import Building, Specimen, modal_damping_matrix, storey_matrix, storey_values
from rths_cli.structure.tangents import on_specimen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from rths_cli.experiment.check import Uncertain
    from rths_cli.experiment.one_table_run import Run
    from rths_cli.experiment.run_signals import Series
    from rths_cli.identification.results import SpecimenFit
    from rths_cli.quantities import Values

FINEST_S = 2.5e-4  # between which the shear of the floors may be taken for straight

RUN = "exp_rths"
CHANGED = 3.0  # standard uncertainties from which the specimen has changed since the identification
TELLS = 0.2  # largest relative standard uncertainty of a stiffness in the run that tells whether the specimen changed
MOST_UNEXPLAINED = 0.1  # of the floors' motion: what a chain of storeys on the measured table may leave unexplained
OF_IDENTIFIED = 3.0  # times what it left at the identification: the same limit of a specimen that is no such chain
AFTER_GAP = 3  # samples after a gap that tell what the table did in it
GAP_ERROR = 0.3  # standard uncertainty of what is reconstructed of gaps, over what it changes
OF_SAMPLES = 0.5  # of what is left unexplained, from which noise and rounding of the samples explain it
BELOW_FIRST = 0.5  # the lines of the fit begin at this fraction of the specimen's first natural frequency or lower


def residual_of_computed_storeys(building: Building, dt_s: float, ground_m_s2: Array, reported_m_s2: Array) -> Array:
    """Return by how much the computed storeys (p, n) in m/s^2 moved otherwise than the measured floors ask for.

    `reported_m_s2` (n_storeys, n): absolute accelerations of the test, measured from the interface up. Between samples
    the ground's acceleration is straight, as SIM takes it, and the shear is smooth.
    """
    from scipy.interpolate import CubicSpline

    p, masses = len(building.numerical.masses_kg), _masses(building)
    shear_n, finer = -(masses @ reported_m_s2[p - 1 :]), max(int(np.ceil(dt_s / FINEST_S)), 1)
    at, between = np.arange(len(shear_n)), np.arange(finer * (len(shear_n) - 1) + 1) / finer
    ground = np.interp(between, at, ground_m_s2[: len(shear_n)])
    inputs = np.vstack([ground, CubicSpline(at, shear_n)(between)])
    moved = run_block(all_storeys(building.numerical, dt_s / finer), inputs)[2 * p :, ::finer]
    return np.asarray(reported_m_s2[:p] - moved)


def loop_error(building: Building, dt_s: float, residual_m_s2: Array) -> Array:
    """Return the error (n_storeys, n) in m/s^2 of a test against SIM of a linear building, by its residual (p, n)."""
    p, size = len(building.numerical.masses_kg), len(building.M)
    a, b = _by_base(building)
    names = tuple(f"storey_{storey}" for storey in range(1, size + 1))
    block = discretise(StateSpace(a, b, a[size:], b[size:]), dt_s, "foh", "loop_error", ("base",), names)
    error = run_block(block, residual_m_s2[-1:])
    error[:p] += residual_m_s2
    error[p:] += residual_m_s2[-1]
    return error


def loop_error_lines(building: Building, frequency_hz: Array, reported_m_s2: ComplexArray) -> ComplexArray:
    """Return what both make (n_storeys, m) of a reported motion (n_storeys, m) by frequency, without ground motion."""
    p, masses, numerical = len(building.numerical.masses_kg), _masses(building), building.numerical
    a, _ = state_equation(numerical.mass_matrix, numerical.C, numerical.K)
    pushed = np.zeros((2 * p, 1))
    pushed[p:, 0] = numerical.per_force
    by_force = StateSpace(a, pushed, a[p:], pushed[p:]).response(frequency_hz)[:, 0]
    residual = reported_m_s2[:p] + by_force * (masses @ reported_m_s2[p - 1 :])
    a, b = _by_base(building)
    error = StateSpace(a, b, a[len(building.M) :], b[len(building.M) :]).response(frequency_hz)[:, 0] * residual[-1]
    error[:p] += residual
    error[p:] += residual[-1]
    return np.asarray(error)


def _by_base(building: Building) -> tuple[Array, Array]:
    """Return the state equation of the building whose specimen's base has a kinematic error."""
    p, size = len(building.numerical.masses_kg), len(building.M)
    a, _ = state_equation(building.M, building.C, building.K)
    pushed = np.zeros(size)
    pushed[p - 1 :] = -_masses(building)  # in relative motion the specimen feels its base's error as inertia
    return a, np.concatenate([np.zeros(size), np.linalg.solve(building.M, pushed)])[:, None]


def _masses(building: Building) -> Array:
    return np.concatenate([[building.interface_experimental_mass_kg], building.specimen.masses_kg])


@dataclass(frozen=True)
class AfterRun:
    """What is known of a test's true error after its run: its distribution, or why there is none; metrics by path."""

    values: Values = field(default_factory=dict)
    true_error: TrueError | None = None
    why_none: str = ""


@dataclass(frozen=True)
class FoundSpecimen:
    """The specimen by the run's own records, relative to the identified one."""

    change: Array  # (n,) relative change of the storeys' stiffnesses
    error: Array  # (n,) its standard uncertainty, that of the identified stiffness and of its level included
    best: Array  # (n,) relative change by the run and by what is known before it
    best_error: Array  # (n,) its standard uncertainty
    damping_ratio: Array  # (n,) modal
    unexplained: float  # rms of the floors' motion that it leaves, over that motion

    @property
    def changed(self) -> bool:
        """Return whether a storey has changed since the identification."""
        return bool(np.any(np.abs(self.change) > CHANGED * self.error))


def error_after_run(uncertain: Uncertain | None, run: Run, of_actuator: bool = False) -> AfterRun:
    """Return what a run tells of its true error.

    `uncertain`: None where the check could not predict the loop, and in a test `of_actuator`.
    """
    reported = run.abs_accel_m_s2
    if run.stopped is not None or reported is None:
        return AfterRun()
    if of_actuator:
        return AfterRun(why_none="none is computed for a displacement interface yet")
    if uncertain is None:
        return AfterRun(why_none="the check predicts no error of this test, and nothing is known of what sensors hide")
    if not uncertain.setup.knows_storeys:
        return AfterRun(why_none="which building the caller's own numerical substructure is, nobody has declared")
    if not np.isfinite(reported).all():
        return AfterRun(why_none="the motion of some storeys is not known")
    values: dict[str, ArrayLike] = of_declaration(uncertain)
    measured = samples_in_gaps(uncertain, run.series)
    reconstructed = np.vstack([reported[: len(reported) - len(measured)], measured])
    found = specimen_in_run(uncertain, measured)
    if isinstance(found, str):
        return AfterRun(values, why_none=found)
    if found.unexplained > max(MOST_UNEXPLAINED, OF_IDENTIFIED * _identified(uncertain).residual):
        return AfterRun(  # what a chain of storeys does not explain says nothing of its stiffnesses
            values | {f"{RUN}.specimen_unexplained": found.unexplained},
            why_none=f"{100.0 * found.unexplained:.0f} % of the floors' motion in the run is not that of the specimen "
            f"on the measured table: {_why_unexplained(uncertain, run.series, measured, found.unexplained)}",
        )
    values |= _as_figures(uncertain, found)
    building = reference_building(uncertain, found)
    try:
        sim = reference_of(building).sim(building, uncertain.setup.rig.dt_s, uncertain.setup.motion.accel_m_s2)
    except InputError as error:
        return AfterRun(values, why_none=f"the building as identified has no SIM: {error.faults[0]}")
    truth, loop = _distribution(uncertain, found, reported, reconstructed, sim.abs_accel_m_s2)
    size = _rms(uncertain, sim.abs_accel_m_s2)
    values[f"{RUN}.measured_loop_rms_error_m_s2"] = loop
    against = _rms(uncertain, reported - sim.abs_accel_m_s2)
    with np.errstate(divide="ignore", invalid="ignore"):
        values |= {
            f"{RUN}.identified_reference_rms_error_m_s2": against,
            f"{RUN}.identified_reference_nrmse_percent": 100.0 * against / size,
            f"{RUN}.true_error_median_m_s2": truth.median,
            f"{RUN}.true_error_bound_m_s2": truth.bound,
            f"{RUN}.true_error_calibration_m_s2": truth.calibration,
            f"{RUN}.true_error_median_percent": 100.0 * truth.median / size,
            f"{RUN}.true_error_bound_percent": 100.0 * truth.bound / size,
        }
    values |= worth(uncertain, reported, sim.abs_accel_m_s2)
    return AfterRun(values, truth)


def _why_unexplained(uncertain: Uncertain, series: Series, measured: Array, unexplained: float) -> str:
    """Return what explains it: steps without samples, noise and rounding (the table's count for every floor), or else a
    sensor or the specimen."""
    lost = series.live.get("lost")
    steps = 0 if lost is None else int(np.count_nonzero(without_samples(lost)))
    if steps:
        return f"what moved in the {steps} steps without samples is not known"
    noise = np.hypot(white_noise_m_s2(uncertain.known), uncertain.known.bits_m_s2 / np.sqrt(12.0))
    of_table, of_floors = noise[0] ** 2, noise[1 : len(measured)] ** 2
    share = float(np.sqrt(np.sum(of_floors + of_table) / np.sum(np.mean(measured[1:] ** 2, axis=1))))
    if share >= OF_SAMPLES * unexplained:
        return (
            f"noise and rounding of the samples alone are {100.0 * share:.0f} %; a larger motion, or finer converters, "
            "would tell"
        )
    return "a sensor, or the specimen, is not what it was at the identification"


def samples_in_gaps(uncertain: Uncertain, series: Series) -> Array:
    """Return the measured accelerations (c, n) in m/s^2 as the rig gave them, also where the step took others.

    After a gap the step goes back to its samples gradually, and the log holds both. In the gap it took what the
    identified rig would show under the commands that it sent. A target may hold the last one that came instead: how
    much of that it did, the first samples after the gap show.
    """
    lost = series.live.get("lost")
    if lost is None or not np.any(lost):
        return series.measured
    known, gaps, every = uncertain.known, without_samples(lost), np.arange(lost.size)
    if gaps.all():
        return series.measured
    measured = _unmixed(uncertain, series, gaps, lost == MIXED)
    unanswered = np.append(gaps[1:], gaps[-1])  # a sample answers the command before it
    last = np.maximum.accumulate(np.where(unanswered, 0, every))  # the last step whose command came
    held = series.command_v[last] - series.command_v
    answered, more = (
        at_full_rate(known.lines, known.loop.rig * known.lines.of(volts))[:, : gaps.size]
        for volts in (series.command_v, held)
    )
    after = (np.convolve(gaps, np.ones(1 + AFTER_GAP), "full")[: gaps.size] > 0) & ~gaps
    size = float(np.sum(more[:, after] ** 2))
    share = float(np.sum((measured - answered)[:, after] * more[:, after])) / size if size > 0.0 else 0.0
    return np.asarray(measured + np.where(gaps, min(max(share, 0.0), 1.0), 0.0) * more)


def _unmixed(uncertain: Uncertain, series: Series, gaps: NDArray[np.bool_], mixed: NDArray[np.bool_]) -> Array:
    """Return the measured accelerations (c, n), those of `mixed` steps (n,) from the rig's samples alone.

    The samples are corrected anew, over straight lines in the gaps. The slow part of the correction that these leave is
    taken off: the mean difference where the step had its own samples next.
    """
    measured = series.measured.copy()
    if not mixed.any() or not series.samples_v.size:
        return measured
    came, every = np.flatnonzero(~gaps), np.arange(gaps.size)
    volts = np.array([np.interp(every, came, row[came]) for row in series.samples_v])
    volts *= np.array([channel.sign for channel in uncertain.known.rig.channels])[:, None]
    anew = run_block(uncertain.known.correction, volts)[: len(measured)]
    anew[0] = without_staircase(anew[0], series.command_v, uncertain.known.model)
    own = ~(gaps | mixed)
    anew -= _zeros(uncertain, measured, anew, own)
    for stretch in np.split(np.flatnonzero(mixed), np.flatnonzero(np.diff(np.flatnonzero(mixed)) > 1) + 1):
        near = np.flatnonzero(own & (np.abs(every - stretch[-1]) <= 2 * len(stretch)) & (every > stretch[-1]))
        near = near if near.size else np.flatnonzero(own)
        off = (measured - anew)[:, near].mean(axis=1) if near.size else np.zeros(len(measured))
        measured[:, stretch] = anew[:, stretch] + off[:, None]
    return measured


def _zeros(uncertain: Uncertain, measured: Array, anew: Array, own: NDArray[np.bool_]) -> Array:
    """Return what the zeros of the channels (c, n) make of the corrected samples: those of the step are without."""
    ones = np.ones((len(uncertain.known.rig.channels), own.size))
    shape = run_block(uncertain.known.correction, ones)[: len(measured)]
    size = np.sum(shape[:, own] ** 2, axis=1)
    share = np.sum(shape[:, own] * (anew - measured)[:, own], axis=1)
    return np.asarray(np.divide(share, size, out=np.zeros_like(size), where=size > 0.0)[:, None] * shape)


def specimen_in_run(uncertain: Uncertain, measured: Array) -> FoundSpecimen | str:
    """Return the specimen by the floors' motion on the measured table (c, n) in the run, or why it is not told."""
    fit, dt_s = _identified(uncertain), uncertain.setup.rig.dt_s
    low_hz = min(uncertain.setup.compared.hz[0], BELOW_FIRST * float(fit.natural_frequency_hz[0]))
    if measured.shape[1] < least_samples(fit.natural_frequency_hz, dt_s, low_hz):
        return "the run is too short to tell whether the specimen is still the identified one"
    start = Start(fit.stiffness_n_per_m, fit.damping_ratio)
    motion = Motion(measured[0], measured[1:])
    if not motion.shows_floors:
        return (
            "the floors do not move by a bit, so that the run does not tell whether the specimen is the identified one"
        )
    try:
        again = fit_stretches([motion], dt_s, fit.specimen.masses_kg, low_hz, start, free=False)
    except (InputError, np.linalg.LinAlgError) as fault:
        return f"the run does not tell whether the specimen is still the identified one: {fault}"
    own = again.stiffness_error_n_per_m / again.stiffness_n_per_m
    if not np.all(own < TELLS):
        storey = len(uncertain.building.numerical.masses_kg) + int(np.argmax(own)) + 1
        return (
            "the run moves the specimen too little to tell whether it is still the identified one (stiffness of storey "
            f"{storey} +- {100.0 * float(np.max(own)):.0f} %)"
        )
    change = again.stiffness_n_per_m / fit.stiffness_n_per_m - 1.0
    error = np.hypot(own, uncertain.stiffness_error)
    found = FoundSpecimen(change, error, change, own, again.damping_ratio, again.residual)
    if found.changed:
        return found
    before = uncertain.stiffness_error  # no change, more or less: the mean of both, weighed by their uncertainties
    share = before**2 / (before**2 + own**2)
    return replace(found, best=share * change, best_error=np.sqrt(share) * own)


def _identified(uncertain: Uncertain) -> SpecimenFit:
    fit = uncertain.identified.specimen
    assert fit is not None  # every case has experimental storeys
    return fit


def reference_building(uncertain: Uncertain, found: FoundSpecimen) -> Building:
    """Return the declared computed storeys below the specimen of the reference: as identified, or as found in the run
    where it has changed since."""
    if not found.changed:
        return uncertain.at_level
    building = on_specimen(uncertain.building, _as_found(uncertain, found))
    return replace(building, laws=uncertain.building.laws, program=uncertain.building.program)


def _linear(uncertain: Uncertain, found: FoundSpecimen) -> Building:
    """Return the linear building whose specimen is that of the run, as far as it is known."""
    return on_specimen(uncertain.building, _as_found(uncertain, found))


def _as_found(uncertain: Uncertain, found: FoundSpecimen) -> Specimen:
    fit = _identified(uncertain)
    ratios = found.damping_ratio if found.changed else fit.damping_ratio
    return _specimen(fit, fit.stiffness_n_per_m * (1.0 + found.best), ratios)


def _specimen(fit: SpecimenFit, stiffness_n_per_m: Array, damping_ratio: Array) -> Specimen:
    masses, K = fit.specimen.masses_kg, storey_matrix(stiffness_n_per_m)
    return Specimen(masses, K, modal_damping_matrix(masses, K, damping_ratio))


def _distribution(
    uncertain: Uncertain, found: FoundSpecimen, reported: Array, reconstructed: Array, sim: Array
) -> tuple[TrueError, Array]:
    """Return the distribution of the true error, and the RMS (n_storeys,) of the loop's error as measured.

    `reported` and `reconstructed` (n_storeys, n): as the step had the samples, and with those of gaps.
    """
    known = uncertain.known
    off, changed = _loop(uncertain, found, reconstructed, sim)
    if not np.array_equal(reconstructed, reported):
        without, _ = _loop(uncertain, found, reported, sim)
        changed = np.hypot(changed, GAP_ERROR * _rms(uncertain, off - without))
    loop = _rms(uncertain, off)
    linear = _linear(uncertain, found)
    lines, reference = known.lines, sim_lines(linear, known.lines, known.ground[0])
    of_each, _ = errors_by_calibration(linear, lines, reference, uncertain.corners_hz, known.model, known.measured)
    read, true = _noise(uncertain, found)
    beside = products(lines, of_each, lines.of(off))
    measured = MeasuredError(loop, beside, read, true, changed, uncertain.pitch, uncertain.pitch_error)
    truth = true_error_of_run(gram(lines, of_each), uncertain.covariance, measured)
    return truth, loop


def _loop(uncertain: Uncertain, found: FoundSpecimen, reported: Array, sim: Array) -> tuple[Array, Array]:
    """Return the loop's error (n_storeys, n), and the RMS (n_storeys,) of its change by the specimen's uncertainty.

    Where computed storeys have laws it is the error against SIM, which holds what is not known of the specimen.
    """
    if uncertain.building.has_laws:
        return reported - sim, np.zeros(len(reported))
    setup, linear = uncertain.setup, _linear(uncertain, found)
    dt_s, fit = setup.rig.dt_s, _identified(uncertain)
    residual = residual_of_computed_storeys(linear, dt_s, setup.motion.accel_m_s2, reported)
    off, squares = loop_error(linear, dt_s, residual), np.zeros(len(reported))
    stiffness, errors = storey_values(linear.specimen.K), found.best_error
    for storey, error in enumerate(errors):
        other = stiffness * np.where(np.arange(len(stiffness)) == storey, 1.0 + error, 1.0)
        moved = loop_error(on_specimen(linear, _specimen(fit, other, _modal(linear.specimen))), dt_s, residual)
        squares += _rms(uncertain, moved - off) ** 2
    return off, np.sqrt(squares)


def _noise(uncertain: Uncertain, found: FoundSpecimen) -> tuple[Array, Array]:
    """Return the RMS (n_storeys,) that noise and rounding of samples are expected to have in the loop's error as it is
    measured, and in the true motions."""
    known, nominal = uncertain.known, uncertain.prediction.nominal
    if uncertain.building.has_laws:
        return noise_shown_and_true(known, nominal, lambda reported: reported)
    linear, hz = _linear(uncertain, found), known.lines.frequency_hz
    return noise_shown_and_true(known, nominal, lambda reported: loop_error_lines(linear, hz, reported))


def worth(uncertain: Uncertain, reported: Array, sim: Array) -> Values:
    """Return how much the specimen matters: its base shear over the interface floor's inertia, and by how much the
    computed storeys would move otherwise without it."""
    building, setup = uncertain.building, uncertain.setup
    p = len(building.numerical.masses_kg)
    masses = np.concatenate([[building.interface_experimental_mass_kg], building.specimen.masses_kg])
    shear = (masses @ reported[p - 1 :]) / building.numerical.interface_mass_kg
    values: dict[str, ArrayLike] = {}
    of_shear, of_floor = _rms(uncertain, np.array([shear, reported[p - 1]]))
    values[f"{RUN}.specimen_share"] = float(of_shear / of_floor) if of_floor > 0.0 else 0.0
    if not building.has_laws:
        inputs = np.vstack([setup.motion.accel_m_s2, np.zeros(sim.shape[1])])
        bare = run_block(all_storeys(building.numerical, setup.rig.dt_s), inputs)[2 * p :]
        size = _rms(uncertain, sim[:p])
        change = _rms(uncertain, bare - sim[:p]) / np.where(size > 0.0, size, np.inf)
        values[f"{RUN}.without_specimen_percent"] = 100.0 * float(np.max(change))
    return values


def of_declaration(uncertain: Uncertain) -> dict[str, ArrayLike]:
    """Return how far the identified specimen is from the declared one, with standard uncertainties, by path."""
    setup, fit = uncertain.setup, _identified(uncertain)
    declared, masses = setup.building.specimen, fit.specimen.masses_kg
    stated, of_mass = storey_values(declared.K), _mass_error(uncertain, masses)
    error = np.sqrt(
        (fit.stiffness_error_n_per_m / fit.stiffness_n_per_m) ** 2
        + np.max(2.0 * fit.frequency_error_hz / fit.natural_frequency_hz) ** 2
        + of_mass**2
    )
    values: dict[str, ArrayLike] = {
        f"{RUN}.stiffness_over_declared": _by_storey(uncertain, fit.stiffness_n_per_m / stated),
        f"{RUN}.stiffness_over_declared_error": _by_storey(uncertain, error * fit.stiffness_n_per_m / stated),
    }
    ratios = _modal(declared)
    if np.all(ratios > 0.0):
        values[f"{RUN}.damping_over_declared"] = fit.damping_ratio / ratios
        values[f"{RUN}.damping_over_declared_error"] = fit.damping_error / ratios
    calibration = uncertain.identified.calibration
    if calibration is not None:
        n = len(calibration.mass)
        of_masses = np.sqrt(np.diag(uncertain.covariance)[-n:])
        values[f"{RUN}.mass_over_declared"] = _by_storey(uncertain, calibration.mass)
        values[f"{RUN}.mass_over_declared_error"] = _by_storey(uncertain, of_masses)
    return values


def _mass_error(uncertain: Uncertain, masses: Array) -> Array:
    """Return the relative standard uncertainty (n,) of the mass above each storey of the specimen."""
    n = len(masses)
    covariance = uncertain.covariance[-n:, -n:]
    above = np.triu(np.ones((n, n))) * masses
    above /= above.sum(axis=1, keepdims=True)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", above, covariance, above), 0.0)))


def _modal(specimen: Specimen) -> Array:
    """Return the modal damping ratios (n,) of a specimen on a fixed base."""
    root = 1.0 / np.sqrt(specimen.masses_kg)
    values, vectors = np.linalg.eigh(root[:, None] * specimen.K * root)
    damped = np.einsum("ir,ij,jr->r", vectors, root[:, None] * specimen.C * root, vectors)
    return np.asarray(damped / (2.0 * np.sqrt(np.maximum(values, np.finfo(float).tiny))))


def _as_figures(uncertain: Uncertain, found: FoundSpecimen) -> Values:
    return {
        f"{RUN}.stiffness_change": _by_storey(uncertain, found.change),
        f"{RUN}.stiffness_change_error": _by_storey(uncertain, found.error),
        f"{RUN}.specimen_changed": float(found.changed),
        f"{RUN}.specimen_unexplained": found.unexplained,
    }


def _by_storey(uncertain: Uncertain, of_specimen: Array) -> Array:
    """Return values of the specimen's storeys (n,) as values of all storeys, NaN where they are computed."""
    return np.concatenate([np.full(len(uncertain.building.numerical.masses_kg), np.nan), of_specimen])


def _rms(uncertain: Uncertain, series: Array) -> Array:
    """Return RMS values (k,) of series (k, n) in the test band, above the lowest reliable frequency."""
    setup = uncertain.setup
    pairs = (np.zeros_like(series), np.ascontiguousarray(series), None)
    found = run_metrics.errors(
        RUN, None, pairs, setup.rig.dt_s, lowest_reliable_hz(setup), None, setup.case.test_band_hz
    )
    return np.asarray(found[f"{RUN}.rms_error_m_s2"])
