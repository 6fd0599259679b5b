"""A file is recognised by its content, and a name that stands for another kind of file is refused with what it is."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import h5py
import pytest

from rths_cli.case.benchmark_schema import BenchmarkSpec
from rths_cli.case.calibration_schema import CalibrationSpec
from rths_cli.case.case_schema import CaseKeys
from rths_cli.case.load import load_cases
from rths_cli.case.named_files import TELLING, find, is_record, kind_of, known, known_files, written_by_rths
from rths_cli.case.reference_schema import ReferenceSpec
from rths_cli.case.rig_schema import NiRigSpec, UdpPlainRigSpec, UdpRigSpec, VirtualRigSpec
from rths_cli.case.shipped_files import FOLDERS, shipped
from rths_cli.case.structure_schema import StructureSpec
from rths_cli.case.study_schema import StudyKeys
from rths_cli.errors import InputError

OWN = {
    "b5.yaml": "{numerical: {masses_kg: [7]}, experimental: {masses_kg: [7]}}",
    "r5.yaml": "extends: aps400_virtual\nphysics: {coulomb_n: 1}\n",
    "r6.yaml": "extends: aps400_virtual\nlimits: {stroke_m: 0.02}\n",
    "p5.yaml": "title: a paper\nentries: []\n",
    "c5.yaml": "structure: b5\ndamping: low\n",
    "broken.yaml": "structure: [\n",
    "compose.yaml": "services: {web: {image: x}}\n",
    "pulse.csv": "time_s,accel_m_s2\n0.00,0.1\n0.01,-.2\n0.02,3e-1\n",
    "peer.at2": "PEER\nEl Centro\nUNITS OF G\nNPTS= 6, DT= .02\n .1 -.2 .3\n .1 .2 .3\n .3 .4 .5\n",
    "notes.txt": "What we did.\n1. Bolts.\nThe rest tomorrow.\n",
}


@pytest.fixture
def own(lab: Path) -> Path:
    """Return a laboratory's folder with a file of each kind, and files of none."""
    for name, text in OWN.items():
        (lab / name).write_text(text)
    return lab


def fault_of(name: str) -> str:
    with pytest.raises(InputError) as caught:
        load_cases([name])
    (fault,) = caught.value.faults
    return fault


def test_no_two_kinds_share_a_telling_key_and_each_key_is_one_of_its_kind() -> None:
    assert not any(set(one) & set(other) for one, other in combinations(TELLING.values(), 2))
    fields = {
        "cases": set(CaseKeys.model_fields),
        "structures": set(StructureSpec.model_fields),
        "rigs": {
            *NiRigSpec.model_fields,
            *UdpPlainRigSpec.model_fields,
            *UdpRigSpec.model_fields,
            *VirtualRigSpec.model_fields,
        },
        "references": set(ReferenceSpec.model_fields),
        "calibrations": set(CalibrationSpec.model_fields) - {"channels"},  # a rig has them too, but no made_utc
        "studies": set(StudyKeys.model_fields),
        "benchmarks": set(BenchmarkSpec.model_fields),
    }
    for kind, keys in TELLING.items():
        others = set().union(*(fields[other] for other in fields if other != kind))
        assert set(keys) <= fields[kind] and not set(keys) & others, kind


@pytest.mark.parametrize("kind", ["cases", "structures", "rigs", "references", "benchmarks"])
def test_everything_shipped_is_recognised(kind: str) -> None:
    found = {path.name: kind_of(path) for path in shipped(kind).glob("*.yaml")}
    assert found and set(found.values()) == {kind}


def test_files_of_the_users_own_are_known_by_what_they_hold(own: Path) -> None:
    mine = {kind: {name for name, path in known_files(kind, own).items() if path.parent == own} for kind in FOLDERS}
    assert mine == {
        "cases": {"c5", "broken"},  # a case with a fault in its YAML is still offered
        "structures": {"b5"},
        "rigs": {"r5", "r6"},
        "references": {"p5"},
        "benchmarks": set(),
        "records": {"pulse", "peer"},
    }


@pytest.mark.parametrize("kind", FOLDERS)
def test_a_known_name_stands_for_the_file_that_is_listed(kind: str, own: Path) -> None:
    (own / "three_storey.yaml").write_text(OWN["b5.yaml"])
    for name, path in known_files(kind, own).items():
        assert find(name, kind, own) == path, name


def test_a_record_needs_lines_of_numbers(own: Path) -> None:
    assert is_record(shipped("records") / "el_centro.csv") and not is_record(own) and not is_record(own / "nowhere")


def test_what_is_no_case_says_what_it_is(own: Path) -> None:
    b5 = "is a structure, not a case; write a case that names it (structure: b5) with rths new, or look at it with rths"
    assert fault_of("b5.yaml") == f"b5.yaml: {b5} structure b5.yaml"
    assert fault_of("b5") == f"b5.yaml: {b5} structure b5"
    assert fault_of("./b5.yaml").endswith(
        "(structure: ./b5.yaml) with rths new, or look at it with rths structure ./b5.yaml"
    )
    assert fault_of("r5.yaml") == "r5.yaml: is a rig, not a case; write a case that names it (table: r5) with rths new"
    assert "is a reference, not a case; write a case that names it (reference: p5)" in fault_of("p5.yaml")
    assert "'three_storey' is a structure, not a case" in fault_of("three_storey")
    assert "'hachinohe' is a record, not a case; write a case that names it (record: hachinohe)" in fault_of(
        "hachinohe"
    )


def test_a_result_a_sweep_and_a_model_given_as_a_case_say_what_shows_them(lab: Path) -> None:
    for name, form in (("result.h5", ""), ("sweep.h5", "rths-sweep"), ("model.h5", "rths-model")):
        with h5py.File(name, "w") as file:
            file.attrs["format"] = form
    assert fault_of("result.h5") == "result.h5: is a result, not a case; rths report result.h5 shows it"
    assert fault_of("./sweep.h5") == "sweep.h5: is a sweep, not a case; rths report sweep.h5 shows it"
    assert (
        fault_of("model.h5")
        == "model.h5: is a model file, not a case; name it in a case: identification: {model: FILE}"
    )
    assert written_by_rths(lab) == "" and written_by_rths(lab / "records/el_centro.csv") == ""


def test_an_unknown_name_lists_only_its_own_kind(own: Path) -> None:
    with pytest.raises(InputError) as caught:
        find("xyz", "cases", own)
    assert str(caught.value) == f"no case is called 'xyz'; known: {', '.join(known('cases', own))}"
    assert "b5" not in known("cases", own) and "compose" not in known("cases", own)
    with pytest.raises(InputError, match="'el_centro' is a record, not a structure; rths list structures shows what"):
        find("el_centro", "structures", own)


def test_a_calibration_is_none_of_the_files_that_commands_take(tmp_path: Path) -> None:
    (tmp_path / "lab.yaml").write_text("rig: bench\nmade_utc: 2026-11-24T09:30:00Z\nchannels: []\n")
    assert "lab" not in known("rigs", tmp_path)
    with pytest.raises(InputError, match=r"is a calibration, not a case; a rig file names it \(calibration: "):
        load_cases([tmp_path / "lab.yaml"])


def test_a_rig_that_states_only_its_calibration_is_listed(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text("extends: aps400_laboratory\ncalibration: lab.yaml\n")
    assert "bench" in known("rigs", tmp_path)
