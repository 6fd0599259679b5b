"""A hybrid test whose target freezes or whose packets are lost, in simulated time: no clock and no network.

The target is written from docs/reference/udp.md and shares nothing with `rths serve` but the physics of the virtual
table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from ideal_table import storeys_of
from stalling import MEMORY, PREVIEWED, Laboratory, logged

from rths_cli.analysis.metrics import error_figures
from rths_cli.case.load import load_cases
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.laboratory.serve import ServedRig, describe, make_table
from rths_cli.loop import realtime_run
from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.guard import STOPPED, GuardLimits, GuardState
from rths_cli.loop.realtime_loop import Course, conduct, judge, leave, look_ahead
from rths_cli.loop.realtime_run import Performance
from rths_cli.loop.run_log import Log
from rths_cli.loop.step_arrays import NUMERICAL, Step
from rths_cli.loop.stop_reasons import reason_of
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.numerics.lti import Array
from rths_cli.rigs.udp.late_command_trajectory import POINTS, SPACING, Way, fresh_way
from rths_cli.rigs.udp.link import LOST, OK
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.plant_kernel import Plant, PlantState, fresh_state

TICKS = 4  # of the physics in a sample interval
# what a target does while it gets no command: it holds the last one and then jumps to the newest; goes on to the points
# it was told; gets the commands, but its answers are lost; stands still with all its physics, as a paused simulation;
# holds the last one and then approaches the commands
HOLDS, GOES_ON, ANSWERS_LOST, PAUSED, APPROACHES = range(5)
MODES = {
    "holds": HOLDS, "goes on": GOES_ON, "answers lost": ANSWERS_LOST, "paused": PAUSED, "approaches": APPROACHES
}  # fmt: skip
CLOSING_M_S = 45.0 / (4.0 * np.pi * 14.0)  # acceleration limit over twice the rate of the table's loop


@part
def along(volts: Array, points: int, spacing: int, intervals: int) -> float:
    """Return where a command has gone on to (docs/reference/udp.md, "A command that is late")."""
    if points == 0 or intervals >= points * spacing:
        return volts[points]
    i, x = intervals // spacing, (intervals % spacing) / spacing
    p1, p2 = volts[i], volts[i + 1]
    p3 = volts[i + 2] if i + 2 <= points else p1
    p0 = volts[i - 1] if i > 0 else 3.0 * (p1 - p2) + p3
    return p1 + x / 2.0 * (p2 - p0 + x * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + x * (3.0 * p1 - 3.0 * p2 + p3 - p0)))


@part
def approached(held: float, command: float, before: float, passed: int, closing: float) -> float:
    """Return where a target goes that stood at `held` when this command came, so many intervals after the one before
    (docs/reference/udp.md, "A command that is late"); closing in V per interval."""
    most = abs(command - before) / passed + closing
    return held + min(max(command - held, -most), most)


@entry
def frozen(
    plant: Plant, table: PlantState, noise: Array, way: Way, told: Way, course: Course, s: Step, limits: GuardLimits,
    g: GuardState, drive: Array, log: Log, freezes: IntArray, mode: int, latched: Array, samples: Array,
) -> int:  # fmt: skip
    """Play a run whose target gives no answer for as many intervals as `freezes` (n,) says, from a step on.

    `latched` (n,) is what the table was given in each interval, in V. Return the steps done.
    """
    plant, table, noise, way, told, course, s, limits = borrowed((plant, table, noise, way, told, course, s, limits))
    g, drive, log, freezes, latched, samples = borrowed((g, drive, log, freezes, latched, samples))
    k, command, left, since, held, passed, late = 0, 0.0, 0, 0, 0.0, 1, False
    closing = CLOSING_M_S / limits.gain_m_per_v * limits.dt_s
    plant_kernel.read(plant, table, noise[0], samples)
    while k < log.columns.shape[1] and g.flags[0] != STOPPED:
        lost = 0
        if k > 0:
            command = leave(course, s, limits, log, way, command, k)
            if freezes[k - 1] > 0:
                left = freezes[k - 1]
            lost, since = (1, since + 1) if left > 0 else (0, 0)
            if left == 0 or mode != PAUSED:
                plant_kernel.read(plant, table, noise[k % noise.shape[0]], samples)
            if lost == 0 or mode == ANSWERS_LOST:
                late = mode == APPROACHES and (late or passed > 1)
                held = approached(held, command, told.volts[0], passed, closing) if late else command
                late, passed = late and held != command, 1
                for i in range(way.volts.size):
                    told.volts[i] = way.volts[i]
                told.marks[POINTS], told.marks[SPACING] = way.marks[POINTS], way.marks[SPACING]
            elif mode == GOES_ON:
                held = along(told.volts, told.marks[POINTS], told.marks[SPACING], since)
            else:
                passed += 1
            latched[k - 1] = held
            judge(course, g, LOST if lost == 1 else OK)
            if lost == 0 or mode != PAUSED:
                for _ in range(TICKS):
                    plant_kernel.hold(plant, table, held)
            left -= lost
        log.done[0] = k
        command = conduct(course, s, limits, g, drive, log, samples, lost, k)
        k += 1
        look_ahead(course, s, limits, g, drive, log, k)
    log.done[0] = k
    return k


def told(run: Performance) -> str:
    """Return what is told of the guard's reason."""
    cause = cause_of(run.info, run.blocks, run.limits, run.guard, logged(run))
    return reason_of(run.info, run.limits, run.guard, NUMERICAL, cause)


@dataclass(frozen=True)
class Freezing:
    """A case, what was identified of its rig, and the same rig to be served."""

    setup: Setup
    design: Design
    served: ServedRig
    record: int  # samples that are played

    def run(self, at: IntArray, length: int, mode: int, lost_samples: int = 60) -> tuple[Performance, Array]:
        """Play the case with a target that gives no answer for `length` intervals at some steps; return the run and
        what the table was given in V."""
        setup = self.setup
        info = replace(
            setup.rig, kind="udp", overrun="skip", limits=replace(setup.rig.limits, lost_samples=lost_samples)
        )
        drive = drive_of(setup, self.design)[: self.record]
        run = realtime_run.prepare(info, self.design.blocks, NUMERICAL, drive, guard_limits(setup))
        plant = make_table(self.served, run.course.dt_ns).plant
        freezes, latched = np.zeros(len(run.drive), np.int64), np.zeros(len(run.drive))
        freezes[at] = length
        steps = frozen(
            plant, fresh_state(plant, 0), self.served.noise, fresh_way(), fresh_way(), run.course, run.step, run.limits,
            run.guard, run.drive, run.log, freezes, mode, latched, np.zeros(len(info.channels)),
        )  # fmt: skip
        return run, latched[:steps]

    @cached_property
    def laboratory(self) -> Laboratory:
        return Laboratory(self.setup, self.design, self.served, self.record)

    def errors(self, run: Performance) -> Array:
        """Return the RMS errors of a run to SIM, storey by storey, in m/s^2."""
        return self.laboratory.errors(run)

    @property
    def sim(self) -> Array:
        return self.laboratory.sim


def freezing_of(record: int, rate_hz: int, case: str = "el_centro_low_ff_fb", *settings: str) -> Freezing:
    """Return a case to be played for so many samples; the rig is identified."""
    setup = make_setup(load_cases([case], (f"sample_rate_hz={rate_hz}", PREVIEWED, *settings))[0])
    design = design_blocks(setup, MEMORY.identify(setup, lambda _: None))
    served = describe("aps400_virtual", "three_storey", (f"sample_rate_hz={rate_hz}", *settings), 0)
    return Freezing(setup, design, served, record)


def ideal_errors(laboratory: Freezing, at: IntArray, length: int, lag_s: float) -> Array:
    """Return the RMS errors to SIM of an ideal table that is frozen at some steps, storey by storey, in m/s^2.

    `lag_s`: a table follows its command by so much, and so does the freeze.
    """
    dt_s, lead, count = laboratory.setup.rig.dt_s, laboratory.design.blocks.lead_samples, laboratory.record
    motion, ramp = laboratory.setup.motion, round(1.0 / dt_s)
    ground = np.array([motion.displacement_m, motion.velocity_m_s])[:, :count]
    frozen = {int(step) - ramp - lead + round(lag_s / dt_s): float(length) for step in at}
    found = storeys_of(laboratory.setup.building, ground, dt_s, frozen, 0.9)
    return error_figures(laboratory.sim[:, :count], found, dt_s).rms
