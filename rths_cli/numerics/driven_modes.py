"""Modes of complex poles, driven by a series."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.numerics.lti import Array


def driven_modes(poles: ArrayLike, now: ArrayLike, before: ArrayLike, series: ArrayLike) -> Array:
    """Return z[k] = p z[k-1] + a u[k] + b u[k-1], z[0] = 0, for each complex mode: (2, m, n), real and imaginary part.

    `poles` p, `now` a, `before` b are complex (m,), `series` u is (n,).
    """
    from scipy.signal import lfilter

    numbers = np.array([poles, now, before], dtype=complex).reshape(3, -1)
    drive = np.asarray(series, dtype=float)
    modes = np.empty((2, numbers.shape[1], len(drive)))
    for r, (p, a, b) in enumerate(numbers.T):
        mode, _ = lfilter([a, b], [1.0, -p], drive, zi=[-a * drive[0]])
        modes[0, r], modes[1, r] = mode.real, mode.imag
    return modes
