"""Change a motion so that its response spectrum follows a target, by the least motion that does so.

Each step adds a sum of reversed impulse responses of the oscillators, each ending at a peak of its response
(Lilhanand and Tseng, 9WCEE, 1988), held within the band of the periods and under the envelope of the record. Every
peak near the largest one is watched, so that none exceeds the target while another is lowered.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rths_cli.analysis.code_spectra import compared_periods
from rths_cli.analysis.intensity import displacement_history
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

PER_DECADE = 80  # periods that are matched
LEAST_SAMPLES = 10  # of the matched motion in the shortest period
MOST_VALUES = 20_000_000  # samples times periods: 160 MB in each of a few arrays
MOST_STEPS, PATIENCE = 30, 6  # steps in all, and those that may pass without a better one
CLOSE_ENOUGH = 0.03  # largest relative misfit at which the steps end
NEAR_PEAK = 0.85  # of the largest response of an oscillator, above which a peak is watched
LARGEST_CHANGE = 0.5  # of a target, that one step asks of a peak
RIDGE = 1e-3  # of the mean diagonal of the normal equations
LEAST_ENVELOPE = 0.05  # of its largest value
BEYOND = 2.0  # the band of what is added reaches this much beyond the periods
PASSES = 8  # over the choice of the peaks that a step must hold


@dataclass(frozen=True)
class Matched:
    """A matched acceleration (n,) in m/s^2 that ends without velocity, its interval, and the steps that led to it."""

    accel_m_s2: Array
    dt_s: float
    steps: int


def matched(
    accel_m_s2: Array,
    dt_s: float,
    ends_s: tuple[float, float],
    target: Callable[[Array], Array],
    damping_ratio: float,
) -> Matched:
    """Return an acceleration (n,) changed so that its pseudo-acceleration between two periods is that of `target`.

    `target` returns the pseudo-acceleration in m/s^2 at periods (p,) in s. The motion is sampled at least 10 times in
    the shortest period, on the straight lines between its samples. Raises InputError for a motion that is shorter than
    the longest period, or too long for the number of periods.
    """
    parts = max(1, int(np.ceil(LEAST_SAMPLES * dt_s / ends_s[0] - 1e-9)))
    count, dt_s = (accel_m_s2.size - 1) * parts + 1, dt_s / parts
    periods = compared_periods(*ends_s, PER_DECADE)
    if (count - 1) * dt_s < ends_s[1] or count * periods.size > MOST_VALUES:
        length = "shorter than the longest of its periods" if (count - 1) * dt_s < ends_s[1] else "too long"
        raise InputError(
            f"record.scale_to: a record of {(count - 1) * dt_s:g} s is {length} for a match from {ends_s[0]:g} to "
            f"{ends_s[1]:g} s; narrow period_s, or give another record"
        )
    accel = np.interp(np.arange(count) / parts, np.arange(accel_m_s2.size), accel_m_s2)
    displacement = target(periods) * (periods / (2.0 * np.pi)) ** 2
    added = _Added(accel, dt_s, ends_s)
    now = added.at_rest(accel)
    best, least, since = Matched(now, dt_s, 0), np.inf, 0
    for step in range(MOST_STEPS):
        rows, left, largest = _watched(now, dt_s, periods, displacement, damping_ratio)
        misfit = float(np.abs(left[largest]).max())
        since += 1
        if misfit < least:
            best, least, since = Matched(now, dt_s, step), misfit, 0
        if least <= CLOSE_ENOUGH or since >= PATIENCE:
            break
        now = now + added.least(rows, np.clip(left, -LARGEST_CHANGE, LARGEST_CHANGE), largest)
    return best


def _watched(
    accel: Array, dt_s: float, periods: Array, target_m: Array, damping_ratio: float
) -> tuple[Array, Array, np.ndarray]:
    """Return of each watched peak what each sample (n,) of the acceleration adds to it, (m, n), what is left of it to
    its target, (m,), both over the target, and whether it is the largest of its oscillator, (m,)."""
    time_s = dt_s * np.arange(accel.size)
    rows, left, largest = [], [], []
    for period, wanted in zip(periods, target_m, strict=True):
        omega = 2.0 * np.pi / period
        damped = omega * np.sqrt(1.0 - damping_ratio**2)
        moved, step_s = displacement_history(accel, dt_s, omega, damping_ratio)
        size = np.abs(moved)
        inner = size[1:-1]
        turning = (inner >= size[:-2]) & (inner > size[2:]) & (inner >= NEAR_PEAK * size.max())
        top = int(size.argmax())
        for place in {top, *(np.flatnonzero(turning) + 1).tolist()}:
            ago = np.maximum(place * step_s - time_s, 0.0)
            response = np.exp(-damping_ratio * omega * ago) * np.sin(damped * ago)
            rows.append(-np.sign(moved[place]) * dt_s / (damped * wanted) * response)
            left.append(1.0 - size[place] / wanted)
            largest.append(place == top)
    return np.array(rows), np.array(left), np.array(largest)


class _Added:
    """The motion that may be added to a record: within the band, under its envelope, at rest before and after."""

    def __init__(self, accel: Array, dt_s: float, ends_s: tuple[float, float]) -> None:
        from scipy.fft import next_fast_len, rfftfreq
        from scipy.ndimage import gaussian_filter1d

        samples, low_hz = accel.size, 1.0 / (BEYOND * ends_s[1])
        envelope = np.sqrt(gaussian_filter1d(accel**2, 0.5 * ends_s[1] / dt_s, mode="constant"))
        rising = np.clip(2.0 * dt_s / ends_s[1] * np.arange(samples), 0.0, 1.0)
        window = 0.5 * (1.0 - np.cos(np.pi * np.minimum(rising, rising[::-1])))
        self._envelope = window * np.maximum(envelope / envelope.max(), LEAST_ENVELOPE)
        self._length = next_fast_len(samples + int(3.0 / (low_hz * dt_s)), real=True)
        frequency = np.maximum(rfftfreq(self._length, dt_s), 1e-9)
        self._gain = 1.0 / ((1.0 + (low_hz / frequency) ** 4) * (1.0 + (frequency * ends_s[0] / BEYOND) ** 4))
        bell = np.sin(np.pi * np.arange(samples) / (samples - 1)) ** 2
        self._shapes = np.array([bell, bell * np.linspace(-1.0, 1.0, samples)])  # that bring it to rest
        time_left = dt_s * np.arange(samples)[::-1]
        self._end = dt_s * np.array([np.ones(samples), time_left])  # final velocity and displacement of each sample
        self._end[:, 0] *= 0.5
        self._end[:, -1] *= 0.5
        self._end[1, 0] -= dt_s**2 / 6.0
        self._end[1, -1] += dt_s**2 / 6.0
        self._mix = np.linalg.inv(self._end @ self._shapes.T)

    def at_rest(self, accel: Array) -> Array:
        """Return a motion (n,) whose velocity is zero at its end, by a smooth one over its whole length."""
        bell = self._shapes[0]
        return np.asarray(accel - bell * (self._end[0] @ accel) / (self._end[0] @ bell))

    def least(self, rows: Array, left: Array, largest: np.ndarray) -> Array:
        """Return the smallest motion (n,) that adds what is `left` (m,) to the largest peaks and lets no other exceed
        its target; `rows` (m, n) is what each sample adds to each."""
        held = rows - (rows @ self._shapes.T) @ self._mix.T @ self._end
        shaped = self._in_band(self._envelope * held)
        normal = shaped @ shaped.T
        ridge = RIDGE * np.trace(normal) / len(normal)
        chosen = largest.copy()
        for _ in range(PASSES):
            among = normal[np.ix_(chosen, chosen)] + ridge * np.eye(int(chosen.sum()))
            weights = np.zeros(len(left))
            weights[chosen] = np.linalg.solve(among, left[chosen])
            exceeding = ~chosen & (left - normal @ weights < 0.0)
            pulled_up = chosen & ~largest & (weights > 0.0)
            if not (exceeding | pulled_up).any():
                break
            chosen = (chosen | exceeding) & ~pulled_up
        motion = self._envelope * self._in_band(weights @ shaped)
        return np.asarray(motion - self._shapes.T @ (self._mix @ (self._end @ motion)))

    def _in_band(self, motion: Array) -> Array:
        from scipy.fft import irfft, rfft

        whole = irfft(rfft(motion, self._length) * self._gain, self._length)
        return np.asarray(whole[..., : motion.shape[-1]])
