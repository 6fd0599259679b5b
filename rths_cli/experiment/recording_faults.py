"""What speaks against a recorded run as one of its case: channels with the wrong sign, unit or place, computed storeys
and specimen that are not those of the case; and what its channels tell of the error without a model of the table.

The error of the loop (`error_after_run`) needs no model of table and controller. It has two parts: the table did not
follow the desired motion, and the desired motion was not what the case's computed storeys do under ground and base
shear.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.optimize import minimize_scalar

from rths_cli.analysis.metrics import high_passed, test_band
from rths_cli.control.kalman_filter import open_loop
from rths_cli.errors import InputError
from rths_cli.experiment import run_metrics
from rths_cli.experiment.error_after_run import MOST_UNEXPLAINED, loop_error, residual_of_computed_storeys
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.run_signals import base_shear_of, computed_interface
from rths_cli.experiment.setup import RecordedRun, Setup, shown
from rths_cli.findings import Finding, stated
from rths_cli.identification.specimen_fit import Motion, Start, fit_stretches, least_samples
from rths_cli.loop.block_replay import run_block
from rths_cli.numerics.lti import Array
from rths_cli.structure import Numerical, modes, storey_values

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.experiment.one_table_run import Run
    from rths_cli.identification.results import SpecimenFit
    from rths_cli.quantities import Values

HYBRID = "exp_rths"  # the run with computed storeys
MOST_LAG_S = 0.02  # by which two channels of one motion may be apart
OPPOSITE = -0.5  # correlation, from which a channel has the wrong sign
SURE = 0.9  # correlation, from which a gain says something of a unit
OTHER_UNIT = 1.5  # gain (or its inverse), from which a unit or sensitivity is wrong
AS_DECLARED = 0.05  # of the floors' power, that the declared specimen on the measured table may leave
LEFT_BY_CAUSE, LOWERED = (
    0.2,
    0.25,
)  # what another sign or order that is told leaves at most, also of what is left as named
SAME_STOREYS = 0.03  # of the desired motion, that the case's computed storeys may leave unexplained
SAME_STOREYS_BY_FLOORS = 0.3  # the same where the base shear is not recorded
FACTORS = (0.25, 4.0)  # on stiffness or damping of the computed storeys, within which a cause is searched for
TELLS = 0.3  # of what is left, to which a factor must lower it to be told as the cause
BELOW_FIRST = 0.5  # the lines of the fit begin at this fraction of the specimen's first natural frequency or lower


class Alike(NamedTuple):
    """How a motion follows another one: largest correlation within MOST_LAG_S, signed, and the gain there."""

    correlation: float
    gain: float


@dataclass(frozen=True)
class JudgedRecording:
    """What a recorded hybrid test tells by itself: metrics by path, and why it belongs to another case, "" if not."""

    values: Values = field(default_factory=dict)
    another: str = ""
    told: tuple[Finding, ...] = ()


def alike(setup: Setup, motion: Array, follows: Array) -> Alike:
    """Return how a motion (n,) follows another one (n,), both in the test band."""
    dt_s = setup.rig.dt_s
    first, second = _in_band(setup, np.vstack([motion, follows]))
    size, most = next_fast_len(2 * first.size, real=True), round(MOST_LAG_S / dt_s)
    cross = irfft(np.conj(rfft(first, size)) * rfft(second, size), size)
    lags = np.concatenate([cross[: most + 1], cross[-most:]])
    best = float(lags[int(np.argmax(np.abs(lags)))])
    power, other = float(first @ first), float(second @ second)
    if not power or not other:
        return Alike(0.0, 0.0)
    return Alike(best / float(np.sqrt(power * other)), best / power)


def _in_band(setup: Setup, series: Array) -> Array:
    dt_s = setup.rig.dt_s
    return np.asarray(test_band(high_passed(series, lowest_reliable_hz(setup), dt_s), dt_s, setup.case.test_band_hz))


def channel_faults(setup: Setup, run: RecordedRun) -> list[str]:
    """Return a sentence for each channel of a recorded run whose sign, unit or place is wrong."""
    log = run.outcome.log
    name, samples = shown(setup.case.recorded[run.run].recording), run.samples
    setup = replace(setup, motion=replace(setup.motion, accel_m_s2=setup.motion.accel_m_s2[:samples]))
    table = alike(setup, log.desired[0], log.corrected[0])
    faults = list(_faults_of(name, "table", "the desired motion", table))
    if run.run != HYBRID or faults:
        return faults
    floors = list(_floor_faults(setup, name, log.corrected))
    if floors:
        return floors
    if "base_shear" in run.names:
        of_floors = base_shear_of(setup, log.corrected[0], log.corrected[1:])
        found = alike(setup, of_floors, log.base_shear_n)
        faults += _faults_of(name, "base_shear", "minus the masses times the measured accelerations", found, "N")
    return faults


def _faults_of(name: str, role: str, what: str, found: Alike, unit: str = "g") -> Iterator[str]:
    """Yield what is wrong with a channel that should follow another motion."""
    if found.correlation < OPPOSITE:
        yield (
            f"{name}: {role} has the opposite sign of {what} (gain {found.gain:.3g}); turn it by a minus before its "
            f"unit, as in {role}: [NAME, -{unit}]"
        )
    elif found.correlation > SURE and not 1.0 / OTHER_UNIT <= found.gain <= OTHER_UNIT:
        yield f"{name}: {role} is {found.gain:.3g} times {what}; correct its unit, or the sensitivity of its sensor"


def _floor_faults(setup: Setup, name: str, measured: Array) -> Iterator[str]:
    """Yield what is wrong with the floors, if they move as the declared specimen does on the table once a unit is
    changed, a sign is turned or two are exchanged, and not as they are."""
    predicted = run_block(open_loop(setup.building.specimen, setup.rig.dt_s), measured[:1])
    names = [channel.name for channel in setup.rig.channels[1:]]
    what = "the motion that the case's specimen has on the measured table"
    units = [_faults_of(name, *one) for one in zip(
        names, [what] * len(names), [alike(setup, *pair) for pair in zip(predicted, measured[1:], strict=True)],
        strict=True,
    )]  # fmt: skip
    if faults := [fault for one in units for fault in one if " times " in fault]:
        yield from faults
        return
    floors, predicted, count = _in_band(setup, measured[1:]), _in_band(setup, predicted), len(names)
    as_named = _left(floors, predicted)
    if as_named <= AS_DECLARED:
        return
    most = min(LOWERED * as_named, LEFT_BY_CAUSE)
    for turned in (one for size in range(1, count + 1) for one in combinations(range(count), size)):
        signs = np.where(np.isin(np.arange(count), turned), -1.0, 1.0)
        if _left(signs[:, None] * floors, predicted) <= most:
            which = " and ".join(names[place] for place in turned)
            yield (
                f"{name}: {which} moves as the case's specimen on the measured table with the opposite sign; turn it "
                f"by a minus before its unit, as in {names[turned[0]]}: [NAME, -g]"
            )
            return
    for one, other in combinations(range(count), 2):
        order = np.arange(count)
        order[[one, other]] = other, one
        if _left(floors[order], predicted) <= most:
            pair = f"{names[one]} and {names[other]}"
            yield f"{name}: {pair} are exchanged: each moves as the other one should; name them so"
            return


def _left(floors: Array, predicted: Array) -> float:
    """Return the part of the floors' power (c, n) that is not that of the predicted motion."""
    power = float(np.sum(floors**2))
    return float(np.sum((floors - predicted) ** 2)) / power if power else 0.0


def judged(setup: Setup, run: Run, recorded: RecordedRun) -> JudgedRecording:
    """Return what a recorded hybrid test tells without a model of its table."""
    if run.building is None or run.abs_accel_m_s2 is None:
        return JudgedRecording()
    values: dict[str, ArrayLike] = {}
    if setup.building.linear:
        values |= _error_of_loop(setup, run)
    of_specimen, told = _of_specimen(setup, run)
    return JudgedRecording(values | of_specimen, _another_building(setup, run, recorded), told)


def _error_of_loop(setup: Setup, run: Run) -> dict[str, ArrayLike]:
    """Return the error of the loop below the declared specimen, and its two parts, by path."""
    dt_s, reported, building = setup.rig.dt_s, run.abs_accel_m_s2, setup.building
    assert reported is not None  # of a hybrid test
    residual = residual_of_computed_storeys(building, dt_s, setup.motion.accel_m_s2, reported)
    followed = np.zeros_like(residual)
    followed[-1] = run.series.measured[0] - run.series.desired[0]
    parts = {
        "measured_loop_rms_error_m_s2": residual,
        "following_rms_error_m_s2": followed,
        "computing_rms_error_m_s2": residual - followed,
    }
    found: dict[str, ArrayLike] = {}
    for name, part in parts.items():
        error = loop_error(building, dt_s, part)
        pair = (np.zeros_like(error), np.ascontiguousarray(error), None)
        lowest_hz, band_hz = lowest_reliable_hz(setup), setup.case.test_band_hz
        rms = run_metrics.errors("exp_rths", None, pair, dt_s, lowest_hz, None, band_hz)
        found[f"exp_rths.{name}"] = rms["exp_rths.rms_error_m_s2"]
    return found


def _another_building(setup: Setup, run: Run, recorded: RecordedRun) -> str:
    """Return why the computed storeys of the case are not those of the test, "" where they may be."""
    if not setup.building.linear or "desired" not in recorded.names:
        return ""
    ground, shear = setup.motion.accel_m_s2, run.series.base_shear_n
    measured = "base_shear" in recorded.names
    desired = _in_band(setup, run.series.desired[:1])

    def left(numerical: Numerical) -> float:
        other = replace(setup, building=replace(setup.building, numerical=numerical))
        moved = _in_band(setup, computed_interface(other, ground, shear)[None])
        return float(np.sqrt(np.sum((desired - moved) ** 2) / np.sum(desired**2)))

    own = setup.building.numerical
    unexplained = left(own)
    if unexplained <= (SAME_STOREYS if measured else SAME_STOREYS_BY_FLOORS):
        return ""
    what = "base shear" if measured else "masses times measured accelerations"
    said = (
        f"the desired motion is not what the computed storeys of the case do under the ground motion and the {what} of "
        f"the recording ({100.0 * unexplained:.2g} % of it is left), so masses, stiffness or damping below the table "
        "are not those of the test"
    )
    for word, changed in (
        ("stiffness", lambda k: replace(own, K=k * own.K)),
        ("damping", lambda k: replace(own, C=k * own.C)),
        ("mass", lambda k: replace(own, masses_kg=k * own.masses_kg)),
    ):
        factor, least = _best_factor(lambda k, changed=changed: left(changed(k)))
        if least < TELLS * unexplained:
            return f"{said}; with {factor:.4g} times the {word} {100.0 * least:.2g} % is left"
    return said


def _best_factor(left: object) -> tuple[float, float]:
    """Return the factor within FACTORS at which a function is least, and its value."""
    assert callable(left)
    low, high = np.log(FACTORS)
    grid = np.linspace(low, high, 25)
    values = [float(left(float(np.exp(one)))) for one in grid]
    best, width = float(grid[int(np.argmin(values))]), float(grid[1] - grid[0])
    found = minimize_scalar(
        lambda one: float(left(float(np.exp(one)))), bounds=(best - width, best + width), method="bounded",
        options={"xatol": 1e-4},
    )  # fmt: skip
    return float(np.exp(found.x)), float(found.fun)


def _of_specimen(setup: Setup, run: Run) -> tuple[dict[str, ArrayLike], tuple[Finding, ...]]:
    """Return the specimen by its own motion on the measured table beside the declared one, or why it is not told."""
    fit = _fitted(setup, run.series.measured)
    if isinstance(fit, str):
        return {}, (stated(fit),)
    values: dict[str, ArrayLike] = {"exp_rths.specimen_unexplained": fit.residual}
    if fit.residual > MOST_UNEXPLAINED:
        told = (
            f"{100.0 * fit.residual:.0f} % of the floors' motion is not that of a chain of storeys on the measured "
            "table: a sensor, its place or its unit is not as stated, or the specimen is no such chain"
        )
        return values, (stated(told),)
    specimen, computed = setup.building.specimen, len(setup.building.numerical.masses_kg)
    stiffness, unknown = storey_values(specimen.K), np.full(computed, np.nan)
    _, ratios = modes(np.diag(specimen.masses_kg), specimen.C, specimen.K)
    error = np.hypot(fit.stiffness_error_n_per_m / fit.stiffness_n_per_m, setup.rig.uncertainty.specimen)
    values |= {
        "exp_rths.stiffness_over_declared": np.concatenate([unknown, fit.stiffness_n_per_m / stiffness]),
        "exp_rths.stiffness_over_declared_error": np.concatenate([unknown, error]),
    }
    if np.all(ratios > 0.0):
        values["exp_rths.damping_over_declared"] = fit.damping_ratio / ratios
        values["exp_rths.damping_over_declared_error"] = np.hypot(
            fit.damping_error / ratios, setup.rig.uncertainty.specimen
        )
    return values, ()


def _fitted(setup: Setup, measured: Array) -> SpecimenFit | str:
    """Return the specimen that the floors (c, n) on the measured table show, or why they show none."""
    specimen, dt_s = setup.building.specimen, setup.rig.dt_s
    hz, ratios = modes(np.diag(specimen.masses_kg), specimen.C, specimen.K)
    low_hz = min(setup.compared.hz[0], BELOW_FIRST * float(hz[0]))
    if measured.shape[1] < least_samples(hz, dt_s, low_hz):
        return "the recording is too short to tell whether the specimen is the declared one"
    motion = Motion(measured[0], measured[1:])
    if not motion.shows_floors:
        return "the floors of the recording do not move, so that it does not tell what the specimen is"
    start = Start(storey_values(specimen.K), np.maximum(ratios, 1e-3))
    try:
        return fit_stretches([motion], dt_s, specimen.masses_kg, low_hz, start, free=False)
    except (InputError, np.linalg.LinAlgError) as fault:
        return f"the recording does not tell whether the specimen is the declared one: {fault}"
