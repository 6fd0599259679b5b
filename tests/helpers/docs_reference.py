"""Write docs/reference/, made from the code: `python tests/helpers/docs_reference.py`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from docs_commands import commands_page
from docs_findings import findings_page
from docs_hdf5 import hdf5_page
from docs_keys import case_page, law_page, rig_page, study_page
from docs_licences import licences_page
from docs_metrics import reference_page
from docs_modules import with_map

FOLDER = Path(__file__).parents[2] / "docs" / "reference"
SOURCE_MAP = FOLDER / "source_map.md"
PAGES: dict[str, Callable[[], str]] = {
    "commands.md": commands_page,
    "case.md": case_page,
    "rig.md": rig_page,
    "study.md": study_page,
    "storey_laws.md": law_page,
    "hdf5.md": hdf5_page,
    "metrics.md": reference_page,
    "findings.md": findings_page,
    "licences.md": licences_page,
}


def write_pages(folder: Path) -> None:
    """Write every page of the reference into a folder."""
    for name, page in PAGES.items():
        (folder / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    write_pages(FOLDER)
    SOURCE_MAP.write_text(with_map(SOURCE_MAP.read_text(encoding="utf-8")), encoding="utf-8")
    sys.exit(0)
