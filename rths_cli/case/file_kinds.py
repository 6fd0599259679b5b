"""What a file holds, by its content: a case, structure, rig, reference or record, or a file that rths wrote."""

from __future__ import annotations

import os
import re
from pathlib import Path

from rths_cli.case.yaml_reader import read_file
from rths_cli.case.yaml_tree import Node

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
        "ni",
        "calibration",
    ),
    "references": ("title", "source", "entries"),
    "calibrations": ("rig", "made_utc", "masses"),
    "studies": ("case", "axes", "samples", "correlations", "constraints"),
}
"""Top-level keys by which a YAML file is recognised; no other kind of file has them."""
KEY_IN_CASE = {"structures": "structure", "rigs": "table", "references": "reference", "records": "record"}
HDF5 = b"\x89HDF\r\n\x1a\n"
MARKED = 1 << 16  # bytes in which an HDF5 file states its format
RECORD_BYTES, RECORD_LINES = 8192, 3  # read to recognise a record, and the fewest lines of numbers that it has
NUMBER = re.compile(r"\s*[-+]?(?:\d|\.\d)")


def kind_of(path: Path) -> str | None:
    """Return the kind of a YAML file, a key of TELLING; "" if its keys are none of them, None if it has no keys."""
    tree = read_file(path)[1]
    return None if tree is None or not tree.children else kind_of_tree(tree)


def kind_of_tree(tree: Node) -> str:
    """Return the kind of a YAML document, the one with most of its keys; "" if it has none of TELLING."""
    counts = {kind: sum(key in tree.children for key in keys) for kind, keys in TELLING.items()}
    kind = max(counts, key=lambda kind: counts[kind])
    if not counts[kind] and {"extends", "limits"} <= set(tree.children):
        return "rigs"  # a case has limits too, but extends nothing
    return kind if counts[kind] else ""


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
    if kind == "calibrations":
        return f"is a calibration, not a case; a rig file names it (calibration: {name})"
    named = Path(name).stem if os.path.basename(name) == name else name
    look = f", or look at it with rths structure {name}" if kind == "structures" else ""
    return f"is a {what}, not a case; write a case that names it ({KEY_IN_CASE[kind]}: {named}) with rths new{look}"
