"""The work of `rths recover`: write the samples of interrupted runs from their raw logs to their result files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import ValidationError

from rths_cli.analysis.intensity import integrate
from rths_cli.analysis.references import reference_of
from rths_cli.case.case_schema import Case
from rths_cli.case.named_files import find
from rths_cli.case.yaml_reader import Source, parse, plain
from rths_cli.control.interface import Logged
from rths_cli.errors import InputError
from rths_cli.experiment import result_contents, run_metrics
from rths_cli.experiment.ground_motion import GroundMotion
from rths_cli.experiment.one_table_run import TABLE_RUNS, RunKind, metrics_of_record, run_of
from rths_cli.experiment.run_case import write_run
from rths_cli.experiment.run_signals import Expected, as_read
from rths_cli.experiment.setup import NUMERICAL, Setup, ground_motion, rig_info
from rths_cli.files.raw_log import RawHeader, RawLog, read_header, read_raw_log
from rths_cli.files.result_reader import BEGUN, ResultWriter, Status, read_result, read_series
from rths_cli.loop.realtime_loop import AT_REST
from rths_cli.loop.realtime_run import whole_of
from rths_cli.loop.run_log import DESIRED, Signals
from rths_cli.loop.simulated_time_run import Outcome, part_of
from rths_cli.quantities import attribute_fault
from rths_cli.structure import build

if TYPE_CHECKING:
    from rths_cli.files.result_writer import Attribute
    from rths_cli.numerics.lti import Array

KINDS = {kind.name: kind for kind in TABLE_RUNS}
TIMED = ("late_ns", "exchange_ns", "lost", "state")  # signals that not every log has
NOTED = tuple(f"recovered_{run}" for run in KINDS)


@dataclass(frozen=True)
class Recovered:
    """Outcome of the recovery of one log."""

    log: Path
    result: Path
    status: str  # of the result
    run: str  # name of the run
    samples: int  # recovered steps
    steps: int  # largest possible number of steps of the run
    dt_s: float
    note: str  # sentence on the recovered steps
    known: bool = False  # whether the result held the run already and was not changed


@dataclass(frozen=True)
class _Job:
    """A log that can be recovered, its case, its result, and the prediction with which drift is found."""

    path: Path
    header: RawHeader
    case: Case
    result: Path
    expected: Expected | None


def recover(paths: Sequence[Path]) -> list[Recovered]:
    """Create or complete the result beside each raw log; the logs are kept.

    Before anything is written, raises InputError with all faults if a file is no log, is being written, or belongs to a
    complete result.
    """
    jobs: list[_Job] = []
    faults: list[str] = []
    for path in paths:
        try:
            jobs.append(_job(path))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(*faults)
    return [_recover(job) for job in jobs]


def result_of(path: Path, header: RawHeader) -> Path:
    """Return the result file that a log belongs to, in the folder of the log."""
    return path.parent / Path(header.result).name


def _job(path: Path) -> _Job:
    """Return a log whose result is missing or not complete, with its case; raises InputError."""
    header = read_header(path)
    if header.run not in KINDS:
        raise InputError(
            f"{path}: holds a run named {header.run!r}, this rths knows {' and '.join(KINDS)}; keep the log, recover "
            "it with the version of rths that wrote it."
        )
    result = result_of(path, header)
    if result.exists() and read_result(result).attributes["status"] == "complete":
        raise InputError(f"{path}: is not needed any more: {result} is complete and is left alone; remove the log.")
    case = _case(path, header)
    floors = len(case.structure.experimental.masses_kg)
    needed = ("command_v", "base_shear_n", *DESIRED, *_numbered("corrected", 1 + floors))
    missing = [name for name in (*needed, *_numbered("estimated", 3 * floors)) if name not in header.names]
    if missing:
        raise InputError(f"{path}: has no column {missing[0]}, without which its case has no result.")
    return _Job(path, header, case, result, _expected(path, header, 1 + floors))


def _expected(path: Path, header: RawHeader, channels: int) -> Expected | None:
    """Return the prediction to which a log is compared, None for a log of an earlier version; raises InputError."""
    try:
        return as_read(header.expected, channels) if header.expected is not None else None
    except ValueError as error:
        raise InputError(
            f"{path}: what its header expects of the rig cannot be read ({error}); keep the log, recover it with the "
            "version of rths that wrote it."
        ) from error


def _recover(job: _Job) -> Recovered:
    """Write the run of one log to its result."""
    header, result, log = job.header, job.result, read_raw_log(job.path)
    if not result.exists():
        _begin(job)
    samples = read_series(result, "record/time_s").size
    found, key, note = read_result(result), f"recovered_{header.run}", _note(job.path, log, samples)
    status: Status = found.attributes["status"]  # type: ignore[assignment]
    half = header.run in found.groups and found.attributes.get(f"{header.run}_status") == BEGUN
    known = key in found.attributes or (header.run in found.groups and not half)
    if not known:
        with ResultWriter(result, {key: note}, continues=True) as writer:
            if half:
                writer.drop(header.run)
            if log.columns.shape[1] > header.ramp_steps + header.lead_samples:
                _write(writer, job, log, found.attributes)
            writer.finish(status, _reason(found.attributes | {key: note}, note))
    return Recovered(job.path, result, status, header.run, log.samples, header.steps, header.dt_s, note, known)


def _write(writer: ResultWriter, job: _Job, log: RawLog, before: Mapping[str, object]) -> None:
    """Write the run like one that reached its end, only shorter; the warnings `before`, among attributes, are kept."""
    header, setup = job.header, _setup(job)
    steps = log.columns.shape[1] - header.ramp_steps
    everything = _signals(log, setup)
    whole = whole_of(everything, header.still_steps, header.ramp_steps, header.dt_s)
    of_record = part_of(everything, slice(header.ramp_steps, None))
    outcome = Outcome(of_record, steps, None, "", 0.0, whole=whole, logs=_logs(header, len(everything.logged)))
    run = run_of(outcome, setup, _kind(header), header.lead_samples, job.expected)
    if run.warnings:
        writer.about(result_contents.told_also(before, run.warnings))
    write_run(writer, setup, run)
    whole_record = run.series.command_v.size == len(setup.motion.time_s) and np.isfinite(run.series.measured).all()
    if (
        whole_record and NUMERICAL not in setup.parts
    ):  # whose building, and with it SIM, only the caller's program knows
        sim = reference_of(setup.building).sim(setup.building, header.dt_s, setup.motion.accel_m_s2)
        remarks = run_metrics.remarks(setup, header.run, run.series.desired[0])
        writer.metrics(metrics_of_record(run, setup, sim), remarks)


def _logs(header: RawHeader, count: int) -> tuple[Logged, ...]:
    """Return what the parts logged; a log of an earlier version names none of it."""
    told = tuple(Logged(*one) for one in header.logs)
    return (*told, *(Logged(f"logged_{i}", "1") for i in range(len(told), count)))[:count]


def _kind(header: RawHeader) -> RunKind:
    """Return the kind of run that a log belongs to."""
    return KINDS[header.run]


def _note(path: Path, log: RawLog, samples: int) -> str:
    """Return the recovered steps of a run in words, separately for record, rest and ramps."""
    header, steps = log.header, log.columns.shape[1]
    rest, record = min(steps, header.still_steps), min(samples + header.lead_samples, header.steps - header.ramp_steps)
    played = min(max(steps - header.ramp_steps, 0), record)
    ramp, after = min(steps, header.ramp_steps) - rest, max(steps - header.ramp_steps - played, 0)
    rested = _rested(log)
    gaps = f", {steps - log.samples} of them are missing" if log.samples < steps else ""
    label, time_s, most_s = _kind(header).label, played * header.dt_s, record * header.dt_s
    there = f"{played} of {record} steps of the record ({time_s:.3f} s of {most_s:.3f} s)"
    counts = ((rest, "rest before it"), (ramp, "ramp-up"), (after - rested, "ramp-down"), (rested, "rest after it"))
    beside = [f"{count} of the {name}" for count, name in counts if count]
    return f"{label}: {', '.join([there, *beside])} are recovered from {path.name}{gaps}"


def _rested(log: RawLog) -> int:
    """Return the number of steps at rest at the end of a log."""
    names = log.header.names
    return int(np.sum(log.columns[names.index("state")] == AT_REST)) if "state" in names else 0


def _reason(attributes: Mapping[str, Attribute], note: str) -> str:
    """Return the reason for the end of the run; a fault that the result states already is kept."""
    if attributes["status"] != "interrupted":
        return f"{attributes['status_reason']}; {note}"
    notes = [str(attributes[key]) for key in NOTED if key in attributes]
    return "; ".join(["the process ended before the run did", *notes])


def _begin(job: _Job) -> None:
    """Create a result from the log's header and the record's file.

    Raises InputError if the record's file is missing or has changed.
    """
    header, case = job.header, job.case
    motion, sha256 = ground_motion(case)
    if sha256 != header.attributes.get("record_sha256", sha256):
        name = job.result.name
        raise InputError(f"{case.record.path}: is not the file any more that {name} was made with; restore it.")
    if fault := attribute_fault(header.attributes):
        raise InputError(f"{job.path}: {fault}; recover it with the version of rths that wrote it.")
    with ResultWriter(job.result, header.attributes, lasting=True) as writer:
        writer.case(header.case_yaml, header.resolved_yaml)
        result_contents.write_record(writer, _about(job, motion))
        writer.finish("interrupted", f"made anew from the raw log of {header.run}")


def _case(path: Path, header: RawHeader) -> Case:
    """Return the resolved case of a log; the files that it names are not needed any more."""
    node, faults = parse(header.resolved_yaml, Source(f"{path}: its case", path.parent))
    if node is None or faults:
        raise InputError(*(str(fault) for fault in faults))
    told = plain(node) | {"path": Path(header.case_path), "yaml_text": header.case_yaml}
    try:
        told["record"]["file"] = _record_file(told["record"]["file"], path.parent)
        told["identification"]["model"] = None  # the blocks are made already
        told["table"] |= {name: None for name in ("model",) if name in told["table"]}
        if isinstance(told["table"].get("udp"), dict):
            told["table"]["udp"]["key_file"] = None  # nobody is asked anything
        return Case.model_validate(told)
    except KeyError as error:
        raise InputError(f"{path}: its case has no {error.args[0]}; nothing can be recovered.") from error
    except ValidationError as error:
        written = header.attributes.get("rths_version", "another version")
        fault = error.errors()[0]
        place = ".".join(str(part) for part in fault["loc"])
        raise InputError(
            f"{path}: its case was written by rths {written} and does not fit this one ({place}: {fault['msg']}); "
            "use the version that wrote it."
        ) from error


def _record_file(name: str, folder: Path) -> Path:
    """Return the file of a record; a resolved case names a shipped record without its folder."""
    try:
        return find(name, "records", folder)
    except InputError:
        return Path(name)  # needed only where there is no result yet


def _setup(job: _Job) -> Setup:
    """Return the setup of the case, with the ground motion of the result."""
    time_s, accel = (read_series(job.result, f"record/{name}") for name in ("time_s", "ground_accel_m_s2"))
    return _about(job, GroundMotion(job.header.dt_s, time_s, accel, *integrate(accel, job.header.dt_s)))


def _about(job: _Job, motion: GroundMotion) -> Setup:
    case, attributes = job.case, job.header.attributes
    masses = np.asarray(case.structure.experimental.masses_kg, dtype=float)
    sha256, overrides = (str(attributes.get(key, "")) for key in ("record_sha256", "overrides"))
    building = build(case.structure, case.damping)
    places = str(attributes.get("own_parts", "")).split()
    parts = dict.fromkeys(places, _made_already)
    return Setup(case, motion, sha256, building, rig_info(case), masses, tuple(overrides.split()), parts)


def _made_already(designed: object) -> None:
    """Stand for a part of the caller's that the run had; what is recovered needs only to know of it."""
    raise AssertionError("a recovered run makes no parts")


def _signals(log: RawLog, setup: Setup) -> Signals:
    """Return the signals of a log by name; signals that the rig does not have are NaN."""
    columns = dict(zip(log.header.names, log.columns, strict=True))
    channels = len(setup.rig.channels)
    unknown = np.full(log.columns.shape[1], np.nan)

    def rows(names: Sequence[str]) -> Array:
        return np.array([columns.get(name, unknown) for name in names])

    further = len(setup.rig.further)
    single = ("command_v", "base_shear_n", "true_displacement_m", "compute_ns")
    several = ("corrected", "true_velocity_m_s", "samples_v")
    return Signals(
        desired=rows(DESIRED),
        estimated=rows(list(takewhile(columns.__contains__, _named("estimated")))),
        logged=rows(list(takewhile(columns.__contains__, _named("logged")))).reshape(-1, unknown.size),
        **{name: rows(_numbered(name, channels)) for name in several},
        **{name: rows(_numbered(name, further)).reshape(further, unknown.size) for name in ("further", "further_v")},
        **{name: columns.get(name, unknown) for name in single},
        **{name: columns.get(name, unknown[:0]) for name in TIMED},
    )


def _named(stem: str) -> Iterator[str]:
    """Yield `stem_0`, `stem_1`, ..."""
    return (f"{stem}_{i}" for i in count())


def _numbered(stem: str, length: int) -> list[str]:
    """Return the first names of `_named`."""
    return [f"{stem}_{i}" for i in range(length)]
