"""The ground motion of a run: record scaled, interpolated, high-pass filtered, integrated; its response spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.accelerograms import Accelerogram
from rths_cli.numerics.driven_modes import driven_modes
from rths_cli.numerics.lti import Array
from rths_cli.structure import Similitude

CORNER_HZ = 0.25  # of the usual high pass of a record
MOST_SAMPLES = 5_000_000  # largest number of samples: 40 minutes at 2 kHz, 40 MB in each of about ten arrays


@dataclass(frozen=True)
class GroundMotion:
    """Ground motion at the sample rate.

    The acceleration is linear between samples; velocity and displacement are its exact integrals from rest.
    """

    dt_s: float
    time_s: Array  # (n,)
    accel_m_s2: Array  # (n,)
    velocity_m_s: Array  # (n,)
    displacement_m: Array  # (n,)


@dataclass(frozen=True)
class Peaks:
    """Largest absolute values of a ground motion over its samples."""

    accel_m_s2: float
    velocity_m_s: float
    displacement_m: float


def compressed(accelerogram: Accelerogram, scale: Similitude) -> Accelerogram:
    """Return the record of a prototype as the model needs it: in the model's time, with the model's accelerations."""
    accel = accelerogram.accel_m_s2 / scale.factor("m/s^2")
    return replace(accelerogram, dt_s=accelerogram.dt_s / scale.factor("s"), accel_m_s2=accel)


def prepare(
    accelerogram: Accelerogram,
    scaling: float,
    sample_rate_hz: float,
    corner_hz: float = CORNER_HZ,
    order: int = 2,
) -> GroundMotion:
    """Scale the record, interpolate it linearly to the sample rate, then filter it from a zero initial state.

    The filter is a causal Butterworth high pass of the given order; a corner of 0 Hz switches it off. The last sample
    is the last one within the record. Raises InputError with all faults: a sample rate below the record's own, too many
    samples, a corner outside 0 to half the sample rate, an order below 1, a record shorter than one period of the
    corner.
    """
    _check(accelerogram, sample_rate_hz, corner_hz, order)
    recorded_s = accelerogram.dt_s * np.arange(len(accelerogram.accel_m_s2))
    samples = int(np.floor(recorded_s[-1] * sample_rate_hz * (1.0 + 1e-9))) + 1
    time_s = np.arange(samples) / sample_rate_hz
    accel = np.interp(time_s, recorded_s, scaling * accelerogram.accel_m_s2)
    accel = _high_pass(accel, sample_rate_hz, corner_hz, order)
    velocity, displacement = integrate(accel, 1.0 / sample_rate_hz)
    return GroundMotion(1.0 / sample_rate_hz, time_s, accel, velocity, displacement)


def _check(accelerogram: Accelerogram, sample_rate_hz: float, corner_hz: float, order: int) -> None:
    """Raise one InputError with a sentence for each value that does not fit the record."""
    own_rate_hz = 1.0 / accelerogram.dt_s
    duration_s = accelerogram.dt_s * (len(accelerogram.accel_m_s2) - 1)
    faults = []
    if not own_rate_hz <= sample_rate_hz * (1.0 + 1e-9):
        faults.append(
            f"sample_rate_hz: {sample_rate_hz:g} Hz is below the record's {own_rate_hz:g} Hz, which would alias it; "
            "raise it or resample the record"
        )
    if duration_s * sample_rate_hz > MOST_SAMPLES:
        faults.append(
            f"sample_rate_hz: {sample_rate_hz:g} Hz makes {duration_s * sample_rate_hz:.3g} samples of the record's "
            f"{duration_s:g} s, the limit is {MOST_SAMPLES:.3g}; lower it to {MOST_SAMPLES / duration_s:.3g} Hz or "
            "shorten the record"
        )
    if not 0.0 <= corner_hz < 0.5 * sample_rate_hz:
        faults.append(
            f"record_filter: the corner {corner_hz:g} Hz must be at least 0 (off) and below half the sample rate, "
            f"{0.5 * sample_rate_hz:g} Hz; correct it"
        )
    if order < 1:
        faults.append(f"record_filter: the order {order} must be at least 1; correct it, or state a corner of 0 (off)")
    if corner_hz > 0.0 and duration_s * corner_hz < 1.0 - 1e-9:
        faults.append(
            f"record: {duration_s:g} s is shorter than one period of the {corner_hz:g} Hz high pass, "
            f"{1.0 / corner_hz:g} s; give a longer record, or raise record_filter.corner_hz (0: no filter)"
        )
    if faults:
        raise InputError(*faults)


def _high_pass(accel: Array, sample_rate_hz: float, corner_hz: float, order: int) -> Array:
    """Return the causal Butterworth high pass of a series (n,) from rest; a corner of 0 Hz returns it unchanged."""
    from scipy.signal import butter, sosfilt

    if corner_hz == 0.0:
        return accel
    return np.asarray(sosfilt(butter(order, corner_hz, "high", fs=sample_rate_hz, output="sos"), accel))


def integrate(accel_m_s2: Array, dt_s: float) -> tuple[Array, Array]:
    """Return velocity in m/s and displacement in m, each (n,), of a piecewise-linear acceleration (n,) from rest."""
    before, after = accel_m_s2[:-1], accel_m_s2[1:]
    velocity = np.concatenate([[0.0], np.cumsum(0.5 * dt_s * (before + after))])
    steps = dt_s * velocity[:-1] + dt_s**2 * (2.0 * before + after) / 6.0
    return velocity, np.concatenate([[0.0], np.cumsum(steps)])


def peaks(motion: GroundMotion) -> Peaks:
    """Return the peak ground acceleration, velocity and displacement."""
    return Peaks(
        float(np.abs(motion.accel_m_s2).max()),
        float(np.abs(motion.velocity_m_s).max()),
        float(np.abs(motion.displacement_m).max()),
    )


def response_spectrum(motion: GroundMotion, periods_s: Sequence[float] | Array, damping_ratio: float = 0.05) -> Array:
    """Return the pseudo-acceleration spectrum w^2 max|u| in m/s^2, (n_periods,), over the record's samples.

    u is the relative displacement of d2u + 2 zeta w du + w^2 u = -a, w = 2 pi / period, solved exactly for the
    piecewise-linear acceleration (Nigam and Jennings 1969) as one complex mode. Raises InputError for periods that are
    not positive and a damping ratio outside 0 to 1 (1 excluded).
    """
    periods = np.asarray(periods_s, dtype=float)
    if not np.all((periods > 0.0) & np.isfinite(periods)):
        raise InputError("periods_s: every period must be a positive number of seconds")
    if not 0.0 <= damping_ratio < 1.0:
        raise InputError(f"damping_ratio: {damping_ratio:g} must be at least 0 and below 1")
    omega = 2.0 * np.pi / periods
    return omega**2 * np.array([_peak_displacement(motion, w, damping_ratio) for w in omega])


def _peak_displacement(motion: GroundMotion, omega: float, damping_ratio: float) -> float:
    """Return max|u| in m of one oscillator with u = -Im(z) / w_d, dz = s z + a, s = -zeta w + i w_d."""
    damped = omega * np.sqrt(1.0 - damping_ratio**2)
    x = complex(-damping_ratio * omega, damped) * motion.dt_s
    first, second = _exponential_integrals(x)
    now, before = motion.dt_s * second, motion.dt_s * (first - second)
    _, imaginary = driven_modes(np.exp(x), now, before, motion.accel_m_s2)
    return float(np.abs(imaginary).max() / damped)


def _exponential_integrals(x: complex) -> tuple[complex, complex]:
    """Return (e^x - 1) / x and (e^x - 1 - x) / x^2, from their series for small |x|."""
    if abs(x) > 0.5:
        first = (np.exp(x) - 1.0) / x
        return first, (first - 1.0) / x
    second, term = 0j, 0.5 + 0j
    for k in range(3, 20):
        second, term = second + term, term * x / k
    return 1.0 + x * second, second
