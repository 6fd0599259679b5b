"""Play table runs whose sensors die, stick or flip at the peak of their motion, and judge where the table went."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from bare_rig import BareRig

from rths_cli.experiment.design import Design
from rths_cli.experiment.one_table_run import HYBRID_TEST, SHAKE_TABLE_TEST, RunKind, RunPlan, drive_of, plan_run
from rths_cli.experiment.planned_motion import planned_motion
from rths_cli.experiment.real_rig_readiness import open_virtual
from rths_cli.experiment.setup import Setup
from rths_cli.identification.results import Identification
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import Rig

DEAD, STUCK, FLIPPED = KINDS = ("dead", "stuck", "flipped")
MORE, FURTHER_M = 1.5, 1e-3  # a table may go this many times as far as in the healthy run, or that much farther
REST_S, AT_REST_M = 2.0, 1e-3
BOTH = (SHAKE_TABLE_TEST, HYBRID_TEST)


class Watched(BareRig):
    """A virtual rig of which the true displacement is written down; one channel fails from a step on."""

    def __init__(self, rig: Rig, kind: str = "", channel: int = 0, at: int = 10**9) -> None:
        super().__init__(rig)
        self._kind, self._channel, self._at, self._kept = kind, channel, at, np.nan
        self.place_m: list[float] = []

    def exchange(self, command_v: float) -> Array:
        samples = super().exchange(command_v)
        self.place_m.append(float(self._rig.state.state[0]))  # type: ignore[attr-defined]
        return samples

    def shown(self, samples: Array) -> Array:
        step, c = len(self.samples), self._channel
        if step == self._at:
            self._kept = samples[c]
        if step >= self._at:
            samples[c] = {DEAD: 0.0, STUCK: self._kept, FLIPPED: -samples[c]}[self._kind]
        return samples


@dataclass(frozen=True)
class Ended:
    """How a run with one faulty channel ended."""

    run: str
    kind: str
    channel: str
    healthy_m: float  # largest displacement of the healthy run
    reached_m: float  # largest displacement after the fault
    seconds: float  # from the fault to the guard's stop; NaN: it never stopped
    rest_s: float  # from there to rest
    sentence: str

    @property
    def stays(self) -> bool:
        """Return whether the table stayed where it may."""
        return self.reached_m <= max(MORE * self.healthy_m, self.healthy_m + FURTHER_M)

    @property
    def rests(self) -> bool:
        """Return whether the table was at rest in time."""
        return not self.rest_s > REST_S

    @property
    def named(self) -> str:
        """Return whether the true sensor is named: "true", "group", "false", "none", or "not stopped"."""
        if np.isnan(self.seconds):
            return "not stopped"
        first = self.sentence.partition(": ")[0] if "channel" in self.sentence.partition(": ")[0] else self.sentence
        others = first.replace(f"channel {self.channel}", "").replace(f" {self.channel} ", "")
        if self.channel not in first:
            return "false" if "channel" in first else "none"
        return "group" if "channels" in first or " or " in others.partition("(")[0] else "true"


def planned(setup: Setup, identified: Identification, design: Design, kind: RunKind) -> RunPlan:
    """Return the plan of a run with the guard's limits set to its motion."""
    needs = planned_motion(setup, identified, design, drive_of(setup, design), kind.source)
    return plan_run(setup, design, kind, None, needs)


def played(plan: RunPlan, kind: str = "", channel: int = 0, at: int = 10**9) -> tuple[Outcome, Watched]:
    """Play a run in which a channel fails at a step; return how it went and the rig."""
    rig = Watched(open_virtual(plan.setup, (plan.kind.stream,), plan.setup.case.seed), kind, channel, at)
    blocks = plan.design.blocks
    return play(
        rig, plan.setup.rig, blocks, plan.kind.source, plan.drive, plan.limits, foreseen=plan.foreseen
    ), rig  # fmt: skip


def healthy(plan: RunPlan) -> tuple[str, Array, Array]:
    """Return why a run without a fault was stopped, "" if it was not, its samples (c, n) in V and its places (n,)."""
    outcome, rig = played(plan)
    return outcome.stopped_by_limit, np.array(rig.samples).T, np.array(rig.place_m)


def faulty_runs(plan: RunPlan, samples_v: Array, place_m: Array) -> Iterator[Ended]:
    """Yield how a run ends with each channel dead, stuck or flipped at the peak of its motion."""
    dt_s, most = plan.setup.rig.dt_s, float(np.abs(place_m).max())
    for channel, named in enumerate(plan.setup.rig.channels):
        at = int(np.argmax(np.abs(samples_v[channel, : len(place_m) - round(2.0 / dt_s)])))
        for kind in KINDS:
            outcome, rig = played(plan, kind, channel, at)
            place = np.array(rig.place_m)
            stopped = not outcome.played
            taken = round(outcome.stopped_at_s / dt_s)
            moving = np.flatnonzero(np.abs(place) > AT_REST_M)
            yield Ended(
                plan.kind.name, kind, named.name, most, float(np.abs(place[at - 1 :]).max()),
                (taken - at) * dt_s if stopped else np.nan,
                (moving[-1] - taken) * dt_s if stopped and moving.size else np.nan,
                outcome.stopped_by_limit,
            )  # fmt: skip
