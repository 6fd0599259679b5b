"""The blocks of a run and a linear virtual table as a network of state spaces, for programs of other kinds, and our
step on the same table.

The table's friction, noise, quantisation, limits, guard and log are left out: what is left, every program can express,
but for what the feedforward adds against friction, which is no linear block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.experiment.setup import Setup
from rths_cli.loop.linear_parts import Linear, linear
from rths_cli.loop.step import note_sent, step
from rths_cli.loop.step_arrays import NUMERICAL, Step, assemble
from rths_cli.numerics.compiled import entry
from rths_cli.numerics.lti import Array, Block
from rths_cli.rigs.virtual.plant import accelerations, continuous, with_sensors

GROUND = ("ground_accel", "ground_velocity", "ground_displacement")


@dataclass(frozen=True)
class Part:
    """One discrete block x+ = A x + B u, y = C x + D u with the names of its signals; `added(u)` is added to y where it
    is no linear block."""

    name: str
    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    added: Callable[[Array], Array] | None = None


def network(setup: Setup, blocks: Blocks) -> tuple[Part, ...]:
    """Return table, sensors' correction, estimator, base shear, numerical part, feedforward, feedback and their sum.

    In this order every output depends on outputs before it only; the ground motion is the input, `command`, which
    comes last, the output.
    """
    channels, lead = blocks.correction.C.shape[0], blocks.lead_samples
    samples, estimates = _names("sample", channels), _names("estimate", blocks.estimator.C.shape[0])
    corrected = _names("corrected", channels)
    stairs = blocks.staircase()
    recent = _names("recent", lead)
    motion = ("desired", "desired_velocity", "desired_displacement")
    inputs = (*recent, "desired")
    return (
        _table(setup, blocks, samples),
        Part("staircase", stairs.A, stairs.B, stairs.C, stairs.D, ("command",), ("stairs",)),
        _of(blocks, 0, samples, _names("unstaired", channels)),
        _sum("ripple", np.hstack([np.eye(channels), -np.eye(channels)[:, :1]]),
             (*_names("unstaired", channels), "stairs"), corrected),
        _of(blocks, 1, corrected, estimates),
        _recent(lead, recent),
        _sum("known_shear", np.concatenate(blocks.interface.force.of_one()[:3])[None],
             (*estimates, *recent, *corrected), ("known",)),
        _numerical(blocks, motion),
        _feedforward(blocks, motion, corrected),
        _sum("error", np.array([[1.0, -1.0]]), (inputs[0], corrected[0]), ("tracking_error",)),
        _feedback(blocks),
        _sum("both", np.ones((1, 2)), ("forward", "back"), ("command",)),
    )  # fmt: skip


def _names(kind: str, count: int) -> tuple[str, ...]:
    return tuple(f"{kind}_{i}" for i in range(count))


def _of(blocks: Blocks, place: int, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Part:
    block = blocks.named()[place]
    return Part(block.name, block.A, block.B, block.C, block.D, inputs, outputs)


def _sum(name: str, gain: Array, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Part:
    p, m = gain.shape
    return Part(name, np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0)), gain, inputs, outputs)


def _recent(lead: int, outputs: tuple[str, ...]) -> Part:
    """Return the memory of the last desired accelerations, the oldest first."""
    last = np.eye(lead)[:, -1:]
    return Part("recent", np.eye(lead, k=1), last, np.eye(lead), np.zeros((lead, 1)), ("desired",), outputs)


def _feedforward(blocks: Blocks, motion: tuple[str, ...], corrected: tuple[str, ...]) -> Part:
    """Return the feedforward of the desired motion, of the measured accelerations too where it counters the specimen's
    reaction, and of what it adds against friction."""
    design = blocks.feedforward
    block = design.linearised()
    inputs = (*motion, *corrected)[: block.B.shape[1]]
    added = (lambda given: design.added_v(given[:3])) if isinstance(design, FrictionFeedforward) else None
    return Part(block.name, block.A, block.B, block.C, block.D, inputs, ("forward",), added)


def _feedback(blocks: Blocks) -> Part:
    """Return the feedback, whose second input is zero where no limit acts."""
    block = blocks.feedback
    return Part(block.name, block.A, block.B[:, :1], block.C, block.D[:, :1], ("tracking_error",), ("back",))


def _numerical(blocks: Blocks, motion: tuple[str, ...]) -> Part:
    """Return the numerical part with the base shear of the same instant solved for, and the ground's motion added."""
    block, share = blocks.numerical, blocks.interface.force.of_one()[3]
    loop = share / (1.0 - block.D[0, 1] * share)
    shear_c = loop * block.C[:1]
    shear_d = loop * block.D[:1] + np.array([[0.0, 1.0]])
    c, d = block.C + block.D[:, 1:] @ shear_c, np.zeros((3, 4))
    d[:, [0, 3]] = np.outer(block.D[:, 0], [1.0, 0.0]) + block.D[:, 1:] @ shear_d
    d[1, 1], d[2, 2] = 1.0, 1.0
    a, b = block.A + block.B[:, 1:] @ shear_c, np.zeros((len(block.A), 4))
    b[:, [0, 3]] = np.outer(block.B[:, 0], [1.0, 0.0]) + block.B[:, 1:] @ shear_d
    return Part(block.name, a, b, c, d, (*GROUND, "known"), motion)


def _table(setup: Setup, blocks: Blocks, samples: tuple[str, ...]) -> Part:
    """Return the table without friction and limits, its sensors, and the commands under way (one sample or more)."""
    from scipy.signal import cont2discrete

    building, channel, late = setup.building, setup.rig.channels[0], blocks.latency_samples
    a, b_u, b_n, _, _ = continuous(setup.case.table.physics, building.specimen, building.interface_experimental_mass_kg)
    rows = accelerations(a, b_n, len(building.specimen.masses_kg))[0]
    unused = np.zeros((len(rows), b_n.shape[1]))
    full, drive, _ = with_sensors(a, b_u, b_n, rows, unused, channel.low_pass_hz, channel.high_pass_hz)
    n, count = len(full), len(samples)
    sensed = np.zeros((count, n))
    sensed[:, n - 2 * count :] = channel.sensitivity_v_per_unit * np.hstack([np.eye(count), -np.eye(count)])
    held, pushed = cont2discrete((full, drive[:, None], sensed, np.zeros((count, 1))), setup.rig.dt_s)[:2]
    a = np.block([[held, pushed, np.zeros((n, late - 1))], [np.zeros((late, n)), np.eye(late, k=1)]])
    b, c = np.eye(n + late)[:, -1:], np.hstack([sensed, np.zeros((count, late))])
    return Part("table", a, b, c, np.zeros((count, 1)), ("command",), samples)


class Stepping:
    """The network in plain numpy, sample by sample: every block one product for its outputs, one for its states."""

    def __init__(self, parts: Sequence[Part]) -> None:
        names = [*GROUND, *(name for part in parts for name in part.outputs)]
        place = {name: i for i, name in enumerate(names)}
        self.outputs = [
            (
                i,
                np.hstack([p.C, p.D]),
                [place[name] for name in p.inputs],
                slice(place[p.outputs[0]], place[p.outputs[-1]] + 1),
                p.added,
            )
            for i, p in enumerate(parts)
        ]
        self.following = [
            (i, np.hstack([p.A, p.B]), [place[name] for name in p.inputs]) for i, p in enumerate(parts) if len(p.A)
        ]
        self.signals = np.zeros(len(names))
        self.states = [np.zeros(len(part.A)) for part in parts]

    def step(self, ground: Array) -> float:
        """Return the command for one row (3,) of ground motion."""
        signals, states = self.signals, self.states
        signals[:3] = ground
        for i, matrix, inputs, outputs, added in self.outputs:
            signals[outputs] = matrix @ np.concatenate((states[i], signals[inputs]))
            if added is not None:
                signals[outputs] += added(signals[inputs])
        for i, matrix, inputs in self.following:
            states[i] = matrix @ np.concatenate((states[i], signals[inputs]))
        return float(signals[-1])


def assembled(parts: Sequence[Part]) -> tuple[Array, Array, Array, Array]:
    """Return the whole closed loop of linear parts as A, B, C, D from ground motion to command: what one step makes of
    unit vectors."""
    sizes = [len(part.A) for part in parts]
    n = sum(sizes)
    columns = []
    for unit in np.eye(n + 3):
        stepping = Stepping(parts)
        stepping.states = np.split(unit[:n], np.cumsum(sizes)[:-1])
        command = stepping.step(unit[n:])
        columns.append(np.concatenate([*stepping.states, [command]]))
    whole = np.array(columns).T
    return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def following_samples(table: Part) -> Block:
    """Return the table as a block from a command to the samples one step later."""
    return Block("table", table.A, table.B, table.C @ table.A, table.C @ table.B, 0.0)


@entry
def run_linear(s: Step, table: Linear, drive: Array, commands: Array) -> None:
    """Play the step on a linear table (a block from a command to the samples after it)."""
    for k in range(drive.shape[0]):
        step(s, drive[k])
        note_sent(s)
        commands[k] = s.command[0]
        table.given[table.states] = commands[k]
        table.apply()
        for c in range(s.samples.size):
            s.samples[c] = table.made[table.states + c]


def our_commands(parts: Sequence[Part], blocks: Blocks, ground: Array) -> Callable[[], Array]:
    """Return a function that plays our compiled step on the linear table, without rounding of commands; it returns the
    commands (n,) in V for ground motion (n, 3)."""
    commands = np.zeros(len(ground))
    plain = replace(blocks, shaping_step_v=0.0)

    def run() -> Array:
        run_linear(assemble(plain, NUMERICAL), linear(following_samples(parts[0])), ground, commands)
        return commands

    return run


def numpy_commands(parts: Sequence[Part], ground: Array) -> Array:
    """Return the commands (n,) in V for ground motion (n, 3) by plain numpy."""
    stepping = Stepping(parts)
    return np.array([stepping.step(row) for row in ground])
