"""The server's side of OpenFresco's generic client, the element `genericClient` of OpenSees, over TCP.

The first message is 11 int32: sizes of what is controlled (displacement, velocity, acceleration, force, time) and
measured (the same), and the length n of all later messages, which are n doubles: a command and its values. Byte order
is that of x86, lengths and forces are in the client's units (Schellenberg, Mahin and Fenves 2009, PEER 2009/104; the
numbers of the commands as seen on the wire of the package opensees 0.1.32).
"""

from __future__ import annotations

import ipaddress
import math
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from rths_cli.case.rig_schema import PRIVATE
from rths_cli.errors import InputError, LimitError, RigError

SIZES = struct.Struct("<11i")
NAMES = ("displacements", "velocities", "accelerations", "forces", "times")
LONGEST = 100_000  # doubles in a message


class Command(IntEnum):
    """What a client says first in a message; TRIAL, COMMIT and END get no answer."""

    TRIAL = 3
    COMMIT = 5
    DISPLACEMENT = 7
    VELOCITY = 8
    ACCELERATION = 9
    FORCE = 10
    TIME = 11
    INITIAL_STIFFNESS = 12
    TANGENT = 13
    DAMPING = 14
    MASS = 15
    END = 99


@dataclass(frozen=True)
class Asked:
    """A message. `displacement` in the client's unit and `time_s` are 0 where it states none."""

    command: Command
    displacement: float
    time_s: float


class Client:
    """A client of one degree of freedom that has connected and told its sizes."""

    def __init__(self, link: socket.socket, silent_after_s: float) -> None:
        """Read the sizes; raises InputError for those that no rig of one actuator has."""
        self._link, self._silent_s = link, silent_after_s
        link.settimeout(silent_after_s)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sizes = SIZES.unpack(self._read(SIZES.size))
        self._controlled, measured, length = sizes[:5], sizes[5:10], sizes[10]
        told = f"its first message is {', '.join(map(str, sizes))}"
        if not all(0 <= one <= LONGEST for one in sizes) or not 1 + sum(self._controlled) <= length <= LONGEST:
            raise InputError(f"the client does not speak OpenFresco's generic protocol: {told}")
        if self._controlled[0] != 1 or self._controlled[3] or max(self._controlled) > 1:
            stated = ", ".join(f"{n} {name}" for n, name in zip(self._controlled, NAMES, strict=True) if n)
            raise InputError(
                f"the client controls {stated or 'nothing'}, the rig has one actuator that follows a displacement; "
                "give the element genericClient one node with one -dof"
            )
        if measured[3] != 1 or max(measured) > 1:
            raise InputError(f"the client wants {measured[3]} forces, the rig returns one ({told})")
        self._vector = struct.Struct(f"<{length}d")

    def messages(self) -> Iterator[Asked]:
        """Yield what the client says until it ends; raises RigError where it leaves, is silent or says something
        unknown, LimitError for a displacement that is no number."""
        while True:
            values = self._vector.unpack(self._read(self._vector.size))
            if values[0] not in {float(one) for one in Command}:
                raise RigError(f"the client sent the command {values[0]:g}, which OpenFresco's generic protocol lacks")
            last = values[sum(self._controlled)] if self._controlled[4] else 0.0
            asked = Asked(Command(int(values[0])), values[1], last)
            if asked.command is Command.END:
                return
            if asked.command is Command.TRIAL and not math.isfinite(asked.displacement):
                raise LimitError(f"the client sent {asked.displacement} as a displacement at t = {last:g} s")
            yield asked

    def answer(self, value: float) -> None:
        """Send a number, zeros behind it."""
        values = [value, *[0.0] * (self._vector.size // 8 - 1)]
        try:
            self._link.sendall(self._vector.pack(*values))
        except OSError as error:
            raise RigError(f"the client left without ending the test: {error.strerror}") from None

    def _read(self, size: int) -> bytes:
        got = b""
        while len(got) < size:
            try:
                more = self._link.recv(size - len(got))
            except TimeoutError:
                raise RigError(f"the client was silent for {self._silent_s:g} s") from None
            except OSError as error:
                raise RigError(f"the client left without ending the test: {error.strerror}") from None
            if not more:
                raise RigError("the client left without ending the test (OpenSees ends it by wipe, or when it leaves)")
            got += more
        return got


def listening(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address; port 0 selects a free one.

    Raises InputError for an address that is not private: whoever reaches it moves the rig. RigError where it is not
    this machine's or the port is taken.
    """
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError:
        raise InputError(f"--host: must be an IPv4 address in numbers, such as 127.0.0.1, got {host[:40]!r}") from None
    if not any(address in ipaddress.IPv4Network(network) for network in PRIVATE):
        raise InputError(
            f"--host: {host} is not private ({', '.join(PRIVATE)}); messages carry no key, so whoever reaches the "
            "address moves the rig"
        )
    door = socket.socket()
    try:
        door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        door.bind((host, port))
        door.listen(1)
    except OSError as error:
        door.close()
        raise RigError(f"cannot listen at {host}:{port}: {error.strerror}; choose another --port or --host") from None
    return door
