"""One rule for every command that writes: what was computed is replaced and told, `--no-replace` refuses, measured data
stay."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.case.load import load_cases
from rths_cli.cli import entry_point
from rths_cli.cli.command_group import cli
from rths_cli.experiment.setup import make_setup
from rths_cli.files.measured_data import Recording, write_recording
from rths_cli.files.result_reader import ResultWriter
from tests.helpers.made_result import ATTRIBUTES, TIME
from tests.helpers.page_results import write as write_result

CASE = "el_centro_low_ff_fb"
SHORT = ("--set", "record.file=short.csv")
SUITE = (
    "--records", "suite", "--limit", "drift_m=0.002", "--on", "sim", "--hunt", "--levels", "0.3:2:5", "--set",
    "record.baseline={remove: none, taper_s: 1}",
)  # fmt: skip
QUICK = ("--set", "identification.duration_s=40")


class Writes(NamedTuple):
    """A command, and a file that it writes."""

    words: tuple[str, ...]
    file: str


COMMANDS = {
    "run": Writes(("run", CASE, *SHORT, "--set", "runs=[sim]"), f"results/{CASE}.h5"),
    "run --junit": Writes(("run", CASE, *SHORT, "--set", "runs=[sim]", "--output", "new", "--junit", "j.xml"), "j.xml"),
    "evaluate": Writes(("evaluate", CASE, *SHORT, "--data", "still.npz"), f"results/{CASE}-still.h5"),
    "sweep": Writes(("sweep", CASE, *SHORT), f"sweeps/{CASE}.h5"),
    "sweep --csv": Writes(("sweep", CASE, *SHORT, "--csv", "s.csv"), "s.csv"),
    "merge": Writes(("merge", *(f"sweeps/{CASE}-part{k}of2.h5" for k in (1, 2)), "--output", "both.h5"), "both.h5"),
    "identify": Writes(("identify", CASE, *QUICK, "--no-figure", "--output", "m.h5"), "m.h5"),
    "identify --figure": Writes(("identify", CASE, *QUICK, "--figure", "m.png"), "m.png"),
    "report --output": Writes(("report", "demo.h5", "--output", "r.txt"), "r.txt"),
    "report --format html": Writes(("report", "demo.h5", "--format", "html", "--output", "r.html"), "r.html"),
    "report --junit": Writes(("report", "demo.h5", "--junit", "r.xml"), "r.xml"),
    "report --figures": Writes(("report", "sims.h5", "--figures", "f", "--format", "png"), "f/sims-profiles.png"),
    "export csv": Writes(("export", "demo.h5", "--to", "csv"), "exported/demo.exp_rths.csv"),
    "export mat": Writes(("export", "demo.h5", "--to", "mat"), "exported/demo.mat"),
    "structure --figure": Writes(("structure", "three_storey", "--figure", "s.pdf"), "s.pdf"),
    "benchmark": Writes(
        ("benchmark", "silva2020", "--case", "1", "--compensator", "chen", "--plants", "1", "--record", "short.csv"),
        "benchmarks/silva2020.jsonl",
    ),
    "ida": Writes(("ida", CASE, *SUITE), f"sweeps/{CASE}-ida.h5"),
    "ida --figures": Writes(("ida", CASE, *SUITE, "--output", "i.h5", "--figures", "g"), "g/i-ida.svg"),
}
"""Every command that writes files that may be replaced, and each kind of file."""
NEVER = {"bridge", "calibrate", "new", "recover", "serve"}
"""Commands that replace nothing: a bridge's record, a calibration, a case of the user, a complete result, a key."""
NOTHING = {"check", "data", "doctor", "list", "plugin", "records", "schema"}
"""Commands that write no file that the user names."""
Call = Callable[..., tuple[int, str]]


def hardware_result(path: Path) -> None:
    """Write a result of a real rig."""
    with ResultWriter(path, ATTRIBUTES | {"rig_kind": "udp"}) as writer:
        writer.group("record", {"ground_accel_m_s2": TIME}, TIME)
        writer.finish("complete")


def raw_log(path: Path) -> None:
    """Write what a raw log begins with."""
    path.write_bytes(b"RTHSLOG\n" + bytes(100))


def recording(path: Path) -> None:
    """Write a recording."""
    write_recording(path, Recording(path, "", 0.0005, ("a",), ("m/s^2",), TIME[None]))


MEASURED = {"result": hardware_result, "raw log": raw_log, "recording": recording}


@pytest.fixture
def rths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Call]:
    """Return the command line, called in a folder with a short record and a result."""
    lines = (Path(__file__).parents[2] / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in lines if not line.startswith("#")][:300]
    (tmp_path / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    (tmp_path / "suite").mkdir()
    every = [line for line in lines if not line.startswith("#")]
    for first in (0, 300, 600):
        part = "\n".join(["# units: cm/s^2", "# dt: 0.02 s", *every[first : first + 300]])
        (tmp_path / "suite" / f"{first}.csv").write_text(part + "\n")
    monkeypatch.chdir(tmp_path)
    ground = make_setup(load_cases([CASE], ["record.file=short.csv"])[0]).motion.accel_m_s2
    channels = {f"{name}_accel_m_s2": 0.0 * ground for name in ("table", "floor_2", "floor_3")}
    np.savez(tmp_path / "still.npz", fs=2000.0, ground_accel_m_s2=ground, **channels)
    write_result(tmp_path / "demo.h5")
    write_result(tmp_path / "sims.h5", runs=("sim", "sim_delay"))

    def call(*words: str) -> tuple[int, str]:
        monkeypatch.setattr("sys.argv", ["rths", *words])
        code = entry_point.run_to_exit_code()
        shown = capsys.readouterr()
        return code, " ".join((shown.out + shown.err).split())

    yield call


@parametrize_first(2, "command", COMMANDS)
def test_the_rule_of_existing_files(rths: Call, command: str) -> None:
    words, file = COMMANDS[command]
    path = Path(file)
    for part in ("1/2", "2/2") if command == "merge" else ():
        assert rths("sweep", CASE, *SHORT, "--seeds", "2", "--part", part)[0] == 0
    code, said = rths(*words)
    assert code == 0 and "replaced" not in said, said
    made = path.read_bytes()
    if command == "run --junit":
        shutil.rmtree("new")  # the result is another file
    code, said = rths(*words)
    assert code == 0, said
    assert file in said.rpartition("replaced ")[2] or f"{path.name} (replaced)" in said
    path.write_bytes(made)
    if command == "run --junit":
        shutil.rmtree("new")
    code, said = rths(*words, "--no-replace")
    assert code == 2 and f"{file}: exists; remove it, choose another name, or drop --no-replace" in said
    assert path.read_bytes() == made and not Path("new").exists()
    for kind, write in MEASURED.items():
        write(path)
        made = path.read_bytes()
        code, said = rths(*words)
        assert code == 2 and path.read_bytes() == made, (kind, said)
        told = f"{file}: exists and holds measured data, which are never replaced; choose another name"
        assert told in said or (
            command in ("sweep", "ida") and "is no result of a sweep, which alone is replaced" in said
        )


def test_every_command_is_in_the_rule() -> None:
    written = {name.partition(" ")[0] for name in COMMANDS}
    assert written | NEVER | NOTHING == set(cli.commands)
    assert {name for name, one in cli.commands.items() if any(p.name == "no_replace" for p in one.params)} == written


def test_a_result_takes_the_place_of_a_result_alone(rths: Call) -> None:
    words, file = COMMANDS["run"]
    Path("results").mkdir()
    Path(file).write_text("time,accel\n0,1\n")
    code, said = rths(*words)
    assert code == 2 and "exists and is no result of rths run, which alone is replaced" in said
    assert Path(file).read_text() == "time,accel\n0,1\n"


@pytest.mark.campaign
def test_recordings_and_case_files_are_never_replaced(rths: Call) -> None:
    words = ("identify", CASE, *QUICK, "--no-figure", "--output", "m.h5", "--save-data", "d.h5")
    assert rths(*words)[0] == 0
    made = {path.name: path.read_bytes() for path in Path().glob("d*.h5") if path.name != "demo.h5"}
    assert set(made) == {"d.h5", "d_probe.h5"}
    for name in made:
        Path("d.h5").unlink(missing_ok=True)
        Path(name).write_bytes(made[name])
        code, said = rths(*words)
        assert code == 2 and f"{name}: exists and holds measured data, which are never replaced" in said
        assert Path(name).read_bytes() == made[name]
    assert rths("new", "mine.yaml")[0] == 0
    assert rths("new", "mine.yaml")[0] == 2
