"""What the package reads or writes by a literal path or attribute is declared: a misspelt one would never be found."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

import rths_cli
from rths_cli.case.case_schema import CaseKeys
from rths_cli.quantities import ATTRIBUTES, AXES, METRICS, stored_dataset
from rths_cli.quantities.attributes import OF_BLOCK
from rths_cli.quantities.metrics import GROUPS
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES
from rths_cli.quantities.sweep_datasets import SWEEP_ATTRIBUTES

PACKAGE = Path(rths_cli.__file__).parent
METRIC = re.compile(rf"(?:{'|'.join(GROUPS)})\.[a-z_0-9]+")
DATASET = re.compile(r"(?:record|sim|sim_delay|shake_table|exp_rths|identification|case)(?:/[a-z_0-9]+)+")
ATTRIBUTE = re.compile(r'\.attributes(?:\.get\(|\[)"(\w+)"')


@cache
def texts() -> frozenset[str]:
    """Return every text in the package's code."""
    trees = (ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py"))
    nodes = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant))
    return frozenset(node.value for node in nodes if isinstance(node.value, str))


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models_in(part)


def keys_of_cases() -> set[str]:
    """Return the keys of the second level of a case, some of whose groups are named like those of metrics."""
    fields = CaseKeys.model_fields.items()
    return {
        f"{name}.{key}" for name, field in fields for one in models_in(field.annotation) for key in one.model_fields
    }


@pytest.mark.campaign
def test_every_path_of_a_metric_is_declared_or_begins_one_that_is() -> None:
    named = {text for text in texts() if METRIC.fullmatch(text)} - keys_of_cases()
    assert len(named) > 50
    assert [text for text in named if not any(path.startswith(text) for path in METRICS)] == []


def test_every_path_of_a_dataset_is_declared() -> None:
    named = {text for text in texts() if DATASET.fullmatch(text)}
    known = {text for text in named if stored_dataset(text) or text.rpartition("/")[2] in AXES}
    complex_parts = {text for text in named if stored_dataset(f"{text}_real")}
    assert len(named) > 10 and named - known - complex_parts == set()


def test_every_attribute_that_is_read_is_declared() -> None:
    named = {name for path in PACKAGE.rglob("*.py") for name in ATTRIBUTE.findall(path.read_text(encoding="utf-8"))}
    declared = {*ATTRIBUTES, *SWEEP_ATTRIBUTES, *MODEL_ATTRIBUTES, *(one.name for one in OF_BLOCK)}
    assert len(named) > 15 and named - declared == set()
