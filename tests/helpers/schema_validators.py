"""A validator of each JSON Schema, made once per test process: generating and checking one takes a second."""

from __future__ import annotations

from functools import cache

from jsonschema import Draft202012Validator

from rths_cli.case.json_schema import schema


@cache
def validator(kind: str = "case") -> Draft202012Validator:
    """Return the validator of a kind of file; raises SchemaError where its schema is none."""
    made = schema(kind)
    Draft202012Validator.check_schema(made)
    return Draft202012Validator(made)
