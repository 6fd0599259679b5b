"""Rows of a sweep under way and its table: what a killed process leaves, numbers to the last bit, units of keys."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files import sweep_file
from rths_cli.files.durable_files import part_of
from rths_cli.files.sweep_file import Figure, RowsFile, Sweep, read_rows, read_sweep, rows_path, write_csv, write_sweep

VALUES = [0.1, 1 / 3, 5e-324, -1.7976931348623157e308, float("inf"), float("nan"), -0.0]


def test_rows_read_back_to_the_last_bit_and_half_a_line_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "x.h5.rows"
    assert rows_path(tmp_path / "x.h5") == path
    with RowsFile(path, {"plan": "p"}, resume=False) as file:
        file.append([0, "complete", VALUES])
        assert len([*read_rows(path)[1]]) == 1  # it is on its way to the disk before the next run ends
        file.append([1, "refused", []])
    whole = path.read_bytes()
    for cut in range(1, len(whole.splitlines(keepends=True)[-1])):
        path.write_bytes(whole[:-cut])
        header, lines = read_rows(path)
        rows = [*lines]
        assert header["plan"] == "p" and len(rows) == 1
        assert np.array(rows[0][2]).tobytes() == np.array(VALUES).tobytes()
    with RowsFile(path, {}, resume=True) as file:
        file.append([1, "refused", []])
    assert path.read_bytes() == whole


def test_the_file_tells_how_many_rows_are_kept(tmp_path: Path) -> None:
    """Also where a signal arrived after a row was written, or half of one, and before anybody counted it."""
    path = tmp_path / "x.h5.rows"
    with RowsFile(path, {"plan": "p"}, resume=False) as file:
        for variant in range(3):
            file.append([variant, "complete", VALUES])
        with path.open("ab") as half:
            half.write(b"[3, ")
        assert file.close() == len([*read_rows(path)[1]]) == 3
    with RowsFile(path, {}, resume=True) as file:
        path.unlink()
        assert file.close() == 0


def test_half_a_row_longer_than_a_block_is_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep_file, "BLOCK", 16)
    path = tmp_path / "x.h5.rows"
    with RowsFile(path, {"plan": "p"}, resume=False) as file:
        file.append([0, "complete", VALUES])
        whole = path.read_bytes()
    path.write_bytes(whole + b"[1, " + b"0.5, " * 20)
    with RowsFile(path, {}, resume=True) as file:
        assert path.read_bytes() == whole and file.close() == 1
    path.write_bytes(b"")
    with RowsFile(path, {}, resume=True) as file:
        assert file.close() == 0


@pytest.mark.parametrize("text", [b"", b"\n", b"no json\n", b"[1]\n", b'{"format": "other"}\n', b"\xff\n"])
def test_another_file_is_no_rows(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "x.rows"
    path.write_bytes(text)
    with pytest.raises(InputError, match=r"x\.rows: .*remove it"):
        read_rows(path)


def test_rows_of_another_process_are_not_overwritten(tmp_path: Path) -> None:
    with RowsFile(tmp_path / "x.rows", {}, resume=False), pytest.raises(InputError, match="File exists"):
        RowsFile(tmp_path / "x.rows", {}, resume=False).__enter__()


ABOUT = {
    "case_name": "x", "rig": "r", "rig_kind": "virtual", "seeds": "0", "status": "complete", "plan_sha256": "p",
    "software_sha256": "s", "exit_code": 0,
}  # fmt: skip


def made() -> Sweep:
    figures = {"a.b_m": Figure(np.array(VALUES[:3]), "m", "one number"), "a.s": Figure(np.eye(3), "1", "per storey")}
    texts = dict.fromkeys(("status", "reason", "verdict", "model_sha256", "processor"), ("x", "", 'ä, "q"\nnew line'))
    varied = {
        "scaling": (0.1, 1 / 3, 2),
        "t.stiffness_n_per_m": (1.0, 2.0, 3.0),
        "controller": ("FF", {"kind": "FF"}, [1]),
    }
    figures |= {"exp_rths.tracking_rms_m_s2": Figure(np.ones(3), "m/s^2", "tracking")}
    figures |= {"exp_rths.rms_error_m_s2": Figure(np.eye(3), "m/s^2", "storeys")}
    return Sweep(dict(ABOUT), "yaml", "resolved", 3, varied, np.array([5, 6, 2**53 - 1]), texts, figures)


def test_a_table_written_by_parts_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_sweep(tmp_path / "whole.h5", made())
    monkeypatch.setattr(sweep_file, "BATCH_VALUES", 6)  # two datasets at a time
    write_sweep(tmp_path / "parts.h5", made())
    whole, parts = (read_sweep(tmp_path / name) for name in ("whole.h5", "parts.h5"))
    assert (parts.attributes, parts.varied, parts.texts) == (whole.attributes, whole.varied, whole.texts)
    assert {path: figure.values.tobytes() for path, figure in parts.figures.items()} == {
        path: figure.values.tobytes() for path, figure in whole.figures.items()
    }
    with h5py.File(tmp_path / "parts.h5") as file:
        assert [file["a.s"].dims[axis][0].name for axis in (0, 1)] == ["/variant", "/storey"]


def test_a_table_reads_back(tmp_path: Path) -> None:
    write_sweep(tmp_path / "x.h5", made())
    back = read_sweep(tmp_path / "x.h5")
    assert back.varied["scaling"] == (0.1, 1 / 3, 2.0)
    assert [*map(json.loads, back.varied["controller"][1:])] == [{"kind": "FF"}, [1]]
    assert back.seed.tolist() == [5, 6, 2**53 - 1] and back.texts == made().texts
    assert back.figures["a.s"].values.tobytes() == np.eye(3).tobytes()
    assert list(back.figures) == list(made().figures)  # --resume --csv orders its columns like the first time
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["t.stiffness_n_per_m"].attrs["units"] == "N/m" and file["scaling"].attrs["units"] == "1"
        assert all(file[name].attrs["long_name"] and file[name].attrs["source"] for name in file)
        assert [axis[0].name for axis in file["a.s"].dims] == ["/variant", "/storey"]
    assert [path.name for path in tmp_path.iterdir()] == ["x.h5"]


def test_an_infinite_error_is_refused_and_a_missing_one_is_not(tmp_path: Path) -> None:
    path = tmp_path / "x.h5"
    for value in (np.nan, np.inf):
        write_sweep(path, made())
        with h5py.File(path, "r+") as file:
            file["exp_rths.tracking_rms_m_s2"][1] = value
        if np.isnan(value):
            assert np.isnan(read_sweep(path).figures["exp_rths.tracking_rms_m_s2"].values[1])
        else:
            with pytest.raises(InputError, match=r"infinite number in exp_rths\.tracking_rms_m_s2"):
                read_sweep(path)


@pytest.mark.parametrize(
    ("name", "shape"), [("a.s", (3, 1001)), ("a.b_m", (10**6,)), ("seed", (2, 3)), ("a.s", (3, 3, 1))]
)
def test_what_has_not_the_rows_of_the_table_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, shape: tuple[int, ...]
) -> None:
    """A file of a gigabyte would take many in the memory."""
    path = tmp_path / "x.h5"
    write_sweep(path, made())
    with h5py.File(path, "r+") as file:
        del file[name]
        file[name] = np.zeros(shape, np.int64 if name == "seed" else float)
    monkeypatch.setattr(sweep_file, "values_of", lambda *_: pytest.fail("was read"))
    with pytest.raises(InputError, match=f"has not (one {name} per run|a {name} for each)"):
        read_sweep(path)


def test_a_table_as_csv_keeps_text_and_numbers(tmp_path: Path) -> None:
    import csv

    write_csv(tmp_path / "x.csv", made())
    with open(tmp_path / "x.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["scaling"]) for row in rows] == [0.1, 1 / 3, 2.0]
    assert rows[2]["reason"] == made().texts["reason"][2]
    assert [rows[1][f"a.s[{k}]"] for k in (1, 2, 3)] == ["0.0", "1.0", "0.0"]


def test_sampled_values_are_numbers_in_the_csv(tmp_path: Path) -> None:
    sampled = replace(made(), varied={"scaling": np.array([0.1, 1 / 3, 2.0])})
    write_csv(tmp_path / "x.csv", sampled)
    lines = (tmp_path / "x.csv").read_text().splitlines()[1:]
    assert [line.split(",")[1] for line in lines[:2]] == ["0.1", repr(1 / 3)]


def test_texts_that_are_read_by_parts_are_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_sweep(tmp_path / "x.h5", made())
    whole = read_sweep(tmp_path / "x.h5")
    monkeypatch.setattr(sweep_file, "TEXTS_AT_ONCE", 2)
    parts = read_sweep(tmp_path / "x.h5")
    assert parts.texts == whole.texts == made().texts and parts.varied == whole.varied
    monkeypatch.setattr(sweep_file, "LONG", 2)
    for key, values in read_sweep(tmp_path / "x.h5").varied.items():
        assert isinstance(values, np.ndarray) is (key != "controller")
        assert tuple(values) == whole.varied[key]


def test_a_disk_that_refuses_is_a_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write the result file"):
        write_sweep(tmp_path / "none" / "x.h5", made())
    with pytest.raises(InputError, match=r"cannot write the table"):
        write_csv(tmp_path / "none" / "x.csv", made())


def test_what_a_killed_process_left_of_the_table_is_removed(tmp_path: Path) -> None:
    """A kill while the table is written: the sweep goes on in another process, whose part has another name."""
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left, others = (part_of(tmp_path / "x.h5", number) for number in (gone.pid, os.getppid()))
    for path in (left, others):
        path.touch()
    write_sweep(tmp_path / "x.h5", made())
    write_csv(tmp_path / "x.csv", made())
    assert {path.name for path in tmp_path.iterdir()} == {"x.h5", "x.csv", others.name}


def test_many_runs_are_not_stored_one_chunk_each(tmp_path: Path) -> None:
    runs = 4000
    texts = dict.fromkeys(made().texts, ("x",) * runs)
    figures = {"a": Figure(np.ones((runs, 3)), "m", "the same in every run")}
    write_sweep(tmp_path / "x.h5", Sweep({}, "", "", 1, {}, np.arange(runs), texts, figures))
    with h5py.File(tmp_path / "x.h5") as file:
        assert file["a"].chunks is None and file["a"].shape == (runs, 3)
