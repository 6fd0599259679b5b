"""JSON Schema of the files a user writes, for editors; generated from the models that check them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from rths_cli.case.models import CaseKeys, ReferenceSpec, RigSpec, StructureSpec

MODELS: dict[str, type[BaseModel]] = {
    "case": CaseKeys,
    "structure": StructureSpec,
    "rig": RigSpec,
    "reference": ReferenceSpec,
}
NAME = {"type": "string", "minLength": 1, "description": "a name or a path"}


def schema(kind: str = "case") -> dict[str, Any]:
    """Return the JSON Schema of a case file, or of a structure, rig or reference file."""
    generated = MODELS[kind].model_json_schema()
    definitions = generated.pop("$defs")
    if kind == "case":
        _allow_names(generated, definitions)
    elif kind in ("structure", "rig"):
        generated = _with_extends(generated, definitions)
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"rths {kind} file"}
    return {**generated, **head, "$defs": definitions}


def write_schemas(folder: Path) -> None:
    """Write `KIND.schema.json` of every kind into a folder (the source tree's configs/)."""
    for kind in MODELS:
        (folder / f"{kind}.schema.json").write_text(json.dumps(schema(kind), indent=1) + "\n", encoding="utf-8")


def _allow_names(case: dict[str, Any], definitions: dict[str, Any]) -> None:
    """Let names stand for mappings in the schema of a case, and drop what the loader fills in from `required`."""
    properties = case["properties"]
    for key, model in (("structure", "StructureSpec"), ("table", "RigSpec")):
        properties[key] = {"anyOf": [NAME, _with_extends(definitions[model], definitions)]}
    for key in ("damping", "record", "reference"):
        properties[key] = {"anyOf": [NAME, *properties[key].get("anyOf", [properties[key]])]}
    kinds = definitions["ControllerSpec"]["properties"]["kind"]
    properties["controller"] = {"anyOf": [kinds, properties["controller"]]}
    case["required"] = [key for key in case["required"] if key not in ("name", "table")]


def _with_extends(whole: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a complete mapping, or with `extends` of the variation of a named one."""
    varied = _relaxed(whole, definitions)
    varied["properties"]["extends"] = NAME
    return {"if": {"type": "object", "required": ["extends"]}, "then": varied, "else": whole}


def _relaxed(part: Any, definitions: dict[str, Any]) -> Any:
    """Return a schema with references written out and nothing required any more."""
    if isinstance(part, list):
        return [_relaxed(entry, definitions) for entry in part]
    if not isinstance(part, dict):
        return part
    if "$ref" in part:
        return _relaxed(definitions[part["$ref"].rpartition("/")[2]], definitions)
    dropped = ("required", "allOf") if "properties" in part else ()
    return {key: _relaxed(value, definitions) for key, value in part.items() if key not in dropped}
