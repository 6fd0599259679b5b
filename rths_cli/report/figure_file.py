"""Write one figure to the file that the user names: .png, .svg or .pdf by its suffix, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.interrupts import interruptible

FORMS = ("png", "svg", "pdf")


def write_figure_file(path: Path, image: Callable[[str], bytes]) -> None:
    """Write what `image` returns for the form that the suffix of `path` names.

    Raises InputError for another suffix, or if the file cannot be written; then no file is left behind.
    """
    form = path.suffix.lower().removeprefix(".")
    if form not in FORMS:
        raise InputError(f"{path}: a figure's file name must end in .png, .svg or .pdf")
    content = interruptible(lambda: image(form))
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: cannot write the figure: {error.strerror}; choose another file") from error
    finally:
        with suppress(OSError):
            part.unlink()
