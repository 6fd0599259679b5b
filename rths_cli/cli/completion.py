"""Shell completion of arguments and options that are names: of cases, structures, records and rigs, or files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

KINDS = {
    "case": "cases",
    "cases": "cases",
    "structure": "structures",
    "record": "records",
    "rig": "rigs",
}
"""The kind of name that a parameter takes, by the parameter's own name."""


class FileOfKind(click.ParamType):
    """The name of a file of one kind: a shipped one, one in this folder or in the kind's own folder; or a path."""

    def __init__(self, kind: str) -> None:
        self.kind, self.name = kind, kind.removesuffix("s")

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the names that start so, or have the shell complete files when there are none."""
        from rths_cli.case.named_files import known

        names = [name for name in known(self.kind, Path.cwd()) if name.startswith(incomplete)]
        return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


def complete_names(commands: Iterable[click.Command]) -> None:
    """Have the shell complete the parameters of commands that take a name."""
    for command in commands:
        for parameter in command.params:
            if parameter.name in KINDS:
                parameter.type = FileOfKind(KINDS[parameter.name])
