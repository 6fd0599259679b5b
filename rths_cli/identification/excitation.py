"""Excitation plans: loud, shaped noise for the frequency responses, then a burst that leaves a free vibration.

Planned with data-sheet values only: acceleration = nominal gain times the command's second derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.record import Parts
from rths_cli.lti import Array
from rths_cli.rig_info import RigInfo

FLAT_HZ, CORNER_HZ = 0.7, 12.0  # the command is flat below the first, falls as f^-1.5, above the second as f^-3.5
SHARE = 0.6  # of each limit that a plan may use
AMPLIFICATION = 2.0  # floors over table: margin of floor sensors
SILENCE_S, FADE_S, BURST_S, BURST_FADE_S, HOLD_S = 2.0, 2.0, 4.0, 0.3, 16.0
BURST_BAND_HZ = (1.0, 15.0)
LEAST_ACCEL_BITS = 100.0
LEAST_DURATION_S = 40.0


@dataclass(frozen=True)
class ExcitationSettings:
    """What may be asked of an excitation: duration of the noise, its nominal acceleration and its band."""

    duration_s: float = 120.0
    accel_rms_m_s2: float = 2.0
    low_hz: float = 0.3
    high_hz: float = 60.0


@dataclass(frozen=True)
class Excitation:
    """A planned command (n,) in V with its parts; `accel_rms_m_s2` is the nominal level of the noise.

    `notes` are sentences for the user, for instance that the level was scaled down to a limit.
    """

    command_v: Array
    dt_s: float
    parts: Parts
    accel_rms_m_s2: float
    notes: tuple[str, ...] = ()


def plan(info: RigInfo, settings: ExcitationSettings, seed: int) -> Excitation:
    """Plan silence, noise, a burst and a hold for a rig, rounded to the bits of its command converter.

    The noise is scaled down, and a note says so, when stroke, velocity, acceleration or force would take more
    than 60 % of their limits. Raises InputError when the settings cannot be met.
    """
    check(info, settings)
    random = np.random.default_rng(seed)
    dt = info.dt_s
    noise = faded(shaped_noise(settings.duration_s, dt, settings.low_hz, settings.high_hz, random), FADE_S, dt)
    burst = faded(shaped_noise(BURST_S, dt, *burst_band(settings), random), BURST_FADE_S, dt)
    level, notes = reachable_level(info, noise, settings.accel_rms_m_s2)
    noise = noise * level / accel_rms(noise, info)
    burst = burst * min(level / accel_rms(burst, info), largest_scale(info, burst)[0])
    pieces = (np.zeros(round(SILENCE_S / dt)), noise, np.zeros(round(0.5 / dt)), burst, np.zeros(round(HOLD_S / dt)))
    ends = np.cumsum([len(piece) for piece in pieces])
    parts = Parts(slice(int(ends[0]), int(ends[1])), slice(0, int(ends[0])), slice(int(ends[3]), int(ends[4])))
    return Excitation(rounded(np.concatenate(pieces), info.converters.step_v), dt, parts, level, notes)


def check(info: RigInfo, settings: ExcitationSettings) -> None:
    """Raise one InputError with every setting that is out of range."""
    faults = []
    nyquist = 0.5 / info.dt_s
    if not 0.05 <= settings.low_hz <= 1.0:
        faults.append(f"identification.low_hz: {settings.low_hz:g} Hz must be between 0.05 and 1 Hz")
    if not 2.0 * CORNER_HZ <= settings.high_hz <= 0.4 * nyquist:
        faults.append(
            f"identification.high_hz: {settings.high_hz:g} Hz must be between {2.0 * CORNER_HZ:g} Hz and "
            f"{0.4 * nyquist:g} Hz (0.4 of half the sample rate)"
        )
    if not LEAST_DURATION_S <= settings.duration_s <= 3600.0:
        faults.append(
            f"identification.duration_s: {settings.duration_s:g} s must be between {LEAST_DURATION_S:g} and 3600 s"
        )
    if not settings.accel_rms_m_s2 > 0.0:
        faults.append(f"identification.accel_rms_m_s2: {settings.accel_rms_m_s2:g} m/s^2 must be positive")
    if faults:
        raise InputError(*faults)


def burst_band(settings: ExcitationSettings) -> tuple[float, float]:
    """Return the band of the burst in Hz, inside that of the noise."""
    return max(BURST_BAND_HZ[0], settings.low_hz), min(BURST_BAND_HZ[1], settings.high_hz)


def shaped_noise(duration_s: float, dt_s: float, low_hz: float, high_hz: float, random: np.random.Generator) -> Array:
    """Return Gaussian noise (n,) without unit: flat to 0.7 Hz, falling as f^-1.5 to 12 Hz and as f^-3.5 above."""
    n = round(duration_s / dt_s)
    f = np.fft.rfftfreq(n, dt_s)
    inside = (f >= low_hz) & (f <= high_hz)
    shape = np.zeros(len(f))
    shape[inside] = np.maximum(f[inside] / FLAT_HZ, 1.0) ** -1.5 * np.maximum(f[inside] / CORNER_HZ, 1.0) ** -2
    spectrum = shape * (random.standard_normal(len(f)) + 1j * random.standard_normal(len(f)))
    return np.fft.irfft(spectrum, n)


def faded(signal: Array, fade_s: float, dt_s: float) -> Array:
    """Return the signal (n,) with raised-cosine ends, so that it starts and ends at zero with zero slope."""
    n = round(fade_s / dt_s)
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / n)
    return signal * np.concatenate([rise, np.ones(len(signal) - 2 * n), rise[::-1]])


def nominal_accel(command_v: Array, info: RigInfo) -> Array:
    """Return the nominal table acceleration (n,) in m/s^2: gain times the command's second derivative."""
    return info.gain_m_per_v * np.diff(command_v, 2, prepend=0.0, append=0.0) / info.dt_s**2


def accel_rms(command_v: Array, info: RigInfo) -> float:
    """Return the rms below 12 Hz of the nominal table acceleration in m/s^2 (above, no table follows its command)."""
    amplitude = np.fft.rfft(nominal_accel(command_v, info)) / len(command_v)
    below = np.fft.rfftfreq(len(command_v), info.dt_s) <= CORNER_HZ
    return float(np.sqrt(2.0 * np.sum(np.abs(amplitude[below]) ** 2)))


def largest_scale(info: RigInfo, command_v: Array) -> tuple[float, str]:
    """Return the factor that brings a command to 60 % of the first limit it meets, and that limit's name."""
    accel = np.abs(nominal_accel(command_v, info)).max()
    velocity = info.gain_m_per_v * np.abs(np.diff(command_v)).max() / info.dt_s
    mass = info.moving_mass_kg + info.specimen_mass_kg
    sensor = min(channel.range_m_s2 for channel in info.channels) / AMPLIFICATION
    reach = {
        "stroke": info.limits.stroke_m / (info.gain_m_per_v * np.abs(command_v).max()),
        "velocity": info.limits.velocity_m_s / velocity,
        "acceleration": info.limits.acceleration_m_s2 / AMPLIFICATION / accel,
        "sensor range": sensor / accel,
        "force": info.limits.force_n / (mass * accel),
        "command range": info.converters.range_v / np.abs(command_v).max(),
    }
    first = min(reach, key=lambda name: float(reach[name]))
    return SHARE * float(reach[first]), first


def reachable_level(info: RigInfo, noise: Array, wanted_m_s2: float) -> tuple[float, tuple[str, ...]]:
    """Return the noise level in m/s^2 rms that the limits allow, up to the wanted one, and a note when it is less.

    Raises InputError when what is allowed would drown in the bits of the accelerometers.
    """
    scale, limit = largest_scale(info, noise)
    allowed = scale * accel_rms(noise, info)
    bit = max(info.converters.step_v / channel.sensitivity_v_per_m_s2 for channel in info.channels)
    least = LEAST_ACCEL_BITS * bit
    if min(allowed, wanted_m_s2) < least:
        raise InputError(
            f"identification.accel_rms_m_s2: {min(allowed, wanted_m_s2):.2g} m/s^2 (asked {wanted_m_s2:g}, at most "
            f"{allowed:.2g} within {SHARE:.0%} of the {limit} limit) is below {least:.2g} m/s^2, {LEAST_ACCEL_BITS:g} "
            "bits of the accelerometers; raise the level or the limit, or use a finer converter"
        )
    if wanted_m_s2 <= allowed:
        return wanted_m_s2, ()
    note = f"excitation scaled down from {wanted_m_s2:g} to {allowed:.2f} m/s^2 rms: {SHARE:.0%} of the {limit} limit"
    return allowed, (note,)


def rounded(command_v: Array, step_v: float) -> Array:
    """Return the command (n,) in V rounded to the converter's bits, so that the one played is the one known."""
    return np.round(command_v / step_v) * step_v if step_v > 0.0 else command_v
