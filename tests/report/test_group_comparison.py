"""Groups, repeats and a baseline: counted and averaged by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_up import result

from rths_cli.errors import InputError
from rths_cli.report.group_comparison import (
    BETTER,
    SAME,
    SEEN,
    WORSE,
    against,
    baseline_sections,
    check_keys,
    compare,
    got_worse,
    group_tables,
    over_runs,
    repeats,
    repeats_tables,
)
from rths_cli.report.to_text import text as printed

ERROR, TRACKING = "exp_rths.rms_error_m_s2", "exp_rths.tracking_rms_m_s2"


def run(error, tracking=0.001, **about):
    metrics = {} if error is None else {ERROR: np.array(error), TRACKING: tracking}
    return result(metrics, **about)


def cells(text: str, label: str, after: str = "") -> list[str]:
    """Return the cells of the row with a label, below a line that contains `after`."""
    lines = text[text.index(after) :].splitlines()
    line = next(line for line in lines if line.split("|")[0].strip() == label)
    return line.split("|", 1)[1].replace("|", " ").split()


def test_groups_are_averaged_and_set_against_the_first() -> None:
    members = [
        run([0.01, 0.02], controller="FF", seed=0),
        run([0.03, 0.04], controller="FF", seed=1),
        run([0.005, 0.03], controller="FF+FB", seed=0),
        run(None, controller="FF+FB", seed=1, status="aborted"),
    ]
    (found,) = compare(members, ["controller"])
    text = printed([[*group_tables([found], ["controller"])]])
    assert cells(text, f"{ERROR}[1]") == ["0.0200", "0.0050*", "0.2500"]
    assert cells(text, f"{ERROR}[2]") == ["0.0300", "0.0300*", "1.0000"]
    assert "30 % el_centro, damping low" in text and "(runs: 2, 2)" in text
    assert "virtual rig aps400" in text


def test_a_group_without_a_finished_run_shows_how_it_ended_and_none_is_dropped() -> None:
    members = [run([0.01], method="paper"), run(None, method="best", status="failed"), run([0.02], record="hachinohe")]
    text = printed([[*group_tables(compare(members, ["method"]), ["method"])]])
    assert cells(text, f"{ERROR}[1]", "el_centro") == ["0.0100", "failed", "-"]
    assert cells(text, f"{ERROR}[1]", "hachinohe") == ["-", "0.0200", "-"]


def test_many_groups_are_split_and_long_names_lettered() -> None:
    members = [run([0.01 * k], rig=f"a_rig_with_a_long_name_{k}") for k in range(1, 5)]
    tables = list(group_tables(compare(members, ["rig"]), ["rig"]))
    text = printed([tables])
    assert len(tables) == 2 and max(map(len, text.splitlines())) <= 100
    assert "B: a_rig_with_a_long_name_2." in text and "C / A" in text
    assert cells(printed([tables[1:]]), f"{ERROR}[1]") == ["0.0100", "0.0400", "4.0000"]


def test_cases_of_one_place_are_kept_apart_or_told() -> None:
    members = [run([0.01], case_name="a", method="paper"), run([0.02], case_name="b", method="best")]
    assert len(compare(members, ["method"])) == 2  # another case, not the same one by another method
    found = compare([*members, run([0.02], case_name="c", method="best")], ["controller"])
    labels = [row.label for table in group_tables(found, ["controller"]) for row in table.rows]
    assert any(label.endswith("(runs: 2; several cases in one group: b, c)") for label in labels)


def test_an_unknown_key_is_a_sentence() -> None:
    check_keys(["controller", "software", "folder", "reference_title"], [run([0.1])])
    with pytest.raises(InputError, match="--group-by colour: no result states it; use one of case, controller"):
        check_keys(["colour"], [run([0.1])])


def test_repeats_are_counted_once_per_run() -> None:
    values = [0.010, 0.014, 0.015]
    members = [run([value], seed=seed) for seed, value in enumerate(values)]
    members += [run([values[0]], seed=0), run(None, seed=7, status="aborted"), run([0.5], case_name="alone")]
    (found,) = repeats(members)
    assert (found.runs, found.same_seed, found.ends) == (5, 1, {"aborted": 1, "complete": 4})
    statistics = found.figures[ERROR, 1]
    assert statistics.n == 3
    assert statistics.mean == pytest.approx(0.013) and statistics.std == pytest.approx(np.std(values, ddof=1))
    text = printed([[*repeats_tables([found])]])
    half = 4.302652729749464 * np.std(values, ddof=1) / np.sqrt(3)
    spelt = ["3", "0.0130", "0.0026", "0.0100", "0.0150", f"{0.013 - half:.4f}", f"{0.013 + half:.4f}"]
    assert cells(text, f"{ERROR}[1]") == spelt
    assert "4 complete; 1 with the seed and figures of another, counted once" in " ".join(
        text.replace("|", " ").split()
    )


def test_a_real_rig_that_measures_the_same_twice_counts_twice() -> None:
    (found,) = repeats([run([0.01], rig_kind="udp"), run([0.01], rig_kind="udp")])
    assert found.figures[ERROR, 1].n == 2
    assert repeats([run([0.01]), run([0.01])]) == []


def test_nan_and_unfinished_runs_are_in_no_mean() -> None:
    members = [run([0.01, np.nan]), run([0.03, 0.2], status="interrupted")]
    found = over_runs(members)
    assert found[ERROR, 1].mean == 0.01 and (ERROR, 2) not in found


def with_delay(error, delay):
    made = run(error)
    made.metrics["exp_rths.fei_delay_s"] = delay
    return made


def test_what_got_worse_than_the_baseline() -> None:
    before, now = with_delay([0.010, 0.020, 0.030, 0.0], 1e-4), with_delay([0.0103, 0.0201, 0.015, 1e-7], 5e-4)
    (found,) = against([now], [before], 2.0)
    verdicts = {change.place: change.verdict for change in found.changes}
    assert [verdicts[ERROR, k] for k in (1, 2, 3, 4)] == [WORSE, SAME, BETTER, SAME]
    assert verdicts["exp_rths.fei_delay_s", None] == SEEN
    assert got_worse([found]) and not got_worse(against([now], [before], 3.5))
    text = printed(baseline_sections([found], "old", 2.0))
    assert cells(text, f"{ERROR}[1]") == ["0.0100", "0.0103", "+0.0003", "1.0300", "worse"]
    assert cells(text, f"{ERROR}[3]") == ["0.0300", "0.0150", "-0.0150", "0.5000", "better"]
    assert f"{ERROR}[1] 0.01 -> 0.0103 (+3 %)" in " ".join(text.split())


def test_a_missing_or_aborted_run_is_worse_and_a_new_one_is_not() -> None:
    old = run([0.01])
    for now, word in (([], "missing now"), ([run(None, status="aborted")], "aborted now")):
        found = against(now, [old], 1.0)
        assert got_worse(found) and word in printed(baseline_sections(found, "old", 1.0))
    found = against([old, run([0.01], case_name="new")], [old], 1.0)
    assert not got_worse(found) and "not in the baseline" in printed(baseline_sections(found, "old", 1.0))
    lost = against([run([0.01])], [run([0.01, 0.02])], 1.0)
    assert got_worse(lost) and "1 errors of the baseline are missing" in lost[0].state
    assert not got_worse(against([run([0.01])], [run(None, status="aborted")], 1.0))


def test_results_that_keys_tell_apart_are_no_repeats_but_seeds_are() -> None:
    """With --group-by sample_rate_hz two cases of one name may stand in a report: a mean over both says nothing."""
    members = [run([0.01], seed=k, sample_rate_hz=rate) for k, rate in enumerate((1000.0, 2000.0))]
    assert len(repeats(members)) == 1
    assert repeats(members, ["sample_rate_hz"]) == []
    (found,) = repeats(members, ["seed"])
    assert found.figures[ERROR, 1].n == 2


def test_a_case_that_was_changed_since_the_baseline_is_told() -> None:
    old, new = (replace(run([0.01]), resolved_yaml=f"scaling: {value}\nseed: 0\n") for value in (0.3, 0.2))
    (found,) = against([new], [old], 1.0)
    assert found.state == "another case than in the baseline: they differ in scaling"
    assert found.state in " ".join(printed(baseline_sections([found], "old", 1.0)).replace("|", " ").split())
    assert against([new], [replace(old, resolved_yaml=new.resolved_yaml)], 1.0)[0].state == ""
