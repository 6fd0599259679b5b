"""What `rths doctor --channels` shows of rigs behind UDP and on an NI card: zeros, noise, signs, comparisons."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from further_channels import FIVE_AS_KEYS
from serving_bench import Running, leave_out_punctuality

from rths_cli.case.load import load_cases
from rths_cli.experiment import real_rig_readiness
from rths_cli.experiment.real_rig_readiness import PROBE, open_virtual
from rths_cli.experiment.setup import make_setup
from rths_cli.laboratory.doctor_request import DoctorRequest, channels_request
from rths_cli.laboratory.doctor_rig import ChannelsExamined
from rths_cli.laboratory.serve import describe
from rths_cli.report.doctor_page import channels_page
from rths_cli.rigs.virtual.virtual_rig import VirtualRig

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
RATE = "sample_rate_hz=500"
NOISE = {"table_displacement": 2e-5, "table_force": 0.05, "floor_3_acceleration": 0.01}
NOISY = [
    {**keys, "noise_rms": size}
    for keys, size in zip(FIVE_AS_KEYS, (0.02, 0.05, 0.0, 0.01, 0.0), strict=True)  # in the channel's own unit
]
PUSH_M_S = 0.01
NAMES = ["table", "floor_2", "floor_3", "table_displacement", "table_force", "storey_3_strain",
         "floor_3_acceleration", "floor_2_displacement"]  # fmt: skip


@pytest.fixture(autouse=True)
def unhurried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave punctuality out: it is tested elsewhere."""
    leave_out_punctuality(monkeypatch)
    monkeypatch.setattr(real_rig_readiness, "check_measured", lambda *given: None)
    monkeypatch.chdir(tmp_path)


def pushing(table: Callable[[], VirtualRig]) -> tuple[Callable[[], object], Callable[[str], object], list[str]]:
    """Return who is asked for a push, a listener to the live values who then pushes the top floor, and what it heard.

    The top floor has 10 mm/s at once, so that its acceleration begins against the push and its drift with it; the push
    is repeated with every live value, so that none is missed.
    """
    asked, said = [], []

    def say(told: str) -> None:
        said.append(told)
        if asked and told.startswith("table "):
            table().state.state[6] += PUSH_M_S  # position, velocity and force of the table, two floors, their rates

    return lambda: asked.append(True), say, said


def shows_what_is_there(found: ChannelsExamined, said: list[str]) -> None:
    """Assert that names, live values, noise and signs are those of the table."""
    rows = {row.name: row for row in found.rows}
    assert list(rows) == NAMES
    assert any(all(f"{name} " in told for name in NAMES) for told in said)
    for name, rms in NOISE.items():
        assert rows[name].noise == pytest.approx(rms, rel=0.25), name
    assert [rows[name].pushed for name in ("floor_3", "storey_3_strain", "floor_3_acceleration")] == [-1, 1, -1]


@pytest.mark.campaign
def test_eight_channels_behind_udp(tmp_path: Path) -> None:
    Path("served.yaml").write_text(yaml.safe_dump({"extends": "aps400_virtual", "channels": NOISY}))
    key = tmp_path / "key"
    key.write_text(bytes(range(16)).hex())
    key.chmod(0o600)
    running = Running(describe("served.yaml", "three_storey", (RATE,), 0), key, watchdog_s=2.0)
    push, say, said = pushing(lambda: running.server.table)
    runner = {
        "extends": "udp_loopback", "channels": FIVE_AS_KEYS, "watchdog_s": 2.0,
        "udp": {"host": "127.0.0.1", "port": running.port, "key_file": "key"}, "limits": {"lost_samples": 200},
    }  # fmt: skip
    Path("doctor_over_udp.yaml").write_text(yaml.safe_dump(runner))
    try:
        found = channels_request(DoctorRequest(None, "doctor_over_udp.yaml", (), 1.0, (RATE,)), True, push, say)
    finally:
        running.end()
    assert found.exit_code == 0, channels_page(found)
    assert len(found.comparisons) == 7
    shows_what_is_there(found, said)


def ni_rig(further: list[dict[str, Any]], floor_3: dict[str, Any]) -> dict[str, Any]:
    """Return a rig file of a card with three accelerometers and further channels, a terminal each."""
    one = {"sensitivity_mv_per_g": 1000, "range_g": 5, "high_pass_hz": 0.024, "low_pass_hz": 1549}
    every = [{"name": "table", **one}, {"name": "floor 2", **one}, {"name": "floor 3", **one, **floor_3}, *further]
    return {
        "kind": "ni", "ni": {"device": "Dev1"}, "unattended": True, "overrun": "skip",
        "channels": [{**keys, "terminal": f"ai{i}"} for i, keys in enumerate(every)],
        "converters": {"bits": 16, "range_v": 10}, "limits": {"stroke_m": 0.079, "velocity_m_s": 1.0,
        "acceleration_m_s2": 45, "force_n": 445, "lost_samples": 2},
        "nominal": {"gain_m_per_v": 0.0079, "moving_mass_kg": 7.0, "payload_kg": 23},
    }  # fmt: skip


@pytest.fixture
def look(monkeypatch: pytest.MonkeyPatch) -> Callable[[dict[str, Any]], tuple[ChannelsExamined, list[str]]]:
    """Return what examines a rig file's card, in front of a table whose third floor and whose displacement sensor of
    floor 2 are mounted the other way round, and whose load cell shows
    0.3 V at rest, this sensor 0.1 V."""
    fake_daqmx = pytest.importorskip("fake_daqmx", reason="pip install 'rths-cli[ni]' to test the NI rig")
    wired = np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0, -1.0])
    zeros_v = np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.0, 0.0, 0.1])

    def examined(file: dict[str, Any]) -> tuple[ChannelsExamined, list[str]]:
        table = f"table={json.dumps({'extends': 'aps400_virtual', 'channels': NOISY})}"
        rig = open_virtual(make_setup(load_cases(["el_centro_low_ff_fb"], (table, RATE))[0]), (PROBE,), 0)
        card = fake_daqmx.FakeCard(
            lambda: wired * rig.arm() + zeros_v, lambda volts: wired * rig.exchange(np.array([volts])) + zeros_v
        )
        fake_daqmx.install(monkeypatch, card)
        push, say, said = pushing(lambda: rig)
        Path("card.yaml").write_text(yaml.safe_dump(file))
        found = channels_request(DoctorRequest(None, "card.yaml", (), 1.0, (RATE,)), True, push, say)
        assert [what[1] for what in card.done if what[0] == "input"][:8] == [f"Dev1/ai{i}" for i in range(8)]
        return found, said

    return examined


@pytest.mark.campaign
def test_eight_channels_on_a_card(look: Callable[[dict[str, Any]], tuple[ChannelsExamined, list[str]]]) -> None:
    further = [*FIVE_AS_KEYS[:4], {**FIVE_AS_KEYS[4], "sign": -1}]
    found, said = look(ni_rig(further, {"sign": -1}))
    assert found.exit_code == 0, channels_page(found)
    shows_what_is_there(found, said)
    zeros = {row.name: (row.zero_v, row.zero) for row in found.rows}
    assert zeros["table_force"] == pytest.approx((0.3, 15.0), rel=5e-3)
    assert zeros["floor_2_displacement"] == pytest.approx((0.1, -1e-3), rel=5e-3)


@pytest.mark.campaign
def test_channels_of_a_card_that_are_reversed_are_told(
    look: Callable[[dict[str, Any]], tuple[ChannelsExamined, list[str]]],
) -> None:
    found, _ = look(ni_rig(FIVE_AS_KEYS, {}))
    reversed_ones = {one.channel for one in found.comparisons if one.told == "its sign is reversed"}
    assert {"floor_3", "floor_2_displacement"} <= reversed_ones and "table_displacement" not in reversed_ones
    assert found.exit_code == 1
    pushed = {row.name: row.pushed for row in found.rows}
    assert (pushed["floor_3"], pushed["floor_3_acceleration"]) == (1, -1)


def test_a_card_whose_cell_is_far_from_zero_is_not_moved(
    look: Callable[[dict[str, Any]], tuple[ChannelsExamined, list[str]]],
) -> None:
    further = [{**keys, "range": 100} if keys["kind"] == "force" else keys for keys in FIVE_AS_KEYS]
    found, _ = look(ni_rig(further, {}))
    assert found.comparisons == () and "table_force shows 0.3" in found.faults[0]
