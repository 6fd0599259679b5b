"""`rths bridge opensees`: a client of OpenFresco's generic protocol moves a displacement rig from rest to rest."""

from __future__ import annotations

import csv
import json
import math
import os
import queue
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError, LimitError, RigError, RthsError
from rths_cli.laboratory.bridge import Bridged, BridgeRequest, bridge_opensees

SIZES = (1, 1, 1, 0, 1, 0, 0, 0, 1, 0, 256)  # as the package opensees 0.1.32 sends them for one -dof
STIFFNESS = 1.19e6  # N/m, configs/structures/actuator_frame.yaml
TRIAL, COMMIT, DISPLACEMENT, FORCE, STIFF, END = 3.0, 5.0, 7.0, 10.0, 12.0, 99.0
Act = Callable[["Peer"], None]


class Peer:
    """The client's end, written by what was seen on the wire."""

    def __init__(self, port: int, sizes: tuple[int, ...] = SIZES) -> None:
        self.link, self.length = socket.create_connection(("127.0.0.1", port), 20.0), sizes[10]
        self.link.sendall(struct.pack("<11i", *sizes))

    def say(self, command: float, displacement: float = 0.0, time_s: float = 0.0) -> None:
        values = [command, displacement, 0.0, 0.0, time_s, *[0.0] * (self.length - 5)]
        self.link.sendall(struct.pack(f"<{self.length}d", *values))

    def ask(self, command: float) -> float:
        self.say(command)
        got = b""
        while len(got) < 8 * self.length:
            more = self.link.recv(8 * self.length - len(got))
            if not more:
                raise EOFError
            got += more
        return struct.unpack(f"<{self.length}d", got)[0]


def request(folder: Path, **changes: object) -> BridgeRequest:
    usual = BridgeRequest(
        "el_centro_actuator", (), "mm", "kN", "127.0.0.1", 0, 0.05, 0.1, None, 20.0, folder / "test.csv"
    )  # fmt: skip
    return replace(usual, **changes)


def served(asked: BridgeRequest, act: Act, sizes: tuple[int, ...] = SIZES) -> Bridged:
    """Return what the bridge gives for a client that acts in a thread of its own."""
    ports: queue.Queue[int] = queue.Queue()

    def client() -> None:
        peer = Peer(ports.get(timeout=60), sizes)
        try:
            act(peer)
        except (OSError, EOFError):
            pass  # the bridge has left
        finally:
            peer.link.close()

    def say(line: str) -> None:
        if "-server" in line:
            ports.put(int(line.split()[-2]))

    thread = threading.Thread(target=client, daemon=True)
    thread.start()
    try:
        return bridge_opensees(asked, say)
    finally:
        thread.join(20.0)


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#")))


def test_forces_are_those_of_the_spring_at_the_displacements_asked_for(tmp_path: Path) -> None:
    places, found = (0.0, 4.0, -6.5, -6.5, 0.1), []

    def act(peer: Peer) -> None:
        found.append(peer.ask(STIFF))
        for k, place in enumerate(places):
            peer.say(TRIAL, place, 0.01 * k)
            found.append((peer.ask(FORCE), peer.ask(DISPLACEMENT)))
            peer.say(COMMIT, place, 0.01 * k)
        peer.say(END)

    made = served(request(tmp_path), act)
    assert found[0] == pytest.approx(1e-6 * STIFFNESS)  # kN/mm
    forces, shown = np.array(found[1:]).T
    # the place that is shown misses by the tolerance, and its noise is allowed for by the tolerance too
    bound_m = 2.0 * made.tolerance_m + 4.0 * made.force_error_n / STIFFNESS
    assert np.abs(shown - places).max() < 1e3 * made.tolerance_m
    assert np.abs(1e3 * forces - STIFFNESS * 1e-3 * np.array(places)).max() < STIFFNESS * bound_m
    assert 0.25 < made.force_error_n < 0.8  # 2.2 N of noise, the mean of 50 samples; some settling
    assert bound_m < 2e-5 and made.steps == 5 and made.moves == 4  # the same displacement again is no move
    kept = rows(made.file)
    assert [float(row["target_m"]) for row in kept] == pytest.approx([0.0, 0.004, -0.0065, 1e-4])
    assert [float(row["force_n"]) for row in kept] == pytest.approx(1e3 * forces[[0, 1, 2, 4]])
    assert made.file.read_text().splitlines()[-1] == "# ended after 5 steps: complete"


def leaves(peer: Peer) -> None:
    peer.say(TRIAL, 1.0)
    peer.ask(FORCE)


def moves(displacement: float) -> Act:
    def act(peer: Peer) -> None:
        leaves(peer)
        peer.say(TRIAL, displacement, 0.02)
        peer.ask(FORCE)

    return act


def speaks_otherwise(peer: Peer) -> None:
    leaves(peer)
    peer.say(42.0)
    peer.ask(FORCE)


def is_silent(peer: Peer) -> None:
    leaves(peer)
    time.sleep(1.0)


FAULTS: dict[str, tuple[Act, type[RthsError], str]] = {
    "leaves": (leaves, RigError, "left without ending the test"),
    "silent": (is_silent, RigError, "silent for 0.5 s"),
    "no number": (moves(math.nan), LimitError, "sent nan as a displacement at t = 0.02 s"),
    "beyond the stroke": (moves(41.0), LimitError, "at t = 0.02 s a displacement of 41 mm is asked for, the limit"),
    "beyond the force": (moves(7.5), LimitError, "takes about 8926 N"),
    "unknown": (speaks_otherwise, RigError, "the command 42"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_client_is_one_sentence_and_keeps_what_was_measured(tmp_path: Path, fault: str) -> None:
    act, kind, told = FAULTS[fault]
    asked = request(tmp_path, silent_after_s=0.5, hold_s=0.02)
    with pytest.raises(kind, match=told) as caught:
        served(asked, act)
    assert asked.output is not None
    (row,) = rows(asked.output)
    assert float(row["force_n"]) == pytest.approx(1e-3 * STIFFNESS, rel=0.03)
    assert asked.output.read_text().splitlines()[-1] == f"# ended after 0 steps: {caught.value}"


@pytest.mark.parametrize(
    ("sizes", "told"),
    [
        ((2, 2, 2, 0, 1, 0, 0, 0, 2, 0, 256), "controls 2 displacements, 2 velocities"),
        ((1, 0, 0, 0, 0, 0, 0, 0, 3, 0, 256), "wants 3 forces"),
        ((1, 1, 1, 0, 1, 0, 0, 0, 1, 0, 3), "does not speak"),
        (struct.unpack("<11i", b"GET / HTTP/1.1".ljust(44)), "does not speak"),
    ],
)
def test_a_client_of_another_rig_writes_nothing(tmp_path: Path, sizes: tuple[int, ...], told: str) -> None:
    with pytest.raises(InputError, match=told):
        served(request(tmp_path), lambda peer: None, sizes)
    assert not list(tmp_path.iterdir())


def test_a_sensor_that_shows_something_else_stops_the_test(tmp_path: Path) -> None:
    """A gain error of 30 % is no miss to be corrected."""
    wrong = ("table.imperfections.displacement_gain_error=-0.3",)
    with pytest.raises(RigError, match=r"shows .* mm where 1 mm were commanded"):
        served(request(tmp_path, settings=wrong), leaves)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"case": "el_centro_low_ff"}, "follows an acceleration"),
        ({"host": "8.8.8.8"}, "is not private"),
        ({"host": "0.0.0.0"}, "is not private"),
        ({"rate_m_s": 2.0}, "above limits.velocity_m_s"),
        ({"output": Path(__file__)}, "is not replaced"),
        ({"output": Path("/nowhere/a.csv")}, "there is no folder"),
    ],
)
def test_what_the_command_cannot_do_is_said_before_it_listens(
    tmp_path: Path, changes: dict[str, object], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        bridge_opensees(request(tmp_path, **changes), lambda _: pytest.fail("it listened"))


def process(folder: Path, *words: str) -> tuple[subprocess.Popen[str], int]:
    """Return the command as a process, and the port at which it listens."""
    command = [sys.executable, "-m", "rths_cli", "bridge", "opensees", "el_centro_actuator", "--length", "m"]
    command += ["--force", "N", "--port", "0", "--output", str(folder / "test.csv"), *words]
    made = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert made.stdout
    made.stdout.readline()
    return made, int(made.stdout.readline().split()[-2])


@pytest.mark.campaign
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -9)])
def test_a_signal_leaves_what_was_measured(tmp_path: Path, number: int, code: int) -> None:
    running, port = process(tmp_path)
    peer = Peer(port)
    for k in range(20):
        peer.say(TRIAL, 1e-3 * math.sin(0.3 * k))
        peer.ask(FORCE)
    os.kill(running.pid, number)
    running.communicate(timeout=20)
    assert running.returncode == code and len(rows(tmp_path / "test.csv")) == 20
    last = (tmp_path / "test.csv").read_text().splitlines()[-1]
    assert last.startswith("# ended after 0 steps: by a signal") == (number != signal.SIGKILL)


SCRIPT = """
import math, sys
import openseespy.opensees as ops
ops.model("basic", "-ndm", 1, "-ndf", 1)
for node in (1, 2, 3, 4, 9):
    ops.node(node, 0.0)
ops.fix(1, 1)
ops.fix(9, 1)
ops.uniaxialMaterial("Elastic", 1, 1.2e4)
ops.uniaxialMaterial("Elastic", 2, 1.19e3)
for below in (1, 2, 3):
    ops.mass(below + 1, 2.0)
    ops.element("zeroLength", below, below, below + 1, "-mat", 1, "-dir", 1)
if int(sys.argv[1]):
    ops.element("genericClient", 9, "-node", 4, "-dof", 1, "-server", int(sys.argv[1]), "127.0.0.1")
else:
    ops.element("zeroLength", 9, 9, 4, "-mat", 2, "-dir", 1)
pulse = [6e3 * math.sin(0.1068 * k) * math.sin(math.pi * k / 100) ** 2 for k in range(101)]
ops.timeSeries("Path", 1, "-dt", 0.01, "-values", *pulse)
ops.pattern("UniformExcitation", 1, 1, "-accel", 1)
ops.constraints("Plain")
ops.numberer("Plain")
ops.system("FullGeneral")
ops.algorithm("Linear")
ops.integrator("NewmarkExplicit", 0.5)
ops.analysis("Transient")
for _ in range(100):
    assert ops.analyze(1, 0.01) == 0
    print(repr(ops.nodeDisp(4, 1)))
ops.wipe()
"""
"""The structure of the case in N, mm, s, with its specimen as a client of the rig or as a spring."""


@pytest.mark.campaign
def test_an_opensees_script_gets_the_response_of_the_same_script_with_a_spring(tmp_path: Path) -> None:
    pytest.importorskip("opensees")
    alias = "import sys, types, opensees.openseespy as o; m = types.ModuleType('openseespy'); m.opensees = o\n"
    alias += "sys.modules['openseespy'], sys.modules['openseespy.opensees'] = m, o\n"
    (tmp_path / "script.py").write_text(alias + SCRIPT)

    def response(port: int) -> np.ndarray:
        command = [sys.executable, str(tmp_path / "script.py"), str(port)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
        return np.array(done.stdout.split(), dtype=float)

    words = [sys.executable, "-m", "rths_cli", "bridge", "opensees", "el_centro_actuator", "--length", "mm"]
    words += ["--force", "N", "--port", "18092", "--rate", "0.05", "--json", "--output", str(tmp_path / "test.csv")]
    running = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stderr
    while "-server" not in (line := running.stderr.readline()):
        assert line
    hybrid, spring = response(18092), response(0)
    found = json.loads(running.communicate(timeout=60)[0])
    assert found["exit_code"] == 0 and found["steps"] == 100 and found["moves"] == 100
    assert np.abs(hybrid - spring).max() < 1e3 * found["tolerance_m"] < 0.002 * np.abs(spring).max()
