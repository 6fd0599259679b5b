"""A hybrid test whose runner stalls, in simulated time: runner and served table, with no clock and no network between.

The oracle is the accuracy of the whole test, RMS errors to SIM, which shares no code with the step, beside those of the
same test without a stall.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest

from rths_cli.analysis.sim import simulate
from rths_cli.case.load import load_cases
from rths_cli.clocks import IntArray
from rths_cli.compiled import entry
from rths_cli.loop import performance, serving
from rths_cli.loop.blocks import NUMERICAL, Step
from rths_cli.loop.drive import Outcome
from rths_cli.loop.foresight import no_foresight
from rths_cli.loop.guard import END, STOPPED, GuardLimits, GuardState
from rths_cli.loop.log import Log, Signals, signals
from rths_cli.loop.performance import Performance
from rths_cli.loop.realtime import STANDS_V, Course, conduct, leave, look_ahead, pass_by
from rths_cli.loop.rejoining import OFF_V
from rths_cli.lti import Array
from rths_cli.metrics import error_figures
from rths_cli.rigs.udp.way import Way, fresh_way
from rths_cli.workflows.controllers import Design, design_blocks
from rths_cli.workflows.known import Memory
from rths_cli.workflows.rigs import guard_limits
from rths_cli.workflows.series import Series, on_record_clock, whole_building
from rths_cli.workflows.serve_table import ServedRig, describe, make_table
from rths_cli.workflows.setup import Setup, make_setup
from rths_cli.workflows.table_runs import drive_of

INTERVAL_NS = 1_000_000
RECORD = 20_000  # samples: 20 s of El Centro, its strong part
STALLED_AT = 1000 + np.array([2_113, 4_871, 7_490, 11_006])  # after the ramp


@entry
def stalled(
    d: serving.Door, t: serving.Table, way: Way, course: Course, s: Step, limits: GuardLimits, g: GuardState,
    drive: Array, log: Log, stalls: IntArray, apart: Array,
) -> int:  # fmt: skip
    """Do what `run_udp` does, the clock set on by as many intervals as `stalls` (n,) says where an exchange is due.

    Return the steps done; `apart` (1,) is how far the table was at most from where the runner took it to stand.
    """
    behind, waited, k, command = 0, 0, 0, 0.0
    serving.arm(d, t, 0)
    serving.sample(t, d.session)
    while k < log.columns.shape[1] and g.flags[0] != STOPPED:
        lost = 0
        if behind > 0:
            lost, waited, behind = 2, waited + 1, behind - 1
            pass_by(course, s, limits, log, way, waited, k)
        elif k > 0:
            if stalls[k - 1] > 0:
                behind, stalls[k - 1] = stalls[k - 1], 0
                continue
            now = (k - 1) * course.dt_ns
            serving.advance(d, t, now)
            apart[0] = max(apart[0], abs(t.latched_v[0] - course.drift[STANDS_V]))
            waited, command = 0, leave(course, s, limits, g, log, way, command, k)
            for i in range(way.volts.size):
                t.way.volts[i] = way.volts[i]
            for i in range(way.marks.size):
                t.way.marks[i] = way.marks[i]
            serving.sample(t, d.session)
            serving.obey(d, t, now)
        log.done[0] = k
        command = conduct(course, s, limits, g, drive, log, t.samples, lost, k)
        k += 1
        if behind <= 0:
            look_ahead(course, s, drive, log, k)
    log.done[0] = k
    return k


@dataclass(frozen=True)
class Laboratory:
    """A case, what was identified of its rig, and the same rig to be served."""

    setup: Setup
    design: Design
    served: ServedRig

    def run(self, length: int, told: bool = True) -> tuple[Performance, float]:
        """Play the case with four stalls of so many intervals; return the run, and how far the runner was at most
        mistaken of where the table stands in V. `told` False: the rig is told nothing of the commands to come."""
        setup, blocks = self.setup, self.design.blocks
        drive = drive_of(setup, self.design)[:RECORD]
        info = replace(setup.rig, kind="udp", overrun="skip", limits=replace(setup.rig.limits, lost_samples=200))
        run = performance.prepare(info, blocks, NUMERICAL, drive, guard_limits(setup))
        course = run.course if told else run.course._replace(foresight=no_foresight(3))
        table, stalls, apart = make_table(self.served, INTERVAL_NS), np.zeros(len(run.drive), np.int64), np.zeros(1)
        stalls[STALLED_AT] = length
        nobody = np.zeros(2, np.uint64)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            door = serving.open_door(link, nobody, nobody, INTERVAL_NS, 500_000_000, np.zeros(1, np.int64))
            told_to = (run.step, run.limits, run.guard, run.drive, run.log, stalls, apart)
            stalled(door, table, fresh_way(), course, *told_to)
        return run, float(apart[0])

    def errors(self, run: Performance) -> Array:
        """Return the RMS errors of a run to SIM, storey by storey, in m/s^2."""
        setup, ramp = self.setup, run.course.ramp
        log, dt = logged(run), setup.rig.dt_s
        outcome = Outcome(log, int(run.log.done[0]), "", "", 0.0)
        whole = on_record_clock(outcome, self.design.blocks.lead_samples, dt, ramp + RECORD)
        cut = {name: getattr(whole, name)[..., ramp:] for name in Series.__dataclass_fields__ if name != "live"}
        found = whole_building(setup.building, Series(**cut), setup.motion.accel_m_s2[:RECORD], dt)[2]
        return error_figures(self.sim[:, : found.shape[1]], found, dt).rms

    @cached_property
    def sim(self) -> Array:
        return simulate(self.setup.building, self.setup.rig.dt_s, self.setup.motion.accel_m_s2).abs_accel_m_s2


def logged(run: Performance) -> Signals:
    return signals(run.log, len(run.info.channels), run.step.estimated.size)


@pytest.fixture(scope="module")
def laboratory() -> Laboratory:
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], ("sample_rate_hz=1000",))[0])
    design = design_blocks(setup, Memory().identify(setup, lambda _: None))
    return Laboratory(setup, design, describe("aps400_virtual", "three_storey", ("sample_rate_hz=1000",), 0))


@pytest.fixture(scope="module")
def calm(laboratory: Laboratory) -> Performance:
    return laboratory.run(0)[0]


@pytest.mark.parametrize("length", [1, 7, 18, 30, 50])
def test_a_stall_within_the_time_foreseen_costs_next_to_no_accuracy(
    laboratory: Laboratory, calm: Performance, length: int
) -> None:
    run, apart = laboratory.run(length)
    assert (logged(run).lost == 2).sum() == length * len(STALLED_AT) and apart == 0.0
    ratio = laboratory.errors(run) / laboratory.errors(calm)
    assert ratio.max() < 1.3, ratio


def test_a_rig_that_is_told_nothing_holds_and_that_shakes_the_building(
    laboratory: Laboratory, calm: Performance
) -> None:
    run, apart = laboratory.run(18, told=False)
    assert apart == 0.0 and (laboratory.errors(run) / laboratory.errors(calm)).min() > 5.0


def test_in_a_stall_longer_than_what_was_told_the_rig_stops_and_comes_back_within_the_limits(
    laboratory: Laboratory, calm: Performance
) -> None:
    """It slows down as hard as the guard brakes, and half as hard again between points; bits alone make 10 m/s^2."""
    run, apart = laboratory.run(150)
    limits, here = run.limits, slice(0, run.course.ramp + RECORD)
    metres = limits.gain_m_per_v * np.array([logged(one).command_v[here] for one in (run, calm)])
    jolts = np.abs(np.diff(metres, 2)) / limits.dt_s**2
    for at in STALLED_AT:
        assert jolts[0, at : at + 148].max() < 1.5 * 0.45 * limits.acceleration_m_s2
        assert (metres[0, at + 115 : at + 150] == metres[0, at + 115]).all()
    assert np.abs(np.diff(metres)).max() / limits.dt_s < limits.velocity_m_s
    assert apart == 0.0 and run.guard.flags[1] == END
    assert np.abs(metres[0] - metres[1])[STALLED_AT + 149].min() > 1e-4
    assert run.course.drift[OFF_V] == 0.0 and jolts[1].max() < 10.0
