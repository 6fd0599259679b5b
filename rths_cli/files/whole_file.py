"""Read a file that a user names, after a look at its size."""

from __future__ import annotations

from pathlib import Path

from rths_cli.errors import InputError


def read_whole(path: Path, most_bytes: int, what: str, advice: str) -> bytes:
    """Return the file's bytes; raise InputError where it cannot be read, or is larger than `what` may be."""
    try:
        size = path.stat().st_size
        if size <= most_bytes:
            return path.read_bytes()
    except OSError as fault:
        raise InputError(f"{path}: cannot be read ({fault.strerror}); {advice}") from None
    raise InputError(f"{path}: {size / 1e6:.0f} MB; {what} may have {most_bytes / 1e6:.0f} MB, cut it")


def write_new(path: Path, text: str) -> None:
    """Write a text to a file that does not exist yet; raise InputError where there is one, or the disk refuses.

    Nothing is left behind where the text cannot be written whole.
    """
    try:
        with open(path, "x", encoding="utf-8") as file:
            try:
                file.write(text)
                file.flush()
            except BaseException:  # a signal too must leave no half file
                path.unlink()
                raise
    except FileExistsError:
        raise InputError(f"{path}: exists; choose another name") from None
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or str(fault)
        raise InputError(f"{path}: cannot be written: {reason}") from None
