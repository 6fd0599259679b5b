"""Printed output kept in tests/golden/: a change of it is seen in the commit that makes it.

`RTHS_GOLDEN=write python -m pytest ...` writes what is printed now; read the difference before it is committed.
"""

from __future__ import annotations

import os
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "golden"


def golden(name: str, printed: str) -> str:
    """Return the kept text of a name; where it is to be written, it becomes `printed`."""
    path = FOLDER / name
    if os.environ.get("RTHS_GOLDEN") == "write":
        path.write_text(printed, encoding="utf-8")
    return path.read_text(encoding="utf-8")
