"""`--log FILE` and `-v` of every command: what it does, by the standard logging module, never from inside the loop."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import click

from rths_cli.cli.options import FILE, command_line
from rths_cli.errors import InputError
from rths_cli.version import __version__

LOG = logging.getLogger("rths")
LOG.addHandler(logging.NullHandler())
LOG.setLevel(logging.DEBUG)
LOG.propagate = False
PRINTED = {"printed": True}  # of a record that the command prints itself
TO_FILE = "%(asctime)s %(levelname)s %(message)s"
TO_TERMINAL = "%(relativeCreated)8.0f ms  %(message)s"


class AppendingHandler(logging.Handler):
    """Append each record to a file, which is open meanwhile only."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path.absolute()

    def emit(self, record: logging.LogRecord) -> None:
        """Append a record; a disk that takes nothing more does not end the command."""
        with suppress(OSError):
            self.append(f"{self.format(record)}\n")

    def append(self, text: str) -> None:
        """Append a text; raises OSError."""
        with open(self._path, "a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)


def add_log_options(commands: Iterable[click.Command]) -> None:
    """Add --log and -v to commands."""
    for command in commands:
        command.params.append(
            click.Option(
                ["--log"], type=FILE, metavar="FILE", expose_value=False, callback=_to_file, is_eager=True,
                help="Append to a file what is done, with the time.",
            )
        )  # fmt: skip
        command.params.append(
            click.Option(
                ["-v", "--verbose"], is_flag=True, expose_value=False, callback=_to_terminal, is_eager=True,
                help="Say on stderr what is done, with the time.",
            )
        )  # fmt: skip


def end_logs() -> None:
    """Close what a command logs to."""
    for handler in [one for one in LOG.handlers if not isinstance(one, logging.NullHandler)]:
        LOG.removeHandler(handler)
        handler.close()


def _to_file(ctx: click.Context, param: click.Parameter, path: Path | None) -> None:
    if path is None:
        return
    if path.is_fifo() or path.is_block_device() or path.is_socket():
        raise InputError(f"--log {path}: is no file; give the name of one, or -v to read on stderr what is done")
    handler = AppendingHandler(path)
    try:
        handler.append("")
    except OSError as error:
        raise InputError(f"--log {path}: cannot be written: {error.strerror}; choose another file") from None
    _log_to(handler, TO_FILE)
    LOG.info("rths %s: %s", __version__, command_line())


def _to_terminal(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    if wanted:
        handler = logging.StreamHandler(sys.stderr)
        handler.addFilter(lambda record: not hasattr(record, "printed"))
        _log_to(handler, TO_TERMINAL)


def _log_to(handler: logging.Handler, form: str) -> None:
    handler.setFormatter(logging.Formatter(form))
    LOG.addHandler(handler)
