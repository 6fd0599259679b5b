"""Names are looked up beside the file, in the current folder's places, then among the shipped files."""

from __future__ import annotations

from pathlib import Path

import pytest

from rths_cli.case.named_files import find, known
from rths_cli.case.shipped_files import FOLDERS, shipped
from rths_cli.errors import InputError


def put(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("")
    return path


def test_the_nearest_file_is_taken(lab: Path) -> None:
    folder = lab / "cases"
    found = [find("three_storey", "structures", folder)]
    for place in (lab / "configs/structures/three_storey.yml", folder / "three_storey.yaml"):
        put(place)
        found.append(find("three_storey", "structures", folder))
    assert found[0] == shipped("structures") / "three_storey.yaml"
    assert [path.relative_to(lab).as_posix() for path in found[1:]] == [
        "configs/structures/three_storey.yml",
        "cases/three_storey.yaml",
    ]


def test_the_file_that_names_is_never_what_it_names(lab: Path) -> None:
    own = put(lab / "three_storey.yaml")
    assert find("three_storey", "structures", lab, own) == shipped("structures") / "three_storey.yaml"


def test_a_path_is_relative_to_the_folder_and_never_looked_up(lab: Path) -> None:
    put(lab / "cases/own/rig.yaml")
    assert find("own/rig.yaml", "rigs", lab / "cases") == lab / "cases/own/rig.yaml"
    with pytest.raises(InputError, match=r"no such file: .*cases/aps400_virtual; check the path"):
        find("./aps400_virtual", "rigs", lab / "cases")


@pytest.mark.parametrize("suffix", [".csv", ".at2", ".AT2", ".txt"])
def test_a_record_is_found_under_its_suffixes(lab: Path, suffix: str) -> None:
    put(lab / f"records/quake{suffix}")
    assert find("quake", "records", lab).name == f"quake{suffix}"
    assert find(f"quake{suffix}", "records", lab).name == f"quake{suffix}"


def test_an_unknown_name_says_what_is_near_or_what_exists(lab: Path) -> None:
    with pytest.raises(InputError, match=r"no record is called 'el_centr'; did you mean el_centro\?"):
        find("el_centr", "records", lab)
    with pytest.raises(InputError, match="no rig is called 'xyz'; known: aps400_laboratory, aps400_virtual"):
        find("xyz", "rigs", lab)


@pytest.mark.parametrize("name", ["", " ", "a\0b", "x" * 5000, "/", "..", "~"])
def test_names_that_are_none_are_refused(lab: Path, name: str) -> None:
    with pytest.raises(InputError):
        find(name, "structures", lab)


def test_everything_shipped_is_known(lab: Path) -> None:
    assert set(FOLDERS) == {"cases", "structures", "rigs", "references", "records", "benchmarks"}
    own = ["actuator_frame", "base_isolated", "tuned_mass_damper", "viscous_damper"]
    assert sorted(known("structures", lab)) == sorted([*own, "three_storey", "three_storey_bare"])
    assert known("references", lab) == ["zhang2015"]
    assert len(known("cases", lab)) == 13


def test_an_installed_copy_goes_before_the_source_tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = put(tmp_path / "site/rths_cli/case/shipped_files.py")
    monkeypatch.setattr("rths_cli.case.shipped_files.__file__", str(module))
    assert shipped("records") == tmp_path / "site/records"
    (tmp_path / "site/rths_cli/shipped").mkdir()
    assert shipped("rigs") == tmp_path / "site/rths_cli/shipped/configs/rigs"
