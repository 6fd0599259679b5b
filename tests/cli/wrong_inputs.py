"""Wrong and unusual inputs of a first week with rths: files and commands; the answers: tests/golden/wrong_inputs.txt.

`python tests/cli/wrong_inputs.py` prints the list for a reader.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

TOWER = """\
numerical:
  masses_kg: [8.0, 8.0]
  stiffness_n_per_m: [9000, 8000]
experimental:
  masses_kg: [5.0, 5.0]
  stiffness_n_per_m: [7000, 6000]
  damping_ratios: [0.04, 0.04]
damping_levels:
  design: {first_mode_ratio: 0.03}
"""
CASE = """\
structure: tower
damping: design
record: pulse.csv
scaling: 1.0
controller: FF+FB
"""
PULSE = "time_s,accel_m_s2\n" + "".join(
    f"{0.02 * k:.2f},{math.sin(0.19 * k) * math.exp(-((0.02 * k - 3.0) ** 2)):.5f}\n" for k in range(500)
)
COMPILING = ("first run of this version", "compiling real-time code")  # what a process says once
COMMON = {"tower.yaml": TOWER, "pulse.yaml": CASE, "pulse.csv": PULSE}


@dataclass(frozen=True)
class Wrong:
    """One input: what the user did, the command's words, the user's own files, the exit code."""

    did: str
    words: str
    files: dict[str, str | bytes] = field(default_factory=dict)
    code: int = 2
    masked: bool = False  # whether computed numbers, which differ between processors, are `#` in the kept list
    prepare: Callable[[Path], None] | None = None


def case(old: str, new: str, text: str = CASE) -> dict[str, str | bytes]:
    """Return a case file x.yaml in which one text is replaced."""
    assert old in text
    return {"x.yaml": text.replace(old, new)}


def building(*texts: str) -> dict[str, str | bytes]:
    """Return a case x.yaml with a structure b.yaml in which texts are replaced: old, new, old, new ..."""
    changed = TOWER
    for old, new in zip(texts[::2], texts[1::2], strict=True):
        assert old in changed
        changed = changed.replace(old, new)
    return {"b.yaml": changed, "x.yaml": CASE.replace("tower", "b")}


def further(line: str) -> dict[str, str | bytes]:
    """Return a case x.yaml with a further line."""
    return {"x.yaml": f"{CASE}{line}\n"}


def record(text: str | bytes, name: str = "r.csv") -> dict[str, str | bytes]:
    """Return a case x.yaml with a record of its own."""
    return {name: text, "x.yaml": CASE.replace("pulse.csv", name)}


def _result(folder: Path) -> None:
    """Make a small result file results/c5.h5."""
    from made_result import make

    (folder / "results").mkdir()
    make(folder / "results" / "c5.h5")


def _old_folder(folder: Path) -> None:
    """Make a folder with a result and a file that is none."""
    _result(folder)
    (folder / "results" / "older.h5").write_bytes(b"not HDF5 at all")


WORKBOOK = b"PK\x03\x04\x14\x00\x06\x00\x08\x00" + bytes(40)
GAL = "".join(f"{0.01 * k:.2f},{300 * math.sin(0.1 * k):.4f}\n" for k in range(300))
PEAKS = "0.00;-0,133655\n0.01;-0,2\n0.02;0,1\n"

LABORATORY = "--set table=aps400_laboratory"

WRONG: tuple[Wrong, ...] = (
    # the command line
    Wrong("mistyped the command", "rnu pulse"),
    Wrong("named no case", "run"),
    Wrong("mistyped an option", "run pulse --outptu out"),
    Wrong("took a word of another program for an option's value", "run pulse --method newmark"),
    Wrong("named a case that is not there", "run pulsee"),
    Wrong("named a file that is not there", "run cases/pulse.yaml"),
    Wrong("gave the folder of results instead of a case", "run results", prepare=_result),
    Wrong("gave the structure instead of the case", "run tower.yaml"),
    Wrong("gave the record instead of the case", "run pulse.csv"),
    Wrong("gave the result instead of the case", "check results/c5.h5", prepare=_result),
    Wrong("let --output name a file", "run pulse --output pulse.csv"),
    Wrong("exported without a format", "export results/c5.h5", prepare=_result),
    Wrong("asked for the tables where there are no results", "report"),
    Wrong("reported a case instead of its result", "report pulse.yaml"),
    Wrong("reported a folder in which one file is damaged", "report results", prepare=_old_folder),
    Wrong("asked for a kind of thing in the singular", "list case"),
    Wrong("recovered what is no log", "recover pulse.csv"),
    Wrong("gave channels without measured data", "identify pulse --channel table=ai0"),
    Wrong("measured data that are not there", "identify pulse --data measured.csv"),
    Wrong("would write a new case over an old one", "new pulse.yaml"),
    Wrong("asked for the spectrum of an unknown record", "records elcentro"),
    Wrong("asked for an unknown structure", "structure towr"),
    # --set and sweeps
    Wrong("set a key without a value", "run pulse --set scaling"),
    Wrong("set an unknown key", "run pulse --set scalling=0.5"),
    Wrong("set an element of a list", "run pulse --set structure.numerical.masses_kg[1]=12"),
    Wrong("set the hidden physics without its table", "serve --set physics.coulomb_n=0"),
    Wrong("swept a range without a count", "sweep pulse --vary scaling=0.1:0.5"),
    Wrong("swept a key that an EXP-RTHS does not read", "sweep pulse --vary delay_s=0.001:0.010:10"),
    Wrong("set a limit outside its mapping", "run pulse --set stroke_m=0.05"),
    Wrong("swept an unknown key", "sweep pulse --vary damping.ratio=0.02,0.03"),
    Wrong("swept one value twice", "sweep pulse --vary scaling=1,1"),
    # YAML
    Wrong("left a colon out", "check x.yaml", case("scaling: 1.0", "scaling 1.0")),
    Wrong("left the space after a colon out", "check x.yaml", case("scaling: 1.0", "scaling:1.0")),
    Wrong("indented with a tab", "check x.yaml", case("controller: FF+FB", "controller:\n\tkind: FF+FB")),
    Wrong("wrote a key twice", "check x.yaml", further("scaling: 2.0")),
    Wrong("wrote nothing", "check x.yaml", {"x.yaml": ""}),
    Wrong("saved the case from a word processor", "check x.yaml", {"x.yaml": WORKBOOK}),
    # values of a case
    Wrong("wrote a percentage", "check x.yaml", case("scaling: 1.0", "scaling: 30%")),
    Wrong("wrote a decimal comma", "check x.yaml", case("scaling: 1.0", "scaling: 0,3")),
    Wrong("wrote the unit behind the number", "check x.yaml", further("delay_s: 5 ms")),
    Wrong("gave a delay in milliseconds", "check x.yaml", further("delay_s: 5")),
    Wrong("scaled by zero", "check x.yaml", case("scaling: 1.0", "scaling: 0")),
    Wrong("gave the damping as a number", "check x.yaml", case("damping: design", "damping: 0.03")),
    Wrong("gave the damping in percent", "check x.yaml", case("damping: design", "damping: {first_mode_ratio: 3}")),
    Wrong(
        "asked for less damping than the specimen has",
        "check x.yaml",
        case("damping: design", "damping: {first_mode_ratio: 0.001}"),
    ),
    Wrong("asked for another damping level", "check x.yaml", case("damping: design", "damping: low")),
    Wrong("named a controller that is none", "check x.yaml", case("FF+FB", "PID")),
    Wrong("wrote the controller in small letters", "check x.yaml", case("FF+FB", "ff+fb")),
    Wrong("listed an unknown run", "check x.yaml", further("runs: [sim, rths]")),
    Wrong("gave one run instead of a list", "check x.yaml", further("runs: exp_rths")),
    Wrong("limited a metric that is not there", "check x.yaml", further("accept: {exp_rths.rms_eror_m_s2: 0.01}")),
    Wrong("gave the rate in kHz", "check x.yaml", further("sample_rate_hz: 2")),
    Wrong("named a rig that is not there", "check x.yaml", further("table: aps113")),
    Wrong("changed physics without saying of which rig", "check x.yaml", further("table: {physics: {coulomb_n: 0.9}}")),
    Wrong(
        "mistyped a key of the rig",
        "check x.yaml",
        further("table: {extends: aps400_virtual, physics: {coulomb: 0.9}}"),
    ),
    Wrong("left the rig's model out", "check x.yaml", further("table: udp_loopback")),
    # buildings
    Wrong(
        "gave no damping levels", "check x.yaml", building("damping_levels:\n  design: {first_mode_ratio: 0.03}\n", "")
    ),
    Wrong(
        "gave the structure no experimental part",
        "check x.yaml",
        building(TOWER[TOWER.index("experimental") : TOWER.index("damping_levels")], ""),
    ),
    Wrong(
        "gave damping ratios in percent",
        "check x.yaml",
        building("damping_ratios: [0.04, 0.04]", "damping_ratios: [2, 3]"),
    ),
    Wrong("put no storey on the table", "check x.yaml", building("masses_kg: [5.0, 5.0]", "masses_kg: []")),
    Wrong("gave one stiffness for two floors", "check x.yaml", building("[9000, 8000]", "[9000]")),
    Wrong(
        "gave stiffnesses and frequencies",
        "check x.yaml",
        building("  damping_ratios", "  natural_frequencies_hz: [3, 8]\n  damping_ratios"),
    ),
    Wrong(
        "gave frequencies that no such building has",
        "check x.yaml",
        building("stiffness_n_per_m: [7000, 6000]", "natural_frequencies_hz: [3.0, 3.1]"),
    ),
    Wrong("gave a negative mass", "check x.yaml", building("[8.0, 8.0]", "[8.0, -8.0]")),
    Wrong("called the masses tonnes", "check x.yaml", building("masses_kg: [8.0, 8.0]", "masses_t: [0.008, 0.008]")),
    Wrong(
        "gave masses in tonnes",
        "run x.yaml --set controller=FF",
        building("[8.0, 8.0]", "[0.008, 0.008]", "[5.0, 5.0]", "[0.005, 0.005]"),
        1,
        masked=True,
    ),
    Wrong(
        "gave stiffnesses in kN/m",
        "run x.yaml --quiet",
        building("[9000, 8000]", "[9, 8]", "[7000, 6000]", "[7, 6]"),
        4,
        masked=True,
    ),
    Wrong(
        "put a real building on the table",
        "run x.yaml",
        building("[8.0, 8.0]", "[2e5, 2e5]", "[5.0, 5.0]", "[2e5, 1.8e5]", "[9000, 8000]", "[2e8, 2e8]"),
    ),
    # records
    Wrong("named a record that is not there", "check x.yaml", case("pulse.csv", "northridge")),
    Wrong("mistyped the record's file", "check x.yaml", case("pulse.csv", "pulse.cvs")),
    Wrong(
        "saved the record with decimal commas",
        "check x.yaml",
        record("time_s;accel_m_s2\n" + PEAKS.replace("0.0", "0,0")),
    ),
    Wrong(
        "saved the record with decimal commas and commas between the columns",
        "check x.yaml",
        record("time_s,accel_m_s2\n0,00,0,000\n0,01,-0,133\n0,02,0,1\n"),
    ),
    Wrong("gave a record without a unit", "check x.yaml", record("0.00,0.0\n0.01,0.1\n0.02,0.0\n")),
    Wrong(
        "gave a record with a gap",
        "check x.yaml",
        record("time_s,accel_m_s2\n0.00,0\n0.01,1\n0.02,1\n0.05,0\n0.06,0\n"),
    ),
    Wrong("gave a record with a missing value", "check x.yaml", record("time_s,accel_m_s2\n0.00,0\n0.01,\n0.02,1\n")),
    Wrong("gave the record as a workbook", "check x.yaml", record(WORKBOOK, "r.xlsx")),
    Wrong("cut the record too short", "check x.yaml", record("time_s,accel_m_s2\n0.00,0\n0.01,1\n0.02,1\n0.03,0\n")),
    Wrong("gave an empty record", "check x.yaml", record("")),
    Wrong("gave a record in cm/s^2 that says m/s^2", "check x.yaml", record("time_s,accel_m_s2\n" + GAL)),
    Wrong("scaled beyond the table", "run x.yaml", case("scaling: 1.0", "scaling: 10"), 1, masked=True),
    # calibrating a rig
    Wrong("calibrated a rig without its case", "calibrate aps400_laboratory --output lab.yaml"),
    Wrong("measured nothing", f"calibrate pulse {LABORATORY} --output lab.yaml"),
    Wrong("gave no uncertainty", f"calibrate pulse {LABORATORY} --output lab.yaml --sensitivity table=1012mV/g"),
    Wrong(
        "compared in mV/g without saying so",
        f"calibrate pulse {LABORATORY} --output lab.yaml --sensitivity table=1012+-2",
    ),
    Wrong("would calibrate into an old file", f"calibrate pulse {LABORATORY} --output pulse.yaml --mass floor_3=5+-1%"),
    Wrong(
        "gave the calibration instead of the case", "check lab.yaml", {"lab.yaml": "rig: bench\nmade_utc: 2026-11-24\n"}
    ),
)


PROGRESS = re.compile(r"starting$|.*(s left|: probe|  probe|^probe)|\[\d+/\d+\] \S+  ")  # how fast it was decides of it


def printed(wrong: Wrong, folder: Path) -> tuple[int, str]:
    """Return the exit code of a command run in this process, and what it printed without the folder's own path."""
    from rths_cli.cli.entry_point import run_to_exit_code

    for name, text in {**COMMON, **wrong.files}.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    if wrong.prepare:
        wrong.prepare(folder)
    out, err, before, words = io.StringIO(), io.StringIO(), Path.cwd(), sys.argv
    try:
        os.chdir(folder)
        sys.argv = ["rths", *wrong.words.split()]
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run_to_exit_code()
    finally:
        os.chdir(before)
        sys.argv = words
    said = "".join(line for line in err.getvalue().splitlines(keepends=True) if not PROGRESS.match(line))
    return code, (said + out.getvalue()).replace(str(folder), ".")


def listed(wrongs: Sequence[Wrong] = WRONG, whole: bool = True) -> Iterator[tuple[Wrong, int, str]]:
    """Yield each input with its exit code and a text: number, command, what is printed, `whole` or masked."""
    for number, wrong in enumerate(wrongs, 1):
        with tempfile.TemporaryDirectory() as folder:
            code, text = printed(wrong, Path(folder).resolve())
        lines = [line for line in text.rstrip().splitlines() if not line.startswith(COMPILING)]
        shown = "\n".join(lines)
        shown = re.sub(r" +\d+\.\d+|(?<=\()\d+\.\d+", " #", shown) if wrong.masked and not whole else shown
        yield wrong, code, f"{number}. {wrong.did}\n$ rths {wrong.words}\n{shown}\n[exit code {code}]\n"


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
    for _, _, text in listed():
        print(text, flush=True)
