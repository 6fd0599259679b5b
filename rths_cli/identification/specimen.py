"""The specimen from the accelerations of table and floors, with weighed floor masses.

Output error in the frequency domain: the discrete Fourier transform of a stretch of record obeys
Y = H(jw) A + C (jw - A_s)^-1 d exactly, H the floors' transmissibility, A the table's acceleration and d the state at the
stretch's start less that at its end. With d free there is no leakage however light the damping, and the same
equation serves noise and free vibration, whose coupled motion of table and specimen is input and output at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.errors import InputError
from rths_cli.lti import Array, ComplexArray
from rths_cli.structure import Specimen, modal_damping_matrix, storey_matrix

LEAST_RATIO, MOST_RATIO = 1e-3, 0.5
ABOVE_HIGHEST = 1.6  # the lines used end at this multiple of the highest natural frequency


@dataclass(frozen=True)
class SpecimenFit:
    """Identified specimen of n floors relative to the table: chain of storey stiffnesses, modal damping.

    Natural frequencies in Hz, damping ratios (n,) and their standard errors; `mode_shapes` (n, n), a mode per
    column, largest floor 1; `stiffness_n_per_m` (n,); `residual` = rms of what is not explained over rms of the floors.
    """

    specimen: Specimen
    stiffness_n_per_m: Array
    natural_frequency_hz: Array
    damping_ratio: Array
    mode_shapes: Array
    frequency_error_hz: Array
    damping_error: Array
    residual: float


@dataclass(frozen=True)
class _Stretch:
    """Fourier lines s (m,) of table (m,) and floors (m, n) accelerations."""

    s: ComplexArray
    table: ComplexArray
    floors: ComplexArray


def fit_specimen(
    table_accel: Array,
    floor_accel: Array,
    dt_s: float,
    masses_kg: Array,
    band_hz: tuple[float, float],
    start: SpecimenFit | None = None,
) -> SpecimenFit:
    """Fit storey stiffnesses and modal damping ratios to table (n,) and floor accelerations (c, n) in m/s^2.

    `masses_kg` (c,) are weighed. The start is the dynamic stiffness of each storey, unless one is given.
    Raises InputError when the accelerations are not those of a shear building with these masses.
    """
    from scipy.optimize import least_squares

    masses = np.asarray(masses_kg, dtype=float)
    whole = _transform(table_accel, floor_accel, dt_s, band_hz)
    if start is None:
        stiffness, ratios = _storey_start(whole, masses)
    else:
        stiffness, ratios = start.stiffness_n_per_m, start.damping_ratio
    highest = ABOVE_HIGHEST * float(modal(masses, stiffness)[0][-1]) / (2.0 * np.pi)
    lines = _below(whole, max(highest, 2.0 * band_hz[0]))
    scale = float(np.linalg.norm(lines.floors))
    theta = np.log(np.concatenate([stiffness, ratios]))
    found = least_squares(lambda p: _residual(lines, masses, p) / scale, theta, x_scale=0.1, max_nfev=50)
    stiffness, ratios = np.split(np.exp(found.x), 2)
    return _described(masses, stiffness, ratios, found.jac, found.fun)


def modal(masses_kg: Array, stiffness_n_per_m: Array) -> tuple[Array, Array]:
    """Return natural frequencies in rad/s, ascending, (n,) and mass-normalised mode shapes (n, n)."""
    root = np.sqrt(masses_kg)
    eigenvalues, shapes = np.linalg.eigh(storey_matrix(stiffness_n_per_m) / np.outer(root, root))
    return np.sqrt(eigenvalues), shapes / root[:, None]


def _transform(table: Array, floors: Array, dt_s: float, band_hz: tuple[float, float]) -> _Stretch:
    """Return the Fourier lines of a stretch within a band; its first sample is the mean of both ends (trapezoids)."""
    from scipy.fft import next_fast_len, rfft
    from scipy.signal import detrend

    signals = np.vstack([table, floors])
    count = next_fast_len(signals.shape[1] // 2, real=True)
    while count > signals.shape[1] - 1:
        count = next_fast_len(count // 2, real=True)
    raise NotImplementedError
