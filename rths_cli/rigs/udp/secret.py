"""The secret that runner and target share: 16 bytes in a file, as 32 hexadecimal digits."""

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


def read_secret(key_file: Path | None) -> Words:
    """Return the secret, (2,) words, from a key file, or from the one that RTHS_KEY_FILE names.

    Raises InputError where there is none, where others may read it, or where it does not hold 32 digits.
    """
    named = os.environ.get(KEY_FILE_VARIABLE, "")
    path = key_file or (Path(named) if named else None)
    if path is None:
        raise InputError(
            f"the link needs a key file: name it as udp.key_file in the rig file or in {KEY_FILE_VARIABLE}; "
            "`rths serve` makes one and prints its path"
        )
    try:
        readers = stat.S_IMODE(path.stat().st_mode) & 0o077 if os.name == "posix" else 0
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as fault:
        why = fault.strerror if isinstance(fault, OSError) else "it is not text"
        raise InputError(f"key file {path} cannot be read: {why}; it must hold 32 hexadecimal digits") from None
    if readers:
        raise InputError(f"key file {path} is open to other users; run: chmod 600 {path}")
    if re.fullmatch("[0-9a-fA-F]{32}", text) is None:
        raise InputError(f"key file {path} must hold 32 hexadecimal digits and nothing else, it has {len(text)} signs")
    return as_words(bytes.fromhex(text))


def make_secret(path: Path) -> Words:
    """Write a new random secret to a key file that only its owner may read; return it, (2,) words.

    Raises InputError where the file is there already or cannot be written.
    """
    secret = secrets.token_bytes(16)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as fault:
        raise InputError(f"key file {path} cannot be made: {fault.strerror}; choose another place") from None
    with os.fdopen(handle, "w", encoding="ascii") as file:
        file.write(secret.hex() + "\n")
    return as_words(secret)


def as_words(data: bytes) -> Words:
    """Return bytes as words of 8, the least significant byte first."""
    return np.frombuffer(data, "<u8").astype(np.uint64)
