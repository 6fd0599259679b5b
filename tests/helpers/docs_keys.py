"""The reference pages of case and rig files, from the models that check them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from pydantic import BaseModel, TypeAdapter
from pydantic_core import PydanticUndefined

from rths_cli.case.case_schema import CaseKeys
from rths_cli.case.reference_schema import ReferenceSpec
from rths_cli.case.rig_schema import NiRigSpec, PluginRigSpec, UdpRigSpec, VirtualRigSpec
from rths_cli.case.storey_law_schema import KINDS as LAWS
from rths_cli.case.structure_schema import StructureSpec
from rths_cli.case.study_schema import DISTRIBUTIONS, FolderAxis, ListAxis, RangeAxis, StudyKeys
from rths_cli.quantities.units import unit_of_name

Schema = Mapping[str, Any]
COLUMNS = ("key", "type", "unit", "default", "limits", "meaning")
WORD_OF_TYPE = {
    "number": "number", "integer": "whole number", "string": "text", "boolean": "true or false", "object": "mapping",
}  # fmt: skip
LIMITS = (("exclusiveMinimum", "> "), ("minimum", ">= "), ("exclusiveMaximum", "< "), ("maximum", "<= "))
FILES = {
    "case": (
        "Case files",
        "What a case may state. A value of `structure`, `damping`, `record`, `controller`, `table` and `reference` is "
        "a name that is looked up, or a mapping as below; `extends: NAME` varies what has that name. `--set KEY=VALUE` "
        "takes the same keys. The keys of `table` are those of [rig files](rig.md).",
    ),
    "law": (
        "Laws of storeys",
        "What a law in `numerical.law` of a structure file, or in `physics.specimen_laws` of a virtual rig, "
        "may state, by its `kind`. "
        "[Storeys that are not linear](../background/storey_laws.md) has the equations.",
    ),
    "rig": (
        "Rig files",
        "What the file of a table may state, by its `kind`; `extends: NAME` varies another rig. "
        "[Rigs](rigs.md) explains the kinds; `configs/rigs/` has a commented example of each.",
    ),
    "study": (
        "Study files",
        "What a study may state, for `rths sweep STUDY.yaml`. `axes.KEY` is a dotted key of the [case](case.md) with "
        "one of the kinds of values below; a bare list stands for `values`. Values of all distributions are drawn "
        "together, `samples.count` of them, and every combination of these with the other axes is a row, unless a "
        "constraint leaves it out. Names and relative paths start at the study's folder. "
        "[Run a sweep](../howto/sweep.md#study-files) has an example.",
    ),
}
RIGS: dict[str, type[BaseModel]] = {
    "virtual": VirtualRigSpec,
    "udp": UdpRigSpec,
    "ni": NiRigSpec,
    "of a package": PluginRigSpec,
}


def case_page() -> str:
    """Return the page of case files, with the structure and reference files that a case names."""
    tables = [
        ("The case", _rows(CaseKeys, "", skip=("structure", "table", "reference"))),
        ("`structure`, and a structure file", _rows(StructureSpec, "structure.", skip=("structure.numerical.law",))),
        ("`reference`, and a reference file", _rows(ReferenceSpec, "reference.")),
    ]
    return _page("case", tables)


def law_page() -> str:
    """Return the page of the laws of storeys, a section per kind."""
    return _page("law", [(f"Kind `{kind}`", _rows(model, "")) for kind, model in LAWS.items()])


def rig_page() -> str:
    """Return the page of rig files, a section per kind."""
    laws = ("physics.specimen_laws",)
    virtual, *real = (list(_rows(model, "", skip=laws)) for model in RIGS.values())
    shared = [row for row in real[0] if all(row in rows for rows in real[1:])]
    own = [[row for row in rows if row not in shared] for rows in real]
    headings = ("Kind `virtual`", "Every other kind", "Kind `udp`", "Kind `ni`", "Kind of a package")
    return _page("rig", list(zip(headings, (virtual, shared, *own), strict=True)))


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


def _page(name: str, tables: list[tuple[str, Iterable[tuple[str, ...]]]]) -> str:
    title, about = FILES[name]
    made = "Made from the models that check these files by `python tests/helpers/docs_reference.py`; a test compares."
    unit = "`-` in *default*: nothing, or what the meaning says; **required**: must be stated."
    parts = [f"# {title}", made, about, unit]
    for heading, rows in tables:
        lines = [f"| {' | '.join(cells)} |" for cells in (COLUMNS, ("---",) * len(COLUMNS), *rows)]
        parts += [f"## {heading}", "\n".join(lines)]
    return "\n\n".join(parts) + "\n"


def _rows(model: type[BaseModel], prefix: str, skip: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield a row per key of a model and of the models in it, depth first; below `skip` nothing is told."""
    schema = TypeAdapter(model).json_schema()
    yield from _model_rows(schema, schema.get("$defs", {}), prefix, skip)


def _model_rows(
    schema: Schema, definitions: Schema, prefix: str, skip: tuple[str, ...] = ()
) -> Iterator[tuple[str, ...]]:
    for key, field in schema["properties"].items():
        path = f"{prefix}{key}"
        required = key in schema.get("required", ()) and path not in ("name", "table")
        default = "**required**" if required else _default(field)
        kind, limits = _type(field, definitions)
        yield f"`{path}`", kind, unit_of_name(key, "-"), default, limits, _meaning(field)
        if path not in skip:
            yield from _below(field, definitions, path, skip)


def _below(field: Schema, definitions: Schema, path: str, skip: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the models that a field holds."""
    inner = {"items": "[].", "additionalProperties": ".NAME."}
    for part in field.get("anyOf", [field]):
        if "$ref" in part:
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


def _type(field: Schema, definitions: Schema) -> tuple[str, str]:
    """Return the type of a field in words, and its limits."""
    parts = [part for part in field.get("anyOf", field.get("oneOf", [field])) if part.get("type") != "null"]
    told = [_one_type(part, definitions) for part in parts]
    kinds, limits = (list(dict.fromkeys(entry for entry in column if entry)) for column in zip(*told, strict=True))
    once = [one for one in limits if not any(other.startswith(f"{one}; ") for other in limits)]  # of a list, too
    return " or ".join(kinds), " or ".join(once)


def _one_type(part: Schema, definitions: Schema) -> tuple[str, str]:
    if "anyOf" in part or "oneOf" in part:
        return _type(part, definitions)
    if "const" in part or "enum" in part:
        values = [f"{one}".lower() if isinstance(one, bool) else one for one in part.get("enum", [part.get("const")])]
        return ("", f"{values[0]}") if values == [0] else (", ".join(f"`{value}`" for value in values), "")
    if "$ref" in part:
        return "mapping", ""
    if part.get("type") == "array":
        kind, limits = _type(part.get("items", {}), definitions)
        return f"list of {kind}", "; ".join(filter(None, [limits, _counts(part)]))
    limits = " and ".join(f"{sign}{_number(part[key])}" for key, sign in LIMITS if key in part)
    longest = f"at most {part['maxLength']} characters" if "maxLength" in part else ""
    if part.get("format") == "path":
        return "file", ""
    inner = part.get("additionalProperties")
    if isinstance(inner, Mapping):
        kind, limits = _type(inner, definitions)
        return f"mapping of names to {kind}", limits
    return WORD_OF_TYPE[part["type"]] if "type" in part else "anything", limits or longest


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
    if value is None or value is PydanticUndefined or isinstance(value, dict) or value == "":
        return "-"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`".replace("'", "")


def _meaning(field: Schema) -> str:
    """Return what a key means, as its model says."""
    return str(field.get("description", "")).replace("|", "\\|").replace("\n", " ")
