"""`rths serve`: a virtual table with a specimen on it, as a target that a runner reaches over UDP."""

from __future__ import annotations

import ipaddress
import math
import secrets
import shlex
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.clocks import require_real_time
from rths_cli.files.user_cache import user_cache
from rths_cli.loop import serving
from rths_cli.loop.scheduling import NEXT_TO_LAST, at_leisure, real_time
from rths_cli.rigs.udp import wire
from rths_cli.rigs.udp.handshake import open_greeter
from rths_cli.rigs.udp.secret import KEY_FILE_VARIABLE, as_words, make_secret, read_secret
from rths_cli.rigs.udp.sentences import fault_names
from rths_cli.rigs.udp.session import ARM_WORDS, Terms
from rths_cli.rigs.udp.sockets import bound, shown
from rths_cli.workflows.serve_table import ServedRig, describe, make_table

if TYPE_CHECKING:
    from rths_cli.rigs.udp.siphash import Words

SHORTEST_INTERVAL_NS = 100_000
LOOK_S = 0.1  # between two looks at signals
REST_S = 5.0  # the longest a table may take to come to rest
NOT_AT_REST = f"the table was not yet at rest after {REST_S:g} s"
PRIORITY = 79  # below a runner on the same machine
Say = Callable[[str], object]


@dataclass(frozen=True)
class ServeRequest:
    """Hold what the user asked `rths serve` for; no `seconds`: until a signal comes."""

    rig: str
    structure: str
    host: str
    port: int
    key_file: Path | None
    watchdog_s: float
    seconds: float | None
    seed: int
    settings: tuple[str, ...]


@dataclass(frozen=True)
class SessionEnded:
    """How a session went; all packets but its own are counted from its ARM to the next session's.

    `lost`: sequence numbers that never came; `greetings`: genuine HELLO, of runners to come or replayed.
    """

    peer: str
    rate_hz: float
    commands: int
    ended_by: str
    lost: int
    replayed: int
    forged: int
    malformed: int
    greetings: int
    longest_gap_s: float


def serve(request: ServeRequest, say: Say) -> list[SessionEnded]:
    """Serve sessions until the time is over or a signal comes, then rest the table and return what was served.

    Raises InputError for bad input, RigError where the address cannot be had.
    """
    require_real_time()
    rig = describe(request.rig, request.structure, request.settings, request.seed)
    path, secret = _secret(request.key_file)
    with bound(request.host, request.port) as link:
        server = Server(link, secret, rig, round(1e9 * request.watchdog_s), say)
        server.start()
        say(f"{rig.title} at {shown(link.getsockname())}; end with Ctrl-C")
        say(f"key file {path}; a runner on this machine learns of it by")
        say(f"export {KEY_FILE_VARIABLE}={shlex.quote(str(path))}")
        if not ipaddress.ip_address(link.getsockname()[0]).is_loopback:
            say("warning: reachable from other machines; packets are authenticated with the key file, not encrypted")
        try:
            server.run_for(request.seconds)
        finally:
            say("ended; the table was led to rest" if server.at_rest else f"ended; {NOT_AT_REST}")
    return server.ended


class Server:
    """The sessions of a served rig, one after the other, in a thread of its own."""

    def __init__(self, link: socket.socket, secret: Words, rig: ServedRig, watchdog_ns: int, say: Say) -> None:
        self.ended: list[SessionEnded] = []
        self._link, self._rig, self._say = link, rig, say
        self._orders = np.zeros(1, np.int64)
        self._ready, self._done = threading.Event(), threading.Event()
        self._fault: BaseException | None = None
        self._peer, self._told = "", True
        self._terms = Terms(rig.channels, round(1e9 * rig.usual_dt_s), watchdog_ns)
        greeter = open_greeter(secret, rig.channels, SHORTEST_INTERVAL_NS, watchdog_ns)
        nobody = as_words(secrets.token_bytes(16))  # there is no session yet
        self._table = make_table(rig, self._terms.interval_ns)
        self._door = serving.open_door(link, greeter, nobody, self._terms.interval_ns, watchdog_ns, self._orders)
        serving.serve_packets.bind(self._door, self._table)  # compiled before anyone waits for an answer

    def start(self) -> None:
        """Begin to serve, and return when the thread that does so has what it needs from the system."""
        threading.Thread(target=self._serve, name="rths serve", daemon=True).start()
        while not self._ready.wait(LOOK_S):
            pass

    @property
    def at_rest(self) -> bool:
        """Tell whether the served table stands still."""
        return self._door.session[serving.STATE] in (wire.IDLE, wire.RESTED)

    def run_for(self, seconds: float | None) -> None:
        """Serve on for a time, or until an exception such as a signal's ends it; the table is then led to rest."""
        end = time.monotonic() + seconds if seconds is not None else math.inf
        try:
            while not self._done.wait(min(LOOK_S, max(end - time.monotonic(), 0.0))) and time.monotonic() < end:
                pass
        finally:
            self._orders[0] = 1
            self._done.wait(REST_S)  # a signal that interrupts Thread.join makes it take the thread for ended
        if self._fault is not None:
            raise self._fault

    def _serve(self) -> None:
        try:
            with real_time(PRIORITY, NEXT_TO_LAST) as granted:
                for sentence in granted.refused:
                    self._say(f"note: {sentence}")
                self._ready.set()
                event = serving.ENDED
                while event != serving.ORDERED:
                    with at_leisure():  # the table is at rest: nobody's flood of packets stops this processor
                        event = self._serve_on()
                    if event == serving.BEGUN:
                        self._begin()
                        event = self._serve_on()
        except BaseException as fault:  # raised again by the thread that waits for this one
            self._fault = fault
        finally:
            self._ready.set()
            self._done.set()

    def _serve_on(self) -> int:
        """Serve until something is to be done, and say how the session ended where it did."""
        event = int(serving.serve_packets(self._door, self._table))
        self._tell_end()
        return event

    def _begin(self) -> None:
        """Begin the session whose ARM was received: it replaces the last one, whose table is at rest."""
        words = self._door.incoming[wire.WORDS : wire.WORDS + 8 * wire.ARM_WORDS].tobytes()
        self._terms = Terms(*struct.unpack(ARM_WORDS, words)[1:])
        self._table = make_table(self._rig, self._terms.interval_ns)
        self._door = serving.begin_session(self._door, self._terms.interval_ns, self._terms.watchdog_ns)
        self._peer, self._told = shown(socket_address(self._door.address)), False

    def _tell_end(self) -> None:
        """Note and say, once, how a session ended whose table was armed."""
        if self._door.counts[serving.OBEYED] and not self._told:
            self.ended.append(summary(self._door, self._peer, self._terms))
            self._say(sentence(len(self.ended), self.ended[-1]))
            self._told = True


def summary(door: serving.Door, peer: str, terms: Terms) -> SessionEnded:
    """Return how the session of a door went."""
    faults, closed = int(door.session[serving.FAULTS]), door.session[serving.CLOSING] > 0
    count = [int(number) for number in door.counts]
    tick_s = 1e-9 * terms.interval_ns / serving.TICKS_PER_INTERVAL
    return SessionEnded(
        peer=peer,
        rate_hz=1e9 / terms.interval_ns,
        commands=count[serving.OBEYED],
        ended_by=fault_names(faults)
        or ("the server was told to end" if door.orders[0] else "")
        or ("the runner closed it" if closed else "the runner had the table rest"),
        lost=count[serving.LOST],
        replayed=count[serving.REPLAYED],
        forged=count[serving.FORGED],
        malformed=count[serving.MALFORMED],
        greetings=count[serving.GREETED],
        longest_gap_s=int(door.session[serving.LONGEST_TICKS]) * tick_s,
    )


def sentence(number: int, ended: SessionEnded) -> str:
    """Return the line of a session."""
    return (
        f"session {number} with {ended.peer} at {ended.rate_hz:g} Hz: {ended.commands} commands, lost {ended.lost}, "
        f"doubled or late {ended.replayed}, forged {ended.forged}, malformed {ended.malformed}, HELLO "
        f"{ended.greetings}, longest gap {1e3 * ended.longest_gap_s:.2f} ms; ended: {ended.ended_by}"
    )


def socket_address(data: serving.Bytes) -> tuple[str, int] | tuple[str, int, int, int]:
    """Return a socket address of the system as Python spells it."""
    raw = data.tobytes()
    port = int.from_bytes(raw[2:4], "big")
    if int.from_bytes(raw[:2], "little") == socket.AF_INET:
        return socket.inet_ntop(socket.AF_INET, raw[4:8]), port
    flow, scope = int.from_bytes(raw[4:8], "big"), int.from_bytes(raw[24:28], "little")
    return socket.inet_ntop(socket.AF_INET6, raw[8:24]), port, flow, scope


def _secret(key_file: Path | None) -> tuple[Path, Words]:
    """Return the key file and what it holds; without one named, that in the user's cache, made at the first need."""
    path = (key_file or user_cache() / "serve.key").absolute()
    if key_file is None and not path.exists():
        return path, make_secret(path)
    return path, read_secret(path)
