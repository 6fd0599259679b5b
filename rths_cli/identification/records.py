"""What an identification is made from: a command, the accelerations it caused, and which samples are what."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.filters import fast_length
from rths_cli.numerics.lti import Array, ComplexArray

TAIL_S = 30.0  # rest appended to a command, in which a table's response dies out


@dataclass(frozen=True)
class Parts:
    """Which samples of a record are excitation, silence and free vibration (command held); None: the record has none.

    `noise` names the excitation whatever its kind. `period_samples`: the excitation repeats after so many samples
    (0: it does not, or not so that whole periods should be evaluated). `segment_samples`: length of the Hann segments
    that suit it (0: any).
    """

    noise: slice
    silence: slice | None = None
    free_vibration: slice | None = None
    period_samples: int = 0
    segment_samples: int = 0


@dataclass(frozen=True)
class PaddedLines:
    """Fourier lines (count // 2 + 1,) of a signal with rest at its end, of `count` samples in all."""

    values: ComplexArray
    count: int
    dt_s: float


def padded(samples: int, dt_s: float) -> int:
    """Return how many samples a signal has with rest at its end, a length that transforms fast."""
    return fast_length(samples + round(TAIL_S / dt_s))


@dataclass(frozen=True)
class Record:
    """Command (n,) in V as it left, accelerations (c, n) in m/s^2 of table and floors, and the parts of the record."""

    command_v: Array
    accel_m_s2: Array
    parts: Parts
    _lines: dict[int, ComplexArray] = field(default_factory=dict, init=False, repr=False, compare=False)

    def command_lines(self, count: int, dt_s: float) -> PaddedLines:
        """Return the Fourier lines of the command with rest up to so many samples; they are computed once."""
        if count not in self._lines:
            self._lines[count] = np.fft.rfft(self.command_v, count)
        return PaddedLines(self._lines[count], count, dt_s)

    def excited_in(self, noise: slice) -> Record:
        """Return the same record with another part of it as its excitation; what is computed stays known."""
        other = replace(self, parts=replace(self.parts, noise=noise))
        other._lines.update(self._lines)
        return other


BLOCK_S = 0.1
STILL = 1e-3  # of the command's standard deviation: a block that moves less is at rest
LEAST_REST_S = 0.4  # a shorter one is part of the excitation
LEAST_SILENCE_S, LEAST_FREE_S, LEAST_EXCITED_S = 1.0, 5.0, 10.0
SHORTEST_PERIOD_S = 2.0
AROUND = 16  # samples
SWEEP_SEGMENTS, SWEEPING = 10, 1.0  # pieces of a period; scatter of the logarithm of their mean frequencies
SAME = 1e-3  # of the command's standard deviation, between one period and the next


def find_parts(command_v: Array, dt_s: float, name: str = "record") -> Parts:
    """Return which samples of a command (n,) in V are what.

    Excitation: the longest moving stretch, cut to whole periods where it repeats; silence: rest of a second or more
    before any motion; free vibration: the longest rest of five seconds or more after motion.
    Raises InputError when nothing moves for ten seconds.
    """
    moves = _moving(command_v, dt_s)
    stretches = _stretches(moves)
    loud = [s for s in stretches if moves[s.start]]
    if not loud or ((longest := max(loud, key=_length)) and _length(longest) * dt_s < LEAST_EXCITED_S):
        raise InputError(
            f"{name}: the command does not move for {LEAST_EXCITED_S:g} s on end; an identification needs a longer "
            "excitation, or the command is another channel"
        )
    before = [s for s in stretches if s.stop <= loud[0].start and _length(s) * dt_s >= LEAST_SILENCE_S]
    after = [s for s in stretches if s.start >= loud[0].stop and not moves[s.start]]
    free = max(after, key=_length, default=None)
    segment = 0
    whole = slice(loud[0].start, loud[-1].stop)  # a sweep rests where its command is less than a bit
    period = find_period(command_v[whole], dt_s)
    part, period = (whole, period) if period else (longest, find_period(command_v[longest], dt_s))
    if period:
        longest = _steady(command_v, part, period)
        if sweeps(command_v[longest][:period]):
            period, segment = 0, period // SWEEP_SEGMENTS
    return Parts(
        longest,
        before[0] if before else None,
        free if free is not None and _length(free) * dt_s >= LEAST_FREE_S else None,
        period,
        segment,
    )


def _length(part: slice) -> int:
    return int(part.stop - part.start)


def _moving(command_v: Array, dt_s: float) -> np.ndarray:
    """Tell for each sample whether its block of 0.1 s moves, short rests filled in."""
    block = max(round(BLOCK_S / dt_s), 2)
    count = -(-len(command_v) // block)
    padded = np.concatenate([command_v, np.full(count * block - len(command_v), command_v[-1])]).reshape(count, block)
    moving = np.ptp(padded, axis=1) > STILL * float(command_v.std())
    least = round(LEAST_REST_S / BLOCK_S)
    for rest in _stretches(moving):
        if not moving[rest.start] and _length(rest) < least and rest.start > 0 and rest.stop < count:
            moving[rest] = True
    return np.repeat(moving, block)[: len(command_v)]


def _stretches(flags: np.ndarray) -> list[slice]:
    """Return the stretches over which flags (n,) keep their value."""
    edges = [0, *(np.flatnonzero(np.diff(flags)) + 1).tolist(), len(flags)]
    return [slice(a, b) for a, b in pairwise(edges) if b > a]


def find_period(command_v: Array, dt_s: float) -> int:
    """Return after how many samples a command (n,) repeats, at least three times; 0 when it does not."""
    n = len(command_v)
    signal = command_v - command_v.mean()
    power = np.abs(np.fft.rfft(signal, 2 * n)) ** 2
    together = np.fft.irfft(power)[:n]
    energy = np.concatenate([[0.0], np.cumsum(signal**2)])
    lags = np.arange(n)
    overlap = np.sqrt(energy[n - lags] * (energy[n] - energy[lags])) + 1e-300
    shortest, longest = round(SHORTEST_PERIOD_S / dt_s), n // 3
    if longest <= shortest:
        return 0
    likeness = (together / overlap)[shortest : longest + 1]
    near = shortest + int(np.argmax(likeness))  # faded ends and a burst push it off the true lag a little
    around = range(max(near - AROUND, shortest), min(near + AROUND, longest) + 1)
    lag = min(around, key=lambda candidate: _apart(signal, candidate, AROUND))
    return lag if _apart(signal, lag, 1) < SAME * float(signal.std()) else 0


def _apart(signal: Array, lag: int, stride: int) -> float:
    """Return how much a signal (n,) differs from itself a lag later, the median over every so many samples.

    The median, because faded ends and a burst do not repeat.
    """
    return float(np.median(np.abs(signal[lag::stride] - signal[: len(signal) - lag : stride])))


def sweeps(period: Array) -> bool:
    """Tell whether a period (n,) of a command goes through its frequencies one after the other.

    Then its tenths have mean frequencies that differ much: their logarithms scatter by 1.5 and more, those of noise by
    less than 0.5. Of a derivative they would be those of the converter's bits.
    """
    means = []
    for piece in np.array_split(period - period.mean(), SWEEP_SEGMENTS):
        power = np.abs(np.fft.rfft(np.hanning(len(piece)) * piece)) ** 2
        means.append(float(np.sum(np.arange(len(power)) * power) / np.sum(power)))
    return float(np.std(np.log(means))) > SWEEPING


def _steady(command_v: Array, part: slice, period: int) -> slice:
    """Return the whole periods at the end of a stretch in which the command repeats, its fade-out cut off.

    At least half a period before them is left to the transient.
    """
    signal = command_v[part]
    apart = np.abs(signal[period:] - signal[:-period]) < 10.0 * SAME * float(signal.std())
    longest = max((s for s in _stretches(apart) if apart[s.start]), key=_length, default=slice(0, 0))
    end = part.start + longest.stop + period  # so far the command repeats
    count = (end - part.start - longest.start - period // 2) // period
    return slice(end - count * period, end)
