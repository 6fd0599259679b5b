"""Where a report is written: tried before anything is read, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.result_writer import refusal
from rths_cli.files.whole_file import open_regular
from rths_cli.printed import visible

BINARY = (b"\x89HDF\r\n\x1a\n", b"RTHSLOG")


def check_output(option: str, path: Path, inputs: Iterable[Path]) -> None:
    """Raise InputError where a report must not go: a folder, a file that is read, measured data."""
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; give the name of a file in it.")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}; make it first.")
    if path.resolve() in {one.resolve() for one in inputs}:
        raise InputError(f"{option} {path}: is read for this report; choose another name.")
    if path.suffix in (".h5", ".rthslog", ".yaml", ".yml") or _is_data(path):
        raise InputError(f"{option} {path}: has the name or the content of a result or case; choose another name.")


def _is_data(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(8).startswith(BINARY)
    except OSError:
        return False


def write_text(path: Path, text: str) -> None:
    """Write a text, control characters made visible, under a temporary name and rename it; raises InputError where the
    disk refuses."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(visible(text).encode())
        os.replace(part, path)
    except OSError as error:
        raise InputError(refusal(path, "cannot write", error, advice=False)) from error
    finally:
        with suppress(OSError):
            part.unlink()
