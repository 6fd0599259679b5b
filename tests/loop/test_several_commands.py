"""Vectors in the loop: two tables in one run are two runs, on both clocks, and a displacement may be commanded."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, ideal_info, specimen
from hybrid import best_like, ground, open_limits, storeys
from scipy.linalg import block_diag
from test_reference_step import by_reference

from rths_cli.control import numerical_substructure
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Interface, InterfaceForce
from rths_cli.control.state_space import static
from rths_cli.errors import InputError, RigError
from rths_cli.loop import guard as g
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.realtime_run import perform, prepare
from rths_cli.loop.run_log import Sizes, column_names, column_units, signals, sizes_of
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array, Block
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.interface import Commands
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

pytestmark = pytest.mark.campaign

STEPS = 1500
ONE = ideal_info()
TWO = replace(ONE, channels=ONE.channels * 2, actuators=2)


class Tables:
    """Tables side by side, each with an actuator of its own."""

    def __init__(self, info: RigInfo, *rigs: VirtualRig) -> None:
        self.info, self.rigs = info, rigs

    def open(self) -> None: ...

    def arm(self) -> Array:
        return np.concatenate([rig.arm() for rig in self.rigs])

    def exchange(self, command_v: Commands) -> Array:
        return np.concatenate([rig.exchange(v) for rig, v in zip(self.rigs, np.atleast_1d(command_v), strict=True)])

    def rest(self) -> None:
        for rig in self.rigs:
            rig.rest()

    def close(self) -> None: ...


def table() -> VirtualRig:
    return VirtualRig(ONE, build_plant(ONE, LINEAR, specimen(), 0.0, interface_mass_kg=1.2), (0,))


def of_storey(dashpot_n_s_per_m: float) -> Blocks:
    """Return the blocks of one table below one computed storey."""
    numerical = numerical_substructure.interface(storeys(1, dashpot_n_s_per_m, 6.93 - 1.2), ONE.dt_s)
    return replace(best_like(ONE, 1.2), numerical=numerical, open_loop=None, feedback_limit_v=0.05)


def beside(one: Block, other: Block) -> Block:
    """Return two blocks side by side."""
    parts = [block_diag(getattr(one, name), getattr(other, name)) for name in "ABCD"]
    inputs, outputs = (tuple(map(str, range(size))) for size in parts[3].shape[::-1])
    return Block(one.name, *parts, one.dt_s, inputs, outputs)


def by_quantity(block: Block, inputs: int, outputs: int) -> Block:
    """Return two blocks side by side with the inputs, or outputs, of each quantity next to each other."""
    columns, rows = (np.arange(2 * size).reshape(2, size).T.ravel() for size in (inputs, outputs))
    return replace(block, B=block.B[:, columns], C=block.C[rows], D=block.D[np.ix_(rows, columns)])


def both(one: Blocks, other: Blocks) -> Blocks:
    """Return the blocks of two tables in one run, which share nothing but the ground."""
    storeys_of = by_quantity(beside(*(b.numerical.linearised() for b in (one, other))), 2, 3)
    both_grounds = np.hstack([storeys_of.B[:, :2].sum(axis=1)[:, None], storeys_of.B[:, 2:]])
    direct = np.hstack([storeys_of.D[:, :2].sum(axis=1)[:, None], storeys_of.D[:, 2:]])
    forward = beside(one.feedforward.linearised(), other.feedforward.linearised())
    back = beside(one.feedback.linearised(), other.feedback.linearised())
    forces = [b.interface.force for b in (one, other)]
    recent = np.zeros((2, one.lead_samples, 2))
    for i, force in enumerate(forces):
        recent[i, :, i] = force.recent[0, :, 0]
    force = InterfaceForce(
        block_diag(*(f.estimates for f in forces)), recent, block_diag(*(f.samples for f in forces)),
        block_diag(*(f.desired for f in forces)),
    )  # fmt: skip
    return replace(
        one,
        correction=beside(one.correction, other.correction),
        estimator=beside(one.estimator, other.estimator),
        numerical=replace(storeys_of, B=both_grounds, D=direct, inputs=storeys_of.inputs[1:]),
        feedforward=by_quantity(forward, 3, 1),
        feedback=by_quantity(back, 2, 1),
        interface=Interface(force, (0, 3), 2),
    )


def limits(info: RigInfo) -> GuardLimits:
    return open_limits(info)


def assert_twice(pair: Outcome, alone: list[Outcome]) -> None:
    """Assert that each table's signals in one run are those of a run of its own."""
    for i, run in enumerate(alone):
        found = {
            "command_v": pair.log.command_v[i],
            "base_shear_n": pair.log.base_shear_n[i],
            "desired": pair.log.desired[i::2],
            "corrected": pair.log.corrected[3 * i : 3 * i + 3],
        }
        for name, values in found.items():
            wanted = getattr(run.log, name)
            assert np.abs(wanted).max() > 1e-4, name
            np.testing.assert_allclose(values, wanted, rtol=0.0, atol=1e-11 * np.abs(wanted).max(), err_msg=name)


def alone_and_together(drive: Array, limits_of: GuardLimits | None = None) -> tuple[Outcome, list[Outcome]]:
    designs = [of_storey(22.163), of_storey(40.0)]
    alone = [play(Tables(ONE, table()), ONE, one, NUMERICAL, drive, limits(ONE)) for one in designs]
    pair = Tables(TWO, table(), table())
    return play(pair, TWO, both(*designs), NUMERICAL, drive, limits_of or limits(TWO)), alone


def test_two_tables_in_one_run_are_two_runs() -> None:
    pair, alone = alone_and_together(ground(STEPS))
    assert pair.steps == STEPS and pair.log.command_v.shape == (2, STEPS)
    assert_twice(pair, alone)
    assert np.abs(pair.log.command_v[0] - pair.log.command_v[1]).max() > 1e-4


def test_they_are_in_real_time_too() -> None:
    """The loop that is exchanged with from Python, with its ramp-up and its way to rest."""
    designs, drive = [of_storey(22.163), of_storey(40.0)], ground(200)
    pair = prepare(TWO, both(*designs), NUMERICAL, drive, limits(TWO)._replace(stroke_m=0.1), ramp_s=0.05)
    assert perform(Tables(TWO, table(), table()), pair) == ""
    found = signals(pair.log, sizes_of(pair.step))
    for i, design in enumerate(designs):
        run = prepare(ONE, design, NUMERICAL, drive, limits(ONE)._replace(stroke_m=0.1), ramp_s=0.05)
        assert perform(Tables(ONE, table()), run) == ""
        done = int(min(pair.log.done[0], run.log.done[0]))  # the run ends when all tables rest
        wanted = signals(run.log, sizes_of(run.step)).command_v[:done]
        peak = np.abs(wanted).max()
        assert peak > 1e-3
        np.testing.assert_allclose(found.command_v[i, :done], wanted, rtol=0.0, atol=1e-10 * peak)


def test_the_reference_step_computes_both_tables() -> None:
    designs, drive = [of_storey(22.163), of_storey(40.0)], ground(STEPS)
    blocks, rig = both(*designs), Noted(TWO, table(), table())
    outcome = play(rig, TWO, blocks, NUMERICAL, drive, limits(TWO))
    wanted = by_reference(blocks, np.array(rig.given[:STEPS]), drive, numerical=True)
    for name, values in wanted.items():
        found = np.atleast_2d(getattr(outcome.log, name))
        np.testing.assert_allclose(found, values, rtol=0.0, atol=1e-12 * np.abs(values).max(), err_msg=name)


class Noted(Tables):
    """Tables whose samples are kept."""

    def __init__(self, info: RigInfo, *rigs: VirtualRig) -> None:
        super().__init__(info, *rigs)
        self.given: list[Array] = []

    def arm(self) -> Array:
        self.given = [super().arm()]
        return self.given[-1]

    def exchange(self, command_v: Commands) -> Array:
        self.given.append(super().exchange(command_v))
        return self.given[-1]


@pytest.mark.parametrize("number", [0, 1])
def test_the_guard_brakes_all_tables_for_one(number: int) -> None:
    """A floor of one of the tables passes its level: both commands return to zero together."""
    drive, level = ground(4 * STEPS), np.full(6, 1e9)
    peak = np.abs(alone_and_together(drive)[0].log.corrected[3 * number + 2]).max()
    level[3 * number + 2] = 0.5 * peak
    tight = limits(TWO)._replace(abort=level, stroke_m=0.1, velocity_m_s=1.0, acceleration_m_s2=45.0)
    stopped, _ = alone_and_together(drive, tight)
    assert stopped.reason == g.ACCELERATION and "channel" in stopped.stopped_by_limit
    command = stopped.log.command_v[:, round(stopped.stopped_at_s / DT_S) : stopped.steps]
    assert np.abs(command[:, 0]).min() > 1e-3
    assert np.abs(command[:, -1]).max() < 0.01 * np.abs(command[:, 0]).min()
    braking = np.abs(np.diff(command, 2)).max(axis=1) * TWO.gain_m_per_v / DT_S**2
    assert braking.max() <= 1.001 * g.BRAKE_SHARE * 45.0


def test_a_rig_with_one_actuator_takes_no_two_commands() -> None:
    designs = [of_storey(22.163), of_storey(40.0)]
    with pytest.raises(InputError, match="2 commands, but rig bench has 1 actuator"):
        play(Tables(ONE, table(), table()), ONE, both(*designs), NUMERICAL, ground(100), limits(ONE))
    with pytest.raises(RigError, match="2 commands for one actuator"):
        table().exchange(np.zeros(2))
    with pytest.raises(RigError, match="2 actuators, but a rig of kind virtual has one"):
        VirtualRig(TWO, build_plant(ONE, LINEAR, specimen(), 0.0), (0,))


def test_columns_are_numbered_where_there_are_several() -> None:
    names = column_names(Sizes(6, 2, axes=2, actuators=2))
    assert [n for n in names if n.startswith(("command", "base"))] == [
        "command_v_0", "command_v_1", "base_shear_n_0", "base_shear_n_1",
    ]  # fmt: skip
    assert "desired_velocity_m_s_1" in names and len(column_units(names)) == len(names)


class Positioned:
    """A table that goes 97 % of its command an interval later, with a specimen of one floor on a load cell.

    Channels: acceleration of the table over the last interval, its displacement, the force of the load cell.
    """

    mass_kg, stiffness_n_per_m, dashpot_n_s_per_m = 5.0, 4000.0, 20.0

    def __init__(self, info: RigInfo) -> None:
        self.info, self.place_m, self.speed_m_s, self.state = info, 0.0, 0.0, np.zeros(2)
        self.given: list[Array] = []

    def open(self) -> None: ...

    def arm(self) -> Array:
        self.given = [np.zeros(3)]
        return self.given[-1]

    def exchange(self, command_v: Commands) -> Array:
        dt, place = self.info.dt_s, 0.97 * self.info.gain_m_per_v * float(np.asarray(command_v))
        speed = (place - self.place_m) / dt
        accel, self.place_m, self.speed_m_s = (speed - self.speed_m_s) / dt, place, speed
        for _ in range(10):
            x, v = self.state[0] - place, self.state[1] - speed
            pull = -(self.stiffness_n_per_m * x + self.dashpot_n_s_per_m * v) / self.mass_kg
            self.state = self.state + 0.1 * dt * np.array([self.state[1], pull])
        x, v = self.state[0] - place, self.state[1] - speed
        force = self.stiffness_n_per_m * x + self.dashpot_n_s_per_m * v
        self.given.append(np.array([accel, place, force]))
        return self.given[-1]

    def rest(self) -> None: ...

    def close(self) -> None: ...


def displacement_blocks(info: RigInfo) -> Blocks:
    """Return an interface that commands a displacement, measured by channel 1, and takes its force from a load cell."""
    names = ("accel", "place", "force")
    force = InterfaceForce(np.zeros((1, 1)), np.zeros((1, 1, 1)), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 1)))
    gain = 1.0 / info.gain_m_per_v
    return Blocks(
        correction=static(np.eye(3), info.dt_s, "correction", names, names),
        estimator=static(np.zeros((1, 3)), info.dt_s, "estimator", names, ("nothing",)),
        numerical=numerical_substructure.interface(storeys(), info.dt_s),
        feedforward=static(np.array([[0.0, 0.0, gain]]), info.dt_s, "forward", ("a", "v", "d"), ("command_v",)),
        feedback=static(np.array([[0.1 * gain]]), info.dt_s, "back", ("error_m",), ("back_v",)),
        interface=Interface(force, (1,), 1, "displacement"),
    )


def test_a_displacement_may_be_commanded_and_a_load_cell_may_give_the_force() -> None:
    """The error is the displacement's: with feedback the command differs from the feedforward's by a tenth of it."""
    info, drive = replace(ONE, channels=ONE.channels[:3]), ground(STEPS)
    rig, blocks = Positioned(info), displacement_blocks(info)
    outcome = play(rig, info, blocks, NUMERICAL, drive, open_limits(info))
    assert outcome.steps == STEPS and outcome.stopped_by_limit == ""
    wanted = by_reference(blocks, np.array(rig.given[:STEPS]), drive, numerical=True)
    for name, values in wanted.items():
        found = np.atleast_2d(getattr(outcome.log, name))
        np.testing.assert_allclose(found, values, rtol=0.0, atol=1e-12 * np.abs(values).max() + 1e-15, err_msg=name)
    place, shown, gain = outcome.log.desired[2], outcome.log.corrected[1], 1.0 / info.gain_m_per_v
    lead = blocks.lead_samples
    error = np.concatenate([np.zeros(lead), place[:-lead]]) - shown
    assert np.abs(error).max() > 1e-5  # the table falls short of its command
    np.testing.assert_allclose(outcome.log.command_v, gain * (place + 0.1 * error), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(outcome.log.base_shear_n, outcome.log.corrected[2])
    assert np.abs(outcome.log.base_shear_n).max() > 1.0


def test_the_guard_watches_the_error_of_the_displacement() -> None:
    info, drive = replace(ONE, channels=ONE.channels[:3]), ground(STEPS)
    blocks = displacement_blocks(info)
    free = play(Positioned(info), info, blocks, NUMERICAL, drive, open_limits(info))
    error = np.concatenate([[0.0], free.log.desired[2, :-1]]) - free.log.corrected[1]
    tight = open_limits(info)._replace(tracking_error=0.5 * float(np.abs(error).max()), stroke_m=0.1)
    tight = tight._replace(velocity_m_s=10.0, acceleration_m_s2=45.0)
    stopped = play(Positioned(info), info, blocks, NUMERICAL, drive, tight)
    first = int(np.argmax(np.abs(error) > tight.tracking_error))
    assert stopped.reason == g.TRACKING and stopped.stopped_at_s == pytest.approx(first * DT_S)
