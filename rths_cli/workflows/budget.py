"""The error budget of a finished EXP-RTHS as figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.budget import ABOUT, Budget, Signals, split
from rths_cli.files.result_writer import Metric
from rths_cli.workflows.figures import BAND, scalar

if TYPE_CHECKING:
    from rths_cli.analysis.prediction import Known
    from rths_cli.analysis.sim import Response
    from rths_cli.lti import Array
    from rths_cli.workflows.series import Series

ACCEL = "m/s^2"


def of_exp_rths(known: Known | None, series: Series, reported: Array, sim: Response) -> dict[str, Metric]:
    """Return the measured errors by cause; nothing for a loop that is unstable (None) or figures that are not finite.

    `reported` (n_storeys, n) absolute accelerations of a run that reached the record's end; from the table up measured.
    """
    if known is None or not np.isfinite(reported).all():
        return {}
    computed = reported[: len(reported) - len(series.measured)]
    signals = Signals(series.desired, series.measured, series.command_v, computed, sim.abs_accel_m_s2)
    return as_figures(split(known, signals))


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
    for name, errors in found.causes.items():
        about = f"by cause, {name}: {ABOUT[name]}; {BAND}"
        values[f"budget.rms_error_{name}_m_s2"] = Metric(errors.storeys, ACCEL, f"RMS error to SIM {about}")
        values[f"budget.tracking_rms_{name}_m_s2"] = scalar(errors.tracking, ACCEL, f"RMS tracking error {about}")
    return values


def paths() -> dict[str, bool]:
    """Return the path of every figure of a budget, and whether it has one value per storey."""
    single = [*(f"budget.tracking_rms_{name}_m_s2" for name in ABOUT), "budget.table_gain_error"]
    single += ["budget.table_delay_error_s", "budget.friction_v"]
    many = [*(f"budget.rms_error_{name}_m_s2" for name in ABOUT), "budget.unexplained_rms_m_s2"]
    return dict.fromkeys(single, False) | dict.fromkeys(many, True)
