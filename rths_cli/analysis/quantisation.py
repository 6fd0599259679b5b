"""The noise spectrum that rounding to a converter's bits adds to a signal.

The error of rounding s to steps q is, up to its sign, the sum over n of q / (pi n) sin(2 pi n s / q). If s crosses many
steps, the n-th term is a wave of frequency n s' / q. Its power q^2 / (2 pi^2 n^2) is distributed over frequency like
the rate s', as a Gauss curve of standard deviation n rms(s') / q (Bennett, Bell System Technical Journal 27, 1948,
446). With slow signals this power stays at low frequencies, in the test band. White noise of the channel spreads the
fraction 1 - exp(-(2 pi n noise / q)^2) of it over all lines; a random motion that is faster than the signal spreads a
fraction of the same form over its own Gauss curve.
"""

from __future__ import annotations

import numpy as np

from rths_cli.numerics.lti import Array

HARMONICS = 8  # terms of the sum
ZERO_HARMONICS = 1000  # the same for a mean; they need no density
WINDOW_S = 1.0  # length of the windows in which a signal's size and rate are determined
WHITE = 3.0  # a Gauss curve counts as white if the sample rate is less than this many standard deviations


def rounding_power(
    frequency_hz: Array, signal: Array, signal_dt_s: float, step: float, noise: float, dt_s: float,
    shaken: tuple[float, float] = (0.0, 0.0),
) -> Array:  # fmt: skip
    """Return, for each line (m,), the variance per sample of white noise with the same power there as the rounding.

    `signal` (n,), sampled every `signal_dt_s`, contains white `noise` (rms per sample) and is rounded to multiples of
    `step` every `dt_s`; all in the same unit. `shaken`: rms of a random motion that the signal lacks, and of its rate
    per s. The rounding error is at most the signal itself.
    """
    if step <= 0.0:
        return np.zeros(len(frequency_hz))
    count = max(round(WINDOW_S / signal_dt_s), 2)
    windows = signal[: max(len(signal) // count, 1) * count].reshape(-1, min(count, len(signal)))
    rate = np.sqrt(np.mean((np.diff(windows, axis=1) / signal_dt_s) ** 2, axis=1))
    lost = np.minimum(12.0 * (np.mean(windows**2, axis=1) + noise**2 + shaken[0] ** 2) / step**2, 1.0)
    found = np.zeros(len(frequency_hz))
    white = step**2 / 12.0
    for n in range(1, HARMONICS + 1):
        power = step**2 / (2.0 * np.pi**2 * n**2)
        left, slow = (
            float(power * np.exp(-((2.0 * np.pi * n / step) ** 2) * size))
            for size in (noise**2, noise**2 + shaken[0] ** 2)
        )
        white -= left
        parts = ((slow, rate), (left - slow, np.hypot(rate, shaken[1])))
        found += sum(part * (lost @ _spread(frequency_hz, n * speed / step, dt_s)) for part, speed in parts) / len(lost)
    return found + white * float(lost.mean())


def _spread(frequency_hz: Array, deviation_hz: Array, dt_s: float) -> Array:
    """Return the density (windows, m) of each Gauss curve over the density of white noise with the same power."""
    deviation = np.maximum(deviation_hz, 1.0 / WINDOW_S)[:, None]
    curve = np.exp(-0.5 * (frequency_hz / deviation) ** 2) / (np.sqrt(2.0 * np.pi) * deviation * dt_s)
    return np.asarray(np.where(deviation * WHITE > 1.0 / dt_s, 1.0, curve))


def zero_error(step: float, at_rest: float) -> float:
    """Return the root mean square error of a channel's zero, the mean of its samples at rest, by their rounding.

    `step` of the converter, and `at_rest`, standard deviation of the samples at rest, in the same unit. A zero may be
    anywhere between two steps. Without noise its error is anything up to half a step; noise of a step makes it nothing.
    Rounding by itself may show half a step of `at_rest` (between two steps), which is not counted as noise. Each term
    of the module's sum keeps exp(-2 (pi n noise / q)^2) of its amplitude in the mean.
    """
    if step <= 0.0:
        return 0.0
    noise = max(at_rest**2 - 0.25 * step**2, 0.0)
    n = np.arange(1, ZERO_HARMONICS + 1)
    power = step**2 / (2.0 * np.pi**2 * n**2) * np.exp(-((2.0 * np.pi * n / step) ** 2) * noise)
    return float(np.sqrt(power.sum()))
