"""Open UDP sockets of both sides, IPv4 and IPv6."""

from __future__ import annotations

import ipaddress
import socket

from rths_cli.errors import InputError, RigError


class _UnknownHost(Exception):
    """Raised for a host without an address, with a clause that gives the reason."""


def connected(host: str, port: int) -> list[tuple[socket.socket, str]]:
    """Return a socket connected to each address of a host, with its name for messages, IPv4 first.

    A connected socket receives only from that address and port. The sockets are non-blocking.
    Raises RigError if the host is unknown or cannot be reached.
    """
    found, fault = [], ""
    try:
        addresses = _addresses(host, port)
    except _UnknownHost as error:
        raise RigError(f"{error}; check udp.host in the rig file") from None
    for family, _, _, _, address in addresses:
        try:
            link = socket.socket(family, socket.SOCK_DGRAM)
        except OSError as error:
            fault = str(error.strerror)
            continue
        try:
            link.connect(address)
        except OSError as error:
            fault = str(error.strerror)
            link.close()
            continue
        link.setblocking(False)
        found.append((link, shown(address)))
    if not found:
        raise RigError(f"target {host} port {port} cannot be reached: {fault}; check udp.host and the network")
    return found


def on_this_machine(link: socket.socket) -> bool:
    """Return whether a connected socket leads to this machine: to a loopback address, or to its own address."""
    here, there = (name()[0].partition("%")[0] for name in (link.getsockname, link.getpeername))
    return bool(here == there or ipaddress.ip_address(there).is_loopback)


def bound(host: str, port: int) -> socket.socket:
    """Return a non-blocking socket bound to an address; port 0 selects a free one.

    Raises InputError if the host is unknown, RigError if the address is not this machine's or the port is in use.
    """
    try:
        family, _, _, _, address = _addresses(host, port)[0]
    except _UnknownHost as error:
        raise InputError(f"--host: {error}; give a name or an address of this machine") from None
    door = socket.socket(family, socket.SOCK_DGRAM)
    try:
        door.bind(address)
    except OSError as error:
        door.close()
        raise RigError(f"cannot listen at {shown(address)}: {error.strerror}; choose another port or address") from None
    door.setblocking(False)
    return door


def shown(address: tuple[str | int, ...]) -> str:
    """Return an address as host:port, [host]:port for IPv6."""
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in str(host) else f"{host}:{port}"


def _addresses(host: str, port: int) -> list[tuple[int, int, int, str, tuple[str | int, ...]]]:
    try:
        found = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_DGRAM)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or "it is no host name"
        raise _UnknownHost(f"host {host!r} is not known: {why}") from None
    return sorted(found, key=lambda one: one[0] != socket.AF_INET)  # type: ignore[arg-type]
