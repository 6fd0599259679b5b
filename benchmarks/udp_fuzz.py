"""Throw 100,000 random, mutated, replayed and forged packets at every reader of the UDP link: none may be obeyed.

python benchmarks/udp_fuzz.py [COUNT]                    runner, handshake, and the example target in C
python benchmarks/udp_fuzz.py COUNT HOST PORT KEY_FILE   a running target, for instance `rths serve`
"""

from __future__ import annotations

import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from options import arguments, parsed

from rths_cli.errors import RthsError
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.handshake import answer_hello_at, open_greeter, opens_session_at
from rths_cli.rigs.udp.link import OK, converse_at, fresh_link
from rths_cli.rigs.udp.packets import Words
from rths_cli.rigs.udp.session import as_words, bound, connected, make_secret, sealed
from rths_cli.rigs.udp.udp_rig import UdpRig, UdpTarget

SHORT = ("20",)
PRINTS = "runner"  # the short form at its end

BURST = 40  # hostile packets between two genuine ones
MOVED_V = 0.05  # a table at rest shows less; a forged command of 5 V gives more
EXAMPLE = Path(__file__).parents[1] / "examples" / "udp_target_pc.c"
Random = np.random.Generator


@dataclass(frozen=True)
class Material:
    """What an attacker may have: a packet not yet answered in sight but not its key, and packets already obeyed."""

    fresh: bytes
    used: list[bytes]


ATTACKS: dict[str, Callable[[Random, Material], bytes]] = {
    "random bytes": lambda random, _: random.bytes(int(random.integers(0, 1400))),
    "random of the right size": lambda random, m: random.bytes(len(m.fresh)),
    "right head, random rest": lambda random, m: m.fresh[:40] + random.bytes(len(m.fresh) - 40),
    "bits flipped": lambda random, m: flipped(random, m.fresh),
    "cut": lambda random, m: m.fresh[: int(random.integers(0, len(m.fresh)))],
    "longer": lambda random, m: m.fresh + random.bytes(int(random.integers(1, 100))),
    "other word, old tag": lambda random, m: m.fresh[:40] + random.bytes(8) + m.fresh[48:],
    "other key": lambda random, m: sealed(m.fresh[5], m.fresh[40:-8], as_words(random.bytes(16)), 10**6),
    "replayed": lambda random, m: m.used[int(random.integers(len(m.used)))],
}
NAMES = list(ATTACKS)


def flipped(random: Random, packet: bytes) -> bytes:
    """Return a packet with one to four different bits changed."""
    bits = np.unpackbits(np.frombuffer(packet, np.uint8))
    bits[random.choice(bits.size, int(random.integers(1, 5)), replace=False)] ^= 1
    return np.packbits(bits).tobytes()


def bursts(count: int, seed: int, material: Material, kinds: Counter[str]) -> Iterator[list[bytes]]:
    """Yield hostile packets in bursts, counting their kinds."""
    random = np.random.default_rng(seed)
    for start in range(0, count, BURST):
        drawn = [NAMES[i] for i in random.integers(len(NAMES), size=min(BURST, count - start))]
        kinds.update(drawn)
        yield [ATTACKS[name](random, material) for name in drawn]


def shown(kinds: Counter[str]) -> str:
    """Return how many kinds of attack there were."""
    return f"{len(kinds)} kinds, {min(kinds.values())} or more of each"


def at_runner(count: int) -> str:
    """Send them to the compiled link as answers; return what came of it."""
    key, kinds = np.array([1, 2], np.uint64), Counter[str]()
    door = bound("127.0.0.1", 0)
    runner, _ = connected("127.0.0.1", door.getsockname()[1])[0]
    link = fresh_link(runner, key, 3)
    answers = [sealed(packets.SAMPLES, struct.pack("<3d", 9.0, 9.0, 9.0), key, k) for k in range(10)]
    door.sendto(answers[8], runner.getsockname())
    converse_at(link, packets.COMMAND, 8, 0.0, 0, 10**9)
    link.samples_v[:] = 0.0
    for burst in bursts(count, 1, Material(answers[9], answers[:9]), kinds):
        for packet in burst:
            door.sendto(packet, runner.getsockname())
        converse_at(link, packets.COMMAND, 9, 0.0, 0, 2_000_000)
    converse_at(link, packets.COMMAND, 9, 0.0, 0, 100_000_000)
    refused = int(link.counts[links.BAD] + link.counts[links.DOUBLED])
    taken = int(link.counts[links.ANSWERED]) - 1 + int(link.samples_v.any()) + int(link.counts[links.STRAY])
    return f"runner: {count} sent, {refused} refused, {taken} taken, {shown(kinds)}"


def at_handshake(count: int) -> str:
    """Give them to a target's handshake; return what came of it."""
    secret, kinds = np.array([3, 4], np.uint64), Counter[str]()
    hello = sealed(packets.HELLO, struct.pack("<16s3q16x", b"n" * 16, 3, 10**6, 10**8), secret)
    used = [sealed(kind, b"", secret) for kind in (*range(packets.WELCOME, packets.CLOSE + 1), 0, 200)]
    greeter, out = open_greeter(secret, 3, 1000, 10**8), np.zeros(packets.MOST_BYTES, np.uint8)
    answered = begun = 0
    for burst in bursts(count, 2, Material(hello, used), kinds):
        for data in burst:
            packet = np.zeros(packets.MOST_BYTES, np.uint8)
            packet[: len(data)] = np.frombuffer(data[: packets.MOST_BYTES], np.uint8)
            answered += answer_hello_at(greeter, packet, len(data), 10**9, 0, False, out) > 0
            packet[packets.KIND] = packets.ARM
            begun += opens_session_at(greeter, packet, len(data), 10**9, out)
    return f"handshake: {count} given, {answered} answered, {begun} sessions begun, {shown(kinds)}"


def at_target(count: int, name: str, target: UdpTarget) -> str:
    """Send them to a target whose table is armed at rest; return what came of it."""
    rig, kinds = UdpRig(rest_info(), target), Counter[str]()
    rig.open()
    rig.arm()
    moved, answered = 0.0, 0
    with connected(target.host, target.port)[0][0] as stranger:
        for burst in bursts(count, 3, commands(rig.link.key, int(rig.link.status[links.LAST])), kinds):
            for packet in burst:
                stranger.send(packet)
            moved = max(moved, step(rig))
            answered += drained(stranger)
        for _ in range(100):
            time.sleep(0.002)
            moved = max(moved, step(rig))
    counts = rig.counts
    rig.rest()
    rig.close()
    return (
        f"{name}: {count} sent, {answered} answered, largest sample {moved:.4f} V"
        f"{'' if moved < MOVED_V else ' (MOVED)'}, genuine commands {counts['sent']}, lost {counts['lost']}, "
        f"at rest {rig.at_rest}, {shown(kinds)}"
    )


def commands(key: Words, base: int) -> Material:
    """Return a command of 5 V far ahead to be spoilt, and such of sequence numbers that are used up already."""
    volts = struct.pack("<d", 5.0)
    return Material(
        sealed(packets.COMMAND, volts, key, base + 10**6),
        [sealed(packets.COMMAND, volts, key, n) for n in range(base + 1)],
    )


def step(rig: UdpRig) -> float:
    """Send the command 0 V and return the largest sample; a target that stopped ends the program."""
    k = int(rig.link.status[links.LAST] - rig.link.status[links.BASE]) + 1
    if converse_at(rig.link, packets.COMMAND, k, 0.0, 0, 50_000_000) not in (OK, links.LOST):
        sys.exit(f"the target stopped: state {rig.link.status[links.STATE]}, faults {rig.link.status[links.FAULTS]:#x}")
    return float(np.abs(rig.link.samples_v).max())


def drained(stranger: socket.socket) -> int:
    """Return how many answers a stranger got."""
    count = 0
    try:
        while True:
            stranger.recv(300)
            count += 1
    except OSError:
        return count


def rest_info() -> RigInfo:
    """Return a rig of three channels at 1 kHz."""
    channels = tuple(Channel(name, 0.1, 50.0, 0.0, 0.0) for name in ("table", "floor 1", "floor 2"))
    limits = Limits(0.079, 1.0, 45.0, 445.0)
    return RigInfo("fuzzed", "udp", 1e-3, channels, Converters(16, 10.0), 1, limits, 0.0079, 7.0, 13.86)


def at_example(count: int) -> str:
    """Compile and start the example in C and fuzz it."""
    compiler = shutil.which("cc")
    if compiler is None:
        return "example in C: no compiler here"
    with tempfile.TemporaryDirectory() as folder:
        program, key_file = Path(folder) / "udp_target", Path(folder) / "key"
        subprocess.run(
            [compiler, "-std=c99", "-O2", "-fsanitize=address,undefined", "-o", program, EXAMPLE], check=True
        )
        make_secret(key_file)
        process = subprocess.Popen([program, "0", key_file], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        port = int(process.stdout.readline().rpartition(":")[2])
        try:
            return at_target(count, "example in C", UdpTarget("127.0.0.1", port, key_file, watchdog_s=1.0))
        finally:
            process.kill()


def main() -> None:
    """Fuzz what is asked for and print one line each."""
    parser = arguments(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=100_000)
    parser.add_argument("target", nargs="*", metavar="HOST PORT KEY_FILE", help="of a running target")
    asked = parsed(parser, SHORT)
    count, words = asked.count, asked.target
    if words:
        host, port, key_file = words
        print(at_target(count, f"{host}:{port}", UdpTarget(host, int(port), Path(key_file))))
        return
    for part in (at_runner, at_handshake, at_example):
        start = time.perf_counter()
        print(f"{part(count)} in {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    try:
        main()
    except RthsError as fault:
        sys.exit(str(fault))
