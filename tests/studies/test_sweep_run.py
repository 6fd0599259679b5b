"""A sweep's rows against runs alone, whatever the number of threads, resumed or not; and what is made once."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import h5py
import numpy as np
import pytest
from declared_contents import sweep_faults
from portfolio import parametrize_first
from watched_references import watch_references

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment import run_case
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.files.sweep_file import read_sweep, rows_path
from rths_cli.studies import sweep as sweep_workflow
from rths_cli.studies import sweep_runs
from rths_cli.studies.engines import Engine
from rths_cli.studies.grid_points import check_points
from rths_cli.studies.study_plan import Asked, read_plan
from rths_cli.studies.sweep import SweepRequest, Swept, run_sweep
from rths_cli.studies.sweep_output import begin
from rths_cli.studies.sweep_runs import Shared, play_variant

CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
WORN = "table.after_identification.coulomb_factor"


class Watcher:
    """Take note of messages; raise after so many rows."""

    def __init__(self, raises_at: int | None = None) -> None:
        self.messages: list[str] = []
        self.raises_at = raises_at

    def doing(self, what: str) -> None:
        if self.raises_at is not None and what.startswith(f"{self.raises_at} of "):
            raise KeyboardInterrupt

    def message(self, text: str) -> None:
        self.messages.append(text)

    warning = message

    def started(self, number: int, count: int, name: str) -> None: ...

    def ended(self, ended: object, seconds: float) -> None: ...


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a case on a record of 4.5 s."""
    place = tmp_path_factory.mktemp("sweep")
    time_s = np.arange(0.0, 4.5, 0.01)
    accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 4.5) ** 2
    (place / "short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{a:.6f}" for a in accel) + "\n")
    (place / "a.yaml").write_text(CASE)
    return place


def asked(folder: Path, *vary: str, seeds: str | None = None, settings: tuple[str, ...] = ()) -> SweepRequest:
    request = Asked(str(folder / "a.yaml"), settings, vary, seeds)
    return SweepRequest(request, folder / "out.h5", None, Engine(jobs=2), True, False, "test")


@pytest.mark.campaign
def test_a_doubt_on_units_is_told_once_for_all_points_that_raise_it(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "short.csv").write_text((folder / "short.csv").read_text().replace("m/s^2", "cm/s^2"))
    (tmp_path / "a.yaml").write_text(CASE)
    watcher, request = Watcher(), asked(tmp_path, "scaling=0.2,0.5,1,40")  # at 40 it is known to be weak
    run_sweep(request, watcher)  # type: ignore[arg-type]
    (told,) = (text for text in watcher.messages if "unit" in text)
    assert ": record: short, its peak before scaling, 0.0148656 m/s^2 is 0.00152 times 1 g" in told and told.endswith(
        "(at 3 of 4 grid points)"
    )


def swept(request: SweepRequest, path: Path, **changes: object) -> Swept:
    return run_sweep(replace(request, output=path, **changes), Watcher())  # type: ignore[arg-type]


def datasets(path: Path) -> dict[str, bytes]:
    """Return every dataset of a file as bytes, text as its spelling."""

    def content(node: h5py.Dataset) -> bytes:
        if h5py.check_string_dtype(node.dtype):
            return repr(np.asarray(node.asstr()[()]).tolist()).encode()
        return np.asarray(node[()]).tobytes()

    with h5py.File(path) as file:
        assert len(file) > 30
        return {name: content(node) for name, node in file.items()}


@pytest.fixture(scope="module")
def whole(folder: Path) -> tuple[SweepRequest, Swept]:
    request = asked(folder, "scaling=0.2,3", f"{WORN}=1,3", seeds="3:5")
    return request, swept(request, folder / "whole.h5")


@pytest.fixture(scope="module")
def worn(folder: Path) -> tuple[SweepRequest, Swept]:
    """Return a sweep of six runs over one check."""
    request = asked(folder, f"{WORN}=1,3", seeds="3")
    return request, swept(request, folder / "worn.h5")


@parametrize_first(
    1,
    ("variant", "settings"),
    [(2, ("scaling=0.2", "seed=5")), (3, ("scaling=0.2", f"{WORN}=3", "seed=3"))],
)
def test_a_row_is_what_a_run_alone_gives(
    whole: tuple[SweepRequest, Swept], folder: Path, tmp_path: Path, memory: Memory, variant: int, settings: tuple[str]
) -> None:
    case = load_cases([folder / "a.yaml"], (*settings, "runs=[exp_rths]"))[0]
    assert run_case.run_case(make_setup(case), tmp_path / "a.h5", memory, "test", lambda _: None).exit_code == 0
    alone = read_result(tmp_path / "a.h5")
    sweep = whole[1].sweep
    assert sweep.texts["model_sha256"][variant] == alone.attributes["model_sha256"]
    assert sweep.texts["verdict"][variant] == alone.attributes["check_verdict"] == "safe"
    assert len(sweep.figures) == 27
    for path, figure in sweep.figures.items():
        assert figure.values[variant] == pytest.approx(alone.metrics[path], rel=1e-12), path
        assert figure.units == alone.units[path], path
        assert path.startswith("check.") or figure.definition == alone.definitions[path]


@pytest.mark.campaign
def test_a_row_of_a_building_with_computed_storeys_below_is_too(folder: Path, tmp_path: Path, memory: Memory) -> None:
    settings = ("structure.numerical.masses_kg=[6.93, 6.93]", "structure.numerical.stiffness_n_per_m=[7300, 7300]")
    request = asked(folder, seeds="1", settings=settings)
    sweep = swept(request, tmp_path / "s.h5", overrides=("check",)).sweep
    case = load_cases([folder / "a.yaml"], (*settings, "runs=[exp_rths]"))[0]
    run_case.run_case(make_setup(case, ("check",)), tmp_path / "a.h5", memory, "test", lambda _: None)
    alone = read_result(tmp_path / "a.h5").metrics
    for which in ("rms_error_m_s2", "max_error_m_s2_true", "rms_error_m_s2_full"):
        found = sweep.figures[f"exp_rths.{which}"].values[0]
        assert found.shape == (4,) and found == pytest.approx(alone[f"exp_rths.{which}"], rel=1e-12)


@pytest.mark.campaign
def test_rows_of_storeys_with_laws_on_another_specimen_are_too(folder: Path, tmp_path: Path, memory: Memory) -> None:
    settings = (
        "structure.numerical.masses_kg=[6.93, 6.93]",
        "structure.numerical.stiffness_n_per_m=[7300, 7300]",
        "structure.numerical.law=[null, {kind: bilinear, yield_displacement_m: 0.0005, hardening: 0.1}]",
        "table.after_identification.specimen_stiffness_factor=0.95",
        "accept={exp_rths.ductility: 50, 'exp_rths.restoring_work_j[2]': 1e-9, "
        "'exp_rths.residual_drift_uncertainty_m[2]': 1e-12}",
        "base_shear_uncertainty=0.02",
    )
    request = asked(folder, seeds="1", settings=settings)
    sweep = swept(request, tmp_path / "s.h5", overrides=("check",)).sweep
    case = load_cases([folder / "a.yaml"], (*settings, "runs=[sim_delay, exp_rths]"))[0]
    run_case.run_case(make_setup(case, ("check",)), tmp_path / "a.h5", memory, "test", lambda _: None)
    alone = read_result(tmp_path / "a.h5")
    for path, figure in sweep.figures.items():
        assert figure.values[0] == pytest.approx(alone.metrics[path], rel=1e-12, nan_ok=True), path
    assert sweep.figures["exp_rths.ductility"].values[0, 1] > 1.0
    assert sweep.figures["exp_rths.residual_drift_uncertainty_m"].values[0, 1] > 0.0
    assert (sweep.figures["exp_rths.true_reference_ratio"].values[0] > 0.0).all()
    for reason in (sweep.texts["reason"][0], alone.attributes["status_reason"]):
        assert reason.startswith("exp_rths.restoring_work_j[2] = ") and "ductility" not in reason
        assert "exp_rths.residual_drift_uncertainty_m[2] = " in reason


@pytest.mark.campaign
def test_a_varied_scale_gives_the_rows_of_runs_alone(folder: Path, tmp_path: Path, memory: Memory) -> None:
    """A sweep shares what two lengths have in common, and not the record; its figures are in model scale."""
    request = asked(folder, "scale.length=1,1.21", settings=("report_in=prototype",))
    sweep = swept(request, tmp_path / "s.h5").sweep
    for variant, length in enumerate((1, 1.21)):
        settings = (f"scale.length={length}", "report_in=prototype", "runs=[exp_rths]")
        case = load_cases([folder / "a.yaml"], settings)[0]
        run_case.run_case(make_setup(case), tmp_path / "a.h5", memory, "test", lambda _: None)
        alone = read_result(tmp_path / "a.h5").metrics
        for path in ("exp_rths.rms_error_m_s2", "exp_rths.tracking_max_m_s2_true", "check.rms_error_m_s2"):
            if path in sweep.figures:
                assert sweep.figures[path].values[variant] == pytest.approx(alone[path], rel=1e-12), path
    first, second = sweep.figures["exp_rths.rms_error_m_s2"].values
    assert not np.allclose(first, second, rtol=0.05)
    assert sweep.varied["scale.length"] == (1, 1.21)


def test_runs_stand_in_the_order_of_the_grid_and_none_is_dropped(whole: tuple[SweepRequest, Swept]) -> None:
    sweep = whole[1].sweep
    assert sweep.varied["scaling"] == (0.2,) * 6 + (3,) * 6
    assert sweep.varied[WORN] == ((1,) * 3 + (3,) * 3) * 2
    assert sweep.seed.tolist() == [3, 4, 5] * 4
    assert sweep.texts["status"] == ("complete",) * 6 + ("refused",) * 6
    assert all("stroke" in reason or "displacement" in reason for reason in sweep.texts["reason"][6:])
    assert whole[1].exit_code == 1 and sweep.attributes["status_reason"] == "6 complete, 6 refused"
    errors = sweep.figures["exp_rths.rms_error_m_s2"].values
    assert np.isfinite(errors[:6]).all() and np.isnan(errors[6:]).all()
    assert len({value.tobytes() for value in errors[:6]}) == 6  # each seed and each friction has its own
    assert errors[3:6].min() > 1.5 * errors[:3].max()  # friction grew after the identification


@pytest.mark.campaign
@pytest.mark.parametrize("jobs", [1, 4])
def test_the_number_of_threads_changes_no_byte(worn: tuple[SweepRequest, Swept], tmp_path: Path, jobs: int) -> None:
    swept(worn[0], tmp_path / "s.h5", engine=Engine(jobs=jobs))
    assert datasets(tmp_path / "s.h5") == datasets(worn[1].path)


def test_a_sweep_that_is_interrupted_before_its_first_row_says_that_it_begins_anew(
    worn: tuple[SweepRequest, Swept], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    watcher, request = Watcher(), replace(worn[0], output=tmp_path / "s.h5", engine=Engine("inline"))
    monkeypatch.setattr(sweep_workflow, "executor_here", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(request, watcher)
    assert watcher.messages[-1] == "none of 6 runs had ended, nothing is kept; the same command begins anew"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.campaign
def test_an_interrupted_sweep_goes_on_where_it_was_and_gives_the_same(
    worn: tuple[SweepRequest, Swept], tmp_path: Path
) -> None:
    path, watcher = tmp_path / "s.h5", Watcher(raises_at=2)
    request = replace(worn[0], output=path)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(request, watcher)
    assert not path.exists() and "2 of 6 runs are kept" in watcher.messages[-1]
    with open(rows_path(path), "ab") as file:
        file.write(b'[2, "complete", "", 0, "safe')  # a killed process was writing this
    with pytest.raises(InputError, match=r"holds 2 runs of this sweep.*--resume"):
        run_sweep(request, Watcher())
    with pytest.raises(InputError, match="holds 2 runs of another sweep"):
        run_sweep(replace(request, asked=replace(request.asked, seeds="4"), resume=True), Watcher())
    whole = rows_path(path).read_bytes()
    head, _, rest = whole.partition(b"\n")
    header = json.loads(head)
    without_name = {key: value for key, value in header.items() if key != "case_name"}
    for damaged in (without_name, header | {"case_name": 1}, header | {"nobody's": ""}):
        rows_path(path).write_bytes(json.dumps(damaged).encode() + b"\n" + rest)
        with pytest.raises(InputError, match="rows that are not of this sweep"):
            run_sweep(replace(request, resume=True), Watcher())
    rows_path(path).write_bytes(whole)
    played: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sweep_workflow, "play_variant", lambda ready, k, *rest: played.append(k) or play_variant(ready, k, *rest)
        )
        resumed = run_sweep(replace(request, resume=True), Watcher())
    assert resumed.played == 4 and sorted(played) == [2, 3, 4, 5] and not rows_path(path).exists()
    assert datasets(path) == datasets(worn[1].path)
    again = run_sweep(replace(request, resume=True), Watcher())
    assert (again.played, again.exit_code) == (0, 0)


@pytest.mark.campaign
def test_a_sweep_takes_the_place_of_a_sweep_alone(
    whole: tuple[SweepRequest, Swept], folder: Path, tmp_path: Path
) -> None:
    request, done = whole
    shutil.copy(done.path, tmp_path / "other.h5")
    other = replace(request, asked=replace(request.asked, vary=(), seeds="1"))
    with pytest.raises(InputError, match="holds another sweep"):
        swept(replace(other, resume=True), tmp_path / "other.h5")
    made = (tmp_path / "other.h5").read_bytes()
    with pytest.raises(InputError, match=r"other\.h5: exists and holds another sweep .* or add --force to replace it"):
        swept(other, tmp_path / "other.h5")
    assert (tmp_path / "other.h5").read_bytes() == made
    assert len(swept(replace(other, force=True), tmp_path / "other.h5").sweep.seed) == 1
    assert len(swept(other, tmp_path / "other.h5").sweep.seed) == 1  # of the same plan
    with pytest.raises(InputError, match="no-replace"):
        swept(request, done.path, replace=False)
    (tmp_path / "text.h5").write_text("mine")
    with pytest.raises(InputError, match="is no result of a sweep"):
        swept(request, tmp_path / "text.h5")
    with pytest.raises(InputError, match="is a folder"):
        swept(request, tmp_path)
    with pytest.raises(InputError, match=r"text\.h5: is a file, or below one"):
        swept(request, tmp_path / "text.h5" / "s.h5")
    assert (tmp_path / "text.h5").read_text() == "mine"


def test_a_sweep_that_ends_before_its_first_row_leaves_no_file(
    whole: tuple[SweepRequest, Swept], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def nobody(*_: object) -> NoReturn:
        raise InputError("no Dask scheduler answers there")

    monkeypatch.setattr(sweep_workflow, "executor_here", nobody)
    watcher = Watcher()
    with pytest.raises(InputError, match="no Dask scheduler"):
        run_sweep(replace(whole[0], output=tmp_path / "s.h5"), watcher)
    assert list(tmp_path.iterdir()) == [] and not any("--resume" in text for text in watcher.messages)


def test_a_finished_sweep_of_another_version_is_played_anew(whole: tuple[SweepRequest, Swept]) -> None:
    path, attributes = whole[1].path, whole[1].sweep.attributes
    assert begin(path, attributes, 12, replace=True, resume=True) is None
    newer = attributes | {"software_sha256": "another"}
    begun = begin(path, newer, 12, replace=True, resume=True)
    assert begun is not None and not begun.resumed


@pytest.mark.campaign
def test_what_runs_share_is_made_once(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: dict[str, int] = {}

    def counted(module: ModuleType, name: str) -> None:
        original = getattr(module, name)

        def count(*args: object, **named: object) -> object:
            calls[name] = calls.get(name, 0) + 1
            return original(*args, **named)

        monkeypatch.setattr(module, name, count)

    for module, name in ((sweep_runs, "design_blocks"), (sweep_runs, "verdict_on")):
        counted(module, name)
    watch_references(monkeypatch, run_case, lambda name: calls.update({name: calls.get(name, 0) + 1}))
    counted(sweep_runs, "plan_run")
    never = ("session_record=never",)  # a rig that has changed since has a session of its own
    swept(asked(folder, f"{WORN}=1,2", "scaling=0.2,0.3", seeds="2", settings=never), tmp_path / "s.h5")
    assert calls == {"design_blocks": 1, "verdict_on": 2, "simulate": 2, "plan_run": 4}


def test_points_that_share_most_are_made_one_after_the_other(folder: Path) -> None:
    grid = Asked(
        str(folder / "a.yaml"),
        ("session_record=never",),
        ("scaling=0.2,0.3", "kalman.q=900,1000", f"{WORN}=1,2", "kalman.r=1,2"),
        None,
    )
    points = check_points(grid, sweep_runs.Shared((), lambda _: None), lambda _: None)
    made = [(q, r, scaling, worn) for scaling, q, worn, r in map(points.plan.values, points.order)]
    assert made == sorted(made) and len(made) == 16


@pytest.mark.campaign
def test_a_run_that_a_limit_stops_is_a_row_too(folder: Path, tmp_path: Path) -> None:
    done = swept(asked(folder, "scaling=3.3", seeds="1"), tmp_path / "s.h5", overrides=("check",))
    assert done.exit_code == 3 and done.sweep.texts["status"] == ("aborted",)
    assert "velocity (estimated from the command) beyond its limit" in done.sweep.texts["reason"][0]
    assert np.isnan(done.sweep.figures["exp_rths.tracking_rms_m_s2"].values).all()


@pytest.mark.campaign
def test_accept_limits_judge_each_run(folder: Path, tmp_path: Path) -> None:
    limits = "accept={'exp_rths.rms_error_m_s2[3]': 1e-9, 'sim_delay.rms_error_m_s2[3]': 1}"
    watcher = Watcher()
    done = run_sweep(replace(asked(folder, settings=(limits,)), output=tmp_path / "s.h5"), watcher)
    assert done.exit_code == 1 and done.sweep.texts["status"] == ("complete",)
    assert done.sweep.texts["reason"][0].startswith("exp_rths.rms_error_m_s2[3] = ")
    assert "sim_delay" not in done.sweep.texts["reason"][0]
    assert any("sim_delay.rms_error_m_s2[3]" in text for text in watcher.messages)


def test_the_file_holds_what_is_declared_and_nothing_else(whole: tuple[SweepRequest, Swept]) -> None:
    assert sweep_faults(whole[1].path, tuple(whole[1].sweep.varied)) == []


def test_the_file_opens_in_xarray_and_reads_back(whole: tuple[SweepRequest, Swept]) -> None:
    import xarray as xr

    with xr.open_dataset(whole[1].path, engine="h5netcdf") as table:
        assert table["exp_rths.rms_error_m_s2"].dims == ("variant", "storey")
        assert set(table.coords) == {"variant", "storey", "seed", "scaling", WORN}
        assert table["exp_rths.rms_error_m_s2"].attrs["units"] == "m/s^2"
        worn = table.where(table[WORN] == 3, drop=True)
        assert worn.sizes["variant"] == 6
        assert table.attrs["format"] == "rths-sweep" and table.attrs["format_version"] == 1
        assert table.attrs["rig"] == "aps400_virtual" and len(table.attrs["plan_sha256"]) == 64
    back, sweep = read_sweep(whole[1].path), whole[1].sweep
    assert (back.varied, back.texts, back.resolved_yaml) == (sweep.varied, sweep.texts, sweep.resolved_yaml)
    assert back.seed.tolist() == sweep.seed.tolist()
    assert {k: f.values.tobytes() for k, f in back.figures.items()} == {
        k: f.values.tobytes() for k, f in sweep.figures.items()
    }


def test_the_table_as_csv_holds_the_same_numbers(whole: tuple[SweepRequest, Swept], tmp_path: Path) -> None:
    request, done = whole
    swept(request, done.path, resume=True, csv=tmp_path / "t.csv")
    with open(tmp_path / "t.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["3", "4", "5"] * 4
    third = done.sweep.figures["exp_rths.rms_error_m_s2"].values[:, 2]
    assert [row["exp_rths.rms_error_m_s2[3]"] for row in rows] == [repr(float(v)) for v in third[:6]] + [""] * 6


def test_every_fault_of_the_grid_is_told_before_the_first_run(folder: Path, tmp_path: Path) -> None:
    request = asked(folder, "scaling=0.3,-1", "controller=FF,FX", "tabel.kind=1", settings=("delay_s=-3",))
    with pytest.raises(InputError) as caught:
        swept(request, tmp_path / "out" / "s.h5")
    told = "\n".join(caught.value.faults)
    for words in ("--vary scaling: must be > 0", "FX", "tabel", "--set delay_s"):
        assert words in told, told
    assert "(at grid point scaling=-1, controller=FF, tabel.kind=1 and 1 more)" in told
    assert len(caught.value.faults) == 4 and not (tmp_path / "out").exists()


@pytest.mark.campaign
def test_samples_out_of_bounds_are_one_fault_of_their_distribution(folder: Path, tmp_path: Path) -> None:
    study = tmp_path / "s.yaml"
    axis = "scaling: {distribution: normal, mean: 0.1, std: 0.2}"
    study.write_text(f"case: {folder / 'a.yaml'}\naxes: {{{axis}}}\nsamples: {{count: 20}}\n")
    points = read_plan(Asked(str(study), (), (), None)).plan
    below = sum(points.values(k)[0] <= 0 for k in range(20))
    with pytest.raises(InputError) as caught:
        check_points(Asked(str(study), (), (), None), sweep_runs.Shared((), lambda _: None), lambda _: None)
    (told,) = caught.value.faults
    assert "axes.scaling: must be > 0 and <= 100, got -0." in told and f" and {below - 1} more)" in told and below > 2


def test_records_that_do_not_exist_are_named_with_their_point(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such file.*\(at grid point record=./none.csv\)"):
        swept(asked(folder, "record=el_centro,./none.csv"), tmp_path / "s.h5")


@pytest.mark.campaign
def test_a_case_that_lacks_what_is_varied_is_a_case_at_every_point(folder: Path, tmp_path: Path) -> None:
    (folder / "b.yaml").write_text(CASE.replace("scaling: 0.3\n", ""))
    request = asked(folder, "scaling=0.3")
    done = swept(replace(request, asked=replace(request.asked, path=str(folder / "b.yaml"))), tmp_path / "s.h5")
    assert done.exit_code == 0


def test_a_real_table_is_never_swept(folder: Path) -> None:
    shared = sweep_runs.Shared((), lambda _: None)
    setup = make_setup(load_cases([folder / "a.yaml"])[0])
    with pytest.MonkeyPatch.context() as patch, pytest.raises(InputError, match="moves no real table"):
        patch.setattr(sweep_runs, "make_setup", lambda *_: replace(setup, rig=replace(setup.rig, kind="udp")))
        shared.setup(setup.case)


def test_the_report_says_how_to_see_a_sweep(whole: tuple[SweepRequest, Swept]) -> None:
    with pytest.raises(InputError, match="holds a sweep; rths sweep with the same options and --resume shows it"):
        read_result(whole[1].path)


def test_a_key_that_no_point_reads_is_refused(folder: Path) -> None:
    """Ten identical rows would look as if the delay did not matter."""
    with pytest.raises(InputError, match="--vary delay_s: changes nothing in a sweep, only SIM-DELAY would read it"):
        run_sweep(asked(folder, "delay_s=0.001:0.010:10"), Watcher())
    read_by_some = asked(folder, "method=paper,best", "kalman.residual_hz=30,40").asked
    assert check_points(read_by_some, Shared((), str), str).plan.points == 4
