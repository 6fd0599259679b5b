"""Metrics of a run by their paths: errors, tracking, FEI, J1 to J9, energy error, error budget; the lowest
frequency at which errors are evaluated.

All errors are formed of accelerations, which every rig measures. docs/background/metrics.md defines each.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.error_attribution import Cause, causes_of
from rths_cli.analysis.error_budget import Budget, Linear, Signals, split
from rths_cli.analysis.intensity import average_sa, measures, spectrum
from rths_cli.analysis.metrics import (
    best_lag_s,
    error_energy_j,
    figures_of_pairs,
    fitted_delays_s,
    frequency_evaluations,
    high_passed,
    input_energy_j,
    response_criteria,
    test_band,
    tracking_indicator,
    tracking_ratios,
    velocity_error_m_s,
)
from rths_cli.analysis.structural_response import inter_storey_drift_m, peaks
from rths_cli.loop.realtime_loop import IN_RUN
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.quantities import kinds_of
from rths_cli.structure import modes, storey_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from rths_cli.analysis.error_budget import Undisturbed
    from rths_cli.analysis.predicted_error import PredictionInputs
    from rths_cli.analysis.sim import Response
    from rths_cli.control.margins import Margins
    from rths_cli.experiment.ground_motion import GroundMotion
    from rths_cli.experiment.run_signals import Series
    from rths_cli.experiment.setup import Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.quantities import Values
    from rths_cli.structure import Building

LEAST_TOLD = 0.1  # of the largest cause: smaller ones are not told
MAIN = 0.5  # least part of the sum of squares of the main cause
LATE_SHARE = 0.5  # fraction of a sample interval; later samples belong to no instant

RECORD_SHARE = 0.4  # fraction of the record filter's corner, at which a 2-pole filter leaves 16 % of the ground motion
USUAL_HZ = 0.1  # upper limit of that term: buildings also move below a higher corner of the record filter
COUPLING_SHARE = 1.0 / 3.0  # fraction of an AC coupling's corner, at which its correction amplifies 3 times
HIGHEST_SHARE = 0.1  # largest fraction of the sample rate
Compared = tuple["Array", "Array", "Array | None"]
"""Reference, measured and, on a virtual rig, true values (else None): accelerations in m/s^2 of equal shape."""


def of_exp_rths(
    known: PredictionInputs | None, series: Series, reported: Array, sim: Response, test: Undisturbed | None = None
) -> tuple[dict[str, ArrayLike], tuple[Cause, ...]]:
    """Return the measured errors by cause and the named causes; empty for an unstable loop (None) or if a value is not
    finite.

    `reported` (n_storeys, n): absolute accelerations of a run that reached the end of its record, measured from the
    table up. `test`: None for a building without laws.
    """
    if known is None or not np.isfinite(reported).all():
        return {}, ()
    computed = reported[: len(reported) - len(series.measured)]
    lost = steps_without_samples(series, known.lines.dt_s)
    signals = Signals(
        series.desired, series.measured, series.command_v, computed, sim.abs_accel_m_s2, lost, series.removed
    )
    test = test or Linear(known)
    budget = split(known, signals, test)
    return budget_metrics(budget), causes_of(known, signals, budget, test)


def told_causes(causes: Sequence[Cause]) -> dict[str, str]:
    """Return the named causes as attributes of a result: those with a tenth of the largest error, and the main one."""
    if not causes or not causes[0].largest > 0.0:
        return {}
    size = float(np.sqrt(sum(cause.largest**2 for cause in causes)))
    lines = [f"{cause.told}: {100.0 * cause.largest / size:.0f} %" for cause in causes]
    shown = [line for line, cause in zip(lines, causes, strict=True) if cause.largest >= LEAST_TOLD * causes[0].largest]
    main = causes[0].told if causes[0].largest ** 2 >= MAIN * size**2 else ""
    return {"error_causes": "\n".join(shown), "main_error_cause": main}


def steps_without_samples(series: Series, dt_s: float) -> NDArray[np.bool_] | None:
    """Return the steps (n,) of a run in real time that are excluded from the budget's fits.

    They did not use the samples of their own instant (lost, caught up, a mix after a gap, late by half an interval) or
    belong to a ramp. None for a run on the counted clock.
    """
    if not series.live:
        return None
    late, lost, state = (series.live[name] for name in ("late_s", "lost", "state"))
    return np.asarray((late > LATE_SHARE * dt_s) | (lost > 0) | (state != IN_RUN))


def budget_metrics(found: Budget) -> dict[str, ArrayLike]:
    """Return a budget as metrics `budget.*`."""
    values: dict[str, ArrayLike] = {
        "budget.table_gain_error": found.gain_error,
        "budget.table_delay_error_s": found.delay_error_s,
        "budget.friction_v": found.friction_v,
        "budget.unexplained_rms_m_s2": found.unexplained.storeys,
        "budget.table_gain_error_uncertainty": found.gain_uncertainty,
        "budget.table_delay_error_uncertainty_s": found.delay_uncertainty_s,
        "budget.friction_uncertainty_v": found.friction_uncertainty_v,
    }
    for name, errors in found.causes.items():
        values[f"budget.rms_error_{name}_m_s2"] = errors.storeys
        values[f"budget.tracking_rms_{name}_m_s2"] = errors.tracking
    return values


def of_ground(motion: GroundMotion, building: Building) -> Values:
    """Return the intensity measures of a ground motion as it is played, `ground.*`."""
    accel, dt_s = motion.accel_m_s2, motion.dt_s
    period_s = 1.0 / float(modes(building.M, building.C, building.K)[0][0])
    at = spectrum(accel, dt_s, [period_s])
    first = {"t1_s": period_s, "sa_t1_m_s2": at.sa_m_s2[0], "sv_t1_m_s": at.sv_m_s[0], "sd_t1_m": at.sd_m[0]}
    averaged = {"sa_avg_m_s2": average_sa(accel, dt_s, period_s)}
    return {f"ground.{name}": float(each) for name, each in (vars(measures(accel, dt_s)) | first | averaged).items()}


def lowest_reliable_hz(setup: Setup) -> float:
    """Return the corner in Hz of the zero-phase high pass with which the errors of a case are evaluated.

    It is the largest of 0.4 times the corner of the record's filter, at most 0.1 Hz (the ground hardly moves below), a
    third of the highest corner of the accelerometers' AC coupling, and one period in the record.
    """
    ground = min(RECORD_SHARE * setup.case.record_filter.corner_hz, USUAL_HZ)
    coupling = COUPLING_SHARE * max(channel.high_pass_hz for channel in setup.rig.channels)
    length = 1.0 / (len(setup.motion.time_s) * setup.rig.dt_s)
    return min(max(ground, coupling, length), HIGHEST_SHARE / setup.rig.dt_s)


def errors(
    run: str,
    table: Compared | None,
    storeys: Compared | None,
    dt_s: float,
    high_pass_hz: float = 0.0,
    room: Array | None = None,
    test_band_hz: float = TEST_BAND_HZ,
) -> Values:
    """Return maximum and RMS of the table's tracking error and of the storeys' errors against SIM, by path.

    `table`: series (n,), desired motion as reference; `storeys`: series (n_storeys, n), SIM as reference; None: no such
    metrics. Both errors are evaluated in the test band (`test_band_hz`) and, with the suffix `_full`, in full band,
    without motion slower than `high_pass_hz`. `room`: memory from `room_for_pairs` for the number of series, None:
    new memory.
    """
    pairs: list[tuple[Array, Array]] = []
    places: dict[str, int | slice] = {}
    for path, compared in ((f"{run}.tracking_{{}}_m_s2", table), (f"{run}.{{}}_error_m_s2", storeys)):
        reference, *values = compared or (None,)
        for suffix, value in zip(("", "_true"), values, strict=False):
            if value is None or reference is None:
                continue
            single, first = value.ndim == 1, len(pairs)
            pairs += [(reference, value)] if single else list(zip(reference, value, strict=True))
            places[path + suffix] = first if single else slice(first, len(pairs))
    found = figures_of_pairs(pairs, dt_s, room, high_pass_hz, test_band_hz)
    kinds = {"max": found.maximum, "rms": found.rms}, {"max": found.maximum_full, "rms": found.rms_full}
    return {
        path.format(which) + band: figures[place]
        for path, place in places.items()
        for band, both in zip(("", "_full"), kinds, strict=True)
        for which, figures in both.items()
    }


def relative_errors(
    run: str,
    found: Values,
    sim_accel: Array,
    dt_s: float,
    high_pass_hz: float = 0.0,
    test_band_hz: float = TEST_BAND_HZ,
) -> Values:
    """Return the storeys' errors `found` by `errors` in percent of the size of SIM (n_storeys, n) in the same band.

    Where SIM does not move the error is NaN, or 0 if there is none.
    """
    sizes = errors(run, None, (np.zeros_like(sim_accel), sim_accel, None), dt_s, high_pass_hz, None, test_band_hz)
    values: dict[str, ArrayLike] = {}
    for which, name in (("rms", "nrmse"), ("max", "peak_error")):
        for path in kinds_of(f"{run}.{which}_error_m_s2"):
            if path in found:
                size = np.asarray(sizes[path.replace("_true", "")])
                with np.errstate(divide="ignore", invalid="ignore"):
                    percent = 100.0 * np.asarray(found[path]) / size
                values[path.replace(f"{which}_error_m_s2", f"{name}_percent")] = percent
    return values


def of_building(run: str, building: Building, rel_disp_m: Array, abs_accel_m_s2: Array) -> dict[str, ArrayLike]:
    """Return the peaks of a building's response by path: relative displacements and absolute accelerations, both
    (n_storeys, n)."""
    found = peaks(building.shear_masses_kg, rel_disp_m, abs_accel_m_s2, building.mass_kg)
    values: dict[str, ArrayLike] = {
        f"{run}.peak_abs_accel_m_s2": found.abs_accel_m_s2,
        f"{run}.peak_rel_disp_m": found.rel_disp_m,
        f"{run}.peak_inter_storey_drift_m": found.inter_storey_drift_m,
        f"{run}.peak_storey_shear_n": found.storey_shear_n,
        f"{run}.peak_building_base_shear_n": found.base_shear_n,
        f"{run}.building_base_shear_ratio": found.base_shear_ratio,
    }
    if building.heights_m is not None:
        values[f"{run}.peak_drift_ratio"] = found.drift_ratio(building.heights_m)
    return values


def of_laws(
    run: str, building: Building, rel_disp_m: Array, law_force_n: Array, work_j: Array | None = None
) -> dict[str, ArrayLike]:
    """Return ductility, residual drift and work of storeys with laws by path; none for a linear building.

    `rel_disp_m` (n_storeys, n), `law_force_n` (s, n) of the lowest s storeys, beside their springs; computed storeys
    above them have springs alone. `work_j` (s,) of the laws; None: by the trapezoidal rule over the drift, and the
    motion is that of a test, in which accelerometers do not know the residual drift of the storeys on the table. What
    is not known of a storey is NaN.
    """
    if building.linear:
        return {}
    drift, computed = inter_storey_drift_m(rel_disp_m), len(building.numerical.masses_kg)
    known = max(len(law_force_n), computed)
    laws, limits = building.laws, np.full(building.storeys, np.nan)
    for storey, limit in zip(laws.storey, laws.yield_drift_m, strict=True):
        limits[storey] = np.fmin(limits[storey], limit)
    of_laws_j = np.zeros(known)
    of_laws_j[: len(law_force_n)] = (
        np.trapezoid(law_force_n, drift[: len(law_force_n)], axis=1) if work_j is None else work_j
    )
    springs = np.concatenate([storey_values(building.numerical.K), storey_values(building.specimen.K)])
    work = np.full(building.storeys, np.nan)
    work[:known] = 0.5 * springs[:known] * drift[:known, -1] ** 2 + of_laws_j
    residual = drift[:, -1].copy()
    if work_j is None:
        residual[len(building.numerical.masses_kg) :] = np.nan
    return {
        f"{run}.ductility": np.abs(drift).max(axis=1) / limits,
        f"{run}.residual_drift_m": residual,
        f"{run}.restoring_work_j": work,
    }


def of_margins(group: str, found: Margins, suffix: str) -> dict[str, ArrayLike]:
    """Return the margins of one loop by path, `group`.NAME`suffix`; a margin without a crossing is infinite."""
    values = {
        "sensitivity_peak": found.sensitivity_peak,
        "sensitivity_peak_hz": found.peak_hz,
        "gain_margin": found.gain_margin,
        "gain_reduction_margin": found.gain_reduction_margin,
        "phase_margin_deg": found.phase_margin_deg,
        "delay_margin_s": found.delay_margin_s,
    }
    return {f"{group}.{name}{suffix}": value for name, value in values.items()}


def of_table_run(
    setup: Setup, run: str, series: Series, sim: Response, hybrid: tuple[Array, Array, Array] | None
) -> dict[str, ArrayLike]:
    """Return the metrics of a complete run on the table by path, except `errors`.

    `series`: signals on the record's clock. `hybrid`: motion of the building in EXP-RTHS, (n_storeys, n) each: relative
    displacements in m and velocities in m/s, absolute accelerations in m/s^2; None in a shake-table test.
    """
    dt, building, ground = setup.rig.dt_s, setup.building, setup.motion.accel_m_s2
    lowest_hz, band_hz = lowest_reliable_hz(setup), setup.case.test_band_hz
    desired, measured = series.desired[0], series.measured[0]
    true = series.true_accel[0] if series.has_truth else None
    figures = delays(run, desired, measured, true, dt)
    figures |= fidelity(run, desired, measured, true, dt, lowest_hz, band_hz)
    if hybrid is not None:
        figures |= of_building(run, building, hybrid[0], hybrid[2])
        if series.law_force_n is not None:
            figures |= of_laws(run, building, hybrid[0], series.law_force_n)
        storeys = high_passed([sim.abs_accel_m_s2, hybrid[2]], lowest_hz, dt)
        figures |= response(run, storeys[0], storeys[1], len(building.numerical.masses_kg), dt, band_hz)
        most = float(np.max(input_energy_j(_input_mass_kg(building), sim.rel_vel_m_s, ground, dt)))
        figures |= energy(run, desired, measured, true, series.base_shear_n, most, dt, band_hz)
    return figures


def _input_mass_kg(building: Building) -> Array:
    """Return the matrix (n_storeys, n_storeys) whose rows add up to M r, of which the input energy is the integral."""
    return building.M if building.influence is None else building.M * building.influence


def delays(run: str, desired: Array, measured: Array, true: Array | None, dt_s: float) -> dict[str, ArrayLike]:
    """Return the delay in s fitted to the measured and, on a virtual rig, to the true table motion, by path.

    `desired`, `measured` and `true` are accelerations (n,) in m/s^2; a positive delay means that the table is late.
    """
    values = {"": measured} if true is None else {"": measured, "_true": true}
    found = fitted_delays_s(desired, tuple(values.values()), dt_s)
    return {f"{run}.tracking_delay_s{suffix}": delay for suffix, delay in zip(values, found, strict=True)}


def fidelity(
    run: str,
    desired: Array,
    measured: Array,
    true: Array | None,
    dt_s: float,
    high_pass_hz: float = 0.0,
    test_band_hz: float = TEST_BAND_HZ,
) -> dict[str, ArrayLike]:
    """Return FEI, tracking indicator and J1 to J3 of the table by path.

    `desired`, `measured` and `true` are accelerations (n,) in m/s^2. Tracking indicator and J1 to J3 are evaluated
    without motion slower than `high_pass_hz`. FEI takes the lines up to `test_band_hz`; it needs no high pass, because
    it weights the lines by the power of the desired motion, which is small there.
    """
    full = high_passed([desired, measured], high_pass_hz, dt_s)
    banded = test_band(full, dt_s, test_band_hz)
    values = {"": measured} if true is None else {"": measured, "_true": true}
    figures: dict[str, ArrayLike] = {}
    evaluations = frequency_evaluations(desired, tuple(values.values()), dt_s, test_band_hz)
    for suffix, found in zip(values, evaluations, strict=True):
        figures[f"{run}.fei_amplitude{suffix}"] = found.amplitude
        figures[f"{run}.fei_delay_s{suffix}"] = found.delay_s
    figures[f"{run}.tracking_indicator_m2_s4"] = float(tracking_indicator(banded[0], banded[1])[-1])
    figures[f"{run}.j1_s"] = best_lag_s(banded[0], banded[1], dt_s)
    for suffix, series in (("", banded), ("_full", full)):
        figures[f"{run}.j2{suffix}"], figures[f"{run}.j3{suffix}"] = tracking_ratios(*series)
    return figures


def response(
    run: str, sim_accel: Array, accel: Array, interface: int, dt_s: float, test_band_hz: float = TEST_BAND_HZ
) -> dict[str, ArrayLike]:
    """Return J4 and J5 of the `interface` storey and, with three storeys or more, J6 to J9 of the two lowest others.

    `sim_accel` and `accel` are absolute accelerations (n_storeys, n) in m/s^2; storeys count from 1.
    """
    numbers = criteria_of_storeys(interface, len(accel))
    figures: dict[str, ArrayLike] = {}
    for suffix in ("", "_full"):
        pair = np.stack([sim_accel, accel])
        found = response_criteria(*(pair if suffix else test_band(pair, dt_s, test_band_hz)))
        for storey, (first, second) in numbers.items():
            figures[f"{run}.j{first}{suffix}"] = found.deviation[storey - 1]
            figures[f"{run}.j{second}{suffix}"] = found.peak[storey - 1]
    return figures


def criteria_of_storeys(interface: int, storeys: int) -> dict[int, tuple[int, int]]:
    """Return the numbers of the J criteria (standard deviation, peak) by storey, for a number of storeys.

    J4 and J5 belong to the `interface` storey, J6 to J9 to the two lowest others if there are two. Storeys count
    from 1.
    """
    others = [storey for storey in range(1, storeys + 1) if storey != interface]
    return {interface: (4, 5)} | (dict(zip(others, ((6, 8), (7, 9)), strict=False)) if len(others) > 1 else {})


def remarks(setup: Setup, run: str, desired: Array) -> dict[str, str]:
    """Return remarks on metrics whose definition depends on the run, by path: storeys of the J's, frequency of the FEI.

    `desired`: acceleration (n,) of the table in m/s^2.
    """
    interface, storeys = len(setup.building.numerical.masses_kg), len(setup.building.M)
    hz = frequency_evaluations(desired, (desired,), setup.rig.dt_s, setup.case.test_band_hz)[0].frequency_hz
    about = dict.fromkeys(("fei_amplitude", "fei_delay_s"), f"equivalent frequency {hz:.3g} Hz")
    for storey, numbers in criteria_of_storeys(interface, storeys).items():
        about |= {f"j{number}": f"storey {storey}" for number in numbers}
    return {path: words for name, words in about.items() for path in kinds_of(f"{run}.{name}")}


def energy(
    run: str,
    desired: Array,
    measured: Array,
    true: Array | None,
    base_shear_n: Array,
    input_j: float,
    dt_s: float,
    test_band_hz: float = TEST_BAND_HZ,
) -> dict[str, ArrayLike]:
    """Return the energy that the tracking error feeds into the structure, in J and divided by `input_j`, by path.

    `desired`, `measured` and `true` are table accelerations (n,) in m/s^2. `base_shear_n` (n,) is the base shear that
    acted on the numerical substructure. `input_j`: largest input energy of SIM in J; if it is 0, the ratio is NaN.
    """
    figures: dict[str, ArrayLike] = {}
    values = {"": measured} if true is None else {"": measured, "_true": true}
    errors = velocity_error_m_s(desired - np.array(list(values.values())), dt_s, test_band_hz)
    for suffix, error in zip(values, errors, strict=True):
        fed = float(error_energy_j(base_shear_n, error, dt_s)[-1])
        figures[f"{run}.energy_error_j{suffix}"] = fed
        figures[f"{run}.energy_error_ratio{suffix}"] = fed / input_j if input_j > 0 else math.nan
    return figures
