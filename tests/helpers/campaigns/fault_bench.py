"""A served table, a network that can be spoilt, and `rths run` between them, as three processes to be mistreated."""

from __future__ import annotations

import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from packets import Packet, opened, plain_siphash
from smooth_way import smooth_way
from udp_relay import Mishap, Relay, as_it_came

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache, save
from rths_cli.experiment.setup import make_setup
from rths_cli.rigs.udp.session import make_secret

HERE = Path(__file__).parent
TREE = HERE.parents[2]
RATE_HZ, RECORD_S = 500, 4.5
HELLO, WELCOME, ARM, COMMAND = 1, 2, 4, 5
SESSIONS = 3  # of a run: listening before its file begins, listening again, the run itself
PATIENCE_S = 90.0
CASE = "structure: three_storey\ndamping: low\nrecord: ./short.csv\nscaling: 0.3\ncontroller: FF+FB\n"
STROKE_M, VELOCITY_M_S, RANGE_V, GAIN_M_PER_V = 0.079, 1.0, 10.0, 0.0079  # of udp_loopback
FASTEST_V = VELOCITY_M_S / GAIN_M_PER_V / RATE_HZ  # in an interval
Passed = tuple[float, bytes]


def make_files(folder: Path, rig: str) -> None:
    """Write record, case, rig file, key and model of a rig of this name into a folder."""
    time_s = np.arange(0.0, RECORD_S, 0.01)
    accel = 4.0 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / RECORD_S) ** 2
    rows = "\n".join(f"{value:.6g}" for value in accel)
    (folder / "short.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{rows}\n")
    (folder / "a.yaml").write_text(CASE)
    (folder / f"{rig}.yaml").write_text((TREE / "configs" / "rigs" / "udp_loopback.yaml").read_text())
    make_secret(folder / "key")
    settings = (f"sample_rate_hz={RATE_HZ}",)
    known = Memory(Cache()).known(make_setup(load_cases([str(folder / "a.yaml")], settings)[0]), lambda _: None)
    served = (*settings, f"table={folder / rig}.yaml")
    save(folder / "model.h5", make_setup(load_cases([str(folder / "a.yaml")], served)[0]), known.found, "virtual", "")


class Served:
    """`rths serve` as a process; `lines` are what it said, with the time it said it."""

    def __init__(self, folder: Path) -> None:
        words = [sys.executable, "-m", "rths_cli", "serve", "--port", "0", "--key-file", str(folder / "key")]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment())
        assert self.process.stdout is not None
        found = re.search(r" at .+:(\d+);", self.process.stdout.readline())
        assert found is not None
        self.port = int(found[1])
        self.lines: list[tuple[float, str]] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append((time.monotonic(), line.strip()))

    def send(self, number: int) -> None:
        if self.process.poll() is None:
            self.process.send_signal(number)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


class Network:
    """A relay that keeps what it delivered, and knows when the run itself, after the listening, begins."""

    def __init__(self, port: int) -> None:
        self.relay = Relay("127.0.0.1", port)
        self.began = threading.Event()
        self.to_target: Mishap = as_it_came
        self.to_runner: Mishap = as_it_came
        self.came: list[bytes] = []  # all that the runner sent
        self.forth: list[Passed] = []
        self.back: list[Passed] = []
        self.greeted: list[bytes] = []
        self.relay.to_target, self.relay.to_runner = self._forth, self._back

    def _forth(self, packet: bytes) -> list[tuple[float, bytes]]:
        if packet[5] == HELLO and packet[40:56] not in self.greeted:
            self.greeted.append(packet[40:56])
        if packet[5] == COMMAND and len(self.greeted) == SESSIONS:
            self.began.set()
        self.came.append(packet)
        out = self.to_target(packet)
        self.forth += [(time.monotonic() + delay, one) for delay, one in out]
        return out

    def _back(self, packet: bytes) -> list[tuple[float, bytes]]:
        out = self.to_runner(packet)
        self.back += [(time.monotonic() + delay, one) for delay, one in out]
        return out

    def commands(self, secret: bytes) -> list[Packet]:
        """Return the genuine commands of the run that the target was given and had to obey, their sequence the place
        among all commands that the runner sent: it leaves out one where the network lost a command, not where the
        runner missed an instant."""
        nonces = [one[40:72] for _, one in self.back if one[5] == WELCOME and one[40:56] == self.greeted[-1]]
        if not nonces:
            return []
        labels = (b"rths-key" + struct.pack("<Q", i) for i in (0, 1))
        key = b"".join(plain_siphash(label + nonces[0], secret) for label in labels)
        obeyed: list[Packet] = []
        for _, data in sorted(self.forth, key=lambda passed: passed[0]):
            packet = opened(data, key)
            newest = obeyed[-1].sequence if obeyed else -1
            if packet is not None and packet.kind == COMMAND and packet.sequence > newest:
                obeyed.append(packet)
        sent = [packet.sequence for data in self.came if (packet := opened(data, key)) and packet.kind == COMMAND]
        place = {sequence: i for i, sequence in enumerate(sent)}
        return [replace(packet, sequence=place[packet.sequence]) for packet in obeyed]


def _way(packet: Packet, count: int) -> NDArray[np.float64]:
    """Return where a command is in each of `count` intervals by its preview (docs/reference/udp.md), in V."""
    words = len(packet.content) // 8
    if words < 3:
        return np.full(count, struct.unpack("<d", packet.content[:8])[0])
    command, spacing, *points = struct.unpack(f"<dq{words - 2}d", packet.content)
    return smooth_way((command, *points), spacing, count)


def _steps(earlier: Packet | None, later: Packet) -> tuple[float, float]:
    """Return two steps that a command makes, each in V per interval: from where the target stood, having gone on as the
    one before told (by the times at which both were sent), where none was lost between them; and from the command
    before, over the intervals since. The velocity limit holds for both."""
    volts = float(_way(later, 1)[0])
    if earlier is None:
        return volts, volts
    since = max(round(1e-9 * (later.sent_ns - earlier.sent_ns) * RATE_HZ), 1)
    way = _way(earlier, since)
    lost = later.sequence - earlier.sequence > 1
    mean = (volts - way[0]) / max(since, later.sequence - earlier.sequence)
    most, stood = min(RANGE_V, STROKE_M / GAIN_M_PER_V), way[0]
    for place in way[1:]:
        stood = min(max(stood + min(max(place - stood, -FASTEST_V), FASTEST_V), -most), most)
    return mean if lost else volts - stood, mean


def _steepest(packet: Packet) -> float:
    """Return the largest step in an interval that a command tells its target to make after it, in V."""
    words = len(packet.content) // 8
    if words < 3:
        return 0.0
    spacing = struct.unpack("<q", packet.content[8:16])[0]
    return float(np.abs(np.diff(_way(packet, (words - 2) * spacing + 1))).max())


class Host:
    """How long the host of a virtual machine took a processor from us, read 20 times a second from /proc/stat.

    `longest_s` within any 0.1 s since `begin`; 0 for ever where the kernel is not told of it (steal).
    """

    def __init__(self) -> None:
        self.longest_s = 0.0
        self._ended = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def begin(self) -> None:
        self.longest_s = 0.0

    def end(self) -> None:
        self._ended.set()

    def _watch(self) -> None:
        before = [stolen_s()] * 2
        while not self._ended.wait(0.05):
            now = stolen_s()
            self.longest_s = max(self.longest_s, float((now - before[0]).max()))
            before = [*before[1:], now]


def stolen_s() -> NDArray[np.float64]:
    """Return how long the host kept each processor from us while we wanted it, since the machine started."""
    lines = [line.split() for line in Path("/proc/stat").read_text().splitlines() if re.match(r"cpu\d", line)]
    return np.array([float(words[8]) for words in lines]) / os.sysconf("SC_CLK_TCK")


def environment(**more: str) -> dict[str, str]:
    """Return the environment of a process that imports this tree."""
    return {**os.environ, "PYTHONPATH": str(TREE), **more}


@dataclass
class Bench:
    """One run under way: what a fault may take hold of."""

    folder: Path
    served: Served
    spare: Served
    network: Network
    random: np.random.Generator
    runner: subprocess.Popen[str]
    at_s: float = 0.0  # when the fault came
    notes: list[str] = field(default_factory=list)

    def kill_runner(self, number: int) -> None:
        self.runner.send_signal(number)


def used(commands: list[Packet]) -> dict[str, float]:
    """Return the largest share of each limit that a target saw, its table at rest at 0 V before.

    The velocity is the largest of the two steps of each command, and of those that they tell the target to make after.
    """
    if not commands:
        return dict.fromkeys(("stroke", "velocity", "range"), 0.0)
    place = GAIN_M_PER_V * np.array([_way(one, 1)[0] for one in commands])
    steps = np.array([_steps(*two) for two in zip([None, *commands[:-1]], commands, strict=True)])
    told = np.array([_steepest(one) for one in commands])
    velocity = GAIN_M_PER_V * RATE_HZ * np.append(steps, told)
    worst = {
        "stroke": np.abs(place).max() / STROKE_M,
        "velocity": np.abs(velocity).max() / VELOCITY_M_S,
        "range": np.abs(place).max() / GAIN_M_PER_V / RANGE_V,
    }
    return {name: float(share) if np.isfinite(share) else np.inf for name, share in worst.items()}


def start_runner(
    folder: Path, output: Path, rig: str, port: int, preexec: Callable[[], None] | None, more: dict[str, str]
) -> subprocess.Popen[str]:
    """Start `rths run` against a port, which the rig's own file alone may state."""
    file = folder / f"{rig}.yaml"
    file.write_text(re.sub(r"port: \d+", f"port: {port}", file.read_text()))
    sets = (
        f"table={file}", f"sample_rate_hz={RATE_HZ}",
        f"identification.model={folder / 'model.h5'}", "runs=[sim, exp_rths]",
    )  # fmt: skip
    words = [sys.executable, str(HERE / "fault_runner.py"), "run", str(folder / "a.yaml"), "--yes"]
    words += ["--override", "model", "--override", "check", "--output", str(output), "--quiet"]
    words += [word for one in sets for word in ("--set", one)]
    env = environment(RTHS_KEY_FILE=str(folder / "key"), **more)
    return subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env, preexec_fn=preexec
    )


def frozen(process: subprocess.Popen[str], seconds: float) -> None:
    """Stop a process for a while."""
    process.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    process.send_signal(signal.SIGCONT)
