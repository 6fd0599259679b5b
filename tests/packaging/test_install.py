"""The package works from wheel and sdist: the shipped files come along and are found by name."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build sdist, and the wheel from the sdist, with the build backend of this environment."""
    folder = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.campaign
def test_the_sdist_holds_what_a_packager_needs(built: Path) -> None:
    with tarfile.open(next(built.glob("*.tar.gz"))) as archive:
        names = {name.split("/", 1)[1] for name in archive.getnames() if "/" in name}
    assert {"LICENSE", "README.md", "Makefile", "configs/el_centro_low_ff.yaml", "records/el_centro.csv"} <= names
    assert any(name.startswith("tests/") for name in names)
    assert {"docs/index.md", "docs/reference/udp.md"} <= names  # the tests in it read the pages


@pytest.mark.campaign
def test_the_wheel_finds_its_shipped_files_by_name(built: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(next(built.glob("*.whl"))) as archive:
        assert "rths_cli/py.typed" in archive.namelist()
        archive.extractall(tmp_path / "site")
    # the dependencies are this environment's; the package is the unpacked wheel's, far from the source tree
    code = (
        "import json, rths_cli; from rths_cli.case.load import load_cases;"
        "from rths_cli.experiment.setup import make_setup;"
        "s = make_setup(load_cases(['hachinohe_high_ff_fb'])[0]);"
        "print(json.dumps([rths_cli.__file__, str(s.case.record.path), s.case.reference.name]))"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "site")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=environment,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count(str(tmp_path / "site")) == 2
    listed = subprocess.run(
        [sys.executable, "-m", "rths_cli", "records"],
        capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=120, check=True,
    )  # fmt: skip
    assert "el_centro" in listed.stdout
    bare = {key: environment[key] for key in ("PYTHONPATH",)} | {"PATH": "", "CC": "/bin/false", "HOME": str(tmp_path)}
    words = ["run", "el_centro_low_ff_fb", "--set", "runs=[sim]", "--quiet"]  # EXP-RTHS, too: make dist
    done = subprocess.run(
        [sys.executable, "-m", "rths_cli", *words],
        capture_output=True, text=True, cwd=tmp_path, env=bare, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and (tmp_path / "results" / "el_centro_low_ff_fb.h5").exists(), done.stderr
