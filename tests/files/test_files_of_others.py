"""Files that another program holds, that lie on a storage without locks, are cut off, foreign or not to be read.

Each is told apart, in results, sweeps and models, and nobody is told to repeat a test on a real rig.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files.model_file import read_model, write_model
from rths_cli.files.result_reader import read_result, read_series
from rths_cli.files.sweep_file import read_sweep, write_sweep
from tests.files.test_model_file import ATTRIBUTES as OF_MODEL
from tests.files.test_model_file import groups
from tests.files.test_sweep_files import made
from tests.helpers.page_results import write as virtual_result

Read = Callable[[Path], object]
AGAIN = ("run the case again", "run it again", "identify again", "run the sweep again")
NO_LOCKS = """
#include <errno.h>
#include <stdlib.h>
int flock(int file, int how) { errno = atoi(getenv("LOCK_ERRNO")); return -1; }
"""
HOLD = """
import sys, h5py
with h5py.File(sys.argv[1], "r+") as file:
    print("held", flush=True)
    sys.stdin.read()
"""


def real_result(path: Path) -> None:
    """Write a result of a real rig."""
    from tests.cli.test_existing_files import hardware_result

    hardware_result(path)


WRITE: dict[str, Callable[[Path], object]] = {
    "result": virtual_result,
    "result of a real rig": real_result,
    "sweep": lambda path: write_sweep(path, made()),
    "model": lambda path: write_model(path, OF_MODEL, groups()),
}
READ: dict[str, Read] = {
    "result": read_result,
    "result of a real rig": read_result,
    "sweep": read_sweep,
    "model": read_model,
}


@pytest.fixture(params=WRITE)
def kind(request: pytest.FixtureRequest) -> str:
    """Return each kind of file that is read back."""
    return str(request.param)


def refused(read: Read, path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    (sentence,) = caught.value.faults
    assert sentence.startswith(f"{path}: ")
    return sentence


@contextmanager
def held(path: Path) -> Iterator[None]:
    """Hold a file open for writing in another process, as an HDF5 viewer does."""
    with subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as it:
        assert it.stdout is not None and it.stdin is not None
        assert it.stdout.readline() == b"held\n"
        yield
        it.stdin.close()


@pytest.mark.campaign
def test_a_file_that_another_program_writes_is_told_so(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.h5"
    WRITE[kind](path)
    whole = path.read_bytes()
    with held(path):
        told = refused(READ[kind], path)
    assert told.endswith(
        "is open for writing in another program; close it there, or read a copy of the file"
    ) and not any(word in told for word in ("damaged", "truncated", *AGAIN))
    path.write_bytes(whole)  # the library changes a file that it opens for writing
    assert READ[kind](path)


@pytest.mark.campaign
def test_a_file_that_others_read_is_read_beside_them(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.h5"
    WRITE[kind](path)
    with subprocess.Popen(
        [sys.executable, "-c", HOLD.replace("r+", "r"), str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as reader:
        assert reader.stdout is not None and reader.stdin is not None and reader.stdout.readline() == b"held\n"
        assert READ[kind](path)
        reader.stdin.close()


@pytest.mark.campaign
@pytest.mark.parametrize("number", ["ENOLCK", "ENOSYS", "EOPNOTSUPP"])
def test_a_storage_without_locks_is_read_without_one(tmp_path: Path, number: str) -> None:
    """The system call that locks a file fails in the process that reads, as on such a storage."""
    import errno

    library = tmp_path / "no_locks.so"
    (tmp_path / "no_locks.c").write_text(NO_LOCKS)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, tmp_path / "no_locks.c"], check=True)
    for kind, write in WRITE.items():
        write(tmp_path / f"{kind}.h5")
    script = (
        "import sys; from pathlib import Path\n"
        "from tests.files.test_files_of_others import READ\n"
        "for kind, read in READ.items(): read(Path(sys.argv[1]) / f'{kind}.h5')\n"
        "print('read')\n"
    )
    without = {"LD_PRELOAD": str(library), "LOCK_ERRNO": str(getattr(errno, number))}
    words = [sys.executable, "-c", script, str(tmp_path)]
    done = subprocess.run(words, env=os.environ | without, capture_output=True, text=True)
    assert (done.stdout, done.returncode) == ("read\n", 0), done.stderr
    asked = without | {"HDF5_USE_FILE_LOCKING": "TRUE"}
    done = subprocess.run(words, env=os.environ | asked, capture_output=True, text=True)
    assert done.returncode == 1 and "is on a storage without file locks" in done.stderr


def test_a_file_that_is_cut_off_says_how_much_of_it_is_there(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.h5"
    WRITE[kind](path)
    whole = path.read_bytes()
    for length in (len(whole) // 4, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        told = refused(READ[kind], path)
        assert f"is truncated: {length} of {len(whole)} bytes are there" in told, told
        assert "take it from a copy, and keep this one until then" in told
        assert not any(word in told for word in AGAIN)


def test_damage_is_no_truncation_and_no_reason_to_repeat_a_real_test(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.h5"
    WRITE[kind](path)
    whole = bytearray(path.read_bytes())
    start = 512 if kind == "model" else 0
    whole[start + 13 : start + 60] = bytes(47)  # of the superblock
    path.write_bytes(whole)
    told = refused(READ[kind], path)
    assert "is damaged" in told and "truncated" not in told and not any(word in told for word in AGAIN)


def test_foreign_and_empty_files_are_told_apart(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.h5"
    path.write_bytes(b"time, accel\n" * 100)
    assert any(
        word in refused(READ[kind], path) for word in ("is not an HDF5 file", "is no file that rths sweep wrote")
    )
    path.write_bytes(b"")
    assert "is empty" in refused(READ[kind], path)
    with h5py.File(path, "w") as file:
        file["somebody's"] = np.arange(3)
    told = refused(READ[kind], path)
    words = ("is not a result file of rths", "is no file that rths sweep wrote", "is HDF5, but not a model file")
    assert any(word in told for word in words)


def test_a_file_that_may_not_be_read_says_so(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.h5"
    WRITE[kind](path)
    READ[kind](path)  # everything is imported
    path.chmod(0)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        told = refused(READ[kind], path)
    finally:
        os.seteuid(user)
    assert told == f"{path}: cannot read: Permission denied; allow this user to read it."


def test_a_result_of_a_real_rig_with_a_fault_inside_is_never_run_again(tmp_path: Path) -> None:
    for write, advised in ((virtual_result, "run the case again"), (real_result, "keep this one until then")):
        path = tmp_path / "a.h5"
        path.unlink(missing_ok=True)
        write(path)
        with h5py.File(path, "r+") as file:
            file["record/linked"] = h5py.ExternalLink("b.h5", "x")
            file["metrics/linked"] = h5py.ExternalLink("b.h5", "x")
        told = refused(lambda path: (read_result(path), read_series(path, "record/linked")), path)
        assert told.rstrip(".").endswith(advised) and "link" in told


def test_sweeps_are_of_virtual_rigs_and_can_be_run_again(tmp_path: Path) -> None:
    path = tmp_path / "s.h5"
    write_sweep(path, made())
    with h5py.File(path, "r+") as file:
        del file["seed"]
    assert refused(read_sweep, path).endswith("run the sweep again.")
