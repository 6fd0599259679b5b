"""Raw logs: every whole frame is read wherever the file is cut or damaged; a full disk is met before anything moves."""

from __future__ import annotations

import errno
import os
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files import raw_log
from rths_cli.files.durable_files import part_of
from rths_cli.files.raw_log import (
    RawHeader,
    RawLogWriter,
    packed_frame,
    packed_header,
    raw_log_path,
    read_header,
    read_raw_log,
)

HEADER = RawHeader(
    names=("command_v", "base_shear_n", "compute_ns"),
    units=("V", "N", "ns"),
    dt_s=0.001,
    steps=100,
    lead_samples=2,
    run="exp_rths",
    result="demo-20260101T000000Z.h5",
    case_path="/lab/demo.yaml",
    case_yaml="record: el_centro # µ\n",
    resolved_yaml="scaling: 0.3\n",
    attributes={"rig_kind": "udp", "seed": 3, "scaling": 0.1},
)
COLUMNS = np.arange(300.0).reshape(3, 100) / 7.0
CUTS = (0, 1, 6, 7, 30, 64)  # frames of 1, 5, 1, 23 and 34 steps


def write(path: Path) -> bytes:
    """Write the log and return its bytes."""
    with RawLogWriter(path, HEADER) as log:
        for first, end in pairwise(CUTS):
            log.append(first, COLUMNS[:, first:end])
    return path.read_bytes()


def by_hand(data: bytes) -> list[tuple[int, int, np.ndarray]]:
    """Read a log from the documented layout alone: (end of frame, first step, values)."""
    length = int.from_bytes(data[12:16], "little")
    at = 16 + length + 4
    assert struct.unpack("<I", data[at - 4 : at])[0] == zlib.crc32(data[: at - 4])
    frames = []
    while data[at : at + 4] == b"RTHF":
        count, first = struct.unpack("<IQ", data[at + 4 : at + 16])
        end = at + 16 + 3 * 8 * count
        assert struct.unpack("<I", data[end : end + 4])[0] == zlib.crc32(data[at:end])
        frames.append((end + 4, first, np.array(struct.unpack(f"<{3 * count}d", data[at + 16 : end])).reshape(3, -1)))
        at = end + 4
    return frames


def read(path: Path, data: bytes) -> tuple[np.ndarray, int]:
    path.write_bytes(data)
    log = read_raw_log(path)
    return log.columns, log.samples


def test_what_is_written_is_read_back_and_stands_as_documented(tmp_path: Path) -> None:
    data = write(tmp_path / "a.rthslog")
    log = read_raw_log(tmp_path / "a.rthslog")
    assert log.header == HEADER and log.samples == 64
    np.testing.assert_array_equal(log.columns, COLUMNS[:, :64])
    assert data.startswith(b"RTHSLOG\n\1\0\0\0")
    frames = by_hand(data)
    assert frames[-1][0] == len(data) and [first for _, first, _ in frames] == list(CUTS[:-1])
    np.testing.assert_array_equal(np.hstack([values for *_, values in frames]), COLUMNS[:, :64])


def test_a_log_cut_at_any_byte_gives_every_frame_before_the_cut(tmp_path: Path) -> None:
    data = write(tmp_path / "a.rthslog")
    start, ends = 20 + int.from_bytes(data[12:16], "little"), [end for end, *_ in by_hand(data)]
    borders = [place for end in (start, *ends) for place in range(end - 24, end + 24)]
    places = [*borders, *np.random.default_rng(0).integers(start, len(data), 100)]
    for cut in (place for place in places if start <= place <= len(data)):
        columns, samples = read(tmp_path / "cut.rthslog", data[:cut])
        whole = CUTS[sum(end <= cut for end in ends)]
        assert samples == columns.shape[1] == whole, cut
        np.testing.assert_array_equal(columns, COLUMNS[:, :whole])


@pytest.mark.parametrize("seed", range(20))
def test_what_follows_a_cut_does_no_harm(tmp_path: Path, seed: int) -> None:
    noise = np.random.default_rng(seed)
    data = write(tmp_path / "a.rthslog")
    frames = by_hand(data)
    cut = int(noise.integers(frames[0][0], len(data)))
    whole = CUTS[sum(end <= cut for end, *_ in frames)]
    garbage = noise.bytes(3000)
    for tail in (bytes(4096), garbage, b"RTHF" + garbage, b"RTHFRTHF" + bytes(4000), b"RTHF\1\0\0\0" + bytes(40)):
        columns, samples = read(tmp_path / "cut.rthslog", data[:cut] + tail)
        assert samples == whole
        np.testing.assert_array_equal(columns, COLUMNS[:, :whole])


def test_a_damaged_frame_costs_its_own_samples_alone(tmp_path: Path) -> None:
    data = write(tmp_path / "a.rthslog")
    for place in range(*(end for end, *_ in by_hand(data)[:2])):  # every byte of the steps 1 to 5
        damaged = bytearray(data)
        damaged[place] ^= 0x10
        columns, samples = read(tmp_path / "b.rthslog", bytes(damaged))
        assert columns.shape == (3, 64) and samples == 59, place
        assert np.isnan(columns[:, 1:6]).all()
        kept = np.r_[0, 6:64]
        np.testing.assert_array_equal(columns[:, kept], COLUMNS[:, kept])


def test_steps_that_the_run_does_not_have_are_passed_over(tmp_path: Path) -> None:
    data = write(tmp_path / "a.rthslog")
    for first in (2**63, 97):
        columns, samples = read(tmp_path / "b.rthslog", data + packed_frame(first, COLUMNS[:, :4]))
        assert columns.shape == (3, 64) and samples == 64


def test_space_is_taken_at_the_start_and_given_back_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.rthslog"
    with RawLogWriter(path, replace(HEADER, steps=100_000)) as log:
        assert path.stat().st_blocks * 512 >= 3 * 8 * 100_000
        log.append(0, COLUMNS[:, :9])
        assert read(tmp_path / "b.rthslog", path.read_bytes())[1] == 9  # zeros follow
    assert by_hand(path.read_bytes())[-1][0] == path.stat().st_size < 2000


def test_a_log_without_samples_is_removed(tmp_path: Path) -> None:
    with RawLogWriter(tmp_path / "a.rthslog", HEADER):
        assert os.listdir(tmp_path) == ["a.rthslog"]
    assert os.listdir(tmp_path) == []


def test_a_log_is_never_replaced_nor_read_while_it_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.rthslog"
    with RawLogWriter(path, HEADER) as log:
        log.append(0, COLUMNS)
        with pytest.raises(InputError, match=r"a\.rthslog: is being written by a run under way; wait"):
            read_header(path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"a\.rthslog: exists and may hold .* rths recover .* remove it"):
        RawLogWriter(path, HEADER)
    assert path.read_bytes() == before and read_raw_log(path).samples == 100


def test_whoever_sees_a_log_sees_its_header(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, seen = tmp_path / "a.rthslog", []

    def interrupted(part: Path, final: Path) -> None:
        seen.append((part.read_bytes(), os.listdir(tmp_path)))
        raise KeyboardInterrupt

    monkeypatch.setattr(raw_log.os, "rename", interrupted)
    with pytest.raises(KeyboardInterrupt):
        RawLogWriter(path, HEADER)
    ((written, names),) = seen
    assert written == packed_header(HEADER) and names == [part_of(tmp_path / "a.rthslog").name]
    assert os.listdir(tmp_path) == []


def test_the_disk_is_asked_to_keep_frames_at_most_every_quarter_of_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, synced = [10.0], []
    monkeypatch.setattr(raw_log.os, "fdatasync", lambda file: synced.append(now[0]))
    log = RawLogWriter(tmp_path / "a.rthslog", HEADER, lambda: now[0])
    log.sync(at_once=True)
    assert synced == []  # nothing to keep
    for step in range(10):
        log.append(step, COLUMNS[:, step : step + 1])
        log.sync()
        now[0] += 0.0625
    log.sync()
    log.sync()
    assert synced == [10.25, 10.5]
    now[0] += 0.25
    log.sync()
    assert synced == [10.25, 10.5, 10.875]  # what the call at 10.625 left
    log.append(10, COLUMNS[:, 10:11])
    log.sync(at_once=True)
    assert synced[3:] == [10.875]
    log.close()


def test_after_a_failed_write_the_next_takes_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, fails = os.pwrite, [True]

    def half(file: int, data: memoryview, place: int) -> int:
        if len(data) > 3 and fails[0]:
            return real(file, data[:3], place)  # the kernel may write less than asked
        if fails[0]:
            raise OSError(errno.ENOSPC, "full")
        return real(file, data, place)

    path = tmp_path / "a.rthslog"
    with RawLogWriter(path, HEADER) as log:
        log.append(0, COLUMNS[:, :4])
        monkeypatch.setattr(raw_log.os, "pwrite", half)
        with pytest.raises(OSError, match="full"):
            log.append(4, COLUMNS[:, 4:9])
        assert read(tmp_path / "b.rthslog", path.read_bytes())[1] == 4
        fails[0] = False
        log.append(4, COLUMNS[:, 4:50])
    np.testing.assert_array_equal(read_raw_log(path).columns, COLUMNS[:, :50])
    assert [first for _, first, _ in by_hand(path.read_bytes())] == [0, 4]


def sentence(path: Path, data: bytes | None = None) -> str:
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_raw_log(path)
    (fault,) = caught.value.faults
    assert fault.startswith(f"{path}: ") and "\n" not in fault
    return fault


def test_what_is_no_raw_log_is_one_sentence(tmp_path: Path) -> None:
    data = write(tmp_path / "a.rthslog")
    path = tmp_path / "b.rthslog"
    assert sentence(path) == f"{path}: no such file; check the path"
    assert "Is a directory" in sentence(tmp_path)
    for other in (b"", b"RTHSLOG", b"\x89HDF\r\n\x1a\n" + bytes(100), data[:15]):
        assert "is no raw log of rths" in sentence(path, other)
    assert "has version 2" in sentence(path, data[:8] + b"\2" + data[9:])
    length = int.from_bytes(data[12:16], "little")
    for cut in (16, 17, 16 + length - 1, 16 + length + 3):
        assert "header is cut or damaged" in sentence(path, data[:cut])
    for place in (13, 40, 16 + length):
        damaged = bytearray(data)
        damaged[place] ^= 1
        assert "header is cut or damaged" in sentence(path, bytes(damaged))
    for told in (b"{}", b"[]", b'{"names": ["a"], "units": ["V"], "other": 1}'):
        start = struct.pack("<8sII", b"RTHSLOG\n", 1, len(told)) + told
        assert "header is cut or damaged" in sentence(path, start + struct.pack("<I", zlib.crc32(start)))


def in_child(code: str, *words: object) -> subprocess.CompletedProcess[str]:
    tree = str(Path(__file__).parents[2])
    prelude = f"""
import os, resource, sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_raw_log import *
path = Path(sys.argv[1])
"""
    environment = {**os.environ, "PYTHONPATH": tree}
    return subprocess.run(
        [sys.executable, "-c", prelude + code, *map(str, words)], capture_output=True, text=True, env=environment
    )


def test_a_run_that_does_not_fit_on_the_disk_is_refused_before_it_starts(tmp_path: Path) -> None:
    code = """
resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
RawLogWriter(path, HEADER).close()
try:
    RawLogWriter(path, replace(HEADER, steps=50_000))
except InputError as error:
    print(error, end="")
"""
    done = in_child(code, tmp_path / "a.rthslog")
    assert done.returncode == 0, done.stderr
    assert "a.rthslog: cannot take 1.3 MB for the raw log: File too large; free space or choose" in done.stdout
    assert os.listdir(tmp_path) == []


def test_more_than_the_free_space_is_refused_in_numbers(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"MB free, .* MB needed"):
        RawLogWriter(tmp_path / "a.rthslog", replace(HEADER, steps=10**12))
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file, or below one, not a folder"):
        RawLogWriter(tmp_path / "file" / "a.rthslog", HEADER)
    assert os.listdir(tmp_path) == ["file"]


def test_the_name_says_which_run_of_which_result(tmp_path: Path) -> None:
    assert raw_log_path(tmp_path / "a-20260101T000000Z.h5", "exp_rths").name == "a-20260101T000000Z.exp_rths.rthslog"
