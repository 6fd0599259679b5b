"""Incremental dynamic analysis of a small set: against another solution of building and oscillator, hunted and in
stripes, resumed, with points that the check refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from rths_cli.analysis.fragility import of_capacities
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import prepare
from rths_cli.experiment.setup import make_setup
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.files.sweep_file import read_sweep, rows_path
from rths_cli.report import ida_page
from rths_cli.studies.engines import Engine
from rths_cli.studies.ida import AskedIda, plan_ida
from rths_cli.studies.ida_curves import RUN, SIM, Curves, about_of, curves_of, hunt, outcome_of
from rths_cli.studies.row_of_sweep import read_row
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep import SweepRequest, Swept, run_sweep
from rths_cli.studies.sweep_runs import Shared

CASE = "structure: three_storey\ndamping: low\nrecord: {file: ./suite/a.csv, baseline: mean}\nscaling: 0.3\n"
CASE += "controller: FF+FB\nidentification: {duration_s: 40}\n"
LIMIT, DRIFT = 0.0011, "peak_inter_storey_drift_m"
LEVELS = "0.2,0.3,0.4"


class Watcher:
    """Raise after so many rows."""

    def __init__(self, raises_at: int | None = None) -> None:
        self.raises_at = raises_at

    def doing(self, what: str) -> None:
        if self.raises_at is not None and what.startswith(f"{self.raises_at} of "):
            raise KeyboardInterrupt

    def message(self, text: str) -> None: ...

    warning = message

    def started(self, number: int, count: int, name: str) -> None: ...

    def ended(self, ended: object, seconds: float) -> None: ...


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a case and a set of four records of 5 s."""
    place = tmp_path_factory.mktemp("ida")
    (place / "suite").mkdir()
    time_s = np.arange(0.0, 5.0, 0.01)
    for name, hz in zip("abcd", (1.6, 2.1, 2.6, 3.3), strict=True):
        accel = 1.5 * np.sin(2 * np.pi * hz * time_s) * np.sin(np.pi * time_s / 5.0) ** 2
        rows = "\n".join(f"{a:.6f}" for a in accel)
        (place / "suite" / f"{name}.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{rows}\n")
    (place / "set.txt").write_text("# two of them\nsuite/b.csv\n{file: suite/d.csv}  # the other\n")
    (place / "case.yaml").write_text(CASE)
    return place


def played(
    folder: Path, name: str, on: str = "both", levels: str = LEVELS, hunting: bool = False,
    limit: str = f"drift_m={LIMIT}", records: str = "suite", raises_at: int | None = None, resume: bool = False,
    settings: tuple[str, ...] = (),
) -> Swept:  # fmt: skip
    shared = Shared((), lambda _: None)
    asked = AskedIda(str(folder / "case.yaml"), str(folder / records), "sa_t1", levels, (limit,), on, hunting, settings)
    planned, every = plan_ida(asked, shared)
    request = SweepRequest(
        Asked(asked.case, every, (), None), folder / f"{name}.h5", None, Engine(jobs=2), True, resume, "test",
        planned=planned, choose=hunt if hunting else None,
    )  # fmt: skip
    return run_sweep(request, Watcher(raises_at))


@pytest.fixture(scope="module")
def stripes(folder: Path) -> Swept:
    return played(folder, "stripes")


def drift_and_sa(folder: Path, name: str) -> tuple[float, float]:
    """Return the largest drift in m and Sa(T1, 5 %) in m/s^2 of a record as written, by scipy's lsim."""
    setup = make_setup(load_cases([folder / "case.yaml"])[0])
    of, count = setup.building, setup.building.storeys
    record = read_accelerogram(folder / "suite" / f"{name}.csv")
    accel = record.accel_m_s2 - record.accel_m_s2.mean()
    ground = prepare(record.__class__(**{**vars(record), "accel_m_s2": accel}), 1.0, setup.case.sample_rate_hz)
    inverse, zero, one = np.linalg.inv(of.M), np.zeros((count, count)), np.eye(count)
    a = np.block([[zero, one], [-inverse @ of.K, -inverse @ of.C]])
    b = np.concatenate([np.zeros(count), -np.ones(count)])[:, None]
    below = np.eye(count) - np.eye(count, k=-1)
    c = np.hstack([below, zero])
    drift = lsim((a, b, c, np.zeros((count, 1))), ground.accel_m_s2, ground.time_s)[1]
    omega = np.sqrt(np.linalg.eigvals(inverse @ of.K).real.min())
    fine_s = np.arange(0.0, record.dt_s * (accel.size - 1), 1e-3)
    fine = np.interp(fine_s, record.dt_s * np.arange(accel.size), accel)
    single = lsim(([[0, 1], [-(omega**2), -0.1 * omega]], [[0], [-1]], [[1, 0]], [[0]]), fine, fine_s)[1]
    return float(np.abs(drift).max()), float(omega**2 * np.abs(single).max())


@pytest.mark.campaign
def test_sim_at_every_level_is_that_of_another_solution(folder: Path, stripes: Swept) -> None:
    curves = curves_of(stripes.sweep, SIM, DRIFT)
    assert curves.records == ("a", "b", "c", "d") and curves.levels.tolist() == [0.2, 0.3, 0.4]
    for row, name in zip(curves.response, curves.records, strict=True):
        drift, sa = drift_and_sa(folder, name)
        assert row == pytest.approx(curves.levels * drift / sa, rel=2e-3)


def test_the_hybrid_test_answers_as_sim_does_and_says_whether_it_is_valid(stripes: Swept) -> None:
    sim, test = (curves_of(stripes.sweep, run, DRIFT) for run in (SIM, RUN))
    assert test.response == pytest.approx(sim.response, rel=0.02)
    assert set(stripes.sweep.texts["verdict"]) == {"safe"} and not test.missing.any()


@pytest.mark.campaign
def test_a_point_run_in_full_has_the_metrics_of_its_row(stripes: Swept, tmp_path: Path) -> None:
    from rths_cli.experiment.model_choice import Memory
    from rths_cli.experiment.model_files import Cache
    from rths_cli.experiment.run_case import run_case
    from rths_cli.files.result_reader import read_result

    row = read_row(stripes.path, 5)
    run_case(make_setup(row.case), tmp_path / "one.h5", Memory(Cache()), "test", lambda _: None)
    metrics = read_result(tmp_path / "one.h5").metrics
    for run in (SIM, RUN):
        path = f"{run}.{DRIFT}"
        assert np.array_equal(np.asarray(metrics[path]), stripes.sweep.figures[path].values[4])


@pytest.mark.campaign
def test_sim_alone_gives_the_same_numbers_and_plays_nothing(folder: Path, stripes: Swept) -> None:
    alone = played(folder, "alone", on="sim").sweep
    path = f"sim.{DRIFT}"
    assert np.array_equal(alone.figures[path].values, stripes.sweep.figures[path].values)
    assert np.isnan(alone.figures["exp_rths.rms_error_m_s2"].values).all()
    assert set(alone.texts["status"]) == {"complete"} and set(alone.texts["verdict"]) == {"safe"}


@pytest.mark.campaign
def test_a_hunt_finds_the_capacities_with_fewer_runs(folder: Path) -> None:
    levels = "0.15:0.75:7"
    swept = played(folder, "hunt", on="sim", levels=levels, hunting=True)
    about = about_of(swept.sweep.attributes)
    assert about is not None and about.hunt and len(swept.sweep.seed) < 4 * 7
    found = outcome_of(curves_of(swept.sweep, SIM, DRIFT), SIM, about.limits[0], hunted=True)
    exact = [LIMIT * sa / drift for drift, sa in (drift_and_sa(folder, name) for name in "abcd")]
    truth = of_capacities(np.array(exact), np.empty(0))
    assert found.fragility is not None and (found.exceeded, found.missing, found.censored) == (swept_over(swept), 0, 0)
    assert (found.fragility.theta, found.fragility.beta) == pytest.approx((truth.theta, truth.beta), rel=5e-3)


def swept_over(swept: Swept) -> int:
    return int((swept.sweep.figures[f"sim.{DRIFT}"].values.max(axis=1) > LIMIT).sum())


@pytest.mark.campaign
def test_a_hunt_that_was_interrupted_goes_on_to_the_same_file(folder: Path) -> None:
    words = {"on": "sim", "levels": "0.15:0.75:7", "hunting": True, "records": "set.txt"}
    whole = played(folder, "whole", **words)  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt):
        played(folder, "part", raises_at=3, **words)  # type: ignore[arg-type]
    assert rows_path(folder / "part.h5").exists()
    again = played(folder, "part", resume=True, **words)  # type: ignore[arg-type]
    assert again.played < len(whole.sweep.seed)
    assert ida_page.document(again.sweep, Path("x")) == ida_page.document(whole.sweep, Path("x"))
    assert ida_page.document(read_sweep(again.path), Path("x")) == ida_page.document(whole.sweep, Path("x"))


@pytest.mark.campaign
def test_refused_points_are_listed_and_a_stripe_with_many_states_no_fragility(folder: Path) -> None:
    swept = played(folder, "refused", levels="0.3,0.4,40")
    document = ida_page.document(swept.sweep, swept.path)
    test, sim = document["outcomes"]
    assert test["fragility"] is None and "4 of 4 points at 40 are missing, more than a fifth" in test["why_none"]
    assert (test["missing"], sim["missing"], sim["exceeded"]) == (4, 0, 4 + test["exceeded"])
    told = "\n".join(str(block) for block in ida_page.sections(swept.sweep, swept.path)[0])
    assert "missing at 40.0 m/s^2: a (refused), b (refused), c (refused), d (refused)" in told
    assert ida_page.exit_code(swept.sweep) == 1


@pytest.mark.campaign
def test_levels_follow_sim_where_none_are_stated(folder: Path) -> None:
    shared = Shared((), lambda _: None)
    asked = AskedIda(str(folder / "case.yaml"), str(folder / "suite"), "sa_t1", "", (f"drift_m={LIMIT}",), "sim", False)
    levels = plan_ida(asked, shared)[0].plan.axes[-1].numbers()
    exact = np.median([LIMIT * sa / drift for drift, sa in (drift_and_sa(folder, name) for name in "abcd")])
    assert levels is not None and levels.size == 8 and np.sqrt(levels[0] * levels[-1]) == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"limits": ("drift=0.02",)}, "--limit drift=0.02: needs heights_m in the structure; add it, or limit drift_m"),
        ({"limits": ("ductility=2",)}, "no storey of this building has a law"),
        ({"limits": ("drfit=2", "drift_m=x")}, "did you mean drift"),
        ({"levels": "0.1,-2"}, "--levels: every level must be a number > 0"),
        ({"levels": "0.1:2"}, "--levels: a range is LOW:HIGH:COUNT"),
        ({"settings": ("scaling=2",)}, "--set scaling=2: is what rths ida varies"),
        ({"records": "none"}, "none"),
    ],
)
def test_what_is_asked_wrongly_is_told(folder: Path, changed: dict[str, object], told: str) -> None:
    right = {
        "case": str(folder / "case.yaml"), "records": str(folder / "suite"), "measure": "sa_t1", "levels": LEVELS,
        "limits": (f"drift_m={LIMIT}",), "on": "sim", "hunt": False,
    }  # fmt: skip
    with pytest.raises(InputError, match=told):
        plan_ida(AskedIda(**{**right, **changed}), Shared((), lambda _: None))  # type: ignore[arg-type]


def test_what_the_file_says_reads_back(stripes: Swept) -> None:
    about = about_of(read_sweep(stripes.path).attributes)
    assert about is not None and about.limits[0].value == LIMIT and about.runs == (RUN, SIM)
    assert json.loads(str(stripes.sweep.attributes["ida"]))["measure"] == "sa_t1"


def test_fractiles_are_those_of_the_records_between_and_above_what_was_run() -> None:
    slopes = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    levels = np.array([1.0, 2.0, 4.0])
    response = slopes[:, None] * levels
    response[1, 1] = np.nan  # not run between two that were: on the straight line
    response[4, 1:] = np.nan  # above the last one that was run
    found = Curves(tuple("abcde"), levels, response, np.zeros((5, 3), dtype=int)).fractiles()
    assert found[1].tolist() == [3.0, 6.0, 12.0] and found[0].tolist() == [1.0, 2.0, 4.0]
    assert found[2, 0] == 5.0 and np.isnan(found[2, 1:]).all()
