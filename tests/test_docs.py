"""What README and docs tell a user to type exists; the files they show are read."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from rths_cli.cli import cli
from rths_cli.files.foreign_models import read_foreign

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def blocks(page: Path, kind: str = "") -> list[str]:
    """Return the fenced blocks of a page, of a kind."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [text for of_kind, text in found if of_kind == kind]


def commands(page: Path) -> list[list[str]]:
    """Return the words of every line that starts with rths, continuation lines joined, comments dropped."""
    lines = "\n".join(blocks(page) + blocks(page, "sh")).replace("\\\n", " ").splitlines()
    return [shlex.split(line.removeprefix("$ "), comments=True) for line in lines if re.match(r"(\$ )?rths ", line)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_options_exist(page: Path) -> None:
    found = commands(page)
    assert found or page.name != "identify.md"
    for _, name, *words in found:
        command = cli.commands[name]
        known = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known, (page.name, name, words)


def links(page: Path) -> list[Path]:
    """Return the files that a page links to."""
    targets = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    return [(page.parent / target).resolve() for target in targets]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    assert [target for target in links(page) if not target.exists()] == []


def slugs(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    heads = re.findall(r"^#+ (.*)$", re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.S | re.M), re.M)
    return {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_anchor_is_a_heading(page: Path) -> None:
    found = re.findall(r"\]\((?!https?:)([^)#]*)#([^)]*)\)", page.read_text(encoding="utf-8"))
    wrong = [(to, at) for to, at in found if at not in slugs((page.parent / to).resolve() if to else page)]
    assert wrong == []


def test_every_page_is_reached_from_the_index() -> None:
    index = DOCS / "index.md"
    assert index in links(ROOT / "README.md")
    reached, waiting = {index}, [index]
    while waiting:
        new = {page for page in links(waiting.pop()) if page.suffix == ".md"} - reached
        reached |= new
        waiting += new
    assert set(PAGES) <= reached


def test_every_page_stands_in_a_section() -> None:
    sections = {"tutorial", "howto", "reference", "background", "decisions"}
    assert {page.name for page in DOCS.iterdir() if page.is_dir()} == sections | {"images"}
    flat = {page.name for page in DOCS.glob("*.md")}
    assert flat <= {"index.md", "changelog.md", "contributing.md", "gallery.md", "security.md"}


def test_every_picture_is_shown_on_a_page() -> None:
    told = "".join(page.read_text(encoding="utf-8") for page in [*PAGES, DOCS.parent / "README.md"])
    pictures = [picture.name for picture in (DOCS / "images").iterdir()]
    assert pictures and all(f"images/{name})" in told for name in pictures)


def test_every_page_begins_with_what_it_is_for() -> None:
    """A heading, then a sentence: no page begins with a table, a list or another heading."""
    for page in PAGES:
        head, empty, first = page.read_text(encoding="utf-8").splitlines()[:3]
        assert head.startswith("# ") and empty == "" and first[0] not in "#|-<!", page


def test_every_module_that_is_named_exists() -> None:
    named = {(page, path) for page in PAGES for path in re.findall(r"`(rths_cli/[\w/.]+)`", page.read_text("utf-8"))}
    assert len(named) > 10
    assert [path for _, path in named if not (ROOT / path).exists()] == []


def test_every_option_of_identify_is_told_in_its_page() -> None:
    text = (DOCS / "howto" / "identify.md").read_text()
    options = [p for p in cli.commands["identify"].params if isinstance(p, click.Option)]
    assert [p.opts[0] for p in options if p.opts[0] not in text] == []


def test_the_model_shown_is_read(tmp_path: Path) -> None:
    shown = [block for block in blocks(DOCS / "howto" / "identify.md", "yaml") if "zeros:" in block]
    assert len(shown) == 1
    path = tmp_path / "model.yaml"
    path.write_text(shown[0])
    model = read_foreign(path)
    assert (len(model.zeros), len(model.poles), model.delay_s) == (6, 7, 0.00075)
