"""`rths list` and `rths structure` as processes: lines for pipes, documents, exit codes, quick imports."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from golden import golden
from warm_command import rths_words

from rths_cli.case.named_files import known
from rths_cli.case.shipped_files import FOLDERS

TREE = Path(__file__).parents[2]
HEAVY = ("scipy", "numba", "h5py", "matplotlib", "rich", "control")
OWN = {
    "b5.yaml": "extends: three_storey\nexperimental: {damping_ratios: [0.02, 0.03]}\n",
    "c5.yaml": "structure: b5\ndamping: low\nrecord: pulse\nscaling: 0.5\ncontroller: FF\n",
    "c6.yaml": "structure: b6\ndamping: low\nrecord: pulse\nscaling: -1\ncontroller: FF\n",
    "table.yaml": "extends: aps400_virtual\nlimits: {stroke_m: 0.02}\n",
    "pulse.csv": "time_s,accel_m_s2\n0.00,0.0\n0.01,1.5\n0.02,-0.5\n0.03,0.0\n",
    "no_unit.csv": "0.00,0.0\n0.01,1.5\n0.02,-0.5\n",
    "readme.txt": "nothing to see\n",
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a user's own files of every kind, some of which cannot be used."""
    folder = tmp_path_factory.mktemp("lab")
    for name, text in OWN.items():
        (folder / name).write_text(text)
    return folder


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*rths_words(), *words], capture_output=True, text=True, cwd=cwd, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("kind", FOLDERS)
def test_each_kind_is_listed_a_line_each(kind: str, lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = rths("list", kind, cwd=lab)
    assert (done.returncode, done.stderr) == (0, "")
    monkeypatch.chdir(lab)
    assert sorted(line.split()[0] for line in done.stdout.splitlines()) == known(kind, lab)
    assert done.stdout == golden(f"list_{kind}.txt", done.stdout)


@pytest.mark.parametrize("kind", FOLDERS)
def test_the_document_says_which_files_are_the_users_own(kind: str, lab: Path) -> None:
    (listed,) = json.loads(rths("list", kind, "--json", cwd=lab).stdout).values()
    own = {one["name"]: one["file"] for one in listed if one["own"]}
    mine = {
        "cases": ["c5", "c6"],
        "structures": ["b5"],
        "rigs": ["table"],
        "records": ["no_unit", "pulse"],
        "references": [],
        "benchmarks": [],
    }
    assert sorted(own) == mine[kind] and all((lab / file).exists() for file in own.values())
    assert [one["own"] for one in listed] == sorted((one["own"] for one in listed), reverse=True)


def test_without_a_name_structure_and_records_list_theirs(lab: Path) -> None:
    for command, kind in (("structure", "structures"), ("records", "records")):
        assert rths(command, cwd=lab).stdout == rths("list", kind, cwd=lab).stdout != ""


@pytest.mark.campaign
def test_a_structure_is_shown_in_a_pipe_as_document_and_as_a_figure(lab: Path, tmp_path: Path) -> None:
    done = rths("structure", "b5", "--figure", str(tmp_path / "b5.svg"), cwd=lab)
    assert (done.returncode, done.stderr) == (0, f"wrote {tmp_path / 'b5.svg'}\n")
    assert "Structure b5 (b5.yaml)" in done.stdout and (tmp_path / "b5.svg").read_bytes().startswith(b"<?xml")
    assert json.loads(rths("structure", "b5", "--json", cwd=lab).stdout)["specimen_damping_ratio"] == pytest.approx(
        [0.02, 0.03]
    )
    impossible = lab / "sub"
    impossible.mkdir()
    (impossible / "x.yaml").write_text("extends: three_storey\ndamping_levels: {all: {first_mode_ratio: 0.99}}\n")
    assert rths("structure", "sub/x.yaml", cwd=lab).returncode == 1
    assert rths("structure", "pulse", cwd=lab).returncode == 2


@pytest.mark.campaign
@pytest.mark.parametrize(("words", "allowed"), [(("list", "structures"), ()), (("structure", "b5"), ("scipy",))])
def test_they_import_nothing_that_they_do_not_use(words: tuple[str, ...], allowed: tuple[str, ...], lab: Path) -> None:
    code = f"import sys; sys.argv = {['rths', *words]!r}\nimport rths_cli.cli as c\n"
    code += "try: c.main()\nexcept SystemExit: pass\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=lab, check=True,
        env={**os.environ, "PYTHONPATH": str(TREE)},
    )  # fmt: skip
    modules = set(done.stderr.split())
    assert "rths_cli.case.load" in modules and [name for name in HEAVY if name in modules] == list(allowed)
