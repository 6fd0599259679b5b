"""What `rths benchmark` does: every compensator on every case and plant, a file of rows that can be continued."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rths_cli.analysis.adaptive_loop import AdaptiveVerdict
from rths_cli.benchmark.displacement import (
    NONE,
    SETTLED_S,
    CaseRuns,
    Designed,
    DisplacementBenchmark,
    critical_delay_s,
)
from rths_cli.benchmark.ran import Ran
from rths_cli.benchmark.table import PLAIN, TableBenchmark, TableCompensator
from rths_cli.case.benchmark_schema import (
    BenchmarkCompensator,
    BenchmarkSpec,
    PlantChange,
    TableBenchmarkSpec,
)
from rths_cli.case.compensator_schema import OWN, STATE_SPACE, compensator_kinds
from rths_cli.case.field_types import near
from rths_cli.case.load import load_benchmark
from rths_cli.case.named_files import find, is_bare
from rths_cli.control.compensator import definition_of
from rths_cli.errors import InputError
from rths_cli.experiment.model_files import software
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.files.durable_files import claimed
from rths_cli.files.existing_files import Kind, check_existing, replaced_sentence
from rths_cli.files.result_writer import check_writable
from rths_cli.studies.engines import Engine, executor_here
from rths_cli.version import __version__

FOLDER = Path("benchmarks")
MOST_BYTES = 1 << 30  # of a file of rows
AnyBenchmark = DisplacementBenchmark | TableBenchmark
AnyDesigned = Designed | TableCompensator
AHEAD = 4  # runs handed out per processor


class Watcher(Protocol):
    """Receives the progress of a benchmark."""

    def started(self, number: int, count: int, name: str) -> None:
        """Show that a run is waited for."""

    def doing(self, what: str) -> None:
        """Show what is being done."""

    def message(self, text: str) -> None:
        """Show a sentence that stays."""


@dataclass(frozen=True)
class BenchmarkRequest:
    """What `rths benchmark` was asked; empty or None: as the benchmark's file states it."""

    name: str
    cases: tuple[str, ...] = ()
    compensators: tuple[str, ...] = ()
    plants: int | None = None
    seed: int = 0
    noise_free: bool = False
    record: str | None = None
    scaling: float | None = None
    output: Path | None = None
    jobs: int = 1
    resume: bool = False
    replace: bool = True
    changes: tuple[str, ...] = ()


@dataclass(frozen=True)
class BenchmarkRow:
    """One run: its case, compensator and plant (0: the nominal one), its numbers by name, and why it was refused or
    stopped ("": it was not)."""

    case: str
    compensator: str
    plant: int
    figures: dict[str, float]
    outcome: str = ""


@dataclass(frozen=True)
class Benchmarked:
    """A finished benchmark: its file of rows, and how many of them were played now."""

    bench: AnyBenchmark
    plan: dict[str, Any]
    rows: tuple[BenchmarkRow, ...]
    path: Path
    played: int
    critical_delays_s: dict[str, float]
    adapting: frozenset[str]
    """Compensators that are no linear block: their radius is that of the block that they declare."""
    adaptive: dict[str, dict[str, AdaptiveVerdict]]
    """What is known of the nominal loop while parameters move, by compensator and case."""


def benchmark_of(request: BenchmarkRequest) -> AnyBenchmark:
    """Return the benchmark as it is asked for; raises InputError with all faults."""
    spec = load_benchmark(find(request.name, "benchmarks", Path.cwd()))
    if isinstance(spec, TableBenchmarkSpec):
        return _table_benchmark(spec, request)
    return _displacement_benchmark(spec, request)


def actuator_benchmark(request: BenchmarkRequest, option: str) -> DisplacementBenchmark:
    """Return the benchmark of an `option` that only those of an actuator have; raises InputError for another one."""
    found = benchmark_of(request)
    if isinstance(found, TableBenchmark):
        raise InputError(f"{option}: {request.name} is a benchmark of tables, this is of actuators; drop it. "
                         "rths check tells it of a case")  # fmt: skip
    return found


def _table_benchmark(spec: TableBenchmarkSpec, request: BenchmarkRequest) -> TableBenchmark:
    """Return a benchmark of tables as it is asked for."""
    instead = {
        "--noise-free": (request.noise_free, "copy its file and state table.sensors.noise_rms_m_s2=0 in the settings"),
        "--change": (bool(request.changes), "state table.after_identification in the settings of its file"),
    }
    if faults := [f"{option}: {request.name} is a benchmark of tables, which has no such option; {what}"
                  for option, (given, what) in instead.items() if given]:  # fmt: skip
        raise InputError(*faults)
    settings = [] if request.record is None else [f"record={json.dumps(request.record)}"]
    settings += [] if request.scaling is None else [f"scaling={request.scaling!r}"]
    spec = spec.model_copy(update={
        "cases": tuple(_chosen("--case", request.cases, {case.name: case for case in spec.cases})),
        "compensators": tuple(_compensators(spec, request, PLAIN)),
        "plants": spec.plants if request.plants is None else request.plants,
    })  # fmt: skip
    return TableBenchmark(spec, tuple(settings))


def _compensators(
    spec: BenchmarkSpec | TableBenchmarkSpec, request: BenchmarkRequest, plain: Sequence[str]
) -> list[BenchmarkCompensator]:
    """Return those that are asked for, else those of the file; `plain`: what is no compensator of the registry."""
    found = [_compensator(spec, one, plain) for one in request.compensators] or list(spec.compensators)
    labels = [one.label for one in found]
    if repeated := sorted({label for label in labels if labels.count(label) > 1}):
        raise InputError(f"--compensator: {', '.join(repeated)} is given more than once; name each once")
    return found


def _displacement_benchmark(spec: BenchmarkSpec, request: BenchmarkRequest) -> DisplacementBenchmark:
    """Return a benchmark of an actuator as it is asked for."""
    cases = _chosen("--case", request.cases, {case.name: case for case in spec.cases})
    compensators = _compensators(spec, request, (NONE,))
    change = _change(spec, request.changes)
    if change is not None:
        compensators = [*compensators, *_frozen(compensators)]
    scaling = spec.ground_motion_factor if request.scaling is None else request.scaling
    plants = spec.plants if request.plants is None else request.plants
    spec = spec.model_copy(update={
        "cases": tuple(cases), "compensators": tuple(compensators), "plants": plants, "ground_motion_factor": scaling,
        "ground_motion": request.record or spec.ground_motion, "change": change,
    })  # fmt: skip
    named = spec.ground_motion
    record = read_accelerogram(find(named, "records", Path.cwd()) if is_bare(named) else Path(named))
    ends_s = (len(record.accel_m_s2) - 1) * record.dt_s
    if change is not None and change.at_s + SETTLED_S >= ends_s:
        raise InputError(
            f"change.at_s: {change.at_s:g} s leaves no errors to judge, which count from {SETTLED_S:g} s later; "
            f"the record ends at {ends_s:g} s"
        )
    return DisplacementBenchmark(spec, record, request.noise_free)


def _change(spec: BenchmarkSpec, stated: Sequence[str]) -> PlantChange | None:
    """Return what changes during the test: that of the file, with the keys that --change states."""
    given: dict[str, Any] = {} if spec.change is None else spec.change.model_dump()
    known = tuple(PlantChange.model_fields)
    for one in stated:
        key, sign, value = one.partition("=")
        if not sign or key not in known:
            raise InputError(f"--change {one}: must be KEY=VALUE with a key of {', '.join(known)}{near(key, known)}")
        try:
            given[key] = int(value) if key == "latency_samples" else float(value)
        except ValueError:
            raise InputError(f"--change {one}: {value!r} is no number") from None
    if not given:
        return None
    if "at_s" not in given:
        raise InputError("--change: at_s is missing; say when, such as --change at_s=10")
    try:
        return PlantChange.model_validate(given)
    except ValueError as error:
        first = error.errors()[0]  # type: ignore[attr-defined]
        raise InputError(f"--change {first['loc'][0]}: {first['msg']}, got {first['input']}") from None


def _frozen(compensators: Sequence[BenchmarkCompensator]) -> list[BenchmarkCompensator]:
    """Return the laws that adapt once more, with their parameters at their start."""
    laws = [one for one in compensators if one.kind not in (NONE, STATE_SPACE) and not one.frozen]
    return [one.model_copy(update={"frozen": True, "name": f"{one.label}_frozen"}) for one in laws
            if definition_of(one.kind, one.file, one.sha256).adapts]  # fmt: skip


def _chosen(option: str, asked: Sequence[str], known: dict[str, Any]) -> list[Any]:
    if faults := [f"{option} {one}: is none of the benchmark's{near(one, known)}" for one in asked if one not in known]:
        raise InputError(*faults)
    return [known[one] for one in dict.fromkeys(asked)] or list(known.values())


def _compensator(spec: BenchmarkSpec | TableBenchmarkSpec, asked: str, plain: Sequence[str]) -> BenchmarkCompensator:
    """Return a compensator of the table by its name, one of any kind with its defaults, or that of a Python file."""
    known = {one.label: one for one in spec.compensators}
    if asked in known:
        return known[asked]
    kinds = [*plain, *(kind for kind in compensator_kinds() if kind not in (OWN, STATE_SPACE))]
    if not asked.endswith(".py") and asked not in kinds:
        names = dict.fromkeys((*known, *kinds))
        raise InputError(
            f"--compensator {asked}: is none of the benchmark's table, no kind and no Python file{near(asked, names)}"
        )
    own = {"kind": OWN, "file": Path(asked)} if asked.endswith(".py") else {"kind": asked}
    return BenchmarkCompensator.model_validate(own)


def run_benchmark(request: BenchmarkRequest, watcher: Watcher) -> Benchmarked:
    """Play what is not played yet; raises InputError with all faults before the first run."""
    bench = benchmark_of(request)
    watcher.doing("designing the compensators")
    designed = _all_designed(bench)
    watcher.doing("reading the cases")
    plan = _plan(bench, request)
    path = request.output or FOLDER / f"{bench.spec.name}.jsonl"
    with claimed(path) as ours:
        if not ours:
            raise InputError(f"{path}: is being written by another process; choose another --output, or wait for it")
        kept = _kept(path, plan, bench.figures) if request.resume else {}
        replaced = () if request.resume else check_existing([(path, Kind.DOCUMENT)], request.replace)
        path.parent.mkdir(parents=True, exist_ok=True)
        check_writable(path.parent)
        rows = _written(path, plan, kept, _played(bench, designed, request, kept, watcher))
    if replaced:
        watcher.message(replaced_sentence(replaced))
    adapting = frozenset(one.label for one in designed if one.adapts)
    made = Benchmarked(bench, plan, tuple(rows), path, len(rows) - len(kept), {}, adapting, {})
    if isinstance(bench, TableBenchmark):
        return made
    watcher.doing("judging the laws that adapt")
    delays = {case.name: critical_delay_s(bench, case) for case in bench.spec.cases}
    of_actuator = [one for one in designed if isinstance(one, Designed)]
    return replace(made, critical_delays_s=delays, adaptive=_adaptive(bench, of_actuator))


def _adaptive(bench: DisplacementBenchmark, designed: Sequence[Designed]) -> dict[str, dict[str, AdaptiveVerdict]]:
    """Return the verdicts on the laws that adapt, by compensator and case."""
    found: dict[str, dict[str, AdaptiveVerdict]] = {}
    for one in designed:
        for case in bench.spec.cases if one.adapted is not None and one.adapted.rate.any() else ():
            verdict = CaseRuns(bench, case, bench.storeys(case), np.zeros((1, 1)), one).adaptive()
            found.setdefault(one.label, {}).update({} if verdict is None else {case.name: verdict})
    return found


def _all_designed(bench: AnyBenchmark) -> list[AnyDesigned]:
    """Return the compensators designed; raises InputError with the faults of all."""
    made: list[AnyDesigned] = []
    faults = []
    for one in bench.spec.compensators:
        try:
            made.append(bench.designed(one))
        except InputError as error:
            faults += [f"{one.label}: {fault}" for fault in error.faults]
    if faults:
        raise InputError(*faults)
    return made


def _plan(bench: AnyBenchmark, request: BenchmarkRequest) -> dict[str, Any]:
    """Return what decides the rows: the same plan gives the same bytes."""
    spec = bench.spec.model_dump(mode="json", exclude_none=True)
    files = {str(one.file): sha256(one.file.read_bytes()).hexdigest() for one in bench.spec.compensators if one.file}
    return {
        "format": "rths-benchmark",
        "version": __version__,
        "software_sha256": software(),
        "seed": request.seed,
        **bench.facts(),
        "compensator_files": files,
        "benchmark": spec,
    }


Key = tuple[str, str, int]
Rows = dict[Key, BenchmarkRow]


def _kept(path: Path, plan: dict[str, Any], names: Sequence[str]) -> Rows:
    """Return the rows that an interrupted benchmark has; raises InputError for the file of another plan."""
    if not path.exists():
        return {}
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path}: is no file of benchmark rows; choose another --output")
    head, *lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
    if _read(head) != json.loads(json.dumps(plan)):
        raise InputError(
            f"--resume: {path} has rows of another benchmark, version, seed, case, record or compensator; give the "
            "same options, drop --resume, or choose another --output"
        )
    found = (_read(line) for line in lines)
    rows = [BenchmarkRow(one["case"], one["compensator"], one["plant"], _figures(one, names), one.get("outcome", ""))
            for one in found if one and set(names) <= set(one)]  # fmt: skip
    return {(row.compensator, row.case, row.plant): row for row in rows}


def _read(line: str) -> dict[str, Any]:
    """Return the content of a line, nothing for one that an interruption cut."""
    try:
        found = json.loads(line)
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _figures(line: dict[str, Any], names: Sequence[str]) -> dict[str, float]:
    return {name: float("nan") if line[name] is None else float(line[name]) for name in names}


def _played(
    bench: AnyBenchmark, designed: Sequence[AnyDesigned], request: BenchmarkRequest, kept: Rows, watcher: Watcher
) -> Iterator[BenchmarkRow]:
    """Yield all rows in their order, those that are kept and those that are played now."""
    count = len(designed) * len(bench.spec.cases) * bench.spec.plants
    tasks = bench.tasks(designed)  # type: ignore[arg-type]
    engine = Engine("threads" if request.jobs > 1 else "inline", request.jobs)
    with executor_here(engine) as executor:
        waiting: list[tuple[Key, Future[Ran] | None]] = []
        done = 0
        try:
            while True:
                for one, case, index in tasks:
                    key = (one.label, case, index)
                    run = None if key in kept else executor.submit(bench.played, one, case, index, request.seed)  # type: ignore[arg-type]
                    waiting.append((key, run))
                    if len(waiting) >= AHEAD * request.jobs:
                        break
                if not waiting:
                    return
                key, future = waiting.pop(0)
                label, case, index = key
                done += 1
                watcher.started(done, count, f"{label}, case {case}, plant {index}")
                watcher.doing("playing")
                if future is None:
                    yield kept[key]
                    continue
                ran = future.result()
                yield BenchmarkRow(case, label, index, ran.figures, ran.outcome)
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def _written(path: Path, plan: dict[str, Any], kept: Rows, rows: Iterator[BenchmarkRow]) -> list[BenchmarkRow]:
    """Write plan and rows, each when it is there, so that an interruption leaves all that was played."""
    made = []
    part = path.with_name(f".{path.name}.part") if kept else path  # what was kept is not lost before it is written
    with open(part, "w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(plan) + "\n")
        for row in rows:
            told = {name: value if value == value else None for name, value in row.figures.items()}
            said: dict[str, Any] = told | ({"outcome": row.outcome} if row.outcome else {})
            file.write(
                json.dumps({"case": row.case, "compensator": row.compensator, "plant": row.plant, **said}) + "\n"
            )
            file.flush()
            made.append(row)
            if part != path and len(made) == len(kept):
                os.replace(part, path)
                part = path
    return made
