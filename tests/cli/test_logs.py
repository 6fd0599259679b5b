"""`--log FILE` and `-v`: what a command does, in a file and on stderr; nothing below the experiment logs."""

from __future__ import annotations

import ast
import re
import subprocess
from pathlib import Path

import pytest
from warm_command import rths_words

TREE = Path(__file__).parents[2]
IN_THE_LOOP = ("loop", "numerics", "control", "rigs", "structure", "analysis")


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=120, check=False,
    )  # fmt: skip


def test_a_log_tells_command_faults_and_exit_code_and_is_appended_to(tmp_path: Path) -> None:
    plain = rths("check", "nothing_of_that_name", cwd=tmp_path)
    for _ in range(2):
        done = rths("check", "nothing_of_that_name", "--log", "a.log", cwd=tmp_path)
        assert (done.returncode, done.stderr, done.stdout) == (2, plain.stderr, "")  # it prints what it always prints
    lines = (tmp_path / "a.log").read_text().splitlines()
    assert len(lines) == 6
    told = [("INFO", "rths "), ("ERROR", "nothing_of"), ("INFO", "exit code 2")] * 2
    for line, (level, words) in zip(lines, told, strict=True):
        assert re.match(rf"\d{{4}}-\d\d-\d\d \d\d:\d\d:\d\d,\d{{3}} {level} {words}", line), line


def test_verbose_says_no_fault_twice(tmp_path: Path) -> None:
    done = rths("check", "nothing_of_that_name", "-v", cwd=tmp_path)
    assert done.stderr.count("nothing_of_that_name") == 2  # place and name in one sentence
    assert done.stderr.splitlines()[-1].endswith("ms  exit code 2")


def test_a_log_that_cannot_be_written_is_refused_before_anything_is_done(tmp_path: Path) -> None:
    done = rths("run", "el_centro_low_ff_fb", "--log", "none/a.log", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2, "--log none/a.log: cannot be written: No such file or directory; choose another file\n"
    )  # fmt: skip
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("package", IN_THE_LOOP)
def test_nothing_that_runs_in_the_loop_logs(package: str) -> None:
    for path in (TREE / "rths_cli" / package).rglob("*.py"):
        tree = ast.parse(path.read_text())
        names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not any(name.split(".")[0] == "logging" for name in names), path
