"""Exceptions for faults a user can meet, each with its exit code; the crash file of our own faults."""

from __future__ import annotations

from pathlib import Path


class RthsError(Exception):
    """A fault with a sentence for the user; `exit_code` is what the process returns."""

    exit_code = 5


class InputError(RthsError):
    """Bad usage or input: nothing was written.

    `faults` holds one sentence per fault (where known it starts with `file:line:column: `).
    """

    exit_code = 2

    def __init__(self, *faults: str) -> None:
        super().__init__("\n".join(faults))
        self.faults = tuple(faults)


class LimitError(RthsError):
    """A limit of the guard stopped the run."""

    exit_code = 3


class RigError(RthsError):
    """The rig or the link to it failed."""

    exit_code = 4


def crash_note() -> str:
    """Write the traceback of the exception being handled to a file, and return where it is, or why there is none."""
    try:
        return f"details in {write_crash_file()}"
    except OSError as error:
        return f"its details cannot be written: {error.strerror}"


def write_crash_file() -> Path:
    """Write the traceback of the exception being handled to a file in the folder for temporary files.

    Raises OSError, and leaves no file, where the disk refuses.
    """
    import tempfile
    import traceback
    from datetime import UTC, datetime

    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    handle, name = tempfile.mkstemp(prefix=f"rths-crash-{stamp}-", suffix=".txt")
    try:
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(traceback.format_exc())
    except OSError:
        Path(name).unlink(missing_ok=True)
        raise
    return Path(name)
