"""SIM of a building whose numerical part is a reduced frame: with all degrees of freedom of the frame.

The reduction is one of the errors of a hybrid test, so its reference knows nothing of it. Like SIM of other buildings
it sums the complex modes, each one exact for the piecewise linear record; only the motion of the coordinates that the
loop has is kept.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import matrix_balance

from rths_cli.analysis.sim import (
    Response,
    base_shear_n,
    check_size,
    checked_record,
    held_modes,
    residual_of_steps,
    sampled_steps,
    state_equation,
)
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.structure import Building

LARGEST_ERROR = 1e-6  # of a peak, by the residual of single steps
AT_ONCE = 64  # modes whose series are in memory


def simulate_unreduced(building: Building, dt_s: float, ground_accel_m_s2: Array) -> Response:
    """Solve M d2x + C dx + K x = -M r a_g of the unreduced building from rest for a record (n,) linear between
    samples.

    The series are those of the reduced building's coordinates. Raises InputError as `sim.simulate` does.
    """
    record, whole, rows = checked_record(dt_s, ground_accel_m_s2), building.unreduced, building.rows_of_unreduced
    check_size(len(rows), len(record), dt_s)
    n = len(whole.M)
    A, B = state_equation(whole.M, whole.C, whole.K, whole.influence)
    values, shapes = _modes_of(A)
    drives: ComplexArray = np.linalg.solve(shapes, B.astype(complex))[:, 0].astype(complex)
    upper = np.flatnonzero(values.imag >= 0.0)
    weights = shapes[:, upper] * np.where(values[upper].imag > 0.0, 2.0, 1.0)
    wanted = np.vstack([weights[rows], weights[n + rows], (weights * values[upper])[n + rows]])
    steps = sampled_steps(len(record))
    series, before, after = np.zeros((len(wanted), len(record))), *np.zeros((2, 2 * n, len(steps)))
    for first in range(0, len(upper), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        modal = held_modes(values[upper][some], drives[upper][some], dt_s, record)
        series += _real(wanted[:, some], modal)
        before += _real(weights[:, some], modal[:, :, steps])
        after += _real(weights[:, some], modal[:, :, np.minimum(steps + 1, len(record) - 1)])
    count = len(rows)
    disp, vel, accel = series[:count], series[count : 2 * count], series[2 * count :]
    peaks = np.concatenate([np.full(n, _peak(before[:n])), np.full(n, _peak(before[n:])), np.full(n, _peak(accel))])
    error = residual_of_steps(A, B, dt_s, record, (steps, before, after), peaks)
    if not error <= LARGEST_ERROR:
        raise InputError(
            f"SIM: all {n} degrees of freedom of this frame can only be solved to {error:.1g} of the peak (at most "
            f"{LARGEST_ERROR:g}): its masses or stiffnesses are too unlike; condense the lightest degrees of freedom "
            "before the export, by a mass of zero"
        )
    return Response(disp, vel, accel, base_shear_n(building, accel, np.vstack([disp, vel])), error)


def _modes_of(A: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the eigenvalues (2n,) in rad/s and eigenvectors (2n, 2n), found in units in which they are of one size."""
    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    values, vectors = np.linalg.eig(balanced)
    return values.astype(complex), (scale[:, None] * vectors).astype(complex)


def _real(weights: ComplexArray, modal: Array) -> Array:
    """Return the real part of weights (r, m) times modes (2, m, n), real and imaginary part."""
    return np.asarray(weights.real @ modal[0] - weights.imag @ modal[1])


def _peak(series: Array) -> float:
    return float(np.abs(series).max(initial=0.0)) or 1.0
