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
from rths_cli.rigs.interface import COMPILED_LINK, Commands, RigInfo, one_actuator, only_command
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.fault_sentences import fault_names
from rths_cli.rigs.udp.link import Link, begin_session, converse_at, fresh_link, prepare
from rths_cli.rigs.udp.packets import Words
from rths_cli.rigs.udp.session import GREETING_S, Session, Terms, connected, greet, on_this_machine, read_secret

ANSWER_SHARE = 0.7  # default timeout of an answer over the sample interval
ARMING_TRIES = 50  # ARM packets without an answer before a new session is begun, once
FRESH_S = 5.0  # age of a WELCOME after which a new one is requested; a target accepts an ARM for at least 10 s
AT_REST_S = 2.0  # time in which a target brings its table to rest
RESTING_S = 6.0  # time in which the target is asked to confirm that
SILENT_S = 0.5  # a target that does not answer REST for this time counts as dead
PAUSE_S = 0.02  # interval of packets that are not time-critical
IN_S = 1e-9


@dataclass(frozen=True)
class UdpTarget:
    """Address of a target, and the limits of its exchange."""

    host: str
    port: int
    key_file: Path | None = None  # None: the file that RTHS_KEY_FILE names
    timeout_s: float | None = None  # longest wait for an answer; None: ANSWER_SHARE of the sample interval
    watchdog_s: float = 0.1  # requested watchdog: longest time without a command
    lost_samples: int = 5  # tolerated number of consecutive lost answers


class UdpRig:
    """A rig behind UDP, clocked by this machine's monotonic clock: `exchange` sends at t_k and returns its samples.

    Compiled loops use `link` directly and continue to count k from the last step. After `rest`, `at_rest` states
    whether the target confirmed it. `overruns` counts the exchanges that were requested more than an interval late.
    """

    offers = (COMPILED_LINK,)

    def __init__(self, info: RigInfo, target: UdpTarget) -> None:
        one_actuator(info)
        if info.latency_samples < 1:
            raise RigError(f"rig {info.name}: latency_samples must be at least 1 over UDP, got {info.latency_samples}")
        self.info = info
        self.target = target
        self.at_rest = True
        self.overruns = 0
        self.peer = f"{target.host}:{target.port}"
        self._door: socket.socket | None = None
        self._link: Link | None = None
        self._secret: Words  # content of the key file when the rig was opened
        self._start_ns = 0
        self._greeted_s = 0.0
        self._dt_ns = round(info.dt_s / IN_S)
        self._timeout_ns = round((target.timeout_s or ANSWER_SHARE * info.dt_s) / IN_S)

    @property
    def link(self) -> Link:
        """Return the open link; raises RigError if the rig is not open."""
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
        """Begin a session with the target; raises RigError if it refuses or stays silent."""
        if not REAL_TIME:
            raise RigError("a rig over UDP needs Linux; offline runs on a virtual rig work here")
        self.close()
        self._secret = read_secret(self.target.key_file)
        prepare(len(self.info.all_channels))
        self._door, self.peer, session = self._greet()
        self.info = replace(self.info, driver_verified="loopback" if on_this_machine(self._door) else "hardware")
        self._link = fresh_link(self._door, session.key, session.terms.channels, timeout_ns=self._timeout_ns)
        self._begin(session)
        self.at_rest, self.overruns = True, 0

    def arm(self) -> Array:
        """Enable motion and return the samples of step 0 in V, (n_channels,); step k follows k intervals later."""
        link = self.link
        first = bool(link.status[links.LAST] < 0)  # a session that has been armed is not begun again
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

    def exchange(self, command_v: Commands) -> Array:
        """Send a command in V at the next sample instant; return the samples of that instant in V, (n_channels,).

        After a lost answer they are the last samples that came. Raises RigError on a fault, or if too many answers were
        lost.
        """
        link, volts = self.link, only_command(self.info, command_v)
        if not math.isfinite(volts):
            raise RigError(f"rig {self.info.name}: the command is not a number; it was not sent")
        k = self.next_step
        late_ns = time.monotonic_ns() - self._instant_ns(k)
        if late_ns > self._dt_ns:  # sent at once; the numbers of the missed instants are skipped
            k += late_ns // self._dt_ns
            self._start_ns += late_ns % self._dt_ns
            self.overruns += 1
        instant_ns = self._instant_ns(k)
        converse_at(link, packets.COMMAND, k, volts, instant_ns, self._timeout_ns)
        self._check(f"rig {self.info.name}: the target {self.peer} stopped")
        if link.counts[links.IN_A_ROW] > self.target.lost_samples:
            raise RigError(self._lost())
        return link.samples_v

    def fault(self) -> str:
        """Return the fault of target or link, "" without one."""
        try:
            self._check(f"rig {self.info.name}: the target {self.peer} stopped")
        except RigError as fault:
            return str(fault)
        return self._lost() if self.link.counts[links.IN_A_ROW] > self.target.lost_samples else ""

    def rest(self) -> None:
        """Let the target bring its table to rest and disable motion; `at_rest` states whether it confirmed that.

        It may be called at any time: without a session, twice, and with a dead peer, whose watchdog then acts.
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
        """End the session and close the socket; safe to call twice. A moving table is brought to rest."""
        if self._link is not None and self._link.status[links.LAST] >= 0:  # before ARM the target has no session
            for _ in range(3):
                if self._hears(packets.CLOSE):
                    break
        if self._door is not None:
            self._door.close()
        self._door = self._link = None

    def _begin(self, session: Session) -> None:
        """Accept a session that the target offers; raises RigError if its terms differ from the rig's."""
        self._check_terms(session.terms)
        self._greeted_s = time.monotonic()
        begin_session(self.link, session.key, session.arming)

    def _greet_again(self) -> None:
        """Begin a new session, because another runner or a restart of the target may have invalidated the first one.

        The table may be armed although no answer arrived; then its watchdog brings it to rest.
        """
        assert self._door is not None  # a link is open
        patience_s = self.target.watchdog_s + AT_REST_S
        self._begin(greet(self._door, self.peer, self._secret, self._wanted(), GREETING_S, patience_s))

    def _armed(self, first: bool) -> bool:
        """Send ARM until the target answers; return whether it did. Raises RigError if the target cannot arm.

        If this process was stalled until the watchdog ended a session right after its `first` ARM, False is returned,
        so that another session can be tried.
        """
        for _ in range(ARMING_TRIES):
            if self._ask(packets.ARM) == links.OK:
                return True
            if first and self.link.status[links.FAULTS] == packets.WATCHDOG:
                return False
            self._check(f"rig {self.info.name}: the target {self.peer} does not arm")
        return False

    def _hears(self, kind: int) -> bool:
        """Send a packet without a command; return whether any answer came, also a late one to an earlier packet."""
        seen = int(self.link.status[links.SEEN])
        self._ask(kind)
        return bool(self.link.status[links.SEEN] > seen)

    def _wanted(self) -> Terms:
        """Return the requested terms of a session."""
        return Terms(len(self.info.all_channels), self._dt_ns, round(self.target.watchdog_s / IN_S))

    def _greet(self) -> tuple[socket.socket, str, Session]:
        """Return socket, name and session for the first address of the host that answers."""
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
        """Raise RigError if the granted terms differ from the requested ones."""
        channels, watchdog_ns = len(self.info.all_channels), round(self.target.watchdog_s / IN_S)
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
        """Raise RigError if the target reported a fault or left the armed state."""
        status = self.link.status
        if status[links.FAULTS]:
            raise RigError(f"{text}: {fault_names(int(status[links.FAULTS]))}")
        if status[links.STATE] in (packets.RESTING, packets.RESTED):
            raise RigError(f"{text}: it has left the test and leads its table to rest")

    def _lost(self) -> str:
        """Return the sentence on a run that ended because of lost answers.

        It states the number at which the run ended, because more answers may be lost on the way to rest.
        """
        counts, limit = self.counts, self.target.lost_samples
        return (
            f"rig {self.info.name}: {limit + 1} answers of target {self.peer} in a row were lost, "
            f"limits.lost_samples is {limit} ({counts['lost']} of {counts['sent']} in all, {counts['late']} came late, "
            f"{counts['bad']} were not genuine); check the target, the cable and the sample rate"
        )
