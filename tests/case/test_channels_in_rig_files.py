"""Channels beside the accelerometers in rig files of every kind: what they state, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import pytest
import yaml

from rths_cli.case.load import load_cases
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.from_case import rig_info

PLACE = {"kind": "displacement", "position": "table", "unit": "mm", "sensitivity_v_per_unit": 0.1, "range": 95}
CELL = {"kind": "force", "position": "table", "unit": "kN", "sensitivity_v_per_unit": 20, "range": 0.45}
ACCELEROMETER = {"sensitivity_mv_per_g": 1000, "range_g": 5, "high_pass_hz": 0.024, "low_pass_hz": 1549}
REAL = {
    "converters": {"bits": 16, "range_v": 10},
    "limits": {"stroke_m": 0.075, "velocity_m_s": 0.9, "acceleration_m_s2": 40, "force_n": 400},
    "nominal": {"gain_m_per_v": 0.0079, "moving_mass_kg": 7.0, "payload_kg": 23},
}
KINDS: dict[str, dict[str, Any]] = {
    "virtual": {"kind": "virtual"},
    "udp": {"kind": "udp", "udp": {"host": "192.168.7.2", "port": 47800}, "sensors": ACCELEROMETER, **REAL},
    "ni": {"kind": "ni", "ni": {"device": "Dev1"}, **REAL},
}


@pytest.fixture
def rig(write):
    """Write a rig file `bench` with further channels, return the line that names it."""

    def write_rig(*further: dict[str, Any], kind: str = "virtual", **changes: Any) -> str:
        own = [{**ACCELEROMETER, "terminal": f"ai{i}"} for i in range(3)] if kind == "ni" else []
        beside = [{**one, "terminal": f"ai{3 + i}"} if kind == "ni" else one for i, one in enumerate(further)]
        data = {**KINDS[kind], "channels": own + beside, **changes}
        write(name="configs/rigs/bench.yaml", text=yaml.safe_dump(data, sort_keys=False))
        return "table: bench\n"

    return write_rig


def info_of(write, line: str) -> RigInfo:
    (case,) = load_cases([write(line)])
    return rig_info(case)


@pytest.mark.parametrize("kind", KINDS)
def test_further_channels_follow_the_accelerometers_in_their_unit(write, rig, kind: str) -> None:
    info = info_of(write, rig({**PLACE, "use": "guard"}, {**CELL, "use": ["guard", "shear"], "abort": 0.4}, kind=kind))
    assert [channel.name for channel in info.channels] == ["table", "floor_2", "floor_3"]
    assert [channel.name for channel in info.all_channels[3:]] == ["table_displacement", "table_force"]
    place, cell = info.further
    assert (place.unit, place.uses, place.abort, place.uncertainty) == ("m", ("guard",), math.inf, 0.01)
    assert place.sensitivity_v_per_unit == pytest.approx(100.0) and place.range == pytest.approx(0.095)
    assert (cell.unit, cell.uses, info.shear_cell) == ("N", ("guard", "shear"), 1)
    assert cell.sensitivity_v_per_unit == pytest.approx(0.02) and cell.range == pytest.approx(450.0)
    assert cell.abort == pytest.approx(400.0)


def test_two_alike_have_two_names(write, rig) -> None:
    strain = {**PLACE, "kind": "strain", "position": "storey_3", "unit": "um/m"}
    info = info_of(write, rig(strain, strain))
    assert [channel.name for channel in info.further] == ["storey_3_strain", "storey_3_strain_2"]
    assert info.further[0].range == pytest.approx(95e-6)


@pytest.mark.parametrize(
    ("changes", "place", "fault"),
    [
        ({"use": "control"}, "use", "control uses the accelerometers of table and floors; a further channel is for "),
        ({"use": "shear"}, "use", "shear needs a load cell under the specimen, kind: force at position: table"),
        ({"unit": "N"}, "unit", "must be m or mm for kind: displacement, got 'N'"),
        ({"position": "roof"}, "position", "must be table, floor_N or storey_N such as floor_2, got 'roof'"),
        ({"position": "storey_2"}, "position", "displacement is that of the table or of a floor, got 'storey_2'"),
        ({"position": "floor_4"}, "position", "must be on the table, which carries floor_2 to floor_3, got floor_4"),
        ({"position": "floor_1"}, "position", "must be on the table, which carries floor_2 to floor_3, got floor_1"),
        ({"kind": "strain", "unit": "1"}, "position", "a strain is that of a storey; state storey_N, got 'table'"),
        ({"abort": 50}, "abort", "needs use: guard, or the guard does not watch this channel; add it, or remove abort"),
        ({"use": "guard", "abort": 100}, "abort", "must be <= range = 95, got 100; the sensor would not show it"),
        ({"use": "guard", "abort": 50, "warning": 60}, "warning", "must be < abort = 50, got 60"),
        ({"plate_mass_kg": 1}, "plate_mass_kg", "belongs to a load cell under the specimen, kind: force at "),
        ({"sign": -1}, "sign", "belongs to a real rig; remove it"),
        ({"low_pass_hz": 100}, "low_pass_hz", "a virtual rig shows its further channels as they are; remove it"),
        ({"range_g": 5}, "range_g", "belongs to an accelerometer of table or floors, which has no kind; state unit, "),
        ({"kind": "speed"}, "kind", "must be acceleration, displacement, force or strain, got 'speed'"),
    ],
)
def test_a_further_channel_at_odds_with_itself_is_refused(faults_of, rig, changes, place: str, fault: str) -> None:
    found = faults_of(rig({**PLACE, **changes}))
    told = [one for one in found if f"table.channels[1].{place}: {fault}" in one]
    assert len(told) == 1, found


def test_the_shear_of_a_case_needs_a_load_cell(faults_of, write, rig) -> None:
    (fault,) = faults_of(rig(PLACE) + "shear_from: both\n")
    assert "shear_from: both needs a load cell, but the rig has no channel with use: shear" in fault
    (case,) = load_cases([write(rig({**CELL, "use": "shear"}) + "shear_from: load_cell\n")])
    assert case.shear_from == "load_cell"
    (fault,) = faults_of(rig({**CELL, "use": "shear"}, {**CELL, "use": "shear"}))
    assert "table.channels: 2 load cells with use: shear; the base shear takes one" in fault


def test_noise_belongs_to_a_virtual_rig(faults_of, rig) -> None:
    (fault,) = faults_of(rig({**PLACE, "noise_rms": 0.01}, kind="udp"))
    assert "table.channels[1].noise_rms: belongs to a virtual rig; remove it" in fault


def test_accelerometers_stand_before_further_channels(faults_of, rig) -> None:
    (fault,) = faults_of(rig(kind="udp", sensors=None, channels=[ACCELEROMETER, PLACE, ACCELEROMETER, ACCELEROMETER]))
    assert "table.channels[2]: is a further channel, but accelerometers of table or floors follow" in fault
    (fault,) = faults_of(rig(kind="udp", sensors=None, channels=[PLACE]))
    assert "must list the accelerometers of the table and of each floor first, without kind" in fault
    (fault,) = faults_of(rig(kind="udp", channels=[ACCELEROMETER, ACCELEROMETER, ACCELEROMETER]))
    assert "give channels or sensors, not both" in fault
