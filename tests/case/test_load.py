"""From files to cases: defaults, names, settings, and every fault at its place."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rths_cli.case.case_schema import Case
from rths_cli.case.compensator_schema import compensator_kinds
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.case.shipped_files import shipped
from rths_cli.errors import InputError

SHIPPED = sorted(path.stem for path in shipped("cases").glob("*.yaml"))


def fields(case: Case) -> dict[str, object]:
    """Return everything of a case except where it was read."""
    return case.model_dump(exclude={"path", "yaml_text"})


def test_five_keys_are_enough(write) -> None:
    path = write()
    (case,) = load_cases([path])
    assert (case.name, case.path, case.yaml_text) == ("a", path.absolute(), path.read_text())
    assert (case.damping.name, case.damping.first_mode_ratio) == ("low", 0.026)
    assert (case.record.name, case.record.path) == ("el_centro", Path("records/el_centro.csv").absolute())
    assert (case.sample_rate_hz, case.delay_s, case.method, case.seed) == (2000.0, 0.005, "best", 0)
    assert case.runs == ("sim", "sim_delay", "shake_table", "exp_rths")
    assert (case.controller.kind, case.controller.feedback_bandwidth_hz) == ("FF+FB", None)
    assert (case.record_filter.corner_hz, case.record_filter.order) == (0.25, 2)
    assert (case.table.name, case.structure.name, case.n_storeys) == ("aps400_virtual", "three_storey", 3)
    assert case.structure.experimental.natural_frequencies_hz == (3.2, 8.4)
    assert case.published() == {}


@pytest.mark.campaign
@pytest.mark.parametrize("name", SHIPPED)
def test_a_resolved_case_loads_to_the_same_case(lab: Path, name: str) -> None:
    more = ["damping={dashpots_n_s_per_m: [22.16]}", "notes='a: b # c'"] if "high" in name else ["accept.sim.x[3]=1e-3"]
    (case,) = load_cases([name], [*more, "table.physics.coulomb_n=0.9", "limits.stroke_m=0.05", "runs=[exp-rths, sim]"])
    (lab / "elsewhere").mkdir()
    again_path = lab / "elsewhere" / "other.yaml"
    again_path.write_text(resolved_yaml(case), encoding="utf-8")
    (again,) = load_cases([again_path])
    assert fields(again) == fields(case)
    assert again.runs == ("sim", "exp_rths") and again.table.limits.stroke_m == 0.05
    assert resolved_yaml(again) == resolved_yaml(case)


def test_every_fault_of_every_file_comes_at_once_with_its_place(write) -> None:
    text = (
        "structure: three_stoery\ndamping: low\nrecord: el_centro\nscaling: -1\ncontroller: FF+BF\n"
        "colour: red\ndelay_s: yes\nscaling: 2\ntable: {extends: aps400_virtual, physics: {coulomb: 1}}\n"
    )
    first, second = write(text=text), write("seed: 1.5\n", name="b.yaml")
    with pytest.raises(InputError) as caught:
        load_cases([first, second, "c.yaml", "seed=1"], ["nothing"])
    known = "known: accept, base_shear_uncertainty, check"
    *kinds, last = compensator_kinds()
    assert [fault.partition(known)[0] for fault in caught.value.faults] == [
        "--set nothing: must be key=value, for example --set table.physics.coulomb_n=0.9",
        "a.yaml:1:12: structure: no structure is called 'three_stoery'; did you mean three_storey or "
        "three_storey_bare?",
        "a.yaml:4:10: scaling: must be > 0 and <= 100, got -1; a factor on the record, 1 plays it as it is",
        f"a.yaml:5:13: controller: must be FF, FF+FB, none, {', '.join(kinds)} or {last}, got 'FF+BF'",
        "a.yaml:6:1: colour: unknown key; ",
        "a.yaml:7:10: delay_s: must be a number, got 'yes'; in s",
        "a.yaml:8:1: scaling: repeated key, first at line 4; keep one",
        "a.yaml:9:44: table.physics.coulomb: unknown key; did you mean coulomb_n?",
        "b.yaml:6:7: seed: must be a whole number, got 1.5",
        "c.yaml: no case is called 'c.yaml'; known: a, b, " + ", ".join(SHIPPED),
        "seed=1: no case is called 'seed=1'; a setting follows --set, each one its own: --set seed=1",
    ]
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        ("kalman: 5", "6:9: kalman: must be a mapping, got 5"),
        ("runs: [sim, simm]", "6:13: runs[2]: must be sim, sim_delay, shake_table or exp_rths, got 'simm'"),
        ("runs: [sim-delay, sim_delay]", "6:7: runs: names a run twice; keep one of each"),
        ("runs: []", "6:7: runs: is empty; put at least one entry into the list"),
        ("delay_s: 0.2", "6:10: delay_s: must be >= 0 and <= 0.1 s, got 0.2"),
        ("limits:\n  stroke_m: 0.08", "7:13: limits.stroke_m: must be <= the rig's 0.079, got 0.08; a case may"),
        ("accept:\n  exp_rths.x[4]: 1", "7:18: accept.exp_rths.x[4]: storey must be <= 3, the structure's"),
        ("accept:\n  exp_rths.x[0]: 1", "7:18: accept.exp_rths.x[0]: must be a figure's path such as exp_"),
        ("runs: [sim]\naccept: {exp_rths.x: 1}", "7:22: accept.exp_rths.x: needs the run exp_rths; add it to runs"),
        ("sample_rate_hz: 100", "6:17: sample_rate_hz: must be > 120, twice identification.high_hz, got 100"),
        ("identification: {model: no.json}", "6:25: identification.model: no such file: "),
        ("sample_rate_hz: 130\nidentification: {high_hz: 65}", "7:27: identification.high_hz: must be < 65, half the"),
        ("identification: {low_hz: 70}", "6:26: identification.low_hz: low_hz = 70 must be < high_hz = 60"),
        ("notes: 5", "6:8: notes: must be text, got 5"),
        ("name: ../x", "6:7: name: must be usable as a file name, got '../x'"),
        ("reference: zhang", "6:12: reference: no reference is called 'zhang'; did you mean zhang2015?"),
        ("table: {physics: {}}", "6:1: table.kind: is missing; add extends: NAME"),
        ("table: ~", "6:8: table: must be a name or a mapping, got nothing"),
        ("path: /x", "6:1: path: unknown key"),
        ("record_filter: {corner_hz: .nan}", "6:28: record_filter.corner_hz: must be a finite number, got .nan"),
    ],
)  # fmt: skip
def test_one_fault_is_one_sentence(faults_of, line: str, fault: str) -> None:
    (found,) = faults_of(line + "\n")
    assert found.startswith(f"a.yaml:{fault}") and "\n" not in found


@pytest.mark.parametrize("name", ["", "..", ".x", "a/b", "a\\b", "x.", " x", "x ", "a\tb", "é" * 76])
def test_a_name_must_be_usable_for_a_file(faults_of, name: str) -> None:
    import json

    (fault,) = faults_of(f"name: {json.dumps(name)}\n")
    assert "must be usable as a file name" in fault


@pytest.mark.parametrize("text", ["", "# nothing\n", "[1, 2]\n", "hello\n"])
def test_a_file_without_keys_says_which_it_needs(faults_of, text: str) -> None:
    (fault,) = faults_of(text=text)
    assert "the keys of a case, at least structure, damping, record, scaling and controller" in fault


def test_missing_keys_are_all_named(faults_of) -> None:
    found = faults_of(text="notes: none\n")
    assert {fault.split(": ")[1] for fault in found} == {"structure", "damping", "record", "scaling", "controller"}


def test_two_cases_may_not_have_one_name(write) -> None:
    with pytest.raises(InputError, match=r"^sub/a.yaml: name: 'a' is also the name of a.yaml; give each case"):
        load_cases([write(), write(name="sub/a.yaml")])
    assert len(load_cases([write(), write("name: b\n", name="sub/a.yaml")])) == 2


def test_a_shipped_case_is_named_as_it_is_typed(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^el_centro_low_ff: name: the case is given twice; name it once$"):
        load_cases(["el_centro_low_ff", "el_centro_low_ff"])


def test_an_unknown_level_lists_the_levels(faults_of, write) -> None:
    text = "structure: three_storey\ndamping: medium\nrecord: el_centro\nscaling: 1\ncontroller: none\n"
    assert faults_of(text=text) == (
        "a.yaml:2:10: damping: the structure has no damping level 'medium'; known: high, low",
    )


def test_inline_damping_is_called_inline_and_fits_the_storeys(faults_of, write) -> None:
    text = "structure: three_storey\nrecord: el_centro\nscaling: 1\ncontroller: none\ndamping: "
    (case,) = load_cases([write("{dashpots_n_s_per_m: [22.16]}", text=text)])
    assert (case.damping.name, case.damping.dashpots_n_s_per_m) == ("inline", (22.16,))
    (fault,) = faults_of("{dashpots_n_s_per_m: [22.16, 3]}", text=text)
    assert fault.endswith("damping.dashpots_n_s_per_m: must have one entry per numerical storey, 1 in all, got 2")


def test_a_variation_keeps_what_it_does_not_state(write) -> None:
    (plain,) = load_cases([write()])
    varied = "table: {extends: aps400_virtual, physics: {coulomb_n: 0.9}, sensors: {noise_rms_m_s2: 6.0e-4}}\n"
    (case,) = load_cases([write(varied)])
    expected = plain.table.model_copy(
        update={
            "name": "aps400_virtual_varied",
            "physics": plain.table.physics.model_copy(update={"coulomb_n": 0.9}),
            "sensors": plain.table.sensors.model_copy(update={"noise_rms_m_s2": 6.0e-4}),
        }
    )
    assert case.table == expected
    (by_setting,) = load_cases([write()], ["table.physics.coulomb_n=0.9", "table.sensors.noise_rms_m_s2=6.0e-4"])
    assert by_setting.table == expected


def test_extends_follows_files_and_refuses_a_circle(write, faults_of) -> None:
    write(name="configs/rigs/worn.yaml", text="extends: aps400_virtual\nphysics: {coulomb_n: 1.5}\n")
    write(name="configs/rigs/old.yaml", text="extends: worn\nphysics: {viscous_n_s_per_m: 20}\n")
    (case,) = load_cases([write("table: old\n")])
    assert (case.table.name, case.table.physics.coulomb_n, case.table.physics.viscous_n_s_per_m) == ("old", 1.5, 20.0)
    write(name="configs/rigs/worn.yaml", text="extends: old\n")
    (fault,) = faults_of("table: old\n")
    assert fault == (
        "configs/rigs/worn.yaml:1:10: table.extends: goes round in a circle: old -> worn -> old; remove one extends"
    )


def test_a_fault_in_a_named_file_is_placed_in_that_file(write, faults_of) -> None:
    write(name="configs/rigs/bad.yaml", text="kind: virtual\nconverters:\n  bits: 1\n  bits: 2\nextra: 1\n")
    assert [fault.split(": ")[0] for fault in faults_of("table: bad\n")] == [
        "configs/rigs/bad.yaml:3:9",
        "configs/rigs/bad.yaml:4:3",
        "configs/rigs/bad.yaml:5:1",
    ]
    write(name="configs/rigs/bad.yaml", text="kind: [\n")
    (fault,) = faults_of("table: bad\n")
    assert fault.startswith("configs/rigs/bad.yaml:2:1: not valid YAML")


def test_a_rival_key_gives_way_in_a_variation(write) -> None:
    (case,) = load_cases([write()], ["structure.experimental.stiffness_n_per_m=[7000, 7100]"])
    assert case.structure.name == "three_storey_varied"
    assert case.structure.experimental.natural_frequencies_hz is None
    assert case.structure.experimental.stiffness_n_per_m == (7000.0, 7100.0)
    assert case.structure.experimental.damping_ratios == (0.043, 0.039)


def test_settings_reach_keys_defaults_and_short_forms(write) -> None:
    settings = [
        "scaling=1e-1", "controller.max_sensitivity=1.3", "record.unit=g", "kalman.q=2", "reference=zhang2015",
        "identification.seed=7", "accept.exp_rths.rms_error_m_s2[3]=0.06", "record_filter={corner_hz: 0}", "name=b",
    ]  # fmt: skip
    (case,) = load_cases([write()], settings)
    assert (case.scaling, case.kalman.q, case.kalman.r, case.name) == (0.1, 2.0, 1.0, "b")
    assert (case.controller.kind, case.controller.max_sensitivity) == ("FF+FB", 1.3)
    assert (case.record.name, case.record.unit) == ("el_centro", "g")
    assert case.accept == {"exp_rths.rms_error_m_s2[3]": 0.06}
    assert case.identification.seed == 7 and case.record_filter.corner_hz == 0
    assert case.reference is not None


@pytest.mark.parametrize(
    ("setting", "fault"),
    [
        ("scaling=-1", "--set scaling: must be > 0 and <= 100, got -1"),
        ("scalling=1", "--set scalling: unknown key; did you mean scaling or scale?"),
        ("table.physics.coulomb=1", "--set table.physics.coulomb: unknown key; did you mean table.physics.coulomb_n?"),
        ("seed=[", "--set seed: not valid YAML: "),
        ("delay_s=.inf", "--set delay_s: must be a finite number, got .inf"),
        ("=1", "--set : must be key=value"),
        ("a..b=1", "--set a..b: must be key=value"),
        ("scaling.x=1", "--set scaling.x: must be a number, got a mapping"),
        (
            "controller=ff",
            "--set controller: must be FF, FF+FB, none, ",
        ),
        ("controller.command_weight=0", "--set controller.command_weight: must be >= 0.001 and <= 10, got 0"),
        ("controller.feedback_limit_v=0", "--set controller.feedback_limit_v: must be > 0 and <= 1000 V, got 0"),
        (
            "controller.disturbance_hz=[1]",
            "--set controller.disturbance_hz: must be the two ends of a band in Hz, such as [1, 12], got 1 entries",
        ),
        ("controller.disturbance_hz=12", "--set controller.disturbance_hz: must be a list, got 12"),
        (
            "controller.disturbance_hz=[0, 12]",
            "--set controller.disturbance_hz: controller.disturbance_hz[1]: must be >= 0.05 and <= 500 Hz, got 0",
        ),
        (
            "controller.disturbance_hz=[12, 1]",
            "--set controller.disturbance_hz: must be a band of an octave or more, its lower end first, got 12 to 1 Hz",
        ),
        (
            "controller={kind: FF+FB, disturbance_hz: [7, 13]}",
            "--set controller: controller.disturbance_hz: must be a band of an octave or more, its lower",
        ),
    ],
)
def test_a_fault_of_a_setting_names_the_setting(faults_of, setting: str, fault: str) -> None:
    found = faults_of(settings=(setting,))
    assert found[0].startswith(fault) and len(found) == 1


def test_the_feedback_removes_nothing_beyond_half_the_sample_rate(faults_of) -> None:
    found = faults_of(settings=("sample_rate_hz=400", "controller.disturbance_hz=[1, 200]"))
    assert list(found) == ["--set controller.disturbance_hz: must be < 200, half the sample rate, got 200"]


def test_the_feedback_weights_are_left_open_unless_stated(write) -> None:
    (case,) = load_cases([write()])
    controller = case.controller
    assert (controller.disturbance_hz, controller.command_weight) == (None, None)
    assert controller.feedback_limit_v is None
    (case,) = load_cases([write()], ["controller.disturbance_hz=[0.5, 1]", "controller.feedback_limit_v=2"])
    assert (case.controller.disturbance_hz, case.controller.feedback_limit_v) == ((0.5, 1.0), 2.0)


def test_paths_are_relative_to_the_file_that_names_them(lab: Path, write) -> None:
    write(name="sub/data/quake.csv", text="0\n")
    write(name="sub/model.json", text="{}\n")
    text = "structure: three_storey\ndamping: low\nrecord: {file: data/quake.csv, unit: g, dt_s: 0.01}\n"
    path = write("scaling: 1\ncontroller: none\nidentification: {model: model.json}\n", name="sub/c.yaml", text=text)
    (case,) = load_cases([path])
    assert case.record.path == lab / "sub/data/quake.csv"
    assert (case.record.name, case.record.unit, case.record.dt_s) == ("quake", "g", 0.01)
    assert case.identification.model == lab / "sub/model.json"


def test_a_folder_and_an_unreadable_file_are_sentences(lab: Path, write, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"^records: is a folder; name a YAML file$"):
        load_cases(["records"])

    def refuse(self: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(self))

    path = write()
    monkeypatch.setattr(Path, "read_bytes", refuse)
    with pytest.raises(InputError, match=r"^a.yaml: cannot be read: Permission denied; check the path$"):
        load_cases([path])


@pytest.mark.parametrize("name", ["", "x" * 5000, "a\0b", "a\nb", "/a\nb/c", "../" * 2000, "/dev/null", "~"])
def test_strange_names_of_cases_are_sentences(lab: Path, name: str) -> None:
    with pytest.raises(InputError) as caught:
        load_cases([name])
    assert all(fault.isprintable() for fault in caught.value.faults)


def test_loading_needs_no_numerical_library() -> None:
    code = (
        "import sys, rths_cli; light = set(sys.modules); import rths_cli.case.load\n"
        "assert not {'pydantic', 'yaml', 'numpy'} & light\n"
        "assert not {'numpy', 'scipy', 'numba', 'h5py', 'matplotlib', 'rich'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ, timeout=60)
