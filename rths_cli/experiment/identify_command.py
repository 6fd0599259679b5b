"""The work of `rths identify`: measure or read measured files (`--data`), evaluate, write the model file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.case.yaml_reader import plain, read_file
from rths_cli.control import sensor_correction
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import differences
from rths_cli.experiment.excitation_plan import plan
from rths_cli.experiment.identify_on_rig import (
    Measured,
    UnfitRig,
    evaluated,
    evaluation_settings,
    measure,
    noted,
    processing,
)
from rths_cli.experiment.identify_output import PROBE, Outputs, check_outputs, make_folders
from rths_cli.experiment.model_choice import as_model, notes_on
from rths_cli.experiment.model_files import channel_names, load, save
from rths_cli.experiment.setup import Progress, Setup, make_setup, shown
from rths_cli.experiment.unit_plausibility import specimen_doubts
from rths_cli.files.durable_files import stamp, taken_sentence
from rths_cli.files.foreign_models import is_foreign, read_foreign
from rths_cli.files.measured_data import Chosen, Recording, choose, mend, missing, read_recording, write_recording
from rths_cli.findings import Finding, stated
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.identify import identify as evaluate
from rths_cli.identification.record_parts import Record, find_parts
from rths_cli.identification.results import Identification
from rths_cli.interrupts import interruptible
from rths_cli.loop.block_replay import run_block
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Model

SAME_RATE = 1e-6
ONLY_OF_RUNS = ("ground", "desired", "base_shear")  # channels that tell of a run and nothing of a table
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
    """Return role -> (name, unit) from texts ROLE=NAME or ROLE=NAME:UNIT, or YAML files; raises InputError with all
    faults."""
    roles: dict[str, tuple[str, str]] = {}
    faults: list[str] = []
    for text in texts:
        try:
            stated = _roles_of_file(Path(text)) if _names_yaml(text) else dict([_role(text)])
        except InputError as fault:
            faults += fault.faults
            continue
        faults += [f"--channel {text}: {r} was named before; name each role once" for r in stated if r in roles]
        roles = stated | roles
    if faults:
        raise InputError(*faults)
    return roles


def _names_yaml(text: str) -> bool:
    return "=" not in text and Path(text).suffix.lower() in (".yaml", ".yml")


def _role(text: str) -> tuple[str, tuple[str, str]]:
    """Return role, name and unit of a text ROLE=NAME[:UNIT]."""
    role, sign, rest = text.partition("=")
    name, colon, unit = rest.rpartition(":")
    if not (sign and role.strip() and rest.strip()):
        raise InputError(f"--channel {text}: must be ROLE=NAME or ROLE=NAME:UNIT, for example --channel table=ai0:g")
    return role.strip(), (name.strip(), unit.strip()) if colon else (rest.strip(), "")


def _roles_of_file(path: Path) -> dict[str, tuple[str, str]]:
    """Return the roles of a YAML file, `channels: {table: [ai0, g]}`."""
    _, node, faults = read_file(path)
    if faults:
        raise InputError(*map(str, faults))
    document = plain(node) if node is not None else None
    stated = document.get("channels") if isinstance(document, dict) and set(document) == {"channels"} else None
    if not isinstance(stated, dict) or not stated:
        raise InputError(f"--channel {path}: must hold channels: {{ROLE: [NAME, UNIT], ...}}, as rths data prints it")
    roles: dict[str, tuple[str, str]] = {}
    wrong = []
    for role, words in stated.items():
        if isinstance(words, tuple) and len(words) in (1, 2) and all(isinstance(word, str) for word in words):
            roles[role] = (words[0], words[1] if len(words) == 2 else "")
        else:
            wrong.append(f"--channel {path}: {role}: must be [NAME, UNIT] or [NAME], two texts at most")
    if wrong:
        raise InputError(*wrong)
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
    notes: list[Finding] = []
    for recording in recordings:
        record, chosen, said = _record(recording, request, setup)
        records.append(record)
        lines += [("data", _parts_line(record, setup.rig.dt_s)), ("channels", "; ".join(chosen.notes))]
        notes += [stated(f"{shown(recording.path)}: {sentence}", "notes") for sentence in said]
    files = ", ".join(f"{shown(r.path)} (SHA-256 {r.sha256[:12]})" for r in recordings)
    loud, quiet = _by_level(records)
    if quiet is None:
        notes.append(Finding("friction.one_level"))
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
    named = {role: one for role, one in request.channels.items() if role not in ONLY_OF_RUNS}
    chosen = choose(recording, ("command", *floors), named)
    signals = np.vstack([chosen.command_v, chosen.accel])
    names = ("command", *floors)
    mended, notes = mend(signals, names)
    lost = missing(mended, names, recording.dt_s)
    if lost:
        raise UnfitRecord([stated(f"{shown(recording.path)}: {sentence}") for sentence in lost])
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


@dataclass(frozen=True)
class Asked:
    """Arguments of `rths identify`."""

    case: str  # name or path of the case
    settings: tuple[str, ...]  # KEY=VALUE each
    data: DataRequest | None = None  # measured files; None: excite the rig
    output: Path | None = None  # model file; None: models/RIG_STRUCTURE.h5, with the time (UTC) for a real rig
    save_data: Path | None = None  # file for the measured records; None: they are not saved
    figure: Path | None = None  # file of the figure; None: beside the model file, as .png
    draw: bool = True  # whether a figure is drawn
    replace: bool = True  # whether files that exist may be replaced


@dataclass(frozen=True)
class About:
    """Origin of an identification, for the page and the document."""

    rig: str  # name
    rig_kind: str  # kind of the rig; "" for measured files
    source: str  # origin of the data, in words
    lines: tuple[tuple[str, str], ...] = ()  # (label, text), such as excitation, estimator, data hash, model file
    compared: ComparedBand = USUAL  # band in which a model is compared with its data


@dataclass(frozen=True)
class Made:
    """Result of `rths identify`."""

    about: About
    found: Identification | None  # None: no model can be made from these channels
    figure: Path | None  # file of the figure to be drawn; None: no figure
    unfit: UnfitRecord | None = None  # why no model can be made; None: one was made
    exit_code: int = 0  # of the process; 0 for an accepted model
    model: Path | None = None  # model file if the model is accepted; None if it is rejected


def make_model(
    asked: Asked,
    progress: Progress,
    permit: Callable[[Setup], None] = lambda _: None,
    warn: Progress = lambda _: None,
) -> Made:
    """Identify as asked and write the model file, also for a rejected model: the file states the verdict.

    `permit` is called before a rig is excited and refuses by raising InputError. Doubts on units precede the warnings
    of the model, or the reasons why there is none. `warn` receives where a file went whose name was taken meanwhile.
    Case, excitation and output files are checked before a rig moves. Raises InputError if the case, the data or an
    output file cannot be used, LimitError or RigError if the excitation was stopped.
    """
    setup = make_setup(load_cases([asked.case], asked.settings)[0])
    outputs = _outputs(asked, setup)
    given, notes = _given(setup)
    if setup.rig.interface == "displacement":
        return _of_actuator(asked, setup, outputs, progress, warn)
    planned = None if asked.data else plan(setup)
    present, seen = check_outputs(outputs, _inputs(asked, setup), asked.replace), stamp(outputs.model)
    doubts = specimen_doubts(setup)
    if not asked.data:
        permit(setup)
    about = About(setup.rig.name, "" if asked.data else setup.rig.kind, "", compared=setup.compared)
    try:
        measured = read_measured(asked.data, setup) if asked.data else measure(setup, progress, planned)
        about = replace(about, source=measured.source, lines=measured.lines)
        make_folders(outputs)
        if asked.save_data:
            _save_data(asked.save_data, setup, measured, warn)
        found = noted(_evaluate(setup, measured, given, asked.data is not None), notes)
        found = noted(found, (*doubts, *differences(setup, found)))
    except (UnfitRig, UnfitRecord) as unfit:
        why, code = (unfit.unfit, unfit.exit_code) if isinstance(unfit, UnfitRig) else (unfit, 1)
        why = UnfitRecord((*doubts, *why.findings), why.channels)
        none = (("model file", "none is written: no model can be made from these channels"),)
        return Made(replace(about, lines=(*about.lines, *none)), None, None, why, code)
    model, sha256 = save(outputs.model, setup, found, measured.source, measured.sha256, seen)
    if model != outputs.model:
        warn(taken_sentence(outputs.model, model))
        own = model.with_suffix(".png") if outputs.figure and not asked.figure else outputs.figure
        outputs = replace(outputs, model=model, figure=own)
    judged = (("judged model", shown(asked_model)),) if (asked_model := setup.case.identification.model) else ()
    drawn = (("figure", f"{shown(outputs.figure)}{_mark(outputs.figure, present)}"),) if outputs.figure else ()
    lines = (
        ("structure", f"{setup.case.structure.name}, case {setup.case.name}"),
        *measured.lines,
        *judged,
        ("data SHA-256", measured.sha256[:16]),
        ("model file", f"{shown(outputs.model)}{_mark(outputs.model, present)}, SHA-256 {sha256[:16]}"),
        *drawn,
    )
    code, accepted = (0, outputs.model) if found.accepted else (1, None)
    return Made(replace(about, lines=lines), found, outputs.figure, None, code, accepted)


def _of_actuator(asked: Asked, setup: Setup, outputs: Outputs, progress: Progress, warn: Progress) -> Made:
    """Identify an actuator and write its model file; no figure is drawn."""
    from rths_cli.experiment import actuator

    for what, given in (("--data: recordings", asked.data), ("--save-data: the records", asked.save_data),
                        ("identification.model: another model", setup.case.identification.model)):  # fmt: skip
        if given:
            raise InputError(
                f"{what} of an actuator cannot be taken yet, a virtual actuator is identified by its own multisine; "
                "leave it out"
            )
    if asked.figure:
        raise InputError("--figure: of an actuator's identification no figure is drawn yet; leave it out")
    outputs = replace(outputs, figure=None)
    present, seen = check_outputs(outputs, _inputs(asked, setup), asked.replace), stamp(outputs.model)
    found, played, measured = actuator.identify(setup, progress)
    found = noted(found, differences(setup, found))
    make_folders(outputs)
    source, sha256_of_data = "excited on the virtual actuator for this model", actuator.data_sha256(played, measured)
    model, sha256 = save(outputs.model, setup, found, source, sha256_of_data, seen)
    if model != outputs.model:
        warn(taken_sentence(outputs.model, model))
    fit = found.specimen
    assert fit is not None and found.at_rest is not None
    own, seconds = fit.specimen, played.period * setup.rig.dt_s
    lines = (
        ("structure", f"{setup.case.structure.name}, case {setup.case.name}"),
        ("excitation", f"multisine, 5 periods of {seconds:g} s, {played.frequency_hz[0]:.3g}-"
                       f"{played.frequency_hz[-1]:.3g} Hz, a quarter of the nearest limit"),
        ("specimen", f"stiffness {own.K[0, 0]:.5g} N/m, dashpot {own.C[0, 0]:.4g} N s/m, "
                     f"mass {own.masses_kg[0]:.4g} kg"),
        ("noise at rest", f"displacement {1e6 * found.at_rest[0]:.3g} um, force {found.at_rest[1]:.3g} N rms"),
        ("model file", f"{shown(outputs.model)}{_mark(outputs.model, present)}, SHA-256 {sha256[:16]}"),
    )  # fmt: skip
    about = About(setup.rig.name, setup.rig.kind, source, lines, setup.compared)
    code, accepted = (0, model) if found.accepted else (1, None)
    return Made(about, found, None, None, code, accepted)


def _mark(path: Path, replaced: Sequence[Path]) -> str:
    return " (replaced)" if path in replaced else ""


def _evaluate(setup: Setup, measured: Measured, given: Model | None, from_file: bool) -> Identification:
    """Evaluate the records; raises UnfitRig or RigError for those of the rig, UnfitRecord or InputError for files."""
    if not from_file:
        return evaluated(setup, measured, given)
    settings = evaluation_settings(setup)
    found = interruptible(
        lambda: evaluate(measured.records, setup.rig, setup.floor_masses_kg, settings, measured.quiet, given)
    )
    return noted(found, measured.notes)


def _given(setup: Setup) -> tuple[Model | None, tuple[Finding, ...]]:
    """Return the model that the case names, which is judged instead of a fitted one, and notes on it; None, () if none.

    Raises InputError if its file cannot be used.
    """
    path = setup.case.identification.model
    if path is None:
        return None, ()
    if not is_foreign(path):
        return load(path, setup).found.best, ()
    given = read_foreign(path)
    return as_model(given, setup), notes_on(given)


def _outputs(asked: Asked, setup: Setup) -> Outputs:
    """Return the output files; the default name of a real rig's model file contains the time, so each one is kept."""
    stamp = datetime.now(UTC).strftime("_%Y%m%dT%H%M%SZ") if setup.rig.can.moves_hardware else ""
    model = asked.output or Path("models") / f"{setup.rig.name}_{setup.case.structure.name}{stamp}.h5"
    figure = (asked.figure or model.with_suffix(".png")) if asked.draw else None
    return Outputs(model, figure, asked.save_data)


def _inputs(asked: Asked, setup: Setup) -> list[tuple[str, Path]]:
    """Return the input files, each with the word or option that names it in a message."""
    case = setup.case
    named = [("the case", case.path), ("the record", case.record.path), ("--model", case.identification.model)]
    data = asked.data.paths if asked.data else ()
    return [(what, path) for what, path in named if path is not None] + [("--data", path) for path in data]


def _save_data(path: Path, setup: Setup, measured: Measured, warn: Progress) -> None:
    """Write every record: command in V, and the accelerations in m/s^2 that are evaluated.

    The first record is written to `path`, further ones to NAME_2, ..., the one at low level to NAME_probe.
    """
    names = ("command_v", *(f"{name}_accel_m_s2" for name in channel_names(setup)))
    notes = (CORRECTED,) if setup.removes_sensors else ()
    saved = {f"_{number}" if number > 1 else "": record for number, record in enumerate(measured.records, 1)}
    saved |= {f"_{PROBE}": measured.quiet} if measured.quiet is not None else {}
    for end, record in saved.items():
        samples = np.vstack([record.command_v, record.accel_m_s2])
        units = ("V", *["m/s^2"] * len(record.accel_m_s2))
        to = path.with_name(f"{path.stem}{end}{path.suffix}")
        written = write_recording(to, Recording(to, "", setup.rig.dt_s, names, units, samples, notes))
        if written != to:
            warn(taken_sentence(to, written))
