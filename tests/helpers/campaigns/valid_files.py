"""Valid files of every kind that commands read, and the commands that read each of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
from nptdms import ChannelObject, TdmsWriter

from campaigns.command_trials import in_a_process_slow
from campaigns.file_damage import Target, sealed_log, sealed_model
from rths_cli.files.measured_data import read_recording, write_recording
from rths_cli.files.model_file import read_model
from rths_cli.files.raw_log import RawHeader, RawLogWriter
from rths_cli.files.result_reader import read_result
from rths_cli.files.sweep_file import ROWS_FORMAT

SHORT_RECORD = "# units: m/s^2\n# dt: 0.01\n" + "\n".join(f"{np.sin(0.3 * k):.5f}" for k in range(450)) + "\n"
CASE = "el_centro_low_ff_fb"
AT_THE_END = ("status", "status_reason", "exit_code", "seeds_per_point", "coordinates", "figures", "format_version")
"""Attributes that a sweep's file has and its rows have not yet."""
ROLES = ("command", "table", "floor_2", "floor_3")


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
        *(("export", "FILE", "--to", form) for form in ("csv", "mat")),
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
