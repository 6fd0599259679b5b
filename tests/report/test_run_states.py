"""How a run ended belongs to that run: the figures of others are shown, and what was not run is a dash."""

from __future__ import annotations

from made_up import LOW, figures, result

from rths_cli.report.result_tables import tables
from rths_cli.report.results_by_case import run_state, state

TRACKING = {run: f"{run}.tracking_rms_m_s2" for run in ("shake_table", "exp_rths")}


def ended(status, reason="EXP-RTHS: interrupted at 1.000 s of 9.000 s, the table was led to rest", **attributes):
    one = result(figures((0.01,) * 4, LOW, LOW), rig_kind="udp", status=status, status_reason=reason, **attributes)
    for path in [path for path in one.metrics if path.startswith("exp_rths.")]:
        del one.metrics[path]
    return one


def test_the_state_is_that_of_the_run_that_ended_so():
    one = ended("interrupted", shake_table_status="complete", exp_rths_status="interrupted")
    assert state(one, TRACKING["shake_table"]) == 0.01
    assert state(one, TRACKING["exp_rths"]) == "halted"
    assert run_state(one, TRACKING["shake_table"]) == "complete"
    text = tables([one])
    assert "0.0100*" not in text and "halted" in text and "interru." not in text
    assert "halted: interrupted, by an order to stop" in text


def test_a_run_that_was_not_begun_is_a_dash_and_one_that_was_has_the_files_end():
    one = ended("failed", shake_table_status="begun")
    del one.metrics[TRACKING["shake_table"]]
    assert state(one, TRACKING["shake_table"]) == "failed"
    assert state(one, TRACKING["exp_rths"]) == "-"
    assert state(one, "sim_delay.rms_error_m_s2", 0) == LOW[0]


def test_sim_delay_that_is_not_there_was_not_interrupted():
    one = ended("interrupted", exp_rths_status="interrupted")
    del one.metrics["sim_delay.rms_error_m_s2"]
    assert state(one, "sim_delay.rms_error_m_s2", 0) == "-"


def test_an_earlier_file_does_not_tell_which_run_it_was():
    assert run_state(ended("aborted"), TRACKING["shake_table"]) == "aborted"


def test_the_reason_comes_first_and_once():
    one = ended("interrupted", exp_rths_status="interrupted")
    lines = tables([one]).splitlines()
    assert lines[0] == "Runs that ended otherwise"
    assert "(best): EXP-RTHS: interrupted at 1.000 s of 9.000 s" in " ".join(lines)
    assert "interrupted: EXP-RTHS" not in " ".join(lines)


def test_steps_without_samples_are_counted_where_there_were_any():
    one = result(figures((0.01,) * 4, LOW, LOW), rig_kind="udp")
    one.metrics.update({"exp_rths.lost_steps": 12.0, "exp_rths.overrun_steps": 1.0, "exp_rths.longest_gap_s": 0.005})
    one.metrics["exp_rths.mixed_steps"], one.units["exp_rths.mixed_steps"] = 9.0, "1"
    for name, unit in (("lost_steps", "1"), ("overrun_steps", "1"), ("longest_gap_s", "s")):
        one.units[f"exp_rths.{name}"] = unit
    text = " ".join(tables([one]).split())
    assert "EXP-RTHS: 12 steps lost samples, 1 step overrun because this computer was late, longest gap 5 ms" in text
    assert "is bridged, in 9 steps after that in part" in text
    assert "Steps without samples" not in tables([result(figures((0.01,) * 4, LOW, LOW))])
