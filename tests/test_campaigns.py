"""Every script of benchmarks/ answers --help and does nothing else then; those with a short form come to its end, each
in a process of its own, as a person starts it."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from campaigns.exported_step import compiler
from forked_programs import Program

FOLDER = Path(__file__).parents[1] / "benchmarks"
LONGEST_S = 600.0  # of a process, on a machine that does much else meanwhile
PARTS = ("step", "rivals", "sim", "commands", "growth", "sweep", "channels", "laws")
HELP = """
import contextlib, io, os, runpy, sys
sys.path.insert(0, {folder!r})
for path in {scripts!r}:
    sys.argv, told, code, before = [path, "--help"], io.StringIO(), None, list(sys.path)
    with contextlib.redirect_stdout(told):
        try:
            runpy.run_path(path, run_name="__main__")
        except SystemExit as ended:
            code = ended.code
    sys.path[:] = before
    assert code == 0 and "usage: " in told.getvalue(), (path, code, told.getvalue())
assert os.listdir() == []
"""


def constants(path: Path) -> dict[str, object]:
    """Return the constants that a script gives a plain value at its top."""
    found = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                found[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return found


SCRIPTS = {
    path.name: constants(path)
    for path in sorted(FOLDER.glob("*.py"))
    if path.name != "__main__.py" and '"__main__":' in path.read_text()
}
SHORT = [name for name, found in SCRIPTS.items() if "SHORT" in found and name != "full_disk.py"]  # which mounts a disk


def run(script: str, words: tuple[str, ...], folder: Path) -> str:
    """Run a script in a folder; return what it printed."""
    path = str(FOLDER / script)
    code = f"import os, sys, runpy; os.chdir({str(folder)!r}); sys.argv = {[path, *words]!r}\n"
    code += "from pathlib import Path; sys.path[0] = str(Path(sys.argv[0]).parent)\n"
    program = Program(code + f"try:\n    runpy.run_path({path!r}, run_name='__main__')\n" + ENDING, dict(os.environ))
    try:
        out, errors = program.communicate(timeout=LONGEST_S)
    finally:
        program.kill()
    assert program.returncode == 0, f"{out[-2000:]}\n{errors[-4000:]}"
    return out


ENDING = "except SystemExit as ended:\n    assert not ended.code, ended.code\n"


@pytest.mark.campaign
def test_every_script_answers_help_and_does_nothing(tmp_path: Path) -> None:
    """What each takes from the package and from the tests is still there, too: it is imported before it answers."""
    scripts = [str(FOLDER / name) for name in SCRIPTS]
    code = HELP.format(folder=str(FOLDER), scripts=scripts)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]


def test_the_folder_lists_its_scripts() -> None:
    done = subprocess.run([sys.executable, str(FOLDER)], capture_output=True, text=True, check=True)
    listed = dict(re.findall(r"^(?:\*| ) (\w+) +(\S.+)$", done.stdout, re.MULTILINE))
    assert sorted(listed) == sorted(name.removesuffix(".py") for name in SCRIPTS)


@pytest.mark.campaign
@pytest.mark.parametrize("script", SHORT)
def test_a_campaign_runs_in_its_short_form(script: str, tmp_path: Path) -> None:
    if script in ("step_mutants.py", "c_step_cases.py") and compiler() is None:
        pytest.skip("no C compiler here")
    assert re.search(str(SCRIPTS[script].get("PRINTS", r"\S")), run(script, ("--short",), tmp_path), re.MULTILINE)


@pytest.mark.campaign
@pytest.mark.parametrize("part", PARTS)
def test_a_part_of_the_benchmark_runs_in_its_short_form(part: str, tmp_path: Path) -> None:
    table = run("run.py", ("--short", part), tmp_path)
    assert re.search(r"^what +figure +demand", table, re.MULTILINE)
    same = [line for line in table.splitlines() if line.startswith("EXP-RTHS step less C")]
    assert all("holds" in line for line in same) and (bool(same) == (part == "step") or not compiler())
