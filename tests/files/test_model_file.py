"""Model files: what is written comes back bit for bit, and any other bytes are refused in one sentence."""

import errno
import hashlib
import os
import re
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest
import xarray
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rths_cli.errors import InputError
from rths_cli.files.hdf5 import Dataset
from rths_cli.files.model_file import read_model, write_model
from rths_cli.files.result_reader import ResultWriter

FREQUENCY = np.linspace(0.1, 60, 600)
FRF = FREQUENCY**2 * np.exp(-0.02j * FREQUENCY)
POLES = np.array([-1 + 20j, -1 - 20j, complex(-0.0, -0.0), complex(np.nan, np.inf)])
ATTRIBUTES = {"rig": "aps400_virtual", "seed": 3, "delay_s": 0.1, "verdict": "fit up to 11 Hz, µ"}
LINES = ("frequency_hz",)


def groups(scale=1.0):
    return {
        "table/frf": {
            "frequency_hz": Dataset(FREQUENCY, "Hz", "frequency", "computed", LINES),
            "frf": Dataset(scale * FRF, "m/s^2/V", "H1, command to table acceleration", "measured", LINES),
            "coherence": Dataset(np.ones(600), "1", "coherence", "measured"),
        },
        "table/best": {
            "poles": Dataset(POLES, "rad/s", "poles", "estimated", ("pole",)),
            "zeros": Dataset(np.zeros(0, dtype=complex), "rad/s", "zeros", "estimated", ("zero",)),
            "gain": Dataset(3, "m/s^2/V", "gain", "estimated"),
        },
        "specimen": {
            "mode_shapes": Dataset(np.array([[1, 2], [3, 4]]), "1", "mode shapes", "estimated", ("storey", "mode")),
            "storey": Dataset([2, 3], "1", "storey", "computed", ("storey",)),
            "reasons": Dataset(["friction", "mode 3, µ"], "1", "reasons of the verdict", "computed", ("reason",)),
            "settings": Dataset("duration_s: 120\n", "1", "settings", "computed"),
        },
    }


def same_bits(a, b):
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("models") / "table.h5"
    return path, write_model(path, ATTRIBUTES, groups()).sha256


def test_what_is_written_is_read_back_bit_for_bit(written):
    path, sha256 = written
    model = read_model(path)
    assert (model.path, model.sha256, model.attributes) == (path, sha256, ATTRIBUTES)
    assert {name: set(group) for name, group in model.groups.items()} == {k: set(g) for k, g in groups().items()}
    best, frf, specimen = model.groups["table/best"], model.groups["table/frf"], model.groups["specimen"]
    assert same_bits(best["poles"], POLES) and same_bits(best["zeros"], np.zeros(0, dtype=complex))
    assert same_bits(frf["frf"], FRF) and same_bits(frf["frequency_hz"], FREQUENCY)
    assert same_bits(specimen["mode_shapes"], np.array([[1.0, 2.0], [3.0, 4.0]]))
    assert best["gain"] == 3.0 and isinstance(best["gain"], float)
    assert specimen["reasons"] == ("friction", "mode 3, µ") and specimen["settings"] == "duration_s: 120\n"


def test_every_dataset_states_unit_meaning_and_source_and_the_root_what_it_is(written):
    path, sha256 = written
    with h5py.File(path) as file:
        assert (file.attrs["format"], file.attrs["format_version"]) == ("rths-model", 1)
        assert file.attrs["sha256"] == sha256
        nodes = []
        file.visititems(lambda name, node: nodes.append(node) if isinstance(node, h5py.Dataset) else None)
        assert len(nodes) == 10 + 3 + 4  # given, complex ones in two parts, axes pole, zero, mode and reason
        assert all({"units", "long_name", "source"} <= set(node.attrs) for node in nodes)
        assert not any(isinstance(node, h5py.Dataset) for node in file.values())


@pytest.mark.parametrize("group", groups())
def test_every_group_opens_in_xarray(written, group):
    with xarray.open_dataset(written[0], group=group, engine="h5netcdf") as data:
        given = {name for name, item in groups()[group].items() if not np.iscomplexobj(item.data)}
        assert given <= set(data.variables)
        for name in given - {"reasons", "settings"}:
            np.testing.assert_array_equal(data[name].values, groups()[group][name].data)
        if group == "table/frf":
            both = data.frf_real + 1j * data.frf_imag
            np.testing.assert_allclose(both.sel(frequency_hz=60.0).item(), FRF[-1], rtol=1e-15)
            assert data.coherence.dims == LINES


def test_the_file_opens_as_a_tree(written):
    with xarray.open_datatree(written[0], engine="h5netcdf") as tree:
        assert set(tree["table"].children) == {"best", "frf"}


def test_the_hash_is_that_of_the_content(tmp_path, written):
    _, sha256 = written
    path = tmp_path / "m.h5"
    reordered = {name: dict(reversed(group.items())) for name, group in reversed(groups().items())}
    shuffled = dict(reversed(ATTRIBUTES.items()))
    assert write_model(path, {**shuffled, "created_utc": "2026-01-01", "path": "elsewhere"}, reordered).sha256 == sha256
    assert read_model(path).sha256 == sha256 and read_model(path).attributes["created_utc"] == "2026-01-01"
    changed = [
        write_model(path, {**ATTRIBUTES, "seed": 4}, groups()).sha256,
        write_model(path, {**ATTRIBUTES, "seed": 3.0}, groups()).sha256,
        write_model(path, {**ATTRIBUTES, "more": ""}, groups()).sha256,
        write_model(path, ATTRIBUTES, groups(1.0 + 1e-15)).sha256,
        write_model(path, ATTRIBUTES, {**groups(), "renamed": groups()["specimen"]}).sha256,
        write_model(
            path, ATTRIBUTES, {name.replace("best", "paper"): group for name, group in groups().items()}
        ).sha256,
    ]
    assert len({sha256, *changed}) == 7


def test_the_same_content_gives_the_same_bytes(tmp_path, written):
    path, _ = written
    write_model(tmp_path / "again.h5", dict(reversed(ATTRIBUTES.items())), groups())
    assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()
    head = path.read_bytes()[:512].rstrip(b"\0").decode()
    assert head == (
        f"rths-model, SHA-256 of all bytes after the first 512: {hashlib.sha256(path.read_bytes()[512:]).hexdigest()}\n"
    )


numbers = st.floats(width=64) | st.complex_numbers() | st.text(st.characters(codec="utf-8", exclude_characters="\0"))
values = st.one_of(
    numbers,
    arrays(float, st.integers(0, 5)),
    arrays(complex, st.tuples(st.integers(0, 3), st.integers(0, 3))),
)
names = st.from_regex("[a-z][a-z0-9_]{0,8}", fullmatch=True).filter(lambda name: not name.endswith(("_real", "_imag")))


def dataset(value):
    dims = tuple(f"AXIS{axis}_{size}" for axis, size in enumerate(np.shape(value)))
    return Dataset(value, "1", "any", "computed", dims)


@pytest.mark.campaign
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.dictionaries(names, st.integers(-(2**63), 2**63 - 1) | st.text(alphabet="aµ\n ", max_size=5) | st.floats()),
    st.dictionaries(names, st.dictionaries(names, values, min_size=1, max_size=3), max_size=3),
)
def test_anything_comes_back(tmp_path_factory, attributes, contents):
    path = tmp_path_factory.mktemp("any") / "m.h5"
    attributes = {f"x_{name}": value for name, value in attributes.items()}
    given_groups = {f"g/{name}": {k: dataset(v) for k, v in group.items()} for name, group in contents.items()}
    sha256 = write_model(path, attributes, given_groups).sha256
    model = read_model(path)
    assert model.sha256 == sha256 and repr(model.attributes) == repr(dict(sorted(attributes.items())))
    assert set(model.groups) == set(given_groups)
    for name, group in contents.items():
        assert set(model.groups[f"g/{name}"]) == set(group)
        for key, value in group.items():
            back = model.groups[f"g/{name}"][key]
            if np.ndim(value):
                assert same_bits(back, value)
            else:
                assert type(back) is type(value)
                assert np.asarray(back).tobytes() == np.asarray(value).tobytes()


@pytest.mark.parametrize(
    ("attributes", "contents", "complaint"),
    [
        ({"sha256": "x"}, {}, "attribute sha256 belongs to the file format"),
        ({}, {"a": {"x_real": dataset(1.0)}}, "a/x_real cannot be read back"),
        ({}, {"a": {"b/c": dataset(1.0)}}, "a/b/c cannot be read back"),
        ({}, {"": {"b": dataset(1.0)}}, "/b cannot be read back"),
        ({}, {"a": {"b": Dataset(1.0, "", "b", "computed")}}, "needs units"),
        ({}, {"a": {"b": Dataset([1.0], "1", "b", "computed")}}, "fits no scale"),
    ],
)
def test_what_could_not_be_read_back_is_a_bug_of_the_caller(tmp_path, attributes, contents, complaint):
    with pytest.raises(ValueError, match=complaint):
        write_model(tmp_path / "m.h5", attributes, contents)
    assert list(tmp_path.iterdir()) == []


def test_a_file_name_that_is_no_text_is_escaped(tmp_path):
    write_model(tmp_path / "m.h5", {"data": "m\udcffe"}, {})
    assert read_model(tmp_path / "m.h5").attributes == {"data": "m\\udcffe"}


def test_a_model_is_replaced_unless_it_must_not_be(tmp_path):
    path = tmp_path / "new" / "folder" / "m.h5"
    first = write_model(path, ATTRIBUTES, groups())
    other = write_model(path, ATTRIBUTES, groups(2.0), replaces=None)
    assert (first.path, other.path) == (path, path.with_name("m-2.h5"))
    assert [read_model(one.path).sha256 for one in (first, other)] == [first.sha256, other.sha256]
    second = write_model(path, ATTRIBUTES, groups(2.0))
    assert read_model(path).sha256 == second.sha256 == other.sha256 != first.sha256
    assert write_model(path.with_name("n.h5"), ATTRIBUTES, groups(2.0), replaces=None).path.name == "n.h5"
    assert sorted(os.listdir(path.parent)) == ["m-2.h5", "m.h5", "n.h5"]


def refused(path, write=False):
    with pytest.raises(InputError) as caught:
        write_model(path, ATTRIBUTES, groups()) if write else read_model(path)
    (sentence,) = caught.value.faults
    assert sentence.startswith(f"{path}: ") and "\n" not in sentence
    return sentence


def test_a_disk_that_refuses_is_one_sentence_and_leaves_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    assert "cannot write the model file: Not a directory; free" in refused(tmp_path / "file" / "m.h5", write=True)
    (tmp_path / "folder").mkdir()
    assert "cannot write the model file: Is a directory; free" in refused(tmp_path / "folder", write=True)
    path = tmp_path / "m.h5"
    write_model(path, ATTRIBUTES, groups(2.0))
    before = path.read_bytes()

    def full(_):
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(os, "fsync", full)
    assert "cannot write the model file: No space left on device; free space or" in refused(path, write=True)
    assert path.read_bytes() == before
    assert sorted(os.listdir(tmp_path)) == ["file", "folder", "m.h5"]


def test_ctrl_c_while_it_is_written_leaves_the_old_model(tmp_path, monkeypatch):
    before = write_model(tmp_path / "m.h5", ATTRIBUTES, groups()).sha256

    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_model(tmp_path / "m.h5", ATTRIBUTES, groups(2.0))
    assert os.listdir(tmp_path) == ["m.h5"] and read_model(tmp_path / "m.h5").sha256 == before


WRITE_FOR_EVER = """
import sys
from pathlib import Path
import numpy as np
from rths_cli.files.hdf5 import Dataset
from rths_cli.files.model_file import write_model
noise = np.random.default_rng(0).normal(size=200_000)
for k in range(10**9):
    data = Dataset(noise + k % 2, "1", "noise", "computed", ("sample",))
    print(write_model(Path(sys.argv[1]), {"k": k % 2}, {"a": {"noise": data}}).sha256, flush=True)
"""


@pytest.mark.campaign
def test_a_killed_writer_leaves_the_old_model_or_the_new_one(tmp_path):
    path, random = tmp_path / "m.h5", np.random.default_rng(1)
    for _ in range(4):
        child = subprocess.Popen([sys.executable, "-c", WRITE_FOR_EVER, str(path)], stdout=subprocess.PIPE, text=True)
        known = {child.stdout.readline().strip(), child.stdout.readline().strip()}
        time.sleep(0.03 * random.random())
        child.send_signal(signal.SIGKILL)
        child.communicate()
        assert read_model(path).sha256 in known and len(known) == 2


def test_other_files_are_named_for_what_they_are(tmp_path, written):
    path = tmp_path / "m.h5"
    assert refused(path) == f"{path}: no such file; check the path"
    assert "cannot read: Is a directory" in refused(tmp_path)
    path.write_text("format: rths-model\n")
    assert "is not an HDF5 file; give a model file written by rths identify" in refused(path)
    with h5py.File(path, "w") as file:
        file.attrs["format"] = "something else"
    assert "is HDF5, but not a model file of rths" in refused(path)
    with ResultWriter(path, {"rig_kind": "virtual"}) as writer:
        writer.finish("complete")
    assert "is a result file of rths run; give a model file written by rths identify" in refused(path)


def sealed(path, change):
    """Change a model file as another program could, its first block included."""
    data = path.read_bytes()
    with h5py.File(path, "r+") as file:
        change(file)
    after = path.read_bytes()[512:]
    assert path.read_bytes() != data
    head = b"rths-model, SHA-256 of all bytes after the first 512: " + hashlib.sha256(after).hexdigest().encode()
    path.write_bytes((head + b"\n").ljust(512, b"\0") + after)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda file: file.attrs.update({"format_version": 2}), "is rths-model version 2, this rths reads rths-model"),
        (lambda file: file.attrs.update({"format": "rths-else"}), "is rths-else version 1, this rths reads"),
        (lambda file: file.attrs.update({"seed": 4}), "holds other content than its attribute sha256 says"),
        (lambda file: file["table/best/gain"].write_direct(np.array(3.1)), "holds other content than its attribute"),
        (lambda file: file.move("specimen/storey", "specimen/storez"), "holds other content than its attribute"),
        (lambda file: file.attrs.pop("sha256"), "holds other content than its attribute"),
        (lambda file: file.attrs.pop("format"), "holds something else than a model"),
        (lambda file: file.pop("table/best/poles_imag"), "holds something else than a model"),
        (lambda file: file.attrs.update({"format_version": "new"}), "holds something else than a model"),
    ],
)
def test_content_that_was_changed_is_refused(tmp_path, written, change, sentence):
    path = tmp_path / "m.h5"
    path.write_bytes(written[0].read_bytes())
    with h5py.File(path, "r+") as file:
        change(file)
    assert re.search(
        r"is (truncated: \d+ of \d+ bytes are there|damaged or edited); take it from a copy", refused(path)
    )
    path.write_bytes(written[0].read_bytes())
    sealed(path, change)
    assert sentence in refused(path)


def test_damaged_and_truncated_bytes_are_refused(tmp_path, written):
    whole, random, path = written[0].read_bytes(), np.random.default_rng(3), tmp_path / "m.h5"
    for k in range(300):
        data = bytearray(whole if k % 4 else whole[: random.integers(len(whole))])
        if k % 4:
            data[random.integers(len(data))] ^= 1 << random.integers(8)
        path.write_bytes(data)
        assert "damaged" in refused(path) or "not an HDF5 file" in refused(path)
