"""Samples that a real-time run lost: how many steps, why, the longest gap; as metrics and as a sentence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.loop.lost_samples import CAUGHT_UP, MIXED, NO_ANSWER, without_samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rths_cli.numerics.lti import Array

RUNS = {"shake_table": "shake-table test", "exp_rths": "EXP-RTHS"}


def losses_of_runs(metrics: Mapping[str, ArrayLike]) -> list[str]:
    """Return a sentence for each table run of a result that had steps without samples."""
    lines = []
    for run, label in RUNS.items():
        names = ("lost_steps", "overrun_steps", "mixed_steps", "longest_gap_s")
        lost, overrun, mixed, gap_s = (float(np.asarray(metrics.get(f"{run}.{name}", 0.0))) for name in names)
        if lost or overrun:
            lines.append(loss_sentence(label, int(lost), int(overrun), int(mixed), gap_s))
    return lines


def loss_sentence(what: str, lost: int, overrun: int, mixed: int, longest_gap_s: float) -> str:
    """Return a sentence on the steps without samples of their own, the longest such time, and the steps with a mix."""
    host = " because this computer was late" if overrun else ""
    after = f", in {_steps(mixed)} after that in part" if mixed else ""
    return (
        f"{what}: {_steps(lost)} lost samples, {_steps(overrun)} overrun{host}, "
        f"longest gap {1e3 * longest_gap_s:.3g} ms; what was measured there is bridged{after}"
    )


def _steps(count: int) -> str:
    return f"{count} step{'s' if count != 1 else ''}"


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

    def sentence(self, what: str) -> str:
        """Return the counts in words; `what` names the run."""
        return loss_sentence(what, self.lost, self.overrun, self.mixed, self.longest_gap_s)


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
