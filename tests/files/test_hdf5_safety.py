"""Result files that somebody made or damaged: one sentence, nothing is followed elsewhere, nothing is waited for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.files.hdf5 import Dataset, write_group
from rths_cli.files.hdf5_safety import DEEPEST, LayoutError, held
from rths_cli.files.result_listing import read_outlines
from rths_cli.files.result_reader import ResultWriter, read_checked, read_dataset

Edit = Callable[[h5py.File], object]


def made(folder: Path) -> Path:
    """Write a small result."""
    path = folder / "a.h5"
    shear = {"base_shear_n": np.zeros(50)}
    figures = {
        "exp_rths.rms_error_m_s2": [0.1, 0.2, np.nan],
        "sim_delay.rms_error_m_s2": [0.1, 0.2, 0.3],
        "check.gain_margin": np.inf,
    }
    with ResultWriter(path, {"case_name": "a", "rig_kind": "virtual", "scaling": 0.3}) as writer:
        writer.case("record: a\n", "record: a\n")
        writer.group("record", {}, np.arange(50) / 2000)
        writer.group("sim", shear, np.arange(50) / 2000)
        roots = {"poles": np.array([-1 + 2j, -1 - 2j])}
        lines = {"frequency_hz": np.arange(1.0, 9.0)}
        writer.group("identification", roots, scales=lines)
        writer.block("feedback", np.eye(2), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), 0.0005, ["a"], ["b"])
        writer.metrics(figures)
        writer.finish("complete")
    return path


def everything(path: Path) -> None:
    """Read all that commands read."""
    read_checked(path, whole=True)
    for group, outline in read_outlines(path).items():
        for name in (*outline.scales, *outline.datasets):
            read_dataset(path, f"{group}/{name}")


def replaced(name: str, data: object) -> Edit:
    def edit(file: h5py.File) -> None:
        del file[name]
        node = file.create_dataset(name, data=data)
        node.attrs.update({"units": "m/s^2", "long_name": "x", "definition": "x", "source": "computed"})

    return edit


def linked(link: object) -> Edit:
    def edit(file: h5py.File) -> None:
        del file["sim"]
        file["sim"] = link

    return edit


def huge(file: h5py.File) -> None:
    del file["metrics/exp_rths/rms_error_m_s2"]
    file.create_dataset("metrics/exp_rths/rms_error_m_s2", (10**12,), dtype="f8", chunks=(1024,))


def elsewhere(file: h5py.File) -> None:
    del file["sim/base_shear_n"]
    file.create_dataset("sim/base_shear_n", (50,), dtype="f8", external=[("pipe", 0, 400)])


def circle(file: h5py.File) -> None:
    for name in ("b", "c", "d"):
        file[f"metrics/{name}"] = file["metrics"]


def deep(file: h5py.File) -> None:
    file.create_group("metrics/" + "g/" * (DEEPEST + 1))


def put(name: str, length: int) -> Edit:
    """Put a series of another length, with a scale of its own, into a result that is otherwise whole."""
    group, _, leaf = name.rpartition("/")

    def edit(file: h5py.File) -> None:
        data = {leaf: Dataset(np.zeros(length), "N", "x", "computed")}
        write_group(file.create_group("put"), data, {"time_s": Dataset(np.arange(length), "s", "time", "computed")})
        file.move("put", group)

    return edit


def filled(name: str, value: float) -> Edit:
    def edit(file: h5py.File) -> None:
        file[name][...] = value

    return edit


def unnamed(key: str, value: str) -> Edit:
    """Give a series a unit, a meaning or a source that rths writes for none."""

    def edit(file: h5py.File) -> None:
        file["sim/base_shear_n"].attrs[key] = value

    return edit


DAMAGES: dict[str, tuple[Edit, str]] = {
    "link to a pipe": (linked(h5py.ExternalLink("pipe", "/")), "link to another place or file at sim"),
    "soft link": (linked(h5py.SoftLink("/metrics")), "link to another place"),
    "circle of links": (linked(h5py.SoftLink("/sim")), "link to another place"),
    "values in a pipe": (elsewhere, "keeps the values of sim/base_shear_n in another file"),
    "terabytes": (huge, "declares 8000000 MB in "),
    "circle of groups": (circle, "groups in a circle"),
    "deep groups": (deep, "groups in a circle"),
    "many figures": (replaced("metrics/exp_rths/rms_error_m_s2", np.ones((3, 3))), "neither a number nor a row"),
    "other storeys": (replaced("metrics/exp_rths/rms_error_m_s2", np.ones(4)), "4 values of|3 values of"),
    "one number": (replaced("metrics/exp_rths/rms_error_m_s2", 1.0), "one value per storey"),
    "too many numbers": (replaced("metrics/check/gain_margin", np.ones(2)), "must have one value"),
    "a text": (replaced("metrics/check/gain_margin", "x"), "neither a number nor"),
    "a vast number": (replaced("metrics/check/gain_margin", 1e308), "beyond 1e"),
    "a record": (replaced("metrics/check/gain_margin", np.zeros(1, [("a", "f8")])), "else than numbers or texts"),
    "nothing": (replaced("metrics/check/gain_margin", h5py.Empty("f8")), "else than numbers or texts"),
    "series of two axes": (replaced("sim/base_shear_n", np.ones((2, 50))), "2 axes in sim/base_shear_n"),
    "series without a scale": (replaced("sim/base_shear_n", np.ones(40)), "not the scale time_s of its own group"),
    "truth of other length": (put("sim/truth/table_accel_m_s2", 40), "40 samples of sim/truth/.* and 50 of sim/time_s"),
    "run beyond the record": (put("exp_rths/command_v", 60), "60 samples of exp_rths/.* and 50 of record/time_s"),
    "series without a unit": (unnamed("units", ""), "sim/base_shear_n without units, long_name or a source"),
    "series without a meaning": (unnamed("long_name", ""), "sim/base_shear_n without units, long_name or a source"),
    "series of another source": (unnamed("source", "guessed"), "sim/base_shear_n without units, long_name or a source"),
    "matrix of other size": (replaced("controller/feedback/B", np.ones((5, 1))), "controller/feedback that do not fit"),
    "matrix of one axis": (replaced("controller/feedback/D", np.ones(3)), "not the four matrices"),
    "matrix of texts": (replaced("controller/feedback/D", [["x"]]), "no numbers in controller/feedback/D"),
    "time that stands": (filled("record/time_s", 0.0), "do not rise in record/time_s"),
    "frequency": (filled("identification/frequency_hz", -1.0), "do not rise in"),
    "root": (filled("identification/poles_real", np.inf), "not finite in identification/poles_real"),
    "scaling": (lambda file: file.attrs.update(scaling="x"), "scaling = 'x'"),
    "not finite": (lambda file: file.attrs.update(note=np.nan), "'note' that is neither"),
    "empty version": (lambda file: file.attrs.update(rths_version=np.zeros(0)), "'rths_version' that is neither"),
    "status": (lambda file: file.attrs.update(status="grand"), "status 'grand'"),
    "published": (lambda file: file.attrs.update(reference_json='{"a": "x"}'), "no numbers"),
    "brackets": (lambda file: file.attrs.update(package_versions="[" * 50_000), "no JSON"),
    "name": (lambda file: file.move("sim", "\x1b[2J"), "object with the name"),
}


@parametrize_first(10, "damage", DAMAGES)
def test_a_file_that_is_not_what_it_must_be_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, damage: str
) -> None:
    path, (edit, said) = made(tmp_path), DAMAGES[damage]
    os.mkfifo(tmp_path / "pipe")
    everything(path)
    with h5py.File(path, "r+") as file:
        edit(file)
    monkeypatch.chdir(tmp_path)
    other_end = os.open("pipe", os.O_RDWR | os.O_NONBLOCK)  # code that follows the link fails here instead of waiting
    try:
        with pytest.raises(InputError, match=said) as caught:
            everything(path)
    finally:
        os.close(other_end)
    assert len(caught.value.faults) == 1 and str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("kind", ["pipe", "folder", "device", "circle"])
def test_what_is_no_file_is_not_waited_for(tmp_path: Path, kind: str) -> None:
    path = Path("/dev/zero") if kind == "device" else tmp_path / kind
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "circle":
        path.symlink_to(path)
    with pytest.raises(InputError, match="cannot read"):
        read_checked(path)


def test_a_list_of_any_length_in_an_attribute_is_not_read(tmp_path: Path) -> None:
    """The library dies of one whose declaration is damaged: one flipped bit makes such a list of a text."""
    with h5py.File(tmp_path / "x.h5", "w") as file:
        lists = np.array([np.arange(2, dtype=np.int32), np.arange(3, dtype=np.int32)], object)
        file.attrs.create("command_line", lists, dtype=h5py.vlen_dtype(np.int32))
        file.attrs["rig"], file.attrs["seed"] = "lab", 5
        assert [held(file, name) for name in ("rig", "seed")] == ["lab", 5]
        with pytest.raises(LayoutError, match="'command_line' that holds neither texts nor numbers"):
            held(file, "command_line")


def test_a_result_that_lost_its_sample_rate_says_so(tmp_path: Path) -> None:
    """It is read all the same: only what needs the rate, as a page's table model, is refused."""
    found = read_checked(made(tmp_path))
    assert found.groups
    with pytest.raises(InputError, match="has lost its attribute sample_rate_hz; run the case again"):
        found.sample_rate_hz  # noqa: B018


def test_every_nan_that_is_read_is_quiet(tmp_path: Path) -> None:
    """Damaged bytes make signalling ones: the first arithmetic with one prints a warning of numpy."""
    path = made(tmp_path)
    signalling = np.array([0x7FF0000000000001], np.uint64)
    with h5py.File(path, "r+") as file:
        file["sim/base_shear_n"][3:4] = signalling.view(float)
    bits = np.asarray(read_dataset(path, "sim/base_shear_n").data).view(np.uint64)
    assert bits[3] == np.array(np.nan).view(np.uint64)
