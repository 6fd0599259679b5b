"""Key files, addresses and ports: what is refused, and in which words."""

from __future__ import annotations

import os
import resource
import socket
from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError, RigError
from rths_cli.rigs.udp.session import bound, connected, make_secret, read_secret, shown


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


GOOD = bytes(range(7, 23)).hex()


def made(folder: Path, text: str = GOOD, mode: int = 0o600, folder_mode: int = 0o700) -> Path:
    """Return a key file in a folder of its own."""
    (folder / "keys").mkdir()
    path = folder / "keys" / "key"
    path.write_text(text)
    path.chmod(mode)
    path.parent.chmod(folder_mode)
    return path


def refused(path: Path, words: str) -> None:
    with pytest.raises(InputError, match=words) as raised:
        read_secret(path)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("mode", [0o600, 0o400, 0o700])
@pytest.mark.parametrize("folder_mode", [0o700, 0o755, 0o775, 0o1700])
def test_a_key_file_of_the_owner_alone_is_read(tmp_path: Path, mode: int, folder_mode: int) -> None:
    assert read_secret(made(tmp_path, mode=mode, folder_mode=folder_mode)).tobytes().hex() == GOOD


@pytest.mark.parametrize("mode", [0o640, 0o620, 0o610, 0o604, 0o602, 0o644, 0o666, 0o777])
def test_a_key_file_that_others_may_touch_is_refused(tmp_path: Path, mode: int) -> None:
    path = made(tmp_path, mode=mode)
    refused(path, f"key file {path} is open to other users; run: chmod 600 {path}")


@pytest.mark.parametrize("mode", [0o777, 0o707, 0o703])
def test_a_key_file_in_a_folder_that_anybody_writes_is_refused(tmp_path: Path, mode: int) -> None:
    path = made(tmp_path, folder_mode=mode)
    refused(
        path, f"the folder {path.parent} of key file {path} can be written by anybody; run: chmod o-w {path.parent}"
    )


def test_a_key_file_in_a_sticky_folder_like_tmp_is_refused(tmp_path: Path) -> None:
    refused(made(tmp_path, folder_mode=0o1777), "can be written by anybody; keep the key file in a folder of your own")


def test_what_a_link_finally_names_is_looked_at(tmp_path: Path) -> None:
    """Two links, the second through a linked folder: file and folder are those at the end."""
    path = made(tmp_path)
    os.symlink(path.parent, tmp_path / "linked")
    os.symlink(tmp_path / "linked" / "key", tmp_path / "first")
    os.symlink(tmp_path / "first", tmp_path / "second")
    assert read_secret(tmp_path / "second").tobytes().hex() == GOOD
    path.parent.chmod(0o777)
    refused(
        tmp_path / "second", rf"folder {path.parent} of key file {tmp_path}/second \(that is {path}\) can be written"
    )
    path.parent.chmod(0o700)
    path.chmod(0o604)
    refused(tmp_path / "second", f"is open to other users; run: chmod 600 {path}")
    os.symlink(tmp_path / "loop", tmp_path / "loop")
    refused(tmp_path / "loop", "cannot be read: ")


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_key_file_or_folder_of_another_user_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    path, nobody = made(tmp_path), 65534
    theirs = path if what == "file" else path.parent
    if os.geteuid() == 0:
        os.chown(theirs, nobody, nobody)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: nobody)
        theirs = path
    start = f"key file {path}" if theirs == path else f"the folder {path.parent} of key file {path}"
    refused(path, rf"^{start} belongs to another user \(number \d+\); make a key file of your own")


@pytest.mark.parametrize("byte", ["00", "ff", "5A"])
def test_a_key_that_anybody_guesses_is_refused(tmp_path: Path, byte: str) -> None:
    refused(made(tmp_path, 16 * byte), f"holds the byte {byte} 16 times, which anybody may guess; make another")


def test_a_pipe_a_folder_and_a_device_are_no_key_files(tmp_path: Path) -> None:
    path = made(tmp_path)
    path.unlink()
    os.mkfifo(path, 0o600)
    refused(path, "is no regular file; name a file that holds 32 hexadecimal digits")
    refused(path.parent, "cannot be read: Is a directory")
    refused(Path("/dev/zero"), "is no regular file")
    huge = tmp_path / "huge"
    with open(huge, "wb") as file:
        file.truncate(1 << 40)
    huge.chmod(0o600)
    refused(huge, "must hold 32 hexadecimal digits and nothing else, it has")


@pytest.mark.skipif(os.name != "posix", reason="modes are those of POSIX")
def test_folders_made_for_a_key_are_the_owner_s_alone(tmp_path: Path) -> None:
    old = os.umask(0o002)
    try:
        make_secret(tmp_path / "a" / "b" / "key")
    finally:
        os.umask(old)
    assert [(tmp_path / name).stat().st_mode & 0o777 for name in ("a", "a/b", "a/b/key")] == [0o700, 0o700, 0o600]


@pytest.mark.parametrize(
    ("text", "mode", "words"),
    [
        (GOOD + "\n", 0o640, "is open to other users; run: chmod 600"),
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
    for host in ("two..dots", 300 * "a"):
        with pytest.raises(InputError, match=rf"--host: host '{host}' is not known: it is no host name; give a name"):
            bound(host, 0)

    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", unknown)
    with pytest.raises(RigError, match=r"host 'shaker' is not known: Name or service not known; check udp\.host"):
        connected("shaker", 1)
    with pytest.raises(InputError, match=r"--host: host 'shaker' is not known: Name or service not known; give a name"):
        bound("shaker", 0)


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


def test_a_full_disk_leaves_no_empty_key_file(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))  # as a full disk: no byte can be written
    try:
        with pytest.raises(InputError, match=r"key file .* cannot be made: File too large"):
            make_secret(tmp_path / "table.key")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
