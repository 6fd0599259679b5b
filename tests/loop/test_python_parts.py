"""A Python object in the place of a compiled part: the same run, a fault that stops the test, what it logs."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, ideal_info, specimen
from hybrid import best_like, ground, open_limits
from portfolio import parametrize_first
from python_models import Inverse, Storeys

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Logged
from rths_cli.control.python_parts import PythonFeedforward, PythonSubstructure
from rths_cli.errors import InputError
from rths_cli.loop import step_arrays
from rths_cli.loop.guard import VELOCITY
from rths_cli.loop.realtime_run import prepare, rehearse
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL, assemble
from rths_cli.numerics.lti import Array
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

INFO = ideal_info()


def played(blocks: Blocks, steps: int = 1500) -> Outcome:
    rig = VirtualRig(INFO, build_plant(INFO, LINEAR, specimen(), 0.0, interface_mass_kg=1.2), (0,))
    return play(rig, INFO, blocks, NUMERICAL, ground(steps), open_limits(INFO))


def linear_blocks() -> Blocks:
    return best_like(INFO, 1.2)


@pytest.mark.campaign
def test_storeys_in_python_move_as_the_compiled_ones() -> None:
    blocks = linear_blocks()
    block = blocks.numerical.linearised()
    logs = (Logged("storey_1_rel_disp", "m"),)
    python = replace(blocks, numerical=PythonSubstructure("storeys in numpy", lambda: Storeys(block), block, logs))
    compiled, called = played(blocks), played(python)
    for name in ("command_v", "base_shear_n", "desired", "corrected"):
        wanted, found = getattr(compiled.log, name), getattr(called.log, name)
        assert np.abs(found - wanted).max() <= 1e-11 * np.abs(wanted).max(), name
    assert called.stopped_by_limit == "" and [one.name for one in called.logs] == ["storey_1_rel_disp"]
    assert called.log.logged.shape == (1, 1500) and np.ptp(called.log.logged) > 1e-5
    assert compiled.log.logged.shape == (0, 1500)


@pytest.mark.campaign
def test_a_feedforward_in_python_gives_the_same_command() -> None:
    blocks = linear_blocks()
    block = blocks.feedforward.linearised()
    called = played(replace(blocks, feedforward=PythonFeedforward("inverse in numpy", lambda: Inverse(block))))
    wanted = played(blocks).log.command_v
    assert np.abs(called.log.command_v - wanted).max() <= 1e-11 * np.abs(wanted).max()


@pytest.mark.campaign
def test_a_model_that_fails_stops_the_test_and_is_named() -> None:
    """The guard brings the table to rest; what the model raised is the reason, and it is not called again."""
    blocks = linear_blocks()
    model = Storeys(blocks.numerical.linearised(), fails_at=700)
    outcome = played(replace(blocks, numerical=PythonSubstructure("storeys in numpy", lambda: model)))
    assert outcome.stopped_by_limit == "storeys in numpy failed: RuntimeError: the model does not converge"
    assert outcome.stopped_at_s == pytest.approx(699 * DT_S) and model.k == 700
    assert np.isfinite(outcome.log.command_v[: outcome.steps]).all()


def test_a_part_without_a_linear_block_cannot_be_judged() -> None:
    blocks = replace(
        linear_blocks(), feedforward=PythonFeedforward("a trial", lambda: Inverse(linear_blocks().named()[3]))
    )
    with pytest.raises(InputError, match="a trial cannot be judged"):
        blocks.linear_parts()


@pytest.mark.campaign
def test_a_rehearsal_calls_it_in_every_step() -> None:
    """So what the rehearsal measures holds the calls into Python."""
    model = Storeys(linear_blocks().numerical.linearised())
    python = replace(linear_blocks(), numerical=PythonSubstructure("storeys in numpy", lambda: model))
    rehearse(prepare(INFO, python, NUMERICAL, ground(50), open_limits(INFO), ramp_s=0.0), 0.02)
    assert model.k == round(0.02 / DT_S)


@pytest.mark.campaign
def test_a_model_starts_anew_in_each_run() -> None:
    blocks = linear_blocks()
    block = blocks.numerical.linearised()
    python = replace(blocks, numerical=PythonSubstructure("storeys in numpy", lambda: Storeys(block)))
    first, second = (played(python, 300).log.command_v for _ in range(2))
    assert (first == second).all() and np.ptp(first) > 0.01


@pytest.mark.campaign
def test_the_calls_of_an_earlier_step_stay_callable() -> None:
    """Compiled code knows their addresses only: a second step of the same design must not free them."""
    blocks = linear_blocks()
    block = blocks.numerical.linearised()
    python = replace(blocks, numerical=PythonSubstructure("storeys in numpy", lambda: Storeys(block)))
    run = prepare(INFO, python, NUMERICAL, ground(50), open_limits(INFO), ramp_s=0.0)
    for _ in range(20):
        assemble(python, NUMERICAL)
    gc.collect()
    rehearse(run, 0.02)
    assert python.fault() == "" and run.log.done[0] > 0


@pytest.mark.campaign
@parametrize_first(
    1,
    ("wrong", "says"),
    [
        (np.zeros(3), "advance gave an array of shape (3,), (3, 1) is needed"),
        (None, "advance gave an array of shape (), (3, 1) is needed"),
        (np.full((3, 1), np.nan), "advance gave a number that is not finite"),
    ],
)
def test_what_a_model_gives_is_looked_at(wrong: object, says: str) -> None:
    class Wrong(Storeys):
        def advance(self, ground: Array, force: Array) -> Array:
            super().advance(ground, force)
            return wrong  # type: ignore[return-value]

    blocks = linear_blocks()
    block = blocks.numerical.linearised()
    outcome = played(replace(blocks, numerical=PythonSubstructure("storeys", lambda: Wrong(block))), 100)
    assert outcome.stopped_by_limit == f"storeys failed: ValueError: {says}"


def test_a_fault_after_a_stop_of_the_guard_is_not_its_reason() -> None:
    """The part is called while the table is led to rest, too."""
    blocks = linear_blocks()
    model = Storeys(blocks.numerical.linearised(), fails_at=900)
    python = replace(blocks, numerical=PythonSubstructure("storeys", lambda: model))
    rig = VirtualRig(INFO, build_plant(INFO, LINEAR, specimen(), 0.0, interface_mass_kg=1.2), (0,))
    limits = open_limits(INFO)._replace(velocity_m_s=1e-3, stroke_m=0.08, acceleration_m_s2=0.5)
    outcome = play(rig, INFO, python, NUMERICAL, ground(1500), limits)
    assert python.fault() and outcome.reason == VELOCITY and "velocity" in outcome.stopped_by_limit


def test_an_interrupt_during_a_call_is_raised_when_the_table_rests() -> None:
    class Interrupted(Storeys):
        def advance(self, ground: Array, force: Array) -> Array:
            raise KeyboardInterrupt

    blocks = linear_blocks()
    block = blocks.numerical.linearised()
    with pytest.raises(KeyboardInterrupt):
        played(replace(blocks, numerical=PythonSubstructure("storeys", lambda: Interrupted(block))), 100)


def test_a_part_in_the_wrong_place_and_more_commands_than_actuators_are_refused() -> None:
    blocks = linear_blocks()
    block = blocks.feedforward.linearised()
    misplaced = replace(blocks, numerical=PythonFeedforward("inverse", lambda: Inverse(block)))
    with pytest.raises(InputError, match="inverse: a PythonFeedforward cannot stand in this place"):
        assemble(misplaced, NUMERICAL)
    with pytest.raises(InputError, match="2 commands"):
        played(replace(blocks, interface=replace(blocks.interface, actuators=2)))


def test_a_step_that_remembers_much_is_assembled_in_a_room_of_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    usual, wanted = assemble(linear_blocks(), NUMERICAL), played(linear_blocks(), 300).log.command_v
    monkeypatch.setattr(step_arrays, "ROOM", usual.state.size - 1)
    tight = assemble(linear_blocks(), NUMERICAL)
    assert tight.state.size == usual.state.size and np.shares_memory(tight.state, tight.sent)
    assert (played(linear_blocks(), 300).log.command_v == wanted).all()
