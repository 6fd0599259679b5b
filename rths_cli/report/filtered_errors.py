"""An error history with the filters of its RMS (high pass, test band), for figures and the HTML page."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.metrics import high_passed, test_band
from rths_cli.files.result_reader import Result
from rths_cli.numerics.lti import Array


def evaluated_error(result: Result, run: str, error: Array, dt_s: float) -> Array:
    """Apply the filters of the RMS to an error (n,) of a run: high pass at the run's `high_pass_hz`, then test band.

    If the result does not state `high_pass_hz`, the high pass is omitted, because the RMS was computed without one or
    does not exist. Returns (n,) in the unit of the error; NaN throughout if the error contains a NaN or fewer than two
    samples.
    """
    if error.size < 2:
        return np.full(error.shape, np.nan)
    corner_hz = float(np.asarray(result.metrics.get(f"{run}.high_pass_hz", 0.0)))
    return test_band(high_passed(error, corner_hz, dt_s), dt_s, result.test_band_hz)
