"""Folders that are made for a file: with those they stand in, but no endless tower of them."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.files.durable_files import MOST_NEW, make_folder


def tower(floors: int) -> Path:
    return Path(*["a"] * floors)


def test_a_folder_is_made_with_those_it_stands_in(tmp_path: Path) -> None:
    folder = tmp_path / tower(MOST_NEW)
    assert make_folder(folder) == [folder, *list(folder.parents)[: MOST_NEW - 1]]
    assert make_folder(folder) == [] and folder.is_dir()


@pytest.mark.parametrize("floors", [MOST_NEW + 1, 1200])
def test_a_tower_of_new_folders_is_refused_and_nothing_is_made(tmp_path: Path, floors: int) -> None:
    """pathlib would call itself for each of them, and Python ends that after a thousand."""
    with pytest.raises(OSError, match="one inside the other") as refused:
        make_folder(tmp_path / tower(floors))
    assert refused.value.errno == errno.ENAMETOOLONG and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("run", "el_centro_low_ff"), ("sweep", "el_centro_low_ff", "--seeds", "1")])
def test_an_output_folder_too_deep_is_one_sentence(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="cannot write result files here: File name too long"):
        cli.main([*words, "--output", str(tower(1200) / "x.h5")], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []
