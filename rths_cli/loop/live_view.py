"""Numbers for the live view of a run under way: progress, tracking error, shares of the limits used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.loop.lost_samples import without_samples
from rths_cli.loop.realtime_loop import AT_REST, IN_RAMP_DOWN, IN_RAMP_UP, IN_RUN, OVERRUNS
from rths_cli.loop.realtime_run import Performance
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.numerics.lti import Array

PEAKS = ("desired", "measured", "place", "velocity", "accel", "force", "late", "compute")
STATES = {IN_RAMP_UP: "ramp-up", IN_RUN: "running", IN_RAMP_DOWN: "ramp-down", AT_REST: "stopped"}


@dataclass(frozen=True)
class View:
    """Present state of a run."""

    state: str
    time_s: float  # since the start of the record
    total_s: float  # length of the record
    desired_m_s2: float  # peak so far
    measured_m_s2: float  # peak so far
    error_rms_m_s2: float  # tracking error so far
    used: dict[str, float]  # largest fraction of each limit so far, by its name; without limits that are off
    overruns: int  # intervals
    lost: int  # samples
    late_us: float  # largest delay of a wake-up
    compute_us: float  # longest computing time


class Watching:
    """Evaluate a running loop repeatedly, each time only its new steps."""

    def __init__(self, run: Performance) -> None:
        self._run, self._seen, self._count = run, 0, 0
        self._signals = signals(run.log, sizes_of(run.step))
        self._peaks = dict.fromkeys(
            ("desired", "measured", "place", "velocity", "accel", "force", "late", "compute"), 0.0
        )
        self._squares = 0.0
        self._lost = 0

    def look(self) -> View:
        """Return the present state of the run."""
        done = int(self._run.log.done[0])
        if done > self._seen:
            self._take(slice(self._seen, done), slice(max(self._seen - 1, 0), done))
            self._seen = done
        run, peaks = self._run, self._peaks
        state = int(self._signals.state[done - 1]) if done else IN_RAMP_UP
        return View(
            state=STATES[state],
            time_s=(done - run.course.ramp) * run.info.dt_s,
            total_s=run.course.record * run.info.dt_s,
            desired_m_s2=peaks["desired"],
            measured_m_s2=peaks["measured"],
            error_rms_m_s2=float(np.sqrt(self._squares / max(self._count, 1))),
            used=self._used(),
            overruns=int(run.course.marks[OVERRUNS]),
            lost=self._lost,
            late_us=peaks["late"] * 1e-3,
            compute_us=peaks["compute"] * 1e-3,
        )

    def _take(self, new: slice, joined: slice) -> None:
        """Include new steps; `joined` begins one step earlier, for differences."""
        run, held = self._run, self._signals
        accel = held.corrected[:, new]
        place = run.limits.gain_m_per_v * held.command_v[joined]
        self._most("desired", held.desired[0, new])
        self._most("measured", accel[0])
        self._most("accel", accel.ravel())
        self._most("place", place)
        self._most("velocity", np.diff(place) / run.info.dt_s)
        self._most("force", run.limits.force_weights @ accel)
        self._most("late", held.late_ns[new])
        self._most("compute", held.compute_ns[new])
        self._lost += int(np.count_nonzero(without_samples(held.lost[new])))
        self._take_errors(new)

    def _take_errors(self, new: slice) -> None:
        """Include the tracking errors of new steps of the record; motion desired `lead` steps ago is measured now."""
        lead, held = self._run.step.recent.shape[0] - 1, self._signals
        first = max(new.start, self._run.course.ramp + lead)
        if new.stop > first:
            error = held.desired[0, first - lead : new.stop - lead] - held.corrected[0, first : new.stop]
            error = error[held.state[first : new.stop] == IN_RUN]
            self._squares += float(np.nansum(error**2))
            self._count += error.size

    def _most(self, name: str, values: Array) -> None:
        self._peaks[name] = max(self._peaks[name], float(np.nanmax(np.abs(values), initial=0.0)))

    def _used(self) -> dict[str, float]:
        limits, peaks = self._run.limits, self._peaks
        known = {
            "stroke": (peaks["place"], limits.stroke_m),
            "velocity": (peaks["velocity"], min(limits.velocity_m_s, limits.gain_m_per_v * limits.command_rate_v_s)),
            "acceleration": (peaks["accel"], limits.acceleration_m_s2),
            "force": (peaks["force"], limits.force_n),
        }
        return {name: reached / limit for name, (reached, limit) in known.items() if np.isfinite(limit)}
