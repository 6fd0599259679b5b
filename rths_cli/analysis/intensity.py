"""How strong a ground motion is: peaks, energy, durations, response spectra, and what follows from them.

Every measure takes the acceleration (n,) in m/s^2 as linear between its samples, which are `dt_s` apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array, driven_modes

STEPS_PER_PERIOD = 100  # at which an oscillator is seen: its peak is missed by 0.05 % at most
MOST_STEPS = 4_000_000
HOUSNER_S = (0.1, 2.5)
HOUSNER_STEPS = 49
HOUSNER_DAMPING = 0.05
MEAN_PERIOD_HZ = (0.25, 20.0)
MEAN_PERIOD_STEP_HZ = 0.05
AVERAGED = np.arange(0.2, 3.01, 0.1)  # times the period, of the average spectral acceleration


@dataclass(frozen=True)
class Measures:
    """Intensity measures of one acceleration: peaks, Arias intensity, cumulative absolute velocity, significant
    durations between 5 and 75 or 95 % of the Arias intensity, mean period, Housner intensity."""

    pga_m_s2: float
    pgv_m_s: float
    pgd_m: float
    arias_m_s: float
    cav_m_s: float
    d5_75_s: float
    d5_95_s: float
    mean_period_s: float
    housner_m: float


@dataclass(frozen=True)
class Spectrum:
    """Response spectra at periods (p,) for one damping: relative displacement Sd, pseudo-velocity and -acceleration."""

    periods_s: Array
    damping_ratio: float
    sd_m: Array

    @property
    def sv_m_s(self) -> Array:
        """Return the pseudo-velocity, 2 pi / T Sd."""
        return 2.0 * np.pi / self.periods_s * self.sd_m

    @property
    def sa_m_s2(self) -> Array:
        """Return the pseudo-acceleration, (2 pi / T)^2 Sd."""
        return (2.0 * np.pi / self.periods_s) ** 2 * self.sd_m


def integrate(accel_m_s2: Array, dt_s: float) -> tuple[Array, Array]:
    """Return velocity in m/s and displacement in m, each (n,), of a piecewise-linear acceleration (n,) from rest."""
    before, after = accel_m_s2[:-1], accel_m_s2[1:]
    velocity = np.concatenate([[0.0], np.cumsum(0.5 * dt_s * (before + after))])
    steps = dt_s * velocity[:-1] + dt_s**2 * (2.0 * before + after) / 6.0
    return velocity, np.concatenate([[0.0], np.cumsum(steps)])


def measures(accel_m_s2: Array, dt_s: float) -> Measures:
    """Return the intensity measures of an acceleration (n,)."""
    velocity, displacement = integrate(accel_m_s2, dt_s)
    energy = husid(accel_m_s2, dt_s)
    low, high = HOUSNER_S
    periods = np.linspace(low, high, HOUSNER_STEPS)
    housner = float(np.trapezoid(spectrum(accel_m_s2, dt_s, periods, HOUSNER_DAMPING).sv_m_s, periods))
    return Measures(
        pga_m_s2=_peak(accel_m_s2),
        pgv_m_s=_peak(velocity),
        pgd_m=_peak(displacement),
        arias_m_s=float(energy[-1]),
        cav_m_s=cumulative_velocity(accel_m_s2, dt_s),
        d5_75_s=duration(energy, dt_s, 0.05, 0.75),
        d5_95_s=duration(energy, dt_s, 0.05, 0.95),
        mean_period_s=mean_period(accel_m_s2, dt_s),
        housner_m=housner,
    )


def husid(accel_m_s2: Array, dt_s: float) -> Array:
    """Return the Arias intensity up to each sample in m/s, (n,): pi / (2 g) times the integral of a^2 (Arias 1970)."""
    before, after = accel_m_s2[:-1], accel_m_s2[1:]
    steps = (before**2 + before * after + after**2) * dt_s / 3.0
    return np.pi / (2.0 * STANDARD_GRAVITY_M_S2) * np.concatenate([[0.0], np.cumsum(steps)])


def duration(energy: Array, dt_s: float, low: float, high: float) -> float:
    """Return the time in s between two shares of an energy (n,) that grows, linear between its samples."""
    samples = np.arange(energy.size)
    rising = np.concatenate([[True], np.diff(energy) > 0.0])
    ends = np.interp([low * energy[-1], high * energy[-1]], energy[rising], samples[rising])
    return float(dt_s * (ends[1] - ends[0]))


def cumulative_velocity(accel_m_s2: Array, dt_s: float) -> float:
    """Return the cumulative absolute velocity in m/s, the integral of |a|."""
    before, after = accel_m_s2[:-1], accel_m_s2[1:]
    sizes = np.abs(before) + np.abs(after)
    crossing = (before * after < 0.0) & (sizes > 0.0)
    areas = 0.5 * sizes
    areas[crossing] = 0.5 * (before**2 + after**2)[crossing] / sizes[crossing]
    return float(dt_s * areas.sum())


def mean_period(accel_m_s2: Array, dt_s: float) -> float:
    """Return the mean period in s: the sum of C^2 / f over that of C^2, C the Fourier amplitudes at 0.25 to 20 Hz
    (Rathje, Abrahamson and Bray 1998); 0 where nothing moves there."""
    samples = max(accel_m_s2.size, int(np.ceil(1.0 / (MEAN_PERIOD_STEP_HZ * dt_s))))
    frequency = np.fft.rfftfreq(samples, dt_s)
    low, high = MEAN_PERIOD_HZ
    within = (frequency >= low) & (frequency <= high)
    power = np.abs(np.fft.rfft(accel_m_s2, samples)[within]) ** 2
    return float(power @ (1.0 / frequency[within]) / power.sum()) if power.any() else 0.0


def spectrum(
    accel_m_s2: Array, dt_s: float, periods_s: Sequence[float] | Array, damping_ratio: float = 0.05
) -> Spectrum:
    """Return the response spectra of an acceleration (n,) at periods (p,) in s, over the record's length.

    The relative displacement u of d2u + 2 zeta w du + w^2 u = -a is exact for the piecewise-linear acceleration (Nigam
    and Jennings 1969) and seen at least 100 times a period. Raises InputError for periods that are not positive and a
    damping ratio outside 0 to 1 (1 excluded).
    """
    periods = np.asarray(periods_s, dtype=float)
    if not np.all((periods > 0.0) & np.isfinite(periods)):
        raise InputError("periods_s: every period must be a positive number of seconds")
    if not 0.0 <= damping_ratio < 1.0:
        raise InputError(f"damping_ratio: {damping_ratio:g} must be at least 0 and below 1")
    sd = [_peak(displacement_history(accel_m_s2, dt_s, 2.0 * np.pi / p, damping_ratio)[0]) for p in periods]
    return Spectrum(periods, damping_ratio, np.array(sd))


def average_sa(accel_m_s2: Array, dt_s: float, period_s: float, damping_ratio: float = 0.05) -> float:
    """Return the geometric mean in m/s^2 of the pseudo-acceleration from 0.2 to 3 times a period (Eads and others
    2015)."""
    found = spectrum(accel_m_s2, dt_s, AVERAGED * period_s, damping_ratio).sa_m_s2
    return float(np.exp(np.log(np.maximum(found, np.finfo(float).tiny)).mean()))


def displacement_history(accel_m_s2: Array, dt_s: float, omega: float, damping_ratio: float) -> tuple[Array, float]:
    """Return the relative displacement (m,) in m of one oscillator to an acceleration (n,), and its interval in s, at
    most 1/100 of a period: u = -Im(z) / w_d, dz = s z + a, s = -zeta w + i w_d."""
    damped = omega * np.sqrt(1.0 - damping_ratio**2)
    wanted = int(np.ceil(STEPS_PER_PERIOD * omega * dt_s / (2.0 * np.pi)))
    parts = max(1, min(wanted, MOST_STEPS // accel_m_s2.size))
    places = np.arange((accel_m_s2.size - 1) * parts + 1) / parts
    accel = accel_m_s2 if parts == 1 else np.interp(places, np.arange(accel_m_s2.size), accel_m_s2)
    x = complex(-damping_ratio * omega, damped) * dt_s / parts
    first, second = _exponential_integrals(x)
    now, before = dt_s / parts * second, dt_s / parts * (first - second)
    _, imaginary = driven_modes(np.exp(x), now, before, accel)
    return -imaginary[0] / damped, dt_s / parts


def _exponential_integrals(x: complex) -> tuple[complex, complex]:
    """Return (e^x - 1) / x and (e^x - 1 - x) / x^2, from their series for small |x|."""
    if abs(x) > 0.5:
        first = (np.exp(x) - 1.0) / x
        return first, (first - 1.0) / x
    second, term = 0j, 0.5 + 0j
    for k in range(3, 20):
        second, term = second + term, term * x / k
    return 1.0 + x * second, second


def _peak(series: Array) -> float:
    return float(np.abs(series).max())
