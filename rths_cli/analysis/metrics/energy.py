"""Energy that the tracking error feeds into the structure, and input energy of the ground motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.analysis.metrics.response_errors import check_pair
from rths_cli.numerics.bands import TEST_BAND_HZ, with_test_band
from rths_cli.numerics.lti import Array

DRIFT_HZ = 0.1  # corner, with the usual test band, of the high pass that removes the drift of an integral


def velocity_error_m_s(accel_error_m_s2: ArrayLike, dt_s: float, test_band_hz: float = TEST_BAND_HZ) -> Array:
    """Integrate acceleration errors (..., n) in m/s^2 from rest to velocity errors (..., n) in m/s, and remove drift.

    The trapezoidal rule is followed by a 2nd-order Butterworth high pass at 1/120 of the test band (0.1 Hz of 12 Hz),
    forward and backward, because an accelerometer does not measure slower motion.
    """
    from scipy.signal import butter, sosfiltfilt

    velocity = _integral(np.asarray(accel_error_m_s2, dtype=float), dt_s)
    sections = butter(2, with_test_band(DRIFT_HZ, test_band_hz), "high", fs=1.0 / dt_s, output="sos")
    return np.asarray(sosfiltfilt(sections, velocity, padlen=min(9, velocity.shape[-1] - 1)))


def error_energy_j(base_shear_n: ArrayLike, velocity_error_m_s: ArrayLike, dt_s: float) -> Array:
    """Return the energy (n,) in J that the interface error has fed in so far: int f (v_desired - v_measured) dt.

    `base_shear_n` (n,): force f of the specimen on the interface floor in N (Eq. 2.6). `velocity_error_m_s` (n,):
    desired - measured velocity of the interface in m/s. The numerical substructure takes the power f v_desired from the
    interface, and the specimen supplies f v_measured; the table supplies the difference. A positive value adds energy,
    as negative damping does. Raises InputError if the lengths differ. Source of the idea: Mosqueda, Stojadinovic,
    Mahin, J. Struct. Eng. 133 (2007) 1100; Ahmadizadeh and Mosqueda, Eng. Struct. 31 (2009) 1987.
    """
    force, error = check_pair(base_shear_n, velocity_error_m_s, ("base_shear_n", "velocity_error_m_s"))
    return _integral(force * error, dt_s)


def input_energy_j(M: Array, rel_vel_m_s: Array, ground_accel_m_s2: Array, dt_s: float) -> Array:
    """Return the relative input energy (n,) in J so far: -int dx^T M 1 a_g dt.

    `M` (n_storeys, n_storeys): mass matrix in kg; `rel_vel_m_s` (n_storeys, n): velocities dx relative to the ground;
    `ground_accel_m_s2` (n,): ground acceleration a_g. Source: Uang and Bertero, Earthquake Eng. Struct. Dyn. 19 (1990)
    77.
    """
    return _integral(-(M.sum(axis=1) @ rel_vel_m_s) * ground_accel_m_s2, dt_s)


def _integral(rate: Array, dt_s: float) -> Array:
    """Return the integral (..., n) of `rate` (..., n) over time by the trapezoidal rule, zero at the first sample."""
    whole = np.zeros(rate.shape)
    np.cumsum(0.5 * dt_s * (rate[..., 1:] + rate[..., :-1]), axis=-1, out=whole[..., 1:])
    return whole
