"""The runner's session with a UDP target: sockets, the file of the key, opening and closing."""

from __future__ import annotations

import ipaddress
import os
import re
import secrets
import select
import socket
import stat
import struct
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError, RigError
from rths_cli.rigs.udp import packets
from rths_cli.rigs.udp.fault_sentences import refused, silence
from rths_cli.rigs.udp.handshake import make_session_key
from rths_cli.rigs.udp.packets import NONCE_BYTES, Words

GREETING_S = 5.0
RESEND_S = 0.1
HELLO_WORDS, WELCOME_WORDS, REFUSAL_WORDS, ARM_WORDS = "<16s3q16x", "<16s16s3q", "<16s2Q", "<16s3q"

KEY_FILE_VARIABLE = "RTHS_KEY_FILE"
LONGEST_BYTES = 1024  # number of bytes that are read; a longer file is no key file
_AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)  # no pipe is waited for


@dataclass(frozen=True)
class Terms:
    """Terms of a session on which both sides agree; the watchdog is the longest time without a command."""

    channels: int
    interval_ns: int
    watchdog_ns: int


@dataclass(frozen=True)
class Session:
    """A session offered by a target."""

    key: Words  # (2,) key of this session's packets
    terms: Terms
    arming: bytes  # words of its ARM


def session_key(secret: Words, runner_nonce: bytes, target_nonce: bytes) -> Words:
    """Return the key (2,) of a session; a word is SipHash, under the secret, of label, word number and both nonces."""
    key, nonces = np.zeros(2, np.uint64), np.frombuffer(bytearray(runner_nonce + target_nonce), np.uint8)
    make_session_key(nonces, secret, np.zeros(48, np.uint8), key)
    return key


def prepare() -> None:
    """Load or compile the code of a handshake in advance, so that no peer has to wait for it."""
    secret = np.zeros(2, np.uint64)
    judge(sealed(packets.HELLO, b"", secret), secret)
    session_key(secret, bytes(NONCE_BYTES), bytes(NONCE_BYTES))


def greet(
    link: socket.socket,
    peer: str,
    secret: Words,
    wanted: Terms,
    timeout_s: float = GREETING_S,
    patience_s: float = 0.0,
) -> Session:
    """Send HELLO on a connected socket until the target answers; return the session.

    `peer` names the target in messages. `timeout_s`: longest wait for a silent target; `patience_s`: longest wait for a
    table that is armed or not yet at rest. Raises RigError if the target refuses or stays silent.
    """
    prepare()
    nonce = secrets.token_bytes(NONCE_BYTES)
    content = struct.pack(HELLO_WORDS, nonce, wanted.channels, wanted.interval_ns, wanted.watchdog_ns)
    hello = sealed(packets.HELLO, content, secret)
    begun = time.monotonic()
    end, strangers = begun + timeout_s, 0
    while (now := time.monotonic()) < end:
        _send(link, hello)
        again = min(now + RESEND_S, end)
        while (data := _receive(link, again - time.monotonic())) is not None:
            if _is_busy(data, secret, nonce) and time.monotonic() < begun + patience_s:
                end = max(end, begun + patience_s + timeout_s)
                continue
            if (session := _welcomed(data, secret, nonce, peer)) is not None:
                return session
            strangers += judge(data, secret) == packets.FORGED
    raise RigError(silence(peer, end - begun, strangers))


def sealed(kind: int, content: bytes, key: Words, sequence: int = 0) -> bytes:
    """Return a packet without times as bytes; `content` holds its words, the key is (2,)."""
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    packet[packets.WORDS : packets.WORDS + len(content)] = np.frombuffer(content, np.uint8)
    size = packets.seal_packet(packet, kind, len(content) // 8, sequence, key)
    return packet[:size].tobytes()


def judge(data: bytes, key: Words) -> int:
    """Return the result of packets.verdict for received bytes under a key (2,)."""
    packet = np.zeros(packets.MOST_BYTES, np.uint8)
    kept = data[: packets.MOST_BYTES]
    packet[: len(kept)] = np.frombuffer(kept, np.uint8)
    return int(packets.judge_packet(packet, len(data), key))


def _is_busy(data: bytes, secret: Words, nonce: bytes) -> bool:
    """Return whether a packet refuses this nonce because the table is armed or not yet at rest."""
    words = data[packets.WORDS : packets.AFTER_NONCE + 8]
    return (
        judge(data, secret) == packets.GENUINE
        and data[packets.KIND] == packets.REFUSAL
        and words == nonce + struct.pack("<Q", packets.BUSY)
    )


def _welcomed(data: bytes, secret: Words, nonce: bytes, peer: str) -> Session | None:
    """Return the session of a WELCOME for this nonce, None for any other packet; raises RigError for a REFUSAL."""
    judged = judge(data, secret)
    if (
        judged not in (packets.GENUINE, packets.OTHER_VERSION)
        or data[packets.WORDS : packets.WORDS + NONCE_BYTES] != nonce
    ):
        return None
    if judged == packets.OTHER_VERSION:
        raise RigError(refused(peer, packets.NO_VERSION, data[packets.VERSION]))
    if (data[packets.KIND], 8 * data[packets.COUNT]) == (packets.REFUSAL, struct.calcsize(REFUSAL_WORDS)):
        raise RigError(refused(peer, *struct.unpack_from(REFUSAL_WORDS, data, packets.WORDS)[1:]))
    if (data[packets.KIND], 8 * data[packets.COUNT]) != (packets.WELCOME, struct.calcsize(WELCOME_WORDS)):
        return None
    _, target_nonce, *terms = struct.unpack_from(WELCOME_WORDS, data, packets.WORDS)
    key = session_key(secret, nonce, target_nonce)
    return Session(key, Terms(*terms), struct.pack(ARM_WORDS, nonce, *terms))


def _send(link: socket.socket, packet: bytes) -> None:
    """Send a packet; network errors, also of an earlier packet, are ignored and appear as a silent target."""
    try:
        link.send(packet)
    except OSError:
        return


def _receive(link: socket.socket, timeout_s: float) -> bytes | None:
    """Return the next packet within a time, None when there is none."""
    end = time.monotonic() + timeout_s
    while (left := end - time.monotonic()) > 0.0:
        if not select.select([link], [], [], left)[0]:
            return None
        try:
            return link.recv(packets.MOST_BYTES + 1)
        except OSError:  # the peer's port was closed when an earlier packet came
            time.sleep(min(0.001, left))
    return None


def read_secret(key_file: Path | None) -> Words:
    """Return the secret, (2,) words, from a key file; None: from the file that RTHS_KEY_FILE names.

    Raises InputError if there is no file, if other users may read, change or replace it, or if it holds no key.
    """
    named = os.environ.get(KEY_FILE_VARIABLE, "")
    path = key_file or (Path(named) if named else None)
    if path is None:
        raise InputError(
            f"the link needs a key file: name it as udp.key_file in the rig file or in {KEY_FILE_VARIABLE}; "
            "`rths serve` makes one and prints its path"
        )
    try:
        text = _private_text(path)
    except (OSError, UnicodeDecodeError, ValueError) as fault:
        why = fault.strerror if isinstance(fault, OSError) else "it is not text"
        raise InputError(f"key file {path} cannot be read: {why}; it must hold 32 hexadecimal digits") from None
    if re.fullmatch("[0-9a-fA-F]{32}", text) is None:
        raise InputError(f"key file {path} must hold 32 hexadecimal digits and nothing else, it has {len(text)} signs")
    secret = bytes.fromhex(text)
    if len(set(secret)) == 1:
        raise InputError(
            f"key file {path} holds the byte {text[:2]} 16 times, which anybody may guess; make another for both "
            f"sides: openssl rand -hex 16 > {path}"
        )
    return as_words(secret)


def _private_text(path: Path) -> str:
    """Return the text of a file, with symbolic links resolved; raises InputError if other users may access it."""
    real = Path(os.path.realpath(path, strict=True))
    shown = f"key file {path}" if real == path.absolute() else f"key file {path} (that is {real})"
    with open(real, "rb", opener=lambda name, flags: os.open(name, flags | _AT_ONCE)) as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise InputError(f"{shown} is no regular file; name a file that holds 32 hexadecimal digits")
        if os.name == "posix":
            _require_own(shown, real, about, stat.S_IRWXG | stat.S_IRWXO, "is open to other users", "chmod 600")
            folder, about = real.parent, real.parent.stat()
            shown = f"the folder {folder} of {shown}"
            _require_own(shown, folder, about, stat.S_IWOTH, "can be written by anybody", "chmod o-w")
        return file.read(LONGEST_BYTES).decode("ascii").strip()


def _require_own(shown: str, path: Path, about: os.stat_result, forbidden: int, fault: str, remedy: str) -> None:
    """Raise InputError if a file or folder belongs to another user or has forbidden permissions."""
    if about.st_uid not in (os.geteuid(), 0):
        raise InputError(f"{shown} belongs to another user (number {about.st_uid}); make a key file of your own")
    if about.st_mode & forbidden and about.st_mode & stat.S_ISVTX:
        raise InputError(f"{shown} {fault}; keep the key file in a folder of your own")
    if about.st_mode & forbidden:
        raise InputError(f"{shown} {fault}; run: {remedy} {path}")


def make_secret(path: Path) -> Words:
    """Write a new random secret to a key file that only its owner may read; return it, (2,) words.

    Missing folders are created with access for the owner only. Raises InputError if the file exists or cannot be
    written.
    """
    secret = secrets.token_bytes(16)
    try:
        for folder in [one for one in reversed(path.parents) if not one.exists()]:
            folder.mkdir(mode=0o700, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                file.write(secret.hex() + "\n")
        except OSError:
            path.unlink()
            raise
    except OSError as fault:
        raise InputError(f"key file {path} cannot be made: {fault.strerror}; choose another place") from None
    return as_words(secret)


def as_words(data: bytes) -> Words:
    """Return bytes as words of 8, the least significant byte first."""
    return np.frombuffer(data, "<u8").astype(np.uint64)


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
