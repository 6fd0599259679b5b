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
    properties = generated["properties"]
    if kind == "case":
        for key in ("structure", "table"):
            properties[key] = {"anyOf": [NAME, _with_extends(key, generated)]}
        for key in ("damping", "record", "controller", "reference"):
            properties[key] = {"anyOf": [_short_form(key, generated), *_forms(properties[key])]}
        generated["required"] = [key for key in generated["required"] if key not in ("name", "table")]
    elif kind in ("structure", "rig"):
        properties["extends"] = NAME
        del generated["required"]
        generated["anyOf"] = [{"required": ["extends"]}, {"required": _required(MODELS[kind])}]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **generated,
        "title": f"rths {kind} file",
    }


def write_schemas(folder: Path) -> None:
    """Write `KIND.schema.json` of every kind into a folder (the source tree's configs/)."""
    for kind in MODELS:
        (folder / f"{kind}.schema.json").write_text(
            json.dumps(schema(kind), indent=1) + "\n", encoding="utf-8"
        )


def _required(model: type[BaseModel]) -> list[str]:
    return [name for name, field in model.model_fields.items() if field.is_required()]


def _short_form(key: str, generated: dict[str, Any]) -> dict[str, Any]:
    """Return what may stand for a mapping: a name, or the kind of a controller."""
    return dict(generated["$defs"]["ControllerSpec"]["properties"]["kind"]) if key == "controller" else NAME


def _forms(property_schema: dict[str, Any]) -> list[dict[str, Any]]:
    return list(property_schema.get("anyOf", [property_schema]))


def _with_extends(key: str, generated: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of an inline structure or table: complete, or the variation of a named one."""
    name = {"structure": "StructureSpec", "table": "RigSpec"}[key]
    whole = {"$ref": f"#/$defs/{name}"}
    varied = _relaxed(generated["$defs"][name], generated["$defs"])
    varied["properties"]["extends"] = NAME
    return {"if": {"required": ["extends"]}, "then": {**varied, "required": ["extends"]}, "else": whole}


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
