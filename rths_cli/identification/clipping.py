"""Is a channel cut off at its extremes? Its peaks tell, as the converter saw them."""

from __future__ import annotations

import numpy as np

from rths_cli.filters import filtered, section
from rths_cli.lti import Array
from rths_cli.rig_info import Channel

TOP, FLAT, FLATTEST, CUT_OFF, LEAST_TOP = 0.95, 0.998, 0.993, 0.5, 6
NOISE_SIGMA = 6.0


def cut_off_peaks(accel: Array, channel: Channel, dt_s: float, rest_rms_m_s2: float, bit_m_s2: float = 0.0) -> int:
    """Return how many peaks of a channel (n,) in m/s^2 are cut off; it may be corrected for the sensor's corners.

    A limit acts before the correction, which tilts a flat top: both are looked at. `bit_m_s2`: of its converter.
    """
    both = accel, as_sampled(accel, channel, dt_s)
    return max(flat_tops(values, rest_rms_m_s2, bit_m_s2) for values in both)


def as_sampled(accel: Array, channel: Channel, dt_s: float) -> Array:
    """Return a corrected channel (n,) in m/s^2 with its sensor's corners put back, as the converter saw it.

    It undoes 1 + w_h / s (trapezoidal rule) and the lead 1 + T / dt (3/2 - 2/z + 1/2 z^-2), T = 1 / w_l,
    from rest.
    """
    half = np.pi * channel.high_pass_hz * dt_s
    lead = 1.0 / (2.0 * np.pi * channel.low_pass_hz * dt_s) if channel.low_pass_hz > 0.0 else 0.0
    coupling = section([1.0, -1.0], [1.0 + half, half - 1.0])
    lag = section([1.0], [1.0 + 1.5 * lead, -2.0 * lead, 0.5 * lead])
    return filtered(np.vstack([coupling, lag]), accel - accel[0])


def flat_tops(accel: Array, rest_rms_m_s2: float = 0.0, bit_m_s2: float = 0.0) -> int:
    """Return how often a signal (n,) in m/s^2 is cut off at its extremes.

    Of the time that a peak, a parabola, spends above 95 % of its top it spends sqrt(0.002 / 0.05) = 0.2 above 99.8 %
    (0.37 above 99.3 %, which noise may ask for); one that is cut off spends most of it there. Where a bit of the
    converter is more than 0.7 % of the top every peak is flat, and none is counted.
    """
    count = 0
    for side in (accel, -accel):
        top = float(side.max())
        if bit_m_s2 > (1.0 - FLATTEST) * top:
            continue
        flat = np.clip(1.0 - NOISE_SIGMA * rest_rms_m_s2 / top, FLATTEST, FLAT) if top > 0.0 else FLAT
        edges = np.diff((side > TOP * top).astype(np.int8), prepend=0, append=0)
        stretches = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
        shares = [int(np.sum(side[a:b] > flat * top)) / (b - a) for a, b in stretches if b - a >= LEAST_TOP]
        count += sum(int(share > CUT_OFF) for share in shares)
    return count
