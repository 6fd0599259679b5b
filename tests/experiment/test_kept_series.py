"""`--series`: what a result of each kind holds, how large it is, and what its readers say of what it does not hold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from portfolio import parametrize_first

import rths_cli
from rths_cli import InputError
from rths_cli.analysis.structural_response import inter_storey_drift_m, storey_shear_n
from rths_cli.case.load import load_cases
from rths_cli.errors import RthsError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_command import Request, plan
from rths_cli.files.result_reader import SeriesLeftOut, read_result, read_series
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import DATASETS
from rths_cli.quantities.datasets import KEPT_SERIES
from rths_cli.report.figures import figure_names, write_figures
from rths_cli.report.page import write_page

CASE = "el_centro_low_ff_fb"
MINUTE = 120_000  # samples of a minute at 2 kHz
LARGEST_MB = {"all": 50.0, "essential": 8.0, "none": 0.5}
MASSES = np.array([6.93, 6.91, 6.95])
WITHOUT = {
    "essential": {"kalman", "limits", "timing"},
    "none": set(figure_names()) - {"table_response", "error_budget"},
}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    """Return the results of the default case under the first 9 s of its record, by their series."""
    folder = tmp_path_factory.mktemp("series")
    record = Path(__file__).parents[2] / "records" / "el_centro.csv"
    values = [line for line in record.read_text().splitlines() if not line.startswith("#")][:450]
    (folder / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    settings = {"record.file": folder / "short.csv"}
    yield {
        series: rths_cli.run(CASE, settings=settings, output=folder / series, series=series).path  # type: ignore[arg-type]
        for series in KEPT_SERIES
    }


def held(path: Path) -> dict[str, np.ndarray]:
    """Return the numbers of all datasets of a file by path."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, node: found.update({name: node[()]} if isinstance(node, h5py.Dataset) else {}))
    return found


@pytest.mark.campaign
@parametrize_first(1, "series", KEPT_SERIES)
def test_a_minute_is_no_larger_than_promised(results: dict[str, Path], series: str) -> None:
    samples = read_series(results["all"], "record/time_s").size
    fixed = results["none"].stat().st_size + (_rest_bytes(results["all"]) if series == "all" else 0)
    minute = fixed + (results[series].stat().st_size - fixed) * MINUTE / samples
    assert minute < 1e6 * LARGEST_MB[series]


def _rest_bytes(path: Path) -> int:
    """Return the bytes of the samples at rest, 4 s beside any record."""
    with h5py.File(path) as file:
        rests = [node for run in ("shake_table", "exp_rths") for node in file[f"{run}/rest"].values()]
        return sum(node.id.get_storage_size() for node in rests)


@pytest.mark.campaign
def test_essential_series_are_those_of_all_in_single_precision_and_no_others(results: dict[str, Path]) -> None:
    every, essential, none = (held(results[series]) for series in KEPT_SERIES)
    assert read_result(results["essential"]).series == "essential"
    for name, values in essential.items():
        declared = DATASETS.get(name)
        if name.startswith(("metrics", "controller", "identification", "session")) or declared is None:
            assert np.array_equal(values, every[name], equal_nan=values.dtype.kind == "f"), name
        elif declared.kind != "text":
            assert declared.essential and values.dtype == np.float32, name
            assert np.array_equal(values, every[name].astype(np.float32)), name
    missing = {name for name in set(every) - set(essential) if name in DATASETS}
    assert missing and not any(DATASETS[name].essential for name in missing)
    assert {name for name in none if name.startswith("metrics")} == {n for n in every if n.startswith("metrics")}
    assert not any("time_s" in name for name in none)


def test_drift_and_shear_follow_from_the_motion_in_their_group(results: dict[str, Path]) -> None:
    found = held(results["all"])
    for run in ("sim", "sim_delay", "exp_rths"):
        disp, accel = found[f"{run}/rel_disp_m"], found[f"{run}/abs_accel_m_s2"]
        drift, shear = found[f"{run}/inter_storey_drift_m"], found[f"{run}/storey_shear_n"]
        assert drift.dtype == shear.dtype == np.float64
        for name, stored, exact in (
            ("inter_storey_drift_m", drift, inter_storey_drift_m(disp)),
            ("storey_shear_n", shear, storey_shear_n(MASSES, accel)),
        ):
            assert np.all(abs(stored - exact) <= 2**-32 * abs(exact).max(axis=1, keepdims=True))
            assert abs(stored).max(axis=1) == pytest.approx(found[f"metrics/{run}/peak_{name}"], rel=1e-9)


@pytest.mark.campaign
def test_the_response_is_read_or_computed_to_the_same_numbers(results: dict[str, Path]) -> None:
    stored, computed = (rths_cli.load(results[series]).response for series in ("all", "essential"))
    assert np.array_equal(stored.inter_storey_drift_m, held(results["all"])["exp_rths/inter_storey_drift_m"])
    for name in ("inter_storey_drift_m", "storey_shear_n"):
        one, other = getattr(stored, name), getattr(computed, name)
        assert one.dtype == other.dtype == np.float64
        assert one == pytest.approx(other, abs=3e-7 * abs(one).max())


@pytest.mark.campaign
@parametrize_first(1, "series", ["essential", "none"])
def test_figures_and_pages_say_what_is_not_kept(results: dict[str, Path], series: str, tmp_path: Path) -> None:
    said: list[str] = []
    found = read_result(results[series])
    written = write_figures([found], tmp_path, "png", "one", said.append)
    assert {name for name in figure_names() if f"figure {name} is left out" in "\n".join(said)} == WITHOUT[series]
    assert len(written) == len(figure_names()) - len(WITHOUT[series])
    left_out = [sentence for sentence in said if "figure timing" not in sentence]  # a virtual table has no real time
    assert all(f"--series {series}; run it with --series all" in sentence for sentence in left_out)
    write_page([found], tmp_path / "page.html", "rths report")
    page = (tmp_path / "page.html").read_text()
    assert ("has no time histories, the case was run with --series none" in page) == (series == "none")


def test_a_series_that_is_not_kept_is_named(results: dict[str, Path]) -> None:
    sentence = "exp_rths/base_shear_n is not kept, the case was run with --series essential; run it with --series all"
    with pytest.raises(SeriesLeftOut, match=sentence):
        read_series(results["essential"], "exp_rths/base_shear_n")
    result = rths_cli.load(results["essential"])
    with pytest.raises(InputError, match=sentence):
        _ = result.exp_rths.base_shear_n
    with pytest.raises(InputError, match="sim/rel_disp_m is not kept"):
        result.response_in("sim")
    with pytest.raises(InputError, match="there is no typo in exp_rths"):
        _ = result.exp_rths.typo
    with pytest.raises(InputError, match="sim/rel_disp_m is not kept, the case was run with --series none"):
        _ = rths_cli.load(results["none"]).response


def test_a_real_rig_keeps_all(tmp_path: Path) -> None:
    case = load_cases([CASE], ("table=udp_example",))[0]
    request = Request((case,), (), tmp_path, True, "rths run", series="essential")
    with pytest.raises(RthsError, match=r"--series essential: rig .* is real, whose runs keep all; leave it out"):
        plan(request, Memory(), SharedValues())


def test_another_word_is_refused() -> None:
    with pytest.raises(InputError, match="series is 'some'; it must be one of all, essential, none"):
        rths_cli.run(CASE, series="some")  # type: ignore[arg-type]
