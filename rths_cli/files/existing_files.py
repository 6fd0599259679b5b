"""The one rule for files that exist: what rths computed is replaced, and the command says so; measured data never are.

docs/decisions/commands.md holds the rule as a table. Every command asks here for each file it is about to write, before
it starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.durable_files import is_stream, open_regular, stream_fault
from rths_cli.files.hdf5_opening import RECORDED, RESTORE, SIGNATURE, VIRTUAL, Wanted, opened, unreadable
from rths_cli.files.hdf5_safety import attribute
from rths_cli.files.model_file import read_model

RAW_LOG, MODEL = b"RTHSLOG", b"rths-model"
SHOWN = 3  # names of replaced files in a sentence


class Kind(Enum):
    """What is written, by what a message calls it; a file takes the place of one of its own kind."""

    RESULT = "result of rths run"
    MODEL = "model file"
    SWEEP = "result of a sweep"
    RECORDING = "recording"
    DOCUMENT = "text, table, page, figure or export"


FORMATS = {"rths-result": Kind.RESULT, "rths-sweep": Kind.SWEEP, "rths-recording": Kind.RECORDING}


def check_existing(files: Iterable[tuple[Path, Kind]], replace: bool, streams: bool = False) -> tuple[Path, ...]:
    """Return those of the files to be written that exist and will be replaced.

    Raises InputError with a sentence for each that may not be: measured data, another kind of file, and any with
    `replace` false (`--no-replace`). A device or pipe is never replaced; with `streams`, one that takes bytes is
    written to, which `written_whole` does.
    """
    asked = list(dict.fromkeys(files))
    flows = [(path, kind) for path, kind in asked if is_stream(path)]
    present = [(path, kind) for path, kind in asked if path.is_file() and (path, kind) not in flows]
    faults = [fault for path, kind in flows if (fault := _stream_fault(path, kind, streams))]
    faults += [fault for path, kind in present if (fault := _fault(path, kind, replace))]
    if faults:
        raise InputError(*faults)
    return tuple(path for path, _ in present)


def replaced_sentence(files: Sequence[Path]) -> str:
    """Return the sentence on the files that were replaced, "" where there are none."""
    names = ", ".join(map(str, files[:SHOWN])) + (f" and {len(files) - SHOWN} more" if len(files) > SHOWN else "")
    return f"replaced {names}" if files else ""


def _stream_fault(path: Path, kind: Kind, streams: bool) -> str:
    what = stream_fault(path)
    if streams and not what:
        return ""
    return f"{path}: {what or 'is no file, but a device or pipe'}; a {kind.value} needs a file, give the name of one"


def _fault(path: Path, kind: Kind, replace: bool) -> str:
    try:
        found, measured = _look(path)
    except InputError as error:
        reason = error.faults[0].removeprefix(f"{path}: ").partition(";")[0].rstrip(".")
        return f"{path}: exists and {reason}, so what it holds is not known; choose another name"
    if measured:
        return f"{path}: exists and holds measured data, which are never replaced; choose another name"
    if found is not kind and path.stat().st_size:
        return f"{path}: exists and is no {kind.value}, which alone is replaced; choose another name"
    if not replace:
        return f"{path}: exists; remove it, choose another name, or drop --no-replace"
    return ""


def _look(path: Path) -> tuple[Kind | None, bool]:
    """Return what a file is, None where it is of no known kind, and whether it holds measured data.

    Raises InputError for one that cannot be read.
    """
    try:
        with open_regular(path) as file:
            start = file.read(len(MODEL))
    except OSError as error:
        raise InputError(unreadable(path, error)) from error
    if start.startswith(RAW_LOG):
        return Kind.RECORDING, True
    if start.startswith(MODEL):
        return Kind.MODEL, _is_real_model(path)
    return _look_into(path) if start.startswith(SIGNATURE) else (Kind.DOCUMENT, False)


def _is_real_model(path: Path) -> bool:
    """Return whether a model is of a real rig; a damaged one is of no use any more."""
    try:
        return _is_real(read_model(path).attributes.get("rig_kind"))
    except InputError:
        return False


def _look_into(path: Path) -> tuple[Kind | None, bool]:
    with opened(path, Wanted("file of rths", "is not an HDF5 file", RESTORE)) as file:
        form, rig, convention = (attribute(file, name) for name in ("format", "rig_kind", "Conventions"))
    if convention is not None:  # an export
        return Kind.DOCUMENT, False
    kind = FORMATS.get(str(form))
    return kind, kind is Kind.RECORDING or (kind is Kind.RESULT and _is_real(rig))


def _is_real(rig_kind: object) -> bool:
    return str(rig_kind or VIRTUAL) not in (VIRTUAL, RECORDED)
