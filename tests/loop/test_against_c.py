"""The compiled step of shipped cases against the exported step in C, on the samples of their runs on the virtual rig;
benchmarks/step_mutants.py shows what the comparison notices. Blocks of the bench: tests/report/test_c_step.py."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns.exported_step import both, compiler, differences, shipped
from portfolio import parametrize_first

from rths_cli.experiment.model_choice import Memory
from rths_cli.loop.guard import DEVIATION

SAME = 1e-10  # of a signal's peak, over a hundred thousand steps
CASES = (
    "el_centro_low_ff_fb", "el_centro_base_isolated", "el_centro_viscous_damper", "el_centro_bare_ff_fb",
    "el_centro_high_ff", "el_centro_high_ff_fb", "el_centro_low_ff", "el_centro_tuned_mass_damper",
    "hachinohe_high_ff", "hachinohe_high_ff_fb", "hachinohe_low_ff", "hachinohe_low_ff_fb",
)  # fmt: skip
pytestmark = [
    pytest.mark.campaign, pytest.mark.skipif(compiler() is None, reason="no C compiler here")
]  # fmt: skip


@parametrize_first(3, "case", CASES)
def test_a_shipped_case_is_the_one_of_c(memory: Memory, tmp_path: Path, case: str) -> None:
    """As it is; with lost samples and a stop by the operator; with a limit of the guard that it exceeds."""
    step, given = shipped(memory, case)
    ours, theirs = both(step, given, tmp_path)
    assert list(differences(ours, theirs, SAME)) == [] and np.abs(ours.log.command_v).max() > 0.1
    lost = replace(given, came=given.came.copy(), stop=given.stop.copy())
    for first, count in ((4000, 1), (6000, 3), (9000, 5), (9007, 2), (12000, 4)):
        lost.came[first : first + count] = False
    lost.stop[20000:] = True
    ours, theirs = both(step, lost, tmp_path)
    assert list(differences(ours, theirs, SAME)) == [] and (ours.log.lost == 3.0).sum() > 20
    away = np.abs(step.info.gain_m_per_v * ours.log.command_v[:20000] - ours.log.desired[2, :20000])
    tight = replace(step, limits=step.limits._replace(deviation_m=0.6 * float(away.max())))
    ours, theirs = both(tight, given, tmp_path)
    assert list(differences(ours, theirs, SAME)) == [] and ours.reason == DEVIATION
