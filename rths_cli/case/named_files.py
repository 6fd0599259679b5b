"""Where the name of a case, structure, rig, reference or record is looked up."""

from __future__ import annotations

import contextlib
import difflib
import os
from collections.abc import Iterator
from pathlib import Path

from rths_cli.case.file_kinds import is_record, kind_of, no_case
from rths_cli.case.shipped_files import FOLDERS, shipped
from rths_cli.errors import InputError

YAML = (".yaml", ".yml")
RECORD = (".csv", ".at2", ".AT2", ".txt", ".dat")


def suffixes(kind: str) -> tuple[str, ...]:
    """Return the file suffixes of a kind, in the order they are tried."""
    return RECORD if kind == "records" else YAML


def find(name: str, kind: str, folder: Path, exclude: Path | None = None) -> Path:
    """Return the file a name or path stands for.

    A path (it contains a separator) is relative to `folder`. A bare name is looked up in `folder`, in the
    current folder's place for the kind, and among the shipped ones; `exclude` is the file it stands in.
    Raise InputError with one sentence when there is no such file.
    """
    if not name.strip() or "\0" in name:
        raise InputError(f"{name[:40]!r} names no file; give a name or a path")
    for candidate in _candidates(name, kind, folder):
        if os.path.isfile(candidate) and not _same(candidate, exclude):
            return candidate
    raise InputError(_missing(name, kind, folder))


def known(kind: str, folder: Path) -> list[str]:
    """Return the bare names of a kind that exist, sorted."""
    return sorted(known_files(kind, folder))


def known_files(kind: str, folder: Path) -> dict[str, Path]:
    """Return the files of a kind by their bare names: those that `find` takes, without files of another kind."""
    files: dict[str, Path] = {}
    for place in _places(kind, folder):
        paths: list[Path] = []
        with contextlib.suppress(OSError):
            paths = sorted(path for path in place.iterdir() if path.suffix in suffixes(kind))
        for path in paths:
            if path.stem not in files and (place != folder or _is_of(kind, path)):
                files[path.stem] = path
    return files


def _is_of(kind: str, path: Path) -> bool:
    """Return whether a file in a folder of several kinds is of this one; a YAML file without keys counts as a case."""
    if kind == "records":
        return is_record(path)
    return kind_of(path) in ((kind, None) if kind == "cases" else (kind,))


def is_bare(name: str) -> bool:
    """Return whether a name contains no separator."""
    return "/" not in name and os.sep not in name


def _places(kind: str, folder: Path) -> tuple[Path, ...]:
    return (folder, Path.cwd() / FOLDERS[kind], shipped(kind))


def _candidates(name: str, kind: str, folder: Path) -> Iterator[Path]:
    for place in _places(kind, folder) if is_bare(name) else (folder,):
        path = place / os.path.expanduser(name)
        yield path
        for suffix in suffixes(kind):
            yield Path(f"{path}{suffix}")


def _same(path: Path, other: Path | None) -> bool:
    return other is not None and os.path.exists(other) and os.path.samefile(path, other)


def _missing(name: str, kind: str, folder: Path) -> str:
    """Return the sentence for a name that stands for no file."""
    what = kind.removesuffix("s")
    if not is_bare(name):
        shown = os.path.normpath(folder / os.path.expanduser(name))[:300]
        return f"no such file: {shown if shown.isprintable() else repr(shown)}; check the path"
    names = known(kind, folder)
    others = [other for other in FOLDERS if other != kind and name in known(other, folder)]
    if others and kind == "cases":
        return f"{name!r} {no_case(others[0], name)}"
    if others:
        return f"{name!r} is a {others[0].removesuffix('s')}, not a {what}; rths list {kind} shows what there is"
    if kind == "cases" and "=" in name:
        return f"no case is called {name[:80]!r}; a setting follows --set, each one its own: --set {name[:80]}"
    matches = difflib.get_close_matches(name[:80], names, n=3, cutoff=0.6)
    hint = f"did you mean {' or '.join(matches)}?" if matches else f"known: {', '.join(names) or 'none'}"
    return f"no {what} is called {name[:80]!r}; {hint}"
