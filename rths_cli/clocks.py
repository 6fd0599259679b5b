"""The monotonic clock as compiled code reads it."""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from rths_cli.compiled import External, part

IntArray = NDArray[np.int64]

if sys.platform == "win32":  # no clock_gettime there: steps of offline runs are not timed

    @part
    def monotonic_ns(scratch: IntArray) -> int:
        """Return 0."""
        return 0

else:
    _clock_gettime = External("clock_gettime", "intc", "intc", "uintp")
    _MONOTONIC = 6 if sys.platform == "darwin" else 1

    @part
    def monotonic_ns(scratch: IntArray) -> int:
        """Return the monotonic time in ns; `scratch` (2,) int64 receives seconds and nanoseconds."""
        _clock_gettime(_MONOTONIC, scratch.ctypes.data)  # type: ignore[operator]
        return scratch[0] * 1_000_000_000 + scratch[1]
