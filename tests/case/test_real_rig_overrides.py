"""A case may tighten the limits of a real rig; nothing else of it changes but in the rig's own file."""

from __future__ import annotations

import pytest
import yaml

from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.rigs.from_case import rig_info

CHANNEL = {"sensitivity_mv_per_g": 1000, "range_g": 5, "high_pass_hz": 0.024, "low_pass_hz": 1549}
LIMITS = {"stroke_m": 0.075, "velocity_m_s": 0.9, "acceleration_m_s2": 40, "force_n": 400, "tracking_error_m_s2": 3}
RIG = {
    "kind": "udp",
    "udp": {"host": "192.168.7.2", "port": 47800},
    "sensors": CHANNEL,
    "converters": {"bits": 16, "range_v": 10},
    "limits": LIMITS,
    "nominal": {"gain_m_per_v": 0.0079, "moving_mass_kg": 7.0, "payload_kg": 23},
}
LOOSER = [
    ("limits.stroke_m", "0.0751", "must be <= the rig's 0.075, got 0.0751"),
    ("limits.velocity_m_s", "1.0", "must be <= the rig's 0.9, got 1"),
    ("limits.acceleration_m_s2", "41", "must be <= the rig's 40, got 41"),
    ("limits.force_n", "1e3", "must be <= the rig's 400, got 1000"),
    ("limits.tracking_error_m_s2", "3.1", "must be <= the rig's 3, got 3.1"),
    ("limits.tracking_error_m_s2", "null", "must be <= the rig's 3, got nothing"),
    ("limits.lost_samples", "6", "must be <= the rig's 5, got 6"),
    ("limits.energy_ratio", "0.2", "must be <= the rig's 0.1, got 0.2"),
]
OWN = [
    ("unattended", "true", "true"), ("watchdog_s", "0.2", "0.2"), ("overrun", "hold", "'hold'"),
    ("udp.port", "1", "a mapping"), ("udp.key_file", "other.key", "a mapping"), ("kind", "ni", "'ni'"),
    ("nominal.gain_m_per_v", "0.001", "a mapping"), ("converters.range_v", "20", "a mapping"),
    ("sensors.sensitivity_mv_per_g", "1", "a mapping"), ("name", "other", "'other'"), ("model", "m.h5", "'m.h5'"),
]  # fmt: skip


@pytest.fixture
def bench(write) -> str:
    """Write a rig file `bench`, return the line that names it."""
    write(name="configs/rigs/bench.yaml", text=yaml.safe_dump(RIG))
    return "table: bench\n"


def inline(key: str, value: str) -> str:
    """Return the lines of a case that state one key over the rig's file."""
    for part in reversed(key.split(".")):
        value = f"{{{part}: {value}}}"
    return f"table: {{extends: bench, {value[1:]}\n"


@pytest.mark.parametrize(("key", "value", "said"), LOOSER)
def test_no_limit_of_a_real_rig_is_loosened_in_a_case_or_by_set(faults_of, bench: str, key, value, said) -> None:
    ends = f"{said}; a case may only be stricter, configs/rigs/bench.yaml states the rig's"
    assert faults_of(bench, settings=(f"table.{key}={value}",)) == (f"--set table.{key}: {ends}",)
    (fault,) = faults_of(inline(key, value))
    assert fault.startswith("a.yaml:6:") and fault.endswith(f": table.{key}: {ends}")


@pytest.mark.parametrize(("key", "value", "got"), OWN)
def test_what_is_no_limit_stands_in_the_rig_s_own_file_alone(faults_of, bench: str, key, value, got) -> None:
    said = "only the rig's own file configs/rigs/bench.yaml may state this"
    ends = f"{said}, got {got}; change it there, or name a rig file of your own"
    (fault,) = faults_of(bench, settings=(f"table.{key}={value}",))
    assert fault.startswith("--set table.") and fault.endswith(ends) and key.partition(".")[0] in fault
    (fault,) = faults_of(inline(key, value))
    assert fault.startswith("a.yaml:6:") and fault.endswith(f"table.{key.partition('.')[0]}: {ends}")


@pytest.mark.parametrize("key", [*LIMITS, "lost_samples", "energy_ratio", "command_rate_v_s"])
def test_every_limit_may_be_tightened_and_the_rig_keeps_its_name(write, bench: str, key: str) -> None:
    tight = 2 if key == "lost_samples" else 0.01
    for lines, settings in ((bench, (f"table.limits.{key}={tight}",)), (inline(f"limits.{key}", str(tight)), ())):
        (case,) = load_cases([write(lines)], settings)
        assert getattr(case.table.limits, key) == tight and case.table.name == "bench"
        assert case.table.limits.stroke_m == (0.01 if key == "stroke_m" else 0.075)


def test_a_case_s_own_limits_do_not_pass_the_energy_a_real_rig_is_given_by_default(faults_of, write, bench) -> None:
    (fault,) = faults_of(f"{bench}limits: {{energy_ratio: 0.11}}\n")
    assert "limits.energy_ratio: must be <= the rig's 0.1, got 0.11; a case may only be stricter" in fault
    (case,) = load_cases([write("limits: {energy_ratio: 5}\n")])  # a virtual rig limits it only where asked
    assert case.table.limits.energy_ratio == 5


def test_unknown_and_foreign_keys_are_told_once(faults_of, bench: str) -> None:
    (fault,) = faults_of(bench, settings=("table.colour=red",))
    assert "table.colour: unknown key" in fault
    (fault,) = faults_of(bench, settings=("table.physics.coulomb_n=0",))
    assert fault.endswith("belongs to a virtual rig; remove it")


def test_a_rig_file_may_extend_another_as_its_laboratory_likes(write, bench: str) -> None:
    text = "extends: bench\nunattended: true\nlimits: {stroke_m: 0.1}\nudp: {port: 9}\n"
    write(name="configs/rigs/rehearsal.yaml", text=text)
    (case,) = load_cases([write("table: rehearsal\n")])
    info = rig_info(case)
    assert case.rig_file is not None
    assert (case.table.name, info.unattended, info.limits.stroke_m) == ("rehearsal", True, 0.1)


def test_a_real_rig_inside_a_case_is_never_unattended(write, bench: str) -> None:
    (case,) = load_cases([write("table: {extends: bench, limits: {stroke_m: 0.05}}\n")])
    assert case.rig_file is not None and not rig_info(case).unattended
    (whole,) = load_cases([write(f"table: {yaml.safe_dump({**RIG, 'unattended': True}, default_flow_style=True)}")])
    assert whole.rig_file is None and not rig_info(whole).unattended
    again = write(name="again.yaml", text=resolved_yaml(whole))
    assert load_cases([again])[0].table == whole.table


def test_set_changes_nothing_of_a_real_rig_inside_a_case(faults_of, write) -> None:
    line = f"table: {yaml.safe_dump(RIG, default_flow_style=True, width=1000)}"
    (fault,) = faults_of(line, settings=("table.limits.stroke_m=0.05",))
    assert fault == (
        "--set table.limits.stroke_m: the case itself states this real rig, --set may not change it, got 0.05; "
        "give a stricter limit under limits"
    )
    assert len(faults_of(line, settings=("table.unattended=true", "table.udp.port=1"))) == 2
    assert load_cases([write(line)], ("limits.stroke_m=0.05",))[0].table.limits.stroke_m == 0.05


def test_on_a_virtual_rig_everything_stays_free(write) -> None:
    free = ("limits.stroke_m=1", "limits.force_n=1e4", "nominal.gain_m_per_v=0.008", "converters.range_v=20")
    (case,) = load_cases([write()], [f"table.{one}" for one in free])
    assert (case.table.limits.stroke_m, case.table.limits.force_n, case.table.converters.range_v) == (1, 1e4, 20)


def test_a_case_makes_no_real_rig_of_a_file_that_is_none(faults_of, write) -> None:
    """Such a file's limits, and its gain, which the guard reckons with, could be loosened by the case or by --set."""
    write(name="configs/rigs/half.yaml", text=yaml.safe_dump({k: v for k, v in RIG.items() if k != "kind"}))
    for settings in ((), ("table.limits.stroke_m=1.0",), ("table.nominal.gain_m_per_v=0.0001",)):
        faults = faults_of("table: {extends: half, kind: udp}\n", settings=settings)
        assert any("table.kind: only the rig's own file may make it a real one, got 'udp'" in one for one in faults)
    assert faults_of("table: {extends: half}\n", settings=("table.kind=udp",))
