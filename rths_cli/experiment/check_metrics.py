"""The results of a check as metrics `check.*`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rths_cli.experiment.run_metrics import of_margins
from rths_cli.quantities import over_samples

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from rths_cli.analysis.predicted_error import Prediction
    from rths_cli.analysis.stability_check import Preflight
    from rths_cli.experiment.check import Judged
    from rths_cli.experiment.tangent_verdicts import TangentVerdict

# name of a Reach -> name in the paths check.peak_* and check.limit_*
REACH = {
    "displacement (with room to brake)": "displacement_m",
    "velocity": "velocity_m_s",
    "acceleration": "acceleration_m_s2",
    "accelerometers' range": "sensor_m_s2",
    "actuator force": "force_n",
    "command": "command_v",
}


TRUE_ERROR = {"true_error": "median", "true_error_bound": "bound", "calibration_error": "calibration"}
LARGEST = "check.largest_scaling"
DECLARED = tuple(f"check.limit_{name}" for name in REACH.values())  # metrics that no identification changes


def check_figures(judged: Judged) -> dict[str, ArrayLike]:
    """Return the metrics of a check by path; for an unstable loop, predicted peaks and errors are left out.

    Over several samples of the identified model, a metric that differs between them carries its range as an interval.
    A peak or error that a sample has not, because its loop is unstable or SIM-DELAY would diverge, has no upper end.
    The largest scaling is safe with every sample and has no interval.
    """
    values = _figures(judged)
    samples = []
    for sample in judged.samples:
        unlimited = {path: np.full(np.shape(value), np.inf) for path, value in values.items() if path not in DECLARED}
        samples.append({**values, **unlimited, **_figures(sample), LARGEST: values[LARGEST]})
    return over_samples(values, samples)


def table_test_figures(found: Preflight) -> dict[str, ArrayLike]:
    """Return the figures of a shake-table test's check by the last part of their paths: loop and predicted peaks."""
    loop = found.stability
    values: dict[str, ArrayLike] = {
        "spectral_radius": loop.radius,
        "tolerated_table_error": loop.tolerates,
        "required_table_error": loop.required,
        "table_error_hz": loop.at_hz,
        "delay_margin_s": loop.measured.delay_margin_s,
    }
    if loop.radius < 1.0:
        values |= {f"peak_{REACH[row.name]}": row.peak for row in found.reach}
    return values


def _figures(judged: Judged) -> dict[str, ArrayLike]:
    """Return the metrics of a check of one member of the identified model, by path."""
    found = judged.preflight
    values = _stability(found) | _modes(judged) | _table_error(found)
    values |= of_margins("check", found.stability.measured, "")
    values |= of_margins("check", found.stability.modelled, "_model")
    values[LARGEST] = judged.largest_scaling
    values["check.friction_v"] = judged.friction_v
    if judged.sim_delay_rms_m_s2 is not None:
        values["check.sim_delay_rms_error_m_s2"] = judged.sim_delay_rms_m_s2
    values |= _tangents(judged.tangents)
    if judged.true_error is not None:
        values |= {f"check.{name}_m_s2": getattr(judged.true_error, field) for name, field in TRUE_ERROR.items()}
        if judged.true_error.pitch is not None:
            values["check.pitch_error_m_s2"] = judged.true_error.pitch
    if judged.expected_m_s2 is not None:
        values["check.expected_error_m_s2"] = judged.expected_m_s2
    if judged.simulated is not None:
        values |= judged.simulated.response
    if found.prediction is None:
        return values
    return values | _reach(found) | _errors(found.prediction)


def _stability(found: Preflight) -> dict[str, ArrayLike]:
    """Return the metrics of the loop's stability and of the critical delay."""
    critical, loop = found.critical, found.stability
    return {
        "check.spectral_radius": loop.radius,
        "check.growth": loop.growth,
        "check.critical_delay_s": critical.delay_s,
        "check.critical_delay_hz": critical.frequency_hz,
        "check.gain_at_infinity": critical.gain_at_infinity,
    }


def _tangents(verdicts: Sequence[TangentVerdict]) -> dict[str, ArrayLike]:
    """Return the metrics of the verdicts at rest and at tangents; none for a linear building."""
    if not verdicts:
        return {}
    critical = np.array([one.critical.delay_s for one in verdicts])
    rows: dict[str, ArrayLike] = {
        "spectral_radius": [one.stability.radius for one in verdicts],
        "tolerated_table_error": [one.stability.tolerates for one in verdicts],
        "required_table_error": [one.stability.required for one in verdicts],
        "table_error_hz": [one.stability.at_hz for one in verdicts],
        "delay_margin_s": [one.stability.measured.delay_margin_s for one in verdicts],
        "critical_delay_s": critical,
        "faults": [float(len(one.faults)) for one in verdicts],
    }
    values = {f"check.tangent_{name}": np.asarray(row) for name, row in rows.items()}
    ends = {"check.critical_delay_least_s": critical.min(), "check.critical_delay_most_s": critical.max()}
    return {**values, **ends}


def _modes(judged: Judged) -> dict[str, ArrayLike]:
    """Return the metrics of the building's modes, on their own and in the loop."""
    (own_hz, own_ratio), (loop_hz, loop_ratio) = judged.building, judged.in_loop
    return {
        "check.building_frequency_hz": own_hz,
        "check.building_damping_ratio": own_ratio,
        "check.loop_frequency_hz": loop_hz,
        "check.loop_damping_ratio": loop_ratio,
    }


def _table_error(found: Preflight) -> dict[str, ArrayLike]:
    """Return the metrics of tolerated and required table error."""
    loop, beyond = found.stability, found.stability.feedback
    alone: dict[str, ArrayLike] = {
        "check.feedback_tolerated_error": beyond.tolerates,
        "check.feedback_required_error": beyond.required,
        "check.feedback_error_hz": beyond.at_hz,
    }
    return (alone if beyond.required > 0.0 else {}) | {
        "check.tolerated_table_error": loop.tolerates,
        "check.required_table_error": loop.required,
        "check.table_error_hz": loop.at_hz,
        "check.table_gain_change": loop.gain_change,
        "check.tolerated_table_error_in_band": loop.in_band,
        "check.table_error_in_band_hz": loop.in_band_hz,
    }


def _reach(found: Preflight) -> dict[str, ArrayLike]:
    """Return the metrics of predicted peaks and their limits."""
    values: dict[str, ArrayLike] = {}
    for row in found.reach:
        values[f"check.peak_{REACH[row.name]}"] = row.peak
        values[f"check.limit_{REACH[row.name]}"] = row.limit
    return values


def _errors(found: Prediction) -> dict[str, ArrayLike]:
    """Return the metrics of the predicted errors, in total and by cause."""
    parts = [("", found.total), *((f"_{cause}", errors) for cause, errors in found.causes.items())]
    storeys: dict[str, ArrayLike] = {f"check.rms_error{part}_m_s2": errors.storeys for part, errors in parts}
    return storeys | {f"check.tracking_rms{part}_m_s2": errors.tracking for part, errors in parts}
