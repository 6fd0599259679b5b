"""Shell completion of the argument CASE: names of cases, or files where a path is begun."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

CASES = ("case", "cases")


class CaseName(click.ParamType):
    """A case: the name of a shipped one, of one in this folder or in configs/, or a path."""

    name = "case"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the names that start so, or have the shell complete files when there are none."""
        from rths_cli.case.named_files import known

        names = [name for name in known("cases", Path.cwd()) if name.startswith(incomplete)]
        return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


def complete_cases(commands: Iterable[click.Command]) -> None:
    """Have the shell complete the arguments of commands that are cases."""
    for command in commands:
        for parameter in command.params:
            if isinstance(parameter, click.Argument) and parameter.name in CASES:
                parameter.type = CaseName()
