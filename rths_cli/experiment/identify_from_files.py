"""Identify from measured files: `rths identify --data FILE`; which channel is what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.control import sensor_correction
from rths_cli.errors import InputError
from rths_cli.experiment.identify_on_rig import Measured, processing
from rths_cli.experiment.setup import Setup, shown
from rths_cli.files.measured_data import Chosen, Recording, choose, mend, missing, read_recording
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.record_parts import Record, find_parts
from rths_cli.loop.block_replay import run_block
from rths_cli.numerics.lti import Array

SAME_RATE = 1e-6
QUIET_SHARE = 0.6  # a record below this fraction of the loudest one's rms is a record at low level
CORRECTED = "accelerations free of the sensors' dynamics"  # mark in a saved record whose sensor dynamics are removed


@dataclass(frozen=True)
class DataRequest:
    """Files with measured time histories.

    `channels`: role (command, table, floor_2, ...) -> name in the file and unit ("" if the file states it); `rate_hz`:
    sample rate if the files do not state it; `corrected`: the sensor dynamics are removed already.
    """

    paths: tuple[Path, ...]
    channels: Mapping[str, tuple[str, str]]
    rate_hz: float | None = None
    corrected: bool = False


def read_roles(texts: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return role -> (name, unit) from texts ROLE=NAME or ROLE=NAME:UNIT; raises InputError with all faults."""
    roles: dict[str, tuple[str, str]] = {}
    faults = []
    for text in texts:
        role, sign, rest = text.partition("=")
        name, colon, unit = rest.rpartition(":")
        if not (sign and role.strip() and rest.strip()):
            faults.append(f"--channel {text}: must be ROLE=NAME or ROLE=NAME:UNIT, for example --channel table=ai0:g")
        elif role.strip() in roles:
            faults.append(f"--channel {text}: {role.strip()} was named before; name each role once")
        else:
            roles[role.strip()] = (name.strip(), unit.strip()) if colon else (rest.strip(), "")
    if faults:
        raise InputError(*faults)
    return roles


def read_measured(request: DataRequest, setup: Setup) -> Measured:
    """Read the files as records of the case's rig.

    Raises InputError if a file cannot be read or does not fit the rig, UnfitRecord if samples are missing.
    """
    recordings: list[Recording] = []
    faults: list[str] = []
    for path in request.paths:
        try:
            recordings.append(read_recording(path, 1.0 / request.rate_hz if request.rate_hz else None))
        except InputError as error:
            faults += error.faults
    faults += [fault for recording in recordings for fault in _rate_faults(recording, setup)]
    faults += _repeated(recordings)
    if faults:
        raise InputError(*faults)
    records: list[Record] = []
    lines: list[tuple[str, str]] = []
    notes: list[str] = []
    for recording in recordings:
        record, chosen, said = _record(recording, request, setup)
        records.append(record)
        lines += [("data", _parts_line(record, setup.rig.dt_s)), ("channels", "; ".join(chosen.notes))]
        notes += [f"{shown(recording.path)}: {sentence}" for sentence in said]
    files = ", ".join(f"{shown(r.path)} (SHA-256 {r.sha256[:12]})" for r in recordings)
    loud, quiet = _by_level(records)
    if quiet is None:
        notes.append(
            "friction: not judged, the records hold one level only; give another one at a fraction of it as well"
        )
    return Measured(loud, quiet, files, (*lines, *_processing(request, setup)), tuple(notes))


def _repeated(recordings: Sequence[Recording]) -> list[str]:
    """Return a sentence for each file that is a copy of another one, because it would count as two records."""
    first: dict[str, Path] = {}
    faults = []
    for recording in recordings:
        if recording.sha256 in first:
            faults.append(
                f"{shown(recording.path)}: holds the same bytes as {shown(first[recording.sha256])}; give it once"
            )
        first.setdefault(recording.sha256, recording.path)
    return faults


def _by_level(records: Sequence[Record]) -> tuple[tuple[Record, ...], Record | None]:
    """Return the records at full level, and the quietest one if it is far below them, to judge friction."""
    rms = [float(record.accel_m_s2[0, record.parts.noise].std()) for record in records]
    quietest = int(np.argmin(rms))
    if len(records) < 2 or rms[quietest] > QUIET_SHARE * max(rms):
        return tuple(records), None
    return tuple(record for i, record in enumerate(records) if i != quietest), records[quietest]


def _rate_faults(recording: Recording, setup: Setup) -> list[str]:
    """Return a sentence if the sample rate of a file differs from that of the case."""
    rate = 1.0 / recording.dt_s
    if abs(recording.dt_s / setup.rig.dt_s - 1.0) < SAME_RATE:
        return []
    return [
        f"{shown(recording.path)}: sampled at {rate:g} Hz, the case runs at {setup.case.sample_rate_hz:g} Hz; a model "
        f"belongs to one rate, add --set sample_rate_hz={rate:g} or record at the case's"
    ]


def _record(recording: Recording, request: DataRequest, setup: Setup) -> tuple[Record, Chosen, list[str]]:
    """Return one file's record, the channels used, and notes on interpolated or unusual samples."""
    floors = [channel.name for channel in setup.rig.channels]
    chosen = choose(recording, ("command", *floors), request.channels)
    signals = np.vstack([chosen.command_v, chosen.accel])
    names = ("command", *floors)
    mended, notes = mend(signals, names)
    lost = missing(mended, names, recording.dt_s)
    if lost:
        raise UnfitRecord([f"{shown(recording.path)}: {sentence}" for sentence in lost])
    command, accel = mended[0], _as_volts(mended[1:], chosen, setup)
    parts = find_parts(command, setup.rig.dt_s, shown(recording.path))
    accel = accel - _rest(accel, parts.silence)[:, None]
    corners = setup.removes_sensors and not (request.corrected or CORRECTED in recording.notes)
    block = sensor_correction.correction(setup.rig.channels, setup.rig.dt_s, corners)
    return (
        Record(command, run_block(block, accel), parts),
        chosen,
        [*(n for n in recording.notes if n != CORRECTED), *notes],
    )


def _as_volts(accel: Array, chosen: Chosen, setup: Setup) -> Array:
    """Return the sensors' signals in V, whatever the unit of the file, as input of the sensor correction."""
    scale = [
        1.0 if unit == "V" else channel.sensitivity_v_per_unit
        for unit, channel in zip(chosen.units, setup.rig.channels, strict=True)
    ]
    return accel * np.array(scale)[:, None]


def _rest(accel: Array, silence: slice | None) -> Array:
    """Return each channel's offset: its mean at rest, or over the record."""
    return accel[:, silence].mean(axis=1) if silence is not None else accel.mean(axis=1)


def _parts_line(record: Record, dt_s: float) -> str:
    """Return the page's line on the durations of excitation, silence and free vibration of a record."""
    parts = record.parts
    seconds = (parts.noise.stop - parts.noise.start) * dt_s
    text = f"{seconds:.1f} s of excitation from {parts.noise.start * dt_s:.1f} s on"
    if parts.period_samples:
        text += f", in periods of {parts.period_samples * dt_s:.4g} s"
    if parts.silence is not None:
        text += f", {(parts.silence.stop - parts.silence.start) * dt_s:.1f} s of silence"
    if parts.free_vibration is not None:
        text += f", {(parts.free_vibration.stop - parts.free_vibration.start) * dt_s:.1f} s of free vibration"
    return text


def _processing(request: DataRequest, setup: Setup) -> tuple[tuple[str, str], ...]:
    """Return the page's lines on the evaluation."""
    lines = dict(processing(setup.case.identification))
    if request.corrected:
        lines["sensor dynamics"] = "taken as removed by whoever measured (--corrected)"
    return tuple(lines.items())
