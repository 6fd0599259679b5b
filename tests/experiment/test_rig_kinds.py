"""From a rig file to the rig: what the loop learns of it, which driver is made, and whose model it takes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, RigError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import differences, identity
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, open_rig
from rths_cli.experiment.setup import Setup, make_setup

CASE = "el_centro_low_ff_fb"
G = 9.80665


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases([CASE], settings)[0])


def test_the_loop_learns_what_a_rig_file_states() -> None:
    info = setup_of("table=udp_example").rig
    assert (info.name, info.kind, info.dt_s, info.latency_samples) == ("udp_example", "udp", 1 / 2000, 1)
    table, floor_2, floor_3 = info.channels
    assert [channel.name for channel in info.channels] == ["table", "floor_2", "floor_3"]
    assert table.label == "table, s/n 10417"
    assert table.sensitivity_v_per_unit == pytest.approx(1.0214 / G, rel=1e-14)
    assert floor_3.sensitivity_v_per_unit == 0.1022
    assert table.range == pytest.approx(5 * G) and table.high_pass_hz == 0.024
    assert info.signs == (1.0, -1.0, 1.0)
    assert (table.warning, table.abort, floor_2.abort) == (20.0, 35.0, math.inf)
    limits = info.limits
    assert (limits.stroke_m, limits.velocity_m_s, limits.acceleration_m_s2, limits.force_n) == (0.075, 0.9, 40, 400)
    assert (limits.command_rate_v_s, limits.tracking_error_m_s2, limits.energy_ratio, limits.lost_samples) == (
        120, 3, 0.1, 5,
    )  # fmt: skip
    assert (info.unattended, info.watchdog_s, info.overrun, info.driver_verified) == (False, 0.1, "skip", "hardware")


def test_a_case_s_stricter_limit_reaches_the_loop() -> None:
    info = setup_of("table=udp_example", "limits.lost_samples=2", "limits.force_n=300").rig
    assert (info.limits.lost_samples, info.limits.force_n, info.limits.stroke_m) == (2, 300, 0.075)


def test_a_virtual_rig_has_no_further_limits_and_verifies_no_driver() -> None:
    info = setup_of().rig
    assert info.signs == (1.0, 1.0, 1.0) and info.driver_verified == ""
    assert (info.limits.tracking_error_m_s2, info.limits.command_rate_v_s) == (math.inf, math.inf)
    assert setup_of("table.limits.tracking_error_m_s2=2").rig.limits.tracking_error_m_s2 == 2.0


def test_before_it_is_open_only_an_address_says_what_is_behind_a_driver() -> None:
    assert setup_of("table=udp_loopback").rig.driver_verified == "loopback"
    assert setup_of("table=udp_example").rig.driver_verified == "hardware"
    ni = setup_of("table=ni_example").rig
    assert (ni.driver_verified, ni.watchdog_s, ni.overrun) == ("", 0.0, "stop")


def test_all_channels_alike_are_stated_once() -> None:
    info = setup_of("table=udp_loopback").rig
    assert len(info.channels) == 3 and len({channel.sensitivity_v_per_unit for channel in info.channels}) == 1
    assert [channel.name for channel in info.channels] == ["table", "floor_2", "floor_3"]


def test_the_driver_of_each_kind_gets_what_its_file_says() -> None:
    udp = open_rig(setup_of("table=udp_example", "limits.lost_samples=2"), (EXP_RTHS,), 0)
    assert type(udp).__name__ == "UdpRig"
    target: Any = udp.target  # type: ignore[attr-defined]
    assert (target.host, target.port, target.key_file.name) == ("192.168.7.2", 47800, "rths.key")
    assert target.key_file.parent.name == "rigs"  # beside its rig file
    assert (target.timeout_s, target.watchdog_s, target.lost_samples) == (0.0003, 0.1, 2)
    ni = open_rig(setup_of("table=ni_example"), (EXP_RTHS,), 0)
    assert type(ni).__name__ == "NiRig"
    wiring: Any = ni.wiring  # type: ignore[attr-defined]
    assert (wiring.device, wiring.command_channel, wiring.terminals) == ("Dev1", "ao0", ("ai0", "ai1", "ai2"))
    assert (wiring.enable_line, wiring.kind, wiring.range_v, wiring.rate_hz) == (
        "port0/line0", "differential", 10.0, pytest.approx(2000.0),
    )  # fmt: skip
    virtual = open_rig(setup_of(), (EXP_RTHS,), 3)
    assert type(virtual).__name__ == "VirtualRig" and virtual.info.kind == "virtual"


def test_a_card_that_is_not_there_is_a_rig_fault_when_it_is_opened_not_before() -> None:
    rig = open_rig(setup_of("table=ni_example"), (EXP_RTHS,), 0)
    with pytest.raises(RigError, match=r"^rig ni_example: (needs the package nidaqmx|the driver NI-DAQmx|there is no)"):
        rig.open()


@pytest.mark.parametrize("table", ["udp_loopback", "udp_example", "ni_example"])
def test_a_run_on_a_real_rig_asks_for_a_model_and_excites_nothing(table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    setup = setup_of(f"table={table}")
    for module in ("rths_cli.experiment.identify_on_rig", "rths_cli.experiment.real_rig_readiness"):
        monkeypatch.setattr(f"{module}.open_rig", lambda *_: pytest.fail("the rig was made"))
    missing = r"identification\.model: is missing; a real rig is identified before it is used"
    with pytest.raises(InputError, match=missing):
        Memory().known(setup, lambda text: None)


def changed(folder: Path, change: str) -> str:
    """Return the setting that names a rig file udp_loopback with one key.sub=value changed."""
    path, _, value = change.partition("=")
    keys: Any = yaml.safe_load(value)
    for key in reversed(path.split(".")):
        keys = {key: keys}
    (folder / "udp_loopback.yaml").write_text(yaml.safe_dump({"extends": "udp_loopback", **keys}))
    return f"table={folder / 'udp_loopback.yaml'}"


def named(*settings: str) -> dict[str, str | int | float]:
    return identity(setup_of(*settings))


def test_a_model_of_another_rig_is_refused_by_name_and_kind() -> None:
    wanted = named("table=udp_loopback")
    assert differences(wanted, wanted) == []
    (fault,) = differences(named(), wanted)
    assert fault == (
        "identified on rig aps400_virtual of kind virtual, the case's rig is udp_loopback of kind udp; "
        "a real rig needs a model that was identified on it"
    )
    twin = {**wanted, "rig": "other_table"}
    assert differences(twin, wanted)[0].startswith("identified on rig other_table of kind udp, the case's rig is udp_")


@pytest.mark.campaign
@pytest.mark.parametrize(
    "setting",
    [
        "limits.stroke_m=0.05",
        "unattended=true",
        "watchdog_s=0.05",
        "overrun=stop",
        "udp.port=1",
        "sensors.abort_m_s2=9",
    ],
)
def test_what_does_not_change_a_rig_leaves_its_model_valid(setting: str, tmp_path: Path) -> None:
    assert differences(named("table=udp_loopback"), named(changed(tmp_path, setting))) == []


@pytest.mark.parametrize(
    "setting",
    ["sensors.sensitivity_mv_per_g=999", "sensors.sign=-1", "converters.bits=12", "nominal.gain_m_per_v=0.008"],
)
def test_what_changes_a_rig_makes_its_model_that_of_another(setting: str, tmp_path: Path) -> None:
    (fault,) = differences(named("table=udp_loopback"), named(changed(tmp_path, setting)))
    assert "is another one (or its file or calibration has changed)" in fault


def test_levels_and_labels_of_single_channels_leave_a_model_valid(tmp_path: Path) -> None:
    def with_channels(channels: list[dict[str, Any]]) -> str:
        text = yaml.safe_dump({"extends": "udp_example", "channels": channels})
        (tmp_path / "udp_example.yaml").write_text(text)
        return f"table={tmp_path / 'udp_example.yaml'}"

    before = named("table=udp_example")
    channel = {"sensitivity_mv_per_g": 1021.4, "range_g": 5, "high_pass_hz": 0.024, "low_pass_hz": 1549}
    others = [{**channel, "sensitivity_mv_per_g": 998.7, "sign": -1}]
    others += [{**{k: v for k, v in channel.items() if "mv" not in k}, "sensitivity_v_per_m_s2": 0.1022}]
    same = [{**channel, "name": "new", "abort_m_s2": 5}, *others]
    assert differences(before, named(with_channels(same))) == []
    assert len(differences(before, named(with_channels([others[0], channel, others[1]])))) == 1
