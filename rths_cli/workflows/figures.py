"""The metrics of computed runs and of the table by their paths; docs/figures.md defines each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.metrics import ErrorFigures, error_figures, fitted_delays_s

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.control.margins import Margins
    from rths_cli.lti import Array


def tracking(
    run: str, desired: Array, measured: Array, true: Array | None, dt_s: float, high_pass_hz: float = 0.0
) -> dict[str, ArrayLike]:
    """Return tracking figures of the table, desired - measured and, on a virtual rig, desired - true; all (n,)."""
    found: dict[str, ArrayLike] = {}
    values = {"": measured} if true is None else {"": measured, "_true": true}
    delays = fitted_delays_s(desired, tuple(values.values()), dt_s)
    wanted = np.broadcast_to(desired, (len(values), len(desired)))
    errors = error_figures(wanted, list(values.values()), dt_s, high_pass_hz)
    for row, suffix in enumerate(values):
        found |= _four(f"{run}.tracking_{{}}_m_s2{suffix}", errors.of(row))
        found[f"{run}.tracking_delay_s{suffix}"] = delays[row]
    return found


def against_sim(
    run: str, sim_accel: Array, accel: Array, true_accel: Array | None, dt_s: float, high_pass_hz: float = 0.0
) -> dict[str, ArrayLike]:
    """Return errors of absolute acceleration against SIM, storey by storey; arrays (n_storeys, n)."""
    found: dict[str, ArrayLike] = {}
    for value, suffix in ((accel, ""), (true_accel, "_true")):
        if value is not None:
            found |= _four(f"{run}.{{}}_error_m_s2{suffix}", error_figures(sim_accel, value, dt_s, high_pass_hz))
    return found


def _four(path: str, error: ErrorFigures) -> dict[str, ArrayLike]:
    """Return maximum and RMS in the test band and in full band under a path with a hole for max or rms."""
    return {
        path.format("max"): error.maximum,
        path.format("rms"): error.rms,
        path.format("max") + "_full": error.maximum_full,
        path.format("rms") + "_full": error.rms_full,
    }


def of_margins(group: str, found: Margins, suffix: str) -> dict[str, ArrayLike]:
    """Return the margins of one loop under a group of paths; infinite where nothing is crossed."""
    values = {
        "sensitivity_peak": found.sensitivity_peak,
        "sensitivity_peak_hz": found.peak_hz,
        "gain_margin": found.gain_margin,
        "gain_reduction_margin": found.gain_reduction_margin,
        "phase_margin_deg": found.phase_margin_deg,
        "delay_margin_s": found.delay_margin_s,
    }
    return {f"{group}.{name}{suffix}": value for name, value in values.items()}
