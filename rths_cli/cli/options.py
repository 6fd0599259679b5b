"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])


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


def methods_option(more: str) -> Callable[[F], F]:
    """Add --method, repeatable; `more` ends its help."""
    about = f"Method instead of the case's own; give both to {more}."
    return click.option("--method", "methods", multiple=True, type=click.Choice(["paper", "best"]), help=about)


def overrides_option(choices: Sequence[str], about: str) -> Callable[[F], F]:
    """Add --override, repeatable: the one option that says "I know"."""
    return click.option("--override", "overrides", multiple=True, type=click.Choice(choices), help=f"I know: {about}")


def yes_option(command: F) -> F:
    """Add --yes."""
    about = "Move a real rig without asking; its file must say `unattended: true`."
    return click.option("--yes", is_flag=True, help=about)(command)
