"""The click group `rths` with its list of commands, and the process's signals."""

from __future__ import annotations

import os

import click

from rths_cli.cli.logs import end_logs
from rths_cli.errors import InputError
from rths_cli.interrupts import Signals
from rths_cli.version import __version__

SIGNALS = Signals()
PARTS = {
    "Run": ("check", "run", "evaluate", "sweep", "ida", "merge", "benchmark"),
    "Look": ("report", "export"),
    "Prepare": ("new", "list", "structure", "records", "schema", "data", "identify"),
    "Real rigs": ("doctor", "calibrate", "serve", "bridge", "recover", "plugin"),
}
LONGEST = 200  # characters of the first sentence: all of it, over several lines
OTHERS = "Other"  # commands that stand in none of the parts


class Commands(click.Group):
    """A group whose help lists its commands by what they are for."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, a part at a time, in the order in which they are met."""
        named = {name for names in PARTS.values() for name in names}
        parts = {**PARTS, OTHERS: tuple(name for name in self.list_commands(ctx) if name not in named)}
        width = max(map(len, self.commands))
        with formatter.section("Commands"):
            for part, names in parts.items():
                shown = [(name.ljust(width), self._line(ctx, name)) for name in names if name in self.commands]
                if shown:
                    with formatter.section(part):
                        formatter.write_dl(shown)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is asked for; `rths sweep merge ...` is `rths merge ...`."""
        return super().resolve_command(ctx, args[1:] if args[:2] == ["sweep", "merge"] else args)

    def _line(self, ctx: click.Context, name: str) -> str:
        command = self.get_command(ctx, name)
        return command.get_short_help_str(LONGEST) if command else ""


@click.group(
    cls=Commands,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="rths")
@click.option("--debug", is_flag=True, help="Show a traceback when rths itself fails.")
@click.pass_context
def cli(ctx: click.Context, debug: bool) -> None:
    """Run substructure real-time hybrid simulations with a uni-axial shake table.

    A case file names a structure, its damping, a record, its scaling and a controller.

    Example: rths run el_centro_low_ff_fb
    """
    end_logs()  # of a command before this one in the same process
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
        return
    try:
        os.getcwd()
    except FileNotFoundError:
        raise InputError("the current folder was removed; change to one that exists") from None
