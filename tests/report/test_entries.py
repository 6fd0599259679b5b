"""From files to cases: all faults at once, doubles kept apart."""

import pytest
from made_up import result

from rths_cli.errors import InputError
from rths_cli.files.result_reader import ResultWriter
from rths_cli.report.result_tables import tables
from rths_cli.report.results_by_case import entries, load

ABOUT = {"case_name": "demo", "method": "best", "rig": "r", "rig_kind": "virtual", "record_name": "el_centro"}


def write(path, value):
    with ResultWriter(path, {**ABOUT, "damping_name": "low", "controller": "FF", "scaling": 0.3}) as writer:
        writer.metrics({"exp_rths.rms_error_m_s2": [value, 2 * value]})
        writer.finish("complete")


def test_files_and_folders_are_read_and_printed(tmp_path):
    write(tmp_path / "b.h5", 0.01)
    (tmp_path / "more").mkdir()
    write(tmp_path / "more" / "a.h5", 0.0234)
    (tmp_path / "more" / "notes.txt").write_text("not a result")
    results = load([tmp_path / "b.h5", tmp_path / "more"])
    assert [found.path.name for found in results] == ["b.h5", "a.h5"]
    text = tables(results)
    assert all(number in text for number in ("0.0100", "0.0200", "0.0234", "0.0468"))


def test_all_faults_are_told_at_once(tmp_path):
    (tmp_path / "bad.h5").write_text("x")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError) as caught:
        load([tmp_path / "bad.h5", tmp_path / "missing.h5", tmp_path / "empty"])
    assert len(caught.value.faults) == 3
    assert sorted(fault.split(": ")[1].split(" (")[0] for fault in caught.value.faults) == [
        "holds no result file",
        "is not an HDF5 file; give a result file written by rths run.",
        "no such file; check the path",
    ]


def test_methods_of_a_case_are_one_entry_and_doubles_are_variants():
    paper, best = result({}, "paper"), result({}, "best")
    (one,) = entries([paper, best], {})
    assert one.variant == "" and set(one.results) == {"paper", "best"}
    again = result({}, "best", case_name="again")
    found = entries([paper, best, again, best], {})
    assert sorted(entry.variant for entry in found) == [
        "case again",
        "case el_centro_low_ff_fb",
        "case el_centro_low_ff_fb (2)",
    ]
    assert sum(len(entry.results) for entry in found) == 4


def test_stored_references_that_are_not_json_are_one_sentence():
    with pytest.raises(InputError, match="reference_json is not a JSON mapping"):
        entries([result({}, reference_json="{")], {})
    with pytest.raises(InputError, match="reference_json is not a JSON mapping"):
        entries([result({}, reference_json="[1]")], {})
