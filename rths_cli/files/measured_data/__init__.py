"""Measured time histories from files of recorders, controllers and programs: one reader; nothing is guessed.

What is wrong with a file is said in one sentence per fault; what is missing in it is NaN, named by `missing` and,
where a short gap allows it, bridged by `mend`. `choose` finds the channels an identification needs.
"""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import read_whole
from rths_cli.files.foreign_texts import lost_scans
from rths_cli.files.measured_data.channel_roles import Chosen, RunChannels, choose, choose_of_run
from rths_cli.files.measured_data.file_formats import READ, is_recorded, read_contents
from rths_cli.files.measured_data.hdf5_files import write_recording
from rths_cli.files.measured_data.recording import (
    Clock,
    Column,
    Contents,
    Recording,
    aligned,
    choose_interval,
    differ,
    mend,
    missing,
    read_clock,
    shifts,
)
from rths_cli.files.measured_data.time_bases import at_one_rate, with_own_clocks
from rths_cli.files.measured_data.units import OF_A_RUN, is_time, role_of, unit_of
from rths_cli.numerics.lti import Array
from rths_cli.safe_text import LONGEST_NAME, shortened

__all__ = [
    "Chosen", "Recording", "RunChannels", "choose", "choose_of_run", "is_recorded", "mend", "missing",
    "read_recording", "role_of", "write_recording",
]  # fmt: skip

MAX_BYTES = 1_000_000_000
LEAST_SAMPLES = 3


def read_recording(path: Path, dt_s: float | None = None) -> Recording:
    """Read the channels of a file with their units and their interval; `dt_s` in s where the file does not state it.

    Gaps of whole samples in a time column become NaN, as do infinite samples. Channels with clocks of their own are
    brought to one rate and start (`time_bases.at_one_rate`, `recording.aligned`). Raises InputError, with the line of a
    text, for a file that is none of the formats, is damaged, holds channels of unequal length or of starts that cannot
    be brought together, an uneven time, no interval, or one that contradicts `dt_s` by more than 1e-6.
    """
    path = Path(path)
    data = read_whole(path, MAX_BYTES, "a recording", f"give measured time histories: {READ}")
    contents = read_contents(path, data)
    contents = with_own_clocks(path, contents)
    columns, time, faults = _time_and_channels(path, contents)
    clock: Clock | None = None
    interval = 0.0
    if time is not None and differ(columns):
        faults.append(
            f"{path}: has a time column and states other starts of its channels ({shifts(columns)}); remove what is "
            "not true, or export all channels with one start"
        )
    rates = {column.dt_s for column in columns}
    if time is not None or not (differ(columns) or len(rates) > 1):
        faults += _length_faults(path, columns if time is None else (*columns, time))
    try:
        if time is not None and not faults:
            with np.errstate(all="ignore"):  # absurd times overflow on the way to their sentence
                clock = read_clock(path, contents, time)
        if time is None or clock is not None:
            interval = choose_interval(path, contents, clock, dt_s)
    except InputError as fault:
        faults += fault.faults
    if faults:
        raise InputError(*faults)
    starts, steps = tuple(c.start_s for c in columns), tuple(c.dt_s for c in columns)
    columns, lost = _without_lost_scans(columns)
    columns, slowed = at_one_rate(path, columns, interval)
    columns, moved = aligned(path, columns, interval)
    samples, infinite = _without_infinite(columns, _spread(np.stack([c.values for c in columns]), clock))
    units, doubts = _units(columns, contents.exact)
    notes = (*contents.notes, *(clock.notes if clock else ()), *lost, *slowed, *moved, *doubts, *infinite)
    names = tuple(c.name for c in columns)
    sha256 = hashlib.sha256(data).hexdigest()
    return Recording(path, sha256, interval, names, units, samples, notes, contents.format, starts, steps)


def _time_and_channels(path: Path, contents: Contents) -> tuple[tuple[Column, ...], Column | None, list[str]]:
    """Return the channels, the time column (None if there is none), and sentences on what is wrong with them."""
    long = [column for column in contents.columns if len(column.name) > LONGEST_NAME]
    short = [column for column in contents.columns if len(column.name) <= LONGEST_NAME]
    times = [] if contents.exact else [column for column in short if is_time(column.name)]
    channels = tuple(c for c in contents.columns if not any(c is time for time in times))
    faults = [
        f"{path}: the channel {shortened(c.name, 60)!r} has a name of {len(c.name)} characters, at most {LONGEST_NAME}"
        for c in long
    ]
    if any(not np.array_equal(times[0].values, other.values, equal_nan=True) for other in times[1:]):
        starts = ", ".join(f"{time.name!r} starts at {time.values[0]:.9g}" for time in times if time.values.size)
        faults.append(f"{path}: has {len(times)} time columns that differ ({starts}); give one time for all channels")
    if not channels:
        faults.append(f"{path}: holds no channel beside the time; give the command and the measured accelerations")
    return channels, times[0] if times else None, faults


def _length_faults(path: Path, columns: tuple[Column, ...]) -> list[str]:
    """Return a sentence where channels have unequal or too few samples."""
    lengths = {len(column.values) for column in columns}
    if len(lengths) > 1:
        every = ", ".join(f"{c.name} {len(c.values)}" for c in columns)
        return [f"{path}: the channels have unequal numbers of samples ({every}); export them over the same time"]
    if lengths and max(lengths) < LEAST_SAMPLES:
        return [f"{path}: holds {max(lengths)} samples; a recording needs at least {LEAST_SAMPLES}"]
    return []


def _spread(samples: Array, clock: Clock | None) -> Array:
    """Return the samples (c, n) with NaN where the time column jumps over samples."""
    if clock is None or clock.index[-1] == samples.shape[1] - 1:
        return samples
    spread = np.full((samples.shape[0], int(clock.index[-1]) + 1), np.nan)
    spread[:, clock.index] = samples
    return spread


def _without_lost_scans(columns: tuple[Column, ...]) -> tuple[tuple[Column, ...], list[str]]:
    """Return the channels with NaN where a recorder wrote -9999 for a lost scan, and a sentence for each with any."""
    found, notes = [], []
    for column in columns:
        lost = lost_scans(column.values)
        if lost.any():
            count = int(lost.sum())
            which = "1 sample reads" if count == 1 else f"{count} samples read"
            notes.append(f"{column.name}: {which} exactly -9999, as recorders write for lost scans; taken as missing")
        found.append(replace(column, values=np.where(lost, np.nan, column.values)) if lost.any() else column)
    return tuple(found), notes


def _without_infinite(columns: tuple[Column, ...], samples: Array) -> tuple[Array, list[str]]:
    """Return the samples with NaN for infinite ones, and a sentence for every channel that has any."""
    infinite = np.isinf(samples)
    counts = infinite.sum(axis=1)
    notes = [
        f"{column.name}: {count} samples are infinite (overload) and taken as missing"
        for column, count in zip(columns, counts, strict=True)
        if count
    ]
    return (np.where(infinite, np.nan, samples) if notes else samples), notes


def _exact_unit(column: Column) -> tuple[str, str]:
    """Return a channel's unit as the project's own form states it; "" and a sentence for one that no channel has."""
    if column.unit in ("", *OF_A_RUN):
        return column.unit, ""
    return "", f"channel {column.name!r}: the unit {column.unit!r} is not known"


def _units(columns: tuple[Column, ...], exact: bool) -> tuple[tuple[str, ...], list[str]]:
    """Return the canonical unit of every channel, "" where it is not known, and sentences on doubts."""
    pairs = [_exact_unit(column) if exact else unit_of(column.name, column.unit) for column in columns]
    return tuple(unit for unit, _ in pairs), [doubt for _, doubt in pairs if doubt]
