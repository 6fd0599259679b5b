"""Are the channels what they say they are, by their responses? Incoherent, swapped, reversed, of wrong sensitivity."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from rths_cli.identification import channels
from rths_cli.identification.fit_table import COMPARED_HZ
from rths_cli.lti import Array, ComplexArray, Frf
from rths_cli.rig_info import RigInfo

LEAST_COHERENCE = 0.9  # median in COMPARED_HZ
LOW_SHARE = 0.5  # of the specimen's first natural frequency: below it all floors move with the table
GAIN_SHARE, FAR_GAIN = 0.1, (0.6, 1.7)  # of the data sheet's gain: said beyond the first, refused outside the second
SLOPE_HZ = 3.0
FLOOR_GAIN_SHARE = 0.05
BAD_CHAIN = 0.2  # share of the storeys' inertia left unexplained
SUSPECT, CURED = 0.12, 0.5  # the share from which exchanges are tried, and the part of it that a true one leaves
HIGHEST_HZ = 30.0
LINES_FOR_A_CURVE, CERTAIN = 8, 2.0


def response_faults(frfs: Sequence[Frf], info: RigInfo, masses_kg: Array) -> list[str]:
    """Return a sentence for each channel that is incoherent, of wrong sign, or in another's place."""
    faults = [
        f"channel {channel.name}: median coherence {channels.coherence(frf):.2f} in {COMPARED_HZ[0]:g}-"
        f"{COMPARED_HZ[1]:g} Hz is below {LEAST_COHERENCE:g}; excite louder or longer, and check the sensor"
        for channel, frf in zip(info.channels, frfs, strict=True)
        if channels.coherence(frf) < LEAST_COHERENCE
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
