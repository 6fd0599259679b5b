"""An identification must not wait for imports that it does not need."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
SCRIPT = """
import sys
from made_linear import linear
from made_records import make_specimen
from rths_cli.identification.identify import identify
made = linear(make_specimen())
found = identify([made.record], made.info, made.specimen.masses_kg, quiet=made.record)
heavy = sorted(name for name in sys.modules if name.split(".")[0] in ("matplotlib", "control", "pandas"))
print(found.specimen is not None, found.friction is not None, found.latency is not None, heavy)
"""


@pytest.mark.campaign
def test_an_identification_imports_neither_figures_nor_control() -> None:
    paths = os.pathsep.join([str(HERE.parent / "helpers"), str(HERE.parents[1])])
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert done.stdout.split("\n")[-2] == "True True True []"
