"""The frames of the plain link byte by byte: every field, its place and type (docs/reference/plain_link.md).

A frame has a head of 40 bytes, its last field the command in V, and from the target one float64 per channel behind it.
No key, no checksum of its own: the link is for a private cable. Compiled code reads and writes frames in preallocated
arrays; `Frame`, `packed` and `unpacked` are the same in Python, for what is not critical in time.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rths_cli.numerics.compiled import part
from rths_cli.rigs.udp.packets import Bytes, get_real, get_small, put_bytes, put_real

# offsets of the fields; the one of a target's state holds a runner's order
MAGIC, SESSION, NUMBER, ECHO, STATE, FAULTS, TIME_S, COMMAND_V, SAMPLES_V = 0, 4, 8, 12, 16, 20, 24, 32, 40
ORDER, COMMAND_BYTES = STATE, SAMPLES_V
OF_RUNNER, OF_TARGET = b"RPC1", b"RPS1"
OF_RUNNER_NUMBER, OF_TARGET_NUMBER = (int.from_bytes(magic, "little") for magic in (OF_RUNNER, OF_TARGET))
ASK, BEGIN, COMMAND, REST = range(4)  # orders of the runner
RUNNING, RESTING, AT_REST = 1, 2, 3  # states of the target: those of packets.py, without IDLE
LARGEST_NUMBER = 2**31 - 1  # of sessions and frames: MATLAB's whole numbers saturate, and so do those of many targets
LONGEST_TIME_S = 9e9
HEAD = struct.Struct("<4s5I2d")


@dataclass(frozen=True)
class Frame:
    """A frame of either side: `order` of the runner or state of the target; `samples_v` is empty in a runner's."""

    session: int
    number: int
    echo: int
    order: int
    time_s: float
    command_v: float
    faults: int = 0
    samples_v: tuple[float, ...] = ()


def packed(frame: Frame, magic: bytes = OF_RUNNER) -> bytes:
    """Return a frame as bytes."""
    numbers = frame.session, frame.number, frame.echo, frame.order, frame.faults
    head = HEAD.pack(magic, *numbers, frame.time_s, frame.command_v)
    return head + struct.pack(f"<{len(frame.samples_v)}d", *frame.samples_v)


def unpacked(data: bytes, channels: int) -> Frame | str:
    """Return the frame of a target with so many channels, or in words what the bytes are instead."""
    wanted = COMMAND_BYTES + 8 * channels
    if data[:4] == OF_RUNNER:
        return "it sends frames of a runner (RPC1): the two ports are exchanged, or another runner is there"
    if data[:4] != OF_TARGET:
        return f"its frames begin with {data[:4].hex(' ')} instead of {OF_TARGET.hex(' ')} (RPS1)"
    if len(data) != wanted:
        other, left = divmod(len(data) - COMMAND_BYTES, 8)
        held = f"{other} channels" if left == 0 and other >= 0 else "no whole number of channels"
        return f"its frames have {len(data)} bytes ({held}), {channels} channels need {wanted}; check both lists"
    _, session, number, echo, state, faults, time_s, command_v = HEAD.unpack_from(data)
    if not RUNNING <= state <= AT_REST:
        return f"its frames state {state} at byte {STATE}, a state is 1, 2 or 3"
    samples_v = struct.unpack_from(f"<{channels}d", data, SAMPLES_V)
    return Frame(session, number, echo, state, time_s, command_v, faults, samples_v)


@part
def put_head(frame: Bytes, magic: int, session: int, number: int, echo: int, order: int) -> None:
    """Write the whole numbers of a frame, all but the faults, which are set to 0."""
    put_bytes(frame, MAGIC, magic, 4)
    put_bytes(frame, SESSION, session, 4)
    put_bytes(frame, NUMBER, number, 4)
    put_bytes(frame, ECHO, echo, 4)
    put_bytes(frame, ORDER, order, 4)
    put_bytes(frame, FAULTS, 0, 4)


@part
def put_command(
    frame: Bytes, session: int, number: int, echo: int, order: int, time_ns: int, command_v: float
) -> int:  # fmt: skip
    """Write a frame of the runner; return its size in bytes."""
    put_head(frame, OF_RUNNER_NUMBER, session, number, echo, order)
    put_real(frame, TIME_S, 1e-9 * time_ns)
    put_real(frame, COMMAND_V, command_v)
    return COMMAND_BYTES


@part
def is_of_target(frame: Bytes, size: int, channels: int) -> bool:
    """Return whether received bytes are a whole frame of a target with so many channels."""
    if size != COMMAND_BYTES + 8 * channels or get_small(frame, MAGIC) != OF_TARGET_NUMBER:
        return False
    return RUNNING <= get_small(frame, STATE) <= AT_REST


@part
def is_of_runner(frame: Bytes, size: int) -> bool:
    """Return whether received bytes are a whole frame of a runner."""
    if size != COMMAND_BYTES or get_small(frame, MAGIC) != OF_RUNNER_NUMBER:
        return False
    return get_small(frame, ORDER) <= REST


@part
def time_ns_of(frame: Bytes) -> int:
    """Return the sender's time in ns, 0 for one that is no time."""
    time_s = get_real(frame, TIME_S)
    return int(1e9 * time_s) if abs(time_s) <= LONGEST_TIME_S else 0
