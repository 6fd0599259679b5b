"""`rths doctor` as a process: text, JSON, exit codes, what it imports."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from warm_command import rths_words

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]


def doctor(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*rths_words(), "doctor", *words],
        capture_output=True,
        text=True,
        cwd=cwd,
        timeout=120,
        check=False,
    )


def test_one_document_whose_exit_code_is_the_processs(tmp_path: Path) -> None:
    done = doctor("--rate", "100", "--rate", "300", "--seconds", "0.1", "--json", cwd=tmp_path)
    found = json.loads(done.stdout)
    assert [rate["rate_hz"] for rate in found["rates"]] == [100.0, 300.0]
    assert found["wanted_hz"] == [100.0, 300.0] and found["rule"].startswith("a rate is held when")
    assert done.returncode == found["exit_code"] == (1 if found["not_held_hz"] else 0)
    assert list(tmp_path.iterdir()) == []


def test_the_page_names_kernel_rates_and_rule(tmp_path: Path) -> None:
    done = doctor("--rate", "200", "--seconds", "0.1", cwd=tmp_path)
    assert done.returncode in (0, 1)
    assert done.stdout.startswith(("HELD: 200 Hz; ", "NOT HELD: 200 Hz; "))
    for word in (os.uname().release, "p99.9", "200", "rule"):
        assert word in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere",), "nowhere"),
        (("--rate", "1"), "--rate"),
        (("--seconds", "0"), "--seconds"),
        (("--rig", "aps400_virtual"), "rths serve aps400_virtual"),
        (("--set", "scaling=1"), "--set"),
    ],
)
def test_bad_usage_is_one_sentence(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    done = doctor(*words, cwd=tmp_path)
    assert done.returncode == 2 and done.stdout == ""
    assert said in done.stderr and "Traceback" not in done.stderr


@pytest.mark.campaign
def test_it_imports_nothing_that_reads_cases_or_results() -> None:
    code = (
        "import sys; sys.argv = ['rths', 'doctor', '--rate', '100', '--seconds', '0.1']\n"
        "import rths_cli.cli as c\ntry: c.main()\nexcept SystemExit: pass\n"
        "print([m for m in ('scipy.signal', 'h5py', 'matplotlib', 'pydantic') if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stderr.splitlines()[-1] == "[]"
