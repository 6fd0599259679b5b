"""The documented Python examples pass `mypy --strict`, seen from outside the package."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "docs/reference/python.md",
    *(ROOT / "docs/howto" / f"{name}.md" for name in ("own_controller", "own_record", "reading_results", "recovery")),
]
CONFIG = """\
[mypy]
strict = True
follow_imports = silent
[mypy-h5py.*,scipy.*,control.*,matplotlib.*,xarray.*,llvmlite.*,nptdms.*,nidaqmx.*,obspy.*]
ignore_missing_imports = True
[mypy-numba.*]
ignore_missing_imports = True
follow_imports = skip
[mypy-xarray.*]
follow_imports = skip
"""


@pytest.mark.campaign
def test_the_examples_are_typed(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    assert (ROOT / "rths_cli" / "py.typed").is_file()
    (tmp_path / "mypy.ini").write_text(CONFIG)
    files = []
    for page in PAGES:
        blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
        assert blocks, page
        files.append(f"{page.stem}_examples.py")
        (tmp_path / files[-1]).write_text("\n".join(blocks))
    cache = pytestconfig.cache.mkdir("mypy_examples") if pytestconfig.cache else tmp_path / "cache"
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--cache-dir", str(cache), *files],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300,
        env={**os.environ, "MYPYPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
