"""The rig at the end of a private cable, behind plain frames without a key (docs/reference/plain_link.md)."""

from __future__ import annotations

import math
import select
import socket
import time
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import RigError
from rths_cli.numerics.clock import REAL_TIME
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import Commands, RigInfo, only_command
from rths_cli.rigs.udp import link as links
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.fault_sentences import fault_names
from rths_cli.rigs.udp.link import converse_at, fresh_link, prepare
from rths_cli.rigs.udp.plain_frames import (
    ASK,
    AT_REST,
    BEGIN,
    COMMAND,
    LARGEST_NUMBER,
    RUNNING,
    Frame,
    packed,
    unpacked,
)
from rths_cli.rigs.udp.session import on_this_machine, shown
from rths_cli.rigs.udp.udp_rig import AT_REST_S, PAUSE_S, UdpRig, UdpTarget

GREETING_S, ASK_S = 5.0, 0.1
ARMING_S = 2.0
PACED_FRAMES, PACE_SHARE, PACE_TRIES = 100, 0.01, 10  # of a target's pace: frames, largest relative error, tries
PATIENCE = 1.7  # intervals until the next frame of a target with its own clock is lost
ECHOES = 50  # answers after which the least latency that they show is judged


@dataclass(frozen=True)
class Cable:
    """The two ends of a private cable; `of_target`: the target has the sample clock."""

    interface: str
    own_port: int
    host: str
    port: int
    of_target: bool


def connected(rig: str, cable: Cable) -> socket.socket:
    """Return a socket between the two ends: nothing from elsewhere is received; raises RigError naming the `rig`."""
    door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        door.bind((cable.interface, cable.own_port))
        door.connect((cable.host, cable.port))
    except OSError as error:
        door.close()
        ends = f"from link.interface {cable.interface} port {cable.own_port} to {cable.host}"
        raise RigError(
            f"rig {rig}: {ends}: {error.strerror}; the interface must be an address of this machine, "
            "on the target's network, and no other program may have the port"
        ) from None
    door.setblocking(False)
    return door


class PlainRig(UdpRig):
    """A rig behind plain frames: as `UdpRig`, without key and terms.

    Where the target has the clock, `exchange` sends at once and waits for the frame of the target's next instant.
    """

    def __init__(self, info: RigInfo, cable: Cable, watchdog_s: float, timeout_s: float | None = None) -> None:
        target = UdpTarget(cable.host, cable.port, None, timeout_s, watchdog_s, info.limits.lost_samples)
        super().__init__(info, target)
        self.cable = cable

    @property
    def next_step(self) -> int:
        """Return the number of the step that the next frame is of; a target with its own clock sets it."""
        status = self.link.status
        newest = max(status[links.LAST], status[links.SEEN]) if self.cable.of_target else status[links.LAST]
        return int(newest - status[links.BASE]) + 1

    def open(self) -> None:
        """Find the target with its table at rest; raises RigError if it is silent, moves or is another one."""
        if not REAL_TIME:
            raise RigError("a rig over UDP needs Linux; offline runs on a virtual rig work here")
        self.close()
        channels = len(self.info.all_channels)
        prepare(channels)
        door = self._door = connected(self.info.name, self.cable)
        self.peer = shown(door.getpeername())
        self.info = replace(self.info, driver_verified="loopback" if on_this_machine(door) else "hardware")
        timeout_ns = links.NO_TIMEOUT_NS if self.cable.of_target else self._timeout_ns
        link = self._link = fresh_link(door, np.zeros(2, np.uint64), channels, timeout_ns=timeout_ns)
        link.plain[links.PLAIN], link.plain[links.OF_TARGET] = 1, int(self.cable.of_target)
        self.at_rest, self.overruns = True, 0
        self._at_rest()
        if self.cable.of_target:
            self._check_pace()

    def arm(self) -> Array:
        """Begin a session and return the samples of step 0 in V, (n_channels,); raises RigError if it does not begin.

        A rig that was armed before is brought to rest first: each session begins at rest.
        """
        if not self.at_rest:
            self.rest()
        session = self._at_rest().session + 1
        if session > LARGEST_NUMBER:
            raise RigError(
                f"rig {self.info.name}: the target {self.peer} has counted {session - 1} sessions; restart it"
            )
        self.at_rest = False
        self.discard()
        self._take_first(self._begun(session))
        return self.link.samples_v

    def exchange(self, command_v: Commands) -> Array:
        """Send a command in V for the next sample instant; return the samples of that instant in V, (n_channels,).

        Raises RigError as `UdpRig.exchange` does, and where the target's frames show another latency than declared.
        """
        if not self.cable.of_target:
            samples_v = super().exchange(command_v)
        else:
            samples_v = self._exchange_paced(only_command(self.info, command_v))
        self._check_latency()
        return samples_v

    def asked(self, timeout_s: float = ASK_S) -> Frame | None:
        """Return a frame of the target without commanding anything, None if none comes in time.

        A target that has the clock sends by itself; the other one is asked, which is no command.
        """
        if not self.cable.of_target:
            self._post(Frame(0, 0, 0, ASK, time.monotonic(), 0.0))
        found = self._next_frame(timeout_s)
        return found if isinstance(found, Frame) else None

    def discard(self) -> None:
        """Forget the frames that wait: those of before are no news."""
        while self._next_frame(0.0) is not None:
            pass

    def post_command(self, volts: float) -> None:
        """Send a command with the next number of the session and wait for nothing."""
        link = self.link
        session, number = int(link.plain[links.SESSION]), int(link.status[links.BASE]) + self.next_step
        link.status[links.LAST] = number
        self._post(Frame(session, number, max(int(link.status[links.SEEN]), 0), COMMAND, time.monotonic(), volts))

    def _exchange_paced(self, volts: float) -> Array:
        if not math.isfinite(volts):
            raise RigError(f"rig {self.info.name}: the command is not a number; it was not sent")
        link = self.link
        k = int(link.status[links.LAST] - link.status[links.BASE]) + 1
        converse_at(link, packets.COMMAND, k, volts, 0, round(PATIENCE * self._dt_ns))
        self._check(f"rig {self.info.name}: the target {self.peer} stopped")
        if link.counts[links.IN_A_ROW] > self.target.lost_samples:
            raise RigError(self._lost())
        return link.samples_v

    def _at_rest(self) -> Frame:
        """Return a frame of the target whose table is at rest; raises RigError where none comes."""
        begun, told = time.monotonic(), ""
        patience_s = GREETING_S
        self.discard()
        while time.monotonic() < begun + patience_s:
            if not self.cable.of_target:
                self._post(Frame(0, 0, 0, ASK, time.monotonic(), 0.0))
            found = self._next_frame(ASK_S)
            if isinstance(found, str):
                told = found
            elif found is not None and found.order == AT_REST:
                return found
            elif found is not None:
                patience_s = max(GREETING_S, self.target.watchdog_s + AT_REST_S)
                told = "its table is running or not yet at rest: another runner has it, or its watchdog does not act"
        where = f"rig {self.info.name}: the target {self.peer}"
        if told:
            raise RigError(f"{where} cannot be used: {told}")
        sends = "sends by itself (clock: target)" if self.cable.of_target else "answers (clock: runner)"
        raise RigError(
            f"{where} was silent for {patience_s:g} s: check that it runs and {sends}, its address and port, "
            f"and that it sends to {self.cable.interface} port {self.cable.own_port}"
        )

    def _check_pace(self) -> None:
        """Raise RigError if a target with its own clock keeps another interval than the case's rate.

        A program without real time sends its frames in bursts now and then: one measurement that agrees is enough.
        """
        for _ in range(PACE_TRIES):
            each_s = self._pace_s()
            if abs(each_s / self.info.dt_s - 1.0) <= PACE_SHARE:
                return
        raise RigError(
            f"rig {self.info.name}: the target {self.peer} counts an instant every {each_s:.6g} s of its clock, "
            f"sample_rate_hz asks for {self.info.dt_s:.6g} s; change the rate of one of them"
        )

    def _pace_s(self) -> float:
        """Return the interval of the target's instants on its own clock, in s, from some of its frames."""
        self.discard()
        found = [self.asked(GREETING_S) for _ in range(PACED_FRAMES + 1)]
        came = np.array([(frame.number, frame.time_s) for frame in found if frame is not None])
        steps, times_s = np.diff(came, axis=0).T if len(came) > 1 else np.zeros((2, 1))
        if not (steps > 0).all():
            raise RigError(f"rig {self.info.name}: the frames of target {self.peer} do not count its instants upwards")
        paces_s = float(np.median(times_s / steps)), float(times_s.sum() / steps.sum())
        return min(
            paces_s, key=lambda pace_s: abs(pace_s / self.info.dt_s - 1.0)
        )  # stamps late here and there harm one

    def _begun(self, session: int) -> Frame:
        """Send BEGIN until the target's frames belong to the session; return the first one."""
        end, told = time.monotonic() + ARMING_S, ""
        while time.monotonic() < end:
            self._post(Frame(session, 0, 0, BEGIN, time.monotonic(), 0.0))
            again = time.monotonic() + PAUSE_S
            while (left := again - time.monotonic()) > 0.0:
                found = self._next_frame(left)
                if isinstance(found, Frame) and found.session == session and found.order == RUNNING:
                    return found
                if isinstance(found, Frame):
                    told = f" ({fault_names(found.faults)})" if found.faults else ""
        raise RigError(f"rig {self.info.name}: the target {self.peer} does not begin a session{told}")

    def _take_first(self, frame: Frame) -> None:
        """Count the steps of the session from a frame on, which is that of step 0."""
        link, status = self.link, self.link.status
        link.counts[:], link.plain[links.SESSION], link.plain[links.ECHOES] = 0, frame.session, 0
        link.plain[[links.LATENCIES, links.IN_STEP, links.NEWEST_LATENCY]] = 0
        status[:] = 0
        status[[links.BASE, links.LAST, links.SEEN]] = frame.number
        status[links.STATE], status[links.FAULTS] = frame.order, frame.faults
        status[links.RECEIVED_NS] = self._start_ns = time.monotonic_ns()
        link.samples_v[:] = frame.samples_v

    @property
    def latency_samples(self) -> float:
        """Return after how many intervals a command acts, the mean of the session's echoes; NaN for none."""
        return links.echoed_latency(self.link)

    def _check_latency(self) -> None:
        """Raise RigError if even the quickest commands act later than the rig file declares.

        Converters behind the target's program may add to what its frames show.
        """
        declared, least = self.info.latency_samples, int(self.link.plain[links.LEAST_LATENCY])
        if self.link.plain[links.ECHOES] == ECHOES and least > declared:
            raise RigError(
                f"rig {self.info.name}: the frames of target {self.peer} echo the command of "
                f"{least} intervals before, converters.latency_samples is {declared}; correct it "
                "in the rig file, or let the target put a command out at the instant whose number it has"
            )

    def _post(self, frame: Frame) -> None:
        """Send a frame; errors of the network appear as a silent target."""
        try:
            if self._door is not None:
                self._door.send(packed(frame))
        except OSError:
            return

    def _next_frame(self, timeout_s: float) -> Frame | str | None:
        """Return the next frame within a time, in words what came instead, None for nothing."""
        door = self._door
        if door is None or not select.select([door], [], [], max(timeout_s, 0.0))[0]:
            return None
        try:
            return unpacked(door.recv(packets.MOST_BYTES + 1), len(self.info.all_channels))
        except OSError:  # the peer's port was closed when an earlier frame came
            time.sleep(min(0.001, max(timeout_s, 0.0)))
            return None
