"""A target in plain Python, written from docs/reference/udp.md alone, whose answers a test may spoil."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import socket
import struct
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from bench import rig_info, specimen
from packets import Packet, opened, plain_siphash

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.rigs.interface import RigInfo
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

SECRET = bytes(range(200, 216))
PATIENT_S = 5.0
FOLDER = tempfile.TemporaryDirectory()  # for the key file; gone when the process ends
HELLO, WELCOME, REFUSAL, ARM, COMMAND, SAMPLES, REST, CLOSE = range(1, 9)
IDLE, ARMED, RESTING, RESTED = range(4)
BUSY, OF_THE_SESSION = 2, 1 | 8 | 64  # faults that end with it: watchdog, bad command, pace
Spoil = Callable[[int, bytes], list[bytes]]


def now_period() -> int:
    """Return the number of the current period, of 10 s, of a target's clock."""
    return time.monotonic_ns() // 10_000_000_000


def faithful(_: int, answer: bytes) -> list[bytes]:
    return [answer]


class PlainTarget:
    """A target in a thread: `table(None)` gives the first samples, `table(u)` those after u was held one interval.

    Each answer passes `spoil(sequence, answer)`, which returns what is sent instead. `obeyed` lists (sequence, V).
    """

    def __init__(
        self, secret: bytes, table: Callable[[float | None], Sequence[float]], channels: int = 3, port: int = 0
    ) -> None:
        self.secret, self.table, self.channels = secret, table, channels
        self.spoil: Spoil = faithful
        self.key: bytes | None = None
        self.boot, self.armed = secrets.token_bytes(32), 0  # what its nonces are computed from; sessions so far
        self.hellos = 0
        self.state, self.faults, self.lost, self.last, self.rests = IDLE, 0, 0, -1, 0
        self.latched_v = 0.0
        self.samples: Sequence[float] = [0.0] * channels
        self.obeyed: list[tuple[int, float]] = []
        self.received: list[Packet] = []
        self.door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.door.bind(("127.0.0.1", port))
        self.port: int = self.door.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def kill(self) -> None:
        """Stop, and leave the port closed."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join()
        self.door.close()

    def _serve(self) -> None:
        while True:
            data, address = self.door.recvfrom(2048)
            if not data:
                return
            if (hello := opened(data, self.secret)) is not None and hello.kind == HELLO:
                self.door.sendto(self.welcome(hello), address)
                continue
            packet = opened(data, self.key) if self.key is not None else None
            packet = packet or self._begun(data)
            if packet is not None and packet.sequence > self.last:
                for answer in self.spoil(packet.sequence, self._answer(packet)):
                    self.door.sendto(answer, address)

    def _nonce(self, runner_nonce: bytes, period: int) -> bytes:
        """Return this target's nonce for a runner's; how it is made is the target's own matter."""
        message = struct.pack("<2Q", self.armed, period) + runner_nonce
        return hmac.digest(self.boot, message, hashlib.sha256)[:16]

    def welcome(self, hello: Packet) -> bytes:
        """Return the answer to a HELLO: WELCOME, or REFUSAL while a session has the table."""
        self.hellos += 1
        runner, terms = hello.content[:16], hello.content[16:40]
        if self.state in (ARMED, RESTING):
            return Packet(REFUSAL, 0, runner + struct.pack("<2Q", BUSY, 0)).sealed(self.secret)
        return Packet(WELCOME, 0, runner + self._nonce(runner, now_period()) + terms).sealed(self.secret)

    def _begun(self, data: bytes) -> Packet | None:
        """Return the first ARM of a new session, which then is this target's."""
        if self.state in (ARMED, RESTING) or len(data) != 88:
            return None
        for period in (now_period(), now_period() - 1):
            nonces = data[40:56] + self._nonce(data[40:56], period)
            label = (b"rths-key" + struct.pack("<Q", i) for i in (0, 1))
            key = b"".join(plain_siphash(head + nonces, self.secret) for head in label)
            packet = opened(data, key)
            if packet is not None and packet.kind == ARM:
                self.key, self.armed = key, self.armed + 1
                self.state, self.lost, self.last, self.rests = IDLE, 0, -1, 0
                self.faults &= ~OF_THE_SESSION
                return packet
        return None

    def _answer(self, packet: Packet) -> bytes:
        self.received.append(packet)
        self.lost += packet.sequence - self.last - 1
        self.last = packet.sequence
        if packet.kind == ARM and self.state == IDLE:
            self.state, self.samples, self.latched_v = ARMED, self.table(None), 0.0
        elif packet.kind == COMMAND and self.state == ARMED:
            self.samples = self.table(self.latched_v)
            self.latched_v = struct.unpack("<d", packet.content[:8])[0]
            self.obeyed.append((packet.sequence, self.latched_v))
        elif packet.kind in (REST, CLOSE):
            self.rests += 1
            self.state = RESTING if self.rests < 3 else RESTED
        content = struct.pack(f"<{len(self.samples)}d", *self.samples)
        answer = Packet(SAMPLES, packet.sequence, content, self.state, self.faults, self.lost, 11, 7)
        assert self.key is not None
        return answer.sealed(self.key)


def virtual_table(info: RigInfo, seed: tuple[int, ...]) -> Callable[[float | None], Sequence[float]]:
    """Return a target's table that makes the rig behind UDP behave as the virtual rig of `info` does.

    The target latches at t_k+1 what was computed from t_k: one sample of the latency lies in the link.
    """
    within = replace(info, latency_samples=info.latency_samples - 1)
    rig = VirtualRig(within, build_plant(within, VirtualPhysics(), specimen(), 3e-4), seed)
    return lambda command_v: (rig.arm() if command_v is None else rig.exchange(command_v)).tolist()


def over_udp(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1), bits: int = 16) -> UdpRig:
    """Return the rig of the contract test, its table behind UDP in this process; the target ends with the tests."""
    info = rig_info(latency_samples=latency_samples, bits=bits)
    target = PlainTarget(SECRET, virtual_table(info, seed))
    key_file = Path(FOLDER.name) / "key"
    key_file.write_text(SECRET.hex())
    key_file.chmod(0o600)
    return UdpRig(info, UdpTarget("127.0.0.1", target.port, key_file, PATIENT_S))
