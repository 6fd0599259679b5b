"""The figures of a run by their paths, with units and definitions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.files.result_writer import Metric
from rths_cli.lti import Array
from rths_cli.metrics import ErrorFigures, error_figures, fitted_delays_s
from rths_cli.metrics.catalogue import SENSORS

if TYPE_CHECKING:
    from rths_cli.analysis.critical_delay import CriticalDelay
    from rths_cli.control.margins import Margins

BAND = "in the test band (12 Hz, 4th-order Butterworth forward and backward), above the lowest reliable frequency"
FULL = "in full band above the lowest reliable frequency"


def tracking(
    run: str, desired: Array, measured: Array, true: Array | None, dt_s: float, high_pass_hz: float = 0.0
) -> dict[str, Metric]:
    """Return tracking figures of the table, desired - measured and, on a virtual rig, desired - true; all (n,)."""
    figures: dict[str, Metric] = {}
    values = {"": measured} if true is None else {"": measured, "_true": true}
    delays = fitted_delays_s(desired, tuple(values.values()), dt_s)
    wanted = np.broadcast_to(desired, (len(values), len(desired)))
    errors = error_figures(wanted, list(values.values()), dt_s, high_pass_hz)
    for row, suffix in enumerate(values):
        what = "true" if suffix else "measured"
        about = f"desired - {what} table acceleration"
        figures |= _four(f"{run}.tracking_{{}}_m_s2{suffix}", errors.of(row), about)
        figures[f"{run}.tracking_delay_s{suffix}"] = Metric(
            delays[row],
            "s",
            f"delay of the {what} against the desired table acceleration, positive = late (reported, never applied)",
        )
    return figures


def against_sim(
    run: str, sim_accel: Array, accel: Array, true_accel: Array | None, dt_s: float, high_pass_hz: float = 0.0
) -> dict[str, Metric]:
    """Return errors of absolute acceleration against SIM, storey by storey; arrays (n_storeys, n)."""
    figures: dict[str, Metric] = {}
    for value, suffix, what in ((accel, "", ""), (true_accel, "_true", "true ")):
        if value is None:
            continue
        error = error_figures(sim_accel, value, dt_s, high_pass_hz)
        about = f"SIM - {what}absolute acceleration of each storey"
        figures |= _four(f"{run}.{{}}_error_m_s2{suffix}", error, about)
    return figures


def _four(path: str, error: ErrorFigures, about: str) -> dict[str, Metric]:
    """Return maximum and RMS in the test band and in full band under a path with a hole for max or rms."""
    return {
        path.format("max"): Metric(error.maximum, "m/s^2", f"largest |{about}| {BAND}"),
        path.format("rms"): Metric(error.rms, "m/s^2", f"RMS of {about} {BAND}"),
        path.format("max") + "_full": Metric(error.maximum_full, "m/s^2", f"largest |{about}| {FULL}"),
        path.format("rms") + "_full": Metric(error.rms_full, "m/s^2", f"RMS of {about} {FULL}"),
    }


def lowest_frequency(run: str, high_pass_hz: float) -> dict[str, Metric]:
    """Return the frequency above which the errors of a run are evaluated."""
    about = (
        "lowest reliable frequency: corner of the 2nd-order Butterworth high pass, forward and backward, of all errors"
    )
    return {f"{run}.high_pass_hz": scalar(high_pass_hz, "Hz", about)}


def solution_error(run: str, relative: float) -> dict[str, Metric]:
    """Return the stated error of a computed run, relative to its peak."""
    return {f"{run}.solution_error": Metric(relative, "1", "own estimate of the solution's error over its peak")}


def critical(found: CriticalDelay) -> dict[str, Metric]:
    """Return the delay at which SIM-DELAY becomes unstable; nothing where no delay does that."""
    if not math.isfinite(found.delay_s):
        return {}
    about = "pure delay of the base shear at which the hybrid test loses stability (0: any delay does)"
    return {"sim_delay.critical_delay_s": scalar(found.delay_s, "s", about)}


def of_margins(group: str, found: Margins, suffix: str, where: str) -> dict[str, Metric]:
    """Return the margins of one loop under a group of paths; infinite where nothing is crossed."""
    figures = (
        ("sensitivity_peak", found.sensitivity_peak, "1", "largest |S| = |1 / (1 + loop)|"),
        ("sensitivity_peak_hz", found.peak_hz, "Hz", "where |S| is largest"),
        ("gain_margin", found.gain_margin, "1", "smallest factor > 1 on the loop gain that makes it unstable"),
        ("gain_reduction_margin", found.gain_reduction_margin, "1", "the same, dividing the loop gain"),
        ("phase_margin_deg", found.phase_margin_deg, "deg", "smallest change of phase that makes the loop unstable"),
        ("delay_margin_s", found.delay_margin_s, "s", "smallest further delay that makes the loop unstable"),
    )
    return {f"{group}.{name}{suffix}": scalar(value, unit, f"{text}, {where}") for name, value, unit, text in figures}


def scalar(value: float, units: str, definition: str) -> Metric:
    """Return a figure of one number."""
    return Metric(np.float64(value), units, definition)


def of_runs() -> dict[str, bool]:
    """Return the path of every figure of the runs, and whether it has one value per storey."""
    kinds = ("", "_true", "_full", "_true_full")
    tracking = {
        f"{run}.tracking_{which}_m_s2{kind}": False
        for run in ("shake_table", "exp_rths")
        for which in ("max", "rms")
        for kind in kinds
    }
    delays = {f"{run}.tracking_delay_s{kind}": False for run in ("shake_table", "exp_rths") for kind in ("", "_true")}
    errors = {f"exp_rths.{which}_error_m_s2{kind}": True for which in ("max", "rms") for kind in kinds}
    errors |= {f"sim_delay.{which}_error_m_s2{kind}": True for which in ("max", "rms") for kind in ("", "_full")}
    others = dict.fromkeys((f"{run}.high_pass_hz" for run in ("shake_table", "exp_rths", "sim_delay")), False)
    others |= dict.fromkeys(
        ("sim.solution_error", "sim_delay.solution_error", "sim_delay.diverged_at_s", "sim_delay.critical_delay_s"),
        False,
    )
    sensors = {f"{run}.{name}": True for run in ("shake_table", "exp_rths") for name in SENSORS}
    return tracking | delays | errors | others | sensors | _of_merit()


def _of_merit() -> dict[str, bool]:
    """Return the paths of FEI, tracking indicator, J1 to J9 and energy error: one number each."""
    table = ["tracking_indicator_m2_s4", "j1_s"]
    table += [f"{name}{kind}" for name in ("fei_amplitude", "fei_delay_s") for kind in ("", "_true")]
    table += [f"{name}{kind}" for name in ("j2", "j3") for kind in ("", "_full")]
    hybrid = [f"j{number}{kind}" for number in range(4, 10) for kind in ("", "_full")]
    hybrid += [f"energy_error_{unit}{kind}" for unit in ("j", "ratio") for kind in ("", "_true")]
    paths = [f"{run}.{name}" for run in ("shake_table", "exp_rths") for name in table]
    return dict.fromkeys([*paths, *(f"exp_rths.{name}" for name in hybrid)], False)
