"""Samples that a real-time run lost: how many steps, why, the longest gap; as metrics and as a finding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.findings import Finding
from rths_cli.loop.lost_samples import CAUGHT_UP, MIXED, NO_ANSWER, without_samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.numerics.lti import Array

RUNS = {"shake_table": "shake-table test", "exp_rths": "EXP-RTHS"}


def losses_of_runs(metrics: Mapping[str, ArrayLike]) -> list[Finding]:
    """Return a finding for each table run of a result that had steps without samples."""
    found = []
    for run, label in RUNS.items():
        names = ("lost_steps", "overrun_steps", "mixed_steps", "longest_gap_s")
        lost, overrun, mixed, gap_s = (float(np.asarray(metrics.get(f"{run}.{name}", 0.0))) for name in names)
        if lost or overrun:
            found.append(Losses(0, int(lost), int(overrun), int(mixed), gap_s).finding(label))
    return found


@dataclass(frozen=True)
class Losses:
    """Numbers of steps of a record without samples of their own."""

    steps: int  # all steps
    lost: int  # steps whose samples were lost
    overrun: int  # steps that were late by an interval or more, or caught up without samples
    mixed: int  # steps after a gap that used a mix of measured and substituted samples
    longest_gap_s: float  # longest time without samples of the right instant

    @property
    def any(self) -> bool:
        """Return whether any samples were missing."""
        return self.lost + self.overrun > 0

    def finding(self, run: str) -> Finding:
        """Return the counts as a finding; `run` names the run."""
        counts = {"lost": self.lost, "overrun": self.overrun, "mixed": self.mixed or None}
        values = {**counts, "late": self.overrun > 0, "longest_gap_s": self.longest_gap_s}
        return Finding("run.lost_samples", values).at("at.run", run=run)


def losses_of(lost: Array, late_s: Array, dt_s: float) -> Losses:
    """Return the losses from timing/lost (n,) and timing/late_s (n,), which are empty for a rig without such a log."""
    overrun = (lost == CAUGHT_UP) | (late_s >= dt_s)
    gap_s = longest_run(without_samples(lost)) * dt_s
    gap_s = max(gap_s, float(np.max(late_s[overrun], initial=0.0, where=np.isfinite(late_s[overrun]))))
    return Losses(lost.size, int(np.sum(lost == NO_ANSWER)), int(np.sum(overrun)), int(np.sum(lost == MIXED)), gap_s)


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Return the length of the longest run of true values (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def of_live(live: Mapping[str, Array], dt_s: float) -> Losses | None:
    """Return the losses of a run on a real rig, None for a run on the counted clock."""
    return losses_of(live["lost"], live["late_s"], dt_s) if live else None


def lost_sample_metrics(run: str, found: Losses) -> dict[str, ArrayLike]:
    """Return losses as metrics of a run."""
    return {
        f"{run}.lost_steps": found.lost,
        f"{run}.overrun_steps": found.overrun,
        f"{run}.mixed_steps": found.mixed,
        f"{run}.longest_gap_s": found.longest_gap_s,
    }
