"""Judge the channels by their signals alone: lost, dead, clipped, mains hum."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.errors import InputError
from rths_cli.findings import Finding, sentences
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import ChannelReport
from rths_cli.identification.table_fit import within
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Frf
from rths_cli.rigs.description import Channel, RigInfo

TOP, FLAT, FLATTEST, CUT_OFF, LEAST_TOP = 0.95, 0.998, 0.993, 0.5, 6
NOISE_SIGMA = 6.0


def cut_off_peaks(accel: Array, channel: Channel, dt_s: float, rest_rms_m_s2: float, bit_m_s2: float = 0.0) -> int:
    """Return the number of clipped peaks of a channel (n,) in m/s^2, which may be corrected for the sensor's corners.

    Clipping happens before the correction, which tilts a flat top. Therefore the corrected and the original signal are
    both examined. `bit_m_s2`: one bit of the converter.
    """
    both = accel, as_sampled(accel, channel, dt_s)
    return max(flat_tops(values, rest_rms_m_s2, bit_m_s2) for values in both)


def as_sampled(accel: Array, channel: Channel, dt_s: float) -> Array:
    """Return a channel (n,) in m/s^2 without the sensor correction, as the converter sampled it.

    It inverts 1 + w_h / s (trapezoidal rule) and the lead 1 + T / dt (3/2 - 2/z + 1/2 z^-2), T = 1 / w_l, from rest.
    """
    from scipy.signal import lfilter

    half = np.pi * channel.high_pass_hz * dt_s
    lead = 1.0 / (2.0 * np.pi * channel.low_pass_hz * dt_s) if channel.low_pass_hz > 0.0 else 0.0
    coupled = lfilter([1.0, -1.0], [1.0 + half, half - 1.0], accel - accel[0])
    return np.asarray(lfilter([1.0], [1.0 + 1.5 * lead, -2.0 * lead, 0.5 * lead], coupled))


def flat_tops(accel: Array, rest_rms_m_s2: float = 0.0, bit_m_s2: float = 0.0) -> int:
    """Return the number of clipped peaks of a signal (n,) in m/s^2.

    A normal peak is a parabola: of the time above 95 % of its top it spends sqrt(0.002 / 0.05) = 0.2 above 99.8 % (0.37
    above 99.3 %, the threshold for noisy signals). A clipped peak spends most of that time there: more than half of its
    samples and one, so that noise cannot make a short peak look clipped. If one bit of the converter is more than 0.7 %
    of the top, every peak looks flat and none is counted.
    """
    count = 0
    for side in (accel, -accel):
        top = float(side.max())
        if bit_m_s2 > (1.0 - FLATTEST) * top:
            continue
        flat = np.clip(1.0 - NOISE_SIGMA * rest_rms_m_s2 / top, FLATTEST, FLAT) if top > 0.0 else FLAT
        edges = np.diff((side > TOP * top).astype(np.int8), prepend=0, append=0)
        stretches = zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
        flats = [(int(np.sum(side[a:b] > flat * top)), int(b - a)) for a, b in stretches if b - a >= LEAST_TOP]
        count += sum(at_top > CUT_OFF * length + 1.0 for at_top, length in flats)
    return count


DEAD_BITS, DEAD_OVER_SILENCE = 1.0, 3.0
CLIPPED_SHARE = 0.98
NO_SENSOR = 2.0  # times its range that a channel in the right unit never reads
MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)  # both public grids and their harmonics, whatever the band
HUM_OVER_FLOOR = 10.0
HUM_WORTH_SAYING = 2e-3  # of the excited rms


class UnfitRecord(InputError):
    """A record that must not be used for a model; `channels` holds the reports on its channels."""

    def __init__(self, findings: Sequence[Finding], channels: tuple[ChannelReport, ...] = ()) -> None:
        super().__init__(*sentences(findings))
        self.findings = tuple(findings)
        self.channels = channels


def signal_faults(record: Record, info: RigInfo) -> list[Finding]:
    """Return a finding for each channel that has missing samples, is dead, is drowned in noise, or is clipped."""
    faults = _lost("command", record.command_v)
    for channel, accel in zip(info.channels, record.accel_m_s2, strict=True):
        faults += _lost(channel.name, accel) or _signal_faults(channel, accel, info, record)
    return faults


def _lost(name: str, values: Array) -> list[Finding]:
    missing = np.flatnonzero(~np.isfinite(values))
    if not missing.size:
        return []
    count, share = missing.size, missing.size / values.size
    told = {"channel": name, "missing": count, "samples": values.size, "share": share, "first": int(missing[0])}
    return [Finding("channel.missing_samples", told)]


def _signal_faults(channel: Channel, accel: Array, info: RigInfo, record: Record) -> list[Finding]:
    parts = record.parts
    rms = float(accel[parts.noise].std())
    quiet = float(accel[parts.silence].std()) if parts.silence is not None else 0.0
    bit = info.converters.step_v / channel.sensitivity_v_per_unit
    least, largest = max(DEAD_BITS * bit, 1e-9), float(np.abs(accel).max())
    named = {"channel": channel.name}
    moved = {**named, "rms_m_s2": rms, "of_floor": channel is not info.channels[0]}
    reached = {**named, "peak_m_s2": largest, "range_m_s2": channel.range}
    if rms < least:
        return [Finding("channel.dead", {**moved, "bit_m_s2": least})]
    if rms < DEAD_OVER_SILENCE * quiet:
        return [Finding("channel.noise_alone", {**moved, "rest_m_s2": quiet})]
    if largest > NO_SENSOR * channel.range:
        return [Finding("channel.impossible", {**reached, "ratio": largest / channel.range})]
    if largest > CLIPPED_SHARE * channel.range:
        return [Finding("channel.clipped", reached)]
    if tops := cut_off_peaks(accel, channel, info.dt_s, quiet, bit):
        return [Finding("channel.cut_off", {**named, "peaks": tops, "peak_m_s2": largest})]
    return []


def channel_noise(record: Record, info: RigInfo) -> Array:
    """Return the standard deviation (c,) in m/s^2 of the channels' noise.

    It is the noise at rest, but at least the quantisation noise: a channel that rests within one bit shows no noise.
    """
    rounding = [info.converters.step_v / channel.sensitivity_v_per_unit / np.sqrt(12.0) for channel in info.channels]
    silence = record.parts.silence
    at_rest = np.zeros(len(rounding)) if silence is None else record.accel_m_s2[:, silence].std(axis=1)
    return np.maximum(at_rest, rounding)


def reports(
    records: Sequence[Record], frfs: Sequence[Frf] | None, info: RigInfo, compared: ComparedBand = USUAL
) -> tuple[ChannelReport, ...]:
    """Return a report on each channel; without responses its coherence is not known (NaN)."""
    found = []
    for index, channel in enumerate(info.channels):
        loud = np.concatenate([r.accel_m_s2[index, r.parts.noise] for r in records])
        quiet = [r.accel_m_s2[index, r.parts.silence].std() for r in records if r.parts.silence is not None]
        frequency, amplitude = _hum(records, index, info.dt_s, float(np.nanstd(loud)))
        found.append(
            ChannelReport(
                channel.name,
                float(np.nanstd(loud)),
                float(np.nanmax(np.abs(loud), initial=0.0)),
                float(np.mean(quiet)) if quiet else None,
                coherence(frfs[index], compared) if frfs else float("nan"),
                amplitude,
                frequency,
                _zero(records, index, channel, info.dt_s),
            )
        )
    return tuple(found)


def _zero(records: Sequence[Record], index: int, channel: Channel, dt_s: float) -> float | None:
    """Return a channel's mean in motion less its mean at rest, in m/s^2 as sampled; None without a silence.

    A motion from rest to rest, or over whole periods, has no mean. At rest samples stay within a bit, in motion their
    rounding is spread over the bits: the difference is what the mean at rest is off by.
    """
    found = []
    for record in records:
        rest = record.parts.silence
        if rest is not None and np.isfinite(record.accel_m_s2[index]).all():
            sampled = as_sampled(record.accel_m_s2[index], channel, dt_s)
            found.append(float(sampled[record.parts.noise].mean() - sampled[rest].mean()))
    return float(np.mean(found)) if found else None


def coherence(frf: Frf, compared: ComparedBand = USUAL) -> float:
    """Return the median coherence in the compared band."""
    return float(np.median(frf.coherence[within(frf.frequency_hz, compared.hz)]))


def _hum(records: Sequence[Record], index: int, dt_s: float, loud: float) -> tuple[float, float]:
    """Return frequency in Hz and amplitude of the strongest mains hum, (0, 0) if there is none.

    It is taken from the silence of a record, or from its excitation if that is not periodic.
    """
    best = (0.0, 0.0)
    for record in records:
        part = record.parts.silence or (None if record.parts.period_samples else record.parts.noise)
        values = record.accel_m_s2[index, part] if part is not None else np.zeros(0)
        if values.size * dt_s < 1.0 or not np.isfinite(values).all():
            continue
        window = np.hanning(values.size)
        size = 2.0 * np.abs(np.fft.rfft(window * (values - values.mean()))) / window.sum()
        frequency = np.arange(size.size) / (values.size * dt_s)
        for mains in MAINS_HZ:
            at = (np.abs(frequency - mains) <= max(0.2, 1.0 / (values.size * dt_s))) & (frequency < 0.45 / dt_s)
            sides = [size[(way * (frequency - mains) > 2.5) & (way * (frequency - mains) < 6.0)] for way in (-1.0, 1.0)]
            if at.any() and sides[1].size:
                floor = max(float(np.median(side)) for side in sides)  # an excitation may end at the mains frequency
                amplitude = float(size[at].max())
                if amplitude > max(HUM_OVER_FLOOR * floor, HUM_WORTH_SAYING * loud, best[1]):
                    best = (mains, amplitude)
    return best


def hum_warnings(channels: Sequence[ChannelReport]) -> tuple[Finding, ...]:
    """Return a warning for each channel with mains hum."""
    return tuple(
        Finding(
            "channel.hum",
            {"channel": c.name, "hum_hz": c.hum_hz, "hum_m_s2": c.hum_m_s2, "share": c.hum_m_s2 / c.rms_m_s2},
        )
        for c in channels
        if c.hum_hz > 0.0
    )
