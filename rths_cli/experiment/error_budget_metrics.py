"""The error budget of a finished EXP-RTHS as metrics `budget.*`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.error_attribution import Cause, causes_of
from rths_cli.analysis.error_budget import Budget, Linear, Signals, split
from rths_cli.loop.realtime_loop import IN_RUN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from rths_cli.analysis.error_budget import Undisturbed
    from rths_cli.analysis.predicted_error import Known
    from rths_cli.analysis.sim import Response
    from rths_cli.experiment.run_signals import Series
    from rths_cli.numerics.lti import Array

LEAST_TOLD = 0.1  # of the largest cause: smaller ones are not told
MAIN = 0.5  # least part of the sum of squares of the main cause
LATE_SHARE = 0.5  # fraction of a sample interval; later samples belong to no instant


def of_exp_rths(
    known: Known | None, series: Series, reported: Array, sim: Response, test: Undisturbed | None = None
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
    return as_figures(budget), causes_of(known, signals, budget, test)


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


def as_figures(found: Budget) -> dict[str, ArrayLike]:
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
