"""Read cases from files: text to a checked `Case`, all faults at once, each with advice."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails
from yaml import YAMLError

from rths_cli.case.benchmark_schema import BenchmarkSpec, TableBenchmarkSpec
from rths_cli.case.case_schema import Case, CaseKeys
from rths_cli.case.json_schema import schema
from rths_cli.case.named_files import find, is_bare, is_record, kind_of, kind_of_tree, known, no_case, written_by_rths
from rths_cli.case.reference_schema import ReferenceSpec
from rths_cli.case.resolve import (
    NOTHING_TYPED,
    SHORT_FORMS,
    Setting,
    apply_settings,
    expand_case,
    expand_file,
    extended_case,
    read_settings,
)
from rths_cli.case.rig_schema import AnyRig, RigSpec
from rths_cli.case.shipped_files import shipped
from rths_cli.case.structure_schema import DampingSpec, ScaleSpec, StructureSpec
from rths_cli.case.study_schema import StudyKeys
from rths_cli.case.yaml_reader import (
    Fault,
    Mark,
    Node,
    Source,
    display,
    dump,
    join,
    odd_space_in,
    parse,
    plain,
    read_file,
)
from rths_cli.errors import InputError
from rths_cli.unit_names import unit_of_name

_NUMBER = r"[-+]?(?:[0-9]+(?:[.,][0-9]*)?|[.,][0-9]+)(?:[eE][-+]?[0-9]+)?"
_LIMIT = rf"[<>]=? {_NUMBER}"
_OUT_OF_RANGE = re.compile(rf"(must be (?:0 \(off\) or )?{_LIMIT}(?: and {_LIMIT})*), got ({_NUMBER})")
IN_ANOTHER_UNIT = {"s": {"ms": 1e-3}, "m": {"mm": 1e-3}, "Hz": {"kHz": 1e3}}  # what a number is often stated in
_CHOICE = re.compile(r"must be (.+), got '(.*)'")

Read = TypeVar("Read")
Given = Path | str | Mapping[str, Any]
"""A case: its file, a bare name, or its keys."""


def with_advice(key: str, message: str) -> str:
    """Return the sentence on the value of a key with the key's unit, and with what to write where that is clear."""
    unit = unit_of_name(key, "")
    if out := _OUT_OF_RANGE.fullmatch(message):
        return _with_unit(key, unit, out[1], out[2])
    if not (choice := _CHOICE.fullmatch(message)):
        return message
    wanted, given = choice[1], choice[2].strip()
    if wanted == "a number":
        return message + _number(given, unit)
    words = re.split(r", | or ", wanted)
    same = [word for word in words if _plain(word) == _plain(given)]
    return f"{message}; write {same[0]}" if same else message


def _with_unit(key: str, unit: str, wanted: str, given: str) -> str:
    """Return the sentence on a number out of its range."""
    if key.endswith(("_ratio", "_ratios")) and 1.0 <= float(given) <= 100.0:
        return f"{wanted}, got {given}; a ratio, not percent: write {float(given) / 100.0:g}"
    told = f"{wanted}{f' {unit}' if unit else ''}, got {given}"
    for smaller, factor in IN_ANOTHER_UNIT.get(unit, {}).items():
        if _meets(wanted, factor * float(given)):
            return f"{told}; {given} {smaller} are {factor * float(given):g} {unit}"
    return f"{told}; a factor on the record, 1 plays it as it is" if key == "scaling" else told


def _meets(wanted: str, value: float) -> bool:
    """Return whether a number is within the limits of a sentence such as `must be >= 0 and <= 0.1`."""
    holds = {"<": value.__lt__, "<=": value.__le__, ">": value.__gt__, ">=": value.__ge__}
    limits = re.findall(rf"([<>]=?) ({_NUMBER})", wanted)
    return value > 0.0 and all(holds[sign](float(limit)) for sign, limit in limits)


def _number(given: str, unit: str) -> str:
    """Return how to write a number that came with a decimal comma, a percent sign or a unit."""
    found = re.fullmatch(rf"({_NUMBER})\s*(\D*)", given)
    if found is None:
        return f"; in {unit}" if unit else ""
    text, after = found[1].replace(",", "."), found[2]
    if after == "%":
        return f"; write {float(text) / 100.0:g}"
    if not after or after == unit:
        return f"; write {text}"
    return f"; write the number alone{f', in {unit}' if unit else ''}"


def _plain(word: str) -> str:
    return word.casefold().replace("_", "").replace("-", "").replace(" ", "")


__all__ = [
    "PlacedSettings", "WrittenCase", "load_all", "load_cases", "load_each", "load_reference", "load_rig",
    "load_structure", "load_study", "load_written", "read_case", "resolved_yaml", "schema", "study_file",
    "written_case",
]  # fmt: skip


def load_cases(
    paths: Sequence[Given], settings: Sequence[str] = (), typed: Mapping[str, str] = NOTHING_TYPED
) -> list[Case]:
    """Return cases, each of a file or a mapping, with `key.sub=value` settings applied to each.

    `typed`: for a setting that came by another option than --set, the name of that option, which faults then give.
    Raise InputError with all faults of all files.
    """
    values, faults = read_settings(settings, typed)
    cases: list[Case] = []
    for path in paths:
        case, found = _load(path, values)
        faults += found
        cases += [] if case is None else [case]
    faults += _repeated_names(cases)
    if faults:
        raise InputError(*dict.fromkeys(str(fault) for fault in faults))
    return cases


@dataclass(frozen=True)
class WrittenCase:
    """A case as it is written, before settings are put in: its file (or where names in it are looked up) and text."""

    path: Path
    text: str
    tree: Node
    faults: tuple[Fault, ...] = ()


def read_case(given: Given) -> WrittenCase:
    """Return the case of a file or a mapping as it is written; raises InputError when it holds none."""
    written, faults = _read(given)
    if written is None:
        raise InputError(*dict.fromkeys(str(fault) for fault in faults))
    return written


def written_case(text: str, path: Path) -> WrittenCase:
    """Return the case of a text that was once read from `path`; raises InputError when it holds none."""
    tree, faults = parse(text, Source(display(path), path.parent, path))
    if tree is None or not isinstance(tree.value, dict):
        raise InputError(*(map(str, faults) if faults else (f"{display(path)}: must hold the keys of a case",)))
    whole, more = extended_case(tree, path)
    return WrittenCase(path, text, whole, (*faults, *more))


@dataclass(frozen=True)
class PlacedSettings:
    """Settings KEY=VALUE, and where relative paths in the values start (None: the present folder)."""

    texts: Sequence[str]
    folder: Path | None = None


def load_written(written: WrittenCase, *settings: PlacedSettings) -> Case:
    """Return a written case with settings put in, in their order; raises InputError with all faults."""
    found: list[Setting] = []
    faults: list[Fault] = []
    for one in settings:
        read, wrong = read_settings(one.texts, folder=one.folder)
        found, faults = [*found, *read], [*faults, *wrong]
    case, wrong = _checked(written, found)
    if faults or case is None:
        raise InputError(*dict.fromkeys(str(fault) for fault in (*faults, *wrong)))
    return case


def study_file(name: str) -> Path | None:
    """Return the file of a study that a name or path stands for, None when it stands for something else."""
    try:
        path = _case_file(name)
    except InputError:
        return None
    return path if os.path.isfile(path) and kind_of(path) == "studies" else None


def load_study(path: Path) -> tuple[StudyKeys, dict[str, str]]:
    """Return a study, and where each of its axes stands as faults give it; raises InputError with all its faults."""
    _, tree, faults = read_file(path)
    study: StudyKeys | None = None
    if tree is not None:
        try:
            study = StudyKeys.model_validate(plain(tree))
        except ValidationError as error:
            unread = {(fault.mark.line, fault.mark.column) for fault in faults}  # told once
            found = [_fault(tree, entry) for entry in error.errors()]
            faults = [*faults, *(one for one in found if (one.mark.line, one.mark.column) not in unread)]
    if tree is None or study is None or faults:
        faults = sorted(faults, key=lambda fault: (fault.mark.line, fault.mark.column))
        raise InputError(*dict.fromkeys(str(fault) for fault in faults))
    axes = tree.children["axes"].children if "axes" in tree.children else {}
    return study, {key: f"{node.place}: axes.{key}" for key, node in axes.items()}


def load_all(paths: Sequence[Given], settings: Sequence[str], methods: Sequence[str]) -> list[Case]:
    """Return the cases, loaded once for each of `methods` (empty: with their own method), method by method.

    Raises InputError as `load_cases` does.
    """
    cases: list[Case] = []
    for method in methods or ("",):
        chosen = (f"method={method}",) if method else ()
        cases += load_cases(paths, (*settings, *chosen))
    return cases


def load_each(
    names: Sequence[str], settings: Sequence[str], methods: Sequence[str]
) -> tuple[list[Case], dict[str, InputError]]:
    """Return the cases that can be used, as `load_all`, and why each other one cannot, by the name of its file.

    Raises InputError where the settings themselves are wrong.
    """
    _, faults = read_settings(settings)
    if faults:
        raise InputError(*dict.fromkeys(map(str, faults)))
    usable: list[str] = []
    refused: dict[str, InputError] = {}
    taken: dict[str, str] = {}
    for name in names:
        try:
            case = load_cases([name], settings)[0]
        except InputError as error:
            refused[name] = error
            continue
        other = taken.setdefault(case.name, name)
        if other != name:
            refused[name] = InputError(f"{name}: {case.name!r} is also the name of {other}; give each its own name")
            continue
        usable.append(name)
    return load_all(usable, settings, methods), refused


def load_structure(name: str) -> tuple[StructureSpec, tuple[DampingSpec, ...], Path, ScaleSpec | None]:
    """Return the building that a name or path stands for, its damping levels, its file, and the scale of a case.

    A case stands for its building, with the case's own damping alone. Raises InputError with all faults of the file.
    """
    path = _structure_file(name)
    _, tree, faults = read_file(path)
    if tree is None:
        written = written_by_rths(path, "structure")
        raise InputError(*([f"{display(path)}: {written}"] if written else map(str, faults)))
    kind = kind_of_tree(tree)
    if kind == "cases":
        case = load_cases([path])[0]
        return case.structure, (case.damping,), path, case.scale
    if kind in ("rigs", "references", "calibrations"):
        raise InputError(
            f"{display(path)}: is a {kind.removesuffix('s')}, not a structure; rths list structures lists them"
        )
    spec = _load_file(path, "structures", StructureSpec.model_validate)
    return spec, tuple(spec.damping_levels.values()), path, None


def load_rig(path: Path) -> RigSpec:
    """Return the rig of a file; raises InputError with all its faults."""
    return _load_file(path, "rigs", TypeAdapter(AnyRig).validate_python)


def load_reference(path: Path) -> ReferenceSpec:
    """Return the reference of a file; raises InputError with all its faults."""
    return _load_file(path, "references", ReferenceSpec.model_validate)


def load_benchmark(path: Path) -> BenchmarkSpec | TableBenchmarkSpec:
    """Return the benchmark of a file; raises InputError with all its faults."""
    return _load_file(path, "benchmarks", _benchmark)


def _benchmark(data: Any) -> BenchmarkSpec | TableBenchmarkSpec:
    of_table = isinstance(data, Mapping) and data.get("loop") == "table"
    return TableBenchmarkSpec.model_validate(data) if of_table else BenchmarkSpec.model_validate(data)


def _load_file(path: Path, kind: str, check: Callable[[Any], Read]) -> Read:
    """Return what a structure, rig or reference file holds; raises InputError with all its faults."""
    node, faults = expand_file(path, kind)
    if node is not None and not faults:
        try:
            return check(plain(node))
        except ValidationError as error:
            faults = [_fault(node, entry) for entry in error.errors()]
    faults = sorted(faults, key=lambda fault: (fault.mark.line, fault.mark.column))
    raise InputError(*dict.fromkeys(str(fault) for fault in faults))


def _structure_file(name: str) -> Path:
    """Return the file of a structure, or of a case, named on the command line."""
    if not is_bare(name) or os.path.isdir(name):
        return Path(name)
    try:
        return find(name, "structures", Path.cwd())
    except InputError:
        if name in known("cases", Path.cwd()):
            return find(name, "cases", Path.cwd())
        raise


def resolved_yaml(case: Case) -> str:
    """Return a case with defaults filled in and names looked up, as YAML that loads to the same case."""
    data = case.model_dump(exclude={"path", "yaml_text"}, exclude_none=True)
    if not case.structure.numerical.masses_kg:  # of matrices that nobody has read yet
        del data["structure"]["numerical"]["masses_kg"]
    record = case.record.path
    if record.parent == shipped("records"):
        data["record"]["file"] = record.stem
    return dump(_writable(data))


def _load(path: Given, settings: Sequence[Setting]) -> tuple[Case | None, list[Fault]]:
    """Return the case of one file or mapping, None with its faults."""
    written, faults = _read(path)
    return (None, faults) if written is None else _checked(written, settings)


def _read(path: Given) -> tuple[WrittenCase | None, list[Fault]]:
    """Return the case of one file or mapping as it is written, None with its faults."""
    if isinstance(path, Mapping):
        return _read_mapping(path)
    try:
        found = _case_file(str(path))
    except InputError as error:
        source = Source(display(Path(path)) if "\0" not in str(path) else "case", Path.cwd())
        return None, [Fault(Mark(source), "", str(error))]
    text, tree, faults = read_file(found)
    if tree is None:
        written = written_by_rths(found)
        return None, [Fault(Mark(Source(display(found), Path.cwd())), "", written)] if written else faults
    if (kind := kind_of_tree(tree)) not in ("", "cases"):
        return None, [Fault(Mark(tree.mark.source), "", no_case(kind, str(path)))]
    if not isinstance(tree.value, dict) and is_record(found):
        return None, [Fault(Mark(tree.mark.source), "", no_case("records", str(path)))]
    if not isinstance(tree.value, dict):
        found_in = "is empty; write" if tree.value is None else "must hold"
        message = f"{found_in} the keys of a case, at least structure, damping, record, scaling and controller"
        return None, [*faults, Fault(tree.mark, "", message)]
    whole, more = extended_case(tree, found)
    return WrittenCase(found, text, whole, (*faults, *more)), []


def _read_mapping(keys: Mapping[str, Any]) -> tuple[WrittenCase | None, list[Fault]]:
    """Return the case of a mapping, None with its faults; names and relative paths start at the present folder."""
    source = Source("case", Path.cwd())
    try:
        text = dump(_writable(dict(keys)))
    except YAMLError as error:
        return None, [Fault(Mark(source), "", f"holds a value that a case file cannot: {str(error).splitlines()[0]}")]
    tree, faults = parse(text, source)
    if tree is None or not isinstance(tree.value, dict):
        return None, faults or [Fault(Mark(source), "", "must hold the keys of a case")]
    path = Path.cwd() / f"{keys.get('name') or 'case'}.yaml"
    whole, more = extended_case(tree, path)
    return WrittenCase(path, text, whole, (*faults, *more)), []


def _checked(written: WrittenCase, settings: Sequence[Setting]) -> tuple[Case | None, list[Fault]]:
    """Return a written case with settings put in, None with its faults."""
    tree = apply_settings(written.tree, settings)
    expanded, more, lost = expand_case(tree, written.path.stem)
    if any(fault.key == "extends" for fault in written.faults):  # nobody knows what the other case states
        lost |= set(CaseKeys.model_fields) - set(tree.children)
    case, wrong = _validate(expanded, lost, written.path, written.text, tree)
    unread = {fault.mark for fault in written.faults if fault.mark.line}
    wrong = [fault for fault in wrong if fault.mark not in unread]
    faults = sorted([*written.faults, *more, *wrong], key=lambda fault: (fault.mark.line, fault.mark.column))
    return (None if faults else case), faults


def _case_file(name: str) -> Path:
    """Return the file of a case named on the command line; a path is left to the reader to refuse."""
    if is_bare(name) and not os.path.isdir(name):
        return find(name, "cases", Path.cwd())
    return Path(name)


def _stated(tree: Node, above: str = "") -> Iterator[str]:
    """Yield the paths of the keys of a document that hold no further keys."""
    for key, node in tree.children.items():
        path = join(above, key)
        yield from _stated(node, path) if node.children else (path,)


def _validate(tree: Node, lost: set[str], path: Path, text: str, unexpanded: Node) -> tuple[Case | None, list[Fault]]:
    """Return the case of an expanded document, or the faults of its values, lost keys passed over.

    `unexpanded`: the document before the files that it names took their places.
    """
    try:
        keys = CaseKeys.model_validate(plain(tree))
    except ValidationError as error:
        faults = [_fault(tree, entry) for entry in error.errors()]
        wrong = [fault for fault, entry in zip(faults, error.errors(), strict=True) if entry["loc"][0] not in lost]
        return None, _first_of_each_value(wrong)
    table = keys.table.model_copy(update={"limits": keys.table.limits.tightened(keys.limits)})
    about = {
        "path": path.absolute(),
        "yaml_text": text,
        "rig_file": _rig_file(tree, path.absolute()),
        "rig_limits": keys.table.limits,
        "stated": tuple(_stated(unexpanded)),
        "places": {**dict(_marks(tree)), **{key: node.mark for key, node in unexpanded.children.items()}},
    }
    return Case.model_construct(**dict(keys) | {"table": table} | about), []  # its values are those checked above


def _marks(tree: Node, above: str = "") -> Iterator[tuple[str, Mark]]:
    """Yield path and place of each key of an expanded document."""
    for key, node in tree.children.items():
        path = join(above, key)
        yield path, node.mark
        yield from _marks(node, path)


def _rig_file(tree: Node, case: Path) -> Path | None:
    """Return the file that states the kind of a case's rig, None where the case, one that it extends, or --set does."""
    kind = tree.children["table"].children.get("kind")
    path = kind.mark.source.path if kind is not None else None
    return None if path in (None, case) or kind_of(path) == "cases" else path


def _fault(tree: Node, entry: ErrorDetails) -> Fault:
    """Return a fault with the place of its location: the value, or for an unknown key the key."""
    kind, loc, message, meant = entry["type"], entry["loc"], entry["msg"], entry.get("ctx", {}).get("meant", ())
    node, path, key_found = tree, "", True
    for part in loc:
        if isinstance(part, str) and isinstance(node.value, dict):
            child = node.value.get(part)
            key_found = child is not None
            short_form = child is not None and child.mark == node.mark and SHORT_FORMS.get(path) == part
            path = path if short_form else join(path, part)
            node = child or node
        elif isinstance(part, int) and isinstance(node.value, tuple) and part < len(node.value):
            path, node = join(path, part), node.value[part]
    at_key = kind == "unknown_key" or not key_found or isinstance(node.value, dict)
    if not key_found and kind != "unknown_key" and node.place.source.path != node.mark.source.path:
        at_key = False  # it is missing in the file that is named here
    name = next((part for part in reversed(loc) if isinstance(part, str)), "")
    mark = node.place if at_key else node.mark
    if kind == "unknown_key" and mark.line and (odd := odd_space_in(name)):
        return Fault(replace(mark, column=mark.column + odd[0]), path, odd[1])
    if kind == "unknown_key" and not mark.line:
        message = _as_typed(message, path, mark.source.label, meant)
    advised = with_advice(name, message)
    if "; write " not in advised and not mark.line and isinstance(node.value, str) and "," in node.value:
        advised += f"; for several values: rths sweep CASE --vary {path}={node.value}"
    return Fault(mark, path, advised, tuple(meant))


def _as_typed(message: str, path: str, label: str, meant: Sequence[str]) -> str:
    """Return the sentence on an unknown key of the command line with whole paths of the keys that it may have `meant`.

    `label` is what was typed (`--set physics.coulomb_n`), `path` the unknown key (`physics`).
    """
    above, typed = path.rpartition(".")[0], label.rpartition(" ")[2]
    below = typed.removeprefix(path) if typed.startswith(f"{path}.") else ""
    whole = " or ".join(f"{join(above, name)}{below}" for name in meant)
    return message.replace(" or ".join(meant), whole) if meant else message


def _first_of_each_value(faults: Sequence[Fault]) -> list[Fault]:
    """Return the faults without those that follow from another one.

    These are further ones of a value that is out of its range or of a wrong type; a key that is missing because it is
    misspelt; and what is to be given instead of a misspelt key of the command line.
    """
    first: dict[tuple[Mark, str], Fault] = {}
    kept = []
    unknown = [fault for fault in faults if fault.message.startswith("unknown key")]
    meant = {join(fault.key.rpartition(".")[0], name) for fault in faults for name in fault.meant}
    typed = {fault.mark for fault in unknown if not fault.mark.line}
    for fault in faults:
        if fault.message.startswith("is missing") and fault.key in meant:
            continue
        if fault.message.startswith("give ") and fault.mark in typed:
            continue
        of_value = fault.message.startswith("must be ") and ", got " in fault.message
        if of_value and first.setdefault((fault.mark, fault.key), fault) is not fault:
            continue
        kept.append(fault)
    return kept


def _repeated_names(cases: Sequence[Case]) -> list[Fault]:
    """Return a fault for each case whose name an earlier one has: their result files would be the same."""
    first: dict[str, Path] = {}
    faults = []
    for case in cases:
        if case.name in first:
            if (other := first[case.name]) == case.path:
                message = "the case is given twice; name it once"
            else:
                message = f"{case.name!r} is also the name of {display(other)}; give each case its own name"
            faults.append(Fault(Mark(Source(display(case.path), case.path.parent)), "name", message))
        first.setdefault(case.name, case.path)
    return faults


def _writable(data: Any) -> Any:
    """Return nested data with lists for tuples and text for paths."""
    if isinstance(data, dict):
        return {key: _writable(value) for key, value in data.items()}
    if isinstance(data, tuple | list):
        return [_writable(value) for value in data]
    return str(data) if isinstance(data, Path) else data
