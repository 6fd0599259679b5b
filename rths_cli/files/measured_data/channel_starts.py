"""Channels of one recording that start at different times: put on one clock by what the file states, or refused."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.measured_data.recording import Column
from rths_cli.numerics.lti import Array

WHOLE = 1e-3  # of a sample: a start that is so near to another's samples is one of them
ROUNDING_S = 1e-6  # of stated times
MOST = 10_000  # channels of one file
TAPS = 32  # samples on either side of which a value between two is made
BETA = 9.0  # of the Kaiser window over them: 1e-4 below 0.85 of half the sample rate
_STARTS = {"t0", "tstart", "starttime", "starttimes", "startoffset", "startoffsets", "timeoffset", "timeoffsets"}
_STARTS |= {"wfstartoffset", "wfstarttime", "xstart", "x0", "start", "starts"}


def states_start(name: str) -> bool:
    """Say whether a property such as `wf_start_offset`, `start_time` or `t0` states when a channel starts."""
    return re.sub(r"[^a-z0-9]", "", name.lower()) in _STARTS


def start_of(value: object) -> float | None:
    """Return a stated start in s, of a number or of a date and time (ISO 8601); None where it is neither."""
    if isinstance(value, str):
        try:
            return datetime.fromisoformat(value.strip().replace("Z", "+00:00")).timestamp()
        except ValueError:
            pass
    try:
        found = float(np.asarray(value).reshape(-1)[0]) if np.size(value) == 1 else np.nan  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None
    return found if np.isfinite(found) else None


def differ(columns: Sequence[Column]) -> bool:
    """Say whether the channels state starts that are not all one; a channel that states none agrees with 0 only."""
    stated = {column.start_s for column in columns}
    if None in stated:
        return len(stated) > 1 and stated != {0.0, None}
    return max(stated, default=0.0) - min(stated, default=0.0) > ROUNDING_S  # type: ignore[operator, type-var]


def numbers_of(value: object) -> tuple[float, ...]:
    """Return stated starts in s, one or one per channel; () where they are none."""
    if isinstance(value, str | bytes) or np.ndim(value) == 0:  # type: ignore[arg-type]
        found = start_of(value.decode(errors="replace") if isinstance(value, bytes) else value)
        return () if found is None else (found,)
    every = [start_of(each) for each in np.asarray(value).reshape(-1)[:MOST].tolist()]
    return () if None in every else tuple(each for each in every if each is not None)


def shifts(columns: Sequence[Column]) -> str:
    """Return the starts of the channels after the first one, in ms, as text."""
    first = min(column.start_s or 0.0 for column in columns)
    told = [f"{column.name} {1e3 * ((column.start_s or 0.0) - first):.6g} ms" for column in columns]
    return ", ".join(told[:12]) + (f" and {len(told) - 12} more" if len(told) > 12 else "")


def aligned(path: Path, columns: tuple[Column, ...], dt_s: float) -> tuple[tuple[Column, ...], tuple[str, ...]]:
    """Return the channels on the samples at which most of them are taken, cut to the time that all share, and a note.

    A channel that starts whole samples later is moved by them. Any other is interpolated (windowed sinc of 64 samples,
    1e-4 below 0.85 of half the sample rate). Raises InputError, with the starts, where a channel states none, they
    share too little time, or samples are missing in a channel that has to be interpolated.
    """
    if not differ(columns):
        return columns, ()
    silent = [column.name for column in columns if column.start_s is None]
    if silent:
        raise InputError(
            f"{path}: the channels {', '.join(silent[:12])} state no start, the others do and differ "
            f"({shifts([c for c in columns if c.start_s is not None])}); export all channels with one start"
        )
    starts = np.array([column.start_s for column in columns], dtype=float)
    places = (starts - starts.min()) / dt_s  # in samples
    wanted = Counter(np.round(places % 1.0, 3) % 1.0).most_common(1)[0][0]
    whole = np.rint(places - wanted).astype(int)
    fraction = places - wanted - whole  # of a sample, by which a channel is late on the common samples
    fraction[np.abs(fraction) <= max(WHOLE, ROUNDING_S / dt_s)] = 0.0
    margins = np.where(fraction != 0.0, TAPS, 0)
    lengths = np.array([len(column.values) for column in columns])
    if not whole.any() and not fraction.any() and lengths.min() == lengths.max():
        return columns, ()
    first, end = int((whole + margins).max()), int((whole + lengths - margins).min())
    if end - first < 3:
        raise InputError(
            f"{path}: the channels start at different times ({shifts(columns)}) and share {max(end - first, 0)} "
            "samples; give channels that were measured together"
        )
    moved = []
    for column, at, late in zip(columns, whole, fraction, strict=True):
        if late and not np.isfinite(column.values).all():
            raise InputError(
                f"{path}: {column.name} starts between the samples of the others ({shifts(columns)}) and has missing "
                "samples, between which nothing can be interpolated; export all channels with one start"
            )
        values = (
            column.values[first - at : end - at] if not late else _between(column.values, late, first - at, end - at)
        )
        moved.append(replace(column, values=values, start_s=None))
    how = "interpolated between samples" if fraction.any() else "moved by whole samples"
    lost = int(lengths.max()) - (end - first)
    return tuple(moved), (
        f"the channels start at different times ({shifts(columns)}): {how}, {lost} samples at the ends are not shared",
    )


def _between(values: Array, late: float, first: int, end: int) -> Array:
    """Return a channel (n,) whose samples are `late` samples after the common ones, at those from `first` to `end`."""
    taps = np.arange(-TAPS, TAPS + 1)
    window = np.i0(BETA * np.sqrt(np.clip(1.0 - ((taps + late) / (TAPS + 1)) ** 2, 0.0, 1.0))) / np.i0(BETA)
    weights = np.sinc(taps + late) * window
    # the value at sample i is the sum over k of values[i + k] sinc(k + late)
    return np.convolve(values, (weights / weights.sum())[::-1], "full")[TAPS + first : TAPS + end]
