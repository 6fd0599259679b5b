"""The page of a sweep's file: of an incremental dynamic analysis (`ida_page`), or of a sweep (`sweep_page`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rths_cli.files.sweep_file import Sweep
from rths_cli.report import ida_page, sweep_page
from rths_cli.report.document import Document
from rths_cli.studies.ida_curves import about_of


def is_ida(sweep: Sweep) -> bool:
    """Return whether `rths ida` made the file, and all of it is there."""
    return sweep.numbers is None and about_of(sweep.attributes) is not None


def sections(sweep: Sweep, path: Path) -> Document:
    """Return the page, the verdict first."""
    return (ida_page if is_ida(sweep) else sweep_page).sections(sweep, path)


def verdict(sweep: Sweep, path: Path) -> str:
    """Return the verdict and the file in one sentence."""
    return (ida_page if is_ida(sweep) else sweep_page).verdict(sweep, path)


def document(sweep: Sweep, path: Path) -> dict[str, Any]:
    """Return the page for JSON."""
    return (ida_page if is_ida(sweep) else sweep_page).document(sweep, path)
