"""One measured record (`Record`: command and accelerations), and which samples are excitation, silence, free
vibration."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, ComplexArray

TAIL_S = 30.0  # rest appended to a command, in which the table's response decays


@dataclass(frozen=True)
class Parts:
    """The parts of a record, as slices of its samples; None: the record has no such part."""

    noise: slice  # the excitation, of whatever kind
    silence: slice | None = None
    free_vibration: slice | None = None  # with the command held
    period_samples: int = 0  # period of an excitation that is evaluated in whole periods; 0: it is not
    segment_samples: int = 0  # length of the Hann segments that suit the excitation; 0: any


@dataclass(frozen=True)
class PaddedLines:
    """Fourier lines (count // 2 + 1,) of a signal padded with rest to `count` samples."""

    values: ComplexArray
    count: int
    dt_s: float


def padded(samples: int, dt_s: float) -> int:
    """Return the number of samples of a signal padded with rest, chosen for a fast Fourier transform."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(samples + round(TAIL_S / dt_s), real=True))


@dataclass(frozen=True)
class Record:
    """Command (n,) in V as sent, accelerations (c, n) in m/s^2 of table and floors, and the parts of the record."""

    command_v: Array
    accel_m_s2: Array
    parts: Parts
    further: Array | None = None  # (f, n) the channels beside the accelerometers, each in its unit; None: not recorded
    _lines: dict[int, ComplexArray] = field(default_factory=dict, init=False, repr=False, compare=False)

    def command_lines(self, count: int, dt_s: float) -> PaddedLines:
        """Return the Fourier lines of the command padded to `count` samples; they are computed once."""
        if count not in self._lines:
            self._lines[count] = np.fft.rfft(self.command_v, count)
        return PaddedLines(self._lines[count], count, dt_s)

    def excited_in(self, noise: slice) -> Record:
        """Return the same record with another part as its excitation; Fourier lines already computed are shared."""
        other = replace(self, parts=replace(self.parts, noise=noise))
        other._lines.update(self._lines)
        return other


BLOCK_S = 0.1
STILL = 1e-3  # a block whose range is below this fraction of the command's standard deviation is at rest
LEAST_REST_S = 0.4  # a shorter rest is part of the excitation
LEAST_SILENCE_S, LEAST_FREE_S, LEAST_EXCITED_S = 1.0, 5.0, 10.0
SHORTEST_PERIOD_S = 2.0
AROUND = 16  # samples around the estimated period that are searched
SWEEP_SEGMENTS, SWEEPING = 10, 1.0  # pieces of a period; scatter of their mean frequencies' logarithm in a sweep
SAME = 1e-3  # largest difference of two periods over the command's standard deviation


def find_parts(command_v: Array, dt_s: float, name: str = "record") -> Parts:
    """Find the parts of a record from its command (n,) in V.

    The excitation is the longest moving stretch, cut to whole periods if it repeats. The silence is a rest of a second
    or more before any motion. The free vibration is the longest rest of five seconds or more after motion.
    Raises InputError if no motion lasts ten seconds.
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
    """Return for each sample whether its block of 0.1 s moves; short rests within a motion count as moving."""
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
    """Return the median difference between a signal (n,) and itself one lag later, over every `stride`-th sample.

    It is the median because faded ends and a burst do not repeat.
    """
    return float(np.median(np.abs(signal[lag::stride] - signal[: len(signal) - lag : stride])))


def sweeps(period: Array) -> bool:
    """Return whether a period (n,) of a command is a sweep.

    In a sweep the tenths of a period have very different mean frequencies: the standard deviation of their logarithms
    is 1.5 and more, for noise it is less than 0.5. The command itself is used, because its derivative would show the
    converter's bits.
    """
    means = []
    for piece in np.array_split(period - period.mean(), SWEEP_SEGMENTS):
        power = np.abs(np.fft.rfft(np.hanning(len(piece)) * piece)) ** 2
        means.append(float(np.sum(np.arange(len(power)) * power) / np.sum(power)))
    return float(np.std(np.log(means))) > SWEEPING


def _steady(command_v: Array, part: slice, period: int) -> slice:
    """Return the last whole periods of a stretch in which the command repeats, without its fade-out.

    At least half a period before them is left out, for the transient to decay.
    """
    signal = command_v[part]
    apart = np.abs(signal[period:] - signal[:-period]) < 10.0 * SAME * float(signal.std())
    longest = max((s for s in _stretches(apart) if apart[s.start]), key=_length, default=slice(0, 0))
    end = part.start + longest.stop + period  # so far the command repeats
    count = (end - part.start - longest.start - period // 2) // period
    return slice(end - count * period, end)
