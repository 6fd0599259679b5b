"""`Step`: the parts of one step and the signals between them, assembled from the designed blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from rths_cli.control.compensator import CompiledLaw
from rths_cli.control.designed_blocks import Blocks, with_cell
from rths_cli.control.displacement_interface import StoreysOfActuator
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.interface import COMMANDED, Interface, PartDesign
from rths_cli.control.python_parts import PythonFeedforward, PythonSubstructure
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.errors import InputError
from rths_cli.loop.adapted_states import Held, held
from rths_cli.loop.compiled_laws import compiled_command
from rths_cli.loop.linear_parts import (
    Channels,
    OpenLoop,
    channelwise,
    compensated_feedforward,
    dense_storeys,
    kalman_filter,
    linear_feedback,
    linear_feedforward,
    twice,
)
from rths_cli.loop.parts import Feedback, Feedforward, NumericalSubstructure, Observer, Room
from rths_cli.loop.python_parts import called_feedforward, called_substructure
from rths_cli.loop.storey_forces import modal, storeys_and_forces
from rths_cli.numerics.lti import Array, Block

EXCITATION, RECORD, NUMERICAL = 0, 1, 2
ACCELERATION = COMMANDED["acceleration"]
ROOM = 4096  # numbers; a step that remembers more is assembled again in a room of its size

Make = Callable[[Any, Interface, Room], Any]
NUMERICAL_PARTS: dict[type, Make] = {
    Block: modal,
    StoreysWithLaws: storeys_and_forces,
    StoreysOfActuator: dense_storeys,
    PythonSubstructure: called_substructure,
}
FEEDFORWARD_PARTS: dict[type, Make] = {
    Block: linear_feedforward,
    FrictionFeedforward: compensated_feedforward,
    PythonFeedforward: called_feedforward,
    CompiledLaw: compiled_command,
}
FEEDBACK_PARTS: dict[type, Make] = {Block: linear_feedback}
"""What makes the part of the step from each kind of design in `Blocks`; another kind has a method `compiled_part`."""


class Step(NamedTuple):
    """One RTHS step: c accelerometers (table first), f further channels, e estimates, i degrees of freedom of the
    interface, a commands.

    At t_k the hybrid clock is at k + n_p. The interface force there is
    f = force_known + force_recent . d[k .. k+n_p-1] + force_desired d[k+n_p],
    with the desired accelerations d and what the observer knows from samples and estimates.
    """

    source: int  # EXCITATION, RECORD or NUMERICAL
    state: Array  # (n,) all that the step remembers: the parts take their places in it
    deciding: int  # number of its first places that decide the coming commands
    correction: Channels  # raw samples in V (c + f,) -> corrected accelerations (c,), values of the others (f,)
    observer: Observer  # corrected accelerations (c,), load cell -> estimates (e,), known interface force (i,)
    numerical: NumericalSubstructure  # ground motion (3,), interface force (i,) -> interface motion (3, i)
    feedforward: Feedforward  # interface motion (3, i) -> commands in V (a,)
    feedback: Feedback  # tracking errors (i,) -> commands in V (a,)
    open_loop: OpenLoop  # table acceleration, desired and measured -> expected accelerations of the floors
    force_recent: Array  # (i, n_p, i) N per m/s^2
    force_returned: Array  # (i, i) N per m/s^2 that known forces cause, mutual dependence solved
    commanded: int  # row of the motion that the commands are to make: 0 acceleration, 2 displacement
    measured_by: tuple[int, ...]  # (i,) channels that measure the commanded motion; numba knows its length
    actuators: tuple[int, ...]  # (a,) numbers of the commands
    recent: Array  # (n_p + 1, i) desired accelerations at k .. k + n_p
    recent_commanded: Array  # (n_p + 1, i) the same of the commanded motion; the same array for accelerations
    samples: Array  # (c + f,) raw samples in V
    corrected: Array  # (c + f,) in the unit of each channel
    accel: Array  # (c,) the accelerations in it, the same memory
    estimated: Array  # (e,)
    force: Array  # (i,) interface force in N at k + n_p
    free_accel: Array  # (i,) accelerations without the interface force, then with its known part
    motion: Array  # (3, i) desired absolute acceleration, velocity, displacement of the interface at k + n_p
    error: Array  # (i,) tracking errors of t_k, in m/s^2, or in m where displacements are commanded
    command: Array  # (a,) in V
    forward: Array  # (a,) the feedforward's part of it
    back: Array  # (a,) the feedback's part
    back_limits: Array  # (2, a) lowest and highest permitted part of the feedback
    command_limit_v: Array  # (a,) limit of the command, to which the feedback's part is clipped
    feedback_limit_v: Array  # (a,) limit of the feedback's part itself
    carried: Array  # (a,) rounding errors carried over in V
    bit_v: float  # size of a bit (0: commands are not rounded)
    bits_per_v: float
    ripple_m_s2_per_v: float  # alias of the held command in a table sample, per V of command change
    ripple_sum_m_s2_per_v: float  # integral of the alias by the AC correction, per V of the sum of two commands
    sent: Array  # (max(latency, 1) + 1, a) commands that were sent, the latest first
    logged: int  # number of values that the parts log
    expected: Array  # (2, c) what the accelerometers must show by the desired and by the measured motion; 0: nothing
    accelerometers: int  # c
    cell: int  # place of the load cell of the base shear in `corrected`; -1: none
    held: Held  # the parameters of a feedforward that adapts
    cell_reads: Array  # (c,) what it shows per m/s^2 of each accelerometer, in N


def assemble(blocks: Blocks, source: int) -> Step:
    """Return a step at rest for one run of the given source, all of its states in one flat array.

    Raises InputError for a design from which no part can be made.
    """
    floors = 0 if blocks.open_loop is None else len(blocks.open_loop.C)
    if floors >= len(blocks.correction.C):
        raise InputError(
            f"specimen: {floors} floors are expected of {len(blocks.correction.C)} channels, the table's first"
        )
    room = Room(ROOM)
    step = _assembled(blocks, source, room)
    return step if room.taken <= room.all.size else _assembled(blocks, source, Room(room.taken))


def _part(known: dict[type, Make], design: PartDesign, interface: Interface, room: Room) -> Any:
    """Return the part of a design at rest; raises InputError for one that cannot be in a step."""
    if not design.affine:
        raise InputError(f"{design.name}: its outputs are not affine in the inputs of the same instant; hold the input")
    makers: list[Any] = [known[one] for one in type(design).__mro__ if one in known]
    makers.append(getattr(type(design), "compiled_part", None))
    if makers[0] is None:
        kinds, kind = " or ".join(one.__name__ for one in known), type(design).__name__
        raise InputError(f"{design.name}: a {kind} cannot stand in this place of the step; use a {kinds}")
    return makers[0](design, interface, room)


def _assembled(blocks: Blocks, source: int, room: Room) -> Step:
    own, lead = len(blocks.correction.C), blocks.lead_samples
    further, cell = blocks.further, blocks.cell
    estimator, sensed = (blocks.estimator, blocks.interface) if cell is None else with_cell(blocks, cell)
    interface = blocks.interface
    force, count, commands = interface.force, len(interface.channels), interface.actuators
    correction = channelwise((blocks.correction,) if further is None else (blocks.correction, further), room)
    channels = len(correction.given)
    observer = kalman_filter(estimator, sensed, room, own, channels)
    numerical = _part(NUMERICAL_PARTS, blocks.numerical, interface, room)
    coupled = np.eye(count) - numerical.direct @ force.desired
    feedforward = _part(FEEDFORWARD_PARTS, blocks.feedforward, interface, room)
    feedback = _part(FEEDBACK_PARTS, blocks.feedback, interface, room)
    size, commanded, recent = blocks.shaping_step_v, COMMANDED[interface.commanded], room.take(lead + 1, count)
    recent_commanded = recent if commanded == ACCELERATION else room.take(lead + 1, count)
    samples, sent = room.take(channels), room.take(max(blocks.latency_samples, 1) + 1, commands)
    deciding = room.taken
    open_loop, carried = twice(blocks.open_loop, room), room.take(commands)
    return Step(
        source=source,
        state=room.all[: room.taken],
        deciding=deciding,
        correction=correction,
        observer=observer,
        numerical=numerical,
        feedforward=feedforward,
        feedback=feedback,
        open_loop=open_loop,
        force_recent=np.ascontiguousarray(force.recent, dtype=float),
        force_returned=np.ascontiguousarray(np.linalg.solve(coupled.T, force.desired.T).T),
        commanded=commanded,
        measured_by=interface.channels,
        actuators=interface.commands,
        recent=recent,
        recent_commanded=recent_commanded,
        samples=samples,
        corrected=observer.corrected,
        accel=observer.corrected[:own],
        estimated=observer.estimated,
        force=np.zeros(count),
        free_accel=np.zeros(count),
        motion=np.zeros((3, count)),
        error=np.zeros(count),
        command=np.zeros(commands),
        forward=np.zeros(commands),
        back=np.zeros(commands),
        back_limits=np.zeros((2, commands)),
        command_limit_v=np.full(commands, float(blocks.command_limit_v)),
        feedback_limit_v=np.full(commands, float(blocks.feedback_limit_v)),
        carried=carried,
        bit_v=size,
        bits_per_v=1.0 / size if size > 0.0 else 0.0,
        ripple_m_s2_per_v=float(blocks.ripple_m_s2_per_v),
        ripple_sum_m_s2_per_v=float(blocks.ripple_sum_m_s2_per_v),
        sent=sent,
        logged=numerical.logged.size + feedforward.logged.size + feedback.logged.size,
        expected=np.zeros((2, own)),
        accelerometers=own,
        cell=-1 if cell is None else own + cell.channel,
        held=held(
            getattr(blocks.feedforward, "adapted", None),
            getattr(feedforward, "state", np.zeros(0)),
            feedforward.logged,
            commands,
        ),
        cell_reads=np.zeros(own) if cell is None else cell.reads.copy(),
    )
