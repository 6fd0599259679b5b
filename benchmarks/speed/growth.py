"""How the time per step grows with storeys, experimental floors and the length of the record, and that of a command
with its cases."""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from campaigns import step_run
from further_channels import FIVE_AS_KEYS

from rths_cli.control.numerical_substructure import interface
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import Setup
from rths_cli.structure import Numerical
from speed.commands import EIGHT
from speed.process import median_s
from speed.rows import RATIO, Row, seconds_of

STOREYS = (3, 10, 30, 100)
FLOORS = (2, 4, 8)
LENGTHS_S = (54.0, 27.0, 13.5)
CASES = (1, 4, 8)
GENTLE = 0.1  # of the record, for tall buildings: they move the table farther
REPETITIONS = 7


def growth_rows(setup: Setup, given: step_run.Inputs) -> list[Row]:
    """Measure growth over storeys, channels, experimental floors, record length and cases."""
    storeys = {count: tall(setup, given, count) for count in STOREYS}
    lengths = {f"{length} s": shortened(given, round(length / setup.rig.dt_s)) for length in LENGTHS_S}
    return [
        *_rows("storeys, 2 of them on the table", {str(count): one for count, one in storeys.items()}, 15.0),
        *channel_rows(),
        *_rows("floors on the table", {str(count): many_floors(count) for count in FLOORS}, None),
        *_rows("record", lengths, None),
        cases_row(),
    ]


def channel_rows() -> list[Row]:
    """Compare a step with eight channels, a displacement sensor and a load cell among them, with one of three."""
    runs = {"3": with_channels(""), "8": with_channels(json.dumps(FIVE_AS_KEYS))}
    return _rows("channels", runs, 1.3)


def with_channels(further: str) -> step_run.Inputs:
    """Return the paper's run with further channels on its table, listed in JSON."""
    settings = (f"table={{extends: aps400_virtual, channels: {further}}}",) if further else ()
    return step_run.inputs(*step_run.prepared(Memory(Cache()), settings=settings))


def _rows(what: str, runs: dict[str, step_run.Inputs], demand: float | None) -> list[Row]:
    """Compare the time per step with that of the first run; the demand is on the last."""
    first, *others = runs
    times = per_step_s(runs)
    behind = "; ".join(f"{name}: {1e9 * time_s:.0f} ns" for name, time_s in times.items())
    return [
        Row(
            f"a step with {what}: {name} / {first}",
            times[name] / times[first],
            RATIO,
            demand if name == others[-1] else None,
            behind if name == others[-1] else "",
        )
        for name in others
    ]


def per_step_s(runs: dict[str, step_run.Inputs]) -> dict[str, float]:
    """Return the shortest time of a step of each run, measured by turns.

    Raises RuntimeError when a run does not reach its end.
    """
    for name, given in runs.items():
        done = step_run.bound(given, step_run.fresh(given))()
        if done != len(given.drive):
            raise RuntimeError(f"{name}: the run stopped after {done} of {len(given.drive)} steps")
    turns = [{name: seconds_of(given, step_run.bound) for name, given in runs.items()} for _ in range(REPETITIONS)]
    return {name: min(turn[name] for turn in turns) / len(given.drive) for name, given in runs.items()}


def tall(setup: Setup, given: step_run.Inputs, storeys: int) -> step_run.Inputs:
    """Return the run with so many storeys, all but two computed, each like the paper's, under a gentler record."""
    count = storeys - len(setup.floor_masses_kg)
    own = setup.building.numerical
    differences = np.eye(count) - np.eye(count, k=-1)
    chain = differences.T @ differences
    part = Numerical(np.full(count, own.masses_kg[-1]), own.K[-1, -1] * chain, own.C[-1, -1] * chain)
    return replace(
        given,
        blocks=replace(given.blocks, numerical=interface(part, setup.rig.dt_s, setup.case.integration)),
        drive=GENTLE * given.drive,
    )


def shortened(given: step_run.Inputs, steps: int) -> step_run.Inputs:
    """Return the run over the first steps only."""
    return replace(given, drive=given.drive[:steps].copy(), noise=given.noise[: steps + 1].copy())


def many_floors(count: int) -> step_run.Inputs:
    """Return the run with so many floors on the table that weigh as much together, identified and designed anew."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "floors.yaml"
        path.write_text(_case(count))
        return step_run.inputs(*step_run.prepared(Memory(Cache()), str(path)))


def _case(floors: int) -> str:
    """Return a case with a specimen of 13.8 kg whose first frequency hardly depends on its floors."""
    mass, stiffness = 13.8 / floors, 7354.0 * floors / 2
    return f"""structure:
  numerical: {{masses_kg: [6.93], stiffness_n_per_m: [7354]}}
  experimental:
    masses_kg: {[mass] * floors}
    stiffness_n_per_m: {[stiffness] * floors}
    dashpots_n_s_per_m: {[0.003 * stiffness] * floors}
  damping_levels: {{low: {{dashpots_n_s_per_m: [22.16]}}}}
damping: low
record: el_centro
scaling: 0.1
controller: FF+FB
"""


def cases_row() -> Row:
    """Compare the time of a further case in a long command with that in a short one."""
    times = {count: median_s("run", *EIGHT[:count], repetitions=2) for count in CASES}
    few, more, most = times.values()
    growth = (most - more) / (CASES[2] - CASES[1]) / ((more - few) / (CASES[1] - CASES[0]))
    behind = ", ".join(f"{count}: {time_s:.2f} s" for count, time_s in times.items())
    return Row("rths run, a case more, 4 to 8 / 1 to 4 cases", growth, RATIO, None, behind)
