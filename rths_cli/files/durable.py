"""What makes a file last: names that no later run takes, and contents that a loss of power leaves."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path


def dated(path: Path, when: datetime) -> Path:
    """Return the path with the UTC time of an instant in its name, as the results of hardware have it."""
    return path.with_name(f"{path.stem}-{when.astimezone(UTC):%Y%m%dT%H%M%SZ}{path.suffix}")


def sync(path: Path) -> None:
    """Have a file, or the names in a folder, on the disk itself; raises OSError."""
    if path.is_dir() and os.name != "posix":
        return
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
