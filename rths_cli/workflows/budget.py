"""The error budget of a finished EXP-RTHS as figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.budget import ABOUT, ABOUT_DRIFT, ABOUT_LOST, DRIFT, LOST, Budget, Signals, split
from rths_cli.files.result_writer import Metric
from rths_cli.loop.realtime import IN_RUN
from rths_cli.workflows.figures import BAND, scalar

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.analysis.prediction import Known
    from rths_cli.analysis.sim import Response
    from rths_cli.lti import Array
    from rths_cli.workflows.series import Series

ACCEL = "m/s^2"
LATE_SHARE = 0.5  # of a sample interval: samples that come later belong to no instant
UNCERTAINTIES = {
    "budget.table_gain_error_uncertainty": ("1", "gain of the table over identified, less 1"),
    "budget.table_delay_error_uncertainty_s": ("s", "delay of the table in the run less identified"),
    "budget.friction_uncertainty_v": ("V", "friction of the table in the run, as a change of command"),
}


def of_exp_rths(known: Known | None, series: Series, reported: Array, sim: Response) -> dict[str, Metric]:
    """Return the measured errors by cause; nothing for a loop that is unstable (None) or figures that are not finite.

    `reported` (n_storeys, n) absolute accelerations of a run that reached the record's end; from the table up measured.
    """
    if known is None or not np.isfinite(reported).all():
        return {}
    computed = reported[: len(reported) - len(series.measured)]
    lost = steps_without_samples(series, known.lines.dt_s)
    signals = Signals(
        series.desired, series.measured, series.command_v, computed, sim.abs_accel_m_s2, lost, series.removed
    )
    return as_figures(split(known, signals))


def steps_without_samples(series: Series, dt_s: float) -> NDArray[np.bool_] | None:
    """Return which steps (n,) of a run in real time have no samples of their instant, or are none of the record: lost,
    caught up, late by half an interval, in a ramp; None for a run on the counted clock."""
    if not series.live:
        return None
    late, lost, state = (series.live[name] for name in ("late_s", "lost", "state"))
    return np.asarray((late > LATE_SHARE * dt_s) | (lost > 0) | (state != IN_RUN))


def as_figures(found: Budget) -> dict[str, Metric]:
    """Return a budget as figures `budget.*`."""
    values = {
        "budget.table_gain_error": scalar(found.gain_error, "1", "gain of the table over identified, less 1"),
        "budget.table_delay_error_s": scalar(found.delay_error_s, "s", "delay of the table in the run less identified"),
        "budget.friction_v": scalar(found.friction_v, "V", "friction of the table in the run, as a change of command"),
        "budget.unexplained_rms_m_s2": Metric(
            found.unexplained.storeys, ACCEL, f"RMS error to SIM that the parts do not add up to, {BAND}"
        ),
    }
    offs = (found.gain_uncertainty, found.delay_uncertainty_s, found.friction_uncertainty_v)
    for (path, (units, about)), off in zip(UNCERTAINTIES.items(), offs, strict=True):
        values[path] = scalar(off, units, f"standard uncertainty of the {about}")
    for name, errors in found.causes.items():
        about = f"by cause, {name}: {(ABOUT | {LOST: ABOUT_LOST, DRIFT: ABOUT_DRIFT})[name]}; {BAND}"
        values[f"budget.rms_error_{name}_m_s2"] = Metric(errors.storeys, ACCEL, f"RMS error to SIM {about}")
        values[f"budget.tracking_rms_{name}_m_s2"] = scalar(errors.tracking, ACCEL, f"RMS tracking error {about}")
    return values


def paths() -> dict[str, bool]:
    """Return the path of every figure that each budget has, and whether it has one value per storey."""
    single = [*(f"budget.tracking_rms_{name}_m_s2" for name in ABOUT), "budget.table_gain_error"]
    single += ["budget.table_delay_error_s", "budget.friction_v", *UNCERTAINTIES]
    many = [*(f"budget.rms_error_{name}_m_s2" for name in ABOUT), "budget.unexplained_rms_m_s2"]
    return dict.fromkeys(single, False) | dict.fromkeys(many, True)
