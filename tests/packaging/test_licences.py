"""What users install is under licences that let them use it: the page says all of it, and metadata agree."""

from __future__ import annotations

import re
from importlib import metadata
from pathlib import Path

import pytest
from docs_licences import LICENCES, SOMETIMES, declared, families, installed_requirements, stated_by_itself

ROOT = Path(__file__).parents[2]
COPYLEFT = {"GPL", "AGPL"}
JUDGED = {"nptdms": "LGPL", "obspy": "LGPL"}  # optional, and judged on the page


def is_installed(name: str) -> bool:
    return bool([*metadata.distributions(name=name)])


def test_the_page_is_complete() -> None:
    page = (ROOT / "docs" / "reference" / "licences.md").read_text(encoding="utf-8")
    lines = re.findall(r"^- ([^:]+): (`.*)$", page, re.MULTILINE)
    told = {name: licence for licence, names in lines for name in re.findall("`([^`]+)`", names)}
    asked = {name for names in declared().values() for name in names}
    required = installed_requirements()
    assert asked | required <= set(told) and told == LICENCES
    assert set(told) - asked - required <= set(SOMETIMES)


def test_nothing_required_is_under_the_gpl_or_agpl() -> None:
    for name in sorted(installed_requirements()):
        found = families(stated_by_itself(name))
        assert found and not found & (COPYLEFT | {"LGPL"}), (name, found)
    stated = {name: families(licence) for name, licence in LICENCES.items()}
    assert {name for name, found in stated.items() if found & (COPYLEFT | {"LGPL"})} == set(JUDGED)


@pytest.mark.parametrize("name", [name for name in LICENCES if is_installed(name)])
def test_the_stated_licence_is_the_packages_own(name: str) -> None:
    told, own = families(LICENCES[name]), families(stated_by_itself(name))
    assert told & own and not own & COPYLEFT, (told, own)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("GPL-3.0-or-later", {"GPL"}), ("AGPL-3.0", {"AGPL"}), ("LGPL-3.0-only", {"LGPL"}),
        ("License :: OSI Approved :: GNU General Public License v3 (GPLv3)", {"GPL"}),
        ("License :: OSI Approved :: GNU Lesser General Public License v3 (LGPLv3)", {"LGPL"}),
        ("License :: OSI Approved :: GNU Affero General Public License v3", {"AGPL"}),
        ("Apache-2.0 OR BSD-2-Clause", {"Apache", "BSD"}), ("MIT", {"MIT"}),
    ],
)  # fmt: skip
def test_licences_are_told_apart(text: str, found: set[str]) -> None:
    assert families(text) == found
