"""`rths benchmark`: the same bytes for the same seed, however often it was interrupted; order, tables, refusals."""

from __future__ import annotations

import json
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest
from docs_running import run_words, shortened

from rths_cli.benchmark.campaign import BenchmarkRow
from rths_cli.benchmark.displacement import ROW
from rths_cli.benchmark.ranking import half_interval, has_failed, verdict
from rths_cli.case.shipped_files import shipped

WORDS = ("--record", "short.csv", "--case", "4", "--compensator", "pi_lead", "--compensator", "predictive")
OWN = """
STATES = 1


def design(plant, options):
    return [plant.lag_s / plant.dt_s / plant.gain_m_per_v, 1.0 / plant.gain_m_per_v]


def command(p, state, next_state, desired, measured, sent):
    next_state[0] = desired[2]
    return p[1] * desired[2] + p[0] * (desired[2] - state[0])
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("benchmark")
    shortened(shipped("records") / "el_centro.csv", folder / "short.csv", 200)
    shortened(shipped("records") / "el_centro.csv", folder / "longer.csv", 500)
    return folder


def told(place: Path, *words: str, code: int = 0) -> str:
    with chdir(place):
        found, printed = run_words(["benchmark", *words])
    assert found == code, printed
    return printed


@pytest.mark.campaign
def test_rows_are_the_same_bytes_with_any_jobs_and_after_an_interruption(place: Path) -> None:
    plan = ("silva2020", *WORDS, "--plants", "3", "--seed", "5", "--quiet")
    told(place, *plan, "--jobs", "1", "--output", "whole.jsonl")
    told(place, *plan, "--jobs", "3", "--output", "again.jsonl")
    whole = (place / "whole.jsonl").read_bytes()
    assert whole == (place / "again.jsonl").read_bytes() and whole.count(b"\n") == 7
    cut = whole[: whole.rindex(b"\n", 0, -1) - 40]  # in the middle of a row
    (place / "cut.jsonl").write_bytes(cut)
    told(place, *plan, "--resume", "--output", "cut.jsonl")
    assert (place / "cut.jsonl").read_bytes() == whole
    head, first, *others = whole.split(b"\n")  # a row that is there is taken, not played again
    marked = b"\n".join([head, json.dumps(json.loads(first) | {"radius": 10.5}).encode(), *others])
    (place / "marked.jsonl").write_bytes(marked[: marked.rindex(b"\n", 0, -1) - 40])
    told(place, *plan, "--resume", "--output", "marked.jsonl")
    assert (place / "marked.jsonl").read_bytes() == marked != whole
    other = told(place, *plan[:-2], "6", "--quiet", "--resume", "--output", "cut.jsonl", code=2)
    assert "has rows of another benchmark" in other and (place / "cut.jsonl").read_bytes() == whole
    told(place, *plan[:-2], "6", "--quiet", "--output", "other.jsonl")
    assert (place / "other.jsonl").read_bytes().split(b"\n")[2:] != whole.split(b"\n")[2:]


def test_a_law_of_ones_own_is_put_beside_a_built_in_one_that_it_equals(place: Path) -> None:
    """Chen's inverse, written by a stranger: the same block, the same figures."""
    (place / "mine.py").write_text(OWN)
    words = [
        "--record",
        "short.csv",
        *["--compensator", "mine.py", "--compensator", "chen", "--plants", "2", "--case", "1"],
    ]
    printed = told(place, "silva2020", *words, "--json")
    found = json.loads(printed[printed.index("{") :])  # behind what the first run of a machine says of compiling
    mine, chen = ([row for row in found["rows"] if row["compensator"] == name] for name in ("mine", "chen"))
    for one, other in zip(mine, chen, strict=True):
        assert all(one[name] == pytest.approx(other[name], rel=1e-9) for name in ROW)
    assert [one["rank"] for one in found["ranking"]] == [1, 1]


@pytest.mark.campaign
def test_tables_are_written_in_each_format(place: Path) -> None:
    words = (*WORDS, "--plants", "2", "--quiet", "--output", "t.jsonl")
    for name, mark in (
        ("t.tex", r"\begin{longtable}"),
        ("t.md", "|:---|"),
        ("t.html", '<table class="figures"'),
        ("t.txt", "rank"),
    ):
        printed = told(place, "silva2020", *words, "--table", name)
        assert "predictive: best of 2" in printed and mark in (place / name).read_text()
    assert "must end with .tex" in told(place, "silva2020", *words, "--table", "t.pdf", code=2)


@pytest.mark.campaign
def test_the_critical_delays_are_those_that_the_table_names(place: Path) -> None:
    found = json.loads(told(place, "silva2020", "--critical-delays", "--json"))["critical_delays_ms"]
    assert list(found) == ["1", "2", "3", "4"] and found == pytest.approx(
        {"1": 14.640, "2": 12.223, "3": 9.919, "4": 8.725}, abs=0.001
    )
    assert "8.725     8.359" in " ".join(told(place, "silva2020", "--critical-delays").split()).replace(" ", "     ")
    assert told(place, "list").split()[0] == "aps400" and "silva2020" in told(place, "list")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("silva",), "no benchmark is called 'silva'; did you mean silva2020?"),
        (("silva2020", "--case", "5"), "--case 5: is none of the benchmark's; known: 1, 2, 3, 4"),
        (
            ("silva2020", "--compensator", "pi_led"),
            "no kind and no Python file; did you mean pi_lead or lead?",
        ),
        (("silva2020", "--compensator", "chen", "--compensator", "chen"), "chen is given more than once"),
    ],
)
def test_what_cannot_be_played_is_refused_in_a_sentence(place: Path, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in told(place, *words, code=2)


TABLE = ("aps400", "--case", "ideal_el_centro", "--record", "longer.csv")


@pytest.mark.campaign
def test_a_law_that_needs_a_displacement_is_a_row_with_its_reason(place: Path) -> None:
    words = (*TABLE, "--compensator", "ats", "--compensator", "smith", "--plants", "2", "--output", "refused.jsonl")
    printed = " ".join(told(place, *words).split())
    assert "none: of every compensator a run is refused or stopped" in printed
    assert "ats, smith: refused: the law uses the measured displacement of an actuator" in printed
    _, *rows = (place / "refused.jsonl").read_text().splitlines()
    assert [json.loads(one)["outcome"].startswith("refused: controller: ") for one in rows] == [True] * 4


@pytest.mark.campaign
def test_a_table_gives_what_rths_run_gives_and_the_same_bytes(place: Path) -> None:
    """Errors of the ideal table are those of its result file, whose specimen is as declared; tracking as well."""
    from rths_cli.files.result_reader import read_result

    plan = (*TABLE, "--compensator", "FF", "--compensator", "predictive", "--plants", "2", "--seed", "3", "--quiet")
    assert "FF: best of 2" in told(place, *plan, "--jobs", "1", "--output", "one.jsonl")
    told(place, *plan, "--jobs", "2", "--output", "two.jsonl")
    one = (place / "one.jsonl").read_bytes()
    assert one == (place / "two.jsonl").read_bytes() and one.count(b"\n") == 5
    (place / "two.jsonl").write_bytes(one[: one.rindex(b"\n", 0, -1) - 40])
    told(place, *plan, "--resume", "--output", "two.jsonl")
    assert (place / "two.jsonl").read_bytes() == one
    with chdir(place):
        code, printed = run_words(["run", "el_centro_low_ff_fb", "--set", "record=longer.csv", "--set", "seed=4",
                                   "--set", "controller=FF", "--quiet"])  # fmt: skip
    assert code == 0, printed
    found = read_result(place / "results" / "el_centro_low_ff_fb.h5").metrics
    ff = json.loads(one.splitlines()[3])
    assert (ff["compensator"], ff["plant"]) == ("FF", 1)
    assert ff["error_percent"] == pytest.approx(max(found["exp_rths.nrmse_percent_true"]), rel=1e-9)
    assert ff["peak_percent"] == pytest.approx(max(found["exp_rths.peak_error_percent_true"]), rel=1e-9)
    assert ff["sim_percent"] == pytest.approx(max(found["exp_rths.nrmse_percent"]), rel=1e-9)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("aps400", "--noise-free"), "--noise-free: aps400 is a benchmark of tables, which has no such option"),
        (("aps400", "--change", "at_s=10"), "state table.after_identification in the settings of its file"),
        (("aps400", "--critical-delays"), "--critical-delays: aps400 is a benchmark of tables, this is of actuators"),
        (("aps400", "--record", "nowhere.csv", "--compensator", "FF"), "case ideal_el_centro: "),
    ],
)
def test_what_a_benchmark_of_tables_has_not_is_refused(place: Path, words: tuple[str, ...], sentence: str) -> None:
    assert sentence in told(place, *words, code=2)


def row(**figures: float) -> BenchmarkRow:
    return BenchmarkRow("1", "x", 0, dict.fromkeys(ROW, 1.0) | {"radius": 0.999} | figures)


def test_what_the_linear_loop_says_of_plants() -> None:
    nan = float("nan")
    assert verdict([row(), row()], adapts=False) == "safe" and not has_failed(row())
    assert verdict([row(), row(radius=1.01)], adapts=False) == "unstable in 1 of 2" and has_failed(row(radius=1.01))
    assert verdict([row()], adapts=True) == "safe at its start, adapts"
    assert verdict([row(radius=nan)], adapts=True) == "not judged" and has_failed(row(error_percent=nan))


def test_half_an_interval_is_that_of_students_t() -> None:
    """Four values with a deviation of 2: 3.182 of it over the root of 4."""
    assert half_interval(np.array([1.0, 1.0, 1.0, 5.0])) == pytest.approx(3.1824 * 2.0 / 2.0, rel=1e-4)
