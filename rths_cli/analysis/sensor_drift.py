"""Detect offset, drift and jumps of accelerometer channels after a run.

A channel behind an AC coupling of corner w shows y = s / (s + w) a + o + r t + jumps, because offset, drift and jumps
of amplifier and converter are added after the coupling. The step corrects the coupling, a = (1 + w / s) y. This turns
an offset into a line, o (1 + w t), a drift into a parabola, r (t + w t^2 / 2), and a jump into a jump and a line. Here
the response of the identified rig to the commands that were sent is subtracted first, and the coupling is applied
again. The remainder is o + r t + jumps, the model's error, noise and rounding. The run begins and ends at rest, so that
motion adds nothing to a straight line through all of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.numerics.lti import Array

BLOCK_S = 0.01  # length of the block means that are used for everything except the date of a jump
LEVEL_S = 2.5  # length of the windows before and after a jump in which the levels are determined
SURE = 8.0  # least size of a jump, in standard deviations of the levels' changes
BITS = 3.0  # least size of a jump, in bits of the converter
FIRM = 3.0  # an offset or drift above this many standard uncertainties is removed
OTHERS = 0.35  # if all other channels show at least this fraction of a jump at the same time, it is motion
NEAR_S = 0.5  # time around the largest change of level in which the edge of a jump is searched
EDGE_S, EDGE_SAMPLES = 0.012, 8  # time, and least number of samples, on each side of an edge
EDGE_SHARE = 0.5  # least fraction of a jump that its edge must show; otherwise the jump has no date
MOST_JUMPS = 6  # a channel with this many jumps is not usable from the first one on
UNCERTAIN_S = 2.0  # length of the means of the residual that count as independent


@dataclass(frozen=True)
class Jump:
    """A jump of a channel by `size` m/s^2 at sample `at`."""

    at: int
    size: float


@dataclass(frozen=True)
class ChannelDrift:
    """Offset, drift and jumps of one channel; uncertainties are standard uncertainties."""

    middle: float  # sample at which the offset is stated
    offset: float  # m/s^2
    rate: float  # drift in m/s^2 per s
    offset_uncertainty: float  # m/s^2
    rate_uncertainty: float  # m/s^2 per s
    jumps: tuple[Jump, ...] = ()
    unusable_from: int | None = None  # sample from which on none of these explains the channel

    @property
    def drifts(self) -> bool:
        """Return whether offset or drift exceeds FIRM times its uncertainty."""
        return abs(self.offset) > FIRM * self.offset_uncertainty or abs(self.rate) > FIRM * self.rate_uncertainty

    def shown(self, samples: int, dt_s: float) -> Array:
        """Return the sum of offset, drift and jumps (n,) in m/s^2, as behind the AC coupling."""
        k = np.arange(samples)
        series = self.offset + self.rate * dt_s * (k - self.middle)
        for jump in self.jumps:
            series[jump.at :] += jump.size
        return np.asarray(series)


def coupled_again(corrected: Array, corner_hz: Sequence[float], dt_s: float) -> Array:
    """Return corrected accelerations (c, n) with the AC couplings of these corners (0: none) applied again."""
    from scipy.signal import lfilter

    halves = [np.pi * corner * dt_s for corner in corner_hz]
    rows = [lfilter([1.0, -1.0], [1.0 + h, h - 1.0], row) for h, row in zip(halves, corrected, strict=True)]
    return np.array(rows)


def channel_drifts(left: Array, dt_s: float, bit_m_s2: Sequence[float] | Array) -> tuple[ChannelDrift, ...]:
    """Return offset, drift and jumps of every channel.

    `left` (c, n) in m/s^2: the channels, with their AC coupling, minus the predicted motion, from rest to rest.
    `bit_m_s2` (c,): one bit of their converters.
    """
    size = max(round(BLOCK_S / dt_s), 1)
    count = left.shape[1] // size
    blocks = left[:, : count * size].reshape(len(left), count, size).mean(axis=2)
    return tuple(
        _drift(left[i], blocks[i], _jumps(blocks, i, size * dt_s, bit), size, dt_s, bit)
        for i, bit in enumerate(bit_m_s2)
    )


def _drift(series: Array, blocks: Array, places: list[int], size: int, dt_s: float, bit: float) -> ChannelDrift:
    """Return the drift of one channel; its jumps near the blocks `places` are dated to the sample."""
    found = [_edge(series, near * size, dt_s, jump, before) for near, jump, before in _levels(blocks, places, size)]
    lost = [place * size for place, at in zip(places, found, strict=True) if at is None]
    dated = sorted({at for at in found if at is not None})  # two may be dated to one sample
    if lost or len(places) >= MOST_JUMPS:
        first = max(min(lost, default=min(places) * size) - round(NEAR_S / dt_s), 0)
        dated = [at for at in dated if at < first]
        blocks = blocks[: max(first // size, 2)]
        return replace(_fitted(blocks, dated, size, dt_s, bit), unusable_from=first)
    return _fitted(blocks, dated, size, dt_s, bit)


def _fitted(blocks: Array, jumps: list[int], size: int, dt_s: float, bit: float) -> ChannelDrift:
    """Return the least-squares line and jumps at known samples through block means."""
    middle = 0.5 * (len(blocks) * size - 1)
    rows = _rows(len(blocks), [(at + 0.5) / size for at in jumps])
    found = np.linalg.lstsq(rows.T, blocks, rcond=None)[0]
    wide = max(round(UNCERTAIN_S / (size * dt_s)), 1)
    means = [part.mean() for part in np.array_split(blocks - found @ rows, max(len(blocks) // wide, 1))]
    noise = max(float(np.std(means)), bit / np.sqrt(12.0))
    spread = noise * np.sqrt(np.diag(np.linalg.inv(rows @ rows.T)) * wide)
    seconds = 0.5 * len(blocks) * size * dt_s  # time in which the row of the drift grows by one
    return ChannelDrift(
        middle, float(found[0]), float(found[1]) / seconds, float(spread[0]), float(spread[1]) / seconds,
        tuple(Jump(at, float(by)) for at, by in zip(jumps, found[2:], strict=True)),
    )  # fmt: skip


def _rows(count: int, jumps: Sequence[float]) -> Array:
    """Return the rows (k, count) fitted to block means: a constant, a line from -1 to 1, and a step for each jump."""
    k = np.arange(count)
    steps = [np.clip(k + 1.0 - at, 0.0, 1.0) for at in jumps]
    return np.array([np.ones(count), (k - 0.5 * (count - 1)) * (2.0 / count), *steps])


def _sizes(blocks: Array, places: Sequence[float]) -> Array:
    """Return the sizes of jumps at blocks of a channel, fitted together with its line."""
    rows = _rows(blocks.shape[-1], places)
    return np.asarray(np.linalg.lstsq(rows.T, blocks.T, rcond=None)[0][2:].T, dtype=float)


def _jumps(blocks: Array, channel: int, dt_s: float, bit: float) -> list[int]:
    """Return the blocks in which one of several channels (c, n) jumps while the others do not."""
    found: list[int] = []
    refused = np.zeros(blocks.shape[1], dtype=bool)
    width = round(LEVEL_S / dt_s)
    while len(found) < MOST_JUMPS:
        rows = _rows(blocks.shape[1], found)
        left = blocks - np.linalg.lstsq(rows.T, blocks.T, rcond=None)[0].T @ rows
        changes = np.array([_changes(series, width) for series in left])
        change = np.where(refused, 0.0, changes[channel])
        place = int(np.argmax(np.abs(change)))
        size = _sizes(blocks[channel], [*found, place])[-1]
        rows = _rows(blocks.shape[1], [*found, place])
        calm = _changes(blocks[channel] - _told(blocks[channel], rows), width)
        usual = 1.4826 * float(np.median(np.abs(calm)))
        if abs(change[place]) <= max(SURE * usual, BITS * bit) or abs(size) < BITS * bit:
            return found
        shared = np.delete(changes[:, place], channel) / change[place]
        if shared.size and shared.min() > OTHERS:
            refused[max(place - width, 0) : place + width] = True
            continue
        found.append(place)
    return found


def _told(series: Array, rows: Array) -> Array:
    return np.asarray(np.linalg.lstsq(rows.T, series, rcond=None)[0] @ rows)


def _changes(series: Array, width: int) -> Array:
    """Return the change of level (n,) of a series (n,) at each place: the mean after it minus the mean before it.

    The means have Hann windows, which suppress oscillations. The change is zero within a window of either end.
    """
    window = np.hanning(width + 2)[1:-1]
    window /= window.sum()
    change = np.zeros(series.size)
    if series.size <= 2 * width:
        return change
    level = np.convolve(series, window, "valid")  # of the `width` values from each place on
    change[width : series.size - width + 1] = level[width:] - level[: level.size - width]
    return change


def _levels(blocks: Array, places: list[int], size: int) -> list[tuple[int, float, Array]]:
    """Return for each jump its block, its size, and the line before it (value at sample 0, slope per sample)."""
    rows = _rows(len(blocks), places)
    found = np.linalg.lstsq(rows.T, blocks, rcond=None)[0]
    steps = dict(zip(places, found[2:], strict=True))
    slope = found[1] * 2.0 / (len(blocks) * size)
    begins = found[0] - slope * 0.5 * (len(blocks) * size - 1)
    earlier = [sum(by for at, by in steps.items() if at < place) for place in places]
    return [
        (place, float(steps[place]), np.array([begins + level, slope]))
        for place, level in zip(places, earlier, strict=True)
    ]


def _edge(series: Array, near: int, dt_s: float, size: float, before: Array) -> int | None:
    """Return the sample at which a jump of known size begins, near the sample `near`; None without a visible edge.

    Among all edges that are large enough, it is the one that best divides the series (n,) into the line `before` (value
    at sample 0 and slope) and the same line plus the jump.
    """
    half = max(round(EDGE_S / dt_s), EDGE_SAMPLES)
    start = max(near - round(NEAR_S / dt_s), half)
    stop = min(near + round(NEAR_S / dt_s), series.size - half)
    if stop <= start:
        return None
    edges = np.convolve(series[start - half : stop + half], _edge_kernel(half)[::-1], "valid")[: stop - start]
    k = np.arange(start, stop)
    above = (series[start:stop] - before[0] - before[1] * k) / size - 0.5
    likely = np.cumsum(above[::-1])[::-1]
    likely[edges / size < EDGE_SHARE] = -np.inf
    best = int(np.argmax(likely))
    return start + best if np.isfinite(likely[best]) else None


def _edge_kernel(half: int) -> Array:
    """Return the weights (2 half,) that estimate a jump between both halves of a window, in addition to a parabola."""
    k = (np.arange(2 * half) - half + 0.5) / half
    rows = np.array([k >= 0.0, np.ones(2 * half), k, k**2])
    return np.asarray(np.linalg.pinv(rows.T)[0])
