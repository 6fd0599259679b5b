"""Frequency responses from records: H1 by Welch's method, from the command to each corrected channel."""

from __future__ import annotations

import numpy as np

from rths_cli.errors import InputError
from rths_cli.lti import Array, ComplexArray, Frf

SEGMENT_S = 40.0
"""Hann segments: resolution 0.04 Hz, bias 1 / (6 T^2) times the second derivative of the response."""
LEAST_SEGMENTS = 4
OVERLAP_CORRELATION = 1.0 / 36.0  # squared correlation of Hann segments that overlap by half (Welch 1967)
ERROR_FLOOR = 1e-6


def estimate(
    command_v: Array, outputs: Array, dt_s: float, band_hz: tuple[float, float], segment_s: float = SEGMENT_S
) -> tuple[Frf, ...]:
    """Estimate H1 from the command (n,) in V to each output (c, n) in m/s^2 at the lines within a band.

    Welch's method: Hann segments that overlap by half. The second difference of the command stands for the
    command, which makes response and spectrum flat at low frequencies, where leakage would show; it is put back
    exactly. The standard error is sqrt((1 - c) / (2 c n)) (Bendat and Piersol, Random Data, chapter 9).
    Raises InputError when the record is shorter than four segments.
    """
    from scipy.signal import csd, welch

    length = round(segment_s / dt_s)
    segments = 2 * (len(command_v) // length) - 1 + int(len(command_v) % length >= length // 2)
    if segments < 2 * LEAST_SEGMENTS - 1:
        raise InputError(
            f"identification.duration_s: {len(command_v) * dt_s:.0f} s of noise is shorter than {LEAST_SEGMENTS} "
            f"segments of {segment_s:g} s; excite for longer"
        )
    moved = np.diff(command_v, 2, prepend=[0.0, 0.0])
    options = {"fs": 1.0 / dt_s, "window": "hann", "nperseg": length, "detrend": "constant"}
    frequency, input_power = welch(moved, **options)
    inside = (frequency >= band_hz[0]) & (frequency <= band_hz[1])
    frequency, input_power = frequency[inside], input_power[inside]
    difference = second_difference(frequency, dt_s)
    averages = segments / (1.0 + 2.0 * OVERLAP_CORRELATION * (segments - 1) / segments)
    frfs = []
    for output in outputs:
        cross = csd(moved, output, **options)[1][inside]
        coherence = np.abs(cross) ** 2 / (input_power * welch(output, **options)[1][inside])
        error = np.sqrt((1.0 - coherence) / (2.0 * coherence * averages)).clip(min=ERROR_FLOOR)
        frfs.append(Frf(frequency, cross / input_power * difference, coherence, error, round(averages)))
    return tuple(frfs)


def second_difference(frequency_hz: Array, dt_s: float) -> ComplexArray:
    """Return (1 - 1/z)^2 at z = exp(j w dt), (n_frequencies,)."""
    return (1.0 - np.exp(-2j * np.pi * frequency_hz * dt_s)) ** 2
