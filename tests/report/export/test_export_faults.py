"""Bad input to `rths export`: one sentence each, exit code 2, nothing written."""

from __future__ import annotations

import json
import os
import subprocess
import time
from pathlib import Path

import h5py
import pytest
from made_result import make
from scipy.io import loadmat
from warm_command import rths_words

from rths_cli.errors import InputError
from rths_cli.report import export_files
from rths_cli.report.export_files import FORMATS, ExportRequest, export

ROOT = Path(__file__).parents[3]


@pytest.fixture
def result(tmp_path: Path) -> Path:
    return make(tmp_path / "demo.h5")


def faults(request: ExportRequest) -> tuple[str, ...]:
    with pytest.raises(InputError) as refused:
        export(request)
    return refused.value.faults


def test_every_fault_is_told_and_nothing_is_written(result: Path, tmp_path: Path) -> None:
    whole = result.read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.h5").write_text("time,accel\n")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["a"] = 1.0
    (tmp_path / "later.h5").write_bytes(whole)
    with h5py.File(tmp_path / "later.h5", "a") as file:
        file.attrs["format_version"] = 2
    (tmp_path / "empty").mkdir()
    names = ("cut.h5", "text.h5", "other.h5", "later.h5", "gone.h5", "demo.h5", "empty")
    told = faults(ExportRequest(tuple(tmp_path / name for name in names), "mat", tmp_path / "out"))
    assert len(told) == 6 and not (tmp_path / "out").exists()
    for name, words in {
        "empty": "holds no result file", "cut.h5": "truncated", "text.h5": "not an HDF5 file",
        "other.h5": "not a result file of rths", "later.h5": "format version 2",
        "gone.h5": "no such file; check the path",
    }.items():  # fmt: skip
        assert sum(name in sentence and words in sentence for sentence in told) == 1, (name, told)


def test_a_missing_group_is_named_with_those_there(result: Path, tmp_path: Path) -> None:
    told = faults(ExportRequest((result,), "csv", tmp_path / "out", ("exp_rths", "shake_table")))
    assert len(told) == 1 and "holds no group shake_table (status complete)" in told[0]
    assert "its groups are case, controller, exp_rths" in told[0] and not (tmp_path / "out").exists()


def test_a_group_brings_what_is_in_it_and_hyphens_are_taken(result: Path, tmp_path: Path) -> None:
    export(ExportRequest((result,), "mat", tmp_path, ("exp-rths", "sim", "metrics/check")))
    told = loadmat(tmp_path / "demo.mat", simplify_cells=True)
    assert {name for name in told if not name.startswith("__")} == {"attributes", "exp_rths", "metrics", "sim"}
    assert "truth" in told["exp_rths"] and set(told["metrics"]) == {"check"}


def test_what_is_there_is_replaced_unless_told_not_to(result: Path, tmp_path: Path) -> None:
    (tmp_path / "demo.mat").write_text("mine")
    told = faults(ExportRequest((result,), "mat", tmp_path, replace=False))
    assert told == (f"{tmp_path / 'demo.mat'}: exists; remove it, choose another name, or drop --no-replace",)
    assert (tmp_path / "demo.mat").read_text() == "mine"
    (done,) = export(ExportRequest((result,), "mat", tmp_path))
    assert done.replaced == (tmp_path / "demo.mat",)
    assert (tmp_path / "demo.mat").read_bytes().startswith(b"MATLAB")


def test_two_results_of_one_name_are_refused(result: Path, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    twin = make(tmp_path / "b" / "demo.h5")
    told = faults(ExportRequest((result, twin, result), "mat", tmp_path / "out"))
    assert len(told) == 1 and f"{twin}: would become {tmp_path / 'out' / 'demo.mat'}, as {result} does" in told[0]


def test_a_folder_that_is_a_file_is_refused(result: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    told = faults(ExportRequest((result,), "mat", tmp_path / "out"))
    assert len(told) == 1 and "is a file, or below one" in told[0] and "choose another --output folder" in told[0]


@pytest.mark.skipif(os.geteuid() == 0 if hasattr(os, "geteuid") else True, reason="root writes everywhere")
def test_a_folder_that_cannot_be_written_is_refused(result: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir(mode=0o500)
    assert "Permission denied" in faults(ExportRequest((result,), "mat", tmp_path / "out"))[0]


@pytest.mark.parametrize("fault", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_what_fails_halfway_leaves_nothing(
    fault: BaseException, result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise fault

    monkeypatch.setattr(export_files, "notes", fail)  # the last file, when all tables are written
    with pytest.raises(InputError if isinstance(fault, OSError) else KeyboardInterrupt, match=r"No space left|^$"):
        export(ExportRequest((result,), "csv", tmp_path / "out"))
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.campaign
def test_the_same_result_gives_the_same_bytes(result: Path, tmp_path: Path) -> None:
    written = []
    for folder in ("a", "b"):
        done = [export(ExportRequest((result,), form, tmp_path / folder))[0] for form in FORMATS]
        written.append([(path.name, path.read_bytes()) for one in done for path in one.files])
        time.sleep(1.1 if folder == "a" else 0.0)  # a time of writing would differ
    assert written[0] == written[1] and len(written[0]) == 7


@pytest.mark.campaign
@pytest.mark.parametrize("form", ["csv", "mat"])
def test_a_file_of_many_groups_is_opened_no_more_often(
    result: Path, tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[object] = []
    open_file = h5py.File.__init__

    def counting(self: h5py.File, name: object, *further: object, **named: object) -> None:
        opened.append(name)
        open_file(self, name, *further, **named)

    monkeypatch.setattr(h5py.File, "__init__", counting)
    counts = []
    for number in range(2):
        opened.clear()
        export(ExportRequest((result,), form, tmp_path / f"{number}"))
        counts.append(opened.count(result))
        if number:
            break
        with h5py.File(result, "a") as file:
            for group in range(300):
                file.create_group(f"many/g{group}")
    assert 0 < counts[1] <= counts[0] + 1


def rths(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    words = (*rths_words(), "export", *words)
    return subprocess.run(words, capture_output=True, text=True, cwd=cwd, timeout=60, check=False)


@pytest.mark.campaign
def test_the_command_prints_its_files_and_how_a_run_ended(tmp_path: Path) -> None:
    make(tmp_path / "good.h5")
    make(tmp_path / "cut.h5", "aborted")
    done = rths(".", "--to", "mat", "--output", "out", cwd=tmp_path)
    assert (done.returncode, done.stdout.split()) == (0, ["out/cut.mat", "out/good.mat"])
    assert "cut.h5: aborted, exported as far as it goes: EXP-RTHS: stroke limit at 0.0125 s" in done.stderr
    again = rths("good.h5", "--to", "mat", "--output", "out", "--no-replace", "--json", cwd=tmp_path)
    assert again.returncode == 2 and json.loads(again.stdout)["exit_code"] == 2
    assert "out/good.mat: exists; remove it, choose another name, or drop --no-replace" in again.stderr


@pytest.mark.campaign
def test_the_command_prints_one_document(tmp_path: Path) -> None:
    make(tmp_path / "cut.h5", "aborted")
    done = rths("cut.h5", "--to", "csv", "--group", "record", "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["exported"] == [
        {
            "result": "cut.h5",
            "status": "aborted",
            "status_reason": "EXP-RTHS: stroke limit at 0.0125 s",
            "files": ["exported/cut.record.csv", "exported/cut.json"],
            "replaced": [],
        }
    ]
