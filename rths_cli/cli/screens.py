"""The screen of a command: progress on stderr, signals polled, and a word before code is compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rths_cli.cli.group import SIGNALS

if TYPE_CHECKING:
    from rths_cli.screen import Screen


def new_screen(quiet: bool) -> Screen:
    """Return the screen of a command that may move a table."""
    from rths_cli.compiled import announce
    from rths_cli.screen import Screen

    screen = Screen(quiet, poll=SIGNALS.poll)

    def say(text: str) -> None:
        screen.clear()
        click.echo(text, err=True)

    if not quiet:
        announce(say)
    return screen
