"""Key files, addresses and ports: what is refused, and in which words."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError, RigError
from rths_cli.rigs.udp.secret import make_secret, read_secret
from rths_cli.rigs.udp.sockets import bound, connected, shown


def test_a_new_secret_is_read_back_and_is_the_owners_alone(tmp_path: Path) -> None:
    path = tmp_path / "keys" / "table.key"
    secret = make_secret(path)
    assert np.array_equal(read_secret(path), secret)
    assert path.stat().st_mode & 0o777 == 0o600
    assert len(path.read_text().strip()) == 32
    assert not np.array_equal(make_secret(tmp_path / "other"), secret)
    with pytest.raises(InputError, match="cannot be made: File exists"):
        make_secret(path)


def test_the_environment_names_a_key_file_where_the_rig_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RTHS_KEY_FILE", raising=False)
    with pytest.raises(InputError, match=r"needs a key file: name it as udp\.key_file .* or in RTHS_KEY_FILE"):
        read_secret(None)
    named, other = tmp_path / "named", tmp_path / "other"
    wanted = make_secret(named)
    monkeypatch.setenv("RTHS_KEY_FILE", str(named))
    assert np.array_equal(read_secret(None), wanted)
    assert not np.array_equal(make_secret(other), wanted)
    assert not np.array_equal(read_secret(other), wanted)


@pytest.mark.parametrize(
    ("text", "mode", "words"),
    [
        ("00" * 16 + "\n", 0o640, "is open to other users; run: chmod 600"),
        ("00" * 15, 0o600, "must hold 32 hexadecimal digits and nothing else, it has 30 signs"),
        ("0g" * 16, 0o600, "must hold 32 hexadecimal digits"),
        ("\u00fc" * 32, 0o600, "cannot be read: it is not text"),
        (None, 0o600, "cannot be read: No such file"),
    ],
)
def test_a_bad_key_file_is_one_sentence(tmp_path: Path, text: str | None, mode: int, words: str) -> None:
    path = tmp_path / "key"
    if text is not None:
        path.write_text(text, encoding="utf-8")
        os.chmod(path, mode)
    with pytest.raises(InputError, match=words) as raised:
        read_secret(path)
    assert "\n" not in str(raised.value)


def test_a_port_in_use_a_foreign_address_and_an_unknown_host_are_sentences(monkeypatch: pytest.MonkeyPatch) -> None:
    with bound("127.0.0.1", 0) as door:
        port = door.getsockname()[1]
        with pytest.raises(RigError, match=rf"cannot listen at 127\.0\.0\.1:{port}: Address already in use; choose"):
            bound("127.0.0.1", port)
    with pytest.raises(RigError, match=r"cannot listen at 192\.0\.2\.1:0: "):
        bound("192.0.2.1", 0)
    with pytest.raises(RigError, match=r"host 'two\.\.dots' is not known: it is no host name"):
        connected("two..dots", 1)

    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(RigError, match=r"host 'shaker' is not known: Name or service not known; check udp\.host"):
        connected("shaker", 1)


def test_ipv4_is_asked_first_where_a_host_has_both(monkeypatch: pytest.MonkeyPatch) -> None:
    """localhost is often both, and a target listens at one."""
    six = (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", 9, 0, 0))
    four = (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", 9))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: [six, four])
    found = connected("localhost", 9)
    for link, _ in found:
        link.close()
    assert found[0][1] == "127.0.0.1:9"


def test_ipv6_is_spoken_where_the_machine_has_it() -> None:
    try:
        door = bound("::1", 0)
    except RigError:
        pytest.skip("no IPv6 here")
    link, peer = connected("[::1]", door.getsockname()[1])[0]
    with door, link:
        assert peer == f"[::1]:{door.getsockname()[1]}" == shown(door.getsockname())
        link.send(b"hello")
        door.settimeout(2.0)
        assert door.recv(10) == b"hello"
