"""Hybrid tests with held commands, lost answers and dropouts, with the truth beside what the run's records tell of it.

The runs are those of freezing.py, in simulated time. The true motion is that of the plant under the commands that the
table was given, played once more beside the loop.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from freezing import TICKS, Freezing
from stalling import logged

from rths_cli.analysis.sim import simulate
from rths_cli.experiment import run_metrics
from rths_cli.experiment.check import Uncertain, judge
from rths_cli.experiment.error_after_run import AfterRun, error_after_run
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, Run
from rths_cli.experiment.run_metrics import lowest_reliable_hz
from rths_cli.experiment.run_signals import Series, on_record_clock, whole_building
from rths_cli.laboratory.serve import make_table
from rths_cli.loop.guard import END
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.numerics.clock import IntArray
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array
from rths_cli.rigs.from_case import true_building
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.plant_kernel import Plant, PlantState, fresh_state

TAIL_S = 0.2


@entry
def moved(plant: Plant, state: PlantState, latched: Array, velocity: Array) -> None:
    """Fill in the true velocities (c, n) in the middle of the intervals in which the table was given `latched` V,
    which begin at the second sample."""
    plant, state, latched, velocity = borrowed((plant, state, latched, velocity))
    for k in range(latched.size):
        for tick in range(TICKS):
            plant_kernel.hold(plant, state, latched[k])
            if tick == TICKS // 2 - 1 or tick == TICKS // 2:
                for i in range(velocity.shape[0]):
                    velocity[i, k + 1] += 0.5 * state.middle_velocity[i]


@dataclass(frozen=True)
class Told:
    """RMS errors (n_storeys,) in percent of SIM of the specimen in the run: true, measured, and what is stated."""

    true: Array
    measured: Array
    after: AfterRun

    @property
    def bound(self) -> Array:
        return np.asarray(self.after.values["exp_rths.true_error_bound_percent"])

    @property
    def median(self) -> Array:
        return np.asarray(self.after.values["exp_rths.true_error_median_percent"])


class Disturbed:
    """A laboratory in which one disturbed run is played after the other."""

    def __init__(self, freezing: Freezing, memory: Memory) -> None:
        """What is played last is not judged: the desired motion ends there, and the table comes to rest."""
        motion = freezing.setup.motion
        names = ("time_s", "accel_m_s2", "velocity_m_s", "displacement_m")
        self._samples = freezing.record - round(TAIL_S / freezing.setup.rig.dt_s)
        cut = replace(motion, **{name: getattr(motion, name)[: self._samples] for name in names})
        self.freezing, self._setup, self._memory = freezing, replace(freezing.setup, motion=cut), memory

    @cached_property
    def uncertain(self) -> Uncertain:
        setup = self._setup
        found = judge(setup, self._memory.identify(setup, lambda _: None), self.freezing.design).uncertain
        assert found is not None
        return found

    def told(self, at: IntArray, length: int, mode: int) -> Told | None:
        """Return what is known after a run with no answer for `length` intervals at some steps; None if it stopped."""
        played, latched = self.freezing.run(at, length, mode, lost_samples=400)
        if played.guard.flags[1] != END:
            return None
        setup, ramp, dt = self._setup, played.course.ramp, self._setup.rig.dt_s
        log = logged(played)
        log = replace(log, true_velocity_m_s=self._true_velocity(played, latched, log.command_v.shape[-1]))
        lead = self.freezing.design.blocks.lead_samples
        outcome = Outcome(log, int(played.log.done[0]), None, "", 0.0)
        whole = on_record_clock(outcome, lead, dt, ramp + self.freezing.record)
        kept = Series.__dataclass_fields__.keys() - {"removed", "logs", "live"}
        part = slice(ramp, ramp + self._samples)
        cut = {name: getattr(whole, name)[..., part] for name in kept}
        series = Series(**cut, live={name: one[..., part] for name, one in whole.live.items()})
        building = whole_building(setup.building, series, setup.motion.accel_m_s2, dt)
        run = Run(HYBRID_TEST, lead, series, building)
        there = true_building(setup.case, setup.building)
        assert there is not None
        sim = simulate(there, dt, setup.motion.accel_m_s2).abs_accel_m_s2
        size, true, measured = (
            self._rms(one)
            for one in (sim, series.with_true(building.abs_accel_m_s2) - sim, building.abs_accel_m_s2 - sim)
        )
        return Told(100.0 * true / size, 100.0 * measured / size, error_after_run(self.uncertain, run))

    def _true_velocity(self, played: object, latched: Array, samples: int) -> Array:
        """Return the true velocities (c, samples) in the middle of each interval."""
        setup = self.freezing.setup
        table = make_table(self.freezing.served, played.course.dt_ns)  # type: ignore[attr-defined]
        found = np.zeros((len(setup.rig.channels), samples))
        moved(table.plant, fresh_state(table.plant, 0), np.ascontiguousarray(latched[: samples - 1]), found)
        return found

    def _rms(self, series: Array) -> Array:
        setup = self._setup
        pairs = (np.zeros_like(series), np.ascontiguousarray(series), None)
        lowest, band = lowest_reliable_hz(setup), setup.case.test_band_hz
        found = run_metrics.errors("exp_rths", None, pairs, setup.rig.dt_s, lowest, None, band)
        return np.asarray(found["exp_rths.rms_error_m_s2"])
