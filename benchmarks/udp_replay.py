"""Replay captured packets at a target and its runner, at the start, in motion and at the end of sessions.

python benchmarks/udp_replay.py [--count 100000] [--rate 10000] [--seed 0] [--target serve|c|plain] [--seconds 600]

A relay between runner and target captures all packets of earlier sessions and of the present one, and sends them again
in random order, `--rate` a second, until `--count` of each of HELLO, WELCOME, ARM, REST and CLOSE were sent in each of
the three moments. Packets of a runner go to the target, those of a target to both; what is genuine and no command goes
out twice, up to 15 ms late, and so in another order. In the earlier sessions the runner
commands 1 V, in the ones under attack 0 V, so that a command obeyed by mistake shows in the samples.
Exit code 1 where a start was denied, a command obeyed, a table not confirmed at rest, or, of `rths serve`, a moment
took more than 20 % of a processor. `plain` is the target in Python that was written from docs/reference/udp.md
(tests/helpers/udp_peer.py), in the runner's process.
"""

from __future__ import annotations

import heapq
import multiprocessing
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from options import arguments, parsed

TREE = Path(__file__).parents[1]
sys.path.insert(0, str(TREE / "tests" / "helpers"))

from udp_peer import PlainTarget  # noqa: E402

from rths_cli.errors import RigError  # noqa: E402
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo  # noqa: E402
from rths_cli.rigs.udp import packets  # noqa: E402
from rths_cli.rigs.udp.session import make_secret  # noqa: E402
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget  # noqa: E402

SHORT = ("--count", "50", "--seconds", "5")

KINDS = {
    "HELLO": packets.HELLO,
    "WELCOME": packets.WELCOME,
    "ARM": packets.ARM,
    "REST": packets.REST,
    "CLOSE": packets.CLOSE,
}
FROM_TARGET = (packets.WELCOME, packets.REFUSAL, packets.SAMPLES)
MOMENTS = ("start", "motion", "end")
DT_S, EARLIER, MOVED_V, MOST_CPU = 5e-3, 5, 0.05, 0.20
SENT_AGAIN = np.array([*KINDS.values(), *KINDS.values(), packets.COMMAND, packets.SAMPLES])
MOST_KEPT, LATE_S = 2000, 0.015
Address = tuple[str, int]
WATCHDOG_S = 5.0  # a machine that others use stops a runner for a second now and then
IDLE_S, STEPS, AFTER_S = 0.5, 100, 0.3  # of each session under attack


class Line:
    """A relay in a process of its own: passes packets, captures them, and sends captured ones again when told to."""

    def __init__(self, port: int, rate_hz: float, seed: int) -> None:
        self._ours, theirs = multiprocessing.Pipe()
        front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        front.bind(("127.0.0.1", 0))
        self.port: int = front.getsockname()[1]
        relay = Relay(theirs, front, port, rate_hz, seed)
        self._process = multiprocessing.get_context("fork").Process(target=relay.run, daemon=True)
        self._process.start()
        front.close()

    def attack(self, going: bool) -> None:
        """Begin or end to send captured packets again."""
        self._ours.send(going)

    def told(self) -> tuple[Counter[int], int, float]:
        """Return how many of each kind were sent again since last asked, HELLO nonces seen, and seconds of attack."""
        self._ours.send(None)
        sent, nonces, seconds = self._ours.recv()
        return Counter(sent), nonces, seconds

    def end(self) -> None:
        self._process.kill()
        self._process.join()


class Relay:
    """What the process of a line does: pass, capture, and send again."""

    def __init__(self, orders: Connection, front: socket.socket, port: int, rate_hz: float, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        self.orders, self.front, self.rate_hz = orders, front, rate_hz
        self.back, self.stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in "12")
        for door in (self.back, self.stranger):
            door.connect(("127.0.0.1", port))
        self.runner: Address = ("127.0.0.1", 9)
        self.captured: dict[int, list[bytes]] = {kind: [] for kind in range(256)}
        self.nonces: set[bytes] = set()
        self.sent, self.spent_s = Counter[int](), 0.0
        self.going, self.begun, self.allowed, self.turn = False, 0.0, 0.0, 0
        self.held: list[tuple[float, int, socket.socket, bytes]] = []  # packets that are going to be late

    def run(self) -> None:
        """Pass packets for ever; attack when told to."""
        doors = [self.front, self.back, self.stranger, self.orders]
        while True:
            for door in select.select(doors, [], [], 0.0005 if self.going or self.held else 0.02)[0]:
                if door is self.orders:
                    self.obey(self.orders.recv())
                else:
                    self.pass_on(door)
            while self.held and self.held[0][0] <= time.monotonic():
                self.post(*heapq.heappop(self.held)[2:])
            if self.going:
                self.attack()

    def obey(self, order: bool | None) -> None:
        """Begin or end an attack, or tell what was sent."""
        if order is None:
            self.orders.send((dict(self.sent), len(self.nonces), self.spent_s))
            self.sent.clear()
            self.nonces.clear()
            self.spent_s = 0.0
        else:
            self.going, self.begun, self.allowed = order, time.monotonic(), 0.0

    def pass_on(self, door: socket.socket) -> None:
        """Capture a packet and pass it on; under attack, what is no command or its answer is doubled and reordered."""
        try:
            packet, sender = door.recvfrom(2048)
        except OSError:  # the other side's port is closed
            return
        if door is self.stranger:
            return  # an answer to what was sent again
        keep = self.captured[packet[packets.KIND]]
        keep.append(packet)
        if len(keep) > MOST_KEPT:
            del keep[int(self.random.integers(MOST_KEPT // 2))]
        if door is self.front:
            self.runner = sender
        if packet[packets.KIND] == packets.HELLO:
            self.nonces.add(packet[packets.WORDS : packets.AFTER_NONCE])
        other = self.back if door is self.front else self.front
        if self.going and packet[packets.KIND] not in (packets.COMMAND, packets.SAMPLES):
            for late_s in (0.0, LATE_S)[int(self.random.integers(2)) :]:
                due = time.monotonic() + late_s * self.random.random()
                heapq.heappush(self.held, (due, self.turn, other, packet))
                self.turn += 1
        else:
            self.post(other, packet)

    def attack(self) -> None:
        """Send as many captured packets as the rate allows by now: every other one of the newest, the rest of any."""
        now = time.monotonic()
        self.allowed = min(self.allowed + self.rate_hz * (now - self.begun), 50.0)
        self.spent_s, self.begun = self.spent_s + now - self.begun, now
        for kind in self.random.choice(SENT_AGAIN, int(self.allowed)):
            self.allowed -= 1.0
            self.turn += 1
            keep = self.captured[kind]
            if keep:
                newest = min(len(keep), 4 if self.turn % 2 else MOST_KEPT)
                to_runner = kind in FROM_TARGET and self.turn % 4 < 2
                self.post(self.front if to_runner else self.stranger, keep[-1 - int(newest * self.random.random())])
                self.sent[int(kind)] += 1

    def post(self, door: socket.socket, packet: bytes) -> None:
        """Send a packet; a closed port is the receiver's matter."""
        try:
            if door is self.front:
                door.sendto(packet, self.runner)
            else:
                door.send(packet)
        except OSError:
            return


@dataclass
class Target:
    """Something to attack."""

    port: int
    key_file: Path
    pid: int = 0  # of a process of its own
    sessions: Callable[[], list[int]] | None = None  # commands of each that it says it obeyed, once it is ended


@dataclass
class Found:
    """What the campaign showed."""

    rounds: int = 0
    sent: dict[str, Counter[int]] = field(default_factory=lambda: {moment: Counter() for moment in MOMENTS})
    attack_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(MOMENTS, 0.0))
    cpu_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(MOMENTS, 0.0))
    wall_s: dict[str, float] = field(default_factory=lambda: dict.fromkeys(MOMENTS, 0.0))
    retries: int = 0
    faults: list[str] = field(default_factory=list)
    largest_v: float = 0.0
    lost: int = 0


def rest_info() -> RigInfo:
    """Return a rig of three channels."""
    channels = tuple(Channel(name, 0.1, 50.0, 0.0, 0.0) for name in ("table", "floor 1", "floor 2"))
    limits = Limits(0.079, 1.0, 45.0, 445.0)
    return RigInfo("replayed", "udp", DT_S, channels, Converters(16, 10.0), 1, limits, 0.0079, 7.0, 13.86)


def session(rig: UdpRig, command_v: float, steps: int) -> None:
    """Play one session without an attack."""
    rig.open()
    rig.arm()
    for k in range(steps):
        rig.exchange(command_v * min(k / 20, 1.0, (steps - k) / 20))
    rig.rest()
    rig.close()


def cpu_s(pid: int) -> float:
    """Return the processor time that a process has taken, in s."""
    if not pid:
        return 0.0
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def campaign(target: Target, line: Line, count: int, seconds: float) -> Found:
    """Attack session after session until enough was sent in each moment, or the time is over."""
    found, end = Found(), time.monotonic() + seconds
    reached = UdpTarget("127.0.0.1", line.port, target.key_file, watchdog_s=WATCHDOG_S, lost_samples=150)
    rig = UdpRig(rest_info(), reached)
    for _ in range(EARLIER):
        session(rig, 1.0, STEPS)

    @contextmanager
    def moment(name: str) -> Iterator[None]:
        line.told()
        before, start = cpu_s(target.pid), time.monotonic()
        line.attack(True)
        yield
        line.attack(False)
        found.wall_s[name] += time.monotonic() - start
        found.cpu_s[name] += cpu_s(target.pid) - before
        sent, nonces, spent_s = line.told()
        found.sent[name] += sent
        found.attack_s[name] += spent_s
        found.retries += max(nonces - 1, 0)
        if nonces > 2:
            found.faults.append(f"round {found.rounds}: {nonces} greetings")

    def enough() -> bool:
        return all(found.sent[name][kind] >= count for name in MOMENTS for kind in KINDS.values())

    while time.monotonic() < end and not enough():
        found.rounds += 1
        try:
            with moment("start"):
                time.sleep(IDLE_S)
                rig.open()
                rig.arm()
            with moment("motion"):
                for _ in range(STEPS):
                    found.largest_v = max(found.largest_v, float(np.abs(rig.exchange(0.0)).max()))
            with moment("end"):
                rig.rest()
                if not rig.at_rest:
                    found.faults.append(f"round {found.rounds}: not confirmed at rest")
                time.sleep(AFTER_S)
                found.lost += rig.counts["lost"]
                rig.close()
        except RigError as fault:
            line.attack(False)
            found.faults.append(f"round {found.rounds}: {fault}")
            rig.close()
    return found


def show(found: Found, target: Target) -> bool:
    """Print what was found; return whether all is well."""
    well = not found.faults and found.largest_v < MOVED_V
    print(f"{found.rounds} sessions under attack, {found.retries} begun a second time, {found.lost} answers lost")
    for name in MOMENTS:
        kinds = ", ".join(f"{kind} {found.sent[name][number]}" for kind, number in KINDS.items())
        rate = sum(found.sent[name].values()) / max(found.attack_s[name], 1e-9)
        share = found.cpu_s[name] / max(found.wall_s[name], 1e-9)
        print(f"  {name:<7}{kinds}; {rate:.0f}/s; target {100 * share:.1f} % of a processor")
        well = well and share < MOST_CPU
    print(f"  largest sample {found.largest_v:.4f} V{'' if found.largest_v < MOVED_V else ' (MOVED)'}")
    for fault in found.faults[:20]:
        print(f"  {fault}")
    return well


@contextmanager
def served(folder: Path) -> Iterator[Target]:
    """Start `rths serve`, and see at its end that it obeyed no more commands than were sent."""
    key_file = folder / "key"
    make_secret(key_file)
    words = [sys.executable, "-m", "rths_cli", "serve", "--port", "0", "--key-file", str(key_file)]
    words += ["--watchdog", str(WATCHDOG_S)]
    env = {**os.environ, "PYTHONPATH": str(TREE)}
    with open(folder / "said", "w+") as said:
        process = subprocess.Popen(words, stdout=said, text=True, env=env)
        found = None
        while found is None and process.poll() is None:
            time.sleep(0.1)
            found = re.search(r" at .+:(\d+);", (folder / "said").read_text())
        assert found is not None

        def sessions() -> list[int]:
            process.terminate()
            process.wait()
            return [int(number) for number in re.findall(r"Hz: (\d+) commands", (folder / "said").read_text())]

        yield Target(int(found[1]), key_file, process.pid, sessions)
        process.kill()


@contextmanager
def example(folder: Path) -> Iterator[Target]:
    """Start the example in C."""
    program, key_file = folder / "udp_target", folder / "key"
    make_secret(key_file)
    source = TREE / "examples" / "udp_target_pc.c"
    subprocess.run([str(shutil.which("cc")), "-std=c99", "-O2", "-o", program, source], check=True)
    process = subprocess.Popen([program, "0", key_file], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    yield Target(int(process.stdout.readline().rpartition(":")[2]), key_file, process.pid)
    process.kill()


@contextmanager
def plain(folder: Path) -> Iterator[Target]:
    """Start the target in plain Python, written from docs/reference/udp.md."""
    key_file, held = folder / "key", [0.0]
    make_secret(key_file)

    def table(command_v: float | None) -> list[float]:
        held[0] = command_v or 0.0
        return [held[0]] * 3

    target = PlainTarget(bytes.fromhex(key_file.read_text().strip()), table)
    yield Target(target.port, key_file)
    target.kill()


TARGETS = {"serve": served, "c": example, "plain": plain}


def main() -> int:
    """Attack what is asked for, print what was found; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("--count", type=int, default=100_000)
    parser.add_argument("--rate", type=float, default=10_000.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--target", choices=list(TARGETS), default="serve")
    asked = parsed(parser, SHORT)
    with tempfile.TemporaryDirectory() as folder, TARGETS[asked.target](Path(folder)) as target:
        line = Line(target.port, asked.rate, asked.seed)
        found = campaign(target, line, asked.count, asked.seconds)
        line.end()
        well = show(found, target)
        if target.sessions is not None:
            obeyed = target.sessions()
            well = well and len(obeyed) == EARLIER + found.rounds and max(obeyed) <= STEPS
            print(
                f"  {len(obeyed)} sessions served of {EARLIER + found.rounds}, each of {max(obeyed)} commands at most"
            )
    print("as it must be" if well else "NOT AS IT MUST BE")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
