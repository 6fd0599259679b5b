"""`rths data`: what is understood of a recording, before anything is computed from it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from rths_cli.files.measured_data import Recording, role_of
from rths_cli.identification.channel_signals import flat_tops
from rths_cli.loop.guard import STUCK_S
from rths_cli.numerics.lti import Array
from rths_cli.report.document import Block, Column, Document, Line, by_columns
from rths_cli.report.numbers import json_data, three
from rths_cli.report.to_text import width, wrapped
from rths_cli.safe_text import shortened

MOVING = 0.5  # of its own rms: another channel that moves so much shows that a constant one is stuck
ROLES = ("command", "table", "ground", "desired", "base_shear")  # beside floor_N and floor_N_displacement
MOST_LINES, LEAST_ROOM = 20, 5  # of a page where the channels allow it; of its sentences


@dataclass(frozen=True)
class JudgedChannel:
    """What is known of a channel; `start_s` and `rate_hz` as the file states them for it, None where it does not."""

    name: str
    role: str  # command, table, floor_2, ...; "" where the name speaks of none
    unit: str  # "" where it is not known
    start_s: float | None
    rate_hz: float | None
    missing: int  # samples
    clipped_peaks: int
    stuck_s: float  # longest time without any change while another channel moves, 0 below 0.5 s
    mean: float  # in its unit, as is the peak: the largest distance from 0
    peak: float


@dataclass(frozen=True)
class JudgedRecording:
    """A recording and its channels; `doubts` are sentences on what may be wrong, before the notes of its reading."""

    recording: Recording
    channels: tuple[JudgedChannel, ...]
    doubts: tuple[str, ...]


def judge(recording: Recording) -> JudgedRecording:
    """Return what is known of a recording's channels from their samples (c, n) alone."""
    places = [role_of(name) for name in recording.names]
    roles = [role if _is_role(role) and places.count(role) == 1 else "" for role in places]
    with np.errstate(all="ignore"):  # absurd samples overflow
        stuck = _stuck_s(recording.samples, recording.dt_s)
        channels = tuple(_channel(recording, k, roles[k], stuck[k]) for k in range(len(roles)))
    return JudgedRecording(recording, channels, _doubts(channels, recording.samples.shape[1]))


def _is_role(role: str) -> bool:
    return role in ROLES or role.startswith("floor_")


def _channel(recording: Recording, index: int, role: str, stuck_s: float) -> JudgedChannel:
    values = recording.samples[index]
    known = values[np.isfinite(values)]
    start = recording.starts_s[index] if recording.starts_s else None
    step = recording.steps_s[index] if recording.steps_s else None
    return JudgedChannel(
        name=recording.names[index],
        role=role,
        unit=recording.units[index],
        start_s=start,
        rate_hz=1.0 / step if step else None,
        missing=int(values.size - known.size),
        clipped_peaks=_clipped(known),
        stuck_s=stuck_s,
        mean=float(known.mean()) if known.size else float("nan"),
        peak=float(np.abs(known).max()) if known.size else float("nan"),
    )


def _clipped(values: Array) -> int:
    """Return the number of clipped peaks of a signal (n,) about its mean, its smallest step taken as one bit."""
    steps = np.diff(np.unique(values))
    if steps.size < 2:  # one value or two: nothing has a peak
        return 0
    return flat_tops(values - values.mean(), bit_m_s2=float(steps.min()))


def _stuck_s(samples: Array, dt_s: float) -> list[float]:
    """Return for each channel (c, n) the longest time in s without any change in which another channel moves."""
    filled = np.where(np.isfinite(samples), samples, 0.0)
    powers = (filled - filled.mean(axis=1, keepdims=True)) ** 2
    sums = np.concatenate([np.zeros((len(samples), 1)), np.cumsum(powers, axis=1)], axis=1)
    moving = MOVING**2 * powers.mean(axis=1)
    longest = []
    for k, values in enumerate(samples):
        edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1, [values.size]])
        found = 0.0
        for start, end in pairwise(edges):
            others = (sums[:, end] - sums[:, start]) / max(int(end - start), 1) > moving
            others[k] = False
            if (end - start) * dt_s >= STUCK_S and others.any():
                found = max(found, float(end - start) * dt_s)
        longest.append(found)
    return longest


def _doubts(channels: Sequence[JudgedChannel], count: int) -> tuple[str, ...]:
    """Return a sentence for each kind of doubt, with the channels that it concerns."""
    kinds: list[tuple[str, Callable[[JudgedChannel], bool]]] = [
        ("stuck (no change while others move; sensor, cable, converter)", lambda c: c.stuck_s > 0.0),
        ("clipped (range of amplifier or converter)", lambda c: c.clipped_peaks > 0),
        (f"more than 0.1 % of {count} samples missing", lambda c: c.missing > 1e-3 * count),
        ("unit not known, state it below", lambda c: not c.unit),
        ("no role (command, table, floor_2, ...), state it below", lambda c: not c.role),
    ]
    found = [(what, [c.name for c in channels if holds(c)]) for what, holds in kinds]
    return tuple(f"{what}: {', '.join(names)}" for what, names in found if names)


def channels_yaml(channels: Sequence[JudgedChannel]) -> str:
    """Return the YAML that `rths identify` and `rths evaluate` read by --channel channels.yaml: role: [name, unit]."""
    entries = []
    for place, channel in enumerate(channels, 1):
        words = [channel.name, *([channel.unit] if channel.unit else [])]
        entries.append(f"{channel.role or f'role_{place}'}: {json.dumps(words, ensure_ascii=False)}")
    lines = ["channels: {"]
    for entry, end in zip(entries, [", "] * (len(entries) - 1) + ["}"], strict=True):
        if len(lines[-1] + entry + end) > width() and not lines[-1].endswith("{"):
            lines.append("  ")
        lines[-1] += entry + end
    return "\n".join(line.rstrip() for line in lines)


def as_document(judged: JudgedRecording) -> Document:
    """Return the page: verdict and size first, a row for each channel, doubts and notes, the YAML."""
    recording, channels = judged.recording, judged.channels
    count = recording.samples.shape[1]
    verdict = "doubtful" if judged.doubts else "readable"
    what = "1 channel" if len(channels) == 1 else f"{len(channels)} channels"
    size = (
        f"{recording.path.name}, {recording.format}, {what}, {count} samples at "
        f"{1.0 / recording.dt_s:.9g} Hz ({count * recording.dt_s:.6g} s)"
    )
    yaml = channels_yaml(channels).split("\n")
    room = max(MOST_LINES - len(channels) - len(yaml) - 2, LEAST_ROOM)
    told = _in_lines([*judged.doubts, *recording.notes], room)
    blocks = [Line(f"{verdict}: {size}", verdict=verdict), _table(channels), *map(Line, [*told, *yaml])]
    return [blocks]


def _in_lines(sentences: Sequence[str], room: int) -> list[str]:
    """Return as many sentences as have room in so many lines, and a line on the others."""
    told: list[str] = []
    for place, sentence in enumerate(sentences):
        room -= len(wrapped(sentence, 2))
        if room < (place + 1 < len(sentences)):
            return [*told, f"{len(sentences) - place} more on this file with --json"]
        told.append(sentence)
    return told


def _table(channels: Sequence[JudgedChannel]) -> Block:
    first = min((c.start_s for c in channels if c.start_s is not None), default=0.0)
    columns: list[tuple[Column, Sequence[str]]] = [
        (Column("role", words=True), [c.role or "?" for c in channels]),
        (Column("unit", words=True), [c.unit or "?" for c in channels]),
        (Column("start ms"), ["-" if c.start_s is None else f"{1e3 * (c.start_s - first):.6g}" for c in channels]),
        (Column("rate Hz"), ["-" if c.rate_hz is None else f"{c.rate_hz:.6g}" for c in channels]),
        (Column("missing"), [str(c.missing) for c in channels]),
        (Column("clipped"), [str(c.clipped_peaks) for c in channels]),
        (Column("stuck s"), [three(c.stuck_s) if c.stuck_s else "0" for c in channels]),
        (Column("mean"), [three(c.mean) for c in channels]),
        (Column("peak"), [three(c.peak) for c in channels]),
    ]
    count = Counter(c.name for c in channels)
    labels = [shortened(c.name, 40) if count[c.name] == 1 else f"{shortened(c.name, 36)} ({k})"
              for k, c in enumerate(channels, 1)]  # fmt: skip
    return by_columns("channel", labels, columns)


def as_data(judged: JudgedRecording) -> dict[str, Any]:
    """Return the page as JSON: None for each number that is not finite or not stated."""
    recording = judged.recording
    data: dict[str, Any] = json_data({
        "file": str(recording.path),
        "sha256": recording.sha256,
        "format": recording.format,
        "rate_hz": 1.0 / recording.dt_s,
        "samples": recording.samples.shape[1],
        "verdict": "doubtful" if judged.doubts else "readable",
        "channels": [asdict(channel) for channel in judged.channels],
        "doubts": list(judged.doubts),
        "notes": list(recording.notes),
        "channels_yaml": channels_yaml(judged.channels),
    })  # fmt: skip
    return data
