"""What makes a file last, and what is cleared away of those that were not finished."""

from __future__ import annotations

import glob
import os
from contextlib import suppress
from pathlib import Path


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk itself; raises OSError."""
    if path.is_dir() and os.name != "posix":
        return
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def remove_leftovers(path: Path) -> None:
    """Remove what killed processes left of this file (`.NAME.PID.part`): parts whose process is gone."""
    for part in path.parent.glob(f".{glob.escape(path.name)}.*.part"):
        number = part.name.split(".")[-2]
        if number.isdigit() and not _is_alive(int(number)):
            with suppress(OSError):
                part.unlink()


def _is_alive(process: int) -> bool:
    """Tell whether a process of this number runs; in doubt it does."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
