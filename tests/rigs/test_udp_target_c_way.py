"""The example target in C on a clock that the test sets: how it goes on while a command is late."""

from __future__ import annotations

import shutil
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from packets import Packet, opened, plain_siphash
from portfolio import parametrize_first
from smooth_way import smooth_way

from rths_cli.rigs.udp import packets

EXAMPLES = Path(__file__).parents[2] / "examples"
COMPILER = shutil.which("cc") or shutil.which("gcc")
pytestmark = [
    pytest.mark.skipif(COMPILER is None, reason="no C compiler here"),
    pytest.mark.real_time,
]
SECRET, INTERVAL_NS = bytes(range(16)), 1_000_000
MAIN = r"""
#include <stdio.h>
#include "udp_target.c"
static int64_t now;
static double written;
void read_samples(double volts[CHANNELS], int64_t now_ns)
{
    (void)now_ns;
    for (int c = 0; c < CHANNELS; c++)
        volts[c] = written;
}
void write_command(double volts, int64_t now_ns) { (void)now_ns; written = volts; }
void random_bytes(uint8_t *bytes, size_t count) { memset(bytes, 7, count); }
int64_t clock_ns(void) { return now; }
int main(void)
{
    static struct target t;
    uint8_t in[MOST], out[MOST];
    long long time;
    unsigned size, byte;
    for (int i = 0; i < 16; i++)
        t.secret[i] = (uint8_t)i;
    while (scanf("%lld %u", &time, &size) == 2) {
        for (unsigned i = 0; i < size && scanf("%2x", &byte) == 1; i++)
            in[i] = (uint8_t)byte;
        now = time;
        size_t answer = size ? handle(&t, in, size, out) : 0;
        watch(&t);
        printf("%.17g %d ", written, t.state);
        for (size_t i = 0; i < answer; i++)
            printf("%02x", out[i]);
        puts("");
        fflush(stdout);
    }
}
"""


class Clocked:
    """A target to which time passes when it is told so, armed in a session at 4 ms."""

    def __init__(self, program: Path) -> None:
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        terms = struct.pack("<3q", 3, INTERVAL_NS, 200_000_000)
        hello = Packet(packets.HELLO, 0, bytes(16) + terms + bytes(16))
        answer = self.at(0, hello.sealed(SECRET))[2]
        welcome = opened(answer, SECRET)
        assert welcome is not None and welcome.kind == packets.WELCOME
        label = (b"rths-key" + struct.pack("<Q", i) for i in (0, 1))
        self.key = b"".join(plain_siphash(head + welcome.content[:32], SECRET) for head in label)
        self.sequence = 0
        assert self.at(4_000_000, Packet(packets.ARM, 0, bytes(16) + terms).sealed(self.key))[1] == packets.ARMED

    def at(self, time_ns: int, packet: bytes = b"") -> tuple[float, int, bytes]:
        """Let it be this time, and a packet come then; return what stands at the output, the state, the answer."""
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{time_ns} {len(packet)} {packet.hex()}\n")
        self.process.stdin.flush()
        words = self.process.stdout.readline().split()
        return float(words[0]), int(words[1]), bytes.fromhex(words[2] if len(words) > 2 else "")

    def command(self, time_ns: int, content: bytes) -> tuple[float, int, bytes]:
        self.sequence += 1
        return self.at(time_ns, Packet(packets.COMMAND, self.sequence, content).sealed(self.key))

    def held(self, time_ns: int, intervals: int) -> list[float]:
        """Return what stands at the output 0.2 ms after the beginning of each of the intervals that follow."""
        return [self.at(time_ns + k * INTERVAL_NS + 200_000)[0] for k in range(intervals)]


@pytest.fixture
def target(tmp_path: Path) -> Iterator[Clocked]:
    source, program = tmp_path / "clocked.c", tmp_path / "clocked"
    source.write_text(MAIN)
    strict = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsanitize=undefined")
    words = [str(COMPILER), *strict, f"-I{EXAMPLES}", "-o", str(program), str(source)]
    if subprocess.run(words, check=False, capture_output=True).returncode != 0:  # no sanitizer on this machine
        subprocess.run([word for word in words if "sanitize" not in word], check=True)
    clocked = Clocked(program)
    yield clocked
    clocked.process.kill()
    clocked.process.wait()


@pytest.mark.campaign
@parametrize_first(2, "spacing", [1, 8])
@parametrize_first(2, "count", [1, 2, 14])
def test_it_goes_the_way_it_is_told_then_holds(target: Clocked, spacing: int, count: int) -> None:
    points = 0.02 * spacing * np.sin(np.arange(1.0, count + 1))
    assert target.command(5_000_000, struct.pack(f"<dq{count}d", 0.01, spacing, *points))[0] == 0.01
    wanted = smooth_way((0.01, *points), spacing, 130)
    assert target.held(5_000_000, 130) == pytest.approx(wanted, abs=1e-14)


def test_the_next_command_ends_the_way(target: Clocked) -> None:
    target.command(5_000_000, struct.pack("<dq2d", 0.01, 4, 0.02, 0.03))
    target.held(5_000_000, 3)
    target.command(8_000_000, struct.pack("<d", 0.05))
    assert target.held(8_000_000, 10) == [0.05] * 10


CLOSING_V = 0.032  # in an interval


def test_a_late_command_is_approached_whatever_the_target_did_meanwhile(target: Clocked) -> None:
    """It heard nothing for 20 intervals; then commands come in time again, 2 mV apart."""
    target.command(5_000_000, struct.pack("<d", 0.1))
    target.held(5_000_000, 20)
    places = [target.command(25_000_000 + k * INTERVAL_NS, struct.pack("<d", 1.0 + 2e-3 * k))[0] for k in range(60)]
    moved = np.diff([0.1, *places])
    assert moved[0] == pytest.approx(0.8 * (0.9 / 20 + CLOSING_V))  # it looked last 0.8 intervals before
    assert moved[1:].max() <= 2e-3 + CLOSING_V + 1e-12 and places[-20:] == pytest.approx(1.0 + 2e-3 * np.arange(40, 60))


def test_commands_that_waited_for_a_frozen_target_move_it_by_one_step(target: Clocked) -> None:
    """All it missed is handed to it at once; it stood still meanwhile, although it was told a way."""
    target.command(5_000_000, struct.pack("<dq14d", 0.1, 8, *np.linspace(0.3, 3.0, 14)))
    for k in range(1, 31):
        stands = target.command(35_100_000, struct.pack("<d", 0.1 + 0.02 * k))[0]
    assert 0.1 < stands <= 0.1 + 0.02 + CLOSING_V + 1e-12
    after = np.array(target.held(35_000_000, 40))
    assert np.diff([stands, *after]).max() <= CLOSING_V + 1e-12 and after[-1] == 0.7


def test_a_frozen_target_does_not_jump_on_its_way_nor_on_its_way_to_rest(target: Clocked) -> None:
    target.command(5_000_000, struct.pack("<dq14d", 0.1, 8, *np.linspace(0.3, 3.0, 14)))
    assert target.at(60_000_000)[0] <= 0.1 + 0.04 + CLOSING_V  # where the way moves by less than 0.04 V an interval
    target.command(60_500_000, struct.pack("<d", 2.0))
    stands = target.at(62_500_000)[0]
    target.at(300_000_000)  # the watchdog has bitten
    assert target.at(500_000_000)[0] >= stands - 0.1


def test_it_goes_no_faster_than_its_limit_and_no_farther_than_its_range(target: Clocked) -> None:
    target.command(5_000_000, struct.pack("<dq3d", 9.7, 1, 11.0, 11.0, 11.0))
    assert target.held(5_000_000, 6) == pytest.approx([9.7, 9.827, 9.954, 10.0, 10.0, 10.0], rel=1e-12)


@pytest.mark.campaign
@parametrize_first(2, ("spacing", "last"), [(0, 0.1), (-1, 0.1), (1001, 0.1), (4, np.nan), (4, np.inf), (4, 1e308)])
def test_a_way_that_is_no_good_makes_it_hold(target: Clocked, spacing: int, last: float) -> None:
    target.command(5_000_000, struct.pack("<dq2d", 0.01, spacing, 0.1, last))
    assert target.held(5_000_000, 20) == [0.01] * 20


def test_the_watchdog_bites_on_the_way(target: Clocked) -> None:
    target.command(5_000_000, struct.pack("<dq14d", 0.5, 100, *np.linspace(0.6, 2.0, 14)))
    target.held(5_000_000, 199)
    assert target.at(204_500_000)[1] == packets.ARMED
    stood = target.at(204_500_000)[0]
    assert stood > 0.6
    volts, state, _ = target.at(206_000_000)
    assert state == packets.RESTING and volts <= stood + 0.01
    assert target.at(207_000_000)[0] < volts
