"""Are the channels what they say they are? Dead, clipped, incoherent, swapped, reversed, humming: each is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.clipping import cut_off_peaks
from rths_cli.identification.fit_table import COMPARED_HZ, within
from rths_cli.identification.record import Record
from rths_cli.lti import Array, ComplexArray, Frf
from rths_cli.rig_info import Channel, RigInfo

LEAST_COHERENCE = 0.9  # median in COMPARED_HZ
DEAD_BITS, DEAD_OVER_SILENCE = 3.0, 3.0
CLIPPED_SHARE = 0.98
MAINS_HZ = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)
HUM_OVER_FLOOR = 10.0
HUM_WORTH_SAYING = 2e-3  # of the excited rms
LOW_SHARE = 0.5  # of the specimen's first natural frequency: below it all floors move with the table
GAIN_SHARE, FAR_GAIN = 0.1, (0.6, 1.7)  # of the data sheet's gain: said beyond the first, refused outside the second
SLOPE_HZ = 3.0
FLOOR_GAIN_SHARE = 0.05
BAD_CHAIN = 0.2  # share of the storeys' inertia left unexplained
SUSPECT, CURED = 0.12, 0.5  # the share from which exchanges are tried, and the part of it that a true one leaves
HIGHEST_HZ = 30.0
LINES_FOR_A_CURVE, CERTAIN = 8, 2.0


@dataclass(frozen=True)
class ChannelReport:
    """What a channel showed under excitation: rms and largest in m/s^2, rms at rest (None: no silence), median
    coherence in 0.7-11 Hz, amplitude of mains hum in m/s^2 at its frequency in Hz (0: none)."""

    name: str
    rms_m_s2: float
    largest_m_s2: float
    rest_rms_m_s2: float | None
    coherence: float
    hum_m_s2: float = 0.0
    hum_hz: float = 0.0


class UnfitRecord(InputError):
    """A record from which no model may be made; `channels` says what was seen."""

    def __init__(self, faults: Sequence[str], channels: tuple[ChannelReport, ...] = ()) -> None:
        super().__init__(*faults)
        self.channels = channels


def signal_faults(record: Record, info: RigInfo) -> list[str]:
    """Return a sentence for each channel of a record that is incomplete, dead, drowned or clipped."""
    faults = _lost("command", record.command_v)
    for channel, accel in zip(info.channels, record.accel_m_s2, strict=True):
        faults += _lost(channel.name, accel) or _signal_faults(channel, accel, info, record)
    return faults


def _lost(name: str, values: Array) -> list[str]:
    """Return a sentence when samples are missing."""
    missing = np.flatnonzero(~np.isfinite(values))
    if not missing.size:
        return []
    return [
        f"channel {name}: {missing.size} of {values.size} samples ({missing.size / values.size:.2%}) are missing, the "
        f"first is number {missing[0]}; a response needs them all, measure again or cut the record"
    ]


def _signal_faults(channel: Channel, accel: Array, info: RigInfo, record: Record) -> list[str]:
    parts = record.parts
    rms = float(accel[parts.noise].std())
    quiet = float(accel[parts.silence].std()) if parts.silence is not None else 0.0
    least = max(DEAD_BITS * info.converters.step_v / channel.sensitivity_v_per_m_s2, 1e-9)
    if rms < least:
        return [
            f"channel {channel.name}: dead, {rms:.2g} m/s^2 rms under excitation where at least {least:.2g} is "
            "expected; check sensor, cable and power"
        ]
    if rms < DEAD_OVER_SILENCE * quiet:
        return [
            f"channel {channel.name}: nothing but noise, {quiet:.2g} m/s^2 rms at rest and {rms:.2g} under excitation; "
            "check sensor and cable, or excite louder"
        ]
    largest = float(np.abs(accel).max())
    if largest > CLIPPED_SHARE * channel.range_m_s2:
        return [
            f"channel {channel.name}: clipped, {largest:.4g} m/s^2 reaches the sensor's range of "
            f"{channel.range_m_s2:.4g}; lower identification.accel_rms_m_s2"
        ]
    tops = cut_off_peaks(accel, channel, info.dt_s, quiet)
    if tops:
        return [
            f"channel {channel.name}: clipped, {tops} of its peaks are cut off at {largest:.4g} m/s^2; "
            "check the range of amplifier and converter, or lower identification.accel_rms_m_s2"
        ]
    return []


def reports(records: Sequence[Record], frfs: Sequence[Frf] | None, info: RigInfo) -> tuple[ChannelReport, ...]:
    """Return what each channel showed; without responses the coherence is not known (NaN)."""
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
                _coherence(frfs[index]) if frfs else float("nan"),
                amplitude,
                frequency,
            )
        )
    return tuple(found)


def _coherence(frf: Frf) -> float:
    return float(np.median(frf.coherence[within(frf.frequency_hz, COMPARED_HZ)]))


def _hum(records: Sequence[Record], index: int, dt_s: float, loud: float) -> tuple[float, float]:
    """Return frequency and amplitude of the strongest mains line at rest, or else in excitation without lines."""
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


def hum_warnings(channels: Sequence[ChannelReport]) -> tuple[str, ...]:
    """Return a sentence for each channel that hums."""
    return tuple(
        f"channel {c.name}: {c.hum_hz:g} Hz hum of {c.hum_m_s2:.2g} m/s^2 amplitude ({c.hum_m_s2 / c.rms_m_s2:.1%} of "
        "the excited rms); lines at the mains frequency carry little weight, check shielding and ground loops"
        for c in channels
        if c.hum_hz > 0.0
    )


def response_faults(frfs: Sequence[Frf], info: RigInfo, masses_kg: Array) -> list[str]:
    """Return a sentence for each channel that is incoherent, of wrong sign, or in another's place."""
    faults = [
        f"channel {channel.name}: median coherence {_coherence(frf):.2f} in {COMPARED_HZ[0]:g}-{COMPARED_HZ[1]:g} Hz "
        f"is below {LEAST_COHERENCE:g}; excite louder or longer, and check the sensor"
        for channel, frf in zip(info.channels, frfs, strict=True)
        if _coherence(frf) < LEAST_COHERENCE
    ]
    if faults:
        return faults
    return _reversed_roles(frfs, info) or _signs(frfs, info) or _order(frfs, info, masses_kg)


def gain_faults(table: Frf, floors: Sequence[Frf], info: RigInfo) -> list[str]:
    """Return a sentence for each channel whose sensitivity is wrong; `table` is without the staircase alias."""
    return _floor_gains((table, *floors), info)


def far_gain(low_frequency_gain_m_per_v: float, info: RigInfo) -> tuple[str, ...]:
    """Return why a model is refused whose gain is nowhere near the data sheet's."""
    ratio = abs(low_frequency_gain_m_per_v) / info.gain_m_per_v
    if FAR_GAIN[0] <= ratio <= FAR_GAIN[1]:
        return ()
    return (
        f"table: moves {1e3 * abs(low_frequency_gain_m_per_v):.3g} mm/V, {ratio:.3g} times nominal.gain_m_per_v; a "
        "unit (g for m/s^2, mV for V), the sample rate, a sensor's corner or the data sheet's gain is wrong",
    )


def _reversed_roles(frfs: Sequence[Frf], info: RigInfo) -> list[str]:
    """Return a sentence when the table falls with frequency as a command should: it is one, or a displacement."""
    low = frfs[0].frequency_hz <= SLOPE_HZ
    slope = np.polyfit(np.log(frfs[0].frequency_hz[low]), np.log(np.abs(frfs[0].response[low])), 1)[0]
    if slope > 0.0:
        return []
    return [
        f"channels command and {info.channels[0].name}: they look swapped; table over command falls as f^{slope:.1f} "
        "at low frequency, where an acceleration over a displacement's command rises as f^2"
    ]


def _low_lines(frfs: Sequence[Frf]) -> tuple[np.ndarray, float]:
    """Tell which lines lie below half the specimen's first natural frequency, and what that is in Hz."""
    f = frfs[0].frequency_hz
    first = min((_first_mode_hz(f, frf.response / frfs[0].response) for frf in frfs[1:]), default=HIGHEST_HZ)
    low = f <= LOW_SHARE * first
    low[:3] = True
    low[30:] &= f[30:] <= 2.0
    return low, first


def _first_mode_hz(frequency_hz: Array, over_table: ComplexArray) -> float:
    """Return where a floor's motion over the table's (m,) first lags an eighth of a turn behind, on two lines on end.

    Lighter damping makes a higher mode the largest; every floor moves with the table until the first mode.
    """
    upright = np.sign(np.median(over_table[:3].real)) or 1.0
    late = np.append(upright * over_table.real < np.abs(over_table.imag), True)
    return float(frequency_hz[min(np.flatnonzero(late[:-1] & late[1:]), default=len(frequency_hz) - 1)])


def _signs(frfs: Sequence[Frf], info: RigInfo) -> list[str]:
    """Return a sentence for each channel that moves against the command at low frequency."""
    low, _ = _low_lines(frfs)
    s2 = -((2.0 * np.pi * frfs[0].frequency_hz[low]) ** 2)
    against = [bool(np.median((frf.response[low] / s2).real) < 0.0) for frf in frfs]
    if all(against):
        return ["command: every channel moves against it; its polarity is reversed (or that of all sensors)"]
    return [
        f"channel {channel.name}: wrong sign, at low frequency it moves against the command and the other channels; "
        "turn the sensor round or reverse the channel's sign"
        for channel, wrong in zip(info.channels, against, strict=True)
        if wrong
    ]


def _order(frfs: Sequence[Frf], info: RigInfo, masses_kg: Array) -> list[str]:
    """Return a sentence when floors do not carry each other's inertia, and which exchange of channels cures it."""
    if len(frfs) < 2:
        return []
    f = frfs[0].frequency_hz
    inside = (f <= HIGHEST_HZ) & np.all([frf.coherence >= LEAST_COHERENCE for frf in frfs], axis=0)
    motion = np.array([frf.response[inside] for frf in frfs])
    here = chain_residual(f[inside], motion, masses_kg)
    if here < SUSPECT:
        return []
    best, pair = here, None
    for i, j in combinations(range(len(frfs)), 2):
        order = list(range(len(frfs)))
        order[i], order[j] = j, i
        left = chain_residual(f[inside], motion[order], masses_kg)
        if left < best:
            best, pair = left, (i, j)
    if pair is not None and best < CURED * here:
        one, other = (info.channels[k].name for k in pair)
        return [
            f"channels {one} and {other}: they look swapped; exchanged, {best:.1%} of the storeys' inertia is "
            f"unexplained, as they are {min(here, 9.99):.0%}; check the cables"
        ]
    if here < BAD_CHAIN:
        return []
    return _floor_gains(frfs, info) or [
        f"floors: {min(here, 9.99):.0%} of the storeys' inertia does not fit a chain of storeys with the given masses; "
        "check order, sensitivities and masses of the floors"
    ]


def chain_residual(frequency_hz: Array, motion: ComplexArray, masses_kg: Array) -> float:
    """Return how much of the storeys' inertia no spring and dashpots explain, relative; rows: table, then floors.

    A storey carries the inertia of the floors above: sum m a = -k drift - sum over all storeys of s c drift, for modal
    damping couples the storeys. A negative stiffness counts as explaining nothing.
    """
    s = 2j * np.pi * frequency_hz
    drifts = np.diff(motion, axis=0) / s**2
    left, total = 0.0, 0.0
    for i in range(len(masses_kg)):
        inertia = np.asarray(masses_kg)[i:] @ motion[i + 1 :]
        columns = np.column_stack([drifts[i], *(s * drifts)])
        stacked = np.vstack([columns.real, columns.imag])
        wanted = -np.concatenate([inertia.real, inertia.imag])
        found = np.linalg.lstsq(stacked, wanted, rcond=None)[0]
        total += float(wanted @ wanted)
        unexplained = wanted - stacked @ found
        left += float(unexplained @ unexplained) if found[0] > 0.0 else float(wanted @ wanted)
    return float(np.sqrt(left / total)) if total > 0.0 else 1.0


def _floor_gains(frfs: Sequence[Frf], info: RigInfo) -> list[str]:
    """Return a sentence for each floor, or the table, whose motions do not go over into each other at low frequency."""
    gains, errors = floor_gains(frfs)
    off = np.abs(gains - 1.0) > FLOOR_GAIN_SHARE + CERTAIN * errors
    if len(gains) > 1 and off.all() and float(np.ptp(gains)) < FLOOR_GAIN_SHARE * float(np.mean(gains)):
        return [
            f"channel {info.channels[0].name}: reads {1.0 / float(np.mean(gains)):.3f} times every floor at zero "
            "frequency, where they move as one; check its sensitivity"
        ]
    return [
        f"channel {channel.name}: reads {gain:.3f} times the table at zero frequency, where floor and table "
        "move as one; check the sensitivity of both channels"
        for channel, gain, wrong in zip(info.channels[1:], gains, off, strict=True)
        if wrong
    ]


def floor_gains(frfs: Sequence[Frf]) -> tuple[Array, Array]:
    """Return what each floor reads over what the table reads at zero frequency, (n,), and its standard error (n,).

    Below the first mode, floor / table times 1 - (f / first mode)^2 has no pole: it is a + b f^2, nearly.
    """
    low, first = _low_lines(frfs)
    f2 = frfs[0].frequency_hz[low] ** 2
    powers = np.vander(f2, 3 if low.sum() > LINES_FOR_A_CURVE else 2, increasing=True)
    table, smooth = frfs[0].response[low], 1.0 - f2 / first**2
    # what is left of the staircase alias turns table / floor, but hardly changes its real part
    ratios = np.array([smooth / (table / frf.response[low]).real for frf in frfs[1:]]).reshape(-1, len(f2))
    inverse = np.linalg.pinv(powers)
    found = ratios @ inverse.T
    left = ratios - found @ powers.T
    spread = np.linalg.norm(left, axis=1) / np.sqrt(max(len(f2) - powers.shape[1], 1))
    return found[:, 0], spread * float(np.linalg.norm(inverse[0]))


def gain_warnings(low_frequency_gain_m_per_v: float, info: RigInfo) -> tuple[str, ...]:
    """Return a sentence when the table's gain is far from the data sheet's."""
    ratio = abs(low_frequency_gain_m_per_v) / info.gain_m_per_v
    if abs(ratio - 1.0) <= GAIN_SHARE or not FAR_GAIN[0] <= ratio <= FAR_GAIN[1]:
        return ()
    return (
        f"table: moves {1e3 * abs(low_frequency_gain_m_per_v):.3g} mm/V at low frequency, the data sheet says "
        f"{1e3 * info.gain_m_per_v:.3g}; check sensitivity and unit of table and command, or nominal.gain_m_per_v",
    )
