"""Frequency responses from records: H1 by Welch's method, from the command to each corrected channel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.lti import Array, ComplexArray, Frf, Model

LEAST_SEGMENTS = 4
OVERLAP_CORRELATION = 1.0 / 36.0  # squared correlation of Hann segments that overlap by half (Welch 1967)
ERROR_FLOOR = 1e-6
TAIL_S = 30.0  # rest appended to a command, in which a model's response dies out


def estimate(
    command_v: Array, outputs: Array, dt_s: float, band_hz: tuple[float, float], segment_s: float
) -> tuple[Frf, ...]:
    """Estimate H1 from the command (n,) in V to each output (c, n) in m/s^2 at the lines within a band.

    The second difference of the command stands for the command, which makes response and spectrum flat at low
    frequencies, where leakage would show; it is put back exactly.
    Raises InputError when the record is shorter than four segments.
    """
    frfs = h1(np.diff(command_v, 2, prepend=[0.0, 0.0]), outputs, dt_s, band_hz, segment_s)
    difference = (1.0 - np.exp(-2j * np.pi * frfs[0].frequency_hz * dt_s)) ** 2
    return tuple(replace(frf, response=frf.response * difference) for frf in frfs)


def h1(given: Array, outputs: Array, dt_s: float, band_hz: tuple[float, float], segment_s: float) -> tuple[Frf, ...]:
    """Return H1 from an input (n,) to each output (c, n) by Welch's method: Hann segments that overlap by half.

    The standard error is sqrt((1 - c) / (2 c n)) (Bendat and Piersol, Random Data, chapter 9).
    """
    length = round(segment_s / dt_s)
    if len(given) < LEAST_SEGMENTS * length:
        raise InputError(
            f"identification.duration_s: {len(given) * dt_s:.0f} s of noise is shorter than {LEAST_SEGMENTS} "
            f"segments of {segment_s:g} s; excite for longer, or shorten identification.segment_s"
        )
    frequency = np.arange(length // 2 + 1) / (length * dt_s)
    inside = (frequency >= band_hz[0] - 1e-9) & (frequency <= band_hz[1] + 1e-9)
    lines = _spectra(given, length, inside)
    return tuple(_h1(frequency[inside], lines, _spectra(output, length, inside)) for output in outputs)


def _spectra(signal: Array, length: int, inside: np.ndarray) -> ComplexArray:
    """Return the Fourier lines of each Hann segment less its mean, (n_segments, n_lines)."""
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    starts = range(0, len(signal) - length + 1, length // 2)
    segments = (signal[k : k + length] for k in starts)
    return np.array([np.fft.rfft(window * (part - part.mean()))[inside] for part in segments])


def _h1(frequency: Array, given: ComplexArray, output: ComplexArray) -> Frf:
    """Return H1, coherence and standard error from the segments' lines of input and output."""
    power, cross = np.sum(np.abs(given) ** 2, axis=0), np.sum(np.conj(given) * output, axis=0)
    coherence = np.abs(cross) ** 2 / (power * np.sum(np.abs(output) ** 2, axis=0))
    segments = len(given)
    averages = segments / (1.0 + 2.0 * OVERLAP_CORRELATION * (segments - 1) / segments)
    error = np.sqrt((1.0 - coherence).clip(min=0.0) / (2.0 * coherence * averages)).clip(min=ERROR_FLOOR)
    return Frf(frequency, cross / power, coherence, error, round(averages))


def without_leakage(frf: Frf, model: Model, command_v: Array, table_accel: Array, noise: slice) -> Frf:
    """Return the table's FRF with the leakage taken out that a model's own response has too.

    Segments average a response over neighbouring lines and cut vibrations off at their ends: 1-2 % in the valleys of
    a specimen of 4 % damping, a quarter for 0.5 %. H1 from the model's response to the same command (n,) in V to the
    measured one (n,) in m/s^2 is near 1 and free of that; times the model it is the table's, wrong only by leakage
    times the model's own error.
    """
    f = frf.frequency_hz
    simulated = simulate(model, command_v, 1.2 * float(f[-1]))
    segment_s = 1.0 / (f[1] - f[0])
    over = h1(simulated[noise], table_accel[None, noise], model.dt_s, (f[0], f[-1]), segment_s)[0]
    return replace(over, response=over.response * model.sampled_response(f))


def simulate(model: Model, command_v: Array, high_hz: float) -> Array:
    """Return the table's samples (n,) in m/s^2 that a model gives from rest, for a command (n,) without content
    above `high_hz`."""
    from scipy.fft import next_fast_len

    count = next_fast_len(len(command_v) + round(TAIL_S / model.dt_s), real=True)
    spectrum = np.fft.rfft(command_v, count)
    frequency = np.arange(len(spectrum)) / (count * model.dt_s)
    inside = frequency <= high_hz
    spectrum[inside] *= model.sampled_response(frequency[inside])
    spectrum[~inside] = 0.0
    return np.fft.irfft(spectrum, count)[: len(command_v)]
