"""Generate the JSON Schemas of all files a user writes (`configs/*.schema.json`)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from rths_cli.case.benchmark_schema import BenchmarkSpec, TableBenchmarkSpec
from rths_cli.case.case_schema import CaseKeys, ReferenceSpec, StructureSpec
from rths_cli.case.compensator_schema import built_in_compensators
from rths_cli.case.rig_schema import KINDS, AnyRig, PluginRigSpec, RigSpec, VirtualActuatorSpec, VirtualRigSpec
from rths_cli.case.study_schema import StudyKeys

MODELS: dict[str, Any] = {
    "case": CaseKeys,
    "structure": StructureSpec,
    "rig": AnyRig,
    "reference": ReferenceSpec,
    "study": StudyKeys,
    "benchmark": BenchmarkSpec | TableBenchmarkSpec,
}
EXTENDS = {"type": "object", "required": ["extends"]}
EXTENDS_CASE = "the case, a name or a path, whose keys hold where this one states none; it lends no name"
NAME = {"type": "string", "minLength": 1, "description": "a name or a path"}


def schema(kind: str = "case") -> dict[str, Any]:
    """Return the JSON Schema of a case file, or of a structure, rig, reference, study or benchmark file."""
    generated = TypeAdapter(MODELS[kind]).json_schema()
    definitions = generated.pop("$defs")
    rigs: list[type[RigSpec]] = [*KINDS.values(), VirtualActuatorSpec, PluginRigSpec]
    for rig in rigs:
        if rig.__name__ in definitions:
            _allow_name(definitions[rig.__name__]["properties"], "calibration")
    if kind == "case":
        _allow_names(generated, definitions)
        generated = _with_other_case(generated)
    elif kind == "structure":
        generated = _with_extends(generated, definitions)
    elif kind == "rig":
        generated = _any_rig(definitions)
    elif kind == "study":
        bare_list = {"type": "array", "minItems": 1}
        generated["properties"]["axes"]["additionalProperties"]["anyOf"].insert(0, bare_list)
        generated["properties"]["seeds"]["anyOf"].insert(0, {"type": "integer", "minimum": 1})
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"rths {kind} file"}
    return {**generated, **head, "$defs": definitions}


def write_schemas(folder: Path) -> None:
    """Write `KIND.schema.json` of every kind into a folder (the source tree's configs/)."""
    for kind in MODELS:
        (folder / f"{kind}.schema.json").write_text(json.dumps(schema(kind), indent=1) + "\n", encoding="utf-8")


def _allow_name(properties: dict[str, Any], key: str) -> None:
    """Let a name stand for the mapping at a key."""
    told = properties[key].pop("description")
    readings = [NAME, *properties[key].get("anyOf", [properties[key]])]
    properties[key] = {"anyOf": readings, "description": told}


def _allow_names(case: dict[str, Any], definitions: dict[str, Any]) -> None:
    """Let names stand for mappings in the schema of a case, and drop what the loader fills in from `required`."""
    properties = case["properties"]
    kinds = definitions["ControllerSpec"]["properties"]["kind"]
    readings: dict[str, list[Any]] = {
        "structure": [NAME, _with_extends(definitions["StructureSpec"], definitions)],
        "table": [NAME, _any_rig(definitions)],
        "controller": [kinds, {"enum": list(built_in_compensators())}, *properties["controller"]["anyOf"]],
    }
    for key in ("damping", "record", "reference"):
        _allow_name(properties, key)
    for key, either in readings.items():
        told = properties[key].pop("description")
        properties[key] = {"anyOf": either, "description": told}
    case["required"] = [key for key in case["required"] if key not in ("name", "table")]


def _with_other_case(case: dict[str, Any]) -> dict[str, Any]:
    """Let a case extend another one: it then requires no key."""
    required = case.pop("required")
    case["properties"] = {"extends": {**NAME, "description": EXTENDS_CASE}, **case["properties"]}
    return {**case, "if": EXTENDS, "else": {"required": required}}


def _any_rig(definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a rig of any kind: which one is read is decided by `kind`, the last is a plug-in's.

    A variation of a named rig seldom states its kind: every key of every kind may stand in it.
    """
    whole: dict[str, Any] = {"$ref": f"#/$defs/{PluginRigSpec.__name__}"}
    for kind, model in reversed(list(KINDS.items())):
        of_kind = {"properties": {"kind": {"const": kind}}, "required": ["kind"]}
        then: dict[str, Any] = {"$ref": f"#/$defs/{model.__name__}"}
        if model is VirtualRigSpec:
            actuator = {"$ref": f"#/$defs/{VirtualActuatorSpec.__name__}"}
            then = {"if": {"required": ["interface"]}, "then": actuator, "else": then}
        whole = {"if": of_kind, "then": then, "else": whole}
    return {"if": EXTENDS, "then": _any_varied(definitions), "else": whole}


def _any_varied(definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a variation of a rig of any kind: each key as one of the kinds reads it."""
    models: list[type[RigSpec]] = [*KINDS.values(), VirtualActuatorSpec, PluginRigSpec]
    kinds = [_varied(definitions[model.__name__], definitions) for model in models]
    readings: dict[str, list[Any]] = {}
    for kind in kinds:
        for key, reading in kind["properties"].items():
            known = readings.setdefault(key, [])
            known += [] if reading in known else [reading]
    properties = {key: known[0] if len(known) == 1 else {"anyOf": known} for key, known in readings.items()}
    return {**kinds[0], "title": "RigSpec", "description": "A variation of a named rig.", "properties": properties}


def _with_extends(whole: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a complete mapping, or with `extends` of the variation of a named one."""
    return {"if": EXTENDS, "then": _varied(whole, definitions), "else": whole}


def _varied(whole: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a variation: nothing is required, and `extends` may stand in it."""
    varied: dict[str, Any] = _relaxed(whole, definitions)
    varied["properties"]["extends"] = NAME
    return varied


def _relaxed(part: Any, definitions: dict[str, Any]) -> Any:
    """Return a schema with references written out and nothing required any more."""
    if isinstance(part, list):
        return [_relaxed(entry, definitions) for entry in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        whole = _relaxed(definitions[part["$ref"].rpartition("/")[2]], definitions)
        return whole | ({"description": part["description"]} if "description" in part else {})
    dropped = ("required", "allOf") if "properties" in part else ()
    return {key: _relaxed(value, definitions) for key, value in part.items() if key not in dropped}
