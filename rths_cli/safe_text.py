"""Text made safe to print: names and texts from files may hold control characters."""

from __future__ import annotations

import errno
from collections.abc import Iterable
from typing import Any, TextIO

from rths_cli.errors import InputError

FORMULAS = ("=", "+", "-", "@", "\t", "\r")  # a cell that begins so is computed
LINE_BREAKS = "\n\t"  # what a text of several lines and columns is laid out with
CONTROLS = (*range(0x20), *range(0x7F, 0xA0), 0x2028, 0x2029)
DIRECTIONS = (0x200E, 0x200F, *range(0x202A, 0x202F), *range(0x2066, 0x206A))  # they show signs in another order
LONGEST_NAME = 200  # characters of a name, a value or a line about them that a file or a person gives
MOST_DIGITS = 18  # of a whole number in a file: it fits into 64 bits
SURROGATES = range(0xD800, 0xE000)  # bytes of a file name that are no UTF-8


def _escapes(codes: Iterable[int]) -> dict[int, str]:
    return {code: f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" for code in codes}


VISIBLE = _escapes(code for code in (*CONTROLS, *DIRECTIONS, *SURROGATES) if chr(code) not in LINE_BREAKS)


def visible(text: str) -> str:
    """Return a text with its control characters as escapes (ESC is \\x1b); line breaks and tabs stay."""
    return text if text.isascii() and text.isprintable() else text.translate(VISIBLE)


def shortened(text: str, most: int = LONGEST_NAME) -> str:
    """Return a text of at most `most` characters: the middle of a longer one is left out."""
    if len(text) <= most:
        return text
    kept = most // 2 - 3
    return f"{text[:kept]} ... {text[-kept:]}"


def csv_cell(text: str) -> str:
    """Return a text as a cell of CSV that no spreadsheet takes for a formula: an apostrophe goes before such a one."""
    return f"'{text}" if text.startswith(FORMULAS) else text


class OutputError(InputError):
    """What was to be printed cannot be written; `reader_gone`: whoever read it has closed the pipe."""

    def __init__(self, name: str, fault: OSError) -> None:
        super().__init__(
            f"rths: cannot write to {name}: {fault.strerror or fault}; redirect it to a place that takes it"
        )
        self.reader_gone = fault.errno == errno.EPIPE


class PrintedStream:
    """Stdout or stderr whose texts are made visible. A fault of stdout is an OutputError, one of stderr is nobody's.

    `unfiltered` is the stream itself, for the control sequences of a status line.
    """

    def __init__(self, stream: TextIO, name: str, needed: bool) -> None:
        self.unfiltered = stream
        self._name, self._needed = name, needed

    encoding = property(lambda self: self.unfiltered.encoding)
    errors = property(lambda self: self.unfiltered.errors)
    closed = property(lambda self: self.unfiltered.closed)

    def write(self, text: str | bytes) -> int:
        """Write a text, which click hands over encoded where it answers a shell; raises OutputError."""
        shown = text if isinstance(text, str) else text.decode("utf-8", "backslashreplace")
        self._doing(self.unfiltered.write, visible(shown))
        return len(text)

    def flush(self) -> None:
        """Have everything written; raises OutputError."""
        self._doing(self.unfiltered.flush)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts; raises OutputError."""
        for line in lines:
            self.write(line)

    def isatty(self) -> bool:
        """Tell whether a terminal shows it."""
        return self.unfiltered.isatty()

    def fileno(self) -> int:
        """Return the descriptor."""
        return self.unfiltered.fileno()

    def writable(self) -> bool:
        """Return that it can be written."""
        return True

    def _doing(self, action: Any, *arguments: str) -> None:
        try:
            action(*arguments)
        except OSError as fault:
            if self._needed:
                raise OutputError(self._name, fault) from fault
