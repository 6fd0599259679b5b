"""Compiled code: where it is kept, when it is compiled again, what it takes, what it may not call."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import every_entry
import numba
import numpy as np
import pytest
from forked_programs import Program
from numba.core.errors import NumbaError
from numpy.typing import NDArray

import rths_cli
from rths_cli.numerics import compiled
from rths_cli.numerics.compiled import Entry, borrowed, cache_folder, entry, runtime_calls
from rths_cli.numerics.lti import Array

PACKAGE = Path(rths_cli.__file__).parent
CODE = "from rths_cli.numerics.compiled import cache_folder; print(cache_folder())"
POSIX = pytest.mark.skipif(os.name != "posix", reason="Windows has no modes of files and no flock")


def folder_of(root: Path) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root), "XDG_CACHE_HOME": str(root)},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return done.stdout.strip()


@pytest.mark.campaign
def test_a_change_in_any_part_moves_the_cache_and_one_above_the_loop_does_not(tmp_path: Path) -> None:
    shutil.copytree(PACKAGE, tmp_path / "rths_cli", ignore=shutil.ignore_patterns("__pycache__"))
    before = folder_of(tmp_path)
    names = ("loop/guard.py", "rigs/virtual/plant_kernel.py", "numerics/compiled.py", "cli/run.py", "report/export.py")
    assert str(tmp_path) in before and folder_of(tmp_path) == before
    for name in names:
        with open(tmp_path / "rths_cli" / name, "a", encoding="utf-8") as file:
            file.write("\n# changed\n")
        after = folder_of(tmp_path)
        assert (after == before) == name.startswith(("cli", "report")), name
        before = after


def test_every_source_that_compiled_code_can_come_from_is_watched() -> None:
    """Also those from which it takes constants: all that a compiled source may import."""
    watched = {path.relative_to(PACKAGE).as_posix() for path in compiled.watched_sources()}
    users = {
        path.relative_to(PACKAGE).as_posix()
        for path in PACKAGE.rglob("*.py")
        if re.search(r"rths_cli\.numerics\.compiled import .*(entry|part|part_class)\b", path.read_text())
    }
    named = {name.split("/")[0] for name in users}
    imported = {
        found
        for name in users
        for found in re.findall(r"^ *from rths_cli\.(\w+)", (PACKAGE / name).read_text(), re.MULTILINE)
    }
    assert users <= watched and len(users) >= 15
    for folder in named | imported:
        source = PACKAGE / folder
        sources = sorted(source.rglob("*.py")) if source.is_dir() else [source.with_suffix(".py")]
        assert {path.relative_to(PACKAGE).as_posix() for path in sources} <= watched, folder


HELLO = """
import numpy as np
from rths_cli.numerics.compiler_messages import announce
said = []
announce(said.append)
from rths_cli.rigs.udp.packets import siphash_into
value = np.zeros(1, np.uint64)
siphash_into(np.arange(15, dtype=np.uint8), 15, np.arange(2, dtype=np.uint64), value)
print(len(said), value[0], *said)
"""


@contextmanager
def started(cache: Path, code: str = HELLO, **settings: str) -> Iterator[subprocess.Popen[str] | Program]:
    """Start a program: forked where numba has no settings, which it reads when it is imported."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache), **settings}
    process: subprocess.Popen[str] | Program
    if settings or not hasattr(os, "fork"):
        process = subprocess.Popen(
            [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    else:
        process = Program(code, environment)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def finished(process: subprocess.Popen[str] | Program) -> list[str]:
    """Return the number of compilations a process announced, its result, and the words of the announcement."""
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    return out.split()


def hello(cache: Path, **settings: str) -> list[str]:
    with started(cache, **settings) as process:
        return finished(process)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """Return a cache that a process has filled, and what that process printed."""
    cache = tmp_path_factory.mktemp("compiled")
    return cache, hello(cache)


def test_code_is_compiled_once_and_announced_then_loaded(made: tuple[Path, list[str]]) -> None:
    cache, first = made
    assert first[0] == "1" and "compiling its real-time code" in " ".join(first) and "not kept" not in " ".join(first)
    assert hello(cache) == ["0", first[1]]
    (folder,) = (cache / "rths").iterdir()
    for kept in folder.glob("*/*.nbc"):
        kept.rename(kept.with_suffix(".away"))  # as if a command compiled a part that no other one has used
    assert "no command here has used yet" in " ".join(hello(cache))
    assert folder.stat().st_mode & 0o777 == 0o700 or os.name != "posix"


@pytest.mark.campaign
def test_code_for_another_processor_is_kept_beside_it(tmp_path: Path) -> None:
    """What numba is told to compile for is a part of the name: neither is loaded in place of the other."""
    quick, generic = {"NUMBA_OPT": "1"}, {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    told = [hello(tmp_path, **settings)[0] for settings in (quick, generic, quick, generic)]
    assert told == ["1", "1", "0", "0"]
    kept = {path: path.read_bytes() for path in tmp_path.rglob("*.nbc")}
    assert len({path.parents[1] for path in kept}) == 2 and len(set(kept.values())) == len(kept) == 2


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-100])


def zeroed(path: Path) -> None:
    path.write_bytes(bytes(path.stat().st_size))


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("damage", "suffix"),
    [(truncated, "nbc"), (zeroed, "nbc"), (Path.unlink, "nbc"), (truncated, "nbi"), (zeroed, "nbi")],
)
def test_damaged_code_is_compiled_again_and_kept(
    made: tuple[Path, list[str]], tmp_path: Path, damage: Callable[[Path], None], suffix: str
) -> None:
    cache, wanted = made
    damaged = Path(shutil.copytree(cache, tmp_path / "damaged"))
    (path,) = damaged.rglob(f"*.{suffix}")
    damage(path)
    told = hello(damaged)
    assert told[:2] == wanted[:2] and "compiling" in told
    assert hello(damaged) == ["0", wanted[1]]


@pytest.mark.campaign
@pytest.mark.parametrize("at", ["*.lock", "*/*.nbi", "*/*.nbc"])
def test_a_process_killed_while_it_compiles_leaves_nothing_wrong(
    made: tuple[Path, list[str]], tmp_path: Path, at: str
) -> None:
    with started(tmp_path) as process:
        while not list(tmp_path.glob(f"rths/*/{at}")) and process.poll() is None:
            time.sleep(0.0005)
        process.kill()
    assert hello(tmp_path)[1] == made[1][1]
    assert hello(tmp_path) == ["0", made[1][1]]


@pytest.mark.campaign
@POSIX
def test_of_processes_that_start_together_one_compiles(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    with started(tmp_path) as first, started(tmp_path) as second, started(tmp_path) as third:
        told = [finished(process) for process in (first, second, third)]
    assert sorted(words[0] for words in told) == ["0", "0", "1"]
    assert {words[1] for words in told} == {made[1][1]}


TOTAL = """
import numpy as np
from rths_cli.numerics.compiled import entry
from rths_cli.numerics.compiler_messages import announce

@entry
def total(values):
    result = 0.0
    for i in range(values.size):
        result += values[i]
    return result

if __name__ == "__main__":
    said = []
    announce(said.append)
    strided = np.repeat(np.arange(5.0), 2)[::2]
    print(len(said), total(np.arange(5.0)), total(np.arange(5)), total(strided), len(said))
"""


def test_an_index_that_names_the_code_of_another_signature_is_found_out(tmp_path: Path) -> None:
    """As two processes that save at the same moment can leave it."""
    (tmp_path / "total.py").write_text(TOTAL)
    code = f"import runpy; runpy.run_path({str(tmp_path / 'total.py')!r}, run_name='__main__')"
    for expected in ("1", "0"):
        with started(tmp_path, code) as process:
            assert finished(process) == ["0", "10.0", "10.0", "10.0", expected]
    one, other, _ = sorted(tmp_path.rglob("*.nbc"))
    kept = one.read_bytes(), other.read_bytes()
    for path, content in zip((other, one), kept, strict=True):
        path.write_bytes(content)
    with started(tmp_path, code) as process:
        assert finished(process)[:4] == ["0", "10.0", "10.0", "10.0"]


PARTS = """
from typing import NamedTuple
from numba.core import event
from rths_cli.numerics.compiled import entry, kept_part

class Foreign(NamedTuple):
    value: float

@kept_part
def doubled(value):
    return 8.0

@entry
def one(value):
    return doubled(value)

@entry
def other(value):
    return doubled(value) + 1.0

class Names(event.Listener):
    def on_start(self, begun):
        told.append(begun.data["dispatcher"].py_func.__name__)
    def on_end(self, ended):
        pass

told = []
event.register("numba:compile", Names())
"""


@POSIX
def test_a_kept_part_is_compiled_once_for_all_its_callers(tmp_path: Path) -> None:
    """A class from outside may change where the folder's name does not: what holds it is compiled anew."""
    (tmp_path / "parts.py").write_text(PARTS)

    def told(call: str) -> list[str]:
        code = f"import sys; sys.path.append({str(tmp_path)!r}); import parts; print(parts.{call}, *parts.told)"
        with started(tmp_path, code) as process:
            return finished(process)

    assert told("one(4.0)") == ["8.0", "one", "doubled"]
    assert told("other(4.0)") == ["9.0", "other"]
    assert told("one(4.0)") == ["8.0"]
    for _ in range(2):
        assert told("other(parts.Foreign(4.0))") == ["9.0", "other", "doubled"]


def test_a_cache_that_cannot_be_made_is_no_fault_and_is_told(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    first = hello(tmp_path / "file")
    assert first[:2] == made[1][:2]
    assert "it is not kept: " in " ".join(first) and str(tmp_path / "file") in first[-1]


@pytest.mark.campaign
def test_files_that_cannot_be_replaced_are_no_fault(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    cache = Path(shutil.copytree(made[0], tmp_path / "taken"))
    (path,) = cache.rglob("*.nbc")
    path.unlink()
    path.mkdir()
    assert hello(cache)[1] == made[1][1]
    shutil.rmtree(path.parent)
    path.parent.touch()
    assert hello(cache) == made[1]
    assert not list(PACKAGE.rglob("*.nbi"))  # where numba would keep it then, under a name without our hash


def test_a_function_without_a_source_file_is_compiled_and_not_kept(tmp_path: Path) -> None:
    code = "from rths_cli.numerics.compiled import entry; print(entry(lambda value: 2.0 * value)(4.0))"
    with started(tmp_path, code) as process:
        assert finished(process) == ["8.0"]
    assert not list(tmp_path.rglob("*.nbi"))


@pytest.mark.campaign
@POSIX
def test_a_full_disk_is_no_fault(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    """A limit on the size of files stands for it: what numba writes to its cache fails."""
    full = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n{HELLO}"
    for _ in range(2):
        with started(tmp_path, full) as process:
            assert finished(process) == made[1]
    assert hello(tmp_path) == made[1]
    assert hello(tmp_path) == ["0", made[1][1]]


@POSIX
@pytest.mark.skipif(os.name == "posix" and os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_that_cannot_be_written_is_not_used_and_is_told(made: tuple[Path, list[str]], tmp_path: Path) -> None:
    cache = Path(shutil.copytree(made[0], tmp_path / "closed"))
    (folder,) = cache.glob("rths/*")
    folder.chmod(0o500)
    told = hello(cache)
    folder.chmod(0o700)
    assert told[:2] == made[1][:2] and f"it is not kept: {folder} cannot be written" in " ".join(told)


@pytest.mark.campaign
@POSIX
def test_a_user_whose_new_files_the_group_may_write_has_a_cache_too(
    made: tuple[Path, list[str]], tmp_path: Path
) -> None:
    before = os.umask(0o002)
    try:
        assert hello(tmp_path) == made[1]
    finally:
        os.umask(before)
    assert hello(tmp_path) == ["0", made[1][1]]


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
        result += values.flat[i]
    return result


@entry
def half(value: float) -> float:
    return 0.5 * value


@pytest.mark.parametrize("value", [None, "1.5", [1.0]])
def test_what_compiled_code_does_not_know_is_refused(value: object) -> None:
    with pytest.raises(NumbaError):
        total(value)


@pytest.mark.parametrize("value", [3, 3.0, np.float32(3.0), np.int32(3), np.uint8(3), np.int64(3), True])
def test_numbers_of_every_type_are_compiled_for_themselves(value: float) -> None:
    assert half(value) == 0.5 * value
    assert half.bind(value)() == 0.5 * value


@pytest.mark.campaign
def test_arrays_of_every_type_and_layout_are_compiled_for_themselves() -> None:
    frozen = np.arange(6.0).reshape(2, 3)
    frozen.flags.writeable = False
    plain = np.arange(12.0)
    arrays = (np.arange(6.0), np.arange(6), np.arange(6, dtype=np.float32), np.arange(6, dtype=np.int32))
    layouts = (frozen, np.asfortranarray(frozen), plain[:6].reshape(2, 3), plain[:6][::-1], 0.5 * plain[::2], plain[:6])
    for array in (*arrays, *layouts):
        assert total(array) == 15.0
    swapped = np.frombuffer(np.arange(7.0).tobytes()[4:-4], np.uint8)
    assert total(swapped) == int(swapped.sum())
    signatures = len(total.dispatcher.overloads)
    assert total(np.arange(6)) == 15.0 and len(total.dispatcher.overloads) == signatures >= 9


def test_an_exception_in_compiled_code_reaches_its_caller() -> None:
    assert raises(np.zeros(3)) == 0.0
    with pytest.raises(ValueError, match=r"^positive$"):
        raises(np.ones(3))
    with pytest.raises(ValueError, match=r"^positive$"):
        raises.bind(np.ones(3))()
    assert raises(np.zeros(3)) == 0.0


def test_what_is_bound_lives_as_long_as_the_function() -> None:
    bound = total.bind(np.full(200_000, 0.5))
    others = [np.zeros(200_000) for _ in range(20)]
    assert bound() == 100_000.0 and len(others) == 20


class Inner(NamedTuple):
    yes: bool
    turned: Array  # a view that is not contiguous
    pair: tuple[int, float]


class Outer(NamedTuple):
    number: int
    cube: Array
    inner: Inner
    no: bool
    words: NDArray[np.int32]
    last: float


@entry
def read_out(outer: Outer, into: Array) -> None:
    inner = outer.inner
    into[0], into[1], into[2] = outer.number, outer.cube[1, 2, 3], 1.0 if inner.yes else 0.0
    into[3], into[4], into[5] = inner.turned[2, 0], inner.pair[0], inner.pair[1]
    into[6], into[7], into[8] = 1.0 if outer.no else 0.0, outer.words[1], outer.last
    into[9] = outer.cube.shape[2] + 10 * len(inner.turned) + 100 * outer.words.size
    inner.turned[1, 1] = -1.0


def test_every_field_of_a_tuple_is_read_where_it_stands_and_its_arrays_are_the_callers() -> None:
    cube, square, into = np.arange(24.0).reshape(2, 3, 4), np.arange(12.0).reshape(3, 4), np.zeros(10)
    inner = Inner(True, square.T, (7, 0.25))
    read_out(Outer(3, cube, inner, False, np.array([5, 6], dtype=np.int32), -0.5), into)
    assert into.tolist() == [3.0, 23.0, 1.0, square[0, 2], 7.0, 0.25, 0.0, 6.0, -0.5, 4 + 40 + 200]
    assert square[1, 1] == -1.0


class Small(NamedTuple):
    single: np.float32
    flag: np.bool_
    few: np.int16


@entry
def read_small(small: Small, into: Array) -> None:
    into[0], into[1], into[2] = small.single, 1.0 if small.flag else 0.0, small.few


def test_numbers_of_other_widths_are_read_as_they_are_and_what_is_none_is_refused() -> None:
    into = np.zeros(3)
    read_small(Small(np.float32(1.5), np.bool_(True), np.int16(-3)), into)
    assert into.tolist() == [1.5, 1.0, -3.0]
    with pytest.raises(TypeError, match="takes numbers, arrays and NamedTuples of these, not str"):
        read_small(Small("a", np.bool_(True), np.int16(1)), into)  # type: ignore[arg-type]


def greedy(n: int) -> float:
    return np.zeros(n).sum()


def counting(pairs: tuple[Array, Array]) -> float:
    larger = pairs[0]
    for i in range(pairs[1].size):
        larger = pairs[0] if pairs[0][i] > pairs[1][i] else pairs[1]
        pairs[0][i] += 1.0
    return larger[0]


def spared(pairs: tuple[Array, Array]) -> float:
    pairs = borrowed(pairs)
    larger = pairs[0]
    for i in range(pairs[1].size):
        larger = pairs[0] if pairs[0][i] > pairs[1][i] else pairs[1]
        pairs[0][i] += 1.0
    return larger[0]


@pytest.mark.campaign
def test_what_allocates_or_counts_references_is_seen_also_when_it_is_loaded() -> None:
    """The second entry of each function loads the code."""
    pair = np.zeros(2), np.ones(2)
    for function, argument, expected in ((greedy, 3, "NRT_MemInfo_alloc"), (counting, pair, "NRT_decref")):
        for made in (Entry(function), Entry(function)):
            made.bind(argument)
            assert any(call.startswith(expected) for call in runtime_calls(made)), function
    for made in (Entry(spared), Entry(spared)):
        assert made(pair) == 1.0
        assert runtime_calls(made) == set()


@pytest.mark.campaign
def test_no_entry_of_the_package_allocates_counts_references_or_calls_python() -> None:
    every_entry.compile_the_loops()
    every_entry.compile_the_exchange()
    every_entry.compile_the_analysis()
    entries = every_entry.entries()
    assert len(entries) >= 20 and cache_folder() is not None
    assert not [name for name, made in entries.items() if not made.dispatcher.overloads]
    assert {name: runtime_calls(made) for name, made in entries.items() if runtime_calls(made)} == {}


UNKNOWN = """
from types import SimpleNamespace
import numpy as np
from rths_cli.numerics import compiled
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.compiler_messages import announce

@entry
def larger(pairs):
    pairs = borrowed(pairs)
    one = pairs[0]
    for i in range(pairs[1].size):
        one = pairs[0] if pairs[0][i] > pairs[1][i] else pairs[1]
        pairs[0][i] += 1.0
    return one[0]

if __name__ == "__main__":
    said = []
    announce(said.append)
    larger.bind((np.zeros(2, np.float32), np.ones(2, np.float32)))
    known, compiled.cgutils = len(said), SimpleNamespace()
    print(known, [larger((np.zeros(2), np.ones(2))) for _ in range(1000)].count(1.0), said[-1])
"""


@pytest.mark.campaign
def test_a_numba_whose_arrays_are_described_in_another_way_runs_slower_and_says_so(tmp_path: Path) -> None:
    (tmp_path / "unknown.py").write_text(UNKNOWN)
    code = f"import runpy; runpy.run_path({str(tmp_path / 'unknown.py')!r}, run_name='__main__')"
    (tmp_path / "file").touch()
    with started(tmp_path / "file", code) as process:
        told = " ".join(finished(process))
    assert told.startswith("1 1000 numba ") and "makes __main__.larger call NRT_decref, NRT_incref: each step" in told


OUTSIDE = """
from typing import NamedTuple
import numpy as np
from rths_cli.numerics.compiled import part_class

@part_class
class Own(NamedTuple):
    values: np.ndarray
    def gained(self):
        return GAIN * self.values[0]
"""
CALLER = """
import numpy as np
from outside import Own
from rths_cli.numerics.compiled import borrowed, entry

@entry
def ask(own):
    own = borrowed(own)
    return own.gained()

print(ask(Own(np.ones(3))))
"""


def test_an_edited_class_from_outside_is_never_met_by_old_code(tmp_path: Path) -> None:
    """The folder's name knows our sources only, and numba looks at the caller's file only."""
    (tmp_path / "caller.py").write_text(CALLER)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); sys.dont_write_bytecode = True; import caller"
    shown = []
    for gain in (1.0, 2.0):
        (tmp_path / "outside.py").write_text(f"GAIN = {gain}\n{OUTSIDE}")
        with started(tmp_path / "cache", code) as process:
            shown.append(finished(process))
    assert shown == [["1.0"], ["2.0"]]


def test_short_loops_are_not_unrolled_for_lengths_they_never_reach() -> None:
    """Code for several rounds at once in every loop costs a fifth of the step and a third of its compilation."""

    def scaled(values: Array, factor: float) -> None:
        for i in range(values.size):
            values[i] *= factor

    made = numba.njit(**compiled.ENTRY)(scaled)
    made(np.ones(3), 2.0)
    code = made.inspect_llvm(made.signatures[0]).split("define ")[1]
    assert code.count("fmul double") == 1
