"""The rig behind UDP as the runner sees it: link, session and faults behind the interface of every rig."""

from __future__ import annotations

import math
import socket
import time
from dataclasses import dataclass, replace
from pathlib import Path

from rths_cli.errors import RigError
from rths_cli.numerics.clock import REAL_TIME
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import COMPILED_LINK, RigInfo
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.fault_sentences import fault_names
from rths_cli.rigs.udp.key_file import read_secret
from rths_cli.rigs.udp.link import Link, begin_session, converse_at, fresh_link, prepare
from rths_cli.rigs.udp.session import GREETING_S, Session, Terms, greet
from rths_cli.rigs.udp.siphash import Words
from rths_cli.rigs.udp.sockets import connected, on_this_machine

ANSWER_SHARE = 0.7  # of the sample interval, in which an answer must come where the rig file does not say
ARMING_TRIES = 50  # to arm a target that does not answer, before a session is begun anew, once
FRESH_S = 5.0  # a target accepts an ARM at least 10 s after its WELCOME
AT_REST_S = 2.0  # within which a target leads its table to rest
RESTING_S = 6.0  # so long it is asked whether it did
SILENT_S = 0.5  # of a peer that is asked to rest, until it is taken for dead
PAUSE_S = 0.02  # between two questions to a target at leisure
IN_S = 1e-9


@dataclass(frozen=True)
class UdpTarget:
    """Where a target is and how patient the runner is with it.

    `timeout_s`: how long to wait for an answer, None for a share of the sample interval. `watchdog_s`: after how long
    without a command the target is to rest its table. `lost_samples`: answers that may miss in a row.
    """

    host: str
    port: int
    key_file: Path | None = None
    timeout_s: float | None = None
    watchdog_s: float = 0.1
    lost_samples: int = 5


class UdpRig:
    """A rig behind UDP, paced by this machine's monotonic clock: `exchange` sends at t_k and takes the samples of t_k.

    `link` serves compiled loops as well, which then count k on from the last step. `at_rest` tells after `rest`
    whether the target confirmed it; `overruns` counts the exchanges asked for more than an interval late.
    """

    offers = (COMPILED_LINK,)

    def __init__(self, info: RigInfo, target: UdpTarget) -> None:
        if info.latency_samples < 1:
            raise RigError(f"rig {info.name}: latency_samples must be at least 1 over UDP, got {info.latency_samples}")
        self.info = info
        self.target = target
        self.at_rest = True
        self.overruns = 0
        self.peer = f"{target.host}:{target.port}"
        self._door: socket.socket | None = None
        self._link: Link | None = None
        self._secret: Words  # what the key file held when the rig was opened
        self._start_ns = 0
        self._greeted_s = 0.0
        self._dt_ns = round(info.dt_s / IN_S)
        self._timeout_ns = round((target.timeout_s or ANSWER_SHARE * info.dt_s) / IN_S)

    @property
    def link(self) -> Link:
        """Return the open link; raises RigError when there is none."""
        if self._link is None:
            raise RigError(f"rig {self.info.name}: the link to {self.peer} is not open")
        return self._link

    @property
    def door(self) -> socket.socket | None:
        """Return the socket of the session, None where there is none."""
        return self._door

    @property
    def next_step(self) -> int:
        """Return the number of the step that the next packet is of, counted from ARM as step 0."""
        link = self.link
        return int(link.status[links.LAST] - link.status[links.BASE]) + 1

    @property
    def counts(self) -> dict[str, int]:
        """Return how many packets were sent, answered, lost, late, doubled, bad, ... in this session."""
        return {name: int(count) for name, count in zip(links.COUNTS, self.link.counts, strict=True)}

    def open(self) -> None:
        """Begin a session with the target; raise RigError when it refuses or stays silent."""
        if not REAL_TIME:
            raise RigError("a rig over UDP needs Linux; offline runs on a virtual rig work here")
        self.close()
        self._secret = read_secret(self.target.key_file)
        prepare(len(self.info.channels))
        self._door, self.peer, session = self._greet()
        self.info = replace(self.info, driver_verified="loopback" if on_this_machine(self._door) else "hardware")
        self._link = fresh_link(self._door, session.key, session.terms.channels, timeout_ns=self._timeout_ns)
        self._begin(session)
        self.at_rest, self.overruns = True, 0

    def arm(self) -> Array:
        """Enable motion and return the samples of step 0 in V, (n_channels,); step k follows k intervals later."""
        link = self.link
        first = bool(link.status[links.LAST] < 0)  # a session that has moved is not begun again
        if first and time.monotonic() - self._greeted_s > FRESH_S:
            self._greet_again()
        self.at_rest = False
        armed = self._armed(first)
        if not armed and first:
            self._greet_again()
            armed = self._armed(False)
        if not armed:
            raise RigError(f"rig {self.info.name}: the target {self.peer} does not answer when it is to arm")
        link.status[links.BASE] = link.status[links.LAST]
        link.counts[:] = 0
        self._start_ns = int(link.status[links.RECEIVED_NS])
        return link.samples_v

    def exchange(self, command_v: float) -> Array:
        """Send a command at the next sample instant, return the samples of that instant in V, (n_channels,).

        After a lost answer they are the last that came. Raises RigError on a fault or when too many were lost.
        """
        link = self.link
        if not math.isfinite(command_v):
            raise RigError(f"rig {self.info.name}: the command is not a number; it was not sent")
        k = self.next_step
        late_ns = time.monotonic_ns() - self._instant_ns(k)
        if late_ns > self._dt_ns:  # sent at once; the instants without a command use up their numbers
            k += late_ns // self._dt_ns
            self._start_ns += late_ns % self._dt_ns
            self.overruns += 1
        instant_ns = self._instant_ns(k)
        converse_at(link, packets.COMMAND, k, float(command_v), instant_ns, self._timeout_ns)
        self._check(f"rig {self.info.name}: the target {self.peer} stopped")
        if link.counts[links.IN_A_ROW] > self.target.lost_samples:
            raise RigError(self._lost())
        return link.samples_v

    def fault(self) -> str:
        """Return what is wrong with target or link, empty when nothing is."""
        try:
            self._check(f"rig {self.info.name}: the target {self.peer} stopped")
        except RigError as fault:
            return str(fault)
        return self._lost() if self.link.counts[links.IN_A_ROW] > self.target.lost_samples else ""

    def rest(self) -> None:
        """Have the target lead its table to rest and disable motion; `at_rest` tells whether it confirmed that.

        Safe at any time: without a session, twice, and with a dead peer, whose own watchdog then rests the table.
        """
        if self._link is None or self.at_rest:
            return
        end = time.monotonic() + RESTING_S
        heard = time.monotonic()
        while not self.at_rest and time.monotonic() < min(end, heard + SILENT_S):
            if self._hears(packets.REST):
                heard = time.monotonic()
                self.at_rest = bool(self._link.status[links.STATE] == packets.RESTED)
                time.sleep(0.0 if self.at_rest else PAUSE_S)

    def close(self) -> None:
        """End the session and let go of the socket; safe to call twice. A table that still moves is led to rest."""
        if self._link is not None and self._link.status[links.LAST] >= 0:  # before ARM the target knows of no session
            for _ in range(3):
                if self._hears(packets.CLOSE):
                    break
        if self._door is not None:
            self._door.close()
        self._door = self._link = None

    def _begin(self, session: Session) -> None:
        """Take a session that the target offers; raise RigError where its terms are others than the rig's."""
        self._check_terms(session.terms)
        self._greeted_s = time.monotonic()
        begin_session(self.link, session.key, session.arming)

    def _greet_again(self) -> None:
        """Begin a session anew, as another runner's or a target's restart may have made the first one worthless.

        The table may be armed although no answer said so; its watchdog rests it then.
        """
        assert self._door is not None  # a link is open
        patience_s = self.target.watchdog_s + AT_REST_S
        self._begin(greet(self._door, self.peer, self._secret, self._wanted(), GREETING_S, patience_s))

    def _armed(self, first: bool) -> bool:
        """Ask the target to arm until it answers, and tell whether it did; raise RigError where it cannot.

        Where this process was held up for so long that the watchdog ended a session of which this is the `first` ARM,
        another one is worth a try.
        """
        for _ in range(ARMING_TRIES):
            if self._ask(packets.ARM) == links.OK:
                return True
            if first and self.link.status[links.FAULTS] == packets.WATCHDOG:
                return False
            self._check(f"rig {self.info.name}: the target {self.peer} does not arm")
        return False

    def _hears(self, kind: int) -> bool:
        """Send a packet without a command; tell whether an answer came, were it to an earlier one that was late."""
        seen = int(self.link.status[links.SEEN])
        self._ask(kind)
        return bool(self.link.status[links.SEEN] > seen)

    def _wanted(self) -> Terms:
        """Return the terms that a session is asked for with."""
        return Terms(len(self.info.channels), self._dt_ns, round(self.target.watchdog_s / IN_S))

    def _greet(self) -> tuple[socket.socket, str, Session]:
        """Return socket, name and session of the first address of the host that answers."""
        found = connected(self.target.host, self.target.port)
        fault: RigError | None = None
        for i, (door, peer) in enumerate(found):
            try:
                session = greet(door, peer, self._secret, self._wanted(), GREETING_S / len(found))
            except RigError as refused:
                door.close()
                fault = fault or refused
                continue
            for other, _ in found[i + 1 :]:
                other.close()
            return door, peer, session
        raise fault or RigError(f"target {self.peer} has no address")

    def _check_terms(self, told: Terms) -> None:
        """Raise RigError where a target grants other terms than were asked for."""
        channels, watchdog_ns = len(self.info.channels), round(self.target.watchdog_s / IN_S)
        if told.channels != channels or told.interval_ns != self._dt_ns:
            raise RigError(
                f"rig {self.info.name}: the target {self.peer} grants {told.channels} channels every "
                f"{told.interval_ns} ns, asked for were {channels} every {self._dt_ns} ns; check its program"
            )
        if not 0 < told.watchdog_ns <= watchdog_ns:
            raise RigError(
                f"rig {self.info.name}: the watchdog of target {self.peer} waits {1e-9 * told.watchdog_ns:g} s, "
                f"the rig file allows {self.target.watchdog_s:g} s; raise watchdog_s or change the target"
            )
        borne_ns = (self.target.lost_samples + 1) * self._dt_ns
        if told.watchdog_ns <= borne_ns:
            raise RigError(
                f"rig {self.info.name}: the watchdog of target {self.peer} waits {1e-9 * told.watchdog_ns:g} s, "
                f"it must wait more than {1e-9 * borne_ns:g} s (lost_samples of the rig file and one more); raise it "
                "or lower lost_samples"
            )

    def _instant_ns(self, k: int) -> int:
        """Return when the command of instant k is due, on the monotonic clock."""
        return self._start_ns + k * self._dt_ns

    def _ask(self, kind: int) -> int:
        """Send a packet without a command and wait shortly for the answer."""
        return int(converse_at(self.link, kind, self.next_step, 0.0, 0, round(PAUSE_S / IN_S)))

    def _check(self, text: str) -> None:
        """Raise RigError where the target reported a fault or left the armed state."""
        status = self.link.status
        if status[links.FAULTS]:
            raise RigError(f"{text}: {fault_names(int(status[links.FAULTS]))}")
        if status[links.STATE] in (packets.RESTING, packets.RESTED):
            raise RigError(f"{text}: it has led its table to rest")

    def _lost(self) -> str:
        """Return why a run ended for lost answers: at the first beyond the limit; more are lost on the way to rest."""
        counts, limit = self.counts, self.target.lost_samples
        return (
            f"rig {self.info.name}: {limit + 1} answers of target {self.peer} in a row were lost, "
            f"limits.lost_samples is {limit} ({counts['lost']} of {counts['sent']} in all, {counts['late']} came late, "
            f"{counts['bad']} were not genuine); check the target, the cable and the sample rate"
        )
