"""The template loads as it is, and so does every line one may uncomment."""

from __future__ import annotations

import re

import pytest

from rths_cli.case.case_schema import CaseKeys
from rths_cli.case.load import load_cases
from rths_cli.case.template import case_template

OPTIONAL = [line for line in case_template().splitlines() if re.match(r"# [a-z_]+: ", line)]


def test_the_template_is_the_default_case(write) -> None:
    (case,) = load_cases([write(text=case_template())])
    (bare,) = load_cases([write()])
    assert case.model_dump(exclude={"yaml_text"}) == bare.model_dump(exclude={"yaml_text"})


@pytest.mark.parametrize("line", OPTIONAL, ids=lambda line: line.split()[1])
def test_each_option_loads_when_its_mark_is_removed(write, line: str) -> None:
    path = write(text=case_template().replace(line, line[2:]))
    (case,) = load_cases([path])
    assert line[2:] in case.yaml_text


def test_every_key_of_a_case_is_in_the_template() -> None:
    keys = set(re.findall(r"^(?:# )?([a-z_]+): ", case_template(), re.MULTILINE))
    assert keys == set(CaseKeys.model_fields) - {"name"}
