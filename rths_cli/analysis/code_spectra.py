"""Spectra that codes prescribe, from their parameters, and the factor that brings a motion's spectrum to one."""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.intensity import spectrum
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array

GROUNDS = {  # EN 1998-1, tables 3.2 and 3.3: soil factor, periods TB, TC, TD in s
    1: {
        "A": (1.0, 0.15, 0.4, 2.0), "B": (1.2, 0.15, 0.5, 2.0), "C": (1.15, 0.2, 0.6, 2.0), "D": (1.35, 0.2, 0.8, 2.0),
        "E": (1.4, 0.15, 0.5, 2.0),
    },
    2: {
        "A": (1.0, 0.05, 0.25, 1.2), "B": (1.35, 0.05, 0.25, 1.2), "C": (1.5, 0.1, 0.25, 1.2),
        "D": (1.8, 0.1, 0.3, 1.2), "E": (1.6, 0.05, 0.25, 1.2),
    },
}  # fmt: skip
LEAST_DAMPING_FACTOR = 0.55
PER_DECADE = 40  # periods at which spectra are compared


def ec8(periods_s: Array, ground: str, ag_m_s2: float, kind: int = 1, damping_ratio: float = 0.05) -> Array:
    """Return the horizontal elastic spectrum of Eurocode 8 in m/s^2 (EN 1998-1, 3.2.2.2), (p,)."""
    soil, tb, tc, td = GROUNDS[kind][ground]
    eta = max(np.sqrt(10.0 / (5.0 + 100.0 * damping_ratio)), LEAST_DAMPING_FACTOR)
    t = np.asarray(periods_s, dtype=float)
    flat = 2.5 * eta
    shape = np.where(t < tb, 1.0 + t / tb * (flat - 1.0), flat)
    with np.errstate(divide="ignore"):  # at t = 0, which takes the first branch
        shape = np.where(t > tc, flat * tc / t, shape)
        shape = np.where(t > td, flat * tc * td / t**2, shape)
    return np.asarray(ag_m_s2 * soil * shape)


def asce7(periods_s: Array, sds_g: float, sd1_g: float, tl_s: float = 8.0) -> Array:
    """Return the design response spectrum of ASCE 7-16 in m/s^2 (11.4.6), (p,)."""
    t, ts = np.asarray(periods_s, dtype=float), sd1_g / sds_g
    shape = np.where(t < 0.2 * ts, sds_g * (0.4 + 0.6 * t / (0.2 * ts)), sds_g)
    with np.errstate(divide="ignore"):
        shape = np.where(t > ts, sd1_g / t, shape)
        shape = np.where(t > tl_s, sd1_g * tl_s / t**2, shape)
    return np.asarray(STANDARD_GRAVITY_M_S2 * shape)


def compared_periods(low_s: float, high_s: float, per_decade: int = PER_DECADE) -> Array:
    """Return the periods (p,) in s at which spectra are compared, evenly spaced in their logarithms."""
    return np.geomspace(low_s, high_s, max(int(per_decade * np.log10(high_s / low_s)), 2) + 1)


def least_squares_factor(
    accel_m_s2: Array, dt_s: float, periods_s: Array, target_m_s2: Array, damping_ratio: float
) -> float:
    """Return the factor on an acceleration (n,) that leaves the least squares between the logarithms of its spectrum
    and of a target (p,)."""
    own = spectrum(accel_m_s2, dt_s, periods_s, damping_ratio).sa_m_s2
    return float(np.exp(np.log(target_m_s2 / own).mean()))


def misfit(
    accel_m_s2: Array, dt_s: float, periods_s: Array, target_m_s2: Array, damping_ratio: float
) -> tuple[float, float]:
    """Return the mean and the largest relative misfit of an acceleration's (n,) spectrum to a target (p,)."""
    own = spectrum(accel_m_s2, dt_s, periods_s, damping_ratio).sa_m_s2
    found = np.abs(own / target_m_s2 - 1.0)
    return float(found.mean()), float(found.max())
