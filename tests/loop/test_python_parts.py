"""A Python object in the place of a compiled part: the same run, a fault that stops the test, what it logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, ideal_info, specimen
from hybrid import best_like, ground, open_limits

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.part_designs import Logged
from rths_cli.control.python_parts import PythonFeedforward, PythonSubstructure
from rths_cli.errors import InputError
from rths_cli.loop.realtime_run import prepare, rehearse
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array, Block
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

INFO = ideal_info()


class Storeys:
    """The linear storeys of a block, in numpy."""

    def __init__(self, block: Block, fails_at: int = -1) -> None:
        self.block, self.x, self.k, self.fails_at = block, np.zeros(len(block.A)), 0, fails_at
        self.direct, self.logged = block.D[:1, 1:], np.zeros(1)

    def free(self, ground: Array) -> Array:
        return self.block.C[:1] @ self.x + self.block.D[:1, 0] * ground[0]

    def advance(self, ground: Array, force: Array) -> Array:
        self.k += 1
        if self.k == self.fails_at:
            raise RuntimeError("the model does not converge")
        inputs = np.array([ground[0], force[0]])
        motion = self.block.C @ self.x + self.block.D @ inputs + np.array([0.0, ground[1], ground[2]])
        self.x = self.block.A @ self.x + self.block.B @ inputs
        self.logged[0] = self.x[0]
        return motion[:, None]


class Inverse:
    """A linear feedforward block in numpy."""

    def __init__(self, block: Block) -> None:
        self.block, self.x = block, np.zeros(len(block.A))

    def command(self, motion: Array, corrected: Array, sent: Array) -> Array:
        command = self.block.C @ self.x + self.block.D @ motion[:, 0]
        self.x = self.block.A @ self.x + self.block.B @ motion[:, 0]
        return command


def played(blocks: Blocks, steps: int = 1500) -> Outcome:
    rig = VirtualRig(INFO, build_plant(INFO, LINEAR, specimen(), 0.0, interface_mass_kg=1.2), (0,))
    return play(rig, INFO, blocks, NUMERICAL, ground(steps), open_limits(INFO))


def linear_blocks() -> Blocks:
    return best_like(INFO, 1.2)


def test_storeys_in_python_move_as_the_compiled_ones() -> None:
    blocks = linear_blocks()
    block = blocks.numerical.linearised()
    logs = (Logged("storey_1_rel_disp", "m"),)
    python = replace(blocks, numerical=PythonSubstructure("storeys in numpy", Storeys(block), block, logs))
    compiled, called = played(blocks), played(python)
    for name in ("command_v", "base_shear_n", "desired", "corrected"):
        wanted, found = getattr(compiled.log, name), getattr(called.log, name)
        assert np.abs(found - wanted).max() <= 1e-11 * np.abs(wanted).max(), name
    assert called.stopped_by_limit == "" and called.logs == logs
    assert called.log.logged.shape == (1, 1500) and np.ptp(called.log.logged) > 1e-5
    assert compiled.log.logged.shape == (0, 1500)


def test_a_feedforward_in_python_gives_the_same_command() -> None:
    blocks = linear_blocks()
    block = blocks.feedforward.linearised()
    called = played(replace(blocks, feedforward=PythonFeedforward("inverse in numpy", Inverse(block))))
    wanted = played(blocks).log.command_v
    assert np.abs(called.log.command_v - wanted).max() <= 1e-11 * np.abs(wanted).max()


def test_a_model_that_fails_stops_the_test_and_is_named() -> None:
    """The guard brings the table to rest; what the model raised is the reason, and it is not called again."""
    blocks = linear_blocks()
    model = Storeys(blocks.numerical.linearised(), fails_at=700)
    outcome = played(replace(blocks, numerical=PythonSubstructure("storeys in numpy", model)))
    assert outcome.stopped_by_limit == "storeys in numpy failed: RuntimeError: the model does not converge"
    assert outcome.stopped_at_s == pytest.approx(699 * DT_S) and model.k == 700
    assert np.isfinite(outcome.log.command_v[: outcome.steps]).all()


def test_a_part_without_a_linear_block_cannot_be_judged() -> None:
    blocks = replace(linear_blocks(), feedforward=PythonFeedforward("a trial", Inverse(linear_blocks().named()[3])))
    with pytest.raises(InputError, match="a trial cannot be judged"):
        blocks.linear_parts()


def test_a_rehearsal_calls_it_in_every_step() -> None:
    """So what the rehearsal measures holds the calls into Python."""
    model = Storeys(linear_blocks().numerical.linearised())
    python = replace(linear_blocks(), numerical=PythonSubstructure("storeys in numpy", model))
    rehearse(prepare(INFO, python, NUMERICAL, ground(50), open_limits(INFO), ramp_s=0.0), 0.02)
    assert model.k == round(0.02 / DT_S)
