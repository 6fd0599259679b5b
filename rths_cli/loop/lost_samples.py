"""How the log marks steps whose samples were lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.lti import Array

# values of `lost`: no samples came in time; the step was caught up without samples; samples came, but the step used a
# mix of them and of substituted ones
NO_ANSWER, CAUGHT_UP, MIXED = 1, 2, 3


def without_samples(lost: Array) -> NDArray[np.bool_]:
    """Return which steps (n,) have no samples of their instant, from the log's `lost`."""
    return np.asarray((lost == NO_ANSWER) | (lost == CAUGHT_UP))
