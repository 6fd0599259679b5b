"""Where compiled code is kept: a change of any source it comes from must not meet old code."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import rths_cli

PACKAGE = Path(rths_cli.__file__).parent
CODE = "from rths_cli.compiled import cache_folder; print(cache_folder())"


def folder_of(root: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=root, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.strip()


def test_a_change_in_any_part_moves_the_cache(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "rths_cli", ignore=shutil.ignore_patterns("__pycache__"))
    before = folder_of(tmp_path)
    assert folder_of(tmp_path) == before
    for name in ("loop/guard.py", "rigs/virtual/kernel.py", "compiled.py"):
        with open(tmp_path / "rths_cli" / name, "a", encoding="utf-8") as file:
            file.write("\n# changed\n")
        after = folder_of(tmp_path)
        assert after != before, name
        before = after


def test_every_compiled_source_is_watched() -> None:
    from rths_cli.compiled import SOURCE_FOLDERS, SOURCES

    users = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if "rths_cli.compiled import" in path.read_text() and "is_compiled" not in path.read_text()
    }
    watched = {name for name in users if name in SOURCES or name.split("/")[0] in SOURCE_FOLDERS}
    assert users == watched and len(users) >= 5
