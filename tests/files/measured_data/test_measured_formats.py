"""Recordings as controllers and recorders write them, made here from the published layouts of each format.

Oracle: a sum of sines, evaluated at the instants at which each channel is sampled.
"""

import struct
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.measured_data import Recording, read_recording

Array = NDArray[np.float64]
N, DT_S = 600, 0.001
TIME_S = np.arange(N) * DT_S
NAMES, UNITS = ("command", "table", "floor_2"), ("V", "m/s^2", "g")
HZ = np.random.default_rng(5).uniform(1.0, 90.0, 8)
Late = tuple[float, float, float]
EQUAL: Late = (0.0, 0.0, 0.0)


def motion(time_s: Array, channel: int) -> Array:
    return np.asarray(np.sum(np.sin(2.0 * np.pi * np.outer(HZ, time_s) + channel + np.arange(8.0)[:, None]), axis=0))


def structures(entries: Sequence[dict[str, object]]) -> NDArray[np.void]:
    """Return a structure array of MATLAB."""
    array = np.zeros((1, len(entries)), dtype=[(name, "O") for name in entries[0]])
    for place, entry in enumerate(entries):
        for name, value in entry.items():
            array[0, place][name] = value
    return array


def control_desk(path: Path, late: Late = EQUAL, steps: Sequence[float] = (DT_S,) * 3, x_index: int = 0) -> None:
    times = [np.arange(round(N * DT_S / step)) * step + shift * DT_S for step, shift in zip(steps, late, strict=True)]
    x = [{"Name": "Time", "Type": "time", "Data": time[None], "Unit": "s", "Raster": f"r{k}"}
         for k, time in enumerate(times)]  # fmt: skip
    y = [
        {"Name": name, "Data": motion(time, k)[None], "Unit": unit, "XIndex": x_index or k + 1, "Raster": f"r{k}"}
        for k, (name, unit, time) in enumerate(zip(NAMES, UNITS, times, strict=True))
    ]
    described = {"X": structures(x), "Y": structures(y), "Description": {"General": "made here"}, "Capture": 1.0}
    scipy.io.savemat(path, {"rec_001": described})


def simulink(path: Path, time_s: Array = TIME_S) -> None:
    signals = structures([
        {"values": motion(TIME_S, k)[:, None], "dimensions": 1.0, "label": f"{name} ({unit})", "blockName": "m/S"}
        for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True))
    ])  # fmt: skip
    scipy.io.savemat(path, {"ScopeData": {"time": time_s[:, None], "signals": signals, "blockName": "m/S"}})


def simulink_73(path: Path) -> None:
    """Write a structure with time as MATLAB 7.3 does: fields of a structure array are sets of references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("ScopeData")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        log["time"] = TIME_S[None]
        log["time"].attrs["MATLAB_class"] = np.bytes_("double")
        signals = log.create_group("signals")
        signals.attrs["MATLAB_class"] = np.bytes_("struct")
        for field in ("label", "values"):
            signals.create_dataset(field, (3, 1), dtype=h5py.ref_dtype)
        for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
            text = np.array([[ord(letter)] for letter in f"{name} ({unit})"], dtype=np.uint16)
            for field, data, kind in (("label", text, "char"), ("values", motion(TIME_S, k)[None], "double")):
                node = file.create_dataset(f"#refs#/{field}{k}", data=data)
                node.attrs["MATLAB_class"] = np.bytes_(kind)
                signals[field][k, 0] = node.ref


def labview(
    path: Path,
    x_columns: str = "One",
    late: Late = EQUAL,
    segments: int = 1,
    separator: str = "\t",
    mark: str = ".",
    skipped: int = 0,
    dated: Late = EQUAL,
) -> None:
    """Write a .lvm file; each segment has a header of its own and begins `skipped` samples after the one before."""

    def line(*cells: object) -> str:
        return separator.join(f"{cell:.9f}" if isinstance(cell, float) else str(cell) for cell in cells)

    moments = [datetime(2026, 2, 3, 10) + timedelta(seconds=each * DT_S) for each in dated]
    lines = ["LabVIEW Measurement" + separator, line("Separator", "Comma" if separator == "," else "Tab")]
    lines += [line("Decimal_Separator", mark), line("X_Columns", x_columns), line("Time_Pref", "Relative")]
    lines += [line("Date", "2026/02/03"), line("Time", "10:00:00"), "***End_of_Header***" + separator, separator]
    count = N // segments
    for segment in range(segments):
        places = np.arange(segment * count, (segment + 1) * count) + segment * skipped
        head: dict[str, Sequence[object]] = {"Samples": [count] * 3, "Date": ["2026/02/03"] * 3}
        head |= {"Time": [f"{each:%H:%M:%S.%f}" for each in moments], "Y_Unit_Label": UNITS, "Delta_X": [DT_S] * 3}
        head["X0"] = [each * DT_S + float(places[0]) * DT_S for each in late]
        between = [""] if x_columns == "Multi" else []  # each cell stands above the Y column of its channel
        lines.append(line("Channels", 3))
        lines += [line(key, *(part for one in cells for part in (one, *between))) for key, cells in head.items()]
        heads = {"One": ["X_Value", *NAMES], "No": ["X_Value", *NAMES]}
        each_x = [word for name in NAMES for word in ("X_Value", name)]
        lines += ["***End_of_Header***" + separator, line(*heads.get(x_columns, each_x), "Comment")]
        for place in places:
            x = [float(place + each) * DT_S for each in late]
            y = [float(motion(np.array([x[k] + dated[k] * DT_S]), k)[0]) for k in range(3)]
            multi = [cell for pair in zip(x, y, strict=True) for cell in pair]
            lines.append(line(*({"One": [x[0], *y], "No": ["", *y]}.get(x_columns, multi))))
        lines.append("")
    text = "\n".join(lines)
    path.write_text(text.replace(".", mark) if mark != "." else text)


def universal(path: Path, late: Late = EQUAL, binary: bool = False, function: int = 1) -> None:
    content = b""
    for k, (name, unit) in enumerate(zip(NAMES, UNITS, strict=True)):
        values = motion(TIME_S + late[k] * DT_S, k)
        kind = f"{58:6d}b{1:6d}{2:6d}{11:12d}{8 * N:12d}{0:6d}{0:6d}{0:12d}{0:12d}" if binary else f"{58:6d}"
        head = ["    -1", kind, name, "NONE", "03-Feb-26 10:00:00", "NONE", "NONE"]
        head += [f"{function:5d}{0:10d}{0:5d}{0:10d} {'NONE':10}{k + 1:10d}{1:4d} {'NONE':10}{0:10d}{0:4d}"]
        head += [f"{4:10d}{N:10d}{1:10d}{late[k] * DT_S:13.5E}{DT_S:13.5E}{0.0:13.5E}"]
        axes = ((17, "Time", "s"), (12, "Signal", unit), (0, "NONE", "NONE"), (0, "NONE", "NONE"))
        head += [f"{code:10d}{0:5d}{0:5d}{0:5d} {label:20} {units:20}" for code, label, units in axes]
        rows = ["".join(f"{value:20.12E}" for value in values[i : i + 4]) for i in range(0, N, 4)]
        body = values.astype("<f8").tobytes() if binary else "\n".join(rows).encode()
        content += "\n".join(head).encode() + b"\n" + body + b"\n    -1\n"
    path.write_bytes(content)


def check(path: Path, first: float = 0.0, dt_s: float | None = None, atol: float = 1e-8) -> Recording:
    """Check that all channels are those at the same instants, the first `first` intervals after the start."""
    found = read_recording(path, dt_s)
    assert found.dt_s == DT_S
    time_s = (np.arange(found.samples.shape[1]) + first) * DT_S
    assert time_s.size >= N - 2 * first - 60
    order = [found.names.index(name) for name in NAMES] if set(NAMES) == set(found.names) else range(3)
    for k, samples in enumerate(found.samples[list(order)]):
        np.testing.assert_allclose(samples, motion(time_s, k), atol=atol)
    return found


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path)
    return " ".join(caught.value.faults).replace(str(path), "")


def one(path: Path, late: Late = EQUAL) -> None:
    labview(path, "One", late)


def multi(path: Path, late: Late = EQUAL) -> None:
    labview(path, "Multi", late)


def without_x(path: Path, late: Late = EQUAL) -> None:
    labview(path, "No", late)


def by_date(path: Path, late: Late = EQUAL) -> None:
    labview(path, dated=late)


def comma(path: Path, late: Late = EQUAL) -> None:
    labview(path, late=late, mark=",")


def commas(path: Path, late: Late = EQUAL) -> None:
    labview(path, late=late, separator=",")


def binary(path: Path, late: Late = EQUAL) -> None:
    universal(path, late, binary=True)


def side_by_side(path: Path, late: Late = EQUAL) -> None:
    head = ",".join(f"Time (s),{name} ({unit})" for name, unit in zip(NAMES, UNITS, strict=True))
    columns = [f(TIME_S + each * DT_S, k) for k, each in enumerate(late) for f in (lambda t, _: t, motion)]
    np.savetxt(path, np.column_stack(columns), "%.9f", ",", header=head, comments="")


WRITERS = [control_desk, one, multi, without_x, by_date, comma, commas, universal, binary, side_by_side]


@pytest.mark.campaign
@pytest.mark.parametrize("late", [EQUAL, (0.0, 1.0, 1.0), (25.0, 0.0, 0.0)])
@pytest.mark.parametrize("write", WRITERS)
def test_channels_stand_at_their_own_instants(tmp_path: Path, write: Callable[[Path, Late], None], late: Late) -> None:
    write(tmp_path / "d", late)
    found = check(tmp_path / "d", max(late))
    assert [name.partition(" (")[0] for name in found.names] == list(NAMES) and found.units == UNITS
    assert ("start at different times" in " ".join(found.notes)) == (max(late) > 0.0)


@pytest.mark.parametrize("write", [simulink, simulink_73])
def test_simulink_structures_are_read_by_their_labels(tmp_path: Path, write: Callable[[Path], None]) -> None:
    write(tmp_path / "d.mat")
    found = check(tmp_path / "d.mat")
    assert found.names == tuple(f"{n} ({u})" for n, u in zip(NAMES, UNITS, strict=True)) and found.units == UNITS


def test_a_structure_without_time_needs_a_rate(tmp_path: Path) -> None:
    simulink(tmp_path / "d.mat", np.zeros(0))
    assert "give --rate HZ" in refusal(tmp_path / "d.mat")
    check(tmp_path / "d.mat", dt_s=DT_S)


def test_a_structure_without_time_takes_what_stands_beside_it(tmp_path: Path) -> None:
    simulink(tmp_path / "d.mat", np.zeros(0))
    log = scipy.io.loadmat(tmp_path / "d.mat", struct_as_record=True)["ScopeData"]
    for beside in ({"tout": TIME_S[:, None]}, {"fs": 1.0 / DT_S}, {"tout": TIME_S[:, None], "dt": DT_S}):
        scipy.io.savemat(tmp_path / "d.mat", {"ScopeData": log, **beside})
        assert check(tmp_path / "d.mat").notes == ()
    scipy.io.savemat(tmp_path / "d.mat", {"ScopeData": log, "tout": TIME_S[:, None], "fs": 500.0})
    assert "the time column says 1000 Hz (0.001 s), fs says 500 Hz" in refusal(tmp_path / "d.mat")


def test_the_time_in_a_matrix_is_compared_with_a_stated_rate(tmp_path: Path) -> None:
    matrix = np.vstack([TIME_S, *(motion(TIME_S, k) for k in range(3))])
    np.savez(tmp_path / "a.npz", data=matrix, fs=1.0 / DT_S)
    assert check(tmp_path / "a.npz").samples.shape == (3, N)
    np.savez(tmp_path / "a.npz", data=matrix, fs=500.0)
    assert "the time column says 1000 Hz (0.001 s), fs says 500 Hz" in refusal(tmp_path / "a.npz")


def test_arrays_of_simulink_have_their_time(tmp_path: Path) -> None:
    signals = np.array([motion(TIME_S, k) for k in range(3)])
    scipy.io.savemat(tmp_path / "a.mat", {"tout": TIME_S[:, None], "yout": signals.T})
    check(tmp_path / "a.mat")
    scipy.io.savemat(tmp_path / "b.mat", {"ans": np.vstack([TIME_S, signals])})
    assert "To File" in check(tmp_path / "b.mat").notes[-1]


def timeseries(k: int, late: float) -> dict[str, object]:
    """Return a timeseries of MATLAB that was made a structure."""
    time_s = TIME_S + late * DT_S
    return {"Time": time_s[:, None], "Data": motion(time_s, k)[:, None], "DataInfo": {"Units": UNITS[k]}}


def dataset(path: Path, late: Late) -> None:
    elements = [{"Name": name, "Values": timeseries(k, late[k])} for k, name in enumerate(NAMES)]
    scipy.io.savemat(path, {"logsout": structures(elements)})


def elements(path: Path, late: Late) -> None:
    logs = {name: {"Values": timeseries(k, late[k])} for k, name in enumerate(NAMES)}
    scipy.io.savemat(path, {"logsout": logs})


def pairs(late: Late) -> list[tuple[str, Array, Array]]:
    """Return name, times and samples of each channel."""
    return [(n, TIME_S + late[k] * DT_S, motion(TIME_S + late[k] * DT_S, k)) for k, n in enumerate(NAMES)]


def matrices(path: Path, late: Late) -> None:
    scipy.io.savemat(path, {name: np.column_stack([time_s, values]) for name, time_s, values in pairs(late)})


def fields(path: Path, late: Late) -> None:
    scipy.io.savemat(path, {name: {"time": time_s, "data": values} for name, time_s, values in pairs(late)})


def nested(path: Path, late: Late) -> None:
    scipy.io.savemat(path, {"run": {name: {"t": time_s, "values": values} for name, time_s, values in pairs(late)}})


def groups(path: Path, late: Late) -> None:
    with h5py.File(path, "w") as file:
        for name, time_s, values in pairs(late):
            file[f"m/{name}/time"], file[f"m/{name}/value"] = time_s, values


@pytest.mark.parametrize("late", [EQUAL, (0.0, 1.0, 25.0)])
@pytest.mark.parametrize("write", [dataset, elements, matrices, fields, nested, groups])
def test_each_series_has_the_time_beside_it(tmp_path: Path, write: Callable[[Path, Late], None], late: Late) -> None:
    write(tmp_path / "d.mat", late)
    found = check(tmp_path / "d.mat", max(late))
    order = [found.names.index(name) for name in NAMES]
    assert [found.units[k] for k in order] == list(UNITS if write in (dataset, elements) else [""] * 3)


def test_an_axis_that_is_not_there_is_refused(tmp_path: Path) -> None:
    control_desk(tmp_path / "d.mat", x_index=4)
    assert "rec_001.Y(1) states XIndex 4, X has 3 entries" in refusal(tmp_path / "d.mat")


@pytest.mark.parametrize("ratio", [10, 3, 2.5])
def test_faster_channels_come_to_the_slowest_rate_without_shift_or_alias(tmp_path: Path, ratio: float) -> None:
    control_desk(tmp_path / "d.mat", steps=(DT_S, DT_S / ratio, DT_S / ratio))
    found = read_recording(tmp_path / "d.mat")
    first = next(k for k in range(60) if abs(found.samples[0, 0] - motion(TIME_S[k : k + 1], 0)[0]) < 1e-9)
    note = " ".join(check(tmp_path / "d.mat", first, atol=1e-3).notes)
    assert "low pass without delay, true below 400 Hz" in note and "start at different times" not in note
    hum = np.sin(2.0 * np.pi * 900.0 * np.arange(N * 10) * DT_S / 10)  # above half of 1 kHz
    x = [{"Data": TIME_S[None]}, {"Data": np.arange(N * 10)[None] * DT_S / 10}]
    y = [{"Name": "a", "Data": motion(TIME_S, 0)[None], "XIndex": 1}, {"Name": "b", "Data": hum[None], "XIndex": 2}]
    scipy.io.savemat(tmp_path / "e.mat", {"r": {"X": structures(x), "Y": structures(y)}})
    assert np.abs(read_recording(tmp_path / "e.mat").samples[1]).max() < 2e-4


def test_a_held_command_is_picked_and_not_smoothed(tmp_path: Path) -> None:
    fast = np.arange(N * 10) * DT_S / 10
    x = [{"Data": TIME_S[None]}, {"Data": fast[None]}]
    held = np.repeat(motion(TIME_S, 0), 10)
    y = [{"Name": "a", "Data": motion(TIME_S, 1)[None], "XIndex": 1}, {"Name": "u", "Data": held[None], "XIndex": 2}]
    scipy.io.savemat(tmp_path / "d.mat", {"r": {"X": structures(x), "Y": structures(y)}})
    found = read_recording(tmp_path / "d.mat")
    assert np.array_equal(found.samples[1], motion(TIME_S, 0)) and "one sample of each 10" in found.notes[0]


def test_clocks_that_drift_apart_are_refused(tmp_path: Path) -> None:
    control_desk(tmp_path / "d.mat", steps=(DT_S, DT_S * (1 + 2e-5), DT_S))
    assert "no ratio of whole numbers" in refusal(tmp_path / "d.mat")


def dated(path: Path) -> None:
    """Write two segments whose X values both begin at 0; date and time say how they follow."""
    labview(path, segments=2)
    lines, segment = [], 0
    for line in path.read_text().splitlines():
        segment += line.startswith("Channels")
        if segment == 2 and line.startswith("Time"):
            line = "Time" + "\t10:00:00.3" * 3
        elif segment == 2 and line.startswith("X0"):
            line = "X0" + "\t0.0" * 3
        elif segment == 2 and line[:1].isdigit():
            x, rest = line.split("\t", 1)
            line = f"{float(x) - 0.3:.9f}\t{rest}"
        lines.append(line)
    path.write_text("\n".join(lines))


def test_segments_follow_each_other_or_leave_a_gap(tmp_path: Path) -> None:
    labview(tmp_path / "a.lvm", segments=3)
    check(tmp_path / "a.lvm")
    labview(tmp_path / "b.lvm", segments=3, skipped=7)
    found = read_recording(tmp_path / "b.lvm")
    assert np.flatnonzero(np.isnan(found.samples[0])).tolist() == [*range(200, 207), *range(407, 414)]
    dated(tmp_path / "e.lvm")
    assert np.flatnonzero(np.isnan(check(tmp_path / "e.lvm").samples[0])).size == 0
    text = (tmp_path / "a.lvm").read_text()
    (tmp_path / "c.lvm").write_text(text + text[text.index("Channels") :])
    assert "save each segment to a file of its own" in refusal(tmp_path / "c.lvm")


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("Samples\t200\t200", "Samples\t300\t300", "the rows end here, 200 of the 300 samples"),
        ("Y_Unit_Label\tV", "Y_Unit_Label\tmV", "states the unit 'mV' of command, the one before 'V'"),
    ],
)
def test_a_segment_cut_off_or_of_another_unit_is_refused(
    tmp_path: Path, before: str, after: str, expected: str
) -> None:
    labview(tmp_path / "a.lvm", segments=3)
    head, _, tail = (tmp_path / "a.lvm").read_text().rpartition(before)
    (tmp_path / "a.lvm").write_text(head + after + tail)
    assert expected in refusal(tmp_path / "a.lvm")


def test_special_blocks_of_labview_are_left_out(tmp_path: Path) -> None:
    labview(tmp_path / "a.lvm", segments=2)
    text = (tmp_path / "a.lvm").read_text()
    block = "***Start_Special***\t\nlog\t5\n***End_Special***\t\n"
    (tmp_path / "a.lvm").write_text(text.replace("X_Value", f"{block}X_Value").replace("Channels", f"{block}Channels"))
    check(tmp_path / "a.lvm")


@pytest.mark.parametrize("word", ["NaN", "Inf", "OVER"])
def test_rows_that_begin_with_a_word_are_no_header(tmp_path: Path, word: str) -> None:
    labview(tmp_path / "a.lvm", "No", segments=2)
    lines = (tmp_path / "a.lvm").read_text().replace("\n\t", "\n").replace("X_Value\tcommand", "command").split("\n")
    assert lines[50][:1] in "-0123456789"
    lines[50] = "\t".join([word, *lines[50].split("\t")[1:]])
    (tmp_path / "a.lvm").write_text("\n".join(lines))
    if word == "OVER":
        assert refusal(tmp_path / "a.lvm").startswith(":51: command: 'OVER' is not a number")
    else:
        found = read_recording(tmp_path / "a.lvm")
        assert found.samples.shape == (3, N) and np.isnan(found.samples).sum() == 1


def test_a_step_that_the_times_contradict_is_refused(tmp_path: Path) -> None:
    labview(tmp_path / "d.lvm")
    text = (tmp_path / "d.lvm").read_text().replace("Delta_X\t0.001000000", "Delta_X\t0.001030000")
    (tmp_path / "d.lvm").write_text(text)
    assert "Delta_X of channel 1 is 0.00103 s, X_Value steps by 0.001 s" in refusal(tmp_path / "d.lvm")


def test_universal_files_without_time_histories_or_cut_off_are_refused(tmp_path: Path) -> None:
    universal(tmp_path / "frf.uff", function=4)
    assert "without time histories (command (function type 4)" in refusal(tmp_path / "frf.uff")
    universal(tmp_path / "cut.uff", binary=True)
    (tmp_path / "cut.uff").write_bytes((tmp_path / "cut.uff").read_bytes()[:-900])
    assert "floor_2 states 600 samples and holds" in refusal(tmp_path / "cut.uff")


@pytest.mark.parametrize("binary", [False, True])
def test_the_abscissa_of_a_universal_file_has_its_unit(tmp_path: Path, binary: bool) -> None:
    universal(tmp_path / "a.uff", late=(0.0, 3.0, 3.0), binary=binary)
    whole = (tmp_path / "a.uff").read_bytes()
    in_ms = whole.replace(b"s".ljust(20), b"ms".ljust(20))
    for before, after in ((b"1.00000E-03", b"1.00000E+00"), (b"3.00000E-03", b"3.00000E+00")):
        in_ms = in_ms.replace(before, after)
    (tmp_path / "a.uff").write_bytes(in_ms)
    check(tmp_path / "a.uff", 3.0)
    (tmp_path / "a.uff").write_bytes(whole.replace(b"s".ljust(20), b"min".ljust(20)))
    assert "the unit 'min' of its abscissa is not s, ms or us" in refusal(tmp_path / "a.uff")


def test_a_universal_file_may_begin_with_other_datasets(tmp_path: Path) -> None:
    universal(tmp_path / "d.uff")
    head = "    -1\n   151\nmodel\n    -1\n    -1\n   164\n         1SI\n    -1\n"
    (tmp_path / "d.uff").write_bytes(head.encode() + (tmp_path / "d.uff").read_bytes())
    assert "dataset 151, dataset 164" in " ".join(check(tmp_path / "d.uff").notes)


def test_starts_of_a_universal_file_need_their_digits(tmp_path: Path) -> None:
    universal(tmp_path / "a.uff", late=(123456.0, 123456.5, 123456.0))
    assert "that of command is written to 0.001 s, 1 of an interval" in refusal(tmp_path / "a.uff")
    for late, notes in (((123456.0,) * 3, 0), ((1000.0, 1003.0, 1003.0), 2), ((0.0, 3.0, 3.0), 1)):
        universal(tmp_path / "a.uff", late)
        assert len(check(tmp_path / "a.uff", max(late)).notes) == notes


def test_npz_is_read_by_names(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", time_s=TIME_S, **{f"{n} ({u})": motion(TIME_S, k) for k, (n, u) in
                                                  enumerate(zip(NAMES, UNITS, strict=True))})  # fmt: skip
    assert check(tmp_path / "a.npz").units == UNITS
    np.savez(tmp_path / "b.npz", a=np.array([{}], dtype=object))
    assert "holds no series of numbers" in refusal(tmp_path / "b.npz")


def test_rattlesnake_channels_have_their_names_and_units(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "d.nc4", "w") as file:
        file.attrs["sample_rate"] = 1000
        file["time_data"] = np.array([motion(TIME_S, k) for k in range(3)])
        for key, texts in {
            "node_number": "123",
            "node_direction": ("X+",) * 3,
            "unit": UNITS,
            "comment": NAMES,
        }.items():
            file[f"channels/{key}"] = list(texts)
    assert check(tmp_path / "d.nc4").names == NAMES
    with h5py.File(tmp_path / "d.nc4", "a") as file:
        file["channels/comment"][:] = ["", "", ""]
        file["time_samples"] = np.zeros(N)  # as netCDF4 writes a dimension
        file["time_samples"].attrs["NAME"] = np.bytes_(
            "This is a netCDF dimension but not a netCDF variable.       600"
        )
    found = check(tmp_path / "d.nc4")
    assert found.names == ("1 X+", "2 X+", "3 X+") and found.units == UNITS


FORMS = [
    ("%Y-%m-%dT%H:%M:%S.%f", ",", "utf-8"),
    ("%Y-%m-%d %H:%M:%S.%fZ", ",", "utf-8"),
    ("%d.%m.%Y %H:%M:%S,%f", ";", "utf-16"),
    ("%m/%d/%Y %I:%M:%S.%f %p", ",", "utf-8"),
    ("%d/%m/%Y %H:%M:%S.%f", "\t", "utf-8"),
    ("%H:%M:%S.%f", ";", "utf-8"),
    ("%Y-%m-%d\t%H:%M:%S.%f", "\t", "utf-8"),
]


@pytest.mark.parametrize(("form", "separator", "coding"), FORMS)
def test_stamps_are_times_also_over_midnight(tmp_path: Path, form: str, separator: str, coding: str) -> None:
    stamps = [(datetime(2026, 2, 3, 23, 59, 59, 800000) + timedelta(milliseconds=k)).strftime(form) for k in range(N)]
    blank = separator * form.count("\t")
    lines = [separator.join(["Stamp" + blank.replace("\t", "\tTime"), *NAMES]), separator.join(["" + blank, *UNITS])]
    for k, stamp in enumerate(stamps):
        cells = [
            f"{motion(TIME_S[k : k + 1], c)[0]:.9f}".replace(".", "," if separator == ";" else ".") for c in range(3)
        ]
        lines.append(separator.join([stamp, *cells]))
    (tmp_path / "d.csv").write_bytes("\n".join(lines).encode(coding))
    assert check(tmp_path / "d.csv").units == UNITS


def test_blocks_of_rows_are_one_where_a_time_says_so(tmp_path: Path) -> None:
    head = "time," + ",".join(f"{n} ({u})" for n, u in zip(NAMES, UNITS, strict=True))
    rows = [
        ",".join([f"{TIME_S[k]:.4f}", *(f"{motion(TIME_S[k : k + 1], c)[0]:.9f}" for c in range(3))]) for k in range(N)
    ]
    path = tmp_path / "d.csv"
    path.write_text("\n".join([head, *rows[:250], "", head, *rows[250:]]))
    check(path)
    path.write_text("\n".join([head, *rows[:250], head, *rows[:250]]))
    assert ":253: 'time' runs backwards" in refusal(path)
    plain = [row.partition(",")[2] for row in rows]
    path.write_text("\n".join(["a,b,c", *plain[:250], "a,b,c", *plain[250:]]))
    assert ":252: another block of rows begins here, and no time says" in refusal(path)
    path.write_text("\n".join([head, *rows[:250], "mean,x,y,z", *rows[250:]]))
    assert ":252: another table begins" in refusal(path)


def objects_in_73(path: Path, class_name: str, name: str, beside: Array | None = None) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        node = file.create_dataset(name, data=np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32))
        node.attrs["MATLAB_class"], node.attrs["MATLAB_object_decode"] = np.bytes_(class_name), np.int32(3)
        if beside is not None:
            file["tout"] = beside[None]
            file["tout"].attrs["MATLAB_class"] = np.bytes_("double")


@pytest.mark.parametrize(
    ("class_name", "command"),
    [
        ("Simulink.SimulationData.Dataset", "tt = extractTimetable(logsout); S = table2struct("),
        ("timetable", "S.time = seconds(logsout.Properties.RowTimes"),
        ("timeseries", "struct('time', logsout.Time, 'channel', squeeze(logsout.Data))"),
    ],
)
@pytest.mark.parametrize("beside", [None, TIME_S])
def test_objects_are_refused_with_the_command_that_converts_them(
    tmp_path: Path, class_name: str, command: str, beside: Array | None
) -> None:
    objects_in_73(tmp_path / "d.mat", class_name, "logsout", beside)
    told = refusal(tmp_path / "d.mat")
    assert f"logsout is a MATLAB object ({class_name})" in told and command in told and "save('run.mat'" in told


def matlab_object(name: bytes, class_name: bytes) -> bytes:
    """Return the bytes of an object of a newer class as a v5 file holds it (mxOPAQUE_CLASS, 17)."""

    def element(kind: int, data: bytes) -> bytes:
        return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)

    flags = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1)) + element(1, b"")
    inner = element(14, flags + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1)))
    texts = b"".join(element(1, text) for text in (name, b"MCOS", class_name))
    return element(14, element(6, struct.pack("<II", 17, 0)) + texts + inner)


def test_objects_of_older_files_are_refused_with_the_command(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "d.mat", {"tout": TIME_S[:, None]})
    path = tmp_path / "d.mat"
    path.write_bytes(path.read_bytes() + matlab_object(b"logsout", b"Simulink.SimulationData.Dataset"))
    assert "tt = extractTimetable(logsout)" in refusal(path)
