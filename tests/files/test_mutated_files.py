"""A sample of the damaged files of `benchmarks/mutated_files.py`: each is read, or refused by a sentence."""

from __future__ import annotations

import os
import random
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from campaigns.file_damage import Target, damaged
from campaigns.valid_files import SHORT_RECORD
from test_hdf5_safety import everything, made

from rths_cli.errors import InputError
from rths_cli.files import sandboxed_reading
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.files.sandboxed_reading import read_in_copy


def short_record(folder: Path) -> Path:
    """Write a record."""
    path = folder / "short.csv"
    path.write_text(SHORT_RECORD)
    return path


KINDS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], object]]] = {
    "result": (made, everything),
    "record": (short_record, read_accelerogram),
}


def _fail() -> None:
    """Have a child process die, which its parent sees, and say why."""
    traceback.print_exc()
    os.abort()


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_is_read_or_refused_by_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    make, read = KINDS[kind]
    monkeypatch.chdir(tmp_path)
    target = Target(kind, make(tmp_path), kind == "result", ())

    def read_or_refuse(numbers: range) -> None:
        for number in numbers:
            file = tmp_path / f"damaged_{number}"
            try:
                damage = damaged(target, file, random.Random(f"15/{number}"))
                last.write_text(f"{number}: {damage}")
            except BaseException:
                _fail()
            try:
                read(file)
            except InputError:
                pass
            except BaseException:
                _fail()

    last = tmp_path / "last"
    monkeypatch.setattr(sandboxed_reading, "TIME_LIMIT_S", 200.0)
    for first in range(0, 80, 10):
        try:
            read_in_copy(partial(read_or_refuse, range(first, first + 10)))
        except ValueError:
            pytest.fail(last.read_text())
