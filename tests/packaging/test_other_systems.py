"""Offline work needs no Linux: in a process that shows the package macOS or Windows it works, and real time refuses."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from docs_running import shortened
from without_linux import declared

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="shows other systems to the package on Linux")

ROOT = Path(__file__).parents[2]
CASE = "el_centro_low_ff_fb"
ON_UDP = ["--set", "table=udp_loopback", "--set", "sample_rate_hz=1000"]
OFFLINE = {
    "SIM alone": ["run", CASE, "--set", "record.file=short.csv", "--set", "runs=[sim]", "--set", "name=sim", "--quiet"],
    "EXP-RTHS": ["run", CASE, "--set", "record.file=short.csv", "--quiet"],
    "report": ["report", "results"],
    "check": ["check", CASE, "--set", "record.file=short.csv"],
    "records": ["records"],
}
HARDWARE = {
    "identify on a rig": ["identify", CASE, *ON_UDP, "--yes"],
    "doctor": ["doctor"],
    "serve": ["serve", "aps400_virtual"],
}
CHILD = """
import json, sys
import without_linux
system, folder, told = sys.argv[1:]
without_linux.become(system)
without_linux.forbid_network()
import rths_cli, rths_cli.api, rths_cli.cli
from docs_running import run_words
from rths_cli.files.sandboxed_reading import read_in_copy
from rths_cli.numerics.clock import require_real_time
found = {name: run_words(words) for name, words in json.loads(folder).items()}
def broken(): raise KeyError("damaged")
found["a file that can be read"] = [0, str(read_in_copy(lambda: 7))]
try: read_in_copy(broken)
except ValueError: found["a file that cannot be read"] = [0, ""]
open(told, "w").write(json.dumps(found))
"""


@pytest.fixture(scope="module", params=["win32", "darwin"])
def printed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Return exit code and text of every command in a process on another system."""
    folder = tmp_path_factory.mktemp(request.param)
    shortened(ROOT / "records" / "el_centro.csv", folder / "short.csv", 300)
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    environment = {**os.environ, "LOCALAPPDATA": cache, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests' / 'helpers'}"}
    words = [sys.executable, "-c", CHILD, request.param, json.dumps(OFFLINE | HARDWARE), "told.json"]
    done = subprocess.run(words, capture_output=True, text=True, cwd=folder, env=environment, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, tuple[int, str]] = json.loads((folder / "told.json").read_text())
    return found


@pytest.mark.campaign
def test_offline_work_needs_neither_linux_nor_a_network(printed: dict[str, tuple[int, str]]) -> None:
    assert {name: told for name, told in printed.items() if told[0] != 0 and name not in HARDWARE} == {}
    assert "sim.h5" in printed["SIM alone"][1] and f"{CASE}.h5" in printed["EXP-RTHS"][1]
    assert "safe" in printed["check"][1] and "el_centro" in printed["records"][1]
    assert printed["a file that can be read"][1] == "7" and "a file that cannot be read" in printed


@pytest.mark.campaign
@pytest.mark.parametrize("name", HARDWARE)
def test_real_time_refuses_with_one_sentence(name: str, printed: dict[str, tuple[int, str]]) -> None:
    code, text = printed[name]
    assert code == 2 and text.strip().startswith("real time needs Linux") and len(text.strip().splitlines()) == 1


def test_the_hidden_names_are_those_that_the_package_must_not_need() -> None:
    for module, name in {"os": "fork", "signal": "SIGALRM", "mmap": "MADV_DONTNEED", "time": "clock_gettime"}.items():
        assert name in declared(module, "linux") - declared(module, "win32")
    for name in ("sched_setscheduler", "memfd_create", "posix_fallocate", "fdatasync"):
        assert name in declared("os", "linux") - declared("os", "darwin")
    assert {"open", "replace", "getpid", "fsync"} <= declared("os", "win32")
