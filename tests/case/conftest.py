"""A laboratory's folder: records to name, case files to write, and nothing else in sight."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError

FIVE_KEYS = """\
structure: three_storey
damping: low
record: el_centro
scaling: 0.30
controller: FF+FB
"""

Write = Callable[..., Path]
FaultsOf = Callable[..., tuple[str, ...]]


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Enter a folder with two records whose content nobody reads here."""
    (tmp_path / "records").mkdir()
    for name in ("el_centro", "hachinohe"):
        (tmp_path / "records" / f"{name}.csv").write_text("0.0\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def write(lab: Path) -> Write:
    """Write a text to a file in the laboratory's folder, by default a case of five keys with lines added."""

    def write_file(more: str = "", name: str = "a.yaml", text: str = FIVE_KEYS) -> Path:
        path = Path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + more, encoding="utf-8")
        return path

    return write_file


@pytest.fixture
def faults_of(write: Write) -> FaultsOf:
    """Return the faults of a case file of five keys with lines added."""

    def faults(more: str = "", text: str = FIVE_KEYS, settings: tuple[str, ...] = ()) -> tuple[str, ...]:
        with pytest.raises(InputError) as caught:
            load_cases([write(more, text=text)], settings)
        return caught.value.faults

    return faults
