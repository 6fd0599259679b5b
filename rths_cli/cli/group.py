"""The group all commands belong to, and the signals that end them."""

from __future__ import annotations

import click

from rths_cli import __version__
from rths_cli.process import Signals

SIGNALS = Signals()


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="rths")
@click.option("--debug", is_flag=True, help="Show a traceback when rths itself fails.")
def cli(debug: bool) -> None:
    """Run substructure real-time hybrid simulations with a uni-axial shake table.

    A case file names a structure, its damping, a record, its scaling and a controller.

    Example: rths run el_centro_low_ff_fb
    """
