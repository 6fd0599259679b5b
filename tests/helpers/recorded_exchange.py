"""The runner's side of one session over UDP, on a counted clock and a scripted network: every packet that it sends.

    python recorded_exchange.py record FILE     # a table answers; keep what was sent and what came
    python recorded_exchange.py replay FILE     # what came then comes again; print what is sent as JSON

A program of its own, because it puts a clock, `send` and `recv` in the place of the C library's for all compiled code
of the process. Time passes only where the loop sleeps or waits for a packet, so that no processor is ever late.
"""

from __future__ import annotations

import ctypes
import gzip
import json
import os
import secrets
import socket
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from packets import Packet, plain_siphash

DT_NS, RECORD_STEPS = 2_000_000, 240
SECRET, RUNNER_NONCE, TARGET_NONCE = bytes(range(16)), bytes(range(50, 66)), bytes(range(80, 96))
HELLO, WELCOME, _, ARM, COMMAND, SAMPLES, REST, CLOSE = range(1, 9)
ARMED, RESTING, RESTED = 1, 2, 3
WATCHDOG_NS = 1_000_000_000
LEFT_NS, CAME_NS, LOOKED_NS = 1_000, 90_000, 60_000  # a packet takes to leave, an answer to come, a look in vain
TRY_AGAIN = 11

LOST = {40, 90, 91, 92, 150, 151}  # answers, counted from the ARM's, that never come
LATE, DOUBLED, FORGED = {60, 200}, {70, 201}, {75, 202}  # that come with the next one, twice, and beside a forged one


def session_key() -> bytes:
    """Return the key of the session, 16 bytes (docs/reference/udp.md)."""
    heads = (b"rths-key" + struct.pack("<Q", i) for i in (0, 1))
    return b"".join(plain_siphash(head + RUNNER_NONCE + TARGET_NONCE, SECRET) for head in heads)


class Network:
    """A clock that is counted in ns, what was sent, and what is there to be received."""

    def __init__(self, answers: Callable[[bytes], list[bytes]]) -> None:
        self.now, self.sent, self.waiting = 10**12, list[bytes](), list[bytes]()
        self._answers = answers
        self._error = ctypes.c_int(TRY_AGAIN)
        self._calls = [*self._functions()]

    def _functions(self) -> Iterator[Any]:
        """Put functions in the place of the C library's, and yield them: they must live as long as the process."""
        place, count, number = ctypes.c_size_t, ctypes.c_ssize_t, ctypes.c_int
        for name, function, result, arguments in (
            ("clock_gettime", self._clock, number, (number, place)),
            ("clock_nanosleep", self._sleep, number, (number, number, place, place)),
            ("send", self._send, count, (number, place, place, number)),
            ("recv", self._receive, count, (number, place, place, number)),
            ("ppoll", self._wait, number, (place, place, place, place)),
            ("__errno_location", lambda: ctypes.addressof(self._error), place, ()),
        ):
            made = ctypes.CFUNCTYPE(result, *arguments)(function)
            llvm.add_symbol(name, ctypes.cast(made, ctypes.c_void_p).value)
            yield made

    def _clock(self, _: int, to: int) -> int:
        struct.pack_into("<2q", (ctypes.c_char * 16).from_address(to), 0, *divmod(self.now, 10**9))
        return 0

    def _time_at(self, place: int) -> int:
        seconds, rest = struct.unpack("<2q", ctypes.string_at(place, 16))
        return int(seconds * 10**9 + rest)

    def _sleep(self, _clock: int, _how: int, until: int, _left: int) -> int:
        from rths_cli.numerics.clock import spin_of

        self.now = self._time_at(until) + spin_of(DT_NS)  # the deadline itself: nothing is left to spin for
        return 0

    def _wait(self, _polled: int, _count: int, time: int, _mask: int) -> int:
        self.now += self._time_at(time)
        return 0

    def _send(self, _door: int, packet: int, size: int, _flags: int) -> int:
        data = ctypes.string_at(packet, size)
        self.sent.append(data)
        self.waiting += self._answers(data)
        self.now += LEFT_NS
        return size

    def _receive(self, _door: int, to: int, size: int, _flags: int) -> int:
        if not self.waiting:
            self.now += LOOKED_NS
            return -1
        self.now += CAME_NS
        data = self.waiting.pop(0)
        ctypes.memmove(to, data, min(len(data), size))
        return len(data)


class Table:
    """A target: it answers as docs/reference/udp.md says, some answers are spoilt on their way."""

    def __init__(self, table: Callable[[float | None], list[float]]) -> None:
        self.answers: list[list[bytes]] = []
        self._table, self._key = table, session_key()
        self._state, self._last, self._lost, self._rests, self._latched_v = 0, -1, 0, 0, 0.0
        self._samples: list[float] = []
        self._late: list[bytes] = []

    def __call__(self, data: bytes) -> list[bytes]:
        kind, (sequence,) = data[5], struct.unpack_from("<q", data, 16)
        if kind == ARM:
            self._state, self._samples = ARMED, self._table(None)
        elif kind == COMMAND:
            self._samples = self._table(self._latched_v)
            (self._latched_v,) = struct.unpack_from("<d", data, 40)
        else:
            self._rests += 1
            self._state = RESTING if self._rests < 3 else RESTED
        self._lost += sequence - self._last - 1
        self._last = sequence
        content = struct.pack(f"<{len(self._samples)}d", *self._samples)
        answer = Packet(SAMPLES, sequence, content, self._state, 0, self._lost, 11, 7).sealed(self._key)
        self.answers.append(self._spoilt(len(self.answers), answer))
        return self.answers[-1]

    def _spoilt(self, number: int, answer: bytes) -> list[bytes]:
        """Return what comes for one packet: late answers of before come first."""
        before, self._late = self._late, []
        if number in LOST:
            return before
        if number in LATE:
            self._late = [answer]
            return before
        forged = answer[:-1] + bytes([answer[-1] ^ 1])
        return [*before, *([forged] if number in FORGED else []), *[answer] * (2 if number in DOUBLED else 1)]


def play(answers: Callable[[bytes], list[bytes]]) -> list[bytes]:
    """Play a hybrid test over UDP; return every packet that the runner sent, from HELLO to CLOSE."""
    network = Network(answers)
    from bench import rig_info
    from hybrid import best_like, open_limits

    from rths_cli.loop import realtime_run
    from rths_cli.loop.step_arrays import NUMERICAL
    from rths_cli.rigs.udp import udp_rig

    secrets.token_bytes = lambda count=None: RUNNER_NONCE[:count]
    here, there = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in "12")
    for door in (here, there):
        door.bind(("127.0.0.1", 0))
    here.connect(there.getsockname())
    there.connect(here.getsockname())
    here.setblocking(False)
    udp_rig.connected = lambda host, port: [(here, "127.0.0.1:1")]
    udp_rig.time = SimpleNamespace(
        monotonic=lambda: 1e-9 * network.now, monotonic_ns=lambda: network.now, sleep=lambda _: None
    )
    terms = struct.pack("<3q", 3, DT_NS, WATCHDOG_NS)
    there.send(Packet(WELCOME, 0, RUNNER_NONCE + TARGET_NONCE + terms).sealed(SECRET))  # it waits for the HELLO

    info = rig_info(dt_s=1e-9 * DT_NS)
    info = replace(info, kind="udp", limits=replace(info.limits, lost_samples=10))
    blocks = replace(best_like(info), shaping_step_v=info.converters.step_v)
    time_s = 1e-9 * DT_NS * np.arange(RECORD_STEPS)
    drive = np.column_stack([np.sin(12.0 * time_s), -np.cos(12.0 * time_s) / 12.0, -np.sin(12.0 * time_s) / 144.0])
    run = realtime_run.prepare(info, blocks, NUMERICAL, 0.2 * drive, open_limits(info), ramp_s=0.04)
    with tempfile.TemporaryDirectory() as folder:
        key_file = Path(folder) / "key"
        key_file.write_text(SECRET.hex())
        key_file.chmod(0o600)
        target = udp_rig.UdpTarget("127.0.0.1", 1, key_file, watchdog_s=1e-9 * WATCHDOG_NS, lost_samples=10)
        rig = udp_rig.UdpRig(info, target)
        rig.open()
        fault = realtime_run.perform(rig, run)
        rig.close()
    assert fault == "", fault
    return [there.recv(1000), *network.sent]


def arithmetic() -> str:
    """Return what the last bits of a command depend on: the processor, and the libraries that compute on it."""
    from importlib.metadata import version

    chosen = [f"{name}={value}" for name, value in sorted(os.environ.items()) if name.startswith("NUMBA_")]
    libraries = [f"{name} {version(name)}" for name in ("numba", "llvmlite", "numpy", "scipy")]
    return " ".join([llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), *chosen, *libraries])


def main() -> None:
    """Record an exchange, or replay the answers of one."""
    what, path = sys.argv[1], Path(sys.argv[2])
    if what == "record":
        from bench import rig_info
        from udp_peer import virtual_table

        table = Table(virtual_table(rig_info(dt_s=1e-9 * DT_NS), (3, 1)))
        sent = play(table)
        kept = {"arithmetic": arithmetic(), "sent": [data.hex() for data in sent]}
        kept["answers"] = [[data.hex() for data in come] for come in table.answers]
        path.write_bytes(gzip.compress(json.dumps(kept).encode(), mtime=0))
        return
    recorded = iter(json.loads(gzip.decompress(path.read_bytes()))["answers"])
    sent = play(lambda _: [bytes.fromhex(data) for data in next(recorded, [])])
    print(json.dumps({"arithmetic": arithmetic(), "sent": [data.hex() for data in sent]}))


if __name__ == "__main__":
    main()
