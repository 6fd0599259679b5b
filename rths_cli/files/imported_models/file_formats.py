"""Read an imported model's document from YAML, JSON or MATLAB: values and their places.

Nothing is judged here but form: a value is a number, a list of numbers, or text. What is not goes to the faults,
and its key stays with the value None, so that nobody calls it missing as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from rths_cli.case.field_types import near, shown
from rths_cli.case.yaml_reader import parse, read_file
from rths_cli.case.yaml_tree import Fault, Mark, Node, Source, display, plain, printable
from rths_cli.files.durable_files import open_regular
from rths_cli.files.matlab_files import MatlabObject, Value, matlab_variables
from rths_cli.numerics.lti import ComplexArray

KEYS: dict[str, tuple[str, ...]] = {
    "zeros": ("z",),
    "poles": ("p",),
    "gain": ("k",),
    "numerator": ("num",),
    "denominator": ("den",),
    "delay_s": ("delay", "Td", "InputDelay", "iodelay", "IODelay"),
    "output": (),
    "frequency_unit": (),
    "band_hz": (),
    "ripple_m_s2_per_v": (),
    "notes": (),
    "sample_time_s": ("Ts",),
}
"""What a file may state, with the other names it may have in a MATLAB file."""
TEXTS = ("output", "frequency_unit", "notes")
PAIRS = ("zeros", "poles")
HEAD = 4096
MAX_NUMBERS = 1000  # of a vector in a MATLAB file
DEPTH = 3  # of cells in each other
Kind = Literal["text", "mat", "other"]


@dataclass(frozen=True)
class Entry:
    """One value of a file: text, one number (), or numbers (n,); `name` is its name in the file."""

    name: str
    value: ComplexArray | str | None
    mark: Mark


@dataclass
class Document:
    """What a file states, by the keys of KEYS, its faults so far, and notes for the user."""

    mark: Mark
    entries: dict[str, Entry] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def kind_of(path: Path) -> Kind:
    """Tell by its first bytes whether a file is text or of MATLAB; `other` is a file of rths, or none of these."""
    try:
        with open_regular(path) as file:
            head = file.read(HEAD)
    except OSError:
        return "other"
    if head.startswith(b"MATLAB"):
        return "mat"
    if not head or head.startswith(b"rths-"):
        return "other"
    if path.suffix.lower() == ".mat":
        return "mat"
    return "other" if b"\0" in head else "text"


def read_text(path: Path) -> Document:
    """Read a YAML or JSON file; unknown keys are faults."""
    text, tree, faults = read_file(path)
    source = Source(display(path), path.absolute().parent, path.absolute())
    if "\t" in text and text.lstrip().startswith("{"):  # YAML forbids the tabs that JSON may be indented with
        tree, faults = parse(text.replace("\t", " "), source)
    document = Document(tree.mark if tree else Mark(source), faults=list(faults))
    if tree is not None and not isinstance(tree.value, dict):
        document.faults.append(Fault(tree.mark, "", "must hold the keys of a model: zeros, poles and gain"))
    for name, node in tree.children.items() if tree else ():
        if name in KEYS:
            document.entries[name] = _entry(document, name, node)
        else:
            document.faults.append(Fault(node.place, printable(name)[:80], f"unknown key{near(name, KEYS)}"))
    return document


def _entry(document: Document, name: str, node: Node) -> Entry:
    """Return the value of a YAML key; what is of a wrong form becomes a fault at its own place."""
    if name in TEXTS:
        if isinstance(node.value, str):
            return Entry(name, node.value, node.mark)
        document.faults.append(Fault(node.mark, name, f"must be text, got {shown(plain(node))}"))
        return Entry(name, None, node.mark)
    items = node.value if isinstance(node.value, tuple) else (node,)
    pairs = name in PAIRS and isinstance(node.value, tuple)
    numbers = [_number(item, pairs) for item in items]
    wanted = "a number or a pair [real, imaginary]" if pairs else "a number"
    wrong = [item for item, number in zip(items, numbers, strict=True) if number is None]
    told = {fault.mark for fault in document.faults}
    for item in wrong:
        if item.mark not in told:
            document.faults.append(Fault(item.mark, name, f"must be {wanted}, got {shown(plain(item))}"))
    if wrong:
        return Entry(name, None, node.mark)
    values: ComplexArray = np.array(numbers if isinstance(node.value, tuple) else numbers[0], dtype=complex)
    return Entry(name, values, node.mark)


def _number(node: Node, pairs: bool) -> complex | None:
    """Return a real number, or a pair as a complex one; None for anything else."""
    if pairs and isinstance(node.value, tuple) and len(node.value) == 2:
        real, imag = (_number(part, False) for part in node.value)
        return None if real is None or imag is None else complex(real.real, imag.real)
    if isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return complex(node.value)
    return None


def read_mat(path: Path) -> Document:
    """Read the variables of a MATLAB file (v5 or v7.3) that have a name of KEYS; others are noted."""
    document = Document(Mark(Source(display(path), path.absolute().parent, path.absolute())))
    wanted = [name for key, others in KEYS.items() for name in (key, *others)]
    try:
        variables = matlab_variables(path, wanted)
    except ValueError:
        message = "cannot be read as a MATLAB file, it is damaged or none at all; save z, p and k again"
        document.faults.append(Fault(document.mark, "", message))
        return document
    for key, others in KEYS.items():
        given = [name for name in (key, *others) if name in variables]
        if len(given) > 1:
            message = f"give {' or '.join(given)}, not both" if key != "delay_s" else _one_delay(given)
            document.faults.append(Fault(document.mark, given[1], message))
        if given:
            document.entries[key] = _variable(document, given[0], variables[given[0]])
    _tell_unused(document, variables, wanted, path)
    return document


def _one_delay(given: list[str]) -> str:
    return f"stands beside {given[0]}; save the sum of all delays as delay_s"


def _variable(document: Document, name: str, value: Value) -> Entry:
    """Return a variable's number, numbers (n,) or text; what is of a wrong form becomes a fault."""
    for _ in range(DEPTH):  # cells of one entry are opened
        if isinstance(value, tuple) and len(value) == 1:
            value = value[0]
    if isinstance(value, list) and len(value) == 1:
        return Entry(name, value[0], document.mark)
    numbers = np.zeros(0) if isinstance(value, list | tuple) and not value else value
    if (
        isinstance(numbers, np.ndarray)
        and numbers.size <= MAX_NUMBERS
        and numbers.size in (0, max((1, *numbers.shape)))
    ):
        return Entry(name, numbers.reshape(-1).astype(complex), document.mark)
    document.faults.append(Fault(document.mark, name, _why_not(value)))
    return Entry(name, None, document.mark)


def _why_not(value: Value) -> str:
    """Return the sentence on a value that is neither numbers nor a text."""
    if isinstance(value, tuple):
        return f"is a cell array of {len(value)} entries; save one input and one output of the model"
    if isinstance(value, MatlabObject):
        return f"must be numbers, got a MATLAB {value.class_name} object"
    if isinstance(value, np.ndarray):
        shape = " x ".join(map(str, value.shape))
        return f"must be a vector of at most {MAX_NUMBERS}, got {shape} numbers"
    return "must be numbers, got a structure or something else"


def _tell_unused(document: Document, variables: Mapping[str, Value], used: list[str], path: Path) -> None:
    """Add a fault when an object of MATLAB stands where roots are looked for, else a note on what was not used."""
    unused = [printable(name)[:60] for name in variables if name not in used]
    objects = {name: value.class_name for name, value in variables.items() if isinstance(value, MatlabObject)}
    if not {"poles", "denominator"} & set(document.entries) and objects:
        name = next(iter(objects))
        message = (
            f"is a MATLAB {printable(objects[name])} object, which only MATLAB can read; "
            f"save its roots instead: [z,p,k] = zpkdata({name},'v'); save('{path.stem}_zpk.mat','z','p','k')"
        )
        document.faults.append(Fault(document.mark, printable(name)[:60], message))
    elif unused:
        document.notes.append(f"variables not used: {', '.join(unused[:10])}{', ...' if len(unused) > 10 else ''}")
