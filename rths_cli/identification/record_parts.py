"""One measured record: which samples are excitation, silence, free vibration; lost ones reconstructed.

Each channel is predicted from its own past and from the command, by an ARX model fitted by least squares to all rows
without a missing sample. The reconstructed samples are those that minimise the squared prediction errors around them
(Janssen, Veldhuis and Vries, IEEE Trans. ASSP 34(2), 1986, with the command as input).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, ComplexArray

TAIL_S = 30.0  # rest appended to a command, in which the table's response decays

BLOCK_S = 0.1
STILL = 1e-3  # a block whose range is below this fraction of the command's standard deviation is at rest
LEAST_REST_S = 0.4  # a shorter rest is part of the excitation
LEAST_SILENCE_S, LEAST_FREE_S, LEAST_EXCITED_S = 1.0, 5.0, 10.0
SHORTEST_PERIOD_S = 2.0
AROUND = 16  # samples around the estimated period that are searched
SWEEP_SEGMENTS, SWEEPING = 10, 1.0  # pieces of a period; scatter of their mean frequencies' logarithm in a sweep
SAME = 1e-3  # largest difference of two periods over the command's standard deviation
Mask = NDArray[np.bool_]
Places = NDArray[np.int_]
PAST_S = 0.04  # past of channel and command that a prediction uses
LEAST_PAST = 8  # samples
ROWS_EACH = 4  # least number of complete rows per coefficient
MOST_MISSING = 0.05  # largest fraction of a record's samples


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


def filled(command_v: Array, channels: Array, missing: Mask, dt_s: float) -> Array:
    """Return the channels (c, n) with their samples reconstructed where `missing` (n,) is set.

    `command_v` (n,) is complete; the channels may be in any unit. Raises InputError if too many samples are missing.
    """
    if not missing.any():
        return channels
    past = max(round(PAST_S / dt_s), LEAST_PAST)
    whole = ~_touched(missing, past)
    share = missing.mean()
    if share > MOST_MISSING or whole.sum() < ROWS_EACH * (2 * past + 1):
        raise InputError(
            f"{missing.sum()} of {missing.size} samples ({100.0 * share:.1f} %) were lost on the link, at most "
            f"{100.0 * MOST_MISSING:.0f} % may be; look at network and machine (rths doctor), or measure at a lower "
            "rate"
        )
    return np.array([_filled(command_v, channel, missing, whole, past) for channel in channels])


def _touched(missing: Mask, past: int) -> Mask:
    """Return which rows of the prediction, for samples past, past + 1, ..., use a missing sample."""
    return np.asarray(sliding_window_view(missing, past + 1).any(axis=1))


def _filled(command_v: Array, accel: Array, missing: Mask, whole: Mask, past: int) -> Array:
    """Return one channel (n,) with its missing samples reconstructed."""
    own, inputs = sliding_window_view(accel, past + 1), sliding_window_view(command_v, past + 1)
    seen = np.column_stack([own[whole, :-1], inputs[whole]])
    factors = _least_squares(seen, own[whole, -1])
    errors_of, forced = np.append(-factors[:past], 1.0), inputs @ factors[past:]
    found = accel.copy()
    head = np.flatnonzero(missing[:past])  # has no past to predict from: interpolated linearly
    came = np.flatnonzero(~missing[: 4 * past])
    found[head] = np.interp(head, came, accel[came])
    for places in clusters(np.flatnonzero(missing[past:]) + past, past):
        found[places] = _put_back(found, places, errors_of, forced, past)
    return found


def clusters(places: Places, past: int) -> Iterator[Places]:
    """Yield the indices (m,) of missing samples in groups; no prediction, of `past` samples, uses two groups."""
    yield from np.split(places, np.flatnonzero(np.diff(places) > past) + 1)


def _least_squares(seen: Array, wanted: Array) -> Array:
    """Return the coefficients by normal equations with scaled columns, slightly damped against rounding errors."""
    scale = np.sqrt((seen**2).mean(axis=0)) + np.finfo(float).tiny
    scaled = seen / scale
    square = scaled.T @ scaled
    square[np.diag_indices_from(square)] += 1e-12 * len(seen)
    return np.asarray(np.linalg.solve(square, scaled.T @ wanted) / scale)


def _put_back(accel: Array, places: Places, errors_of: Array, forced: Array, past: int) -> Array:
    """Return the samples at the indices `places` (m,) that minimise all prediction errors that depend on them."""
    rows = np.arange(places[0], min(places[-1] + past + 1, accel.size))
    lag = rows[:, None] - places[None, :]
    depends = np.where((lag >= 0) & (lag <= past), errors_of[past - np.clip(lag, 0, past)], 0.0)
    known = accel[rows[0] - past : rows[-1] + 1].copy()
    known[places - (rows[0] - past)] = 0.0
    rest = sliding_window_view(known, past + 1) @ errors_of - forced[rows - past]
    return np.asarray(np.linalg.lstsq(depends, -rest, rcond=None)[0])
