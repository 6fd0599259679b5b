"""A feedback whose part of the command is limited: what is applied, what its observer knows, and how it recovers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, held, ideal_info, linear_table, rig_info, specimen
from hybrid import best_like, ground, open_limits, paper_like, true_model

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control import feedback
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.feedback import DEFAULT
from rths_cli.control.state_space import static
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL, RECORD, assemble
from rths_cli.numerics.lti import Array, Block
from rths_cli.numerics.matrix_equations import riccati_gain
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

NOISE, LIMIT_V = 1.0, 0.4
STEPS, ENDS = 3000, 1000


class DisturbedTable:
    """The linear table with one sample of latency, whose accelerometer also sees a disturbance (n,) in m/s^2."""

    def __init__(self, info: RigInfo, disturbance: Array) -> None:
        self.info, self.disturbance = info, disturbance
        a, b, self.sensed, _ = linear_table(LINEAR, specimen(), info.channels[0].low_pass_hz)
        self.step, self.drive = held(a, b, DT_S)

    def open(self) -> None: ...

    def arm(self) -> Array:
        self.state, self.waiting, self.k = np.zeros(len(self.step)), 0.0, 0
        return self.samples()

    def samples(self) -> Array:
        accel = self.sensed @ self.state
        accel[0] += self.disturbance[self.k]
        return accel * self.info.channels[0].sensitivity_v_per_unit

    def exchange(self, command_v: float) -> Array:
        self.state = self.step @ self.state + self.drive * self.waiting
        self.waiting, self.k = command_v, min(self.k + 1, len(self.disturbance) - 1)
        return self.samples()

    def rest(self) -> None: ...

    def close(self) -> None: ...


def push() -> Array:
    """Return a disturbance of 2 Hz that ends after half a second, at a level that asks for far more than is allowed."""
    time = DT_S * np.arange(STEPS)
    return np.where(np.arange(STEPS) < ENDS, 40.0 * np.sin(2.0 * np.pi * 2.0 * time), 0.0)


def pushed(blocks: Blocks) -> Array:
    """Return the command (n,) of a table that is to stand still while it is disturbed."""
    info = ideal_info(latency_samples=1)
    outcome = play(DisturbedTable(info, push()), info, blocks, RECORD, np.zeros((STEPS, 3)), open_limits(info))
    assert outcome.stopped_by_limit == ""
    return outcome.log.command_v


def reference(limit_v: float) -> Array:
    """Return the command by the regulator's equations: observer, state feedback, clipped command, table, sensors."""
    info, model = ideal_info(latency_samples=1), true_model(1.5 * DT_S)
    blocks, channel = best_like(info), info.channels[0]
    a, b, c, d, drive, drive_direct = feedback.lqg_plant(feedback.sampled_table(model, DT_S), DT_S, DEFAULT)
    gain = feedback.regulator_gain(model, (a, b, c, d, drive, drive_direct), DEFAULT)[0]
    variance = drive_direct @ drive_direct.T + NOISE**2
    observer = riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ drive_direct.T)[0]
    ta, tb, sensed, _ = linear_table(LINEAR, specimen(), channel.low_pass_hz)
    step, into = held(ta, tb, DT_S)
    table, estimate, corrector = np.zeros(len(ta)), np.zeros(len(a)), np.zeros(len(blocks.correction.A))
    sent, disturbance, commands = [0.0, 0.0], push(), np.zeros(STEPS)
    share, low = 1.0 - np.exp(-2.0 * np.pi * 0.1 * DT_S), 0.0  # of the high pass, which sums what was applied
    for k in range(STEPS):
        sample = sensed @ table
        sample[0] += disturbance[k]
        sample = sample * channel.sensitivity_v_per_unit
        accel = (blocks.correction.C @ corrector + blocks.correction.D @ sample)[0]
        accel -= blocks.ripple_m_s2_per_v * (sent[0] - sent[1]) + blocks.ripple_sum_m_s2_per_v * (sent[0] + sent[1])
        corrector = blocks.correction.A @ corrector + blocks.correction.B @ sample
        applied = np.clip(-gain @ estimate - low, -limit_v, limit_v)
        through = applied + low  # the command before the high pass, as far as it was applied
        innovation = accel - c[0] @ estimate - d[0, 0] * through
        low += share * applied
        estimate = a @ estimate + b[:, 0] * through + observer * innovation
        table = step @ table + into * sent[0]
        sent, commands[k] = [applied, sent[0]], applied
    return commands


@pytest.mark.parametrize("limit_v", [LIMIT_V, 1e9])
def test_the_limited_feedback_is_the_regulator_whose_observer_knows_the_applied_command(limit_v: float) -> None:
    found = pushed(replace(best_like(ideal_info(latency_samples=1)), feedback_limit_v=limit_v))
    wanted = reference(limit_v)
    assert np.abs(found - wanted).max() <= 1e-9 * np.abs(wanted).max()
    clipped = np.count_nonzero(np.abs(found) == limit_v)
    assert clipped > 300 if limit_v == LIMIT_V else clipped == 0


def last_at_limit_s(command_v: Array) -> float:
    """Return how long after the disturbance's end the command was last at its limit."""
    return float((np.flatnonzero(np.abs(command_v) == LIMIT_V).max() + 1 - ENDS) * DT_S)


def test_a_feedback_that_knows_recovers_with_its_observer_and_one_that_does_not_winds_up() -> None:
    """The observer forgets the disturbed table within some 10 ms; what it was never told keeps it wrong for 0.5 s."""
    blocks = replace(best_like(ideal_info(latency_samples=1)), feedback_limit_v=LIMIT_V)
    a, _, c, _, drive, direct = feedback.lqg_plant(feedback.sampled_table(true_model(1.5 * DT_S), DT_S), DT_S, DEFAULT)
    variance = direct @ direct.T + NOISE**2
    observer = riccati_gain(a.T, c.T, drive @ drive.T, variance, drive @ direct.T).T
    sizes = np.abs(np.linalg.eigvals(a - observer @ c))
    constants_s = -DT_S / np.log(sizes[sizes > 0.5])  # beyond 0.1 s: the disturbance's band and the specimen
    table_s = constants_s[constants_s < 0.1].max()
    told = pushed(blocks)
    untold = pushed(replace(blocks, feedback=feedback.unlimited(blocks.feedback)))
    assert table_s == pytest.approx(0.0097, abs=2e-4)
    assert 0.0 < last_at_limit_s(told) < 3.0 * table_s
    assert last_at_limit_s(untold) > 15.0 * last_at_limit_s(told)
    later = slice(ENDS + round(0.3 / DT_S), ENDS + round(0.6 / DT_S))
    assert np.abs(told[later]).mean() < 0.2 * np.abs(untold[later]).mean()


def with_feedback(info: RigInfo) -> Blocks:
    """Return the printed method with feedback."""
    model = true_model((info.latency_samples + 0.5) * DT_S)
    return replace(paper_like(info), feedback=feedback.lqg(model, 3.0, DT_S))


def everything(outcome: Outcome) -> list[bytes]:
    log = outcome.log
    return [part.tobytes() for part in (log.command_v, log.desired, log.corrected, log.estimated, log.base_shear_n)]


@pytest.mark.campaign
@pytest.mark.parametrize("make", [best_like, with_feedback, paper_like])
def test_limits_that_nothing_reaches_change_no_byte(make: object) -> None:
    info = rig_info()
    blocks = replace(make(info), shaping_step_v=info.converters.step_v)
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (1, 3))
    free = play(rig, info, blocks, NUMERICAL, ground(4000), open_limits(info))
    assert free.steps == 4000
    reached = float(np.abs(free.log.command_v).max())
    assert 0.001 < reached < 10.0
    variants = [
        replace(blocks, command_limit_v=reached + info.converters.step_v, feedback_limit_v=reached + 1.0),
        replace(blocks, feedback=feedback.unlimited(blocks.feedback)),
    ]
    for other in variants:
        assert everything(play(rig, info, other, NUMERICAL, ground(4000), open_limits(info))) == everything(free)


def standing(forward_v: float, feedback_limit_v: float = np.inf) -> tuple[Outcome, Array]:
    """Return a pushed table whose feedforward asks for a constant command, range 1 V, and the part of the feedback."""
    info = ideal_info(latency_samples=1)
    forward = static(np.array([[0.0, 0.0, 1.0]]), DT_S, "feedforward", (), ())
    blocks = replace(
        best_like(info),
        feedforward=forward,
        command_limit_v=0.99,
        feedback_limit_v=feedback_limit_v,
        ripple_m_s2_per_v=0.0,
    )
    drive = np.tile([0.0, 0.0, forward_v], (STEPS, 1))
    limits = open_limits(info)._replace(command_v=1.0)
    outcome = play(DisturbedTable(info, push()), info, blocks, RECORD, drive, limits)
    return outcome, outcome.log.command_v - forward_v


@pytest.mark.parametrize("forward_v", [0.0, 0.9, -0.9])
def test_the_feedback_takes_what_the_feedforward_leaves_of_the_range(forward_v: float) -> None:
    outcome, _ = standing(forward_v)
    assert outcome.stopped_by_limit == ""
    assert outcome.log.command_v.max() == pytest.approx(0.99, abs=1e-15)
    assert outcome.log.command_v.min() == pytest.approx(-0.99, abs=1e-15)


@pytest.mark.parametrize("forward_v", [0.0, 0.9])
def test_a_share_of_its_own_limits_the_feedback_further(forward_v: float) -> None:
    outcome, part = standing(forward_v, 0.3)
    assert outcome.stopped_by_limit == ""
    assert part.min() == pytest.approx(-0.3, abs=1e-15)
    assert part.max() == pytest.approx(min(0.3, 0.99 - forward_v), abs=1e-15)


@pytest.mark.parametrize("forward_v", [1.2, -1.2])
def test_a_feedforward_beyond_the_range_is_left_to_the_guard(forward_v: float) -> None:
    """At rest the feedback has nothing to say, and is not made to hide what the feedforward asks for."""
    outcome, _ = standing(forward_v)
    assert outcome.stopped_by_limit.startswith("command beyond the converter's range (")
    assert outcome.stopped_at_s == 0.0


def test_a_feedback_gone_wrong_reaches_the_guard_as_not_a_number() -> None:
    info = ideal_info(latency_samples=1)
    blocks = replace(best_like(info), command_limit_v=1.0, feedback_limit_v=0.5)
    wrong = replace(blocks.feedback, C=np.full_like(blocks.feedback.C, np.nan))
    table = DisturbedTable(info, push())
    drive = np.zeros((10, 3))
    outcome = play(table, info, replace(blocks, feedback=wrong), RECORD, drive, open_limits(info))
    assert outcome.stopped_by_limit.startswith("a sample or the command is not a number (rths check")
    assert (outcome.log.command_v[: outcome.steps] == 0.0).all()


def test_a_block_that_takes_the_error_alone_gets_nothing_else() -> None:
    blocks = best_like(rig_info())
    assert assemble(blocks, RECORD).feedback.shortfall.shape[0] == 1
    alone = Block("feedback", *(np.zeros(s) for s in ((0, 0), (0, 1), (1, 0), (1, 1))), DT_S)
    assert assemble(replace(blocks, feedback=alone), RECORD).feedback.shortfall.shape[0] == 0
