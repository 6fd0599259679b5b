"""Oracle: h5py's own high-level writing and reading of the same numbers and texts."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.typing import NDArray

from rths_cli.files.hdf5 import Dataset, add_dataset, add_text, datasets, is_long, numbers, text, write_group

VALUES = {
    "number": np.array(2.5),
    "count": np.array(3),
    "flag": np.array([True, False]),
    "vector": np.arange(3.0),
    "turned": np.arange(12.0).reshape(3, 4).T,
    "empty": np.zeros((0, 2)),
    "single": np.arange(4, dtype=np.float32),
    "word": np.array("µ m"),
    "words": np.array(["a", "", "long text"]),
    "time": np.arange(20_001) / 2000.0,
    "codes": np.round(100 * np.sin(np.arange(60_000).reshape(2, -1) / 500)),
    "noise": np.random.default_rng(1).normal(size=9000),
}


@pytest.mark.parametrize("name", VALUES)
def test_a_dataset_is_what_h5py_writes(tmp_path: Path, name: str) -> None:
    values: NDArray[np.generic] = VALUES[name]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        add_text(add_dataset(file.id, name, values), "about", "µ, or nothing")
        as_text = values.dtype.kind == "U"
        expected = file.create_dataset(
            "h5py", data=values.astype(object) if as_text else values, dtype=h5py.string_dtype() if as_text else None
        )
        expected.attrs["about"] = "µ, or nothing"
        found = file[name]
        assert found.id.get_type() == expected.id.get_type()
        assert (found.shape, found.maxshape) == (expected.shape, expected.maxshape)
        assert np.array_equal(found[()], expected[()])
        ours, theirs = (node.attrs.get_id("about") for node in (found, expected))
        assert ours.get_type() == theirs.get_type() and ours.shape == theirs.shape
        assert found.attrs["about"] == text(found.id, "about") == "µ, or nothing"
        assert (found.compression == "gzip") == (name in ("time", "codes", "noise")) == is_long(values)
        if not as_text:
            assert np.array_equal(numbers(found.id), np.asarray(values, dtype=float))


def test_small_numbers_stand_in_their_header_and_large_ones_do_not(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for size, layout in ((1, h5py.h5d.COMPACT), (256, h5py.h5d.COMPACT), (257, h5py.h5d.CONTIGUOUS)):
            node = add_dataset(file.id, f"n{size}", np.arange(float(size)))
            assert node.get_create_plist().get_layout() == layout


def test_equal_scales_are_equal_however_they_were_packed(tmp_path: Path) -> None:
    time_s = np.arange(40_001) / 2000.0
    series = Dataset(np.sin(time_s), "m", "made", "computed", definition="sin t")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        written: dict[str, NDArray[np.generic]] = {}
        for name, values in (("a", time_s), ("b", time_s.copy()), ("c", time_s[:-1]), ("d", time_s + 1.0)):
            scale = Dataset(values, "s", "time", "computed")
            one = Dataset(np.sin(values), "m", "made", "computed", definition="sin t")
            write_group(file.create_group(name), {"x": one}, {"time_s": scale}, written)
            assert np.array_equal(file[f"{name}/time_s"][()], values)
            assert file[f"{name}/time_s"].is_scale and file[f"{name}/x"].dims[0][0] == file[f"{name}/time_s"]
        assert file["b/time_s"].id.get_storage_size() == file["a/time_s"].id.get_storage_size() < 50_000
        assert file["b/time_s"].chunks == file["a/time_s"].chunks
        assert file["a/x"].attrs["definition"] == "sin t" and "definition" not in file["a/time_s"].attrs
        assert sorted(written) == [f"/{name}/time_s" for name in "abcd"]
        with pytest.raises(ValueError, match="/a/time_s has other values than in /a/below"):
            write_group(file.create_group("a/below"), {}, {"time_s": Dataset(time_s + 1.0, "s", "time", "computed")})
        write_group(file["a"], {"y": series}, {"time_s": Dataset(time_s, "s", "time", "computed")})
        assert file["a/y"].dims[0][0] == file["a/time_s"]


def test_datasets_below_a_group_come_with_their_paths_and_without_scales(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in ("b/deep/x", "b/a", "c", "b/deep/scale"):
            file[name] = 1.0
        file["b/deep/scale"].make_scale("scale")
        expected: list[str] = []
        file.visititems(lambda path, node: expected.append(path) if isinstance(node, h5py.Dataset) else None)
        assert [path for path, _ in datasets(file)] == [p for p in expected if p != "b/deep/scale"]
        assert [path for path, _ in datasets(file, "b")] == ["a", "deep/x"]
        with pytest.raises(KeyError):
            text(file["c"].id, "units")
