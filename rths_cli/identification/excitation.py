"""The excitation: its spectrum, signals (noise, multisine, sweep, steps) and plan within the table's limits.

All signals have the same amplitude over frequency: flat to the start of the compared band (0.7 Hz), falling as f^-1.5
to 12/11 of its end (12 Hz) and as f^-3.5 above. This keeps the acceleration nearly constant over the band without using
up the stroke at its low end.

A plan uses data-sheet values only. They give displacement and velocity of the table. Its acceleration, the sensors'
signals and the actuator's force depend on the table's response, which is not known yet. The nominal acceleration, gain
times the command's second derivative, therefore only defines levels and limits the probe (see low_level_probe.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from rths_cli.errors import InputError
from rths_cli.findings import Finding
from rths_cli.identification.record_parts import Parts
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

CORNER_HZ = 12.0  # of the usual compared band: above it the amplitude falls as f^-3.5, and a level is not counted
LEAST_HOLD_S, MOST_HOLD_S = 1.0, 4.0  # duration of a held level
ROUNDING = 40  # a sweep's kinks are rounded over this fraction of a period
LEAST_LEVEL = 0.5  # smallest held level; the largest is 1


def amplitude(frequency_hz: Array, compared: ComparedBand = USUAL) -> Array:
    """Return the amplitude (n,) without unit that all signals follow over frequencies (n,) in Hz."""
    return _falling(frequency_hz, 1.5, compared)


def _falling(frequency_hz: Array, power: float, compared: ComparedBand) -> Array:
    """Return the amplitude (n,) that falls as f^-power from the band's start on, and above the corner as f^-2 more."""
    corner_hz = compared.with_high(CORNER_HZ)
    slope, steep = (np.maximum(frequency_hz / hz, 1.0) for hz in (compared.low_hz, corner_hz))
    return np.asarray(slope**-power * steep**-2)


def shaped_noise(
    duration_s: float,
    dt_s: float,
    low_hz: float,
    high_hz: float,
    random: np.random.Generator,
    compared: ComparedBand = USUAL,
) -> Array:
    """Return Gaussian noise (n,) without unit with the amplitude of all signals."""
    n = round(duration_s / dt_s)
    shape = _lines(n, dt_s, low_hz, high_hz, compared)
    spectrum = shape * (random.standard_normal(len(shape)) + 1j * random.standard_normal(len(shape)))
    return np.fft.irfft(spectrum, n)


def multisine(
    period_s: float,
    dt_s: float,
    low_hz: float,
    high_hz: float,
    random: np.random.Generator,
    compared: ComparedBand = USUAL,
) -> Array:
    """Return one period (n,) without unit of a random-phase multisine with every line of 1/period_s in the band.

    Pintelon and Schoukens, System Identification: A Frequency Domain Approach, section 2.2.
    """
    n = round(period_s / dt_s)
    shape = _lines(n, dt_s, low_hz, high_hz, compared)
    return np.fft.irfft(shape * np.exp(2j * np.pi * random.random(len(shape))), n)


def sweep(period_s: float, dt_s: float, low_hz: float, high_hz: float, compared: ComparedBand = USUAL) -> Array:
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
    lines = np.fft.rfft(np.exp(_rounded_off(np.log(amplitude(frequency, compared)))) * np.sin(phase))
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


def steps(
    duration_s: float, dt_s: float, high_hz: float, random: np.random.Generator, compared: ComparedBand = USUAL
) -> Array:
    """Return smoothed steps (n,) without unit between levels of alternating sign and random size, held for 1-4 s.

    The smoothing (without phase) is flat to the band's start, falls as f^-0.5, as f^-2.5 above and is zero above
    `high_hz`. With the 1/f of a step that is the shape of the noise, and a step of height h m has at most
    h 4 pi integral(f H(f) df) m/s^2: 774 h for 60 Hz.
    """
    n = round(duration_s / dt_s)
    count = int(np.ceil(duration_s / LEAST_HOLD_S)) + 1
    ends = np.cumsum(random.uniform(LEAST_HOLD_S, MOST_HOLD_S, count))
    levels = random.uniform(LEAST_LEVEL, 1.0, count) * (-1.0) ** np.arange(count)
    held = levels[np.searchsorted(ends, np.arange(n) * dt_s, side="right")]
    return np.fft.irfft(np.fft.rfft(held) * smoothing(_frequencies(n, dt_s), high_hz, compared), n)


def smoothing(frequency_hz: Array, high_hz: float, compared: ComparedBand = USUAL) -> Array:
    """Return the factor (n,) without unit by which steps are smoothed at frequencies (n,) in Hz."""
    return np.where(frequency_hz <= high_hz, _falling(frequency_hz, 0.5, compared), 0.0)


def faded(signal: Array, fade_s: float, dt_s: float) -> Array:
    """Return the signal (n,) with raised-cosine ends, so that it starts and ends at zero with zero slope."""
    n = round(fade_s / dt_s)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / n)
    return signal * np.concatenate([rise, np.ones(len(signal) - 2 * n), rise[::-1]])


def repeated(period: Array, periods: int, fade_s: float, dt_s: float) -> Array:
    """Return a signal that repeats a period (n,): one that fades in, `periods` steady ones, and a short fade-out."""
    return faded(np.concatenate([np.tile(period, periods + 1), period[: round(fade_s / dt_s)]]), fade_s, dt_s)


def _lines(samples: int, dt_s: float, low_hz: float, high_hz: float, compared: ComparedBand) -> Array:
    """Return the amplitude of every Fourier line (n,), zero outside the band."""
    f = _frequencies(samples, dt_s)
    inside = (f >= low_hz) & (f <= high_hz)
    shape = np.zeros(len(f))
    shape[inside] = amplitude(f[inside], compared)
    return shape


def _frequencies(samples: int, dt_s: float) -> Array:
    """Return the frequencies (n,) in Hz of the Fourier lines of so many samples."""
    return np.asarray(np.fft.rfftfreq(samples, dt_s), dtype=float)


Kind = Literal["noise", "multisine", "sweep", "step"]
PERIODIC = ("multisine", "sweep")
SHARE = 0.6  # fraction of each limit that a plan may use
AMPLIFICATION = 2.0  # assumed acceleration of the floors over that of the table
SILENCE_S, FADE_S, PAUSE_S, BURST_S, BURST_FADE_S, HOLD_S = 2.0, 2.0, 0.5, 4.0, 0.3, 16.0
BURST_BAND_HZ = (1.0, 15.0)  # of the usual compared band
MOVED = ("stroke", "velocity", "command range")  # limits that the command alone determines
LEAST_DURATION_S = 40.0
LOW_HZ = (0.05, 1.0)  # of the usual compared band: least and largest low_hz
LEAST_PERIODS, LEAST_CYCLES = 3, 4.0  # periods in a record; cycles of low_hz in a period
SWEEP_SEGMENTS = 10  # segments per period: so short that a harmonic and its fundamental fall in different ones
MOST_CHANNELS = 41  # table and 40 floors: the evaluation takes minutes, and grows with their cube
MOST_VALUES = 3e7  # samples times channels of a record, 240 MB: an hour at 2 kHz with three channels
DRAWS = 50  # random draws of a multisine's phases


@dataclass(frozen=True)
class ExcitationSettings:
    """The requested excitation: duration of the signal, nominal acceleration, band and kind.

    Multisine and sweep repeat every `period_s`; their duration is rounded down to whole periods.
    """

    duration_s: float = 120.0
    accel_rms_m_s2: float = 2.0
    low_hz: float = 0.3
    high_hz: float = 60.0
    kind: Kind = "noise"
    period_s: float = 20.0
    compared: ComparedBand = USUAL  # band in which a model of the table will be compared with its data


class Reach(NamedTuple):
    """A predicted peak and its limit, both in `unit`."""

    predicted: float
    limit: float
    unit: str

    @property
    def share(self) -> float:
        """Return the fraction of the limit that is used."""
        return self.predicted / self.limit


@dataclass(frozen=True)
class Stretch:
    """A stretch of a plan in which the table moves."""

    samples: slice
    level_m_s2: float  # rms
    reach: dict[str, Reach]  # nominal peaks with their limits, by the name of the limit


@dataclass(frozen=True)
class Excitation:
    """A planned command (n,) in V with its parts; `accel_rms_m_s2` is its signal's nominal level below the corner.

    `notes` are for the user, for instance that the level was scaled down to a limit. `stretches`: the signal
    and, where there is one, the burst.
    """

    command_v: Array
    dt_s: float
    parts: Parts
    accel_rms_m_s2: float
    notes: tuple[Finding, ...] = ()
    stretches: tuple[Stretch, ...] = ()
    compared: ComparedBand = USUAL  # of its settings

    @property
    def reach(self) -> dict[str, Reach]:
        """Return, for each limit, the largest nominal peak of the whole plan."""
        names = self.stretches[0].reach if self.stretches else ()
        return {name: max(stretch.reach[name] for stretch in self.stretches) for name in names}


class Signal(NamedTuple):
    """A command before it is scaled to its level."""

    command_v: Array  # (n,)
    steady: slice  # samples that are evaluated
    period_samples: int = 0  # 0: not periodic
    segment_samples: int = 0  # length of the Hann segments that suit it; 0: any


def plan(info: RigInfo, settings: ExcitationSettings, seed: int, level: float | None = None) -> Excitation:
    """Plan silence, the signal, a burst and a hold for a rig, rounded to the bits of its command converter.

    A `level` in m/s^2 rms, as permitted by a probe, replaces that of the settings. If stroke, velocity or command would
    exceed 60 % of their limits, the signal is scaled down and a note says so. Raises InputError if the settings cannot
    be met.
    """
    settings = settings if level is None else replace(settings, accel_rms_m_s2=level)
    check(info, settings)
    random = np.random.default_rng(seed)
    dt, compared = info.dt_s, settings.compared
    signal = make_signal(info, settings, random)
    burst = faded(shaped_noise(BURST_S, dt, *burst_band(settings), random, compared), BURST_FADE_S, dt)
    level, notes = reachable_level(info, signal, settings.accel_rms_m_s2, MOVED, compared)
    loud = signal.command_v * level / accel_rms(signal.command_v, info, signal.steady, compared)
    burst = burst * min(level / accel_rms(burst, info, compared=compared), largest_scale(info, burst, MOVED)[0])
    pieces = (still(SILENCE_S, dt), loud, still(PAUSE_S, dt), burst, still(HOLD_S, dt))
    ends = [int(end) for end in np.cumsum([len(piece) for piece in pieces])]
    steady = slice(ends[0] + signal.steady.start, ends[0] + signal.steady.stop)
    parts = Parts(steady, slice(0, ends[0]), slice(ends[3], ends[4]), signal.period_samples, signal.segment_samples)
    stretches = (
        Stretch(slice(ends[0], ends[2]), level, reach(info, loud)),
        Stretch(slice(ends[2], ends[4]), accel_rms(burst, info, compared=compared), reach(info, burst)),
    )
    notes = (*whole_periods(settings), *notes)
    return Excitation(
        rounded(np.concatenate(pieces), info.converters.step_v), dt, parts, level, notes, stretches, compared
    )


def check(info: RigInfo, settings: ExcitationSettings) -> None:
    """Raise one InputError that names every setting out of range."""
    faults = []
    nyquist, compared = 0.5 / info.dt_s, settings.compared
    lowest, highest = (compared.with_low(hz) for hz in LOW_HZ)
    least = 2.0 * compared.with_high(CORNER_HZ)
    if not lowest <= settings.low_hz <= highest:
        faults.append(
            f"identification.low_hz: {settings.low_hz:g} Hz must be between {lowest:g} and {highest:g} Hz to identify "
            f"the table in {compared}"
        )
    if least > 0.4 * nyquist:
        faults.append(
            f"identification.compared_hz: up to {compared.high_hz:g} Hz needs an excitation up to {least:g} Hz, but "
            f"the sample rate carries {0.4 * nyquist:g} Hz (0.4 of half of it); lower test_band_hz or compared_hz"
        )
    elif not least <= settings.high_hz <= 0.4 * nyquist:
        faults.append(
            f"identification.high_hz: {settings.high_hz:g} Hz must be between {least:g} Hz and "
            f"{0.4 * nyquist:g} Hz (0.4 of half the sample rate)"
        )
    if not LEAST_DURATION_S <= settings.duration_s <= 3600.0:
        faults.append(
            f"identification.duration_s: {settings.duration_s:g} s must be between {LEAST_DURATION_S:g} and 3600 s"
        )
    if len(info.channels) > MOST_CHANNELS:
        faults.append(
            f"structure.experimental: {len(info.channels) - 1} floors on the table, at most {MOST_CHANNELS - 1} can be "
            "identified; put fewer storeys on the table"
        )
    values = settings.duration_s / info.dt_s * (1 + len(info.channels))
    if values > MOST_VALUES:
        faults.append(
            f"identification.duration_s: {settings.duration_s:g} s at {1.0 / info.dt_s:g} Hz make {values:.2g} values "
            f"of command and {len(info.channels)} channels, the limit is {MOST_VALUES:.2g}; ask for at most "
            f"{MOST_VALUES / values * settings.duration_s:.3g} s, or lower sample_rate_hz"
        )
    if not 0.0 < settings.accel_rms_m_s2 < np.inf:
        faults.append(f"identification.accel_rms_m_s2: {settings.accel_rms_m_s2:g} m/s^2 must be positive")
    if settings.kind not in get_args(Kind):
        faults.append(f"identification.kind: {settings.kind!r} must be one of {', '.join(get_args(Kind))}")
    if settings.kind in PERIODIC:
        faults.extend(_period_faults(settings))
    if faults:
        raise InputError(*faults)


def _period_faults(settings: ExcitationSettings) -> list[str]:
    """Return sentences on a period that is too short for its lowest frequency or too long for the duration."""
    period, faults = settings.period_s, []
    least = LEAST_CYCLES / settings.low_hz if settings.low_hz > 0.0 else 0.0
    if not period >= least * (1.0 - 1e-9):
        faults.append(
            f"identification.period_s: {period:g} s must hold {LEAST_CYCLES:g} cycles of low_hz "
            f"{settings.low_hz:g} Hz; give at least {np.ceil(100.0 * least) / 100.0:g} s"
        )
    if period > 0.0 and settings.duration_s < LEAST_PERIODS * period * (1.0 - 1e-9):
        faults.append(
            f"identification.duration_s: {settings.duration_s:g} s must hold {LEAST_PERIODS} periods of period_s "
            f"{period:g} s for a {settings.kind}; give at least {LEAST_PERIODS * period:g} s"
        )
    return faults


def periods(settings: ExcitationSettings) -> int:
    """Return how many whole periods the duration holds."""
    return int(settings.duration_s / settings.period_s * (1.0 + 1e-9))


def whole_periods(settings: ExcitationSettings) -> tuple[Finding, ...]:
    """Return a note when the duration is not a whole number of periods."""
    whole_s = periods(settings) * settings.period_s if settings.kind in PERIODIC else settings.duration_s
    if abs(whole_s - settings.duration_s) < 1e-6 * settings.duration_s:
        return ()
    values = {"played_s": whole_s, "wanted_s": settings.duration_s, "period_s": settings.period_s}
    return (Finding("excitation.whole_periods", values),)


def make_signal(info: RigInfo, settings: ExcitationSettings, random: np.random.Generator) -> Signal:
    """Return the signal of the requested kind with faded ends; periodic kinds begin with one period to settle."""
    dt, low, high, compared = info.dt_s, settings.low_hz, settings.high_hz, settings.compared
    if settings.kind == "multisine":
        return _periodic(best_multisine(info, settings, random), settings, dt)
    if settings.kind == "sweep":
        played = _periodic(sweep(settings.period_s, dt, low, high, compared), settings, dt)
        return played._replace(period_samples=0, segment_samples=played.period_samples // SWEEP_SEGMENTS)
    if settings.kind == "step":
        signal = steps(settings.duration_s, dt, high, random, compared)
    else:
        signal = shaped_noise(settings.duration_s, dt, low, high, random, compared)
    return Signal(faded(signal, FADE_S, dt), slice(0, len(signal)))


def _periodic(period: Array, settings: ExcitationSettings, dt_s: float) -> Signal:
    """Return the signal that repeats a period (n,) for the duration, after one period in which transients decay."""
    n, count = len(period), periods(settings)
    return Signal(repeated(period, count, FADE_S, dt_s), slice(n, n * (count + 1)), n)


def best_multisine(info: RigInfo, settings: ExcitationSettings, random: np.random.Generator) -> Array:
    """Return one period (n,) of a multisine: of 50 draws of its phases, the one that permits the highest level.

    On the default rig, in the mean of six seeds, this level is 16 % (force is the first limit) to 22 % (stroke or
    velocity) above that of a single draw; 10 draws gain 12-15 %, 200 draws 19-25 %.
    """
    dt, shape = info.dt_s, (settings.low_hz, settings.high_hz, random, settings.compared)
    draws = (multisine(settings.period_s, dt, *shape) for _ in range(DRAWS))
    return max(draws, key=lambda period: largest_scale(info, repeated(period, 1, FADE_S, dt))[0])


def burst_band(settings: ExcitationSettings) -> tuple[float, float]:
    """Return the band of the burst in Hz, inside that of the signal."""
    low, high = settings.compared.with_low(BURST_BAND_HZ[0]), settings.compared.with_high(BURST_BAND_HZ[1])
    return max(low, settings.low_hz), min(high, settings.high_hz)


def still(duration_s: float, dt_s: float) -> Array:
    """Return a command (n,) of zeros."""
    return np.zeros(round(duration_s / dt_s))


def nominal_accel(command_v: Array, info: RigInfo) -> Array:
    """Return the nominal table acceleration (n,) in m/s^2: gain times the command's second derivative."""
    return info.gain_m_per_v * np.diff(command_v, 2, prepend=0.0, append=0.0) / info.dt_s**2


def accel_rms(command_v: Array, info: RigInfo, part: slice = slice(None), compared: ComparedBand = USUAL) -> float:
    """Return the rms below the corner of the nominal table acceleration in m/s^2 (above, no table follows)."""
    accel = nominal_accel(command_v, info)[part]
    amplitude = np.fft.rfft(accel) / len(accel)
    below = np.fft.rfftfreq(len(accel), info.dt_s) <= compared.with_high(CORNER_HZ)
    return float(np.sqrt(2.0 * np.sum(np.abs(amplitude[below]) ** 2)))


def reach(info: RigInfo, command_v: Array) -> dict[str, Reach]:
    """Return the nominal peaks of a command (n,) in V, before rounding, with their limits."""
    place = float(np.abs(command_v).max())
    accel = float(np.abs(nominal_accel(command_v, info)).max())
    velocity = info.gain_m_per_v * float(np.abs(np.diff(command_v)).max()) / info.dt_s
    mass = info.moving_mass_kg + info.specimen_mass_kg
    sensor = min(channel.range for channel in info.channels)
    limits = info.limits
    return {
        "stroke": Reach(info.gain_m_per_v * place, limits.stroke_m, "m"),
        "velocity": Reach(velocity, limits.fastest_m_s(info.gain_m_per_v), "m/s"),
        "acceleration": Reach(AMPLIFICATION * accel, limits.acceleration_m_s2, "m/s^2"),
        "sensor range": Reach(AMPLIFICATION * accel, sensor, "m/s^2"),
        "force": Reach(mass * accel, limits.force_n, "N"),
        "command range": Reach(place, info.converters.range_v, "V"),
    }


def largest_scale(info: RigInfo, command_v: Array, limits: Sequence[str] = ()) -> tuple[float, str]:
    """Return the factor that brings a command (n,) in V to 60 % of the tightest limit, and that limit's name.

    Only the named `limits` count; without names, all of them.
    """
    nominal = reach(info, command_v)
    room = {name: nominal[name].limit / nominal[name].predicted for name in limits or nominal}
    first = min(room, key=lambda name: room[name])
    return SHARE * room[first], first


def reachable_level(
    info: RigInfo,
    signal: Signal,
    wanted_m_s2: float,
    limits: Sequence[str] = (),
    compared: ComparedBand = USUAL,
) -> tuple[float, tuple[Finding, ...]]:
    """Return the level in m/s^2 rms that the named limits (without names: all) permit, and a note if it is reduced.

    The level is at most `wanted_m_s2`.
    """
    scale, limit = largest_scale(info, signal.command_v, limits)
    allowed = scale * accel_rms(signal.command_v, info, signal.steady, compared)
    if wanted_m_s2 <= allowed:
        return wanted_m_s2, ()
    values = {"wanted_m_s2": wanted_m_s2, "allowed_m_s2": allowed, "share": SHARE, "limit": limit}
    return allowed, (Finding("excitation.scaled_down", values),)


def rounded(command_v: Array, step_v: float) -> Array:
    """Return the command (n,) in V rounded to the converter's bits, so that the known command is the one played."""
    return np.round(command_v / step_v) * step_v if step_v > 0.0 else command_v
