"""Oracle: zlib and HDF5's own filters, which read every chunk back bit for bit."""

from __future__ import annotations

import zlib
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from rths_cli.files.compressed_chunks import LONGEST, chunk_at, chunk_length, deflated, put_chunk, write_chunks
from rths_cli.files.hdf5 import add_dataset

RANDOM = np.random.default_rng(5)
TIME = np.arange(50_001) / 2000.0
SERIES = {
    "smooth": np.sin(TIME) * np.exp(-((TIME - 9.0) ** 2)),
    "noise": RANDOM.normal(size=TIME.size),
    "noise in the middle": np.where(abs(TIME - 12.0) < 1.0, RANDOM.normal(size=TIME.size), 0.0),
    "not a number": np.where(TIME > 3.0, np.nan, -np.inf),
    "negative zero": np.full(TIME.size, -0.0),
    "single": np.sin(TIME).astype(np.float32),
    "counts": np.arange(TIME.size) // 7,
    "every second": np.repeat(np.sin(TIME), 2)[::2],
    "storeys": np.sin(TIME + np.arange(3)[:, None]),
    "over time": np.ascontiguousarray(np.sin(TIME + np.arange(3)[:, None]).T).T,
}


@pytest.mark.parametrize("name", SERIES)
def test_hdf5_reads_every_bit_back(tmp_path: Path, name: str) -> None:
    values: NDArray[np.generic] = SERIES[name]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        add_dataset(file.id, "values", values)
    with h5py.File(tmp_path / "a.h5") as file:
        found = file["values"]
        assert (found.compression, found.shuffle, found.dtype) == ("gzip", True, values.dtype)
        assert found[()].tobytes() == values.tobytes()


@given(st.binary(max_size=4000).map(lambda data: np.frombuffer(data[: len(data) // 8 * 8])))
def test_any_bytes_come_back_shuffled(values: NDArray[np.float64]) -> None:
    if values.size:
        shuffled = values.view(np.uint8).reshape(-1, 8).T.tobytes()
        assert zlib.decompress(deflated(values)) == shuffled


@pytest.mark.parametrize("name", ["smooth", "noise", "storeys"])
def test_little_is_lost_to_plain_gzip(tmp_path: Path, name: str) -> None:
    values = SERIES[name]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        add_dataset(file.id, "ours", values)
        chunks = file["ours"].chunks
        file.create_dataset("gzip", data=values, chunks=chunks, shuffle=True, compression="gzip", compression_opts=1)
        ours, plain = (file[name].id.get_storage_size() for name in ("ours", "gzip"))
    assert ours < 1.03 * plain


@pytest.mark.parametrize("samples", [1, 100, LONGEST, LONGEST + 1, 107_481, 10 * LONGEST + 1])
def test_rows_are_divided_evenly(samples: int) -> None:
    length = chunk_length(samples)
    chunks = -(-samples // length)
    assert length <= LONGEST and chunks == -(-samples // LONGEST)
    assert chunks * length - samples < chunks  # padded values


class Watched:
    """A dataset that notes whether another thread could have called HDF5 during each of its calls."""

    def __init__(self, of: h5py.h5d.DatasetID, threads: ThreadPoolExecutor) -> None:
        self.of, self.threads, self.lock_was_free = of, threads, list[bool]()

    def _look(self) -> None:
        done, _ = wait([self.threads.submit(h5py.h5.get_libversion)], timeout=0.1)
        self.lock_was_free.append(bool(done))

    def write_direct_chunk(self, *told: object) -> None:
        self._look()
        self.of.write_direct_chunk(*told)

    def read_direct_chunk(self, *told: object) -> tuple[int, bytes]:
        self._look()
        mask, packed = self.of.read_direct_chunk(*told)
        return mask, packed


def test_no_other_thread_is_in_hdf5_while_chunks_are_written_or_read(tmp_path: Path) -> None:
    """HDF5 is no library for threads: h5py calls it under one lock, but for chunks only since 3.16."""
    values = np.sin(TIME)
    with h5py.File(tmp_path / "a.h5", "w") as file, ThreadPoolExecutor(9) as threads:
        add_dataset(file.id, "values", values)
        node = Watched(file["values"].id, threads)
        mask, packed = chunk_at(node, (0,))
        put_chunk(node, (0,), packed, mask)
        write_chunks(node, values)
        assert file["values"][()].tobytes() == values.tobytes()
    assert len(node.lock_was_free) > 3 and not any(node.lock_was_free)
