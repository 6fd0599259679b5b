"""The reference page of the commands, from their own help."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import click

from rths_cli.cli import cli

HEAD = """# Commands

Made from the commands' own help by `python tests/helpers/docs_reference.py`; a test compares.
`rths COMMAND --help` prints the same.

Exit codes: 0 done; 1 done, but an `accept` limit failed, the check refused EXP-RTHS or an identified model was
rejected; 2 bad usage or input, nothing written; 3 stopped by a limit of the guard; 4 rig failed or its channels
unusable; 5 our bug; 130 Ctrl-C; 143 SIGTERM.
"""
OPTION_COLUMNS = ("option", "does", "default, limits")


def commands_page() -> str:
    """Return the page as Markdown: a section per command, a table row per option."""
    whole = ["## `rths`", *_told(cli), _table(OPTION_COLUMNS, _option_rows(cli))]
    parts = [HEAD.rstrip(), *whole]
    for name in sorted(cli.commands):
        parts += _command(name, cli.commands[name])
    return "\n\n".join(parts) + "\n"


def _command(name: str, command: click.Command) -> Iterator[str]:
    arguments = [p for p in command.params if isinstance(p, click.Argument)]
    context = click.Context(command, info_name=name)
    yield f"## `{' '.join(['rths', name, *(p.make_metavar(context) for p in arguments)])}`"
    yield from _told(command)
    stated = [p for p in arguments if isinstance(p.default, str)]
    if stated:
        yield "Without it: " + ", ".join(f"`{p.default}`" for p in stated) + "."
    yield _table(OPTION_COLUMNS, _option_rows(command))


def _told(command: click.Command) -> Iterator[str]:
    """Yield the paragraphs of a command's help, its example as a block."""
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        text = " ".join(paragraph.split())
        example = re.fullmatch(r"Example: (rths .*)", text)
        yield f"```sh\n{example[1]}\n```" if example else text


def _option_rows(command: click.Command) -> Iterator[tuple[str, str, str]]:
    context = click.Context(command, parent=click.Context(cli, **cli.context_settings))
    for option in command.get_params(context):
        if isinstance(option, click.Option):
            record = option.get_help_record(context)
            assert record is not None, option.name  # a hidden option would stand nowhere
            text, _, extra = record[1].partition("  [")
            # click keeps a command's help option as the first context made it: names are taken from this one
            names = ", ".join(context.help_option_names) if option is command.get_help_option(context) else record[0]
            yield f"`{names}`", text, extra.removesuffix("]").replace("default: ", "").replace("; ", ", ")


def _table(columns: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [" | ".join(cell.replace("|", "\\|") for cell in cells) for cells in rows]
    return "\n".join(f"| {line} |" for line in (" | ".join(columns), " | ".join(["---"] * len(columns)), *lines))
