"""Options and arguments that several commands share, and the names that a shell completes."""

from __future__ import annotations

import math
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from rths_cli.safe_text import shortened, visible

F = TypeVar("F", bound=Callable[..., Any])
LONGEST_PART, LONGEST_PATH = 255, 4000  # bytes of a file's name, and of a path

KINDS = {
    "case": "cases",
    "cases": "cases",
    "structure": "structures",
    "record": "records",
    "rig": "rigs",
}
"""The kind of name that a parameter takes, by the parameter's own name."""
SETTINGS = ("settings", "vary")


class Number(click.FloatRange):
    """A finite number in a range; click takes NaN for one in any."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; fails for one that is not finite or out of range."""
        found = float(super().convert(value, param, ctx))
        if not math.isfinite(found):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return found


class FileName(click.Path):
    """The name of a file or folder that may exist: not empty, not too long, and in no circle of links."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the path; fails for a name that no file can have."""
        text = os.fspath(value)
        if not text.strip() or "\0" in text:
            self.fail("the name is empty; give the name of a file or folder.", param, ctx)
        if len(os.fsencode(text)) > LONGEST_PATH or max(map(len, os.fsencode(text).split(b"/"))) > LONGEST_PART:
            self.fail(f"{shortened(text, 80)}: no file can have a name of {len(text)} characters.", param, ctx)
        try:
            Path(text).resolve()
        except (OSError, RuntimeError):
            self.fail(f"{shortened(text, 80)}: its links go round in a circle.", param, ctx)
        return Path(text)


FILE = FileName()


def command_line() -> str:
    """Return what was typed, as results keep it."""
    return visible(shlex.join(["rths", *sys.argv[1:]]))


def settings_option(command: F) -> F:
    """Add --set KEY=VALUE."""
    return click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="KEY=VALUE",
        help="Change a key of every case, for instance --set table.physics.coulomb_n=0. Repeatable.",
    )(command)


def json_option(command: F) -> F:
    """Add --json."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON document on stdout and nothing else.")(
        command
    )


def rate_option(command: F) -> F:
    """Add --rate."""
    about = "Sample rate, where the file does not state it."
    return click.option("--rate", "rate_hz", type=Number(min=0, min_open=True), metavar="HZ", help=about)(command)


def quiet_option(command: F) -> F:
    """Add --quiet."""
    about = "Show no progress, and of the output only the line with the verdict."
    return click.option("--quiet", is_flag=True, help=about)(command)


def no_replace_option(command: F) -> F:
    """Add --no-replace."""
    about = "Refuse, before anything is done, to replace a file that exists."
    return click.option("--no-replace", is_flag=True, help=about)(command)


def force_option(command: F) -> F:
    """Add --force."""
    about = "Replace a finished sweep of another case, grid or part, too."
    return click.option("--force", is_flag=True, help=about)(command)


def methods_option(more: str) -> Callable[[F], F]:
    """Add --method, repeatable; `more` ends its help."""
    about = f"Method instead of the case's own; give both to {more}."
    return click.option("--method", "methods", multiple=True, type=click.Choice(["paper", "best"]), help=about)


def overrides_option(choices: Sequence[str], about: str) -> Callable[[F], F]:
    """Add --override, repeatable: the one option that goes on against a refusal."""
    return click.option("--override", "overrides", multiple=True, type=Overridden(choices), help=about)


class Overridden(click.Choice[str]):
    """What is gone on against; whoever gives a setting of the case instead is told where it belongs."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return one of the choices; raises BadParameter for anything else."""
        if isinstance(value, str) and "=" in value:
            self.fail(f"{value!r} is a setting; give it as --set {value}", param, ctx)
        return super().convert(value, param, ctx)


def yes_option(command: F) -> F:
    """Add --yes."""
    about = "Move a real rig without asking; its file must say `unattended: true`."
    return click.option("--yes", is_flag=True, help=about)(command)


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
