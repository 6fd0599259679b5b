"""When the samples of a rig are there: over UDP against a real server, and on a rig with a clock of its own."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from serving_bench import Running

from rths_cli.errors import RigError
from rths_cli.laboratory import doctor_rig
from rths_cli.laboratory.doctor_rig import exchange_delays, paced_delays
from rths_cli.laboratory.serve import describe
from rths_cli.loop import udp_target
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.session import make_secret

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
MS = 1_000_000


class Paced:
    """A rig with a clock of its own, whose exchanges return at even instants `now`, those of `late_ns` later."""

    def __init__(self, dt_s: float, late_ns: dict[int, int]) -> None:
        self.info = replace(describe("aps400_virtual", "three_storey", (), 0).setup.rig, dt_s=dt_s)
        self.late_ns, self.k, self.now = late_ns, 0, 0

    def exchange(self, command_v: float) -> None:
        assert command_v == 0.0
        due = round(self.k * self.info.dt_s * 1e9) + self.late_ns.get(self.k, 0)
        self.k, self.now = self.k + 1, max(due, self.now)


def test_a_late_exchange_of_a_rig_with_its_own_clock_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of 9 ms at a pace of 2 ms: the next ones come at once until the pace is caught up."""
    rig = Paced(0.002, {20: 9 * MS})
    monkeypatch.setattr(time, "monotonic_ns", lambda: rig.now)
    late = paced_delays(rig, 40)  # type: ignore[arg-type]
    assert late.tolist() == [*[0] * 20, 9 * MS, 7 * MS, 5 * MS, 3 * MS, MS, *[0] * 15]


def test_a_rig_that_waits_for_no_sample_instant_is_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pace a quarter faster is that of another clock and shows as it is; one of none has no rate to be held."""
    rig = Paced(0.002, {})
    monkeypatch.setattr(time, "monotonic_ns", lambda: 3 * rig.now // 4)
    assert paced_delays(rig, 40)[0] == 39 * MS // 2  # type: ignore[arg-type]
    rig.k = rig.now = 0
    monkeypatch.setattr(time, "monotonic_ns", lambda: rig.now // 100)
    with pytest.raises(RigError, match=r"39 exchanges took 0.00078 s, not the 0.078 s .* by COUNTED_CLOCK"):
        paced_delays(rig, 40)  # type: ignore[arg-type]


def test_the_exchange_over_udp_is_measured_and_the_table_stays_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_secret(tmp_path / "key")
    served = describe("aps400_virtual", "three_storey", ("sample_rate_hz=200",), 0)
    running = Running(served, tmp_path / "key")
    monkeypatch.setattr(doctor_rig, "open_rig", lambda *_: running.rig())
    try:
        late = exchange_delays(served.setup.case)(200.0, 0.2)
        assert late.shape == (40,) and (late > 0).all()
        ended = running.server.ended[0]
        assert 40 - ended.lost <= ended.commands <= 40  # lost are commands that did not come, or answers too late
        assert running.session[udp_target.STATE] == packets.RESTED
        assert not running.server.table.state.state[: running.server.table.plant.mechanical].any()
    finally:
        running.end()


def test_a_target_that_stops_ends_the_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_secret(tmp_path / "key")
    served = describe("aps400_virtual", "three_storey", ("sample_rate_hz=200",), 0)
    running = Running(served, tmp_path / "key")
    rig = running.rig()
    monkeypatch.setattr(doctor_rig, "open_rig", lambda *_: rig)
    armed = rig.arm

    def arm_and_fail() -> np.ndarray:
        samples = armed()
        running.session[udp_target.FAULTS] = packets.ACTUATOR
        return samples

    monkeypatch.setattr(rig, "arm", arm_and_fail)
    try:
        with pytest.raises(RigError, match="actuator"):
            exchange_delays(served.setup.case)(200.0, 0.2)
    finally:
        running.end()
