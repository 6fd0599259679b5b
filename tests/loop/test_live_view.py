"""A run under way in words, from the columns of a log made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info
from hybrid import best_like, open_limits

from rths_cli.cli.terminal import live_lines, one_line
from rths_cli.loop import realtime_loop, realtime_run
from rths_cli.loop.live_view import Watching
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL


def made() -> realtime_run.Performance:
    """Return a run of 1,000 steps with a ramp of 100, all signals zero, none done."""
    info = rig_info(dt_s=1e-3)
    limits = open_limits(info)._replace(stroke_m=0.079, velocity_m_s=1.0, acceleration_m_s2=45.0, force_n=445.0)
    run = realtime_run.prepare(info, best_like(info), NUMERICAL, np.zeros((1000, 3)), limits, ramp_s=0.1)
    run.log.columns[:] = 0.0
    return run


def test_peaks_shares_and_errors_are_those_of_the_columns() -> None:
    run = made()
    held = signals(run.log, sizes_of(run.step))
    lead = run.step.recent.size - 1
    held.state[:], held.state[:100] = realtime_loop.IN_RUN, realtime_loop.IN_RAMP_UP
    held.command_v[300:302] = [2.0, 2.5]  # 7.9 mm/V: 15.8 and 19.75 mm
    held.corrected[0, 400] = -9.0
    held.desired[0, 400 - lead] = -8.5  # is measured `lead` steps later: an error of 0.5
    held.late_ns[450], held.compute_ns[451] = 2.5e5, 3e3
    held.lost[460:463] = 1.0
    watching = Watching(run)
    run.log.done[0] = 350
    watching.look()  # in two looks, as a screen would
    run.log.done[0] = 600
    view = watching.look()
    assert (view.state, view.time_s, view.total_s) == ("running", pytest.approx(0.5), pytest.approx(1.0))
    assert (view.desired_m_s2, view.measured_m_s2) == (8.5, 9.0)
    assert view.error_rms_m_s2 == pytest.approx(0.5 / np.sqrt(500 - lead))
    assert view.used["stroke"] == pytest.approx(0.01975 / 0.079)
    assert view.used["velocity"] == pytest.approx(0.01975 / 1e-3)  # back from 2.5 V at once
    assert view.used["acceleration"] == pytest.approx(0.2)
    assert (view.late_us, view.compute_us, view.lost) == (250.0, 3.0, 3)
    text = "\n".join(live_lines("EXP-RTHS", view))
    for told in ("EXP-RTHS: running", "0.5 of 1.0 s", "desired 8.500", "stroke 25 %", "lost 3", "Ctrl-C"):
        assert told in text
    assert "0.5 of 1.0 s" in one_line("EXP-RTHS", view)
    assert "velocity at 1975 % of its limit" in one_line("EXP-RTHS", view)


def test_nothing_done_yet_is_a_ramp_up_without_peaks() -> None:
    view = Watching(made()).look()
    assert (view.state, view.measured_m_s2, view.error_rms_m_s2) == ("ramp-up", 0.0, 0.0)
    assert "0.0 of 1.0 s" in live_lines("EXP-RTHS", replace(view, used={}))[0]
