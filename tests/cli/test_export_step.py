"""`rths export step CASE --to c DIR` as a user types it: the files, what is printed, and the golden program."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import pytest
from docs_running import run_words
from wrong_inputs import COMMON

from rths_cli.case.load import load_cases, resolved_yaml

FILES = {
    "CMakeLists.txt", "README.md", "golden.c", "record.csv", "rths_data.c", "rths_sfunction.c", "rths_sizes.h",
    "rths_step.c", "rths_step.h",
}  # fmt: skip


@pytest.mark.campaign
def test_a_case_becomes_a_library_that_agrees_with_rths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in COMMON.items():
        Path(name).write_text(text, encoding="utf-8")
    code, printed = run_words(["export", "step", "pulse.yaml", "--to", "c", "step", "--quiet"])
    assert code == 0 and {Path(line).name for line in printed.splitlines()} == FILES
    assert {path.name for path in Path("step").iterdir()} == FILES
    code, told = run_words(["export", "step", "pulse.yaml", "--to", "c", "step", "--json"])
    resolved = hashlib.sha256(resolved_yaml(load_cases(["pulse.yaml"])[0]).encode()).hexdigest()
    assert code == 0 and json.loads(told)["case_sha256"] == resolved
    assert resolved in Path("step", "rths_data.c").read_text() and resolved in Path("step", "README.md").read_text()
    assert run_words(["export", "step", "pulse.yaml", "--to", "c", "step", "--no-replace"])[0] == 2
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    words = ["cc", "-std=c99", "-O1", "rths_step.c", "rths_data.c", "golden.c", "-lm", "-o", "golden"]
    subprocess.run(words, cwd="step", check=True)
    done = subprocess.run(["./golden"], cwd="step", capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "0 steps in another state, 0 tests that ended otherwise" in done.stdout
