"""Shell completion of names of cases, structures, records and rigs, of files, and of the keys of --set and --vary."""

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


SETTINGS = ("settings", "vary")


class FileOfKind(click.ParamType):
    """The name of a file of one kind: a shipped one, one in this folder or in the kind's own folder; or a path."""

    def __init__(self, kind: str) -> None:
        self.kind, self.name = kind, kind.removesuffix("s")

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the names that start so, or have the shell complete files when there are none."""
        from rths_cli.case.named_files import known

        names = [name for name in known(self.kind, Path.cwd()) if name.startswith(incomplete)]
        return [CompletionItem(name) for name in names] or [CompletionItem(incomplete, type="file")]


class SettingKey(click.ParamType):
    """A key of a case, as in `--set table.physics.coulomb_n=0.9`."""

    name = "key"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the keys that start so; the last ones, which take a value, with their equals sign."""
        from rths_cli.case.case_schema import CaseKeys
        from rths_cli.case.field_types import dotted_keys

        keys = dict.fromkeys(dotted_keys(CaseKeys))
        parents = {key.rpartition(".")[0] for key in keys}
        shown = [key if key in parents else f"{key}=" for key in keys if key.startswith(incomplete)]
        return [CompletionItem(key) for key in shown]


def complete_names(commands: Iterable[click.Command]) -> None:
    """Have the shell complete the parameters of commands that take a name."""
    for command in commands:
        for parameter in command.params:
            if parameter.name in KINDS:
                parameter.type = FileOfKind(KINDS[parameter.name])
            elif parameter.name in SETTINGS:
                parameter.type = SettingKey()
