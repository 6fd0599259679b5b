"""Exceptions for faults a user can meet, each with its exit code; the crash file of our own faults."""

from __future__ import annotations

import errno
from pathlib import Path

_NO_MEMORY = ("cannot allocate memory", "can't start new thread", "failed to map segment", "unable to allocate")


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


def out_of_memory(error: BaseException) -> str:
    """Return a sentence on too little memory where that is what an exception, or one that led to it, says; else ""."""
    cause: BaseException | None = error
    while cause is not None:
        system = isinstance(cause, OSError) and cause.errno == errno.ENOMEM
        if isinstance(cause, MemoryError) or system or any(told in str(cause).lower() for told in _NO_MEMORY):
            return (
                "there is too little memory (about 1 GB is needed): end other programs, or raise the limit (ulimit -v)"
            )
        cause = cause.__cause__ or (None if cause.__suppress_context__ else cause.__context__)
    return ""


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
