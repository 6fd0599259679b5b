"""Where the user's cache is: the folder of compiled code, models of virtual rigs, measured sample rates, locks."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from rths_cli.errors import InputError


def user_cache() -> Path:
    """Return rths's folder in the user's cache; raises InputError for a user who has none."""
    base = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "rths"
    except RuntimeError:
        raise InputError("there is no home folder to keep compiled code in; set XDG_CACHE_HOME to a folder") from None
