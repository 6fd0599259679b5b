"""A hybrid test whose runner stalls, in simulated time: runner and served table, no clock and no network between.

Its accuracy, RMS errors to SIM, which shares no code with the step, stands beside that of a test without a stall.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rths_cli.analysis.metrics import error_figures
from rths_cli.analysis.sim import simulate
from rths_cli.case.load import load_cases
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.experiment.run_signals import Series, on_record_clock, whole_building
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.laboratory.serve import ServedRig, describe, make_table
from rths_cli.loop import realtime_run, udp_target
from rths_cli.loop.fallback_commands import no_foresight
from rths_cli.loop.guard import STOPPED, GuardLimits, GuardState
from rths_cli.loop.realtime_loop import STANDS_V, Course, conduct, leave, look_ahead, pass_by
from rths_cli.loop.realtime_run import Performance
from rths_cli.loop.run_log import Log, Signals, signals, sizes_of
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.loop.step_arrays import NUMERICAL, Step
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp.handshake import open_greeter
from rths_cli.rigs.udp.late_command_trajectory import Way, coast, fresh_way

INTERVAL_NS = 1_000_000
# The plain feedforward: friction is not countered on a rig with a preview of the commands, and with the reaction
# countered the errors of a test without stalls, to which those of a stall are compared, are smaller still.
PREVIEWED = "controller={kind: FF+FB, reaction_feedforward: false, friction_compensation: false}"
MEMORY = Memory()  # the rig of each rate is identified once for all laboratories


@entry
def stalled(
    d: udp_target.Door, t: udp_target.Table, way: Way, course: Course, s: Step, limits: GuardLimits, g: GuardState,
    drive: Array, log: Log, stalls: IntArray, apart: Array, coasts: bool,
) -> int:  # fmt: skip
    """Do what `run_udp` does, the clock set on by as many intervals as `stalls` (n,) says where an exchange is due.

    Return the steps done; `apart` (1,) is how far the table was at most from where the runner took it to stand.
    """
    d, t, way, course, s, limits, g = borrowed((d, t, way, course, s, limits, g))
    drive, log, stalls, apart = borrowed((drive, log, stalls, apart))
    behind, waited, k, command, sent_v, sent_k = 0, 0, 0, 0.0, 0.0, 0
    udp_target.arm(d, t, 0)
    udp_target.sample(t, d.session)
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
            udp_target.advance(d, t, now)
            apart[0] = max(apart[0], abs(t.latched_v[0] - course.drift[STANDS_V]))
            waited, command = 0, leave(course, s, limits, log, way, command, k)
            if coasts:
                coast(way, (command - sent_v) / (k - sent_k), course.coasts)
                sent_v, sent_k = command, k
            for i in range(way.volts.size):
                t.way.volts[i] = way.volts[i]
            for i in range(way.marks.size):
                t.way.marks[i] = way.marks[i]
            udp_target.sample(t, d.session)
            udp_target.obey(d, t, now)
        log.done[0] = k
        command = conduct(course, s, limits, g, drive, log, t.samples, lost, k)
        k += 1
        if behind <= 0:
            look_ahead(course, s, limits, g, drive, log, k)
    log.done[0] = k
    return k


@dataclass(frozen=True)
class Laboratory:
    """A case, what was identified of its rig, and the same rig to be served."""

    setup: Setup
    design: Design
    served: ServedRig

    record: int  # samples that are played

    def run(
        self, at: IntArray, length: int, told: bool = True, limits: GuardLimits | None = None, coasts: bool = False
    ) -> tuple[Performance, float]:
        """Play the case with stalls at some steps, of so many intervals each; return the run, and by how much the
        runner was at most mistaken of where the table stands in V. `told` False: the rig holds what it has, or
        `coasts` as on the plain link."""
        setup, blocks = self.setup, self.design.blocks
        drive = drive_of(setup, self.design)[: self.record]
        info = replace(setup.rig, kind="udp", overrun="skip", limits=replace(setup.rig.limits, lost_samples=200))
        run = realtime_run.prepare(info, blocks, NUMERICAL, drive, limits or guard_limits(setup))
        course = run.course if told else run.course._replace(foresight=no_foresight(3))
        table, stalls, apart = make_table(self.served, INTERVAL_NS), np.zeros(len(run.drive), np.int64), np.zeros(1)
        stalls[at] = length
        nobody = np.zeros(2, np.uint64)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            door = udp_target.open_door(
                link, open_greeter(nobody, 3, 1, 10**9), nobody, INTERVAL_NS, 500_000_000, np.zeros(1, np.int64)
            )
            told_to = (run.step, run.limits, run.guard, run.drive, run.log, stalls, apart, coasts)
            stalled(door, table, fresh_way(), course, *told_to)
        return run, float(apart[0])

    def errors(self, run: Performance) -> Array:
        """Return the RMS errors of a run to SIM, storey by storey, in m/s^2."""
        setup, ramp = self.setup, run.course.ramp
        log, dt = logged(run), setup.rig.dt_s
        outcome = Outcome(log, int(run.log.done[0]), None, "", 0.0)
        whole = on_record_clock(outcome, self.design.blocks.lead_samples, dt, ramp + self.record)
        kept = Series.__dataclass_fields__.keys() - {"live", "removed", "logs"}
        cut = {name: getattr(whole, name)[..., ramp:] for name in kept}
        found = whole_building(setup.building, Series(**cut), setup.motion.accel_m_s2[: self.record], dt)[2]
        return error_figures(self.sim[:, : found.shape[1]], found, dt).rms

    @cached_property
    def sim(self) -> Array:
        return simulate(self.setup.building, self.setup.rig.dt_s, self.setup.motion.accel_m_s2).abs_accel_m_s2


def laboratory_of(record: int) -> Laboratory:
    """Return the laboratory of the example case with a record of so many ms; the rig is identified."""
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], ("sample_rate_hz=1000", PREVIEWED))[0])
    design = design_blocks(setup, MEMORY.identify(setup, lambda _: None))
    served = describe("aps400_virtual", "three_storey", ("sample_rate_hz=1000",), 0)
    return Laboratory(setup, design, served, record)


def logged(run: Performance) -> Signals:
    return signals(run.log, sizes_of(run.step))
