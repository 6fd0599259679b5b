"""The linear blocks of the step by programs of other kinds, per step, against ours with everything in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from campaigns import step_run
from campaigns.step_network import GROUND, Part, assembled, network, numpy_commands, our_commands

from rths_cli.experiment.setup import Setup
from rths_cli.numerics.lti import Array
from speed.rows import RATIO, Row, difference, lowest_s

STEPS, FEW_STEPS = 20_000, 200
HAS = "linear blocks and table: no noise, rounding, friction, limits, guard, log"
QUIET = 2000  # first samples, which are left out


def rival_rows(setup: Setup, given: step_run.Inputs) -> list[Row]:
    """Time each program, ours on the same linear table, and compare all commands with plain numpy's."""
    blocks, dt = given.blocks.linearised(), setup.rig.dt_s
    parts = network(setup, blocks)
    ground = np.ascontiguousarray(given.drive[QUIET : QUIET + STEPS])
    expected = numpy_commands(parts, ground)
    ours = our_commands(parts, blocks, ground)
    ours_s = lowest_s(ours, 20) / STEPS
    apart = difference(expected, ours())
    programs: dict[str, tuple[Callable[[], Array] | None, int]] = {
        "plain numpy, block by block": (lambda: numpy_commands(parts, ground), 1),
        "plain numpy, closed loop assembled": (dense_numpy_commands(parts, ground), 1),
        "scipy.signal.dlsim, closed loop assembled": (dlsim_commands(parts, ground, dt), 1),
        "python-control, interconnect": (control_commands(parts, ground[:FEW_STEPS], dt), 1),
        "numba, closed loop assembled": (dense_commands(parts, ground), 20),
    }
    first = Row(
        "our step, the same linear blocks", 1e9 * ours_s, "ns", None, f"{HAS}; differs from numpy by {apart:.0e}"
    )
    return [first, *(_row(name, *program, expected, ours_s) for name, program in programs.items())]


def _row(name: str, work: Callable[[], Array] | None, often: int, expected: Array, ours_s: float) -> Row:
    if work is None:
        return Row(f"{name}: not installed", None, RATIO)
    made = np.array(work())
    per_step = lowest_s(work, often) / len(made)
    apart = difference(expected[: len(made)], made)
    behind = f"{1e9 * per_step:,.0f} ns a step, ours {1e9 * ours_s:.0f}; {HAS}; differs from numpy by {apart:.0e}"
    return Row(f"{name} / our step", per_step / ours_s, RATIO, None, behind)


def dense_numpy_commands(parts: Sequence[Part], ground: Array) -> Callable[[], Array]:
    """Return a function that advances the assembled loop by one numpy product a step."""
    a, b, c, d = assembled(parts)
    whole = np.block([[a, b], [c, d]])

    def run() -> Array:
        given, commands = np.zeros(whole.shape[1]), np.zeros(len(ground))
        for k, row in enumerate(ground):
            given[-3:] = row
            made = whole @ given
            given[:-3] = made[:-1]
            commands[k] = made[-1]
        return commands

    return run


def dlsim_commands(parts: Sequence[Part], ground: Array, dt_s: float) -> Callable[[], Array]:
    """Return a function that simulates the assembled closed loop by scipy."""
    from scipy.signal import dlsim

    system = (*assembled(parts), dt_s)
    return lambda: np.asarray(dlsim(system, ground)[1][:, 0])


def control_commands(parts: Sequence[Part], ground: Array, dt_s: float) -> Callable[[], Array] | None:
    """Return a function that simulates the network by python-control, None when that is not installed."""
    try:
        import control
    except ImportError:
        return None
    blocks = [
        control.ss(p.A, p.B, p.C, p.D, dt_s, name=p.name, inputs=list(p.inputs), outputs=list(p.outputs)) for p in parts
    ]
    whole = control.interconnect(blocks, inputs=list(GROUND), outputs=["command"])
    time_s = dt_s * np.arange(len(ground))
    return lambda: np.asarray(control.input_output_response(whole, time_s, ground.T).outputs).reshape(-1)


def dense_commands(parts: Sequence[Part], ground: Array) -> Callable[[], Array]:
    """Return a function that advances the assembled loop by one product a step, column by column, compiled by numba."""
    import numba

    @numba.njit
    def advance(columns: Array, ground: Array, commands: Array) -> None:
        width, rows = columns.shape
        given, made = np.zeros(width), np.zeros(rows)
        for k in range(len(ground)):
            for j in range(3):
                given[rows - 1 + j] = ground[k, j]
            made[:] = 0.0
            for j in range(width):
                for i in range(rows):
                    made[i] += columns[j, i] * given[j]
            for i in range(rows - 1):
                given[i] = made[i]
            commands[k] = made[rows - 1]

    a, b, c, d = assembled(parts)
    columns = np.ascontiguousarray(np.block([[a, b], [c, d]]).T)
    commands = np.zeros(len(ground))

    def run() -> Array:
        advance(columns, ground, commands)
        return commands

    return run
