"""Files that cannot be used: one sentence each, and the good ones still reported where that is asked for."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from made_up_files import FIGURES, write

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import TEXTS, Figure, Sweep, write_sweep
from rths_cli.report.input_files import read_inputs
from rths_cli.report.report_contents import contents, page_sections
from rths_cli.report.to_text import text as printed


def quiet(text: str) -> None:
    """Hear progress."""


def report(paths, keys=(), keep_going=True):
    return contents(read_inputs(paths, quiet), keys, None, keep_going)


@pytest.fixture
def bad(tmp_path: Path) -> dict[str, Path]:
    """Return a file of every kind that cannot be used, by a word of its sentence."""
    good = write(tmp_path / "good.h5")
    data = good.read_bytes()
    (tmp_path / "cut.h5").write_bytes(data[: len(data) // 2])
    (tmp_path / "text.h5").write_text("not a result")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = 1.0
    for name, key, value in (("later", "format_version", 2), ("undated", "format_version", "two")):
        (tmp_path / f"{name}.h5").write_bytes(data)
        with h5py.File(tmp_path / f"{name}.h5", "r+") as file:
            file.attrs[key] = value
    units = {**FIGURES, "exp_rths.rms_error_m_s2": ([10.0, 20.0, 30.0], "mm/s^2")}
    write(tmp_path / "units.h5", units, case_name="other")
    (tmp_path / "empty").mkdir()
    words = {
        f"is truncated: {len(data) // 2} of {len(data)} bytes are there": "cut.h5",
        "is not an HDF5 file": "text.h5",
        "is not a result file of rths": "foreign.h5",
        "has format version 2": "later.h5",
        "damaged and cannot be read": "undated.h5",
        "exp_rths.rms_error_m_s2 is in mm/s^2, not m/s^2": "units.h5",
        "holds no result file": "empty",
        "no such file; check the path": "missing.h5",
    }
    return {word: tmp_path / name for word, name in words.items()}


def test_each_fault_is_one_sentence_and_nothing_is_reported(bad: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        report([tmp_path / "good.h5", *bad.values()], keep_going=False)
    *faults, advice = caught.value.faults
    assert advice == "the others are reported with --keep-going" and len(faults) == len(bad)
    for word, path in bad.items():
        (mine,) = [fault for fault in faults if fault.startswith(f"{path}: ")]
        assert word in mine and mine.endswith(".") and "\n" not in mine


def test_the_good_ones_are_reported_and_the_others_told(bad: dict[str, Path], tmp_path: Path) -> None:
    found = report([*bad.values(), tmp_path / "good.h5"])
    assert [result.path.name for result in found.inputs.results] == ["good.h5"]
    assert len(found.faults) == len(bad)
    text = " ".join(printed(page_sections(found, full=True, paper=False)).split())
    assert "0.0100" in text and all(word in text for word in bad)
    with pytest.raises(InputError):
        report(list(bad.values()))  # nothing is left to report


def test_a_file_named_twice_is_read_once_and_a_copy_is_told(tmp_path: Path) -> None:
    first = write(tmp_path / "a.h5")
    assert len(report([first, tmp_path, first]).inputs.results) == 1
    (tmp_path / "b.h5").write_bytes(first.read_bytes())
    found = report([tmp_path])
    assert found.faults == (f"{tmp_path / 'b.h5'}: is the same run as {first}; leave one of them out.",)
    assert len(found.inputs.results) == 2


def test_another_case_of_one_name_is_a_fault_and_another_seed_is_not(tmp_path: Path) -> None:
    first = write(tmp_path / "a.h5")
    write(tmp_path / "b.h5", seed=1, created_utc="2026-02-02")
    for number in (1, 2):  # identified with another seed
        nested = f"scaling: 0.3\nidentification:\n  seed: {number}\n  records: 1\n"
        write(tmp_path / f"i{number}.h5", resolved=nested, seed=number, case_name="i")
    assert report([tmp_path]).faults == ()
    write(tmp_path / "c.h5", resolved="scaling: 0.4\nruns:\n- sim\n", scaling=0.4, created_utc="2026-02-03")
    (fault,) = report([tmp_path]).faults
    assert fault.startswith(f"{tmp_path / 'c.h5'}: case demo is another one than in {first}")
    assert "(they differ in scaling)" in fault
    assert report([tmp_path], keys=("scaling",)).faults == ()
    assert report([first, tmp_path / "c.h5"], keys=("folder",)).faults != ()


@pytest.mark.campaign
def test_many_files_are_read_by_several_processes_in_order(tmp_path: Path) -> None:
    data = write(tmp_path / "000.h5").read_bytes()
    for number in range(1, 70):
        (tmp_path / f"{number:03}.h5").write_bytes(data if number != 40 else data[:500])
    heard: list[str] = []
    found = read_inputs([tmp_path], heard.append)
    assert heard[-1] == "reading results: 70 of 70"
    assert [result.path.stem for result in found.results] == [f"{k:03}" for k in range(70) if k != 40]
    assert [one.path.stem for one in found.unread] == ["040"]
    one, last = found.results[0], found.results[-1]
    assert dict(last.units) == {name: unit for name, (_, unit) in FIGURES.items()}
    assert last.definitions["exp_rths.fei_delay_s"].startswith("delay of the frequency evaluation index")
    assert np.array_equal(one.metrics["exp_rths.rms_error_m_s2"], [0.01, 0.02, 0.03])


def test_a_sweep_is_shown_by_its_own_text_and_a_damaged_one_told(tmp_path: Path) -> None:
    figures = {
        "exp_rths.tracking_rms_m_s2": Figure(np.array([0.001, 0.003]), "m/s^2", "x"),
        "exp_rths.rms_error_m_s2": Figure(np.array([[0.1], [0.3]]), "m/s^2", "x"),
    }
    texts = {name: ("complete", "complete") if name == "status" else ("", "") for name in TEXTS}
    about = {
        "case_name": "swept",
        "rig": "r",
        "rig_kind": "virtual",
        "seeds": "2",
        "status": "complete",
        "plan_sha256": "",
        "software_sha256": "",
        "exit_code": 0,
    }
    path = tmp_path / "sweep.h5"
    write_sweep(path, Sweep(about, "a", "b", 2, {}, np.array([0, 1]), texts, figures))
    found = report([path, write(tmp_path / "run.h5")])
    text = printed(page_sections(found, full=True, paper=False))
    assert "swept: RMS errors" in text and "200.00" in text and "0.0100" in text
    assert report([path]).inputs.results == ()
    path.write_bytes(path.read_bytes()[:-3000])
    told = f"is truncated: {path.stat().st_size} of {path.stat().st_size + 3000} bytes are there"
    assert told in read_inputs([path], quiet).unread[0].sentence


def test_a_baseline_in_other_units_is_not_compared(tmp_path: Path) -> None:
    """Errors in mm/s^2 made everything look a thousand times better."""
    (tmp_path / "old").mkdir()
    now = write(tmp_path / "now.h5")
    old = write(tmp_path / "old" / "units.h5", {**FIGURES, "exp_rths.rms_error_m_s2": ([10.0, 20.0, 30.0], "mm/s^2")})
    read = [read_inputs([path], quiet) for path in (now, old)]
    with pytest.raises(InputError, match=r"units\.h5: exp_rths\.rms_error_m_s2 is in mm/s\^2, not m/s\^2"):
        contents(read[0], (), ("old", read[1], 1.0), keep_going=False)
    found = contents(read[0], (), ("old", read[1], 1.0), keep_going=True)
    assert any("is in mm/s^2" in one for one in found.faults)
    assert found.baseline is not None and not any(one.changes for one in found.baseline.changes)
