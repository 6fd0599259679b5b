"""The output files of `rths identify`: checked before anything is measured."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable_files import open_regular
from rths_cli.files.model_file import FORMAT
from rths_cli.files.result_writer import check_writable

FIGURE_FORMATS = ("png", "svg", "pdf")
Named = tuple[str, Path]


@dataclass(frozen=True)
class Outputs:
    """The files of an identification: model file, figure and measured data, the latter two None where not wanted."""

    model: Path
    figure: Path | None
    save_data: Path | None

    @property
    def named(self) -> tuple[Named, ...]:
        """Return each file that is written with the option that names it."""
        every = (("--output", self.model), ("--figure", self.figure), ("--save-data", self.save_data))
        return tuple((option, path) for option, path in every if path is not None)


def check_outputs(outputs: Outputs, inputs: Iterable[Named]) -> None:
    """Raise InputError, with every fault, where a file cannot be written or would replace what it must not.

    `inputs` are the files that are read, each with what names it.
    """
    faults = [fault for option, path in outputs.named for fault in _name_faults(option, path)]
    faults += _shared(outputs.named, tuple(inputs)) or _replaced(outputs.model)
    if faults:
        raise InputError(*faults)
    for _, path in outputs.named:
        try_folder(path.parent)


def make_folders(outputs: Outputs) -> None:
    """Make the folders of the files that are about to be written; raises InputError where that fails."""
    for _, path in outputs.named:
        check_writable(path.parent)


def try_folder(folder: Path, needed_bytes: int = 0) -> None:
    """Raise InputError where a folder cannot be written to; one that is not there yet is not left behind."""
    new = [place for place in (folder, *folder.parents) if not place.exists()]
    check_writable(folder, needed_bytes)
    with suppress(OSError):
        for place in new:
            place.rmdir()


def _name_faults(option: str, path: Path) -> list[str]:
    """Return a sentence when a path is a folder, or a figure's has another suffix."""
    if path.is_dir():
        return [f"{option} {path}: is a folder; give the name of a file in it"]
    if option == "--figure" and path.suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
        return [f"--figure {path}: must end in .png, .svg or .pdf"]
    return []


def _shared(outputs: tuple[Named, ...], inputs: tuple[Named, ...]) -> list[str]:
    """Return a sentence for each file that is written and also read, or written twice."""
    faults, seen = [], {path.resolve(): what for what, path in inputs}
    for option, path in outputs:
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            faults.append(f"{option} {path}: is the file of {other} too; choose another name")
    return faults


def _replaced(model: Path) -> list[str]:
    """Return a sentence when something else than a model file has the model file's name."""
    try:
        with open_regular(model) as file:
            start = file.read(len(FORMAT))
    except OSError:
        return []  # there is none, or it cannot be read: writing will tell
    if start in (b"", FORMAT.encode()):
        return []
    return [f"--output {model}: exists and is no model file, which alone is replaced; choose another name"]
