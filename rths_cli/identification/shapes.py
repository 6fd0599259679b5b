"""Signals an excitation is made of: shaped noise, multisine, logarithmic sweep, smoothed steps; all without unit.

They share one amplitude over frequency: flat to 0.7 Hz, falling as f^-1.5 to 12 Hz and as f^-3.5 above, which keeps
the acceleration even over the band without taking the stroke at its low end.
"""

from __future__ import annotations

import numpy as np

from rths_cli.lti import Array

FLAT_HZ, CORNER_HZ = 0.7, 12.0  # the amplitude is flat below the first, falls as f^-1.5, above the second as f^-3.5
LEAST_HOLD_S, MOST_HOLD_S = 1.0, 4.0
ROUNDING = 40
LEAST_LEVEL = 0.5  # of a held level, of at most 1


def amplitude(frequency_hz: Array) -> Array:
    """Return the amplitude (n,) without unit that all signals follow over frequencies (n,) in Hz."""
    return np.maximum(frequency_hz / FLAT_HZ, 1.0) ** -1.5 * np.maximum(frequency_hz / CORNER_HZ, 1.0) ** -2


def shaped_noise(duration_s: float, dt_s: float, low_hz: float, high_hz: float, random: np.random.Generator) -> Array:
    """Return Gaussian noise (n,) without unit: flat to 0.7 Hz, falling as f^-1.5 to 12 Hz and as f^-3.5 above."""
    n = round(duration_s / dt_s)
    shape = _lines(n, dt_s, low_hz, high_hz)
    spectrum = shape * (random.standard_normal(len(shape)) + 1j * random.standard_normal(len(shape)))
    return np.fft.irfft(spectrum, n)


def multisine(period_s: float, dt_s: float, low_hz: float, high_hz: float, random: np.random.Generator) -> Array:
    """Return one period (n,) without unit of a random-phase multisine with every line of 1/period_s in the band.

    Pintelon and Schoukens, System Identification: A Frequency Domain Approach, section 2.2.
    """
    n = round(period_s / dt_s)
    shape = _lines(n, dt_s, low_hz, high_hz)
    return np.fft.irfft(shape * np.exp(2j * np.pi * random.random(len(shape))), n)


def sweep(period_s: float, dt_s: float, low_hz: float, high_hz: float) -> Array:
    """Return one period (n,) without unit of a logarithmic sine sweep: up in its first half, down in its second.

    A period holds a whole number of cycles: the frequencies are lowered by less than one cycle per period. The
    amplitude is that of the instantaneous frequency, its kinks rounded over 1/40 of a period so that they leave no
    spikes in the acceleration. Lines above `high_hz` and the mean are taken out.
    """
    n = round(period_s / dt_s)
    frequency = sweep_frequency(n, low_hz, high_hz)
    cycles = (np.cumsum(frequency) - frequency) * dt_s
    total = float(np.sum(frequency)) * dt_s
    phase = 2.0 * np.pi * cycles * np.floor(total) / total
    lines = np.fft.rfft(np.exp(_rounded_off(np.log(amplitude(frequency)))) * np.sin(phase))
    lines[(_frequencies(n, dt_s) > high_hz) | (np.arange(len(lines)) == 0)] = 0.0
    return np.fft.irfft(lines, n)


def _rounded_off(cyclic: Array) -> Array:
    """Return one period (n,) averaged around each sample by a Hann window of 1/40 of the period."""
    n = len(cyclic)
    away = np.minimum(np.arange(n), n - np.arange(n)) * 2.0 * ROUNDING / n
    window = np.where(away < 1.0, 1.0 + np.cos(np.pi * away), 0.0)
    return np.fft.irfft(np.fft.rfft(cyclic) * np.fft.rfft(window / window.sum()), n)


def sweep_frequency(samples: int, low_hz: float, high_hz: float) -> Array:
    """Return the instantaneous frequency (n,) in Hz of one period of the sweep, before its cycles are made whole."""
    way = 1.0 - np.abs(1.0 - 2.0 * np.arange(samples) / samples)
    return low_hz * (high_hz / low_hz) ** way


def steps(duration_s: float, dt_s: float, high_hz: float, random: np.random.Generator) -> Array:
    """Return smoothed steps (n,) without unit between levels of alternating sign and random size, held for 1-4 s.

    The smoothing (without phase) is flat to 0.7 Hz, falls as f^-0.5 to 12 Hz, as f^-2.5 above and is zero above
    `high_hz`. With the 1/f of a step that is the shape of the noise, and a step of height h m has at most
    h 4 pi integral(f H(f) df) m/s^2: 774 h for 60 Hz.
    """
    n = round(duration_s / dt_s)
    count = int(np.ceil(duration_s / LEAST_HOLD_S)) + 1
    ends = np.cumsum(random.uniform(LEAST_HOLD_S, MOST_HOLD_S, count))
    levels = random.uniform(LEAST_LEVEL, 1.0, count) * (-1.0) ** np.arange(count)
    held = levels[np.searchsorted(ends, np.arange(n) * dt_s, side="right")]
    return np.fft.irfft(np.fft.rfft(held) * smoothing(_frequencies(n, dt_s), high_hz), n)


def smoothing(frequency_hz: Array, high_hz: float) -> Array:
    """Return the factor (n,) without unit by which steps are smoothed at frequencies (n,) in Hz."""
    factor = np.maximum(frequency_hz / FLAT_HZ, 1.0) ** -0.5 * np.maximum(frequency_hz / CORNER_HZ, 1.0) ** -2
    return np.where(frequency_hz <= high_hz, factor, 0.0)


def faded(signal: Array, fade_s: float, dt_s: float) -> Array:
    """Return the signal (n,) with raised-cosine ends, so that it starts and ends at zero with zero slope."""
    n = round(fade_s / dt_s)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / n)
    return signal * np.concatenate([rise, np.ones(len(signal) - 2 * n), rise[::-1]])


def repeated(period: Array, periods: int, fade_s: float, dt_s: float) -> Array:
    """Return a period (n,) as one that fades in, so many steady ones, and the beginning of one that fades out."""
    return faded(np.concatenate([np.tile(period, periods + 1), period[: round(fade_s / dt_s)]]), fade_s, dt_s)


def _lines(samples: int, dt_s: float, low_hz: float, high_hz: float) -> Array:
    """Return the amplitude of every Fourier line (n,), zero outside the band."""
    f = _frequencies(samples, dt_s)
    inside = (f >= low_hz) & (f <= high_hz)
    shape = np.zeros(len(f))
    shape[inside] = amplitude(f[inside])
    return shape


def _frequencies(samples: int, dt_s: float) -> Array:
    """Return the frequencies (n,) in Hz of the Fourier lines of so many samples."""
    return np.asarray(np.fft.rfftfreq(samples, dt_s), dtype=float)
