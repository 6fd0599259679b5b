"""A case that extends another one, folders of cases, and cases that cannot be used among others."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from rths_cli.case.json_schema import schema
from rths_cli.case.load import load_cases, load_each
from rths_cli.case.named_files import case_files, kind_of
from rths_cli.case.yaml_reader import Source, parse, plain
from rths_cli.errors import InputError

BASE = """\
name: the_base
structure: three_storey
damping: low
record: {file: el_centro, baseline: mean}
scaling: 0.1
controller: {kind: FF+FB, feedback_bandwidth_hz: 3}
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "base.yaml").write_text(BASE)
    return tmp_path


def write(name: str, text: str) -> str:
    Path(name).write_text(text)
    return name


def test_what_a_case_states_holds_and_the_rest_is_the_others(folder: Path) -> None:
    (case,) = load_cases([write("own.yaml", "extends: base\nscaling: 0.2\n")])
    assert (case.name, case.scaling, case.damping.name) == ("own", 0.2, "low")
    assert case.controller.feedback_bandwidth_hz == 3.0
    assert case.record.baseline is not None
    assert case.record.baseline.remove == "mean"


def test_a_key_below_varies_what_the_other_case_names_and_a_name_takes_its_place(folder: Path) -> None:
    varied = (
        "extends: ./base.yaml\ntable: {physics: {coulomb_n: 0.9}}\nstructure: {interface_experimental_mass_kg: 0.5}\n"
    )
    (case,) = load_cases(
        [write("varied.yaml", f"{varied}controller: {{feedback_bandwidth_hz: 2}}\nrecord: hachinohe\n")]
    )
    assert case.table.physics.coulomb_n == 0.9 and case.table.limits.stroke_m == 0.079
    assert case.structure.interface_experimental_mass_kg == 0.5 and len(case.structure.experimental.masses_kg) == 2
    assert (case.controller.kind, case.controller.feedback_bandwidth_hz) == ("FF+FB", 2.0)
    assert case.record.path.stem == "hachinohe" and case.record.baseline != "mean"
    (other,) = load_cases([write("other.yaml", "extends: varied\ncontroller: {kind: FF}\n")], ["scaling=0.3"])
    assert (other.controller.kind, other.scaling) == ("FF", 0.3) and other.table.physics.coulomb_n == 0.9
    assert other.controller.feedback_bandwidth_hz != 2.0


def test_a_fault_stands_in_the_file_that_states_it(folder: Path) -> None:
    write("base.yaml", BASE.replace("0.1", "much"))
    with pytest.raises(InputError, match=r"^base\.yaml:5:10: scaling: "):
        load_cases([write("own.yaml", "extends: base\ndelay_s: 0.004\n")])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("extends: nowhere\n", r"own\.yaml:1:10: extends: no case is called 'nowhere'"),
        ("extends: [base]\n", r"own\.yaml:1:10: extends: must be the name or the path of a case"),
        ("extends: round\n", r"extends: goes round in a circle: own -> round -> own; remove one extends"),
        ("extends: aps400_virtual\nscaling: 3\n", r"own\.yaml:1:10: extends: .*'aps400_virtual' is a rig, not a case"),
        ("extends: base\nscalling: 1\n", r"own\.yaml:2:1: scalling: unknown key"),
    ],
)
def test_what_cannot_be_extended_is_one_sentence(folder: Path, text: str, told: str) -> None:
    write("round.yaml", "extends: own\nseed: 1\n")
    with pytest.raises(InputError, match=told) as refused:
        load_cases([write("own.yaml", text)])
    assert len(refused.value.faults) == 1


def test_a_rig_that_the_other_case_states_is_no_rig_file(folder: Path) -> None:
    """A real rig moves unattended by its own file alone, never by a case."""
    inline = "table: {name: mine, extends: aps400_virtual}\n"
    write("with_rig.yaml", f"{BASE}{inline}")
    (named,) = load_cases(["base.yaml"])
    (stated,) = load_cases([write("own.yaml", "extends: with_rig\nscaling: 0.2\n")])
    assert named.rig_file is not None and stated.rig_file == named.rig_file  # the shipped file states the kind
    text = Path(named.rig_file).read_text()
    write("whole.yaml", BASE + "table:\n" + "".join(f"  {line}\n" for line in text.splitlines()))
    for name in ("whole.yaml", write("child.yaml", "extends: whole\nscaling: 0.2\n")):
        (case,) = load_cases([name])
        assert case.rig_file is None, name


def test_a_folder_or_a_pattern_stands_for_its_cases(folder: Path) -> None:
    inside = folder / "night"
    inside.mkdir()
    for name, text in (
        ("b.yaml", "extends: ../base.yaml\nseed: 2\n"),
        ("a.yml", "extends: b\nscaling: 0.3\n"),
        ("broken.yaml", "structure: [\n"),
        ("rig.yaml", "extends: aps400_virtual\nlimits: {stroke_m: 0.05}\n"),
        ("notes.txt", "no case"),
    ):
        (inside / name).write_text(text)
    names = ["a.yml", "b.yaml", "broken.yaml"]
    assert [Path(name).name for name in case_files(["night"])] == names
    assert case_files(["night/?.y*ml", "night/b.yaml", "base"]) == ["night/a.yml", "night/b.yaml", "base"]
    assert kind_of(inside / "rig.yaml") == "rigs" and kind_of(inside / "b.yaml") in ("cases", "")
    with pytest.raises(InputError, match=r"night/\*\.csv: matches no file"):
        case_files(["night/*.csv"])


def test_cases_that_cannot_be_used_are_told_apart(folder: Path) -> None:
    names = [write("a.yaml", "extends: base\n"), write("b.yaml", "extends: base\ndamping: loud\n")]
    names += [write("c.yaml", "extends: base\nname: a\n"), "base.yaml"]
    cases, refused = load_each(names, ["scaling=0.4"], ("paper", "best"))
    assert [(case.name, case.method) for case in cases] == [
        ("a", "paper"), ("the_base", "paper"), ("a", "best"), ("the_base", "best"),
    ]  # fmt: skip
    assert {name: len(error.faults) for name, error in refused.items()} == {"b.yaml": 1, "c.yaml": 1}
    with pytest.raises(InputError, match="must be key=value"):
        load_each(names, ["scaling"], ())
    assert load_each(["b.yaml"], [], ())[0] == []


def test_the_schema_knows_it() -> None:
    validator = Draft202012Validator(schema("case"))
    for text, valid in ((BASE, True), ("extends: base\nscaling: 0.2\n", True), ("scaling: 0.2\n", False)):
        tree, _ = parse(text, Source("case", Path.cwd()))
        assert tree is not None
        assert validator.is_valid(json.loads(json.dumps(plain(tree), default=str))) == valid
