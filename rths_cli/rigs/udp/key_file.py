"""The file of the secret key that runner and target share."""

from __future__ import annotations

import os
import re
import secrets
import stat
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.rigs.udp.siphash import Words

KEY_FILE_VARIABLE = "RTHS_KEY_FILE"
LONGEST_BYTES = 1024  # number of bytes that are read; a longer file is no key file
_AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOFOLLOW", 0)  # no pipe is waited for


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
