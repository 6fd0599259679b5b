"""The work of `rths serve`: run a virtual table as a keyed or plain UDP target; report the end of each session."""

from __future__ import annotations

import ipaddress
import json
import math
import secrets
import shlex
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.case.rig_schema import is_loopback, not_private
from rths_cli.case.structure_schema import without_dashpots
from rths_cli.errors import InputError
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, guard_limits, open_virtual
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.loop import plain_target, udp_target
from rths_cli.loop.guard import fresh_guard
from rths_cli.loop.scheduling import NEXT_TO_LAST, at_leisure, real_time
from rths_cli.loop.udp_target import TICKS_PER_INTERVAL, Table
from rths_cli.numerics.clock import require_real_time
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import capabilities_of
from rths_cli.rigs.from_case import simulated
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.fault_sentences import fault_names
from rths_cli.rigs.udp.handshake import open_greeter
from rths_cli.rigs.udp.late_command_trajectory import fresh_way
from rths_cli.rigs.udp.session import (
    ARM_WORDS,
    KEY_FILE_VARIABLE,
    Terms,
    as_words,
    bound,
    make_secret,
    read_secret,
    shown,
)
from rths_cli.rigs.virtual.virtual_rig import fresh_state, virtual_rig
from rths_cli.user_cache import user_cache

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import VirtualRigSpec
    from rths_cli.rigs.udp.packets import Words
    from rths_cli.rigs.virtual.imperfect.plant import ImperfectPlant
    from rths_cli.rigs.virtual.plant_kernel import Plant

SHORTEST_INTERVAL_NS = 100_000
LOOK_S = 0.1  # interval at which signals are handled
REST_S = 5.0  # longest time in which a table comes to rest
NOT_AT_REST = f"the table was not yet at rest after {REST_S:g} s"
PRIORITY = 79  # below a runner on the same machine
Say = Callable[[str], object]

CASE = "el_centro_low_ff_fb"  # supplies the keys that rig and structure do not state
NOISE_ROWS = 1 << 17  # length of the noise, 131 s at 1 kHz, after which it repeats


@dataclass(frozen=True)
class ServeRequest:
    """Arguments of `rths serve`."""

    rig: str  # name or file of a virtual rig
    structure: str  # name or file of the structure whose specimen stands on it
    host: str  # address to listen at
    port: int
    key_file: Path | None  # None: serve.key in the user's cache, created if missing
    watchdog_s: float  # time without a command after which the target stops the table
    seconds: float | None  # duration; None: until a signal arrives
    seed: int  # of the sensors' noise
    settings: tuple[str, ...]  # KEY=VALUE each
    plain_peer: str = ""  # ADDRESS:PORT of the runner at the other end of a plain link; "": the keyed link
    of_target: bool = False  # on a plain link, this target has the clock


@dataclass(frozen=True)
class SessionEnded:
    """Summary of a session; foreign packets are counted from its ARM to that of the next session."""

    peer: str  # address of the runner
    rate_hz: float
    commands: int  # that the table followed
    ended_by: str  # cause of the end, in words
    lost: int  # sequence numbers that never arrived
    replayed: int  # packets that arrived twice or late
    forged: int  # packets without a valid authentication
    malformed: int
    greetings: int  # authentic HELLO packets, of later runners or replayed
    longest_gap_s: float  # longest time between two commands


def serve(request: ServeRequest, say: Say) -> list[SessionEnded]:
    """Serve sessions until the time is over or a signal arrives, then bring the table to rest; return the sessions.

    Raises InputError for bad input, RigError if the address is not available.
    """
    require_real_time()
    rig = describe(request.rig, request.structure, request.settings, request.seed)
    if request.plain_peer:
        return _serve_plain(request, rig, say)
    path, secret = _secret(request.key_file)
    with bound(request.host, request.port) as link:
        server = Server(link, secret, rig, round(1e9 * request.watchdog_s), say)
        server.start()
        say(f"{rig.title} at {shown(link.getsockname())}; end with Ctrl-C")
        say(f"key file {path}; in the other terminal, type:")
        say(f"export {KEY_FILE_VARIABLE}={shlex.quote(str(path))}")
        if not ipaddress.ip_address(link.getsockname()[0]).is_loopback:
            say("warning: reachable from other machines; packets are authenticated with the key file, not encrypted")
        _run(server, request.seconds, say)
    return server.ended


def _run(server: Server, seconds: float | None, say: Say) -> None:
    try:
        server.run_for(seconds)
    finally:
        say("ended; the table was led to rest" if server.at_rest else f"ended; {NOT_AT_REST}")


def _serve_plain(request: ServeRequest, rig: ServedRig, say: Say) -> list[SessionEnded]:
    """Serve at one end of a private cable; raises InputError for addresses that may not be one."""
    there = end_of_cable(request.host, request.plain_peer, request.key_file)
    with bound(request.host, request.port) as link:
        link.connect(there)
        server = PlainServer(link, request.of_target, rig, round(1e9 * request.watchdog_s), say)
        server.start()
        clock = f"its own clock at {1.0 / rig.usual_dt_s:g} Hz" if request.of_target else "the runner's clock"
        say(f"{rig.title} at {shown(link.getsockname())} for {request.plain_peer} alone, on {clock}; end with Ctrl-C")
        say("warning: frames carry no key; whoever can send on this cable moves the table")
        _run(server, request.seconds, say)
    return server.ended


def end_of_cable(here: str, peer: str, key_file: Path | None = None) -> tuple[str, int]:
    """Return the other end of a private cable; raises InputError for addresses that may not be one."""
    host, _, port = peer.rpartition(":")
    faults = [
        f"{option}: {fault}" for option, one in (("--host", here), ("--peer", host)) if (fault := not_private(one))
    ]
    if not faults and is_loopback(host) != is_loopback(here):
        faults.append(f"--peer: must be reached from --host {here}, got {host}: only one of them is loopback")
    if not port.isdecimal() or not 1 <= int(port) <= 65535:
        faults.append(f"--peer: must be ADDRESS:PORT, got {peer!r}; give own_port of the rig file")
    if key_file is not None:
        faults.append("--key-file: frames of the plain link carry no key; leave it out")
    if faults:
        raise InputError(*faults)
    return host, int(port)


class Server:
    """Serves the sessions of a rig, one after the other, in a separate thread."""

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
        self._door = udp_target.open_door(link, greeter, nobody, self._terms.interval_ns, watchdog_ns, self._orders)
        self._prepare()

    def _prepare(self) -> None:
        """Compile what serves before anyone waits for an answer."""
        udp_target.serve_packets.bind(self._door, self._table)

    def _event(self) -> int:
        """Serve until an event occurs; return it."""
        return int(udp_target.serve_packets(self._door, self._table))

    def _ended(self, number: int, ended: SessionEnded) -> str:
        """Return what is printed of a session."""
        return sentence(number, ended)

    def start(self) -> None:
        """Start to serve; return when the server thread has its real-time properties."""
        threading.Thread(target=self._serve, name="rths serve", daemon=True).start()
        while not self._ready.wait(LOOK_S):
            pass

    @property
    def table(self) -> Table:
        """Return the served table of this session, its arrays shared with the thread that moves it."""
        return self._table

    @property
    def door(self) -> udp_target.Door:
        """Return socket, keys and counts of this session, its arrays shared with the thread that serves."""
        return self._door

    def end(self) -> None:
        """Order the thread to lead the table to rest and end; returns at once."""
        self._orders[0] = 1

    @property
    def at_rest(self) -> bool:
        """Return whether the served table is at rest."""
        return self._door.session[udp_target.STATE] in (packets.IDLE, packets.RESTED)

    def run_for(self, seconds: float | None) -> None:
        """Serve for a time, or until an exception (from a signal, for instance); then bring the table to rest."""
        end = time.monotonic() + seconds if seconds is not None else math.inf
        try:
            while not self._done.wait(min(LOOK_S, max(end - time.monotonic(), 0.0))) and time.monotonic() < end:
                pass
        finally:
            self.end()
            self._done.wait(REST_S)  # a signal that interrupts Thread.join makes it take the thread for ended
        if self._fault is not None:
            raise self._fault

    def _serve(self) -> None:
        try:
            with real_time(PRIORITY, NEXT_TO_LAST) as granted:
                for sentence in granted.refused:
                    self._say(f"note: {sentence}")
                self._ready.set()
                event = udp_target.ENDED
                while event != udp_target.ORDERED:
                    with at_leisure():  # the table is at rest: nobody's flood of packets stops this processor
                        event = self._serve_on()
                    if event == udp_target.BEGUN:
                        self._begin()
                        event = self._serve_on()
        except BaseException as fault:  # raised again by the thread that waits for this one
            self._fault = fault
        finally:
            self._ready.set()
            self._done.set()

    def _serve_on(self) -> int:
        """Serve until an event occurs, and report the end of a session."""
        event = self._event()
        self._tell_end()
        return event

    def _begin(self) -> None:
        """Begin the session whose ARM was received: it replaces the last one, whose table is at rest."""
        words = self._door.incoming[packets.WORDS : packets.WORDS + 8 * packets.ARM_WORDS].tobytes()
        self._terms = Terms(*struct.unpack(ARM_WORDS, words)[1:])
        self._table = make_table(self._rig, self._terms.interval_ns)
        self._door = udp_target.begin_session(self._door, self._terms.interval_ns, self._terms.watchdog_ns)
        self._peer, self._told = shown(socket_address(self._door.address)), False

    def _tell_end(self) -> None:
        """Store and report, once, the end of a session whose table was armed."""
        if self._door.counts[udp_target.OBEYED] and not self._told:
            self.ended.append(summary(self._door, self._peer, self._terms))
            self._say(self._ended(len(self.ended), self.ended[-1]))
            self._told = True


class PlainServer(Server):
    """Serves the sessions of a rig at the end of a plain link, over a connected socket."""

    def __init__(self, link: socket.socket, of_target: bool, rig: ServedRig, watchdog_ns: int, say: Say) -> None:
        self._side = plain_target.open_side(of_target)
        super().__init__(link, as_words(bytes(16)), rig, watchdog_ns, say)  # the key is never used

    def _prepare(self) -> None:
        plain_target.serve_frames.bind(self._door, self._side, self._table)

    def _event(self) -> int:
        return int(plain_target.serve_frames(self._door, self._side, self._table))

    def _begin(self) -> None:
        """Begin the session whose BEGIN was received, with a table at rest."""
        self._table = make_table(self._rig, self._terms.interval_ns)
        self._door = udp_target.begin_session(self._door, self._terms.interval_ns, self._terms.watchdog_ns)
        self._peer, self._told = shown(self._link.getpeername()), False

    def _ended(self, number: int, ended: SessionEnded) -> str:
        """Return the sentence in the words of frames: none of them is forged or a HELLO."""
        told = sentence(number, ended)
        return told.replace("forged", "of another session").replace("HELLO", "questions")


def summary(door: udp_target.Door, peer: str, terms: Terms) -> SessionEnded:
    """Return the summary of a session."""
    faults, closed = int(door.session[udp_target.FAULTS]), door.session[udp_target.CLOSING] > 0
    count = [int(number) for number in door.counts]
    tick_s = 1e-9 * terms.interval_ns / udp_target.TICKS_PER_INTERVAL
    return SessionEnded(
        peer=peer,
        rate_hz=1e9 / terms.interval_ns,
        commands=count[udp_target.OBEYED],
        ended_by=fault_names(faults)
        or ("the server was told to end" if door.orders[0] else "")
        or ("the runner closed it" if closed else "the runner had the table rest"),
        lost=count[udp_target.LOST],
        replayed=count[udp_target.REPLAYED],
        forged=count[udp_target.FORGED],
        malformed=count[udp_target.MALFORMED],
        greetings=count[udp_target.GREETED],
        longest_gap_s=int(door.session[udp_target.LONGEST_TICKS]) * tick_s,
    )


def sentence(number: int, ended: SessionEnded) -> str:
    """Return the printed line on a session."""
    return (
        f"session {number} with {ended.peer} at {ended.rate_hz:g} Hz: {ended.commands} commands, lost {ended.lost}, "
        f"doubled or late {ended.replayed}, forged {ended.forged}, malformed {ended.malformed}, HELLO "
        f"{ended.greetings}, longest gap {1e3 * ended.longest_gap_s:.2f} ms; ended: {ended.ended_by}"
    )


def socket_address(data: udp_target.Bytes) -> tuple[str, int] | tuple[str, int, int, int]:
    """Return a socket address in Python's form from the bytes of a sockaddr structure."""
    raw = data.tobytes()
    port = int.from_bytes(raw[2:4], "big")
    if int.from_bytes(raw[:2], "little") == socket.AF_INET:
        return socket.inet_ntop(socket.AF_INET, raw[4:8]), port
    flow, scope = int.from_bytes(raw[4:8], "big"), int.from_bytes(raw[24:28], "little")
    return socket.inet_ntop(socket.AF_INET6, raw[8:24]), port, flow, scope


def _secret(key_file: Path | None) -> tuple[Path, Words]:
    """Return the key file and its secret; None: the file in the user's cache, which is created if missing."""
    path = (key_file or user_cache() / "serve.key").absolute()
    if key_file is None and not path.exists():
        return path, make_secret(path)
    return path, read_secret(path)


@dataclass(frozen=True)
class ServedRig:
    """A virtual rig with its specimen; its noise is that of the offline run EXP-RTHS with the same seed."""

    setup: Setup
    table: VirtualRigSpec
    seed: int

    @property
    def title(self) -> str:
        """Return rig and specimen in words."""
        floors, further = len(self.setup.rig.channels) - 1, len(self.setup.rig.further)
        beside = f" and {further} further channels" if further else ""
        return f"rig {self.setup.rig.name} with {floors} floors of {self.setup.case.structure.name}{beside}"

    @property
    def channels(self) -> int:
        """Return the number of channels of the rig."""
        return len(self.setup.rig.all_channels)

    @property
    def usual_dt_s(self) -> float:
        """Return the default sample interval in s, that of the case from which the rig is made."""
        return self.setup.rig.dt_s

    @cached_property
    def noise(self) -> Array:
        """Return rows of standard normal noise, (NOISE_ROWS, normals of the rig)."""
        return open_virtual(self.setup, (EXP_RTHS,), self.seed).noise(NOISE_ROWS)


def describe(rig: str, structure: str, settings: tuple[str, ...], seed: int) -> ServedRig:
    """Return a rig file's virtual table with a structure's specimen; raises InputError."""
    from rths_cli.case.load import load_cases

    named = (f"table={json.dumps(rig)}", f"structure={json.dumps(structure)}", "damping={first_mode_ratio: 0.03}")
    typed = dict(zip(named, (f"rths serve {rig}", f"--structure {structure}", ""), strict=True))
    case = load_cases([CASE], (*named, *settings), typed)[0]
    if capabilities_of(case.table.kind).moves_hardware:
        raise InputError(f"{rig}: its kind is {case.table.kind}; only a virtual rig can be served")
    undamped = case.damping.model_copy(
        update={"first_mode_ratio": None, **without_dashpots(case.structure)}
    )  # the computed storeys are not served
    return ServedRig(make_setup(case.model_copy(update={"damping": undamped})), simulated(case), seed)


def make_table(rig: ServedRig, interval_ns: int) -> Table:
    """Return table and specimen at rest, in ticks of a quarter of the interval."""
    tick_s = 1e-9 * interval_ns / TICKS_PER_INTERVAL
    plant = _plant(rig, tick_s)
    return Table(
        plant,
        fresh_state(plant, 0),
        guard_limits(rig.setup)._replace(dt_s=tick_s),
        fresh_guard(len(rig.setup.rig.channels)),
        rig.noise,
        np.zeros(rig.channels),
        np.zeros(2),
        fresh_way(),
    )


def _plant(rig: ServedRig, tick_s: float) -> Plant | ImperfectPlant:
    info = replace(rig.setup.rig, dt_s=tick_s, latency_samples=0)
    building = rig.setup.building
    mass = building.interface_experimental_mass_kg
    return virtual_rig(rig.table, info, building.specimen, mass, (0,), True, case_seed=rig.seed).plant
