"""The shipped files say what the paper and the design say; the schemas beside them fit."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest
from schema_validators import validator

from rths_cli.case.json_schema import MODELS, schema
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.case.rig_schema import VirtualRigSpec
from rths_cli.case.shipped_files import shipped
from rths_cli.case.yaml_reader import plain, read_file

CONFIGS = shipped("cases")
FOLDERS = {
    "case": "cases",
    "structure": "structures",
    "rig": "rigs",
    "reference": "references",
    "benchmark": "benchmarks",
}
FILES = [(kind, path) for kind, folder in FOLDERS.items() for path in sorted(shipped(folder).glob("*.yaml"))]
CASES = [path for kind, path in FILES if kind == "case"]

# Table 5.2 as printed: record, storey, then SIM-DELAY and EXP-RTHS for lower and for higher damping.
TABLE_5_2 = """
el_centro 1 0.0236 0.0158 0.0297 0.0023
el_centro 2 0.1050 0.0466 0.0759 0.0428
el_centro 3 0.1228 0.0615 0.0913 0.0500
hachinohe 1 0.0167 0.0016 0.0172 0.0003
hachinohe 2 0.0617 0.0201 0.0439 0.0145
hachinohe 3 0.0733 0.0179 0.0532 0.0095
"""
# Table 5.1 as printed: shake table test max and RMS, RTHS max and RMS; 30 % El Centro, lower damping.
TABLE_5_1 = {"ff": (0.0376, 0.0030, 0.1007, 0.0058), "ff_fb": (0.0086, 0.0004, 0.1922, 0.0027)}


def as_json(path: Path) -> object:
    """Return a YAML file as JSON would hold it."""
    _, node, faults = read_file(path)
    assert node is not None and faults == []
    return json.loads(json.dumps(plain(node)))


OTHERS = {f"el_centro_{name}" for name in ("actuator", "base_isolated", "tuned_mass_damper", "viscous_damper")}


def test_the_paper_s_eight_cases_the_bare_one_and_three_other_buildings_are_there() -> None:
    paper = {f"{r}_{d}_{c}" for r in ("el_centro", "hachinohe") for d in ("low", "high") for c in ("ff", "ff_fb")}
    assert {path.stem for path in CASES} == paper | {"el_centro_bare_ff_fb"} | OTHERS


@pytest.mark.parametrize("path", [path for path in CASES if path.stem not in OTHERS], ids=lambda path: path.stem)
def test_a_case_is_what_its_name_says(lab: Path, path: Path) -> None:
    (case,) = load_cases([path])
    record, _, rest = path.stem.replace("el_centro", "elcentro").partition("_")
    damping, _, controller = rest.partition("_")
    assert case.record.name == record.replace("elcentro", "el_centro")
    assert case.controller.kind == {"ff": "FF", "ff_fb": "FF+FB"}[controller]
    assert case.scaling == 0.30 and case.method == "best"
    if damping == "bare":
        assert case.structure.experimental.damping_ratios == (0.005, 0.005)
        assert case.damping.first_mode_ratio == 0.005
        assert case.structure.experimental.natural_frequencies_hz == (3.2, 8.4)
    else:
        assert case.damping.first_mode_ratio == {"low": 0.026, "high": 0.036}[damping]
        assert case.reference is not None and case.reference.name == "zhang2015"


def test_published_figures_are_those_of_table_5_1(lab: Path) -> None:
    for controller, printed in TABLE_5_1.items():
        (case,) = load_cases([f"el_centro_low_{controller}"])
        paths = [f"{run}.tracking_{what}_m_s2" for run in ("shake_table", "exp_rths") for what in ("max", "rms")]
        assert tuple(case.published()[path] for path in paths) == printed
    (other,) = load_cases(["el_centro_high_ff"])
    assert set(other.published()) == {"sim_delay.rms_error_m_s2"}


def test_published_figures_are_those_of_table_5_2(lab: Path) -> None:
    for line in TABLE_5_2.split("\n")[1:-1]:
        record, storey, *printed = line.split()
        for damping, pair in (("low", printed[:2]), ("high", printed[2:])):
            (case,) = load_cases([f"{record}_{damping}_ff_fb"])
            for run, figure in zip(("sim_delay", "exp_rths"), pair, strict=True):
                values = case.published()[f"{run}.rms_error_m_s2"]
                assert isinstance(values, tuple) and values[int(storey) - 1] == float(figure)


def test_figures_of_another_scaling_are_not_published_for_ours(lab: Path) -> None:
    (case,) = load_cases(["el_centro_low_ff_fb"], ["scaling=0.29"])
    assert case.published() == {}


def test_the_rig_file_states_every_value_of_the_virtual_table() -> None:
    assert as_json(shipped("rigs") / "aps400_virtual.yaml") == {
        "kind": "virtual",
        "sensors": {
            "sensitivity_mv_per_g": 1000, "range_g": 5, "noise_rms_m_s2": 3e-4, "high_pass_hz": 0.024,
            "low_pass_hz": 1549,
        },
        "converters": {"bits": 16, "range_v": 10, "latency_samples": 1},
        "limits": {"stroke_m": 0.079, "velocity_m_s": 1.0, "acceleration_m_s2": 45, "force_n": 445},
        "nominal": {"gain_m_per_v": 0.0079, "moving_mass_kg": 7.0, "payload_kg": 23},
        "physics": {
            "moving_mass_kg": 7.0, "viscous_n_s_per_m": 8, "coulomb_n": 0.3, "coulomb_velocity_m_s": 0.001,
            "loop_frequency_hz": 14, "loop_damping_ratio": 0.6, "actuator_time_constant_s": 0.0015,
            "gain_m_per_v": 0.0079, "loop_specimen_mass_kg": 13.86, "force_limit_n": 445,
        },
        "after_identification": {"specimen_stiffness_factor": 1, "coulomb_factor": 1, "payload_factor": 1},
    }  # fmt: skip


def test_the_defaults_of_a_rig_are_those_of_the_rig_file(lab: Path) -> None:
    (case,) = load_cases(["el_centro_low_ff_fb"])
    assert case.table == VirtualRigSpec(name="aps400_virtual", kind="virtual")


def test_the_records_named_are_shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    cases = load_cases(CASES)
    assert {case.record.path.parent for case in cases} == {shipped("records")}
    assert all(f"\n  file: {case.record.name}\n" in resolved_yaml(case) for case in cases)


@pytest.mark.parametrize("kind", MODELS)
def test_the_shipped_schema_is_the_generated_one(kind: str) -> None:
    written = json.loads((CONFIGS / f"{kind}.schema.json").read_text(encoding="utf-8"))
    assert written == json.loads(json.dumps(schema(kind))), (
        "call rths_cli.case.json_schema.write_schemas(Path('configs'))"
    )
    jsonschema.Draft202012Validator.check_schema(written)


@pytest.mark.campaign
@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda value: getattr(value, "stem", value))
def test_a_shipped_file_fits_its_schema_and_names_it(kind: str, path: Path) -> None:
    validator(kind).validate(as_json(path))
    first = path.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith("# yaml-language-server: $schema=")
    assert (path.parent / first.partition("$schema=")[2]).resolve() == (CONFIGS / f"{kind}.schema.json").resolve()


REAL = (
    "table: {kind: udp, udp: {host: 10.0.0.1, port: 47800}, sensors: {sensitivity_mv_per_g: 100, range_g: 2, "
    "high_pass_hz: 0, low_pass_hz: 0}, converters: {bits: 16, range_v: 10}, limits: {stroke_m: 0.07, velocity_m_s: 1, "
    "acceleration_m_s2: 20, force_n: 400}, nominal: {gain_m_per_v: 0.0079, moving_mass_kg: 7, payload_kg: 23}}"
)


@pytest.mark.parametrize(
    ("line", "fits"),
    [
        ("table: {extends: aps400_virtual, physics: {coulomb_n: 0.9}}", True),
        ("structure: {extends: three_storey, numerical: {masses_kg: [7]}}", True),
        ("structure: {numerical: {masses_kg: [7]}}", False),
        ("damping: {first_mode_ratio: 0.02}", True),
        ("damping: {}", False),
        ("damping: {first_mode_ratio: 0.02, dashpots_n_s_per_m: [1]}", False),
        ("record: {file: el_centro, unit: g}", True),
        ("record: {unit: g}", False),
        ("runs: [exp-rths, sim]", True),
        ("runs: [exp rths]", False),
        ("controller: {kind: FF, max_sensitivity: 1.3}", True),
        ("controller: {kind: FF+FB, disturbance_hz: [1, 6], command_weight: 0.1, feedback_limit_v: 2}", True),
        ("controller: {kind: FF+FB, disturbance_hz: [1]}", False),
        ("controller: {kind: FF+FB, command_weight: 0}", False),
        ("controller: PID", False),
        ("scaling: -1", False),
        ("scaling: '1'", False),
        ("table: {extends: aps400_virtual, converters: {bits: 1}}", False),
        ("table: {extends: aps400_virtual, converters: {bits: 0}}", True),
        ("table: {extends: aps400_virtual, colour: red}", False),
        ("accept: {exp_rths.rms_error_m_s2: 1}", True),
        ("accept: {Nonsense: 1}", False),
        ("table: {kind: upd}", False),
        (REAL, True),
        (REAL.replace("kind: udp", "kind: ni"), False),
        (REAL.replace("port: 47800", "port: 0"), False),
        (REAL.replace("gain_m_per_v: 0.0079, ", ""), False),
        (REAL.replace("bits: 16, ", ""), False),
        (f"{REAL[:-1]}, physics: {{}}}}", False),
        (f"{REAL[:-1]}, colour: red}}", False),
        (f"{REAL[:-1]}, overrun: skip, unattended: true, watchdog_s: 0.05}}", True),
        (f"{REAL[:-1]}, overrun: wait}}", False),
        (f"{REAL[:-1]}, watchdog_s: 60}}", False),
        (REAL.replace("low_pass_hz: 0", "low_pass_hz: 0, sign: -1"), True),
        (REAL.replace("low_pass_hz: 0", "low_pass_hz: 0, sign: 2"), False),
        ("table: {extends: udp_example, limits: {force_n: 300}}", True),
        ("table: {extends: udp_example, limits: {force_n: -300}}", False),
        ("table: {extends: aps400_virtual, limits: {command_rate_v_s: 100, energy_ratio: 0.5, lost_samples: 3}}", True),
        ("table: {extends: aps400_virtual, limits: {lost_samples: 0}}", False),
        ("colour: red", False),
    ],
)  # fmt: skip
def test_schema_and_loader_agree(write, faults_of, line: str, fits: bool) -> None:
    key = line.partition(":")[0]
    five = ["structure: three_storey", "damping: low", "record: el_centro", "scaling: 0.3", "controller: FF+FB"]
    text = "\n".join([entry for entry in five if not entry.startswith(key)] + [line, ""])
    path = write(text=text)
    assert validator().is_valid(as_json(path)) == fits
    if fits:
        assert len(load_cases([path])) == 1
    else:
        assert faults_of(text=text)
