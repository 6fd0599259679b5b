"""Write one figure to the file that the user names: .png, .svg or .pdf by its suffix, whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
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
    try:
        with written_whole(path) as part:
            part.write_bytes(content)
    except OSError as error:
        raise InputError(f"{path}: cannot write the figure: {error.strerror}; choose another file") from error
