"""Motions in files that recorders and controllers write: the channels of acceleration of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2
from rths_cli.files.accelerograms.record import Channel, Header, check_moves
from rths_cli.files.measured_data import read_recording
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import shortened


def read(path: Path, dt_s: float | None) -> list[Channel]:
    """Return the channels in a unit of acceleration, or, where there is none, those whose unit is not stated.

    `dt_s` is the interval in s that the case states. Raises InputError as `read_recording` does, for a recording
    without such channels, and for missing samples.
    """
    recording = read_recording(path, dt_s)
    named = list(zip(recording.names, recording.units, recording.samples, strict=True))
    chosen = [each for each in named if each[1] in FACTORS_M_S2] or [each for each in named if not each[1]]
    if not chosen:
        told = ", ".join(f"{shortened(name, 30)} in {unit}" for name, unit, _ in named[:8])
        raise InputError(f"{path}: none of its channels ({told}) is an acceleration; give the measured ground motion")
    done = "; ".join(recording.notes)  # on the way to one clock
    made = (
        (Header(recording.format, unit=unit or None, dt_s=recording.dt_s), name, samples)
        for name, unit, samples in chosen
    )
    return [_channel(path, *each, done, len(chosen) > 1) for each in made]


def _channel(path: Path, header: Header, name: str, samples: Array, done: str, several: bool) -> Channel:
    """Return a channel of which no sample is missing; its name is a component where there are `several`."""
    missing = int(np.sum(~np.isfinite(samples)))
    if missing:
        raise InputError(
            f"{path}: {missing} of {samples.size} samples of {shortened(name, 40)!r} are missing; mend or cut the "
            "record"
        )
    if not several:
        check_moves(path, samples)
    return Channel(header, samples, lambda _: 0, names=(name,) if several else (), corrected=done)
