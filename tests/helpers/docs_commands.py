"""The reference page of the commands, from their own help."""

from __future__ import annotations

import inspect
import re
from collections import Counter
from collections.abc import Iterable, Iterator

import click

from rths_cli.cli import cli

HEAD = """# Commands

The commands and their options; `rths COMMAND --help` says what each argument and option does, and so do the [how-to
pages](../index.md#how-to). Options of several commands stand at the end. [Exit codes](../decisions/commands.md) have
one meaning each.
"""
SHARED = "## Options of several commands"
SEVERAL = 2  # commands from which on an option with the same words is told once
Row = tuple[str, str]


def commands_page() -> str:
    """Return the page as Markdown: a section per command with its options by name, shared options with their help."""
    rows = {name: list(_option_rows(command)) for name, command in cli.commands.items()}
    held = Counter(row for own in rows.values() for row in own)
    shared = [row for row, number in held.items() if number >= SEVERAL]
    parts = [HEAD.rstrip(), "## `rths`", *_told(cli), _list(_option_rows(cli))]
    for name in sorted(cli.commands):
        parts += _command(name, cli.commands[name], [row for row in rows[name] if row not in shared])
        further = [_first_name(row) for row in rows[name] if row in shared and held[row] < len(rows)]
        parts += [f"Also {', '.join(further)}."] if further else []
    of_all = [row for row in shared if held[row] == len(rows)]
    parts += [SHARED, f"Every command has {', '.join(_first_name(row) for row in of_all)}."]
    parts += [_list([*of_all, *(row for row in shared if row not in of_all)])]
    return "\n\n".join(parts) + "\n"


def _first_name(row: Row) -> str:
    """Return the option without its value, the long name where it has two."""
    return f"`{row[0].strip('`').split(', ')[-1].split()[0]}`"


def _command(name: str, command: click.Command, own: list[Row]) -> Iterator[str]:
    arguments = [p for p in command.params if isinstance(p, click.Argument)]
    context = click.Context(command, info_name=name)
    yield f"## `{' '.join(['rths', name, *(p.make_metavar(context) for p in arguments)])}`"
    yield from _told(command)
    stated = [p for p in arguments if isinstance(p.default, str)]
    if stated:
        yield "Without it: " + ", ".join(f"`{p.default}`" for p in stated) + "."
    if own:
        yield f"Options: {', '.join(names for names, _ in own)}."


def _told(command: click.Command) -> Iterator[str]:
    """Yield the first paragraph of a command's help, and its example as a block."""
    for i, paragraph in enumerate(inspect.cleandoc(command.help or "").split("\n\n")):
        text = " ".join(paragraph.split())
        example = re.fullmatch(r"Example: (rths .*)", text)
        if example or i == 0:
            yield f"```sh\n{example[1]}\n```" if example else text


def _option_rows(command: click.Command) -> Iterator[Row]:
    context = click.Context(command, parent=click.Context(cli, **cli.context_settings))
    for option in command.get_params(context):
        if isinstance(option, click.Option):
            record = option.get_help_record(context)
            assert record is not None, option.name  # a hidden option would stand nowhere
            text, _, extra = record[1].partition("  [")
            # click keeps a command's help option as the first context made it: names are taken from this one
            names = ", ".join(context.help_option_names) if option is command.get_help_option(context) else record[0]
            limits = extra.removesuffix("]").replace("default: ", "").replace("; ", ", ")
            yield f"`{names}`", f"{text} [{limits}]" if limits else text


def _list(rows: Iterable[Row]) -> str:
    return "\n".join(f"- {names}: {about}" for names, about in rows)
