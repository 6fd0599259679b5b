"""From raw samples (V) to the values of all channels: sensitivity, and the sensors' known filters taken out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rths_cli.numerics.lti import Array, Block
from rths_cli.rigs.description import Channel


def recorrected(accel: Array, before: tuple[Channel, ...], after: tuple[Channel, ...], dt_s: float) -> Array:
    """Return motions (c, n) in m/s^2 that were corrected by the channels of `before` as those of `after` correct them,
    as if the first sample had lasted."""
    from scipy import signal

    made = np.empty_like(accel)
    for i, (old, new) in enumerate(zip(before, after, strict=True)):
        over, under = _polynomial(new, dt_s), _polynomial(old, dt_s)
        made[i] = signal.lfilter(over, under, accel[i], zi=signal.lfilter_zi(over, under) * accel[i, 0])[0]
    return made


def _polynomial(channel: Channel, dt_s: float) -> Array:
    """Return the numerator of a channel's correction in powers of 1/z; its denominator is 1 - 1/z.

    Without AC coupling the numerator has the denominator as a factor; both are left out.
    """
    half, lead = _corner_terms(channel, dt_s)
    low_pass = np.array([1.0 + 1.5 * lead, -2.0 * lead, 0.5 * lead]) / channel.sensitivity_v_per_unit
    return np.convolve(low_pass, [1.0 + half, half - 1.0]) if channel.high_pass_hz > 0.0 else low_pass


def _corner_terms(channel: Channel, dt_s: float) -> tuple[float, float]:
    """Return w_h dt / 2 of the AC coupling and T / dt of the low pass, 0 for a corner that there is none of."""
    lead = 1.0 / (2.0 * np.pi * channel.low_pass_hz * dt_s) if channel.low_pass_hz > 0.0 else 0.0
    return np.pi * channel.high_pass_hz * dt_s, lead


def correction(channels: tuple[Channel, ...], dt_s: float, corners: bool = True) -> Block:
    """Return the block from samples in V (c,) to accelerations in m/s^2 (c,), corrected for the sensors' corners.

    Without `corners` only the sensitivities are taken out.

    The AC coupling s / (s + w_h) is undone by 1 + w_h / s (trapezoidal rule), the low pass w_l / (s + w_l) by
    1 + T / dt (3/2 - 2/z + 1/2 z^-2), T = 1 / w_l, the difference that is right to second order: a corrected sample
    belongs to its own instant and has its own size; at 60 Hz, 1549 Hz and 2 kHz 0.01 % and 0.03 degrees are left.
    Three states per channel: the last two samples, and the integral of the samples.
    """
    count = len(channels)
    a, b = np.zeros((3 * count, 3 * count)), np.zeros((3 * count, count))
    c, d = np.zeros((count, 3 * count)), np.zeros((count, count))
    for i, channel in enumerate(channels):
        scale = 1.0 / channel.sensitivity_v_per_unit
        half, lead = _corner_terms(channel, dt_s) if corners else (0.0, 0.0)
        last, before, total = 3 * i, 3 * i + 1, 3 * i + 2
        b[last, i], a[before, last], a[total, total] = 1.0, 1.0, 1.0
        # y = x_k, x_k-1, x_k-2 times these; its integral grows by half (y_k + y_k-1)
        now, one, two = scale * (1.0 + 1.5 * lead), -2.0 * scale * lead, 0.5 * scale * lead
        b[total, i], a[total, last], a[total, before] = 2.0 * half * now, 2.0 * half * one, 2.0 * half * two
        c[i, last], c[i, before], c[i, total] = one * (1.0 + half), two * (1.0 + half), 1.0
        d[i, i] = now * (1.0 + half)
    names = tuple(channel.name for channel in channels)
    outputs = tuple(f"{n}_accel_m_s2" for n in names)
    return Block("sensor_correction", a, b, c, d, dt_s, tuple(f"{n}_v" for n in names), outputs)


UNIT_SUFFIX = {"acceleration": "m_s2", "displacement": "m", "force": "n", "strain": "1"}


def further_correction(channels: tuple[Channel, ...], dt_s: float, corners: bool = True) -> Block | None:
    """Return the block from samples in V (f,) of the channels beside the accelerometers of table and floors to their
    values (f,), each in the unit of its kind, as `correction`; None without such channels."""
    if not channels:
        return None
    block = correction(channels, dt_s, corners)
    outputs = tuple(f"{channel.name}_{UNIT_SUFFIX[channel.kind]}" for channel in channels)
    return replace(block, name="further_correction", outputs=outputs)
