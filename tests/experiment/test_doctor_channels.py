"""What `rths doctor --channels` says of a virtual rig with further channels: zeros, comparisons, signs by a push."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.experiment.real_rig_readiness import AtRest
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.laboratory.doctor_rig import (
    ChannelsExamined,
    Comparison,
    comparisons,
    examine_channels,
    first_signs,
    motion,
)
from rths_cli.report.doctor_page import channels_document, channels_page

FURTHER = """[
  {kind: displacement, position: table, unit: mm, sensitivity_v_per_unit: 0.1, range: 95, use: guard},
  {kind: force, position: table, unit: N, sensitivity_v_per_unit: 0.02, range: 450, use: [guard, shear],
   plate_mass_kg: 1.5},
  {kind: acceleration, position: floor_3, unit: m/s^2, sensitivity_v_per_unit: 0.1, range: 50}]"""


@pytest.fixture(scope="module")
def setup() -> Setup:
    table = f"table={{extends: aps400_virtual, channels: {FURTHER}}}"
    return make_setup(load_cases(["el_centro_low_ff_fb"], (table,))[0])


@pytest.fixture(scope="module")
def examined(setup: Setup) -> ChannelsExamined:
    said: list[str] = []
    found = examine_channels(setup, 0.5, True, None, said.append)
    assert any(one.startswith("table ") and "table_force" in one for one in said)
    return found


def test_channels_that_agree_are_told_so(examined: ChannelsExamined) -> None:
    assert [row.name for row in examined.rows][3:] == ["table_displacement", "table_force", "floor_3_acceleration"]
    assert examined.faults == () and examined.exit_code == 0
    by_name = {(one.channel, one.against): one for one in examined.comparisons}
    place = by_name["table_displacement", "table, twice integrated"]
    cell = by_name["table_force", "masses times accelerations"]
    assert place.ratio == pytest.approx(1.0, abs=5e-3) and abs(place.phase_deg) < 1.0
    assert cell.ratio == pytest.approx(1.0, abs=5e-3) and abs(cell.phase_deg) < 1.0
    text = channels_page(examined)
    assert text.startswith("AS DECLARED: 6 channels of ") and "agrees" in text and "faults" not in text
    assert channels_document(examined)["exit_code"] == 0


def test_a_motion_stays_small(setup: Setup) -> None:
    command_v, frequency = motion(setup)
    place = setup.rig.gain_m_per_v * command_v
    assert 0.2 < frequency <= 1.0 and np.abs(place).max() == pytest.approx(0.05 * setup.rig.limits.stroke_m, rel=1e-3)
    assert np.abs(place[[0, -1]]).max() < 1e-9


def test_a_reversed_sensor_and_a_wrong_size_are_told(setup: Setup) -> None:
    """A made motion: the cell shows its reverse, the displacement 10 % too much."""
    command_v, frequency = motion(setup)
    rate, place = 2.0 * np.pi * frequency, setup.rig.gain_m_per_v * command_v
    accel = -(rate**2) * place
    floors = np.array([accel, accel, accel])
    force = -(1.5 * accel + setup.floor_masses_kg.sum() * accel)
    log: Any = type("Log", (), {})()
    log.corrected, log.further, log.command_v = floors, np.array([1.1 * place, force, accel]), command_v
    found = {one.channel: one for one in comparisons(setup, log, frequency)}
    assert found["table_force"].told == "its sign is reversed"
    assert found["table_displacement"].told == "does not agree"
    assert found["table_displacement"].ratio == pytest.approx(1.1, rel=1e-2)
    assert found["floor_3_acceleration"].agrees and found["table"].agrees
    told = ChannelsExamined("lab", 1.0, (), tuple(found.values()), ())
    assert told.exit_code == 1 and "table_force: its sign is reversed" in channels_page(told)


@pytest.mark.parametrize("rate_hz", [250, 500])
def test_the_steps_of_a_held_command_are_no_fault_of_a_sensor(rate_hz: int) -> None:
    """At low rates they add to the table's samples up to more than the slow motion itself; exact sensors agree, and
    one that shows 5 % too much is told."""
    settings = (f"table={{extends: aps400_virtual, channels: {FURTHER}}}", f"sample_rate_hz={rate_hz}")
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])
    found = examine_channels(setup, 0.5, True, None, lambda _: None)
    assert found.exit_code == 0, channels_page(found)
    by_name = {one.channel: one for one in found.comparisons}
    assert by_name["table_displacement"].ratio == pytest.approx(1.0, abs=0.01)
    assert by_name["table"].ratio == pytest.approx(1.0, abs=0.02)
    wrong = replace(setup.rig.further[0], sensitivity_v_per_unit=setup.rig.further[0].sensitivity_v_per_unit / 1.05)
    misread = replace(setup, rig=replace(setup.rig, further=(wrong, *setup.rig.further[1:])), declared_rig=setup.rig)
    told = {one.channel: one.told for one in examine_channels(misread, 0.5, True, None, lambda _: None).comparisons}
    assert told["table_displacement"] == "does not agree" and told["table_force"] == "agrees"


def test_a_push_tells_the_sign_of_the_first_excursion(setup: Setup) -> None:
    reversed_floor = tuple(
        replace(channel, sign=-1.0) if channel.name == "floor_3" else channel for channel in setup.rig.channels
    )
    info = replace(setup.rig, channels=reversed_floor)
    shown = np.full((100, 6), 0.2)
    shown[50:60] += [0.0, 0.3, -0.3, 0.0, -0.4, 0.01]
    shown[60:] -= [0.0, 0.3, 0.3, 0.0, 0.3, 0.0]
    found = AtRest(np.full(6, 0.2), np.full(6, 2e-3))
    assert first_signs(shown, found, info) == [0, 1, 1, 0, -1, 0]


def test_a_phase_counts(setup: Setup) -> None:
    assert Comparison("a", "b", 1.0, 0.5, 0.02).agrees
    assert not Comparison("a", "b", 1.0, 2.0, 0.02).agrees
    assert Comparison("a", "b", 1.0, 180.0, 0.02).told == "its sign is reversed"
    assert not Comparison("a", "b", math.nan, 0.0, 0.02).agrees
