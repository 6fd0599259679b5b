"""The rows of a sweep under way: a text file beside the result, one line per run, appended as each run ends.

The first line says which sweep it is. A killed process may leave half a line at the end, which is dropped; what was
written before it is whole, and the numbers in it read back to the last bit.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from rths_cli.errors import InputError
from rths_cli.files.result_writer import refusal
from rths_cli.files.whole_file import open_regular

FORMAT = "rths-sweep-rows"


def rows_path(result: Path) -> Path:
    """Return where the rows of a sweep stand until its result file is written."""
    return result.with_name(f"{result.name}.rows")


def read_rows(path: Path) -> tuple[dict[str, Any], list[list[Any]]]:
    """Return the header and the whole rows of a sweep under way; raise InputError when it is no such file."""
    try:
        with open_regular(path) as file:
            lines = file.read().split(b"\n")[:-1]  # what follows the last newline was being written
        header, *rows = [json.loads(line) for line in lines]
    except OSError as error:
        raise InputError(refusal(path, "cannot read", error, advice=False)) from error
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is damaged or holds no rows of a sweep; remove it and run the sweep anew") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise InputError(f"{path}: holds no rows of a sweep; remove it and run the sweep anew")
    return header, rows


class RowsFile:
    """Append rows to the file of a sweep under way; use as a context manager. Raises InputError where the disk
    refuses."""

    def __init__(self, path: Path, header: Mapping[str, Any], resume: bool) -> None:
        self._path = path
        self._header = {"format": FORMAT, **header}
        self._resume = resume
        self._file: TextIO | None = None

    def __enter__(self) -> RowsFile:
        """Open the file: a new one with its header, or after the last whole row of one that exists."""
        try:
            if self._resume:
                whole = self._path.read_bytes().rpartition(b"\n")
                os.truncate(self._path, len(whole[0]) + len(whole[1]))
            self._file = open(self._path, "a" if self._resume else "x", encoding="utf-8")
            if not self._resume:
                self._write(self._header)
        except OSError as error:
            raise InputError(refusal(self._path, "cannot write the rows of the sweep", error)) from error
        return self

    def append(self, row: Sequence[Any]) -> None:
        """Write one row; whatever happens to the process afterwards, it is kept."""
        try:
            self._write(row)
        except OSError as error:
            raise InputError(refusal(self._path, "cannot write the rows of the sweep", error)) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file; it stays until `remove`."""
        if self._file is not None:
            with suppress(OSError):
                self._file.close()

    def remove(self) -> None:
        """Remove the file: its rows stand in the result."""
        with suppress(OSError):
            self._path.unlink()

    def _write(self, content: Any) -> None:
        assert self._file is not None
        self._file.write(json.dumps(content) + "\n")
        self._file.flush()
