"""The way of a late command by docs/reference/udp.md, drawn by scipy: cubics from slopes at the points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline


def smooth_way(volts: Sequence[float], spacing: int, count: int) -> NDArray[np.float64]:
    """Return where a command that goes through these volts (itself first) is in each of `count` intervals.

    The slope at a point is the mean of those of the straight lines on both sides; at the last one it is zero. At the
    first one it is that of the parabola through three points, or with two of the one that comes to rest.
    """
    points = np.array(volts, dtype=float)
    lines = np.diff(points)
    first = 1.5 * lines[0] - 0.5 * lines[1] if len(lines) > 1 else 2.0 * lines[0]
    slopes = np.array([first, *(0.5 * (lines[:-1] + lines[1:])), 0.0])
    spline = CubicHermiteSpline(np.arange(len(points)), points, slopes)
    return np.asarray(spline(np.minimum(np.arange(count) / spacing, len(points) - 1.0)))
