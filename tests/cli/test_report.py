"""`rths report` and the tests that `rths run` writes: what is printed, written, refused, and the exit codes."""

from __future__ import annotations

import csv
import io
import json
import os
import shlex
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from warm_command import rths_words

from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.files.result_reader import ResultWriter
from rths_cli.files.sweep_file import TEXTS, Figure, Sweep, write_sweep

ROOT = Path(__file__).parents[2]
ABOUT = {"case_name": "demo", "method": "best", "rig": "r", "rig_kind": "virtual", "controller": "FF", "scaling": 0.3}


def write(path: Path, error: float, status: str = "complete", **about: object) -> Path:
    with ResultWriter(path, {**ABOUT, "created_utc": "2026-01-02T03:04:05Z", "seed": 0, **about}) as writer:
        writer.case("", "accept: {exp_rths.tracking_rms_m_s2: 0.01}\n")
        writer.metrics({"exp_rths.tracking_rms_m_s2": error})
        writer.finish(status, "too far" if status != "complete" else "")
    return path


def report(*words: object) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of the command."""
    done = CliRunner().invoke(cli, ["report", *map(str, words)], standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.return_value, done.stdout, done.stderr


def refused(*words: object) -> str:
    with pytest.raises(InputError) as caught:
        report(*words)
    return "\n".join(caught.value.faults)


def counts(root: ET.Element) -> list[int]:
    """Return how many tests, failures and errors all suites have."""
    return [sum(int(suite.attrib[name]) for suite in root) for name in ("tests", "failures", "errors")]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "results").mkdir()
    write(tmp_path / "results" / "a.h5", 0.002)
    write(tmp_path / "results" / "b.h5", 0.5, "aborted", case_name="other")
    return tmp_path


def test_every_format_is_printed_and_written_alike(folder: Path) -> None:
    for name in ("text", "markdown", "csv", "json", "latex"):
        code, text, errors = report(folder / "results", "--format", name, "--full")
        assert code == 0 and errors == "" and "aborted" in text and "0.002" in text
        assert report(folder / "results", "--format", name, "--full", "--output", folder / "out")[:2] == (0, "")
        assert (folder / "out").read_text() == text
    assert [path.name for path in folder.iterdir() if path.suffix == ".part"] == []
    code, text, _ = report(folder / "results", "--json")
    assert json.loads(text)["format"] == "rths-report"
    rows = list(csv.DictReader(io.StringIO(report(folder / "results", "--format", "csv")[1])))
    assert [row["status"] for row in rows] == ["complete", "aborted"]


def test_the_answer_stands_alone_unless_more_is_asked_for(folder: Path) -> None:
    one = report(folder / "results" / "a.h5")[1]
    assert one.startswith("NO HYBRID TEST: ") and "Tracking error" not in one and one.count("\n") <= 16
    for option in ("--full", "--paper"):
        longer = report(folder / "results" / "a.h5", option)[1]
        assert longer.startswith(one[:20]) and "Tracking error of the table" in longer


def test_faults_are_exit_2_and_the_good_ones_are_reported_where_asked(folder: Path) -> None:
    (folder / "results" / "c.h5").write_text("x")
    assert "c.h5: is not an HDF5 file" in refused(folder / "results", "--output", folder / "out")
    assert not (folder / "out").exists()
    code, text, errors = report(folder / "results", "--keep-going", "--full")
    assert code == 1 and "0.0020" in text and "Not in the tables" in text
    assert errors.count("c.h5: is not an HDF5 file") == 1


def test_a_baseline_fails_only_where_that_is_asked(folder: Path) -> None:
    (folder / "old").mkdir()
    write(folder / "old" / "a.h5", 0.00199)
    words = (folder / "results" / "a.h5", "--baseline", folder / "old")
    assert report(*words)[0] == 0
    assert report(*words, "--fail-worse", 1)[0] == 0
    code, text, _ = report(*words, "--fail-worse", 0.4)
    assert code == 1 and "(+0.503 %)" in text
    (folder / "none").mkdir()
    assert "none: holds no result file" in refused(folder / "results", "--baseline", folder / "none")


def test_groups_are_compared(folder: Path) -> None:
    write(folder / "results" / "d.h5", 0.004, controller="FF+FB")
    assert "2.0000" in report(folder / "results", "--group-by", "controller")[1]
    assert "--group-by colour: no result states it" in refused(folder / "results", "--group-by", "colour")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--format", "svg"], "--format svg is a format of figures; add --figures DIR."),
        (["--format", "html"], "--format html is one file; add --output FILE, for instance --output report.html."),
        (["--format", "csv", "--json"], "--format: csv and json are two formats of the tables; give one."),
        (["--metric", "x"], "--metric chooses what the figure of a sweep shows; add --figures DIR."),
        (
            ["--metric", "x", "--figures", "f"],
            "--metric chooses what the figure of a sweep shows, and none of the files is a sweep.",
        ),
        (["--fail-worse", "3"], "--fail-worse compares with a baseline; add --baseline FILE_OR_DIR."),
        (["--output", "x.h5"], "--output x.h5: has the name or the content of a result or case; choose another name."),
        (["--output", "."], "--output .: is a folder; give the name of a file in it."),
        (["--junit", "no/x.xml"], "--junit no/x.xml: there is no folder no; make it first."),
        (["--output", "x", "--junit", "x"], "--output and --junit are both x; give two names."),
    ],
)
def test_wishes_that_do_not_fit_are_one_sentence(folder: Path, words: list[str], sentence: str) -> None:
    assert refused(folder / "results", *words) == sentence


def test_data_are_never_written_over(folder: Path) -> None:
    before = (folder / "results" / "a.h5").read_bytes()
    (folder / "copy").write_bytes(before)
    assert "choose another name" in refused(folder / "results", "--output", folder / "copy")
    assert "is read for this report" in refused(folder / "copy", "--junit", folder / "copy")
    assert (folder / "copy").read_bytes() == before
    (folder / "link").symlink_to(folder / "copy")
    assert "is read for this report" in refused(folder / "copy", "--junit", folder / "link")


def test_the_document_of_figures_is_refused_where_the_folder_is_a_file(folder: Path) -> None:
    (folder / "figures").write_text("x")
    assert "figures: is a file; name a folder." in refused(folder / "results", "--figures", folder / "figures")


def test_a_sweep_is_drawn_beside_the_results(folder: Path) -> None:
    figures = {
        "exp_rths.tracking_rms_m_s2": Figure(np.array([0.001, 0.003]), "m/s^2", "x"),
        "exp_rths.rms_error_m_s2": Figure(np.array([[0.1], [0.3]]), "m/s^2", "x"),
    }
    texts = {name: ("complete", "complete") if name == "status" else ("", "") for name in TEXTS}
    words = ("case_name", "rig", "rig_kind", "seeds", "status", "plan_sha256", "software_sha256")
    about = dict.fromkeys(words, "x") | {"exit_code": 0}
    varied = {"scaling": (0.1, 0.2)}
    write_sweep(folder / "swept.h5", Sweep(about, "a", "b", 1, varied, np.array([0, 0]), texts, figures))
    command = (folder / "swept.h5", "--figures", folder / "out", "--format", "svg", "--quiet")
    assert "is not in the sweep; known: exp_rths.tracking" in refused(*command, "--metric", "check.x")
    assert not (folder / "out").exists()
    assert report(*command, "--metric", "exp_rths.tracking_rms_m_s2", "--header", "none")[0] == 0
    assert [path.name for path in (folder / "out").iterdir()] == ["swept-sweep.svg"]


def test_tests_of_a_report(folder: Path) -> None:
    assert report(folder / "results", "--junit", folder / "j.xml")[0] == 0
    root = ET.parse(folder / "j.xml").getroot()
    assert counts(root) == [2, 0, 1]


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a project as docs/howto/ci.md has it: a short case with a limit it does not meet, and a baseline."""
    folder = tmp_path_factory.mktemp("laboratory")
    (folder / "cases").mkdir()
    (folder / "quake.csv").write_text(
        "# dt: 0.02 s\n# units: m/s^2\n"
        + "".join(f"{0.01 * (k % 7 - 3) * np.sin(np.pi * k / 300) ** 2}\n" for k in range(300))
    )
    keys = ("structure: three_storey", "damping: low", "record: ../quake.csv", "scaling: 1", "controller: FF")
    case = "\n".join([*keys, "runs: [sim, exp_rths]", ""])
    (folder / "cases" / "met.yaml").write_text(case + "accept: {exp_rths.tracking_rms_m_s2: 1.0}\n")
    (folder / "cases" / "not_met.yaml").write_text(case + "accept: {exp_rths.tracking_rms_m_s2: 1.0e-9}\n")
    return folder


def script(folder: Path, command: str) -> int:
    """Run a line of a pipeline with `rths` as this Python has it; return the exit code."""
    places = folder / "bin"
    places.mkdir(exist_ok=True)
    (places / "rths").write_text(f'#!/bin/sh\nexec {shlex.join(rths_words())} "$@"\n')
    (places / "rths").chmod(0o755)
    path = os.pathsep.join([str(places), os.environ["PATH"]])
    made = {**os.environ, "PATH": path, "GITHUB_STEP_SUMMARY": str(folder / "summary.md")}
    return subprocess.run(["sh", "-c", command], cwd=folder, env=made, timeout=100, check=False).returncode


def github() -> list[tuple[str, int]]:
    """Return what each step runs and the exit code it must have where one limit is not met."""
    steps = yaml.safe_load((ROOT / "examples/ci/github.yml").read_text())["jobs"]["rths"]["steps"]
    lines = [step["run"] for step in steps if "run" in step and "pip install" not in step["run"]]
    return [(line, 1 if line.startswith("rths run") else 0) for line in lines]


def gitlab() -> list[tuple[str, int]]:
    """Return the script of the job, which fails when a line of it does."""
    job = yaml.safe_load((ROOT / "examples/ci/gitlab.yml").read_text())["rths"]
    return [("\n".join(line for line in job["script"] if "pip install" not in line), 1)]


@pytest.fixture(scope="module")
def baseline(laboratory: Path) -> Path:
    script(laboratory, "rths run cases/*.yaml --output baseline --quiet")
    return laboratory / "baseline"


@pytest.mark.campaign
@pytest.mark.parametrize("pipeline", [github, gitlab])
def test_the_pipelines_work_as_written(pipeline, laboratory: Path, baseline: Path) -> None:
    for line, expected in pipeline():
        assert script(laboratory, f"set -e\n{line}") == expected, line
    root = ET.parse(laboratory / "junit.xml").getroot()
    assert counts(root) == [2, 1, 0]
    assert json.loads((laboratory / "report.json").read_text())["format"] == "rths-report"
    text = (laboratory / "report.md").read_text()
    assert "Against the baseline baseline" in text and "Nothing is worse by more than 5 %." in text
    if pipeline is github:
        assert (laboratory / "summary.md").read_text() == text
    for name in ("junit.xml", "report.json", "report.md", "summary.md"):
        (laboratory / name).unlink(missing_ok=True)


def test_a_change_for_the_worse_fails_the_pipeline(laboratory: Path, baseline: Path) -> None:
    write(laboratory / "worse.h5", 0.5)
    compare = next(line for line, _ in github() if "--fail-worse" in line).replace("results ", "worse.h5 ")
    assert script(laboratory, compare) == 1
    assert "not\\_met (best), virtual rig" in (text := (laboratory / "report.md").read_text())
    assert "in the baseline, but missing now" in text
