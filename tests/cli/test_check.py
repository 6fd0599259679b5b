"""`rths check` as a process: pages, JSON, exit codes."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest
import yaml
from made_up_check import LINEAR
from warm_command import rths_words

from rths_cli.experiment.model_files import save
from rths_cli.experiment.setup import Setup
from rths_cli.identification.results import Identification

CASE = "el_centro_low_ff_fb"


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=240, check=False)


@pytest.fixture(scope="module")
def model(
    tmp_path_factory: pytest.TempPathFactory, default_setup: Setup, default_identification: Identification
) -> tuple[str, str]:
    path = tmp_path_factory.mktemp("model") / "table.h5"
    save(path, default_setup, default_identification, "made for this test", "0" * 64)
    return "--set", f"identification.model={path}"


def test_safe_and_unsafe_cases_in_one_document(tmp_path: Path, model: tuple[str, str]) -> None:
    for name, scaling in (("calm", 0.3), ("loud", 0.9)):
        text = f"structure: three_storey\ndamping: low\nrecord: el_centro\nscaling: {scaling}\ncontroller: FF+FB\n"
        (tmp_path / f"{name}.yaml").write_text(text)
    done = rths("check", "calm.yaml", "loud.yaml", *model, "--json", cwd=tmp_path)
    assert done.returncode == 1
    calm, loud = json.loads(done.stdout)["cases"]
    assert (calm["case"], calm["verdict"], calm["reasons"]) == ("calm", "safe", [])
    assert (loud["case"], loud["verdict"]) == ("loud", "unsafe") and "largest safe scaling" in loud["reasons"][-1]
    assert set(LINEAR) <= set(calm["metrics"])
    assert calm["units"]["check.peak_command_v"] == "V" and calm["method"] == "best"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calm.yaml", "loud.yaml"]  # nothing is written


def test_the_page_of_a_safe_case_ends_with_the_verdict(tmp_path: Path, model: tuple[str, str]) -> None:
    done = rths("check", CASE, *model, "--full", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.splitlines()[1].split() == ["verdict", "safe"]
    assert max(len(line) for line in done.stdout.splitlines()) <= 100
    for word in ("stability", "margins", "Latency of the loop", "table limits", "Error by cause", "SIM-DELAY, 5 ms"):
        assert word in done.stdout


def test_quiet_prints_a_line_with_the_verdict_on_each_case(tmp_path: Path, model: tuple[str, str]) -> None:
    done = rths("check", CASE, *model, "--quiet", cwd=tmp_path)
    assert done.stderr == "" and re.fullmatch(rf"{CASE} \(best\): safe: up to scaling [0-9.]+\n", done.stdout)


def test_the_resolved_case_loads_to_the_same_case(tmp_path: Path) -> None:
    done = rths("check", CASE, "hachinohe_low_ff", "--set", "scaling=0.2", "--resolved", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    first, second = yaml.safe_load_all(done.stdout)
    assert (first["name"], first["scaling"], first["sample_rate_hz"]) == (CASE, 0.2, 2000.0)
    assert second["name"] == "hachinohe_low_ff"
    (tmp_path / "again.yaml").write_text(done.stdout.split("---\n")[0])
    again = rths("check", "again.yaml", "--resolved", "--json", cwd=tmp_path)
    (only,) = json.loads(again.stdout)["cases"]
    assert yaml.safe_load(only["resolved"]) == first


@pytest.mark.campaign
def test_both_methods_can_be_asked_at_once(tmp_path: Path, model: tuple[str, str]) -> None:
    done = rths("check", CASE, *model, "--method", "paper", "--method", "best", cwd=tmp_path)
    assert done.returncode == 0
    first = done.stdout.splitlines()[:2]
    assert [line.split()[:3] for line in first] == [[CASE, "(paper)", "safe"], [CASE, "(best)", "safe"]]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nowhere.yaml",), "nowhere.yaml"),
        ((CASE, "--set", "scaling=-1"), "scaling"),
        ((CASE, "--set", "identification.model=missing.h5"), "missing.h5"),
        ((CASE, "--override", "check"), "--override"),
        ((), "CASE"),
    ],
)
def test_bad_input_is_a_sentence_and_code_2(tmp_path: Path, words: tuple[str, ...], told: str) -> None:
    done = rths("check", *words, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert told in done.stderr and "Traceback" not in done.stderr
