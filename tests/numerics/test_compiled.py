"""Where compiled code is kept: a change of any source it comes from must not meet old code."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rths_cli
from rths_cli.numerics.compiled import entry
from rths_cli.numerics.lti import Array

PACKAGE = Path(rths_cli.__file__).parent
CODE = "from rths_cli.numerics.compiled import cache_folder; print(cache_folder())"


def folder_of(root: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=root, capture_output=True, text=True, timeout=60, check=True
    )
    return done.stdout.strip()


def test_a_change_in_any_part_moves_the_cache(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "rths_cli", ignore=shutil.ignore_patterns("__pycache__"))
    before = folder_of(tmp_path)
    assert folder_of(tmp_path) == before
    for name in ("loop/guard.py", "rigs/virtual/plant_kernel.py", "numerics/compiled.py"):
        with open(tmp_path / "rths_cli" / name, "a", encoding="utf-8") as file:
            file.write("\n# changed\n")
        after = folder_of(tmp_path)
        assert after != before, name
        before = after


def test_every_compiled_source_is_watched() -> None:
    from rths_cli.numerics.compiled import SOURCE_FOLDERS, SOURCES

    users = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if re.search(r"rths_cli\.numerics\.compiled import .*\b(entry|part)\b", path.read_text())
    }
    watched = {name for name in users if name in SOURCES or name.split("/")[0] in SOURCE_FOLDERS}
    assert users == watched and len(users) >= 5


HELLO = """
import numpy as np
from rths_cli.numerics import compiled
said = []
compiled.announce(said.append)
from rths_cli.numerics.filters import filter_tiles_both_ways
value = np.ones((1, 50, 4))
filter_tiles_both_ways(np.array([[0.1, 0.2, 0.1, 1.0, -1.0, 0.4], [1.0, 2.0, 1.0, 1.0, -1.2, 0.5]]), value, 9)
print(len(said), "numba" in sys.modules, value.tobytes().hex())
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Return a cache that a process has filled, and what that process printed."""
    cache = tmp_path_factory.mktemp("compiled")
    return cache, hello(cache)


def hello(cache: Path, **settings: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", "import sys\n" + HELLO],
        env={**os.environ, "XDG_CACHE_HOME": str(cache), **settings},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout.split()


def test_code_is_compiled_once_and_announced_then_loaded_without_numba(made: tuple[Path, list[str]]) -> None:
    cache, first = made
    second = hello(cache)
    assert first[:2] == ["1", "True"] and second[:2] == ["0", "False"]
    assert first[2] == second[2]


def test_code_for_another_processor_is_kept_beside_it(tmp_path: Path) -> None:
    """What numba is told to compile for is a part of the name: neither is loaded in place of the other."""
    quick, generic = {"NUMBA_OPT": "1"}, {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    made = [hello(tmp_path, **settings)[:2] for settings in (quick, generic, quick, generic)]
    assert made == [["1", "True"], ["1", "True"], ["0", "False"], ["0", "False"]]
    kept = {path.name: path.read_bytes() for path in tmp_path.rglob("*.native")}
    assert len(kept) == len(set(kept.values())) == 2 * len({name.split("-")[0] for name in kept})


def test_damaged_machine_code_is_compiled_again(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    cache, wanted = made
    damaged = Path(shutil.copytree(cache, tmp_path / "damaged"))
    for path in damaged.rglob("*.native"):
        path.write_bytes(path.read_bytes()[:-100])
    assert hello(damaged) == wanted


@pytest.mark.parametrize("value", [np.float32(1.5), np.int32(2), None, "1.5", [1.0]])
def test_what_python_and_machine_would_read_differently_is_refused(value: object) -> None:
    with pytest.raises(TypeError, match="compiled code takes"):
        total.bind(value)


def test_kinds_tell_read_only_arrays_and_only_contiguous_ones_are_taken() -> None:
    frozen = np.zeros(3)
    frozen.flags.writeable = False
    assert first(frozen) == first(np.zeros(3)) == 0.0
    assert len(first.kinds) == 2
    for array in (np.zeros(4)[::2], np.zeros(4)[::-1], np.asfortranarray(np.zeros((2, 3)))):
        with pytest.raises(TypeError, match="C-contiguous"):
            first.bind(array)


def test_a_cache_that_cannot_be_made_is_no_fault(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert hello(tmp_path / "file") == made[1]


@entry
def first(values: Array) -> float:
    return values[0]


@entry
def raises(values: Array) -> float:
    if values[0] > 0.0:
        raise ValueError("positive")
    return values[0]


@entry
def total(values: Array) -> float:
    result = 0.0
    for i in range(values.size):
        result += values[i]
    return result


def test_an_exception_in_compiled_code_ends_the_call() -> None:
    assert raises(np.zeros(3)) == 0.0
    with pytest.raises(RuntimeError, match="failed"):
        raises(np.ones(3))


def test_arguments_of_another_kind_are_compiled_for_themselves() -> None:
    assert total(np.arange(4.0)) == 6.0
    assert total(np.arange(4)) == 6.0
    assert len(total.kinds) == 2


def test_what_is_bound_lives_as_long_as_the_function() -> None:
    bound = total.bind(np.full(200_000, 0.5))
    others = [np.zeros(200_000) for _ in range(20)]
    assert bound() == 100_000.0 and len(others) == 20
