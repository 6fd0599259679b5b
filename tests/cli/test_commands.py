"""The real process: exit codes, what stands on stdout and stderr, and what is not imported."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from warm_command import rths_words

HEAVY = ("numpy", "scipy", "numba", "pydantic", "h5py", "matplotlib", "rich", "yaml", "control")


def rths(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=120, check=False)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['rths', '--help']; import rths_cli.cli as c\n"
        "try: c.main()\nexcept SystemExit: pass\n"
        f"print([m for m in {HEAVY!r} if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr.strip() == "[]"
    assert "Commands:" in done.stdout


@pytest.mark.parametrize(
    "command",
    ["run", "sweep", "check", "report", "identify", "records", "new", "schema", "doctor", "calibrate", "serve"],
)
def test_every_command_has_help_with_an_example(command: str) -> None:
    done = rths(command, "--help")
    assert done.returncode == 0
    assert f"Example: rths {command}" in " ".join(done.stdout.split())


def test_unknown_option_is_bad_usage() -> None:
    done = rths("run", "--frobnicate", "x")
    assert done.returncode == 2
    assert "frobnicate" in done.stderr
    assert done.stdout == ""


def test_a_wrong_case_names_every_fault_and_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(
        "structure: three_storey\ndamping: low\nrecord: el_centro\nscaling: -1\ncontrol: FF\n"
    )
    done = rths("run", "a.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert "a.yaml:4:" in done.stderr and "a.yaml:5:" in done.stderr
    assert "Traceback" not in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.yaml"]


def test_one_wrong_case_of_two_stops_both_before_they_start(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("structure: nowhere\n")
    done = rths("run", "el_centro_low_ff", "a.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("0.1\n0.2\n", "interval"),
        ("# dt: 0.02 s\n# units: m/s^2\n0.1\nnan\n0.2\n0.3\n", "3"),
        ("# dt: 0.02 s\n# units: m/s^2\n0.1\nabc\n0.2\n0.3\n", "abc"),
        ("", "empty"),
    ],
)
def test_a_wrong_record_is_one_sentence(tmp_path: Path, text: str, word: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    (tmp_path / "a.yaml").write_text(
        "structure: three_storey\ndamping: low\nrecord: ./r.csv\nscaling: 0.3\ncontroller: FF\n"
    )
    done = rths("run", "a.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.removeprefix("starting\n").strip().splitlines()) == 1, done.stderr
    assert "r.csv" in done.stderr
    assert not (tmp_path / "results").exists()


def test_an_output_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("in the way")
    done = rths("run", "el_centro_low_ff", cwd=tmp_path)
    assert done.returncode == 2
    assert "results" in done.stderr and "Traceback" not in done.stderr
    assert (tmp_path / "results").read_text() == "in the way"


def test_report_without_results_is_a_sentence(tmp_path: Path) -> None:
    done = rths("report", cwd=tmp_path)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1


def test_records_are_listed_and_shown() -> None:
    listed = json.loads(rths("records", "--json").stdout)["records"]
    assert {(r["name"], r["samples"]) for r in listed} == {("el_centro", 2688), ("hachinohe", 2550)}
    shown = json.loads(rths("records", "hachinohe", "--json").stdout)
    assert shown["peak_m_s2"] == pytest.approx(2.297, abs=1e-3)
    assert "response spectrum" in rths("records", "el_centro").stdout


def test_new_writes_a_case_once(tmp_path: Path) -> None:
    assert rths("new", "mine.yaml", cwd=tmp_path).returncode == 0
    again = rths("new", "mine.yaml", cwd=tmp_path)
    assert again.returncode == 2 and "exists" in again.stderr


def test_schema_is_json() -> None:
    assert json.loads(rths("schema").stdout)["title"]
