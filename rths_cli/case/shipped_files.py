"""Where the shipped cases, structures, rigs, references and records are."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

FOLDERS = {
    "cases": "configs",
    "structures": "configs/structures",
    "rigs": "configs/rigs",
    "references": "configs/references",
    "benchmarks": "configs/benchmarks",
    "records": "records",
}


def shipped(kind: str) -> Path:
    """Return the folder of the shipped files of a kind (a key of FOLDERS).

    It lies in the installed package, or in the source tree the package is used from.
    """
    package = Path(__file__).resolve().parents[1]
    installed = package / "shipped"
    return (installed if installed.is_dir() else package.parent) / FOLDERS[kind]


def is_shipped(path: Path) -> bool:
    """Return whether a file is one of the shipped ones."""
    return path.resolve().parent in _folders()


@lru_cache(maxsize=1)
def _folders() -> tuple[Path, ...]:
    return tuple(shipped(kind).resolve() for kind in FOLDERS)
