"""An error history through the filters of its RMS (high pass, test band), for figures and the HTML page."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.metrics import high_passed, test_band
from rths_cli.files.result_reader import Result
from rths_cli.numerics.lti import Array


def evaluated_error(result: Result, run: str, error: Array, dt_s: float) -> Array:
    """Return an error (n,) of a run through the filters of its RMS: the run's `high_pass_hz`, then the test band.

    A file without `high_pass_hz` has no RMS of that run either, or one without a high pass: then there is none here.
    NaN throughout where the error has fewer than two samples or one that is NaN.
    """
    if error.size < 2:
        return np.full(error.shape, np.nan)
    corner_hz = float(np.asarray(result.metrics.get(f"{run}.high_pass_hz", 0.0)))
    return test_band(high_passed(error, corner_hz, dt_s), dt_s)
