"""The parts of the benchmark by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from campaigns import step_run

from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import Setup
from speed import channels, commands, growth, laws, process, rivals, sim, step, sweep
from speed.rows import Row


@cache
def paper_case() -> tuple[Setup, step_run.Inputs]:
    """Return the case that all parts share, and what its EXP-RTHS reads."""
    setup, blocks = step_run.prepared(Memory(Cache()))
    return setup, step_run.inputs(setup, blocks)


PARTS: dict[str, Callable[[], list[Row]]] = {
    "step": lambda: step.step_rows(paper_case()[1]),
    "rivals": lambda: rivals.rival_rows(*paper_case()),
    "sim": lambda: sim.sim_rows(paper_case()[0]),
    "commands": commands.command_rows,
    "growth": lambda: growth.growth_rows(*paper_case()),
    "sweep": sweep.sweep_rows,
    "channels": lambda: channels.channels_rows(paper_case()[1]),
    "laws": lambda: laws.laws_rows(*paper_case()),
}


def rows_of(part: str) -> list[Row]:
    """Measure one part."""
    return PARTS[part]()


def shorten() -> None:
    """Make every part as small as it can be: its figures mean nothing, all of its code runs."""
    step.PAIRS = channels.PAIRS = laws.PAIRS = laws.SWEEP_PAIRS = growth.REPETITIONS = 1
    rivals.STEPS, rivals.FEW_STEPS, laws.SEEDS = 400, 20, 4
    growth.STOREYS, growth.FLOORS, growth.LENGTHS_S, growth.CASES = (3, 4), (2,), (2.0, 1.0), (1, 2, 3)
    sweep.COUNTS = (2, 3, 5)
    commands.COMMANDS = dict(list(commands.COMMANDS.items())[:2])
    process.SHORT = True
