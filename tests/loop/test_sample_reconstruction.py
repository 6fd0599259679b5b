"""An excitation that lost samples: what is put back, and that nothing of what stood in their place stays behind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits
from test_realtime_loop import Wired, conducted

from rths_cli.control.designed_blocks import Blocks
from rths_cli.errors import RigError
from rths_cli.experiment.identify_on_rig import mended
from rths_cli.loop import realtime_run
from rths_cli.loop.run_log import Signals, signals, sizes_of
from rths_cli.loop.step_arrays import EXCITATION
from rths_cli.numerics.lti import Array

DT_S, STEPS = 1e-3, 6_000
ZEROS_V = np.array([0.04, -0.02, 0.03])


def listening() -> Blocks:
    """Return blocks whose samples are corrected for the sensors alone, as an identification plays."""
    return replace(best_like(rig_info(dt_s=DT_S)), ripple_m_s2_per_v=0.0, ripple_sum_m_s2_per_v=0.0)


def excited(lost: Array) -> tuple[Signals, Signals]:
    """Return an excitation of which some steps (n,) got no samples, as it was logged, and mended."""
    rig, random = Wired(), np.random.default_rng(7)
    drive = np.zeros((STEPS, 3))
    drive[:, 0] = np.convolve(random.standard_normal(STEPS), np.hanning(60) / 200.0, "same")
    blocks = listening()
    run = realtime_run.prepare(
        rig_info(dt_s=DT_S), blocks, EXCITATION, drive, open_limits(rig.info), zeros_v=ZEROS_V, ramp_s=0.0
    )
    samples = rig.arm().copy()
    for k in range(STEPS):
        shown = np.full(3, 9.0) if lost[k] else ZEROS_V + samples
        told = (run.course, run.step, run.limits, run.guard, run.drive, run.log, shown, int(lost[k]), k)
        samples = rig.exchange(conducted(*told)).copy()
    whole = signals(run.log, sizes_of(run.step))
    cut = {name: getattr(whole, name)[..., :STEPS] for name in Signals.__dataclass_fields__}
    logged = Signals(**cut)
    return logged, mended(logged, run.course, blocks.correction)


@pytest.fixture(scope="module")
def whole() -> Signals:
    """Return an excitation that lost nothing."""
    logged, same = excited(np.zeros(STEPS))
    assert same.corrected is logged.corrected
    return logged


def gaps(share: float) -> Array:
    """Return where samples are lost, at random for 1 to 8 ms, 2 where the step was caught up."""
    lost, random = np.zeros(STEPS), np.random.default_rng(3)
    while lost.astype(bool).mean() < share:
        at = random.integers(200, STEPS - 20)
        lost[at : at + random.integers(1, 9)] = 2.0
    return lost


@pytest.mark.campaign
def test_what_was_lost_is_put_back_and_leaves_no_trace(whole: Signals) -> None:
    """3 % lost. In the loop the last samples stood in their place; the correction of an AC coupling integrates them."""
    logged, put_back = excited(gaps(0.03))
    size = whole.corrected.std(axis=1)
    assert (logged.command_v == whole.command_v).all()
    off = (put_back.corrected - whole.corrected) / size[:, None]
    had = (logged.corrected - whole.corrected) / size[:, None]
    assert off.std(axis=1).max() < 2e-3 and np.abs(off).max() < 0.05
    assert np.abs(off[:, -50:].mean(axis=1)).max() < 1e-4 < 2e-3 < np.abs(had[0, -50:].mean())


@pytest.mark.campaign
def test_a_record_that_lost_too_much_is_refused() -> None:
    with pytest.raises(RigError, match=r"samples .* were lost on the link, at most 5 % may be"):
        excited(gaps(0.06))
