"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable import remove_leftovers
from rths_cli.files.result_writer import refusal


@dataclass(frozen=True)
class Target:
    """A file, and what writes all of it at a path it is given."""

    path: Path
    write: Callable[[Path], None]


def write_all(targets: Sequence[Target]) -> None:
    """Write files under temporary names (`.NAME.PID.part`) and rename them when all are there.

    Raises InputError naming path and cause where the disk refuses; then, and after a signal, no file is left behind.
    """
    parts = [target.path.with_name(f".{target.path.name}.{os.getpid()}.part") for target in targets]
    try:
        for target, part in zip(targets, parts, strict=True):
            remove_leftovers(target.path)
            with_reason(target, part)
        for target, part in zip(targets, parts, strict=True):
            os.replace(part, target.path)
    finally:
        for part in parts:
            with suppress(OSError):
                part.unlink()


def with_reason(target: Target, part: Path) -> None:
    """Write one file; raise InputError naming path and cause where the disk refuses."""
    try:
        target.write(part)
    except (OSError, RuntimeError) as error:
        raise InputError(refusal(target.path, "cannot write", error)) from error
