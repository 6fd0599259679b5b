"""Files that HDF5 writes through memory: a disk that refuses is an OSError, and the file stays as it was."""

import errno
import os
import resource
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from rths_cli.files.result_writer import ResultWriter
from rths_cli.files.staged_file import StagedFile, new_hdf5

SERIES = np.random.default_rng(15).normal(size=(4, 20_000))


@pytest.fixture
def limit_files() -> Iterator[Callable[[int], None]]:
    """Yield what limits the size of every file, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def write_groups(path: Path, committed: list[str]) -> None:
    """Write four groups, each committed, and note which ones are."""
    with StagedFile(path) as staged, h5py.File(staged, "w") as file:
        for name, values in zip("abcd", SERIES, strict=True):
            file.create_group(name).create_dataset("values", data=values)
            file.flush()
            staged.commit()
            committed.append(name)


@pytest.mark.parametrize(
    ("size", "groups"), [(0, 0), (1, 0), (100, 0), (3_000, 0), (170_000, 1), (330_001, 2), (480_000, 2), (640_000, 3)]
)
def test_a_full_disk_leaves_the_file_as_the_last_commit_left_it(
    tmp_path: Path, limit_files: Callable[[int], None], size: int, groups: int
) -> None:
    path, committed = tmp_path / "a.h5", []
    limit_files(size)
    with pytest.raises(OSError, match="File too large"):
        write_groups(path, committed)
    if committed:
        with h5py.File(path, "r") as file:
            assert list(file) == committed
            for name, values in zip(committed, SERIES, strict=False):
                np.testing.assert_array_equal(file[f"{name}/values"][()], values)
    assert len(committed) == groups


def test_space_is_taken_before_a_byte_is_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, asked = tmp_path / "a", []
    path.write_bytes(b"before")

    def no_space(file: int, start: int, size: int) -> None:
        asked.append((start, size))
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", no_space, raising=False)
    with StagedFile(path, keep=True) as staged:
        staged.write(b"behind" + bytes(94))
        with pytest.raises(OSError, match="No space left"):
            staged.commit()
    assert (path.read_bytes(), asked) == (b"before", [(6, 94)])


def test_the_file_is_what_h5py_itself_would_write(tmp_path: Path) -> None:
    committed: list[str] = []
    write_groups(tmp_path / "a.h5", committed)
    with h5py.File(tmp_path / "a.h5", "r") as file:
        found = {name: file[f"{name}/values"][()] for name in file}
    assert found.keys() == set("abcd") == set(committed)
    np.testing.assert_array_equal([found[name] for name in "abcd"], SERIES)


def test_what_is_not_committed_is_not_on_the_disk(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with new_hdf5(path) as file:
        file["x"] = 1.0
    before = path.read_bytes()
    with StagedFile(path, keep=True) as staged, h5py.File(staged, "r+") as file:
        file["y"] = SERIES
        file["x"][()] = 2.0
        file.flush()
    assert path.read_bytes() == before
    with StagedFile(path, keep=True) as staged:
        with h5py.File(staged, "r+") as file:
            file["x"][()] = 2.0
        staged.commit()
    with h5py.File(path, "r") as file:
        assert file["x"][()] == 2.0


def test_reading_and_cutting_agree_with_a_plain_file(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    plain = bytearray()
    with StagedFile(tmp_path / "a") as staged:
        for _ in range(600):
            place, size = int(rng.integers(0, 3000)), int(rng.integers(1, 200))
            action = rng.integers(0, 10)
            if action == 0:
                staged.commit()
            elif action == 1:
                staged.truncate(place)
                plain[place:] = b""
                plain.extend(bytes(place - len(plain)))
            elif action < 6:
                data = rng.bytes(size)
                staged.seek(place)
                staged.write(data)
                plain.extend(bytes(max(0, place + size - len(plain))))
                plain[place : place + size] = data
            else:
                staged.seek(place)
                assert staged.read(size) == bytes(plain[place : place + size]).ljust(size, b"\0")
        staged.commit()
    assert (tmp_path / "a").read_bytes() == bytes(plain)


class Ended(BaseException):
    """What a signal's handler raises."""


@pytest.fixture
def ended_by_signal() -> Iterator[None]:
    """Let SIGTERM raise an exception, as the command line does."""

    def end(*_: object) -> None:
        raise Ended

    before = signal.signal(signal.SIGTERM, end)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize("number", [1, 2, 5, 8, 12])
def test_a_signal_while_hdf5_writes_ends_the_run_and_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ended_by_signal: None, number: int
) -> None:
    calls = 0
    write = StagedFile.write

    def signalled(self: StagedFile, data: bytes) -> int:
        nonlocal calls
        calls += 1
        if calls == number:
            signal.raise_signal(signal.SIGTERM)
        return write(self, data)

    monkeypatch.setattr(StagedFile, "write", signalled)
    path = tmp_path / "a.h5"
    with pytest.raises(Ended), ResultWriter(path, {"rig_kind": "virtual", "case_name": "a"}) as writer:
        for name in ("sim", "sim_delay", "shake_table", "exp_rths"):
            values = {"base_shear_n" if name.startswith("sim") else "command_v": SERIES[0]}
            writer.group(name, values, time_s=SERIES[1])
        writer.finish("complete")
    assert calls >= number
    assert list(tmp_path.iterdir()) == []


def test_a_signal_is_delivered_once_the_library_has_returned(tmp_path: Path, ended_by_signal: None) -> None:
    path = tmp_path / "a.h5"
    with pytest.raises(Ended), new_hdf5(path) as file:
        signal.raise_signal(signal.SIGTERM)
        file.create_dataset("values", data=SERIES)
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["values"][()], SERIES)
    with pytest.raises(Ended):
        signal.raise_signal(signal.SIGTERM)  # the handler is in place again
