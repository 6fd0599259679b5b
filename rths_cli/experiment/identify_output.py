"""The output files of `rths identify`: checked before anything is measured."""

from __future__ import annotations

import glob
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.existing_files import Kind, check_existing
from rths_cli.files.result_writer import check_writable

PROBE = "probe"  # end of the name of the record at low level
FIGURE_FORMATS = ("png", "svg", "pdf")
Named = tuple[str, Path]


@dataclass(frozen=True)
class Outputs:
    """The output files of an identification."""

    model: Path  # model file
    figure: Path | None  # None: no figure
    save_data: Path | None  # measured data; None: not saved

    @property
    def named(self) -> tuple[Named, ...]:
        """Return the files that are written, each with the option that names it."""
        every = (("--output", self.model), ("--figure", self.figure), ("--save-data", self.save_data))
        return tuple((option, path) for option, path in every if path is not None)


def check_outputs(outputs: Outputs, inputs: Iterable[Named], replace: bool = True) -> tuple[Path, ...]:
    """Return the files that will be replaced; raises InputError with all faults if a file cannot be written, or would
    replace an input or what may not be replaced.

    `inputs`: files that are read, each with the word or option that names it.
    """
    faults = [fault for option, path in outputs.named for fault in _name_faults(option, path)]
    faults += _shared(outputs.named, tuple(inputs))
    if faults:
        raise InputError(*faults)
    replaced = check_existing(_kinds(outputs), replace)
    for _, path in outputs.named:
        try_folder(path.parent)
    return replaced


def _kinds(outputs: Outputs) -> Iterator[tuple[Path, Kind]]:
    """Yield the files that are written, and those that more than one record would become, with their kinds."""
    yield outputs.model, Kind.MODEL
    if outputs.figure is not None:
        yield outputs.figure, Kind.DOCUMENT
    if (path := outputs.save_data) is not None:
        yield path, Kind.RECORDING
        for other in sorted(path.parent.glob(f"{glob.escape(path.stem)}_*{glob.escape(path.suffix)}")):
            if other.stem.removeprefix(f"{path.stem}_") == PROBE or other.stem.rpartition("_")[2].isdigit():
                yield other, Kind.RECORDING


def make_folders(outputs: Outputs) -> None:
    """Create the folders of the output files; raises InputError if that fails."""
    for _, path in outputs.named:
        check_writable(path.parent)


def try_folder(folder: Path, needed_bytes: int = 0) -> None:
    """Raise InputError if files cannot be written to a folder, or it lacks `needed_bytes` of space.

    A folder that does not exist is created for the test and removed again.
    """
    new = [place for place in (folder, *folder.parents) if not place.exists()]
    check_writable(folder, needed_bytes)
    with suppress(OSError):
        for place in new:
            place.rmdir()


OTHER_DATA = (".csv", ".txt", ".mat", ".tdms")  # of files that --data reads and nothing here writes


def _name_faults(option: str, path: Path) -> list[str]:
    """Return a sentence if a path is a folder, or if its suffix is that of another format than what is written."""
    if path.is_dir():
        return [f"{option} {path}: is a folder; give the name of a file in it"]
    if option == "--figure" and path.suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
        return [f"--figure {path}: must end in .png, .svg or .pdf"]
    if option == "--save-data" and path.suffix.lower() in OTHER_DATA:
        return [f"--save-data {path}: is written as HDF5; give a name that ends in .h5"]
    return []


def _shared(outputs: tuple[Named, ...], inputs: tuple[Named, ...]) -> list[str]:
    """Return a sentence for each output file that is also an input, or is written twice."""
    faults, seen = [], {path.resolve(): what for what, path in inputs}
    for option, path in outputs:
        other = seen.setdefault(path.resolve(), option)
        if other != option:
            faults.append(f"{option} {path}: is the file of {other} too; choose another name")
    return faults
