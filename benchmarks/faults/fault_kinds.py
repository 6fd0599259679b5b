"""Faults of network, target, runner and disk, each with the endings that are true for it."""

from __future__ import annotations

import os
import resource
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from campaigns.fault_bench import COMMAND, Bench, Mishap, Packet, as_it_came, frozen

STEP_S = 0.002


@dataclass(frozen=True)
class Kind:
    """A fault: what it does at its instant, how the run may end, what its file must say.

    `codes` of the process; `status` of its file, one of several; `reason`, a word of it. `serves_on`: the target is
    there to the end and must bring its table to rest in time. `when`: where the instant lies, in the "run", while
    "listening", in the "rehearsal", or nowhere ("end"). `before` is called in the process before it starts, `more` is
    of its environment.
    """

    act: Callable[[Bench], None]
    codes: frozenset[int]
    status: str
    reason: str = ""
    serves_on: bool = True
    when: str = "run"
    before: Callable[[], None] | None = None
    more: dict[str, str] = field(default_factory=dict)


def good(act: Callable[[Bench], None], **more: str) -> Kind:
    """Return a fault that must not stop the run."""
    return Kind(act, frozenset({0}), "complete", more=more)


def may_stop(act: Callable[[Bench], None]) -> Kind:
    """Return a fault that a limit may stop: after a pause of 20 ms the table has its whole way to catch up at once."""
    return Kind(act, frozenset({0, 3}), "complete|aborted")


def failed(act: Callable[[Bench], None], reason: str, serves_on: bool = True) -> Kind:
    return Kind(act, frozenset({4}), "failed", reason, serves_on)


def nothing(bench: Bench) -> None:
    """Do nothing: the run that all others are compared with."""


# --- network: `forth` to the target, `back` to the runner


def network(forth: Mishap | None = None, back: Mishap | None = None) -> Callable[[Bench], None]:
    def act(bench: Bench) -> None:
        bench.network.to_target = forth or as_it_came
        bench.network.to_runner = back or as_it_came

    return act


def lost(_: bytes) -> list[tuple[float, bytes]]:
    return []


def first(count: int) -> Callable[[], Mishap]:
    """Return a maker of mishaps that lose the next packets and then pass everything."""

    def make() -> Mishap:
        left = [count]

        def mishap(packet: bytes) -> list[tuple[float, bytes]]:
            left[0] -= 1
            return [] if left[0] >= 0 else [(0.0, packet)]

        return mishap

    return make


def losing(forth: int, back: int) -> Callable[[Bench], None]:
    return lambda bench: network(first(forth)(), first(back)())(bench)


def drawn(change: Callable[[Bench, bytes], list[tuple[float, bytes]]], share: float) -> Callable[[Bench], None]:
    """Return a fault that spoils a share of all packets, both ways."""

    def act(bench: Bench) -> None:
        def mishap(packet: bytes) -> list[tuple[float, bytes]]:
            return change(bench, packet) if bench.random.random() < share else [(0.0, packet)]

        network(mishap, mishap)(bench)

    return act


def flipped(bench: Bench, packet: bytes) -> list[tuple[float, bytes]]:
    spoilt = bytearray(packet)
    spoilt[int(bench.random.integers(len(spoilt)))] ^= 1 << int(bench.random.integers(8))
    return [(0.0, bytes(spoilt))]


def delayed(seconds: float) -> Mishap:
    return lambda packet: [(seconds, packet)]


def doubled(packet: bytes) -> list[tuple[float, bytes]]:
    return [(0.0, packet), (0.0005, packet)]


def forged(bench: Bench) -> None:
    """Slip commands of 9 V and samples of 9 V in, with tags that are guessed, beside every genuine packet."""

    def beside(kind: int, words: int) -> Mishap:
        def mishap(packet: bytes) -> list[tuple[float, bytes]]:
            sequence = struct.unpack_from("<q", packet, 16)[0] + 1
            return [(0.0, Packet(kind, sequence, struct.pack("<d", 9.0) * words).sealed(os.urandom(16))), (0.0, packet)]

        return mishap

    network(beside(COMMAND, 1), beside(6, 3))(bench)


def replayed(bench: Bench) -> None:
    """Send old packets again, of this session and of the one before."""
    old = [packet for _, packet in bench.network.forth]

    def mishap(packet: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, packet), (0.0, old[int(bench.random.integers(len(old)))])]

    network(mishap)(bench)


def stranger(bench: Bench) -> None:
    """Greet the target, while its table moves, with the right key and with a wrong one."""
    secret = bytes.fromhex((bench.folder / "key").read_text().strip())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        for i in range(40):
            hello = Packet(1, 0, os.urandom(16) + struct.pack("<3q16x", 3, 1_000_000, 100_000_000))
            door.sendto(hello.sealed(secret if i % 2 else os.urandom(16)), ("127.0.0.1", bench.served.port))
            time.sleep(0.02)


def flooded(bench: Bench) -> None:
    """Send 3000 packets of rubbish to the target, and as many to the runner's side."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        for i in range(3000):
            door.sendto(os.urandom(56), ("127.0.0.1", bench.served.port))
            if i % 20 == 0:
                time.sleep(0.002)


# --- processes


def to_target(number: int) -> Callable[[Bench], None]:
    return lambda bench: bench.served.send(number)


def restarted(bench: Bench) -> None:
    """Kill the target; another one that has just started answers in its place."""
    bench.served.send(signal.SIGKILL)
    bench.network.relay._back.connect(("127.0.0.1", bench.spare.port))


def thawed_later(bench: Bench) -> None:
    """Freeze the target for longer than any run takes to give up."""
    bench.served.send(signal.SIGSTOP)
    threading.Timer(4.0, bench.served.send, (signal.SIGCONT,)).start()


def to_runner(*numbers: int) -> Callable[[Bench], None]:
    def act(bench: Bench) -> None:
        for i, number in enumerate(numbers):
            time.sleep(0.15 if i else 0.0)
            bench.kill_runner(number)

    return act


def shaken_awake(bench: Bench) -> None:
    """Freeze the runner for 6 ms, 20 times."""
    for _ in range(20):
        frozen(bench.runner, 0.006)
        time.sleep(0.02)


# --- disk


def no_room(bench: Bench, lasts_s: float) -> None:
    """Let the runner's files grow no further than they are; after a time there is room again."""
    resource.prlimit(bench.runner.pid, resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
    if lasts_s:
        unlimited = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
        time.sleep(lasts_s)
        resource.prlimit(bench.runner.pid, resource.RLIMIT_FSIZE, unlimited)


def small_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, resource.RLIM_INFINITY))


BROKEN = "answers of target"
NO_FILE = "no file"  # nothing has moved or been computed yet: a run that ends here leaves nothing
KINDS: dict[str, Kind] = {
    "nothing": good(nothing),
    "one command lost": good(losing(1, 0)),
    "one answer lost": good(losing(0, 1)),
    "3 commands lost in a row": good(losing(3, 0)),
    "3 answers lost in a row": good(losing(0, 3)),
    "10 commands lost in a row": may_stop(losing(10, 0)),
    "10 answers lost in a row": may_stop(losing(0, 10)),
    "5 % lost both ways": good(drawn(lambda bench, packet: [], 0.05)),
    "all answers lost": failed(network(None, lost), BROKEN),
    "all commands lost": failed(network(lost, None), "target"),
    "cable pulled": failed(network(lost, lost), BROKEN),
    "cable out for 80 ms": Kind(losing(40, 40), frozenset({3}), "aborted", "beyond their limit"),
    "answers 10 ms late": failed(network(None, delayed(0.01)), BROKEN),
    "commands 10 ms late": failed(network(delayed(0.01), None), BROKEN),
    "cable delay 0.3 ms more": good(network(delayed(3e-4), delayed(3e-4))),
    "5 % late by 3 ms: reordered": good(drawn(lambda bench, packet: [(0.003, packet)], 0.05)),
    "every packet doubled": good(network(doubled, doubled)),
    "5 % corrupted": good(drawn(flipped, 0.05)),
    "all corrupted": failed(drawn(flipped, 1.0), BROKEN),
    "forged beside each": good(forged),
    "old packets replayed": good(replayed),
    "strangers greet": good(stranger),
    "flood of rubbish": good(flooded),
    "target killed": failed(to_target(signal.SIGKILL), BROKEN, serves_on=False),
    "target ended by SIGTERM": failed(to_target(signal.SIGTERM), "target", serves_on=False),
    "target frozen": failed(thawed_later, BROKEN, serves_on=False),
    "target frozen 20 ms": may_stop(lambda bench: frozen(bench.served.process, 0.02)),
    # a target that samples and latches at the kernel's stamps is not late itself: then the runner's limit ends it
    "target frozen 0.3 s": Kind(
        lambda bench: frozen(bench.served.process, 0.3), frozenset({3, 4}), "aborted|failed", "limits.lost_samples"
    ),
    "target restarted": failed(restarted, "target", serves_on=False),
    "runner frozen 20 ms": may_stop(lambda bench: frozen(bench.runner, 0.02)),
    "runner frozen 0.3 s": failed(lambda bench: frozen(bench.runner, 0.3), "watchdog"),
    "runner overruns in bursts": may_stop(shaken_awake),
    "Ctrl-C": Kind(to_runner(signal.SIGINT), frozenset({130}), "interrupted", "interrupted"),
    "SIGTERM": Kind(to_runner(signal.SIGTERM), frozenset({143}), "interrupted", "terminated"),
    "SIGHUP": Kind(to_runner(signal.SIGHUP), frozenset({143}), "interrupted", "terminated"),
    "Ctrl-C five times": Kind(to_runner(*[signal.SIGINT] * 5), frozenset({130}), "interrupted"),
    "SIGKILL": Kind(to_runner(signal.SIGKILL), frozenset({-9}), "interrupted", "recovered"),
    "Ctrl-C while listening": Kind(
        to_runner(signal.SIGINT), frozenset({130}), NO_FILE, "", True, "listening"
    ),
    "SIGTERM in the rehearsal": Kind(
        to_runner(signal.SIGTERM), frozenset({143}), NO_FILE, "", False, "rehearsal", None,
        {"RTHS_FAULTS_REHEARSAL_S": "60"},
    ),
    "disk full for 0.5 s": Kind(
        lambda bench: no_room(bench, 0.5), frozenset({4}), "failed", "cannot write the raw log"
    ),
    "disk full to the end": Kind(
        lambda bench: no_room(bench, 0.0), frozenset({2, 4}), "interrupted", "rths recover"
    ),
    "disk full before": Kind(
        nothing, frozenset({4}), "failed", "for the raw log", False, "end", small_files
    ),
    "calendar clock steps": good(nothing, LD_PRELOAD="clock_step"),
}  # fmt: skip
