"""A bad network on one machine: passes packets between a runner and a target, and loses, spoils or delays some."""

from __future__ import annotations

import heapq
import itertools
import select
import socket
import threading
import time
from collections.abc import Callable

Mishap = Callable[[bytes], list[tuple[float, bytes]]]  # what comes out for a packet: (delay in s, packet) each


def as_it_came(packet: bytes) -> list[tuple[float, bytes]]:
    return [(0.0, packet)]


class Relay:
    """Listens at `port` for a runner and passes on to a target; either way may be given mishaps at any time."""

    def __init__(self, host: str, port: int) -> None:
        self.to_target: Mishap = as_it_came
        self.to_runner: Mishap = as_it_came
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", 0))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._back.connect((host, port))
        self.port: int = self._front.getsockname()[1]
        self._ended = False
        self._thread = threading.Thread(target=self._pass_on, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop; both sides then hear nothing any more."""
        self._ended = True
        self._thread.join()
        self._front.close()
        self._back.close()

    def send_to(self, runner: tuple[str, int], packet: bytes) -> None:
        """Send a packet of one's own to a runner, as if the target had sent it."""
        self._front.sendto(packet, runner)

    def _pass_on(self) -> None:
        runner, order = ("127.0.0.1", 9), itertools.count()
        due: list[tuple[float, int, socket.socket, bytes]] = []
        while not self._ended:
            wait = min(0.02, max(0.0, due[0][0] - time.monotonic())) if due else 0.02
            for door in select.select([self._front, self._back], [], [], wait)[0]:
                try:
                    packet, sender = door.recvfrom(2048)
                except OSError:  # the other side's port is closed
                    continue
                forth = door is self._front
                runner = sender if forth else runner
                for delay_s, out in (self.to_target if forth else self.to_runner)(packet):
                    other = self._back if forth else self._front
                    heapq.heappush(due, (time.monotonic() + delay_s, next(order), other, out))
            while due and due[0][0] <= time.monotonic():
                _, _, door, packet = heapq.heappop(due)
                self._send(door, packet, runner)

    def _send(self, door: socket.socket, packet: bytes, runner: tuple[str, int]) -> None:
        try:
            if door is self._back:
                door.send(packet)
            else:
                door.sendto(packet, runner)
        except OSError:
            return
