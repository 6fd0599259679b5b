"""Models brought along: every form of one model gives the same response; what is no table's model says so."""

import json
import os
import re
import struct
import time

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.signal import freqs, freqs_zpk, zpk2tf

from rths_cli.errors import InputError
from rths_cli.files import sandboxed_reading
from rths_cli.files.foreign_models import is_foreign, read_foreign
from rths_cli.files.hdf5 import Dataset
from rths_cli.files.model_file import write_model

FREQUENCY_HZ = np.geomspace(0.3, 60.0, 50)
OMEGA = 2 * np.pi * FREQUENCY_HZ
ZEROS = np.array([0, 0, -0.9 + 20.1j, -0.9 - 20.1j, -2 + 52.8j, -2 - 52.8j])
POLES = np.array([-0.8 + 19.8j, -0.8 - 19.8j, -2 + 52.5j, -2 - 52.5j, -50 + 70j, -50 - 70j, -600])
GAIN = float(0.0079 * np.prod(-POLES).real / np.prod(-ZEROS[2:]).real)
STATED = freqs_zpk(ZEROS, POLES, GAIN, OMEGA)[1]


def response(model):
    """Return a model's own formula without the delay, evaluated as a product of quotients."""
    s = 2j * np.pi * FREQUENCY_HZ
    return model.gain * np.prod(s - model.zeros[:, None], axis=0) / np.prod(s - model.poles[:, None], axis=0)


def pairs(roots):
    return [float(root.real) if root.imag == 0 else [float(root.real), float(root.imag)] for root in np.array(roots)]


def zpk(zeros=ZEROS, poles=POLES, gain=GAIN, **others):
    return {"zeros": pairs(zeros), "poles": pairs(poles), "gain": gain, **others}


def write_text(path, keys):
    path.write_text(keys if isinstance(keys, str) else json.dumps(keys))
    return path


def matlab_node(group, name, value, file):
    """Write one variable the way MATLAB's -v7.3 does: transposed, complex as a compound, cells as references."""
    if isinstance(value, list):
        inner = file.require_group("#refs#")
        cells = [matlab_node(inner, f"{name}{k}", item, file).ref for k, item in enumerate(value)]
        node = group.create_dataset(name, data=np.array([cells], dtype=object), dtype=h5py.ref_dtype)
        node.attrs["MATLAB_class"] = np.bytes_("cell")
        return node
    if isinstance(value, str):
        node = group.create_dataset(name, data=np.array([[ord(letter)] for letter in value], dtype=np.uint16))
        node.attrs.update({"MATLAB_class": np.bytes_("char"), "MATLAB_int_decode": 2})
        return node
    data = np.atleast_2d(np.asarray(value)).T
    if data.size == 0:
        node = group.create_dataset(name, data=np.array([0, 1], dtype=np.uint64))
        node.attrs["MATLAB_empty"] = 1
    elif np.iscomplexobj(data):
        node = group.create_dataset(name, data.shape, dtype=[("real", "f8"), ("imag", "f8")])
        node[...] = np.ascontiguousarray(data, dtype=complex).view([("real", "f8"), ("imag", "f8")])
    else:
        node = group.create_dataset(name, data=data.astype(float))
    node.attrs["MATLAB_class"] = np.bytes_("double")
    return node


def save_v73(path, variables):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            matlab_node(file, name, value, file)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + struct.pack("<HH", 0x0200, 0x4D49)
    with open(path, "r+b") as file:
        file.write(head)


def save_v5(path, variables):
    def value(item):
        if not isinstance(item, list):
            return item
        cells = np.empty((1, len(item)), dtype=object)
        cells[0, :] = [np.atleast_2d(value(inner)).T for inner in item] if item else []
        return cells

    savemat(path, {name: value(item) for name, item in variables.items()})


SAVERS = pytest.mark.parametrize("save", [save_v5, save_v73])


def faults(path):
    with pytest.raises(InputError) as caught:
        read_foreign(path)
    assert all("\n" not in fault and str(path.name) in fault for fault in caught.value.faults)
    return caught.value.faults


def fault(path):
    (only,) = faults(path)
    return only


YAML = f"""
# a comment
zeros:
  - 0
  - 0.0
  - [-0.9, 20.1]
  - [-0.9, -20.1]
  - [-2, 52.8]
  - [-2, -52.8]
poles: [[-0.8, 19.8], [-0.8, -19.8], [-2, 52.5], [-2, -52.5], [-50, 70], [-50, -70], -6e2]
gain: {GAIN!r}
delay_s: 1.25e-3
band_hz: [0.5, 30]
ripple_m_s2_per_v: -0.4
notes: |
  tfest on the sweep
  of Tuesday
"""


def test_roots_of_a_yaml_file_give_their_response_and_keep_every_figure(tmp_path):
    path = write_text(tmp_path / "m.yaml", YAML)
    assert is_foreign(path)
    model = read_foreign(path)
    np.testing.assert_allclose(response(model), STATED, rtol=1e-12)
    assert (model.gain, model.delay_s, model.band_hz, model.ripple_m_s2_per_v) == (GAIN, 1.25e-3, (0.5, 30.0), -0.4)
    assert model.notes == ("tfest on the sweep of Tuesday",) and model.path == path
    np.testing.assert_array_equal(model.zeros, ZEROS)
    np.testing.assert_array_equal(model.poles[:6], POLES[:6])


def test_what_is_not_stated_is_said_to_be_unknown(tmp_path):
    model = read_foreign(write_text(tmp_path / "m.json", zpk()))
    assert (model.delay_s, model.band_hz, model.ripple_m_s2_per_v, model.notes) == (0.0, None, None, ())


def test_roots_come_in_one_order_whatever_the_file_s(tmp_path):
    order = np.random.default_rng(0).permutation(7)
    a = read_foreign(write_text(tmp_path / "a.json", zpk()))
    b = read_foreign(write_text(tmp_path / "b.json", zpk(ZEROS[order[order < 6]], POLES[order])))
    np.testing.assert_array_equal(a.poles, b.poles)
    np.testing.assert_array_equal(a.zeros, b.zeros)
    assert a.sha256 != b.sha256


def test_json_may_be_indented_with_tabs(tmp_path):
    path = write_text(tmp_path / "m.json", json.dumps(zpk(), indent="\t"))
    np.testing.assert_allclose(response(read_foreign(path)), STATED, rtol=1e-12)


def test_coefficients_of_descending_powers_give_their_response(tmp_path):
    numerator, denominator = zpk2tf(ZEROS, POLES, GAIN)
    keys = {"numerator": [0, 0, *numerator], "denominator": list(4.0 * denominator), "delay_s": 0.002}
    model = read_foreign(write_text(tmp_path / "m.json", keys))
    np.testing.assert_allclose(response(model), freqs(numerator, 4.0 * denominator, OMEGA)[1], rtol=1e-9)
    assert model.delay_s == 0.002 and np.all(model.zeros[:2] == 0)


@pytest.mark.parametrize(("output", "count"), [("displacement_m", 2), ("velocity_m_s", 1)])
def test_displacement_and_velocity_become_acceleration(tmp_path, output, count):
    path = write_text(tmp_path / "m.json", zpk(ZEROS[count:], output=output))
    stated = freqs_zpk(ZEROS[count:], POLES, GAIN, OMEGA)[1]
    model = read_foreign(path)
    np.testing.assert_allclose(response(model), stated * (1j * OMEGA) ** count, rtol=1e-12)
    assert f"output {output} was made an acceleration by {count} zero" in model.notes[0]


@pytest.mark.parametrize("output", ["acceleration_m_s2", "displacement_m"])
def test_roots_in_hz_keep_the_response_at_each_frequency(tmp_path, output):
    zeros, poles, gain = ZEROS[0 if output[0] == "a" else 2 :] / 6, POLES / 6, 12.5
    stated = gain * np.prod(1j * FREQUENCY_HZ - zeros[:, None], axis=0)
    stated = stated / np.prod(1j * FREQUENCY_HZ - poles[:, None], axis=0)
    stated = stated * ((1j * OMEGA) ** 2 if output[0] == "d" else 1)
    model = read_foreign(write_text(tmp_path / "r.json", zpk(zeros, poles, gain, output=output, frequency_unit="Hz")))
    np.testing.assert_allclose(response(model), stated, rtol=1e-12)
    np.testing.assert_allclose(np.sort(np.abs(model.poles)), np.sort(np.abs(poles)) * 2 * np.pi)
    numerator, denominator = zpk2tf(zeros, poles, gain)
    keys = {"numerator": list(numerator), "denominator": list(denominator), "output": output, "frequency_unit": "Hz"}
    np.testing.assert_allclose(response(read_foreign(write_text(tmp_path / "c.json", keys))), stated, rtol=1e-9)


FORMS = [
    {"z": ZEROS, "p": POLES, "k": GAIN, "Td": 0.001},
    {"zeros": [ZEROS], "poles": [POLES], "gain": GAIN, "delay_s": 0.001, "unrelated": [1.0, "text"]},
    {"p": POLES, "z": ZEROS[2:], "k": GAIN, "InputDelay": 0.001, "output": "displacement_m", "Ts": 0.0},
    {"num": [np.real(zpk2tf(ZEROS, POLES, GAIN)[0])], "den": [zpk2tf(ZEROS, POLES, GAIN)[1]], "iodelay": 0.001},
]


@SAVERS
@pytest.mark.parametrize("variables", FORMS, ids=["zpk", "cells", "displacement", "tf"])
def test_matlab_files_give_the_response_of_their_numbers(tmp_path, save, variables):
    save(tmp_path / "m.mat", variables)
    assert is_foreign(tmp_path / "m.mat")
    model = read_foreign(tmp_path / "m.mat")
    np.testing.assert_allclose(response(model), STATED, rtol=1e-9)
    assert model.delay_s == 0.001
    assert ("variables not used: unrelated" in model.notes) == ("unrelated" in variables)


@SAVERS
@pytest.mark.parametrize("empty", [[], [np.zeros(0)], np.zeros(0)], ids=["cell", "in a cell", "array"])
def test_a_matlab_model_without_finite_zeros(tmp_path, save, empty):
    save(tmp_path / "m.mat", {"z": empty, "p": POLES, "k": 3.0e12, "output": "displacement_m"})
    model = read_foreign(tmp_path / "m.mat")
    assert model.zeros.tolist() == [0, 0]
    np.testing.assert_allclose(response(model), freqs_zpk([0, 0], POLES, 3e12, OMEGA)[1], rtol=1e-12)


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def matlab_object(name, class_name):
    """Return the bytes of an object of a newer class as a v5 file holds it (mxOPAQUE_CLASS, 17)."""
    flags = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    inner = element(14, flags + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    return element(14, element(6, struct.pack("<II", 17, 0)) + b"".join(element(1, t) for t in name) + inner)


def test_an_object_of_matlab_is_refused_with_the_way_to_save_its_roots(tmp_path):
    path = tmp_path / "table.mat"
    head = b"MATLAB 5.0 MAT-file".ljust(116) + b"\0" * 8 + struct.pack("<HH", 0x0100, 0x4D49)
    path.write_bytes(head + matlab_object((b"G", b"MCOS", b"zpk"), b""))
    said = fault(path)
    assert "table.mat: G: is a MATLAB zpk object" in said and "[z,p,k] = zpkdata(G,'v')" in said
    with h5py.File(path, "w", userblock_size=512) as file:
        file["sys"] = np.zeros((1, 6), dtype=np.uint32)
        file["sys"].attrs.update({"MATLAB_class": np.bytes_("idtf"), "MATLAB_object_decode": 3})
    assert "sys: is a MATLAB idtf object" in fault(path) and "zpkdata(sys,'v')" in fault(path)


NO_MODELS = [
    (
        {"Ts": 0.0005, "k": np.nan, "p": [POLES, POLES], "Td": 0.001, "InputDelay": 0.001},
        [
            "p: is a cell array of 2 entries; save one input and one output of the model",
            "InputDelay: stands beside Td; save the sum of all delays as delay_s",
            "Ts: is 0.0005, which is a discrete-time model; convert it with d2c and save the continuous one",
            "k: must be finite, got nan+0j",
        ],
    ),
    (
        {"Ts": -1.0, "k": [np.array([1.0, 2.0])], "p": np.ones((2, 3)), "poles": POLES},
        [
            "p: give poles or p, not both",
            "Ts: is -1, which is a discrete-time model; convert it with d2c and save the continuous one",
            "k: must be one number, got 2",
        ],
    ),
    (
        {"k": 1 + 2j, "p": "text", "z": np.ones((2, 3)), "output": 3.0},
        [
            "output: must be acceleration_m_s2, velocity_m_s or displacement_m, got numbers",
            "p: must be numbers, got 'text'",
            "k: must be real, got a complex number",
        ],
    ),
    ({"num": np.ones(2)}, ["num: stands beside zeros; give zeros, poles and gain, or numerator and denominator"]),
]


@SAVERS
@pytest.mark.parametrize(("changed", "sentences"), NO_MODELS, ids=["cells", "twice", "types", "both"])
def test_a_matlab_file_that_is_no_model_says_all_that_is_wrong(tmp_path, save, changed, sentences):
    save(tmp_path / "m.mat", {**{name: FORMS[0][name] for name in "zpk"}, **changed})
    said = {text.partition("m.mat: ")[2] for text in faults(tmp_path / "m.mat")}
    matrix = {text for text in said if text.startswith("z: must be a vector of at most 1000, got ")}
    assert said - matrix == set(sentences)
    assert len(matrix) == ("output" in changed)


@SAVERS
def test_a_matlab_file_without_roots_names_what_is_missing(tmp_path, save):
    save(tmp_path / "m.mat", {"x": np.arange(5.0)})
    said = faults(tmp_path / "m.mat")
    assert [re.search("m.mat: (.*), in a MATLAB", text)[1] for text in said] == [
        "poles: is missing; add it",
        "gain: is missing; add it",
    ]


RIGHT = np.array([5 + 3j, 5 - 3j])


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        (zpk(poles=[]), "poles: must give at least one pole"),
        (zpk(poles=POLES[1:]), r"poles: must come in conjugate pairs; -0.8-19.8j rad/s stands alone, add -0.8\+19.8j"),
        (zpk(zeros=ZEROS[[0, 1, 2, 4, 5]]), r"zeros: must come in conjugate pairs; -0.9\+20.1j"),
        (zpk(gain=0), "gain: must be other than 0, got 0"),
        (zpk(zeros=[*ZEROS, -1, -2]), "zeros: must give at most as many zeros as there are poles; got 8, and 7 poles"),
        (zpk(zeros=[*ZEROS[2:], -1, -2], output="displacement_m"), "got 8, 2 of them for output displacement_m"),
        (zpk(poles=[*POLES[:-1], 30]), "poles: 30 rad/s not in the left half plane, the model is unstable; fit"),
        (zpk(poles=[*POLES, 0]), "poles: 0 rad/s not in the left half plane, the model is unstable; fit"),
        (zpk(zeros=[*ZEROS, 30]), "zeros: 30 rad/s not in the left half plane, the model has no stable inverse; fit a"),
        (zpk(zeros=[*ZEROS[:4], 52j, -52j]), r"zeros: [-+0-9j, ]*52j rad/s not in the left half plane"),
        (zpk(zeros=ZEROS[2:]), "must have 2 zeros at the origin .*follows displacement; got 0; state output: disp"),
        (zpk(zeros=ZEROS[1:]), "must have 2 zeros at the origin .*follows displacement; got 1; state output: velo"),
        (zpk(zeros=ZEROS[2:], output="velocity_m_s"), "must have 1 zero at the origin for output velocity_m_s.*got 0"),
        (zpk(zeros=[0, *ZEROS]), "must have 2 zeros at the origin .*; got 3; fit with"),
        (
            zpk(zeros=ZEROS[:4], output="displacement_m"),
            "must have 0 zeros at the origin for output displacement_m.*got 2; state output: acceleration_m_s2",
        ),
        (zpk(zeros=[-1e-4, -1e-4, *ZEROS[2:]]), "must have 2 zeros at the origin .*; got 0; state output: disp"),
        (zpk(zeros=[-1e-5, -1e-5, -2, -5]), "must have 2 zeros at the origin .*; got 0"),
        (zpk(poles=[*POLES[2:], -0.8 + 19.8j, -0.8 - 19.9j]), "poles: must come in conjugate pairs; -0.8"),
        (zpk(delay_s=-1e-9), "delay_s: must be >= 0 and <= 1 s, got -1e-09"),
        (zpk(delay_s=1.1), "delay_s: must be >= 0 and <= 1 s, got 1.1"),
        (zpk(delay_s=[0.1, 0.2]), "delay_s: must be one number, got 2"),
        (zpk(band_hz=[10, 5]), "band_hz: must be two frequencies, 0 < low < high"),
        (zpk(band_hz=[0, 5]), "band_hz: must be two frequencies, 0 < low < high"),
        (zpk(band_hz=5), "band_hz: must be two frequencies, 0 < low < high"),
        (zpk(frequency_unit="hertz"), "frequency_unit: must be rad/s or Hz, got 'hertz'"),
        (zpk(output=3), "output: must be text, got 3"),
        (zpk(poles=[*POLES, -2e7]), r"poles: -2e\+07 rad/s is beyond 1e\+07 in magnitude; check freq"),
        (zpk(poles=[-50.0] * 41), "poles: must be at most 40, got 41"),
        (zpk(sample_time_s=0.001), "sample_time_s: is 0.001, which is a discrete-time model"),
        ({"numerator": [1, 0, 0]}, "denominator: is missing; add it, in a MATLAB file as denominator or den"),
        ({"numerator": [0, 0], "denominator": [1, 2, 3]}, "numerator: must have a coefficient other than 0"),
        ({"numerator": [1, 0, 0], "denominator": [0.0, 1, 2, -3]}, "denominator: 1 rad/s not in the left half plane"),
        ({"numerator": [1, 0, 0], "denominator": [1e-300, 1e300, 1, 1]}, "denominator: .* too far apart"),
        ({"numerator": [1.0] * 42, "denominator": [1, 2]}, "numerator: must have at most 41 coefficients, got 42"),
        ({"poles": pairs(POLES), "zeros": pairs(ZEROS)}, "gain: is missing; add it, in a MATLAB file as gain or k"),
        ({"zeros": [0, 0], "numerator": [1], "denominator": [1]}, "numerator: stands beside zeros; give"),
        ("[1, 2]", "must hold the keys of a model: zeros, poles and gain"),
        ("zeros: [", "not valid YAML"),
    ],
)
def test_each_fault_is_one_sentence(tmp_path, keys, sentence):
    assert re.search(sentence, fault(write_text(tmp_path / "m.json", keys)))


def test_all_faults_are_told_at_once_with_their_places(tmp_path):
    text = "pols: [1]\nzeros: [0, 0, x, [1, 2, 3]]\npoles: [-1, 3, true]\ngain: 1e999\ndelay_s: 2\nbamd_hz: [1, 2]\n"
    said = faults(write_text(tmp_path / "m.yaml", text))
    assert [line.partition("m.yaml:")[2] for line in said] == [
        "1:1: pols: unknown key; did you mean poles?",
        "2:15: zeros: must be a number or a pair [real, imaginary], got 'x'",
        "2:18: zeros: must be a number or a pair [real, imaginary], got a list",
        "3:16: poles: must be a number or a pair [real, imaginary], got true",
        "4:7: gain: must be a finite number, got 1e999",
        "5:10: delay_s: must be >= 0 and <= 1 s, got 2",
        "6:1: bamd_hz: unknown key; did you mean band_hz?",
    ]
    several = zpk(zeros=[*ZEROS[1:], 7], poles=[*POLES[:-1], 8], gain=0, delay_s=-1)
    assert len(faults(write_text(tmp_path / "m.json", several))) == 5


def test_zeros_close_to_the_origin_count_as_at_it(tmp_path):
    near = read_foreign(write_text(tmp_path / "m.json", zpk([1.5e-5, -1.5e-5, *ZEROS[2:]])))
    assert near.zeros[:2].tolist() == [0, 0]
    np.testing.assert_allclose(response(near), STATED, rtol=1e-9)


def test_partners_that_rounding_parted_become_conjugate_and_real_roots_real(tmp_path):
    poles = [*POLES[2:6], -0.8 + 19.8j, -0.8 - 19.800004j, -600 + 1e-8j]
    model = read_foreign(write_text(tmp_path / "m.json", zpk(poles=poles)))
    np.testing.assert_array_equal(model.poles[1:6:2], np.conj(model.poles[0:6:2]))
    assert model.poles[0] == pytest.approx(-0.8 + 19.800002j, rel=1e-12) and model.poles[6] == -600


def test_only_files_that_are_not_ours_are_foreign(tmp_path):
    write_model(tmp_path / "m.h5", {}, {"table": {"gain": Dataset(1.0, "1", "gain", "estimated")}})
    with h5py.File(tmp_path / "result.h5", "w") as file:
        file.attrs["format"] = "rths-result"
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["p"] = POLES.real
    (tmp_path / "junk").write_bytes(b"\0\1\2\3" * 100)
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "ours.mat").write_bytes((tmp_path / "m.h5").read_bytes())
    (tmp_path / "cut.h5").write_bytes((tmp_path / "m.h5").read_bytes()[:700])
    found = {path.name: is_foreign(path) for path in tmp_path.iterdir()} | {"none": is_foreign(tmp_path / "none")}
    assert not any(found.values()), found
    assert "neither YAML or JSON text nor a MATLAB file" in fault(tmp_path / "m.h5")
    assert "No such file" in fault(tmp_path / "none")
    (tmp_path / "junk").rename(tmp_path / "junk.mat")
    assert "cannot be read as a MATLAB file" in fault(tmp_path / "junk.mat")


FIXTURE = HealthCheck.function_scoped_fixture
real = st.floats(-900, -0.5)
pair = st.tuples(real, st.floats(1.0, 900)).map(lambda two: [complex(*two), complex(two[0], -two[1])])


@st.composite
def table_models(draw):
    """Draw zeros, poles in any order, gain and delay of a stable, minimum-phase table model."""
    pole_pairs = draw(st.lists(pair, min_size=1, max_size=4))
    poles = [root for two in pole_pairs for root in two] + draw(st.lists(real, max_size=4))
    zero_pairs = draw(st.lists(pair, max_size=(len(poles) - 2) // 2))
    zeros = [0j, 0j] + [root for two in zero_pairs for root in two]
    return zeros, draw(st.permutations(poles)), draw(st.floats(1e-3, 1e9)), draw(st.floats(0, 1))


def comes_back(path, zeros, poles, gain, delay_s):
    model = read_foreign(path)
    assert (model.gain, model.delay_s) == (gain, delay_s)
    np.testing.assert_allclose(response(model), freqs_zpk(zeros, poles, gain, OMEGA)[1], rtol=1e-9)
    assert np.array_equal(np.sort_complex(model.poles), np.sort_complex(poles))
    assert np.array_equal(np.sort_complex(model.zeros), np.sort_complex(zeros))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(table_models())
def test_any_table_model_comes_back_from_text(tmp_path_factory, model):
    zeros, poles, gain, delay_s = model
    keys = zpk(zeros, poles, gain, delay_s=delay_s)
    comes_back(write_text(tmp_path_factory.mktemp("any") / "m.json", keys), *model)


@pytest.mark.campaign
@SAVERS
@settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=[FIXTURE])
@given(model=table_models())
def test_any_table_model_comes_back_from_matlab(tmp_path_factory, save, model):
    zeros, poles, gain, delay_s = model
    path = tmp_path_factory.mktemp("any") / "m.mat"
    save(path, {"z": np.array(zeros), "p": np.array(poles, dtype=complex), "k": gain, "delay": delay_s})
    comes_back(path, *model)


def damaged(whole, random):
    """Return bytes cut short or with three of them changed."""
    if random.random() < 0.1:
        return whole[: random.integers(len(whole))]
    data = bytearray(whole)
    for place in random.integers(0, len(data), 3):
        data[place] = random.integers(256)
    return bytes(data)


@pytest.mark.campaign
@pytest.mark.parametrize(("name", "count"), [("m.yaml", 300), ("v5.mat", 4), ("v73.mat", 4)])
def test_damaged_bytes_give_sentences_only(tmp_path, name, count):
    path = tmp_path / name
    if name == "m.yaml":
        write_text(path, YAML)
    else:
        (save_v5 if name == "v5.mat" else save_v73)(path, FORMS[1])
    whole, random, refused = path.read_bytes(), np.random.default_rng(7), 0
    for _ in range(count):
        path.write_bytes(damaged(whole, random))
        try:
            read_foreign(path)
        except InputError as error:
            refused += 1
            assert error.faults and all(text and "\n" not in text for text in error.faults)
    assert refused > 0


@pytest.mark.parametrize("happen", [os.abort, lambda: time.sleep(60)])
def test_a_file_on_which_a_reader_crashes_or_hangs_is_called_damaged(tmp_path, monkeypatch, happen):
    monkeypatch.setattr(sandboxed_reading, "TIME_LIMIT_S", 0.5)
    monkeypatch.setattr(scipy.io, "loadmat", lambda *_, **__: happen())
    save_v5(tmp_path / "m.mat", FORMS[0])
    assert "m.mat: cannot be read as a MATLAB file, it is damaged or none at all" in fault(tmp_path / "m.mat")


def test_a_structure_is_no_list_of_roots(tmp_path):
    savemat(tmp_path / "a.mat", {"p": {"a": 1.0}, "k": 1.0})
    with h5py.File(tmp_path / "b.mat", "w", userblock_size=512) as file:
        file["p/a"], file["k"] = 1.0, 1.0
    for name in ("a.mat", "b.mat"):
        assert f"{name}: p: must be numbers, got a structure or something else" in fault(tmp_path / name)
