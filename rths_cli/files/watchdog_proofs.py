"""The file of watchdog proofs made on this machine: `rths doctor --watchdog` writes it, what moves a table reads it."""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rths_cli.errors import InputError
from rths_cli.user_cache import user_cache


@dataclass(frozen=True)
class WatchdogProof:
    """What a target did when its runner fell silent; `content_sha256` is of the rig file that the proof holds for.

    `left_s`: from the last command to the first frame that no longer obeys (at most); `rested_s`: to the table at rest.
    """

    rig: str
    content_sha256: str
    proven_utc: str
    moved_v: float
    left_s: float
    rested_s: float


def content_sha256(content: str) -> str:
    """Return the hash of what a rig file states."""
    return hashlib.sha256(content.encode()).hexdigest()


def keep_proof(proof: WatchdogProof) -> None:
    """Keep a proof; it replaces the one of the same rig. Raises InputError where it cannot be written."""
    path = proofs_path()
    kept = {**_read(), proof.rig: asdict(proof)}
    part = path.with_suffix(f".{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_text(json.dumps(kept, indent=1), encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"the proof of the watchdog cannot be kept in {path}: {error.strerror}") from None


def kept_proof(rig: str) -> WatchdogProof | None:
    """Return the newest proof of a rig of this name, of whatever content; None: there is none."""
    with suppress(TypeError):  # another version's
        entry = _read().get(rig)
        return WatchdogProof(**entry) if entry is not None else None
    return None


def proofs_path() -> Path:
    """Return the file in which the proofs are kept."""
    return user_cache() / "watchdog_proofs.json"


def _read() -> dict[str, dict[str, Any]]:
    """Return everything kept, nothing where the file is missing or damaged."""
    try:
        data = json.loads(proofs_path().read_text(encoding="utf-8"))
    except (OSError, ValueError, InputError):
        return {}
    return data if isinstance(data, dict) and all(isinstance(one, dict) for one in data.values()) else {}
