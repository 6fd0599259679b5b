"""Where the user's cache is: the folder of compiled code, models of virtual rigs, measured sample rates, locks."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from functools import cache
from pathlib import Path

from rths_cli.errors import InputError


def user_cache() -> Path:
    """Return rths's folder in the user's cache; raises InputError for a user who has none."""
    base = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "rths"
    except RuntimeError:
        raise InputError("this user has no home folder; set XDG_CACHE_HOME to a folder that is kept") from None


def cache_or_temporary() -> Path:
    """Return rths's folder in the user's cache; for a user who has none, one that ends with this process."""
    try:
        return user_cache()
    except InputError:
        return _temporary()


@cache
def _temporary() -> Path:
    folder = Path(tempfile.mkdtemp(prefix="rths-cache-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
