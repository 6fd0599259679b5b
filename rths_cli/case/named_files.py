"""What a name in a case stands for: the kinds of files, where they are looked for, what is there."""

from __future__ import annotations

import contextlib
import difflib
import os
import re
from collections.abc import Iterator, Sequence
from glob import glob, has_magic
from pathlib import Path

from rths_cli.case.shipped_files import FOLDERS, shipped
from rths_cli.case.yaml_reader import Node, read_file
from rths_cli.errors import InputError

TELLING = {
    "cases": ("structure", "damping", "record", "scaling", "controller"),
    "structures": ("numerical", "experimental", "damping_levels", "interface_experimental_mass_kg", "heights_m"),
    "rigs": (
        "kind",
        "physics",
        "sensors",
        "channels",
        "converters",
        "nominal",
        "after_identification",
        "udp",
        "link",
        "ni",
        "calibration",
    ),
    "references": ("title", "source", "entries"),
    "benchmarks": ("heading", "published_in", "loop", "compensators"),
    "calibrations": ("rig", "made_utc", "masses"),
    "studies": ("case", "axes", "samples", "correlations", "constraints"),
}
"""Top-level keys by which a YAML file is recognised; no other kind of file has them."""
MOST_EXTENDED = 8  # files that extend one another are followed so far to see of which kind they are
EXTENDING = ("cases", "rigs", "structures")  # kinds whose files may extend another one
KEY_IN_CASE = {"structures": "structure", "rigs": "table", "references": "reference", "records": "record"}
HDF5 = b"\x89HDF\r\n\x1a\n"
MARKED = 1 << 16  # bytes in which an HDF5 file states its format
RECORD_BYTES, RECORD_LINES = 8192, 3  # read to recognise a record, and the fewest lines of numbers that it has
NUMBER = re.compile(r"\s*[-+]?(?:\d|\.\d)")

YAML = (".yaml", ".yml")
RECORD = (
    ".csv", ".at2", ".AT2", ".txt", ".dat", ".ASC", ".asc", ".V1", ".V2", ".v1", ".v2", ".V1c", ".V2c", ".V1C", ".V2C",
    ".NS", ".EW", ".UD", ".NS1", ".EW1", ".UD1", ".NS2", ".EW2", ".UD2", ".g3",
)  # fmt: skip


def kind_of(path: Path) -> str | None:
    """Return the kind of a YAML file, a key of TELLING; "" if its keys are none of them, None if it has no keys."""
    tree = read_file(path)[1]
    return None if tree is None or not tree.children else kind_of_tree(tree)


def kind_of_tree(tree: Node) -> str:
    """Return the kind of a YAML document, the one with most of its keys, or without one that of what it extends; "" if
    neither tells."""
    for _ in range(MOST_EXTENDED):
        counts = {kind: sum(key in tree.children for key in keys) for kind, keys in TELLING.items()}
        kind = max(counts, key=lambda kind: counts[kind])
        if counts[kind]:
            return kind
        base, source = tree.children.get("extends"), tree.mark.source
        if base is None or not isinstance(base.value, str):
            return ""
        there = (path for kind in EXTENDING for path in _candidates(base.value, kind, source.folder))
        path = next((path for path in there if path.is_file() and not _same(path, source.path)), None)
        below = None if path is None else read_file(path)[1]
        if below is None:
            return ""
        tree = below
    return ""


def is_record(path: Path) -> bool:
    """Return whether a text file seems to hold numbers in lines, behind a header at most."""
    if not os.path.isfile(path):
        return False
    try:
        with open(path, "rb") as file:
            head = file.read(RECORD_BYTES)
    except OSError:
        return False
    lines = [line for line in head.decode("latin-1").splitlines() if line.strip()]
    if len(head) == RECORD_BYTES:
        lines = lines[:-1]  # which may be cut in the middle of a number
    return len(lines) >= RECORD_LINES and all(NUMBER.match(line) for line in lines[-RECORD_LINES:])


def written_by_rths(path: Path, wanted: str = "case") -> str:
    """Return what an HDF5 file given for a `wanted` is, as the end of a sentence that says what it is for; else ""."""
    if not os.path.isfile(path):
        return ""
    try:
        with open(path, "rb") as file:
            head = file.read(MARKED)
    except OSError:
        return ""
    if not head.startswith(HDF5):
        return ""
    if b"rths-model" in head:
        return f"is a model file, not a {wanted}; name it in a case: identification: {{model: FILE}}"
    what = "sweep" if b"rths-sweep" in head else "result"
    return f"is a {what}, not a {wanted}; rths report {os.path.relpath(path)} shows it"


def no_case(kind: str, name: str) -> str:
    """Return what a file of another kind is, given its name or path, and what to do, as the end of a sentence."""
    if kind == "studies":
        return f"is a study, not a case; rths sweep {name} runs it"
    what = kind.removesuffix("s")
    if kind == "benchmarks":
        return f"is a benchmark, not a case; rths benchmark {name} runs it"
    if kind == "calibrations":
        return f"is a calibration, not a case; a rig file names it (calibration: {name})"
    named = Path(name).stem if os.path.basename(name) == name else name
    look = f", or look at it with rths structure {name}" if kind == "structures" else ""
    return f"is a {what}, not a case; write a case that names it ({KEY_IN_CASE[kind]}: {named}) with rths new{look}"


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


def case_files(names: Sequence[str]) -> list[str]:
    """Return the cases that names on the command line stand for: a folder for all in it, a pattern for all that it
    matches; anything else is left to the reader.

    In a folder a file without keys that tell its kind counts as a case, to be refused by its own fault. Each file
    counts once. Raises InputError for a folder or a pattern without any.
    """
    found: dict[str, str] = {}
    for name in names:
        if os.path.isdir(name):
            inside = (path for path in sorted(Path(name).iterdir()) if path.suffix in YAML and path.is_file())
            cases = [str(path) for path in inside if kind_of(path) in ("cases", "", None)]
        elif has_magic(name) and not os.path.exists(name):
            cases = sorted(path for path in glob(os.path.expanduser(name)) if os.path.isfile(path))
            if not cases:
                raise InputError(f"{name}: matches no file; a pattern stands for files, not for names of shipped cases")
        else:
            cases = [name]
        if not cases:
            raise InputError(f"{name}: holds no case file (.yaml, .yml); rths new writes one to start from")
        for case in cases:
            found.setdefault(os.path.realpath(case) if os.path.exists(case) else case, case)
    return list(found.values())


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
