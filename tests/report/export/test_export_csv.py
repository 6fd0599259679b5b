"""CSV and its JSON hold every number of a result, bit for bit."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from made_result import STOPPED, YAML, N, contents, make

from rths_cli.files.result_reader import ResultWriter
from rths_cli.report.export_files import ExportRequest, export

ENDS = {"abs_accel_m_s2": ("storey", (1, 2, 3)), "floor_accel_measured_m_s2": ("floor", (2, 3))}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("csv") / "demo.h5")


@pytest.fixture(scope="module")
def exported(result: Path) -> Path:
    export(ExportRequest((result,), "csv", result.parent / "out"))
    return result.parent / "out"


def table(path: Path) -> dict[str, list[str]]:
    """Return the columns of a CSV file as texts, by Python's own reader."""
    with open(path, newline="") as file:
        header, *rows = csv.reader(file)
    assert len(header) == len(set(header))
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def same(texts: tuple[str, ...] | list[str], numbers: np.ndarray, digits: int = 9) -> bool:
    """Tell whether texts are these numbers to so many significant digits, NaN included, and have no more."""
    read = np.array([float(text) for text in texts])
    longest = max(len(text.lower().partition("e")[0].replace("-", "").replace(".", "").lstrip("0")) for text in texts)
    close = np.abs(read - numbers) <= 5.0 * 10.0**-digits * np.abs(numbers)
    return bool(np.all(close | (np.isnan(read) & np.isnan(numbers)))) and longest <= digits


def test_there_is_a_table_for_each_run_and_one_file_about_them(exported: Path) -> None:
    runs = ("exp_rths", "identification", "record", "sim", "sim_delay")
    assert sorted(path.name for path in exported.iterdir()) == sorted(
        [*(f"demo.{run}.csv" for run in runs), "demo.json"]
    )


@pytest.mark.parametrize("run", ["exp_rths", "sim", "sim_delay", "record", "identification"])
def test_time_is_first_and_every_number_has_nine_digits(run: str, result: Path, exported: Path) -> None:
    found, axis = table(exported / f"demo.{run}.csv"), "frequency_hz" if run == "identification" else "time_s"
    assert next(iter(found)) == axis
    seen = {axis}
    for path, numbers in contents(result).items():
        group, _, name = path.rpartition("/")
        if group.split("/")[0] != run or numbers.shape[-1:] != (N,):
            continue
        prefix = "" if group == run else f"{group.split('/')[1]}_"
        if name == axis:
            assert same(found[axis], numbers, 12)
            continue
        scale, values = ENDS.get(name, ("", (0,)))
        for value, row in zip(values, np.atleast_2d(numbers), strict=True):
            column = f"{prefix}{name}_{scale}_{value}" if scale else f"{prefix}{name}"
            assert same(found[column], row), column
            seen.add(column)
    assert seen == set(found)


def test_numbers_of_single_precision_come_back_bit_for_bit(tmp_path: Path) -> None:
    values = np.random.default_rng(8).normal(size=N).astype(np.float32) * np.float32(1e-7)
    with ResultWriter(tmp_path / "a.h5", {"series": "essential"}) as writer:
        writer.group("record", {"ground_accel_m_s2": values}, np.arange(N) / 2048.0)
        writer.finish("complete")
    said: list[str] = []
    export(ExportRequest((tmp_path / "a.h5",), "csv", tmp_path), said.append)
    found = table(tmp_path / "a.record.csv")
    assert np.array_equal(np.array(found["ground_accel_m_s2"], dtype=np.float32), values)
    assert np.array_equal(np.array(found["time_s"], dtype=float), np.arange(N) / 2048.0)
    assert f"{tmp_path / 'a.record.csv'}, 100 %" in said


def test_what_is_not_a_number_is_spelt_as_xml_schema_does(exported: Path) -> None:
    texts = table(exported / "demo.sim_delay.csv")["abs_accel_m_s2_storey_1"]
    assert texts[-1] == "NaN" and texts[0] != "NaN"


def test_the_file_beside_names_unit_and_origin_of_every_column(exported: Path) -> None:
    about = json.loads((exported / "demo.json").read_text(encoding="utf-8"))
    assert about["@context"] == "http://www.w3.org/ns/csvw"
    for told in about["tables"]:
        columns = told["tableSchema"]["columns"]
        assert [column["name"] for column in columns] == list(table(exported / told["url"]))
    columns = {c["name"]: c for t in about["tables"] if "exp_rths" in t["url"] for c in t["tableSchema"]["columns"]}
    assert columns["command_v"]["schema:unitText"] == "V"
    assert columns["truth_table_disp_m"]["schema:measurementTechnique"] == "true"
    assert columns["abs_accel_m_s2_storey_2"]["schema:unitText"] == "m/s^2"


def test_the_file_beside_holds_all_that_is_no_series(result: Path, exported: Path) -> None:
    noted = json.loads((exported / "demo.json").read_text(encoding="utf-8"))["notes"][0]
    groups, held = noted["groups"], contents(result)
    assert noted["attributes"]["status"] == "complete" and noted["attributes"]["rig_kind"] == "virtual"
    assert groups["case"]["yaml"]["value"] == YAML
    assert groups["metrics/exp_rths"]["rms_error_m_s2"]["value"] == [0.1, 0.2, None]
    assert groups["identification"]["poles_imag"] == {
        "value": [2.0, -2.0], "units": "rad/s", "long_name": "poles of the table model, imaginary part",
        "source": "estimated", "dims": ["pole"],
    }  # fmt: skip
    block = groups["controller/feedforward"]
    assert (block["dt_s"], block["inputs"]) == (0.0005, ["accel_m_s2", "vel_m_s", "disp_m"])
    for name in "ABCD":
        assert np.array_equal(block[name]["value"], held[f"controller/feedforward/{name}"])
    scalars = {path for path, numbers in held.items() if np.shape(numbers)[-1:] != (N,)}
    told = {f"{group}/{name}" for group, names in groups.items() for name in names}
    scales = {
        path
        for path in scalars
        if path.rpartition("/")[2] in ("storey", "floor", "state", "next_state", "input", "output", "pole")
    }
    assert scalars - scales <= told


def test_a_stopped_run_goes_as_far_as_it_went_and_says_so(tmp_path: Path) -> None:
    done = export(ExportRequest((make(tmp_path / "cut.h5", "aborted"),), "csv", tmp_path))
    assert (done[0].status, done[0].reason) == ("aborted", "EXP-RTHS: stroke limit at 0.0125 s")
    assert len(table(tmp_path / "cut.exp_rths.csv")["command_v"]) == STOPPED
    assert len(table(tmp_path / "cut.record.csv")["time_s"]) == N
    about = json.loads((tmp_path / "cut.json").read_text())["notes"][0]["attributes"]
    assert (about["status"], about["status_reason"]) == ("aborted", "EXP-RTHS: stroke limit at 0.0125 s")
