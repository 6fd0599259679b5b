"""The parts of the benchmark by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from campaigns import step_run

from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import Setup
from speed.channels import channels_rows
from speed.commands import command_rows
from speed.growth import growth_rows
from speed.laws import laws_rows
from speed.rivals import rival_rows
from speed.rows import Row
from speed.sim import sim_rows
from speed.step import step_rows
from speed.sweep import sweep_rows


@cache
def paper_case() -> tuple[Setup, step_run.Inputs]:
    """Return the case that all parts share, and what its EXP-RTHS reads."""
    setup, blocks = step_run.prepared(Memory(Cache()))
    return setup, step_run.inputs(setup, blocks)


PARTS: dict[str, Callable[[], list[Row]]] = {
    "step": lambda: step_rows(paper_case()[1]),
    "rivals": lambda: rival_rows(*paper_case()),
    "sim": lambda: sim_rows(paper_case()[0]),
    "commands": command_rows,
    "growth": lambda: growth_rows(*paper_case()),
    "sweep": sweep_rows,
    "channels": lambda: channels_rows(paper_case()[1]),
    "laws": lambda: laws_rows(*paper_case()),
}


def rows_of(part: str) -> list[Row]:
    """Measure one part."""
    return PARTS[part]()
