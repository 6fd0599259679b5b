"""The sentence on the samples that a real-time run lost."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

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
