"""A server of the virtual table in a thread, for tests of both of its sides, and the table that it has to be."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.experiment import real_rig_readiness
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, open_rig
from rths_cli.identification import record_parts
from rths_cli.laboratory.serve import ServedRig, Server
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp.session import bound, read_secret
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget
from rths_cli.rigs.virtual.virtual_rig import virtual_rig

RATE_HZ = 200.0
WATCHDOG_S = 0.3  # a busy machine stops a test for a tenth of a second now and then


def leave_out_punctuality(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have no rehearsal, and let most of a record be lost: a busy machine loses more than a laboratory accepts."""
    monkeypatch.setattr(real_rig_readiness, "rehearsed", lambda *given: None)
    monkeypatch.setattr(record_parts, "MOST_MISSING", 0.9)


class Running:
    """A server in a thread of this process, and what a runner needs to reach it."""

    def __init__(
        self, served: ServedRig, key_file: Path, host: str = "127.0.0.1", watchdog_s: float = WATCHDOG_S
    ) -> None:
        self.served, self.key_file = served, key_file
        self.said: list[str] = []
        self.link = bound(host, 0)
        self.host, self.port = self.link.getsockname()[:2]
        self.server = Server(self.link, read_secret(key_file), served, round(1e9 * watchdog_s), self.said.append)
        self.server.start()
        self.thread = threading.Thread(target=self.server.run_for, args=(None,))
        self.thread.start()

    def end(self) -> None:
        self.server.end()
        self.thread.join(10)
        assert not self.thread.is_alive()
        self.link.close()

    def rig(self) -> UdpRig:
        return UdpRig(self.served.setup.rig, UdpTarget(self.host, self.port, self.key_file, 0.5, WATCHDOG_S))

    @property
    def session(self) -> Array:
        return self.server.door.session

    @property
    def counts(self) -> Array:
        return self.server.door.counts


def until(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for something that must come; the time is a bound for a broken program, not a measure."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def wave(steps: int) -> Array:
    t = np.arange(steps) / RATE_HZ
    return np.asarray(0.1 + 2.0 * np.sin(2 * np.pi * 2.0 * t) * np.minimum(t / 0.2, 1.0))


def held_in_ticks(commands: Array, ticks: Array, info: RigInfo) -> Iterator[list[float]]:
    """Yield what a target holds in the ticks, quarters of an interval, before each command: after two intervals without
    one it approaches them (docs/reference/udp.md)."""
    closing_m_s = info.limits.acceleration_m_s2 / (4.0 * np.pi * 14.0)
    fastest, closing = (v / info.gain_m_per_v / RATE_HZ for v in (info.limits.velocity_m_s, closing_m_s))
    held, last, late = 0.0, 0.0, False
    for k, (command, since) in enumerate(zip(commands, ticks, strict=True)):
        holds, moved, own = [], 0, 0.0
        for tick in range(since):
            if k > 0 and tick > 0 and tick % 4 == 0:
                most = min(closing, fastest) if late else fastest
                own = min(max(last - held, -most), most)
                held, moved = held + own, tick if own else moved
            holds.append(held)
        yield holds
        moves = abs(command - last) / max(since // 4, 1)
        if k > 0 and since >= 8:
            late, moves = True, max(moves, abs(own))
        most = min(moves + closing, fastest) * min(since - moved, 4) / 4
        held = float(held + min(max(command - held, -most), most) if late else command)
        late, last = late and not (held == command and 2 <= since < 8), command


def offline_in_ticks(served: ServedRig, commands: Array, ticks: Array) -> Array:
    """Return the samples of a table that is advanced tick by tick, from the offline rig's own code."""
    setup = served.setup
    info = replace(setup.rig, dt_s=setup.rig.dt_s / 4, latency_samples=0)
    rig = virtual_rig(setup.case.table, info, setup.building.specimen, 0.0, (0,), after_identification=True)
    rig.plant = rig.plant._replace(noise_rms_m_s2=0.0)
    noise = open_rig(setup, (EXP_RTHS,), 0).noise(len(commands) + 1)
    scale = setup.case.table.sensors.noise_rms_m_s2 * setup.rig.channels[0].sensitivity_v_per_unit
    made, now = [rig.arm() + scale * noise[0]], rig.arm().copy()
    for k, holds in enumerate(held_in_ticks(commands, ticks, info)):
        for held in holds:
            now = rig.exchange(held).copy()
        made.append(now + scale * noise[k + 1])
    return np.array(made)
