"""Rig files of real rigs: what they must state, what they must not, and what they change in a case."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
import yaml

from rths_cli.case import plugin_interface
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.case.rig_schema import (
    ChannelSpec,
    NiRigSpec,
    PluginRigSpec,
    UdpRigSpec,
    UdpSpec,
)
from rths_cli.case.shipped_files import shipped

CHANNEL = {"sensitivity_mv_per_g": 1000, "range_g": 5, "high_pass_hz": 0.024, "low_pass_hz": 1549}
UDP: dict[str, Any] = {
    "kind": "udp",
    "udp": {"host": "192.168.7.2", "port": 47800},
    "channels": [{**CHANNEL, "name": "table"}, CHANNEL, CHANNEL],
    "converters": {"bits": 16, "range_v": 10},
    "limits": {"stroke_m": 0.075, "velocity_m_s": 0.9, "acceleration_m_s2": 40, "force_n": 400},
    "nominal": {"gain_m_per_v": 0.0079, "moving_mass_kg": 7.0, "payload_kg": 23},
}


def without(data: dict[str, Any], *path: str) -> dict[str, Any]:
    """Return nested data without the entry at a path."""
    key, rest = path[0], path[1:]
    return {k: without(v, *rest) if k == key else v for k, v in data.items() if k != key or rest}


@pytest.fixture
def rig(write):
    """Write a rig file `bench` of these keys, return the line that names it."""

    def write_rig(**changes: Any) -> str:
        write(name="configs/rigs/bench.yaml", text=yaml.safe_dump({**UDP, **changes}, sort_keys=False))
        return "table: bench\n"

    return write_rig


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch):
    """Install entry points of the group by name and value."""

    def plug(*pairs: tuple[str, str]) -> None:
        points = [EntryPoint(name, value, plugin_interface.GROUP) for name, value in pairs]
        monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points if group == "rths.rigs" else [])

    return plug


def test_a_udp_rig_is_read_with_the_defaults_of_what_is_no_knowledge_of_the_table(write, rig) -> None:
    (case,) = load_cases([write(rig())])
    table = case.table
    assert isinstance(table, UdpRigSpec) and table.channels is not None
    assert (table.name, table.udp.host, table.udp.port, table.udp.timeout_s) == ("bench", "192.168.7.2", 47800, None)
    assert (table.unattended, table.watchdog_s, table.overrun, table.converters.latency_samples) == (
        False,
        0.1,
        "skip",
        1,
    )
    assert [channel.name for channel in table.channels] == ["table", "", ""]
    assert table.limits.lost_samples is None and table.limits.tracking_error_m_s2 is None


def test_a_real_rig_plays_no_shake_table_test_unless_the_case_says_so(write, rig) -> None:
    assert load_cases([write(rig())])[0].runs == ("sim", "sim_delay", "exp_rths")
    assert load_cases([write(rig() + "runs: [shake-table]\n")])[0].runs == ("shake_table",)


def test_a_figure_of_a_run_left_out_cannot_be_accepted(faults_of, rig) -> None:
    (fault,) = faults_of(rig() + "accept: {shake_table.tracking_max_m_s2: 1}\n")
    assert "needs the run shake_table; add it to runs" in fault


@pytest.mark.parametrize(
    "path",
    [
        ("limits",), ("limits", "stroke_m"), ("limits", "velocity_m_s"), ("limits", "acceleration_m_s2"),
        ("limits", "force_n"), ("nominal",), ("nominal", "gain_m_per_v"), ("nominal", "moving_mass_kg"),
        ("nominal", "payload_kg"), ("converters",), ("converters", "bits"), ("converters", "range_v"), ("udp",),
        ("udp", "host"), ("udp", "port"),
    ],
    ids=".".join,
)  # fmt: skip
def test_what_a_laboratory_must_know_has_no_default(write, faults_of, path: tuple[str, ...]) -> None:
    write(name="configs/rigs/bench.yaml", text=yaml.safe_dump(without(UDP, *path)))
    (fault,) = faults_of("table: bench\n")
    assert fault.startswith("configs/rigs/bench.yaml:")  # where it is to be added
    assert f": table.{'.'.join(path)}: is missing; add {path[-1]}" in fault


@pytest.mark.parametrize("key", CHANNEL)
def test_a_channel_states_its_sensor_completely(write, faults_of, rig, key: str) -> None:
    line = rig(channels=[CHANNEL, {k: v for k, v in CHANNEL.items() if k != key}, CHANNEL])
    (fault,) = faults_of(line)
    assert fault.partition(": ")[0].startswith("configs/rigs/bench.yaml:") and "table.channels[2]" in fault
    assert key in fault


@pytest.mark.parametrize(
    ("changes", "place", "fault"),
    [
        ({"physics": {}}, "physics", "belongs to a virtual rig; remove it"),
        ({"after_identification": {}}, "after_identification", "belongs to a virtual rig; remove it"),
        ({"channels": None, "sensors": {**CHANNEL, "noise_rms_m_s2": 1e-3}}, "sensors.noise_rms_m_s2",
         "belongs to a virtual rig; remove it"),
        ({"ni": {}}, "ni", "belongs to kind: ni"),
        ({"options": {}}, "options", "belongs to the kind of a plug-in"),
        ({"sensors": CHANNEL}, "sensors", "give channels or sensors, not both"),
        ({"channels": [CHANNEL, CHANNEL]}, "channels", "must be the table's and one per experimental storey, 3 in all, "
         "got 2; list the channels of this structure"),
        ({"converters": {"bits": 16, "range_v": 10, "latency_samples": 0}}, "converters.latency_samples",
         "must be >= 1 and <= 100, got 0"),
        ({"overrun": "wait"}, "overrun", "must be hold, skip or stop, got 'wait'"),
        ({"unattended": 1}, "unattended", "must be true or false, got 1"),
        ({"watchdog_s": 0}, "watchdog_s", "must be >= 0.001 and <= 10 s, got 0"),
        ({"udp": {"host": "10.0.0.1:7", "port": 1}}, "udp.host",
         "must be a host's name or address, without port, got '10.0.0.1:7'"),
        ({"udp": {"host": "a", "port": 1, "timeout_s": 5e-4}}, "udp.timeout_s",
         "must be <= 0.00035, 0.7 of the sample interval, got 0.0005; the step needs the rest"),
        ({"watchdog_s": 0.003}, "watchdog_s", "must be > 0.003, what the 5 samples last that may be lost in a row "
         "(limits.lost_samples), and one more, got 0.003; the rig would rest its table first; lower lost_samples, or "
         "raise watchdog_s in the rig's file"),
        ({"udp": {"host": "a", "port": 1, "key_file": "a\0b"}}, "udp.key_file",
         "must be the name of a file, got 'a\\x00b'"),
        ({"model": " "}, "model", "must be the name of a file, got ' '"),
        ({"udp": {"host": "a", "port": 65536}}, "udp.port", "must be >= 1 and <= 65535, got 65536"),
        ({"udp": {"host": "a", "port": 1, "key": "secret"}}, "udp.key",
         "unknown key; known: host, key_file, port, timeout_s"),
        ({"sample_rate_hz": 500}, "sample_rate_hz", "belongs to the case, not to its rig"),
        ({"limits": {**UDP["limits"], "energy_ratio": 0}}, "limits.energy_ratio", "must be > 0 and <= 100, got 0"),
    ],
)  # fmt: skip
def test_one_fault_is_one_sentence_with_its_place(faults_of, rig, changes, place: str, fault: str) -> None:
    line = rig(**changes)
    if "channels" in changes and changes["channels"] is None:
        text = Path("configs/rigs/bench.yaml").read_text().replace("channels: null\n", "")
        Path("configs/rigs/bench.yaml").write_text(text)
    (found,) = faults_of(line)
    where, _, said = found.partition(": ")
    assert where.count(":") == 2 and where.startswith("configs/rigs/bench.yaml:")
    assert said == f"table.{place}: {fault}"


@pytest.mark.parametrize(
    ("keys", "fault"),
    [
        ({"sign": 0}, "must be 1 or -1 (mounted against the positive direction), got 0"),
        ({"sign": 1.0}, "must be a whole number, got 1.0"),
        ({"sensitivity_v_per_m_s2": 0.1}, "give sensitivity_mv_per_g or sensitivity_v_per_m_s2, not both"),
        ({"warning_m_s2": 30, "abort_m_s2": 30}, "must be < abort_m_s2 = 30, got 30"),
        ({"abort_m_s2": 50}, "must be <= 49.03, the sensor's range, got 50; the sensor would not show it"),
        ({"low_pass_hz": 0.01}, "must be > high_pass_hz = 0.024 or 0 (off), got 0.01"),
        ({"unit": "V"}, "unknown key"),
    ],
)  # fmt: skip
def test_a_channel_at_odds_with_itself_is_refused(faults_of, rig, keys: dict[str, Any], fault: str) -> None:
    (found,) = faults_of(rig(channels=[CHANNEL, CHANNEL, {**CHANNEL, **keys}]))
    assert "table.channels[3]" in found and fault in found


def test_a_sensitivity_is_read_from_either_key() -> None:
    by_g = ChannelSpec.model_validate(CHANNEL)
    rest = {k: v for k, v in CHANNEL.items() if k != "sensitivity_mv_per_g"}
    by_si = ChannelSpec.model_validate({**rest, "sensitivity_v_per_m_s2": 0.10197162129779282})
    assert by_g.volts_per_m_s2 == pytest.approx(0.10197162129779283, rel=1e-14)  # 1 V over 9.80665 m/s^2
    assert by_si.volts_per_m_s2 == pytest.approx(by_g.volts_per_m_s2, rel=1e-14)


@pytest.mark.parametrize(
    ("host", "loopback"),
    [("127.0.0.1", True), ("127.9.9.9", True), ("localhost", True), ("::1", True), ("192.168.7.2", False),
     ("localhost.lab", False), ("fe80::1", False)],
)  # fmt: skip
def test_a_loopback_address_is_known_without_asking_anyone(host: str, loopback: bool) -> None:
    assert UdpSpec(host=host, port=1).is_loopback is loopback


def test_an_unknown_kind_is_one_fault(faults_of, rig, plugged) -> None:
    plugged(("shaker", "a:b"))
    (fault,) = faults_of(rig(kind="upd", nonsense=1))
    assert "table.kind: no kind of rig is called 'upd'; did you mean udp?; a further kind comes with" in fault
    (fault,) = faults_of(rig(kind="hydraulic", nonsense=1))
    assert "known: ni, shaker, target, udp, udp_plain, virtual;" in fault
    (fault,) = faults_of(rig(kind=[1]))
    assert fault.endswith("table.kind: must be text, got a list")


def test_a_plug_in_s_kind_takes_options_and_comes_from_one_package(write, faults_of, rig, plugged) -> None:
    plugged(("shaker", "a:b"), ("udp", "evil:make"))
    keys = {k: v for k, v in UDP.items() if k != "udp"} | {
        "kind": "shaker",
        "options": {"gain": 2, "of": [1, {"a": 2}]},
    }
    write(name="configs/rigs/other.yaml", text=yaml.safe_dump(keys))
    (case,) = load_cases([write("table: other\n")])
    assert isinstance(case.table, PluginRigSpec)
    assert case.table.options == {"gain": 2, "of": (1, {"a": 2})}
    assert isinstance(load_cases([write(rig())])[0].table, UdpRigSpec)  # ours is not taken over
    plugged(("shaker", "a:b"), ("shaker", "c:d"))
    (fault,) = faults_of("table: other\n")
    assert fault.endswith("table.kind: 'shaker' is brought by several packages (a:b, c:d); remove all but one")


def ni(**changes: Any) -> dict[str, Any]:
    """Return the keys that make the rig one on an NI card, for a file that names `udp` no more."""
    channels = [{**CHANNEL, "terminal": f"ai{i}"} for i in range(3)]
    return (
        {k: v for k, v in UDP.items() if k != "udp"}
        | {"kind": "ni", "ni": {"device": "Dev1"}, "channels": channels}
        | changes
    )


def test_an_ni_rig_names_a_terminal_per_channel_and_has_no_watchdog(write, faults_of) -> None:
    def found(keys: dict[str, Any]) -> list[str]:
        write(name="configs/rigs/card.yaml", text=yaml.safe_dump(keys))
        return [fault.partition(": ")[2] for fault in faults_of("table: card\n")]

    write(name="configs/rigs/card.yaml", text=yaml.safe_dump(ni()))
    (case,) = load_cases([write("table: card\n")])
    assert isinstance(case.table, NiRigSpec) and case.table.ni.command_channel == "ao0"
    channels = ni()["channels"]
    assert found(ni(channels=[channels[0], CHANNEL, channels[2]])) == [
        "table.channels[2]: needs the input it is connected to; add terminal, such as terminal: ai0"
    ]
    assert found(ni(channels=[channels[0], channels[1], channels[0]])) == [
        "table.channels[3].terminal: is that of channels[1] already; give each its own"
    ]
    (fault,) = found(ni(watchdog_s=0.1))
    assert fault.startswith("table.watchdog_s: an NI card has no watchdog, it holds its last voltage; remove this")
    assert found({k: v for k, v in ni(sensors=CHANNEL).items() if k != "channels"}) == [
        "table.sensors: an NI card needs the terminal of each channel; list them under channels"
    ]


def test_paths_in_a_rig_file_start_at_the_rig_file(write, rig) -> None:
    line = rig(udp={**UDP["udp"], "key_file": "../keys/rths.key"}, model="../../models/bench.h5")
    write(name="models/bench.h5", text="")
    (case,) = load_cases([write(line)])
    assert isinstance(case.table, UdpRigSpec)
    assert case.table.udp.key_file == Path("configs/keys/rths.key").absolute()  # may be missing: rths check needs none
    assert case.identification.model == case.table.model == Path("models/bench.h5").absolute()


def test_a_rig_s_model_serves_cases_that_name_none(write, faults_of, rig) -> None:
    line = rig(model="missing.h5")
    (fault,) = faults_of(line)
    assert fault.startswith("configs/rigs/bench.yaml:") and "table.model: no such file: " in fault
    assert fault.endswith(
        "identify the rig (rths identify) and name its model file here, or under identification.model"
    )
    other = write(name="own.h5", text="")
    assert load_cases([write(f"{line}identification: {{model: own.h5}}\n")])[0].identification.model == other.absolute()
    assert load_cases([write(line)], ["identification.model=null"])[0].identification.model is None  # rths identify


def test_a_case_may_be_stricter_than_its_rig_never_looser(write, faults_of, rig) -> None:
    line = rig(limits={**UDP["limits"], "tracking_error_m_s2": 3})
    (case,) = load_cases([write(f"{line}limits: {{tracking_error_m_s2: 2, lost_samples: 3, command_rate_v_s: 50}}\n")])
    limits = case.table.limits
    assert (limits.tracking_error_m_s2, limits.lost_samples, limits.command_rate_v_s) == (2, 3, 50)
    assert limits.stroke_m == 0.075
    found = faults_of(f"{line}limits: {{tracking_error_m_s2: 4, lost_samples: 6}}\n")
    assert [fault.partition("limits.")[2] for fault in found] == [
        "tracking_error_m_s2: must be <= the rig's 3, got 4; a case may only be stricter",
        "lost_samples: must be <= the rig's 5, got 6; a case may only be stricter",
    ]


@pytest.mark.parametrize("name", ["udp_loopback", "udp_example", "ni_example"])
def test_a_resolved_case_on_a_shipped_rig_loads_to_the_same_case(lab: Path, write, name: str) -> None:
    (case,) = load_cases([write(f"table: {name}\n")])
    again_path = lab / "again.yaml"
    again_path.write_text(resolved_yaml(case), encoding="utf-8")
    (again,) = load_cases([again_path])
    hidden = {"path", "yaml_text"}
    assert again.model_dump(exclude=hidden) == case.model_dump(exclude=hidden)


def test_the_commented_example_names_every_key(lab: Path) -> None:
    text = (shipped("rigs") / "udp_example.yaml").read_text(encoding="utf-8")
    models = (UdpRigSpec, UdpSpec, ChannelSpec, *(UdpRigSpec.model_fields[k].annotation for k in ("limits", "nominal")))
    for model in models:
        for key in set(model.model_fields) - {"name", "terminal", "sensors"}:
            assert f" {key}:" in f" {text}".replace("\n", " "), key


@pytest.mark.parametrize(
    ("changes", "lines", "fits"),
    [
        ({"watchdog_s": 0.0031}, "", True),
        ({"watchdog_s": 0.003}, "limits: {lost_samples: 4}\n", True),
        ({"watchdog_s": 0.003}, "sample_rate_hz: 2100\n", True),
        ({}, "sample_rate_hz: 130\n", True),
        ({"limits": {**UDP["limits"], "lost_samples": 20}}, "sample_rate_hz: 200\n", False),
        ({"limits": {**UDP["limits"], "lost_samples": 20}}, "sample_rate_hz: 211\n", True),
    ],
)  # fmt: skip
def test_a_watchdog_outlasts_what_the_runner_bears(write, faults_of, rig, changes, lines: str, fits: bool) -> None:
    """Between the last command before k lost ones and the next pass k + 1 intervals."""
    if fits:
        assert load_cases([write(rig(**changes) + lines)])
    else:
        (fault,) = faults_of(rig(**changes) + lines)
        assert ": table.watchdog_s: must be > 0.105, what the 20 samples last" in fault


def test_the_loop_waits_for_an_answer_as_long_as_a_rig_file_may_ask_at_most() -> None:
    from rths_cli.case.case_schema import ANSWER_SHARE
    from rths_cli.loop import realtime_loop
    from rths_cli.rigs.udp import udp_rig

    assert ANSWER_SHARE == realtime_loop.ANSWER_SHARE == udp_rig.ANSWER_SHARE
