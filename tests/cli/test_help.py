"""Help: commands by what they are for, each with an example; completion in the shell; the citation."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
import yaml
from click.shell_completion import BashComplete

from rths_cli import __version__
from rths_cli.cli import cli
from rths_cli.cli.command_group import PARTS

ROOT = Path(__file__).parents[2]
CASE_COMMANDS = ("run", "check", "identify", "doctor", "sweep")


def complete(*words: str) -> list[str]:
    """Return what a shell is offered for the last of some words, as `kind,value`."""
    found = BashComplete(cli, {}, "rths", "_RTHS_COMPLETE").get_completions(list(words[:-1]), words[-1])
    return [f"{item.type},{item.value}" for item in found]


def by_the_shell(cwd: Path, **told: str) -> str:
    """Return what the real process gives a shell that asks."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    code = "import sys; sys.argv = ['rths']; from rths_cli.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=cwd, timeout=60, check=False,
        env={**os.environ, **told, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout


def test_every_command_stands_in_one_part() -> None:
    placed = [name for names in PARTS.values() for name in names]
    assert sorted(placed) == sorted(cli.commands)


def test_help_lists_the_commands_by_part_with_their_whole_first_sentence() -> None:
    lines = cli.get_help(click.Context(cli, info_name="rths", max_content_width=100, terminal_width=100)).splitlines()
    heads = [line.strip() for line in lines if line.startswith("  ") and line.endswith(":")]
    assert heads == ["Run:", "Look:", "Prepare:", "Real rigs:"] and "Commands:" in lines
    assert not any(line.endswith("...") for line in lines[1:])
    for part, names in PARTS.items():
        below = lines[lines.index(f"  {part}:") + 1 :]
        section = below[: below.index("")] if "" in below else below
        assert [line.split()[0] for line in section if line[4:5].strip()] == list(names)


def test_a_command_of_another_package_is_listed_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(cli.commands, "extra", click.Command("extra", help="Do more."))
    text = cli.get_help(click.Context(cli, info_name="rths"))
    assert "  Other:\n    extra" in text


@pytest.mark.parametrize("name", sorted(cli.commands))
def test_every_command_has_one_example_whose_words_it_takes(name: str) -> None:
    command = cli.commands[name]
    examples = [line.strip() for line in (command.help or "").splitlines() if line.strip().startswith("Example: ")]
    assert len(examples) == 1
    words = shlex.split(examples[0].removeprefix("Example: ").partition(">")[0])
    assert words[:2] == ["rths", name]
    command.make_context(name, words[2:])  # raises UsageError for what it does not take


def test_the_process_gives_the_shell_its_script_and_names(tmp_path: Path) -> None:
    assert "_RTHS_COMPLETE=bash_complete" in by_the_shell(tmp_path, _RTHS_COMPLETE="bash_source")
    asked = {"COMP_WORDS": "rths run hachinohe_low", "COMP_CWORD": "2", "_RTHS_COMPLETE": "bash_complete"}
    assert by_the_shell(tmp_path, **asked) == "plain,hachinohe_low_ff\nplain,hachinohe_low_ff_fb\n"


@pytest.mark.parametrize("command", CASE_COMMANDS)
def test_names_of_cases_complete(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hachinohe_mine.yaml").write_text("")
    names = ("high_ff", "high_ff_fb", "low_ff", "low_ff_fb", "mine")
    assert complete(command, "hachinohe_") == [f"plain,hachinohe_{name}" for name in names]
    assert complete(command, "configs/h") == ["file,configs/h"]


def test_names_of_structures_records_and_rigs_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "three_own.yaml").write_text("extends: three_storey\nheights_m: [1, 1, 1]\n")
    assert complete("structure", "three_") == ["plain,three_own", "plain,three_storey", "plain,three_storey_bare"]
    assert complete("records", "el_") == ["plain,el_centro"] and complete("serve", "aps") == [
        "plain,aps400_laboratory",
        "plain,aps400_virtual",
    ]
    assert complete("doctor", "--rig", "udp_l") == ["plain,udp_loopback"]
    assert complete("list", "re") == ["plain,records", "plain,references", "plain,results"]


@pytest.mark.parametrize("option", ["--set", "--vary"])
def test_keys_of_a_case_complete(option: str) -> None:
    assert complete("sweep", option, "table.physics.cou") == [
        "plain,table.physics.coulomb_n=", "plain,table.physics.coulomb_velocity_m_s="
    ]  # fmt: skip
    assert complete("sweep", option, "scali") == ["plain,scaling="]
    assert complete("sweep", option, "controller")[:2] == ["plain,controller", "plain,controller.kind="]


def test_commands_and_options_complete() -> None:
    assert complete("ex") == ["plain,export"]
    assert complete("export", "--to", "m") == ["plain,mat"]
    assert complete("run", "--over") == ["plain,--override"]


def test_the_citation_names_software_and_paper() -> None:
    """Hold the keys that the Citation File Format 1.2.0 requires."""
    told = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= set(told)
    assert (told["cff-version"], told["type"], told["version"]) == ("1.2.0", "software", __version__)
    assert told["license"] == "BSD-3-Clause" and told["authors"][0]["name"]
    paper = told["references"][0]
    assert {"type", "title", "authors"} <= set(paper)
    assert [author["family-names"] for author in paper["authors"]] == ["Zhang", "Lauenstein", "Phillips"]
    assert paper["title"] == "Substructure Real-time Hybrid Simulation With a Small-scale Uni-axial Shake Table"
