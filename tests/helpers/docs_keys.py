"""The reference pages of case and rig files, from the models that check them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any

from pydantic import BaseModel, TypeAdapter
from pydantic_core import PydanticUndefined

from rths_cli.case.case_schema import CaseKeys
from rths_cli.case.compensator_schema import CompensatorSpec, built_in_compensators
from rths_cli.case.reference_schema import ReferenceSpec
from rths_cli.case.rig_schema import (
    NiRigSpec,
    PluginRigSpec,
    TargetRigSpec,
    UdpPlainRigSpec,
    UdpRigSpec,
    VirtualRigSpec,
)
from rths_cli.case.storey_law_schema import KINDS as LAWS
from rths_cli.case.structure_schema import StructureSpec
from rths_cli.case.study_schema import DISTRIBUTIONS, FolderAxis, ListAxis, RangeAxis, StudyKeys
from rths_cli.control.compensator import definition_of

Schema = Mapping[str, Any]
Row = tuple[str, str, str, str]
WORD_OF_TYPE = {
    "number": "number", "integer": "whole", "string": "text", "boolean": "true or false", "object": "mapping",
}  # fmt: skip
LONGEST_TEXT = 60  # characters: a longer limit of a text is no limit that a user meets
FILES = {
    "case": (
        "Case files",
        "The keys of a case. `structure`, `damping`, `record`, `controller`, `table` and `reference` take a name, "
        "which is looked up, or a mapping with the keys below; `extends: NAME` varies what has that name. "
        "`--set KEY=VALUE` takes the same keys. [Rig files](rig.md) has the keys of `table`.",
    ),
    "law": (
        "Laws of storeys",
        "The keys of a law, by its `kind`: in `numerical.law` of a structure file, or in `physics.specimen_laws` of a "
        "virtual rig. [Storeys that are not linear](../background/storey_laws.md) has the equations.",
    ),
    "rig": (
        "Rig files",
        "The keys of a table's file, by its `kind`; `extends: NAME` varies another rig. [Rigs](rigs.md) explains the "
        "kinds; `configs/rigs/` has a commented example of each. Kinds other than `virtual` are real rigs. "
        "`channels[kind]` is an entry of `channels` with a key `kind`. A *drawn* value is one number, a list with a "
        "number for each channel, floor or storey, or a normal distribution `{mean: , std: }`, from which each "
        "laboratory draws.",
    ),
    "study": (
        "Study files",
        "The keys of a study, for `rths sweep STUDY.yaml`. `axes.KEY` is a dotted key of the [case](case.md) with "
        "one of the kinds of values below; a bare list stands for `values`. Values of all distributions are drawn "
        "together, `samples.count` of them. Every combination of these with the other axes is a row, unless a "
        "constraint leaves it out. Names and relative paths start at the study's folder. "
        "[Run a sweep](../howto/sweep.md#study-files) has an example.",
    ),
}
HOW_TO_READ = (
    "This page is made by `python tests/helpers/docs_reference.py` from the models that check the files. Behind a key "
    "stand what it takes and its default, **required** where it must be stated; a key without them takes a mapping. "
    "The unit of a number is the ending of its key. `(0, 1]` is a number above 0 and up to 1; `[0,` has no upper "
    "limit. *As* another key: its meaning is told there."
)
LONGEST_REPEATED = 3  # words: a longer meaning is told at its first key
READ_LIKE_CASES = "[Case files](case.md) says how the entries are to be read."
RIGS: dict[str, type[BaseModel]] = {
    "virtual": VirtualRigSpec,
    "udp": UdpRigSpec,
    "udp_plain": UdpPlainRigSpec,
    "target": TargetRigSpec,
    "ni": NiRigSpec,
    "of a package": PluginRigSpec,
}
REAL = ("`udp`", "`udp_plain`", "`target`", "`ni`", "of a package")


def case_page() -> str:
    """Return the page of case files, with the structure and reference files that a case names."""
    tables = [
        ("The case", _rows(CaseKeys, "", skip=("structure", "table", "reference"))),
        ("`controller` that is a compensator", [*list(_rows(CompensatorSpec, "controller."))[1:], *_option_rows()]),
        (
            "`structure`, and a structure file",
            _once(_rows(StructureSpec, "structure.", skip=("structure.numerical.law",))),
        ),
        ("`reference`, and a reference file", _rows(ReferenceSpec, "reference.")),
    ]
    return _page("case", tables)


def _once(rows: Iterable[Row]) -> list[Row]:
    """Return rows with one for each key: storeys and a program have keys of the same name."""
    found: dict[str, Row] = {}
    for row in rows:
        first = found.get(row[0])
        found[row[0]] = row if first is None else (*first[:3], f"{first[3]}; with a kind: {row[3]}")
    return list(found.values())


def _option_rows() -> Iterator[Row]:
    """Yield a row per set of compensators of rths that have the same options, all of these in it."""
    kinds: dict[str, list[str]] = {}
    for kind in built_in_compensators():
        for name, option in definition_of(kind).options.items():
            default = "" if option.default is None else f", default {option.default:g}"
            told = f"`{name}` number [{option.least:g}, {option.most:g}]{default}: {option.what}"
            kinds.setdefault(told, []).append(f"`{kind}`")
    for held, options in groupby(sorted(kinds, key=lambda told: kinds[told]), key=lambda told: kinds[told]):
        yield f"kind {', '.join(held)}", "", "", "; ".join(options)


def law_page() -> str:
    """Return the page of the laws of storeys, a section per kind."""
    return _page("law", [(f"Kind `{kind}`", _rows(model, "")) for kind, model in LAWS.items()])


def rig_page() -> str:
    """Return the page of rig files: the keys of every kind, then a section per kind."""
    laws = ("physics.specimen_laws",)
    virtual, *real = (list(_rows(model, "", skip=laws)) for model in RIGS.values())
    virtual = [(row[0].replace("`channels[].", "`channels[kind]."), *row[1:]) for row in virtual]
    of_real = [row for row in real[0] if all(row in rows for rows in real[1:])]
    every = [(one, other) for one in virtual for other in of_real if _but_for_default(one) == _but_for_default(other)]
    shared = [_with_both_defaults(one, other) for one, other in every]
    tables = [
        ("Every kind", shared),
        ("Kind `virtual`", [row for row in virtual if row not in [one for one, _ in every]]),
        ("Every real rig", [row for row in of_real if row not in [other for _, other in every]]),
        *((f"Kind {name}", [row for row in rows if row not in of_real]) for name, rows in zip(REAL, real, strict=True)),
    ]
    return _page("rig", tables)


def _but_for_default(row: Row) -> tuple[str, str, str]:
    return row[0], row[1], row[3]


def _with_both_defaults(virtual: Row, real: Row) -> Row:
    if virtual == real:
        return virtual
    defaults = (("virtual", virtual[2].removeprefix("default ")), ("real", real[2].removeprefix("default ")))
    told = ", ".join(f"{name} {default}" for name, default in defaults if default)
    return virtual[0], virtual[1], told, virtual[3]


def study_page() -> str:
    """Return the page of study files, a section per kind of axis."""
    tables = [("The study", list(_rows(StudyKeys, "")))]
    tables += [
        ("An axis with a list", list(_rows(ListAxis, "axes.KEY."))),
        ("An axis with a range", list(_rows(RangeAxis, "axes.KEY."))),
        ("An axis with a folder of records", list(_rows(FolderAxis, "axes.KEY."))),
    ]
    tables += [
        (f"An axis with distribution `{name}`", _rows(kind, "axes.KEY.")) for name, kind in DISTRIBUTIONS.items()
    ]
    return _page("study", tables)


def _page(name: str, tables: list[tuple[str, Iterable[Row]]]) -> str:
    title, about = FILES[name]
    parts = [f"# {title}", about, HOW_TO_READ if name == "case" else READ_LIKE_CASES]
    first: dict[str, str] = {}
    for heading, rows in tables:
        parts += [f"## {heading}", "\n".join(_line(_told_once(row, first)) for row in rows)]
    return "\n\n".join(parts) + "\n"


def _told_once(row: Row, first: dict[str, str]) -> Row:
    """Return a row that names the first key of the page with its meaning, where that has been told."""
    key, value, default, meaning = row
    earlier = first.get(meaning, "")
    first.setdefault(meaning, key)
    if not earlier or len(meaning.split()) <= LONGEST_REPEATED:
        return row
    return key, value, default, "as above" if earlier == key else f"as {earlier}"


def _line(row: Row) -> str:
    """Return the entry of a key: its value, its default where it has one, its meaning."""
    key, value, default, meaning = row
    told = ", ".join(filter(None, ("" if value == "mapping" else value, default)))
    return f"- {key}{f' {told}' if told else ''}: {meaning}"


def _rows(model: type[BaseModel], prefix: str, skip: tuple[str, ...] = ()) -> Iterator[Row]:
    """Yield a row per key of a model and of the models in it, depth first; below `skip` nothing is told."""
    schema = TypeAdapter(model).json_schema()
    yield from _model_rows(schema, schema.get("$defs", {}), prefix, skip)


def _model_rows(schema: Schema, definitions: Schema, prefix: str, skip: tuple[str, ...] = ()) -> Iterator[Row]:
    for key, field in schema["properties"].items():
        path = f"{prefix}{key}"
        required = key in schema.get("required", ()) and path not in ("name", "table")
        default = "**required**" if required else _default(field)
        yield f"`{path}`", _type(field, definitions), default, _meaning(field)
        if path not in skip:
            yield from _below(field, definitions, path, skip)


def _below(field: Schema, definitions: Schema, path: str, skip: tuple[str, ...]) -> Iterator[Row]:
    """Yield the rows of the models that a field holds."""
    inner = {"items": "[].", "additionalProperties": ".NAME."}
    for part in field.get("anyOf", [field]):
        if "$ref" in part and not part["$ref"].endswith(f"/{CompensatorSpec.__name__}"):  # a section of its own
            yield from _model_rows(_resolved(part, definitions), definitions, f"{path}.", skip)
        for key, mark in inner.items():
            held = part.get(key)
            if not isinstance(held, Mapping):
                continue
            either = held.get("anyOf", [held]) if key == "items" else [held]
            models = [one for one in either if "$ref" in one]
            for i, one in enumerate(models):  # a further kind of entry is told by its key `kind`
                where = f"{path}{mark}" if i == 0 else f"{path}[kind]."
                yield from _model_rows(_resolved(one, definitions), definitions, where, skip)


def _resolved(part: Schema, definitions: Schema) -> Schema:
    found: Schema = definitions[part["$ref"].rpartition("/")[2]]
    return found


def _type(field: Schema, definitions: Schema) -> str:
    """Return what a field takes, in words."""
    parts = [part for part in field.get("anyOf", field.get("oneOf", [field])) if part.get("type") != "null"]
    kinds = list(dict.fromkeys(_one_type(part, definitions) for part in parts))
    number, *others = kinds
    if len(kinds) == 3 and others[0].startswith("list of ") and others[1] == "mapping":
        return f"drawn {number}"
    return " or ".join(one for one in kinds if not any(other.startswith(f"{one}, ") for other in kinds))


def _one_type(part: Schema, definitions: Schema) -> str:
    if "anyOf" in part or "oneOf" in part:
        return _type(part, definitions)
    if "const" in part or "enum" in part:
        values = [f"{one}".lower() if isinstance(one, bool) else one for one in part.get("enum", [part.get("const")])]
        return f"{values[0]}" if values == [0] else ", ".join(f"`{value}`" for value in values)
    if "$ref" in part:
        return "mapping"
    if part.get("type") == "array":
        return ", ".join(filter(None, [f"list of {_type(part.get('items', {}), definitions)}", _counts(part)]))
    if part.get("format") == "path":
        return "file"
    if part.get("maxLength", LONGEST_TEXT) < LONGEST_TEXT:
        return f"text of up to {part['maxLength']} characters"
    inner = part.get("additionalProperties")
    if isinstance(inner, Mapping):
        return f"mapping of names to {_type(inner, definitions)}"
    if "type" not in part:
        return "anything"
    word, interval = WORD_OF_TYPE[part["type"]], _interval(part)
    return interval if word == "number" and interval else f"{word} {interval}".rstrip()


def _interval(part: Schema) -> str:
    """Return the range of a number, "" where there is none."""
    low, high = part.get("minimum", part.get("exclusiveMinimum")), part.get("maximum", part.get("exclusiveMaximum"))
    if low is None and high is None:
        return ""
    begin = "" if low is None else f"{'[' if 'minimum' in part else '('}{_number(low)},"
    end = "" if high is None else f"{_number(high)}{']' if 'maximum' in part else ')'}"
    return f"{begin} {end}".strip()


def _counts(part: Schema) -> str:
    """Return how many entries a list may have."""
    least, most = part.get("minItems"), part.get("maxItems")
    if least == most:
        return f"{least} entries" if least else ""
    return " to ".join(str(number) for number in (least, most) if number) + (" entries" if most else " or more entries")


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


def _default(field: Schema) -> str:
    value = field.get("default", PydanticUndefined)
    if value is None or value is PydanticUndefined or isinstance(value, dict) or value in ("", "inline"):
        return ""
    if isinstance(value, bool):
        return f"default `{str(value).lower()}`"
    return f"default `{value:g}`" if isinstance(value, float) else f"default `{value}`".replace("'", "")


def _meaning(field: Schema) -> str:
    """Return what a key means, as its model says."""
    return str(field.get("description", "")).replace("\n", " ")
