"""What a hybrid test showed beside what its check had expected."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.true_error import TrueError
    from rths_cli.quantities import Values

FACTOR = 1.5  # by which the measured error may differ from the expected one before it is told
LEAST_PERCENT = 0.5  # of SIM's RMS; a smaller error, measured and expected, is not worth a sentence


def metrics_of(predicted: TrueError | None, values: Values) -> dict[str, ArrayLike]:
    """Return the measured errors over the expected ones, and the ranks of the true errors, by path; `values` holds the
    errors."""
    found: dict[str, ArrayLike] = {}
    expected, measured = (values.get(name) for name in ("check.expected_error_m_s2", "exp_rths.rms_error_m_s2"))
    if expected is not None and measured is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            found["exp_rths.error_over_expected"] = np.asarray(measured) / np.asarray(expected)
    true = values.get("exp_rths.true_reference_rms_error_m_s2")
    if predicted is not None and true is not None:
        found["exp_rths.true_error_rank"] = predicted.rank(np.asarray(true))
    return found


def disagreement(values: Values) -> tuple[str, ...]:
    """Return a sentence where the measured error of a storey is not the expected one, the one farthest off."""
    needed = ("exp_rths.error_over_expected", "exp_rths.rms_error_m_s2", "exp_rths.nrmse_percent")
    if any(name not in values for name in needed):
        return ()
    over, error, percent = (np.asarray(values[name], dtype=float) for name in needed)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart, largest = np.abs(np.log(over)), percent * np.maximum(1.0, 1.0 / over)
    told = np.isfinite(apart) & (apart > np.log(FACTOR)) & (largest > LEAST_PERCENT)
    if not told.any():
        return ()
    worst = int(np.argmax(np.where(told, apart, 0.0)))
    where = (
        "look at the causes of the error (rths report RESULT), and for what changed since the identification: sensors, "
        "specimen, level of motion"
        if over[worst] > 1.0
        else "the check was more careful than this test needed"
    )
    return (
        f"measured and expected error differ: {1e3 * error[worst]:.3g} mm/s^2 at storey {worst + 1} is "
        f"{over[worst]:.2g} times what the check expected; {where}",
    )
