"""The quiet probe before the excitation, the level of the loud record, and by what factor it could be louder."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rths_cli.errors import InputError
from rths_cli.findings import Finding
from rths_cli.identification.excitation import (
    FADE_S,
    SHARE,
    SILENCE_S,
    Excitation,
    ExcitationSettings,
    Reach,
    Signal,
    Stretch,
    accel_rms,
    check,
    faded,
    reach,
    reachable_level,
    rounded,
    shaped_noise,
    still,
)
from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.inputs import Evidence
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.rigs.description import RigInfo

PROBE_SHARE = 0.2  # level of the probe over the requested level, or over the level that the limits allow
PROBE_BITS, MOST_PROBE_SHARE = 10.0, 0.5  # a probe below 10 bits of an accelerometer is raised, up to this share
PROBE_S, REST_S = 20.0, 3.0
TAIL_S = 1.0  # end of the rest; a lightly damped motion is still visible there
CHANNEL_SHARE = 0.7  # fraction of sensor and converter range that a channel may use
WORTH_LOWERING = 0.98  # a level is lowered only by more than 2 %; the margins of the limits cover less
# end of the measured responses with the usual compared band; least power of a line over the mean power
HIGHEST_HZ, LEAST_POWER = 60.0, 0.01
LEAST_OVER_NOISE = 3.0
SHORT_SEGMENT_S = 4.0  # segments in which two levels are compared: the probe has nine
GROWN, LEAST_SCATTER = 1.5, 1.5e-3  # overdriven: growth of the unexplained share, standard error of a line
FOLLOWED = ("stroke", "velocity")  # limits whose use is proportional to the table's gain
SOFT = "; a floor on a storey far softer than the others may hardly move as well"


@dataclass(frozen=True)
class Level:
    """The level of the excitation that a probe permits."""

    accel_rms_m_s2: float
    limited_by: str  # name of the limit that lowered the level, "" if none did
    notes: tuple[Finding, ...] = ()  # for the user
    reach: Mapping[str, Reach] = field(default_factory=dict)  # expected peaks at this level, with their limits
    allowed_m_s2: Mapping[str, float] = field(default_factory=dict)  # highest level of each limit that lowers it

    def at(self, accel_rms_m_s2: float) -> Level:
        """Return the same excitation at another level, with its expected peaks scaled."""
        factor = accel_rms_m_s2 / self.accel_rms_m_s2
        peaks = {name: peak._replace(predicted=factor * peak.predicted) for name, peak in self.reach.items()}
        return replace(self, accel_rms_m_s2=accel_rms_m_s2, reach=peaks)


class Bound(NamedTuple):
    """A peak that is expected at a level, and the fraction of its limit that it may use."""

    name: str
    level_m_s2: float
    expected: float  # in `unit`
    limit: float  # in `unit`
    share: float
    unit: str

    @property
    def allowed_m_s2(self) -> float:
        """Return the level in m/s^2 rms at which the peak uses exactly its fraction of the limit."""
        return self.level_m_s2 * self.share * self.limit / self.expected


def probe_plan(info: RigInfo, settings: ExcitationSettings, seed: int, most_m_s2: float = math.inf) -> Excitation:
    """Plan the probe: silence, 20 s of shaped noise at a fifth of the requested or permitted level, and a rest.

    All limits are judged by the nominal acceleration, because the table's response is not known yet. If a fifth of the
    level is less than 10 bits of the accelerometers, the probe is up to half of it, and a note says so. The noise has
    its own random stream, so that it changes no other excitation. `most_m_s2`: a level in m/s^2 rms that it must not
    exceed, whatever a fifth is. Raises InputError if the settings cannot be met.
    """
    check(info, settings)
    dt, random = info.dt_s, np.random.default_rng((seed, 1))
    compared = settings.compared
    noise = faded(shaped_noise(PROBE_S, dt, settings.low_hz, settings.high_hz, random, compared), FADE_S, dt)
    signal = Signal(noise, slice(0, len(noise)))
    highest, _ = reachable_level(info, signal, settings.accel_rms_m_s2, compared=compared)
    bit = max(info.converters.step_v / channel.sensitivity_v_per_unit for channel in info.channels)
    level = max(PROBE_SHARE * highest, min(MOST_PROBE_SHARE * highest, PROBE_BITS * bit))
    usual = level == PROBE_SHARE * highest
    if most_m_s2 < WORTH_LOWERING * level:
        level, usual = most_m_s2, True
    noise = noise * level / accel_rms(noise, info, compared=compared)
    pieces = (still(SILENCE_S, dt), noise, still(REST_S, dt))
    start = len(pieces[0])
    played = slice(start, start + len(noise))
    notes = () if usual else (_raised(level, settings),)
    command = rounded(np.concatenate(pieces), info.converters.step_v)
    stretches = (Stretch(played, level, reach(info, noise)),)
    return Excitation(command, dt, Parts(played, slice(0, start)), level, notes, stretches, compared)


def _raised(level_m_s2: float, settings: ExcitationSettings) -> Finding:
    """Return the note that the probe is louder than a fifth of the level."""
    values = {"level_m_s2": level_m_s2, "share": PROBE_SHARE, "wanted_m_s2": settings.accel_rms_m_s2}
    return Finding("excitation.louder_probe", values)


def choose_level(
    info: RigInfo, probe: Excitation, accel: Array, wanted: float, planned: Excitation,
    floor_masses_kg: Array | None = None,
) -> Level:  # fmt: skip
    """Choose the level of a planned excitation from the corrected accelerations (c, n) in m/s^2 of its probe.

    The peaks of each channel are predicted by applying the response measured in the probe to the planned command. On
    the default rig they are right within 5 % for all kinds of excitation, and within 25 % for a specimen of 0.5 %
    damping, whose vibration outlasts the probe.

    Every channel stays below 70 % of the range of its sensor and converter and below 60 % of the acceleration limit.
    Stroke and velocity, predicted with the measured gain, and the force that moves table and floors stay below 60 % of
    their limits. `floor_masses_kg` (c - 1,) are the masses for that force; None: the specimen's whole mass moves with
    the table. The level is never above `wanted` in m/s^2 rms or above that of the plan.

    Raises InputError if the record does not fit the probe, or if a channel shows nothing but noise.
    """
    check_probe(info, probe, accel)
    start = min(wanted, planned.accel_rms_m_s2)
    gain = measured_gain(info, probe, accel[0])
    shown = expected(info, probe, accel, planned)
    bounds = [
        *channel_bounds(info, shown, planned),
        *limit_bounds(planned, gain / info.gain_m_per_v),
        *acceleration_bounds(info, shown, planned),
        *force_bounds(info, shown, planned, floor_masses_kg),
    ]
    lowering = [bound for bound in tightest_first(bounds) if bound.allowed_m_s2 < start * WORTH_LOWERING]
    if not lowering:
        return Level(start, "", (), _reach(bounds, start))
    name, level = lowering[0].name, lowering[0].allowed_m_s2
    allowed = {bound.name: bound.allowed_m_s2 for bound in lowering}
    return Level(level, name, (_lowered(start, lowering[0]),), _reach(bounds, level), allowed)


def _reach(bounds: Iterable[Bound], level_m_s2: float) -> dict[str, Reach]:
    """Return the largest expected peak for each limit at a level; the ranges of all channels count as one limit."""
    found: dict[str, Reach] = {}
    for bound in bounds:
        name = "sensor range" if bound.name.startswith("range of") else bound.name.removesuffix(" limit")
        peak = Reach(bound.expected * min(level_m_s2 / bound.level_m_s2, 1.0), bound.limit, bound.unit)
        found[name] = max(peak, found.get(name, peak), key=lambda each: each.share)
    return found


def tightest_first(bounds: Iterable[Bound]) -> list[Bound]:
    """Return, for each limit that a plan violates, its tightest bound; the tightest of all first."""
    found: dict[str, Bound] = {}
    for bound in sorted(bounds, key=lambda bound: bound.allowed_m_s2):
        if bound.allowed_m_s2 < bound.level_m_s2 * (1.0 - 1e-9):
            found.setdefault(bound.name, bound)
    return list(found.values())


def check_probe(info: RigInfo, probe: Excitation, accel: Array) -> None:
    """Raise InputError if a probe's record (c, n) does not fit its plan, or if a channel shows only noise.

    Noise is the channel's noise at rest or that of its quantisation, whichever is larger.
    """
    if accel.shape != (len(info.channels), len(probe.command_v)) or not np.isfinite(accel).all():
        raise InputError(
            f"probe: {accel.shape} samples must be finite and fit {len(info.channels)} channels and "
            f"{len(probe.command_v)} commands; the record ends early or a channel was lost"
        )
    faults = []
    for channel, samples in zip(info.channels, accel, strict=True):
        loud, quiet = float(samples[probe.parts.noise].std()), float(samples[probe.parts.silence].std())
        bit = info.converters.step_v / channel.sensitivity_v_per_unit
        if not loud > LEAST_OVER_NOISE * max(quiet, bit / np.sqrt(12.0)):
            faults.append(
                f"channel {channel.name}: nothing but noise in the probe, {quiet:.2g} m/s^2 rms at rest and {loud:.2g} "
                f"under excitation of nominally {probe.accel_rms_m_s2:.2g} (a bit is {bit:.2g}); check sensor, cable "
                f"and power, or use a finer converter{'' if channel is info.channels[0] else SOFT}"
            )
    if faults:
        raise InputError(*faults)


def measured_gain(info: RigInfo, probe: Excitation, table_accel: Array) -> float:
    """Return the table's displacement gain in m/V from its acceleration (n,) in m/s^2: |H1| at its lowest lines.

    These are in the lowest of the compared bands.

    The input is the command's second derivative; the record begins and ends at rest, so that no window is needed.
    """
    given, found = _derivative_lines(probe.command_v, info.dt_s), np.fft.rfft(table_accel)
    f = np.fft.rfftfreq(len(table_accel), info.dt_s)
    low_hz, high_hz, *_ = probe.compared.edges_hz
    inside = (f >= low_hz) & (f <= high_hz)
    return float(np.abs(np.vdot(given[inside], found[inside])) / np.sum(np.abs(given[inside]) ** 2))


def expected(info: RigInfo, probe: Excitation, accel: Array, planned: Excitation) -> Array:
    """Return the predicted accelerations (c, n) in m/s^2 of the channels while a plan is played.

    The probe's record begins and ends at rest. Its Fourier lines divided by those of the command's second derivative
    are therefore the frequency response; lines with less than 1 % of the mean power are ignored.
    """
    given, lines = _derivative_lines(probe.command_v, info.dt_s), np.fft.rfft(accel, axis=-1)
    f, power = np.fft.rfftfreq(len(probe.command_v), info.dt_s), np.abs(given) ** 2
    highest_hz = probe.compared.with_high(HIGHEST_HZ)
    inside = (f <= highest_hz) & (power > LEAST_POWER * power[f <= highest_hz].mean())
    wanted = _derivative_lines(planned.command_v, info.dt_s)
    wanted_f = np.fft.rfftfreq(len(planned.command_v), info.dt_s)
    wanted[wanted_f > highest_hz] = 0.0
    responses = (np.interp(wanted_f, f[inside], line[inside] / given[inside]) for line in lines)
    shown = np.array([np.fft.irfft(response * wanted, len(planned.command_v)) for response in responses])
    return shown * ringing_growth(info, probe, accel, planned)[:, None]


def ringing_growth(info: RigInfo, probe: Excitation, accel: Array, planned: Excitation) -> Array:
    """Return the factors (c,) by which the channels' motion may grow because a plan lasts longer than its probe.

    A motion that still rings at the end of the probe's rest had not reached its steady state in the probe. Without any
    damping its power grows in proportion to the duration of the noise. The fraction of the power that still rings at
    the end of the rest is assumed to grow in this way.
    """
    excited = accel[:, probe.parts.noise]
    left = accel[:, -round(TAIL_S / info.dt_s) :]
    ringing = np.minimum(left.var(axis=1) / excited.var(axis=1), 1.0)
    longer = max(stretch.samples.stop - stretch.samples.start for stretch in planned.stretches) / excited.shape[1]
    return np.asarray(np.sqrt(1.0 + ringing * max(longer - 1.0, 0.0)))


def channel_bounds(info: RigInfo, shown: Array, planned: Excitation) -> Iterator[Bound]:
    """Yield the predicted peak of each channel in each stretch of a plan, with the channel's range."""
    for channel, samples in zip(info.channels, np.abs(shown), strict=True):
        limit = min(channel.range, info.converters.range_v / channel.sensitivity_v_per_unit)
        for loud in planned.stretches:
            peak = float(samples[loud.samples].max())
            yield Bound(f"range of channel {channel.name}", loud.level_m_s2, peak, limit, CHANNEL_SHARE, "m/s^2")


def acceleration_bounds(info: RigInfo, shown: Array, planned: Excitation) -> Iterator[Bound]:
    """Yield the largest predicted peak of table and floors in each stretch of a plan, with the acceleration limit."""
    for loud in planned.stretches:
        peak = float(np.abs(shown[:, loud.samples]).max())
        yield Bound("acceleration limit", loud.level_m_s2, peak, info.limits.acceleration_m_s2, SHARE, "m/s^2")


def force_bounds(info: RigInfo, shown: Array, planned: Excitation, floor_masses_kg: Array | None) -> Iterator[Bound]:
    """Yield the peak force that moves table and floors in each stretch of a plan, computed as the guard does."""
    if floor_masses_kg is None:
        force = np.abs((info.moving_mass_kg + info.specimen_mass_kg) * shown[0])
    else:
        force = np.abs(np.concatenate([[info.moving_mass_kg], floor_masses_kg]) @ shown)
    for loud in planned.stretches:
        peak = float(force[loud.samples].max())
        yield Bound("force limit", loud.level_m_s2, peak, info.limits.force_n, SHARE, "N")


def limit_bounds(planned: Excitation, gain_ratio: float) -> Iterator[Bound]:
    """Yield the peak displacement and velocity in each stretch of a plan, with their limits.

    `gain_ratio` is the measured gain of the table over the nominal one.
    """
    for loud in planned.stretches:
        for name in FOLLOWED:
            predicted, limit, unit = loud.reach[name]
            yield Bound(f"{name} limit", loud.level_m_s2, predicted * gain_ratio, limit, SHARE, unit)


def overdriven(quiet: Record, loud: Record, dt_s: float, compared: ComparedBand = USUAL) -> tuple[float, float] | None:
    """Return the fractions of the table's power that the command does not explain, at low and at full level.

    None is returned unless the fraction at full level is larger by enough to spoil a model. The fraction due to noise,
    rounding and friction decreases with the level, and that due to leakage is constant. Only an actuator at a limit, or
    another nonlinearity that grows with the motion, makes it increase. Both records must be noise.
    """
    low, full = (estimate([record], dt_s, compared.hz, SHORT_SEGMENT_S)[0] for record in (quiet, loud))
    before, after = (float(np.median(1.0 / frf.coherence - 1.0)) for frf in (low, full))
    scatter = float(np.median(full.relative_error))
    return (before, after) if after > GROWN * before and scatter > LEAST_SCATTER else None


def _derivative_lines(command_v: Array, dt_s: float) -> ComplexArray:
    """Return the Fourier lines (n,) of a command's second derivative in V/s^2."""
    return np.fft.rfft(np.diff(command_v, 2, prepend=0.0, append=0.0) / dt_s**2)


def _lowered(start_m_s2: float, bound: Bound) -> Finding:
    """Return the note on a level that was lowered, and on the bound that decided."""
    peak = bound.expected * start_m_s2 / bound.level_m_s2
    levels = {"wanted_m_s2": start_m_s2, "allowed_m_s2": bound.allowed_m_s2}
    used = {"bound": bound.name, "peak": peak, "limit": bound.limit, "units": bound.unit, "share": bound.share}
    return Finding("excitation.lowered", {**levels, **used})


def louder(data: Evidence) -> float:
    """Return the factor by which the loudest record could be louder before it reaches the first permitted bound.

    The bounds are the fractions of limits and sensor ranges that an excitation may use (SHARE, CHANNEL_SHARE).
    """
    info, limits = data.info, data.info.limits
    command = max((record.command_v - record.command_v[0] for record in data.records), key=_peak)
    place = info.gain_m_per_v * command
    accel = np.hstack([record.accel_m_s2 for record in data.records])
    force = np.concatenate([[info.moving_mass_kg], data.masses_kg]) @ accel
    room = [
        SHARE * limits.stroke_m / _peak(place),
        SHARE * info.converters.range_v / _peak(command),
        SHARE * limits.fastest_m_s(info.gain_m_per_v) / _peak(np.diff(place) / info.dt_s),
        SHARE * limits.acceleration_m_s2 / _peak(accel),
        SHARE * limits.force_n / _peak(force),
    ]
    for channel, samples in zip(info.channels, accel, strict=True):
        largest = min(channel.range, info.converters.range_v / channel.sensitivity_v_per_unit)
        room.append(CHANNEL_SHARE * largest / _peak(samples))
    return min(room)


def _peak(values: Array) -> float:
    return float(np.abs(values).max())
