"""Every example of the gallery has its file, its one command and its picture; the files are read."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from rths_cli.case.load import load_cases
from rths_cli.studies.study_plan import Asked, read_plan

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "gallery.md"
SECTIONS = re.split(r"^## ", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.splitlines()[0])
def test_an_example_has_file_command_and_picture(section: str) -> None:
    (picture,) = re.findall(r"^!\[[^]]+\]\((images/[\w-]+\.svg)\)$", section, re.MULTILINE)
    assert (PAGE.parent / picture).stat().st_size < 700_000
    (command,) = re.findall(r"^```sh\n(rths [^\n]+)\n```$", section, re.MULTILINE)
    words = shlex.split(command)
    (named, *_) = re.findall(r"\]\(\.\./([\w/.]+)\)", section)
    assert (ROOT / named).exists()
    if words[1] == "run":
        assert load_cases([ROOT / words[2] if "/" in words[2] else words[2]])[0].runs
    if words[1] == "sweep":
        assert read_plan(Asked(str(ROOT / words[2]), (), (), None)).plan.points >= 8
