"""A row of a sweep run in full: the same case, wherever the process stands, and the same metrics."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from portfolio import parametrize_first

from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.experiment import run_case
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.studies.engines import Engine
from rths_cli.studies.row_of_sweep import read_row
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep import SweepRequest, run_sweep

STUDY = """\
case: a
axes:
  controller: [FF, {kind: FF+FB, max_sensitivity: 1.4}]
  table.converters.latency_samples: [1, 2]
  table.after_identification.coulomb_factor: {distribution: lognormal, median: 1.2, cov: 0.3}
samples: {count: 1, seed: 3}
seeds: {first: 4, last: 5}
metrics: [check.gain_margin]
"""
OF_LATER = ("reaction_feedforward", "friction_compensation")
SILENT = SimpleNamespace(doing=lambda text: None, message=lambda text: None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a study, swept from it, of a case on a record of 4.5 s in a folder beside it."""
    place = tmp_path_factory.mktemp("lab")
    time_s = np.arange(0.0, 4.5, 0.01)
    accel = 1.5 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / 4.5) ** 2
    (place / "records").mkdir()
    for name in ("short", "other"):
        lines = "\n".join(f"{a:.6f}" for a in accel)
        (place / "records" / f"{name}.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{lines}\n")
    case = "structure: three_storey\ndamping: low\nrecord: ./records/short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
    (place / "a.yaml").write_text(case)
    (place / "study.yaml").write_text(STUDY)
    with chdir(place):
        asked = Asked("study.yaml", ("record=./records/other.csv",), (), None)
        run_sweep(SweepRequest(asked, Path("s.h5"), None, Engine(jobs=2), True, False, "test"), SILENT)  # type: ignore[arg-type]
    return place


@pytest.mark.campaign
@parametrize_first(1, ("number", "kind", "latency", "seed"), [(7, "FF+FB", 2, 4), (2, "FF", 1, 5)])
def test_a_row_is_run_in_full_with_the_same_metrics(
    folder: Path, tmp_path: Path, memory: Memory, number: int, kind: str, latency: int, seed: int
) -> None:
    with chdir(tmp_path):
        row = read_row(folder / "s.h5", number, ("runs=[sim, exp_rths]",))
    case = row.case
    assert row.session_seed == 0  # of the sweep's case: its seeds are repetitions in one session
    assert (case.controller.kind, case.seed, case.name) == (kind, seed, f"a-row{number}")
    assert case.record.path == folder / "records" / "other.csv"
    assert case.table.converters.latency_samples == latency  # type: ignore[attr-defined]
    assert run_case.run_case(make_setup(case), tmp_path / "r.h5", memory, "test", lambda _: None).exit_code == 0
    result = read_result(tmp_path / "r.h5")
    assert row.differences(result) == []
    assert "exp_rths.rms_error_m_s2" in row.figures and len(row.figures) == 3
    row.figures["exp_rths.rms_error_m_s2"][1] *= 1 + 1e-8
    (told,) = row.differences(result)
    assert told.startswith("exp_rths.rms_error_m_s2[2] is ")


@pytest.mark.campaign
def test_the_command_says_that_the_metrics_are_the_same_or_not(folder: Path, tmp_path: Path) -> None:
    words = ["run", "--from", str(folder / "s.h5"), "--row", "1", "--set", "runs=[exp_rths]", "--output"]
    same = CliRunner().invoke(cli, [*words, str(tmp_path / "one")], standalone_mode=False)
    assert same.return_value == 0 and "row 1 of " in same.stderr and "has the same metrics" in same.stderr
    words += [str(tmp_path / "two"), "--set", "scaling=0.2", "--quiet"]
    other = CliRunner().invoke(cli, words, standalone_mode=False)
    assert other.return_value == 1 and "the metrics are not those of row 1" in other.stderr


def before(folder: Path, tmp_path: Path, rewritten: Callable[[str], str]) -> Path:
    """Return a copy of the sweep whose case was resolved as an earlier version did."""
    old = tmp_path / "old.h5"
    old.write_bytes((folder / "s.h5").read_bytes())
    with h5py.File(old, "r+") as file:
        file["case_resolved"][()] = rewritten(file["case_resolved"].asstr()[()])
    return old


def without(*keys: str) -> Callable[[str], str]:
    """Return what takes the lines with these keys out of a text."""
    return lambda text: "".join(line for line in text.splitlines(keepends=True) if not any(key in line for key in keys))


@pytest.mark.campaign
def test_a_row_of_a_sweep_before_keys_that_are_decided_now_says_how_to_play_it_as_then(
    folder: Path, tmp_path: Path
) -> None:
    assert read_row(folder / "s.h5", 1).later == ()
    old, off = before(folder, tmp_path, without(*OF_LATER)), "controller.reaction_feedforward=false"
    with h5py.File(old, "r+") as file:
        file["exp_rths.rms_error_m_s2"][0, 0] *= 1.01
    assert read_row(old, 1).later == tuple(f"controller.{key}=false" for key in OF_LATER)
    words = ["run", "--from", str(old), "--row", "1", "--set", "runs=[exp_rths]", "--set", off, "--output"]
    done = CliRunner().invoke(cli, [*words, str(tmp_path / "r")], standalone_mode=False)
    said = "by default or in a file; --set controller.friction_compensation=false has those of then"
    assert done.return_value == 1 and said in done.stderr


def test_a_row_of_a_sweep_on_a_rig_that_was_certain_by_default_says_how_to_play_it_as_then(
    folder: Path, tmp_path: Path
) -> None:
    def certain(text: str) -> str:
        return text.replace("skew_s: 2.5e-05", "skew_s: 0.0").replace("corner: 0.1", "corner: 0.0")

    old = before(folder, tmp_path, certain)
    (setting,) = [one for one in read_row(old, 1).later if one.startswith("table.uncertainty=")]
    assert read_row(old, 1, (setting,)).case.table.uncertainty.skew_s == 0.0
    assert read_row(old, 1, (setting,)).later == ()


def test_a_row_of_a_sweep_whose_loops_had_to_tolerate_a_tenth_of_gain_says_how_to_judge_it_as_then(
    folder: Path, tmp_path: Path
) -> None:
    old = before(folder, tmp_path, without("table_gain"))
    (setting,) = read_row(old, 1).later
    stated = read_row(old, 1, (setting,)).case.table.uncertainty
    assert (stated.table_gain, stated.corner, stated.skew_s) == pytest.approx((0.1 / 3.0, 0.1, 25e-6))


def test_figures_of_runs_that_are_left_out_are_no_difference(folder: Path) -> None:
    row, nothing = read_row(folder / "s.h5", 1, ("runs=[sim]",)), SimpleNamespace(metrics={})
    assert row.differences(nothing) == [] and row.left_out == set(row.figures)  # type: ignore[arg-type]
    assert read_row(folder / "s.h5", 1, ("runs=[sim, exp_rths]",)).differences(nothing)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--row", "1"], "give both"),
        (["--from", "s.h5"], "give both"),
        (["--from", "s.h5", "--row", "1", "a"], "leave CASE and --method out"),
        (["--from", "s.h5", "--row", "1", "--method", "paper"], "leave CASE and --method out"),
        ([], "CASE is missing; rths list cases"),
    ],
)
def test_a_row_and_cases_exclude_each_other(folder: Path, words: list[str], told: str) -> None:
    with chdir(folder):
        done = CliRunner().invoke(cli, ["run", *words])
    assert done.exit_code == 2 and told in done.output


def test_a_file_without_its_origin_or_the_row_is_refused(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.h5: no such file"):
        read_row(tmp_path / "none.h5", 1)
    with pytest.raises(InputError, match="--row 9: must be 1 to 8"):
        read_row(folder / "s.h5", 9)
    (tmp_path / "s.h5").write_bytes((folder / "s.h5").read_bytes())
    with h5py.File(tmp_path / "s.h5", "r+") as file:
        assert json.loads(file.attrs["settings"]) == ["record=./records/other.csv"]
        file.attrs["settings"] = "{"
    with pytest.raises(InputError, match="has lost the settings of its case"):
        read_row(tmp_path / "s.h5", 1)
    with h5py.File(tmp_path / "s.h5", "r+") as file:
        del file.attrs["case_file"]
    with pytest.raises(InputError, match="does not say where its case comes from"):
        read_row(tmp_path / "s.h5", 1)
