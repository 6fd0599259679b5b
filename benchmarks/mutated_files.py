"""Damage files of every kind and read them: python benchmarks/mutated_files.py [COUNT] [SEED] [--only N] [--keep DIR]
[--valid DIR].

Valid files (results, models, sweeps and their rows, accelerograms, recordings, models from elsewhere, raw logs) are
damaged: bits flipped, pieces cut, doubled or zeroed, headers and names edited, attributes and datasets of other types
and shapes, datasets declared as terabytes, links to elsewhere and in circles. Each is given to a command that reads it,
in a process of its own with 1 GB and 5 s more than the intact file takes (all figures of a result take
longer than 5 s alone). Demanded: exit code 0, 1 or 2, no traceback, no warning of a library, no
control character on the screen. Files checked by a sum are damaged with and without a sum that fits again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import struct
import sys
import tempfile
import time
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
from nptdms import ChannelObject, TdmsWriter

import rths_cli
from rths_cli.cli import main as rths_main
from rths_cli.files.measured_data import read_recording, write_recording
from rths_cli.files.model_file import BLOCK, LEAD, read_model
from rths_cli.files.raw_log import CHECK, START, RawHeader, RawLogWriter
from rths_cli.files.result_reader import read_result
from rths_cli.files.sweep_file import ROWS_FORMAT
from rths_cli.report import check_page, figures, page, report_options  # noqa: F401
from rths_cli.report.export import export_command as _export  # noqa: F401 imported before processes are copied, to save their time
from rths_cli.studies import sweep  # noqa: F401

LIMIT_S = 5.0  # of the processor, which a busy machine does not change
STOPPED_S = 30.0  # of the processor, by the kernel
HANGS_S = 300.0  # of the clock: for a process that waits
REFUSING = 0.05  # share of files that are given to a command for another kind of file
ENDS_S = 10.0  # of the clock, after SIGTERM
TOLD_TO_END = 143
LIMIT_BYTES = 1 << 30
CONTROL = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]")
SHORT_RECORD = "# units: m/s^2\n# dt: 0.01\n" + "\n".join(f"{np.sin(0.3 * k):.5f}" for k in range(450)) + "\n"
CASE = "el_centro_low_ff_fb"
AT_THE_END = ("status", "status_reason", "exit_code", "seeds_per_point", "coordinates", "figures", "format_version")
"""Attributes that a sweep's file has and its rows have not yet."""
ROLES = ("command", "table", "floor_2", "floor_3")


@dataclass(frozen=True)
class Target:
    """A kind of file: a valid one, how it is damaged, the commands that read it (FILE stands for it), which take the
    valid file without a complaint, and those that refuse it because it is no file for them."""

    kind: str
    valid: Path
    hdf5: bool
    commands: tuple[tuple[str, ...], ...]
    seal: Callable[[bytes], bytes] | None = None
    beside: tuple[Path, ...] = ()
    refusing: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class Outcome:
    """How one command took one damaged file."""

    number: int
    kind: str
    damage: str
    command: tuple[str, ...]
    code: int
    seconds: float
    fault: str
    said: str


def main(arguments: Sequence[str]) -> int:
    """Damage and read as many files as asked; return 1 where a demand was not met."""
    options = dict(pairwise(arguments))
    numbers = [int(text) for before, text in zip(("", *arguments), arguments, strict=False) if _is_count(before, text)]
    count, seed = (*numbers, *(20_000, 15)[len(numbers) :])[:2]
    chosen = [int(options["--only"])] if "--only" in options else range(count)
    kept = Path(options["--keep"]).absolute() if "--keep" in options else None
    with tempfile.TemporaryDirectory(prefix="rths-mutated-") as name:
        valid = Path(options.get("--valid", f"{name}/valid")).absolute()
        bad = run_all(Path(name), valid, seed, chosen, kept)
    return 1 if bad else 0


def _is_count(before: str, text: str) -> bool:
    return text.isdigit() and before not in ("--only", "--keep", "--valid")


def run_all(home: Path, valid: Path, seed: int, chosen: Sequence[int], kept: Path | None) -> int:
    """Read damaged files by their numbers, print what went wrong and a summary, and return how many did."""
    rths_cli.check(CASE)  # what every command compiles and imports is there before the copies are made
    targets, codes, bad = make_targets(valid), Counter[tuple[str, int]](), 0
    usual = {} if len(chosen) == 1 else seconds_of_intact(home / "work", targets)
    for done, number in enumerate(chosen, 1):
        outcome = one(home / "work", targets, seed, number, usual, kept)
        codes[outcome.kind, outcome.code] += 1
        if outcome.fault:
            bad += 1
            print(f"{number}: {outcome.kind}, {outcome.damage}, rths {' '.join(outcome.command)}: {outcome.fault}")
            print("   ", outcome.said[-300:].replace("\n", " | ").encode("unicode_escape").decode(), flush=True)
        if done % 500 == 0:
            print(f"{done} files, {bad} failed", flush=True)
    print(f"{len(chosen)} files, {bad} failed; {dict(sorted(codes.items()))}")
    return bad


def one(
    work: Path,
    targets: Sequence[Target],
    seed: int,
    number: int,
    usual_s: Mapping[tuple[str, ...], float],
    kept: Path | None = None,
) -> Outcome:
    """Damage one file, chosen by seed and number alone, and give it to one command."""
    rng = random.Random(f"{seed}/{number}")
    target = targets[number % len(targets)]
    file = folder_with(work, target)
    damage = damaged(target, file, rng)
    command = rng.choice(target.refusing if target.refusing and rng.random() < REFUSING else target.commands)
    told = tuple(part.replace("FILE", file.name) for part in command)
    code, seconds, memory, said = in_a_process(work, told)
    fault = judged(code, seconds - usual_s.get(told, 0.0), memory, said)
    if fault and kept and file.is_file():
        kept.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, kept / f"{number}-{file.name}")
    return Outcome(number, target.kind, damage, told, code, seconds, fault, said.decode(errors="replace"))


def folder_with(work: Path, target: Target) -> Path:
    """Make the folder of one command anew, with what it finds beside its file; return the file's place."""
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    os.mkfifo(work / "fifo")
    for path in target.beside:
        shutil.copy(path, work)
    return work / target.valid.name


def seconds_of_intact(work: Path, targets: Sequence[Target]) -> dict[tuple[str, ...], float]:
    """Return the CPU time that each command takes with the intact file; raises SystemExit where it does not end as it
    must: only a file that is read to its end says what damage does."""
    found = {}
    for target in targets:
        for command in (*target.commands, *target.refusing):
            file = folder_with(work, target)
            shutil.copy(target.valid, file)
            told = tuple(part.replace("FILE", file.name) for part in command)
            code, found[told], _, said = in_a_process_slow(work, told)
            if code != (2 if command in target.refusing else 0):
                line = f"rths {' '.join(told)} of the valid {target.kind} ends with {code}"
                raise SystemExit(f"mutated_files.py: {line}: {said.decode(errors='replace')}")
    return found


def judged(code: int, seconds: float, memory: int, said: bytes) -> str:
    """Return which demand was not met, "" when all were."""
    faults = [f"exit code {code}"] if code not in (0, 1, 2) else []
    faults += [f"{seconds:.1f} s"] if seconds > LIMIT_S else []
    faults += [f"{memory / 1e6:.0f} MB"] if memory > LIMIT_BYTES else []
    faults += ["a traceback"] if b"Traceback" in said else []
    faults += ["a warning"] if b"Warning" in said or b"WARNING" in said else []
    faults += ["a control character"] if CONTROL.search(said) else []
    return ", ".join(faults)


def in_a_process(work: Path, command: Sequence[str], hangs_s: float | None = None) -> tuple[int, float, int, bytes]:
    """Run a command in a copy of this process, told to end after some time of the clock and then killed; return code
    (negative: a signal), CPU time, memory, output."""
    output, start = work / ".output", time.monotonic()
    child = os.fork()
    if child == 0:
        _become(work, command, output)
    status, usage = _waited(child, start + (HANGS_S if hangs_s is None else hangs_s))
    code = os.waitstatus_to_exitcode(status)
    said = output.read_bytes() if output.exists() else b""
    return code, usage.ru_utime + usage.ru_stime, 1024 * usage.ru_maxrss, said


def _waited(child: int, deadline: float) -> tuple[int, Any]:
    """Wait for a process, which is told to end at the deadline, and killed where it does not."""
    for end, number in ((deadline, signal.SIGTERM), (deadline + ENDS_S, signal.SIGKILL)):
        while time.monotonic() < end:
            done, status, usage = os.wait4(child, os.WNOHANG)
            if done:
                return status, usage
            time.sleep(0.002)
        os.killpg(child, number)
    _, status, usage = os.wait4(child, 0)
    return status, usage


def _become(work: Path, command: Sequence[str], output: Path) -> None:
    """Be `rths COMMAND` in a folder, with everything it prints in a file; never return."""
    try:
        os.setpgid(0, 0)
        os.chdir(work)
        os.environ["TMPDIR"] = str(work)
        tempfile.tempdir = None
        handle = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        for number in (1, 2):
            os.dup2(handle, number)
        for name, number in (("stdout", 1), ("stderr", 2)):
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115
        sys.argv = ["rths", *command]
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(STOPPED_S), int(STOPPED_S)))
        resource.setrlimit(resource.RLIMIT_DATA, (2 * LIMIT_BYTES, 2 * LIMIT_BYTES))
        rths_main()
    except SystemExit as ended:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
        os._exit(ended.code if isinstance(ended.code, int) else 1)
    except BaseException as error:
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
    os._exit(99)


# --- valid files ------------------------------------------------------------------------------------------------------


AT_500_HZ = ("--set", "sample_rate_hz=500")
RECORDED = (
    "identify", CASE, *AT_500_HZ, "--set", "identification.duration_s=60", "--save-data", "own.h5",
    "--output", "at500.h5", "--no-figure", "--quiet",
)  # fmt: skip
"""Makes a recording and the model of it."""


def make_targets(folder: Path) -> list[Target]:
    """Make a valid file of every kind."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "short.csv").write_text(SHORT_RECORD)
    case = ("--set", "record=short.csv")
    sweep_line = ("sweep", CASE, "--seeds", "2", "--output", "sweep.h5", "--quiet")
    for line in (
        ("run", CASE, *case, "--output", ".", "--quiet"),
        ("identify", CASE, "--output", "model.h5", "--no-figure", "--quiet"),
        RECORDED,
        sweep_line,
    ):
        if (folder / (line[line.index("--output") + 1])).is_file():  # from --valid
            continue
        code, _, _, said = in_a_process_slow(folder, line)
        assert code in (0, 1), said.decode()
    result = folder / f"{CASE}.h5"
    log = make_log(folder, result)
    record = folder / "short.csv"
    own, *foreign = foreign_files(folder)
    models = foreign_models(folder)
    return [
        result_target(result),
        Target("model", folder / "model.h5", True, reads_model(), sealed_model, (), (("report", "FILE"),)),
        Target("model at 500 Hz", folder / "at500.h5", True, (
            ("identify", "--model", "FILE", "--data", own.name, "--corrected", *AT_500_HZ, "--output", "new.h5",
             "--no-figure"),), sealed_model, (own,)),
        sweep_target(folder / "sweep.h5", sweep_line, record),
        *record_targets(folder),
        *(Target(f"recording {path.name}", path, path.name in ("own.h5", "v73.mat"),
                 reads_recording(path.suffix != ".mat")) for path in (own, *foreign)),
        *(Target(f"foreign {path.name}", path, False, reads_model(), None, (), (("report", "FILE"),))
          for path in models),
        Target("raw log", log, False, (("recover", "FILE"), ("recover", "FILE", "--json")),
               sealed_log, (record,)),
        Target("raw log beside a result", result, True, (("report", "."), ("recover", log.name)), None, (log, record)),
        Target("rows", make_rows(folder), False, ((*sweep_line, "--resume"),), None, (record,)),
    ]  # fmt: skip


def result_target(result: Path) -> Target:
    """Return what reads a result."""
    commands = (
        *(("report", "FILE", "--format", form) for form in ("text", "markdown", "csv", "json", "latex")),
        ("report", "FILE", "--format", "html", "--output", "page.html"),
        ("report", "FILE", "--group-by", "controller"), ("report", "FILE", "--junit", "tests.xml"),
        ("report", "FILE", "--figures", "figures", "--format", "png"),
        *(("export", "FILE", "--to", form) for form in ("csv", "mat", "netcdf")),
        ("export", "FILE", "--to", "csv", "--group", "exp_rths"), ("report", "--baseline", "FILE", "FILE"),
    )  # fmt: skip
    refusing = (
        ("identify", "--data", "FILE", "--no-figure"), ("check", CASE, "--set", "identification.model=FILE"),
        ("sweep", CASE, "--seeds", "2", "--output", "FILE"),
    )  # fmt: skip
    return Target("result", result, True, commands, None, (), refusing)


def sweep_target(path: Path, line: tuple[str, ...], record: Path) -> Target:
    """Return what reads the result of a sweep."""
    commands = (
        *(("report", "FILE", "--format", form) for form in ("text", "markdown", "csv", "json", "latex")),
        (*line, "--resume"), (*line, "--resume", "--csv", "out.csv"),
    )  # fmt: skip
    refusing = (("report", "FILE", "--format", "html", "--output", "page.html"), ("export", "FILE", "--to", "csv"))
    return Target("sweep", path, True, commands, None, (record,), refusing)


def reads_model() -> tuple[tuple[str, ...], ...]:
    """Return the commands that read a model."""
    line = ("check", CASE, "--set", "identification.model=FILE", "--quiet")
    return line, (*line, "--json", "--override", "model")


def reads_recording(states_units: bool) -> tuple[tuple[str, ...], ...]:
    """Return the commands that read a recording; units are told where the file states none."""
    line = ("identify", "--data", "FILE", "--corrected", *AT_500_HZ, "--no-figure")
    units = {role: "V" if role == "command" else "m/s^2" for role in ROLES}
    told = (part for role, unit in units.items() for part in ("--channel", f"{role}={role}:{unit}"))
    whole = (*line, "--rate", "500", *told)
    return (line, (*line, "--json"), whole) if states_units else (whole, (*whole, "--json"))


def record_targets(folder: Path) -> list[Target]:
    """Write accelerograms in three formats, and return what reads them."""
    at2, named = folder / "old.AT2", folder / "named.csv"
    body = SHORT_RECORD.splitlines()[2:]
    at2.write_text("PEER NGA\nTOWN\nACCELERATION IN UNITS OF G\nNPTS= 450, DT= .0100 SEC\n" + "\n".join(body) + "\n")
    rows = "\n".join(f"{0.01 * k:.2f},{np.sin(0.3 * k):.5f}" for k in range(450))
    named.write_text(f"time (s),acceleration (m/s^2)\n{rows}\n")
    reads = (
        ("records", "./FILE"), ("records", "./FILE", "--json"),
        ("check", CASE, "--set", "record=./FILE", "--set", "scaling=0.01", "--quiet"),
    )  # fmt: skip
    kinds = {"record": folder / "short.csv", "AT2": at2, "named record": named}
    return [Target(kind, path, False, reads) for kind, path in kinds.items()]


def in_a_process_slow(folder: Path, line: Sequence[str]) -> tuple[int, float, int, bytes]:
    """Run a command that makes a valid file, with as much time as it takes."""
    global STOPPED_S, HANGS_S
    before, STOPPED_S, HANGS_S = (STOPPED_S, HANGS_S), 600.0, 600.0
    try:
        return in_a_process(folder, line)
    finally:
        STOPPED_S, HANGS_S = before
        (folder / ".output").unlink(missing_ok=True)


def foreign_files(folder: Path) -> tuple[Path, ...]:
    """Write the recording own.h5 in every other format; return all, own.h5 first."""
    own = replace(read_recording(folder / "own.h5"), names=ROLES)
    write_recording(own.path, own)
    columns = list(zip(own.names, own.units, own.samples, strict=True))
    v73, v5, csv, tdms = (folder / name for name in ("v73.mat", "v5.mat", "data.csv", "data.tdms"))
    with h5py.File(v73, "w", userblock_size=512) as file:
        for role, _, values in columns:
            file[role] = values[None]
            file[role].attrs["MATLAB_class"] = np.bytes_("double")
        file["fs"] = np.array([[500.0]])
    with open(v73, "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    scipy.io.savemat(v5, {**{role: values for role, _, values in columns}, "fs": 500.0})
    head = f"# dt: {own.dt_s} s\n" + ",".join(f"{role} ({unit})" for role, unit, _ in columns)
    csv.write_text(head + "\n" + "\n".join(",".join(f"{v:.7g}" for v in row) for row in own.samples.T) + "\n")
    with TdmsWriter(tdms) as writer:
        told = {"wf_increment": own.dt_s}
        writer.write_segment([
            ChannelObject("g", role, values, {**told, "unit_string": unit}) for role, unit, values in columns
        ])  # fmt: skip
    return folder / "own.h5", v73, v5, csv, tdms


def foreign_models(folder: Path) -> tuple[Path, ...]:
    """Write the identified table model as YAML and for MATLAB, as other programs would."""
    found = read_model(folder / "model.h5").groups["table/best"]
    roots = {name: np.asarray(found[name]) for name in ("zeros", "poles")}
    pairs = {name: [[value.real, value.imag] for value in values.tolist()] for name, values in roots.items()}
    text, mat = folder / "foreign.yaml", folder / "foreign.mat"
    about = {"gain": float(found["gain"]), "delay_s": float(found["delay_s"])}
    text.write_text(json.dumps(pairs | about, indent=1) + "\n")
    scipy.io.savemat(mat, roots | about)
    return text, mat


def make_log(folder: Path, result: Path) -> Path:
    """Write a raw log of a run that was killed."""
    found = read_result(result)
    names = ["command_v", "base_shear_n", "desired_accel_m_s2", "desired_velocity_m_s", "desired_displacement_m"]
    names += [f"corrected_{i}" for i in range(3)] + [f"estimated_{i}" for i in range(7)]
    attributes = {key: value for key, value in found.attributes.items() if not key.startswith("exp_rths")}
    about = {"dt_s": 0.0005, "steps": 1200, "lead_samples": 1, "run": "exp_rths", "result": "killed.h5"}
    header = RawHeader(
        names=tuple(names), units=("1",) * len(names), case_path="case.yaml", case_yaml=found.case_yaml,
        resolved_yaml=found.resolved_yaml.replace(str(folder), "."), attributes=attributes, **about,
    )  # fmt: skip
    path = folder / "killed.exp_rths.rthslog"
    path.unlink(missing_ok=True)
    with RawLogWriter(path, header) as log:
        for first in range(0, 600, 100):
            log.append(first, np.random.default_rng(first).normal(size=(len(names), 100)))
    return path


def make_rows(folder: Path) -> Path:
    """Write the rows of an interrupted sweep beside no result."""
    path = folder / "sweep.h5.rows"
    attributes: dict[str, Any] = {}
    with h5py.File(folder / "sweep.h5") as file:
        for key, value in file.attrs.items():
            if key not in AT_THE_END:
                attributes[key] = value.item() if isinstance(value, np.generic) else value
        width = sum(int(np.prod(node.shape[1:])) for node in file.values() if node.dtype.kind == "f")
    row = [0, "complete", "", 0, "safe", "", [0.5] * width]
    path.write_text("".join(json.dumps(line) + "\n" for line in (attributes | {"format": ROWS_FORMAT}, row)))
    return path


# --- damage -----------------------------------------------------------------------------------------------------------


def damaged(target: Target, file: Path, rng: random.Random) -> str:
    """Write a damaged copy of a valid file and return what was done."""
    done = []
    if target.hdf5 and rng.random() < 0.6:
        shutil.copy(target.valid, file)
        done += [edited(file, rng) for _ in range(rng.randint(1, 2))]
        data = file.read_bytes()
    else:
        data = target.valid.read_bytes()
        is_text = b"\0" not in data[:2000]
        for _ in range(rng.randint(1, 3)):
            damage = rng.choice(TEXT_DAMAGES if is_text and rng.random() < 0.8 else DAMAGES)
            data = damage(data, rng)
            done.append(damage.__name__)
    if target.seal and rng.random() < 0.7:
        data = target.seal(data)
        done.append("sealed")
    file.write_bytes(data)
    return "+".join(done)


def flipped(data: bytes, rng: random.Random) -> bytes:
    """Flip up to 16 bits, rather at the beginning, where the header stands."""
    found = bytearray(data)
    for _ in range(rng.randint(1, 16)):
        if found:
            place = int(len(found) * rng.random() ** rng.choice((1, 3)))
            found[place] ^= 1 << rng.randrange(8)
    return bytes(found)


def cut(data: bytes, rng: random.Random) -> bytes:
    """Cut the end off."""
    return data[: int(len(data) * rng.random())]


def zeroed(data: bytes, rng: random.Random) -> bytes:
    """Overwrite a piece by zeros, ones or noise."""
    start = rng.randrange(len(data) + 1)
    length = min(rng.choice((1, 8, 64, 4096)), len(data) - start)
    return data[:start] + rng.choice((bytes(length), b"\xff" * length, rng.randbytes(length))) + data[start + length :]


def doubled(data: bytes, rng: random.Random) -> bytes:
    """Put a piece in again elsewhere."""
    start, place = rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)
    return data[:place] + data[start : start + rng.choice((1, 16, 512))] + data[place:]


def taken(data: bytes, rng: random.Random) -> bytes:
    """Take a piece out."""
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.choice((1, 16, 512)) :]


def number_replaced(data: bytes, rng: random.Random) -> bytes:
    """Put another number in the place of one."""
    found = list(re.finditer(rb"-?\d+(\.\d*)?([eE][-+]?\d+)?", data[: rng.choice((200, len(data)))]))
    if not found:
        return data
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(NUMBERS) + data[match.end() :]


def text_put_in(data: bytes, rng: random.Random) -> bytes:
    """Put hostile text somewhere, rather into the first lines."""
    place = rng.randrange(min(len(data), rng.choice((40, 200, 10**9))) + 1)
    return data[:place] + rng.choice(TEXTS) + data[place:]


def line_put_in(data: bytes, rng: random.Random) -> bytes:
    """Put a hostile line before one of the first."""
    lines = data.split(b"\n")
    place = rng.randrange(min(len(lines), 6) + 1)
    return b"\n".join([*lines[:place], rng.choice(LINES), *lines[place:]])


def lines_shuffled(data: bytes, rng: random.Random) -> bytes:
    """Put one line elsewhere."""
    lines = data.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    return b"\n".join([*lines[: (place := rng.randrange(len(lines) + 1))], line, *lines[place:]])


NUMBERS = (
    b"9" * 5000, b"1e308", b"-1e308", b"1e999", b"nan", b"NaN", b"inf", b"-inf", b"0", b"-1", b"1e-320", b"", b"x",
    b"0x10", b"1_000", b"1e18", b"99999999999", b"0." + b"1" * 5000, b"1e" + b"9" * 5000, "\u0663".encode(), b"=1+1",
)  # fmt: skip
TEXTS = (
    b" " * 300, b" " * 20_000, b"\t" * 3000, b"(" * 40_000, b"[" * 40_000, b")" * 40_000, b"a" * 150_000, b"\0",
    b"\x1b[2J", b"\x1b]0;x\x07", b"\xff\xfe", b"\xef\xbb\xbf", "\u202e".encode(), b"\r", b'"' * 1001, b"," * 5000,
    b"#", b"=1+1", b"{" * 3000, b"'" * 999, b"- " * 5000, b"&a " * 100, b"!!python/object/apply:os.system ",
    b"<script>", b"\\" * 100, b"%s%n", b"\n" * 3000,
)  # fmt: skip
LINES = (
    b"# samples: " + b"7" * 5000, b"# units: " + b"(" * 3000, b"# dt: " + b"1" * 5000, b" " * 300 + b"x",
    b"dt" + b" " * 3000, b"NPTS= " + b"8" * 5000 + b", DT= 0.01", b"NPTS" + b" " * 20_000 + b"x", b"# dt: 0.01",
    b"# units: g", b"# origin: \x1b[31m", b"# \x1b[2J", b"dt = " + b" " * 3000, b"fs: " + b"9" * 4000,
    b"sample rate" + b"=" * 4000, b"UNITS " * 3000, b"1 " * 3000, b"a" + b" " * 5000 + b"=" + b" " * 5000 + b"1",
    b",".join([b"command"] * 3000), b"\x9b2J\xc2\x9b", b'"' + b"x" * 140_000,
)  # fmt: skip
DAMAGES = (flipped, flipped, flipped, cut, zeroed, doubled, taken)
TEXT_DAMAGES = (number_replaced, number_replaced, text_put_in, line_put_in, lines_shuffled, flipped, cut, taken)


def sealed_model(data: bytes) -> bytes:
    """Return a model file whose sum fits its bytes."""
    after = data[BLOCK:]
    return (LEAD + hashlib.sha256(after).hexdigest().encode() + b"\n").ljust(BLOCK, b"\0") + after


def sealed_log(data: bytes) -> bytes:
    """Return a raw log whose header's length and sum fit again; some of its frames may not."""
    if len(data) < START.size:
        return data
    magic, version, length = START.unpack_from(data)
    match = re.search(rb"\}(?=.{4}RTHF)", data, re.DOTALL)
    end = match.end() if match else min(START.size + length, len(data))
    with contextlib.suppress(struct.error):
        start = START.pack(magic, version, end - START.size) + data[START.size : end]
        return start + CHECK.pack(zlib.crc32(start)) + data[end + CHECK.size :]
    return data


def edited(path: Path, rng: random.Random) -> str:
    """Edit the structure of an HDF5 file; return what was done."""
    names: list[str] = []
    try:
        with h5py.File(path, "r+") as file:
            file.visit(names.append)
            edit = rng.choice(EDITS)
            edit(file, rng.choice(_weighted(names, rng)) if names else "x", rng)
            return edit.__name__
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        return f"nothing ({type(error).__name__})"


def _weighted(names: list[str], rng: random.Random) -> list[str]:
    """Return names, half of the time those of figures alone."""
    small = [name for name in names if name.startswith(("metrics", "case", "record"))]
    return small if small and rng.random() < 0.5 else names


def attribute_replaced(file: Any, name: str, rng: random.Random) -> None:
    """Give an attribute of the root, or of an object, another value."""
    node = file if rng.random() < 0.6 else file[name]
    key = rng.choice([*node.attrs, *(("new", "\x1b[2J") if rng.random() < 0.2 else ())])
    node.attrs[key] = rng.choice(VALUES)


def attribute_removed(file: Any, name: str, rng: random.Random) -> None:
    """Remove an attribute."""
    node = file if rng.random() < 0.6 else file[name]
    del node.attrs[rng.choice(list(node.attrs))]


def object_removed(file: Any, name: str, rng: random.Random) -> None:
    """Remove a group or dataset."""
    del file[name]


def object_replaced(file: Any, name: str, rng: random.Random) -> None:
    """Put a dataset of other values, type or shape in the place of an object, its attributes kept."""
    old = dict(file[name].attrs)
    del file[name]
    node = file.create_dataset(name, data=rng.choice(VALUES))
    node.attrs.update({key: value for key, value in old.items() if isinstance(value, str)})


def values_replaced(file: Any, name: str, rng: random.Random) -> None:
    """Write other numbers into a dataset."""
    node = file[name]
    node[...] = rng.choice((np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, 1e-320, -1.0, 1e30))


def made_huge(file: Any, name: str, rng: random.Random) -> None:
    """Declare a dataset of terabytes without a value in it."""
    old = dict(file[name].attrs)
    del file[name]
    shape = rng.choice(((10**12,), (10**6, 10**6), (2**40,), (10**9,), (3, 10**9)))
    node = file.create_dataset(
        name, shape, dtype=rng.choice(("f8", "f4", "i1")), chunks=(1,) * (len(shape) - 1) + (1024,)
    )
    node.attrs.update({key: value for key, value in old.items() if isinstance(value, str)})


def linked(file: Any, name: str, rng: random.Random) -> None:
    """Put a link elsewhere or in a circle in the place of an object."""
    del file[name]
    other = rng.choice(["/", "/nowhere", name, *file])
    if rng.random() < 0.4:
        file[name] = file[rng.choice([".", name.rpartition("/")[0] or "."])]  # a hard link: a circle
    elif rng.random() < 0.5:
        file[name] = h5py.SoftLink(other)
    else:
        file[name] = h5py.ExternalLink(rng.choice(("fifo", "/dev/zero", "/etc/passwd", "nowhere.h5")), "/")


def nested(file: Any, name: str, rng: random.Random) -> None:
    """Put groups inside groups, or very many beside each other."""
    if rng.random() < 0.5:
        group = file
        for _ in range(rng.choice((60, 1500))):
            group = group.create_group("g")
        group["x"] = 1.0
    else:
        group = file.require_group(rng.choice(("metrics", "sim", "many")))
        for number in range(5000):
            group.create_group(f"g{number}")


def named_oddly(file: Any, name: str, rng: random.Random) -> None:
    """Move an object to a hostile name."""
    odd = rng.choice(
        ("\x1b[31mred", "=1+1", "a" * 5000, "..", "<script>", "ü\u202e", "x y", "1", "-h", "\x07", "class")
    )
    file.move(name, f"{name.rpartition('/')[0]}/{odd}")


def outside(file: Any, name: str, rng: random.Random) -> None:
    """Keep the values of a dataset in another file."""
    del file[name]
    file.create_dataset(
        name, (1000,), dtype="f8", external=[(rng.choice(("fifo", "/dev/zero", "/etc/passwd")), 0, 8000)]
    )


EDITS = (
    attribute_replaced, attribute_replaced, attribute_replaced, attribute_removed, object_removed, object_replaced,
    object_replaced, values_replaced, values_replaced, made_huge, linked, linked, nested, named_oddly, outside,
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    "x", "", "\x1b[2Jred", "=1+1", "9" * 5000, "a\nb", "<script>alert(1)</script>", "[1]", "{", "null", "\u202e",
    0, -1, 7, 2**62, 1e308, -1e308, float("nan"), float("inf"), 1e-320, True, np.uint8(3), np.float16(2), 1 + 2j,
    np.zeros(0), np.zeros((0, 3)), np.ones(3), np.ones(4), np.ones((3, 3)), np.ones((2, 2, 2)), np.full(3, np.nan),
    np.full(3, 1e308), np.arange(1000.0), np.bytes_(b"\xff\xfe"), np.array([b"a", b"\x1b"]), np.array([1, 2], "i1"),
    np.zeros(2, dtype=[("a", "f8"), ("b", "i4")]), np.array(["a", "b"], dtype=h5py.string_dtype()), h5py.Empty("f8"),
    h5py.Empty(h5py.string_dtype()), np.void(b"\0\1"),
)  # fmt: skip

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
