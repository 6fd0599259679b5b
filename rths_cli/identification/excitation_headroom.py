"""By what factor the excitation could be louder within the limits, for the verdict's advice."""

from __future__ import annotations

import numpy as np

from rths_cli.identification.excitation import SHARE
from rths_cli.identification.inputs import Evidence
from rths_cli.identification.low_level_probe import CHANNEL_SHARE
from rths_cli.numerics.lti import Array


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
