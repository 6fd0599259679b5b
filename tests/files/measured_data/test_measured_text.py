"""Oracles: files written by the csv module or by hand with known figures; units from their definitions."""

import csv
import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rths_cli.errors import InputError
from rths_cli.files.measured_data import Recording, read_recording

ROWS = [[0.0, 0.5, -1.25], [0.1, 0.25, 3e-3], [0.2, -0.75, 2.5], [0.3, 1.0, 4.0]]


def write(folder: Path, text: str, name: str = "made.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def the_fault(path: Path, dt_s: float | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, dt_s)
    assert len(caught.value.faults) == 1
    assert "\n" not in caught.value.faults[0]
    return caught.value.faults[0].removeprefix(str(path))


def check_rows(recording: Recording) -> None:
    assert recording.samples.T.tolist() == [row[1:] for row in ROWS]
    assert recording.dt_s == 0.1


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("quoting", [csv.QUOTE_MINIMAL, csv.QUOTE_NONNUMERIC])
def test_what_the_csv_module_writes_is_read(tmp_path: Path, delimiter: str, quoting: int) -> None:
    path = tmp_path / "made.csv"
    with path.open("w", newline="") as file:
        csv.writer(file, delimiter=delimiter, quoting=quoting).writerows([["time_s", "cmd_v", "table_g"], *ROWS])
    recording = read_recording(path)
    check_rows(recording)
    assert (recording.names, recording.units) == (("cmd_v", "table_g"), ("V", "g"))
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert recording.notes == ()


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("time (s);command (V);table [m/s^2]", ("command (V)", "table [m/s^2]"), ("V", "m/s^2")),
        ("Made up;;\n;;\nt;u;acc\ns;mV;gal", ("u", "acc"), ("mV", "gal")),
        ("t;u;acc\n(s);(V);(ft/s2)", ("u", "acc"), ("V", "ft/s^2")),
        ("t;u;force\nsec;mm;kN", ("u", "force"), ("mm", "kN")),
        ("# operator: me\n# time;u;acc", ("u", "acc"), ("", "")),
        ("A title\nTime [sec];u;acc", ("u", "acc"), ("", "")),
    ],
)
def test_headers(tmp_path: Path, head: str, names: tuple[str, ...], units: tuple[str, ...]) -> None:
    rows = "".join(";".join(f"{value!r}" for value in row) + "\n" for row in ROWS)
    recording = read_recording(write(tmp_path, f"{head}\n{rows}"))
    check_rows(recording)
    assert (recording.names, recording.units) == (names, units)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_decimal_commas(tmp_path: Path, separator: str) -> None:
    rows = "\n".join(separator.join(repr(value) for value in row) for row in ROWS).replace(".", ",")
    check_rows(read_recording(write(tmp_path, separator.join(["time_s", "u", "table_g"]) + "\n" + rows + "\n")))


def test_windows_lines_byte_order_mark_and_utf_16(tmp_path: Path) -> None:
    text = "time (s)\tcommand (V)\ttable (m/s²)\r\n" + "".join("\t".join(map(repr, row)) + "\r\n" for row in ROWS)
    for encoding in ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"):
        path = tmp_path / f"{encoding}.txt"
        path.write_bytes(text.encode(encoding))
        recording = read_recording(path)
        check_rows(recording)
        assert recording.units == ("V", "m/s^2")


def test_missing_cells_are_nan_wherever_they_stand(tmp_path: Path) -> None:
    cells = ["", "nan", "NaN", "-", "---", "N/A", " ", "null"]
    rows = "".join(f"{k / 10:.1f},{cell},{k}\n{k / 10 + 0.05:.2f},7,{cell}\n" for k, cell in enumerate(cells))
    recording = read_recording(write(tmp_path, "time_s,a_v,b_v\n" + rows))
    n = len(cells)
    expected = np.array([[np.nan, 7.0] * n, np.ravel([[k, np.nan] for k in range(n)])])
    np.testing.assert_array_equal(recording.samples, expected)


def test_columns_without_names_are_numbered_and_blank_ones_dropped(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path, "1,2,\n3,4,\n5,6,\n"), dt_s=0.001)
    assert recording.names == ("column 1", "column 2")
    assert recording.samples.tolist() == [[1, 3, 5], [2, 4, 6]]


def test_a_blank_line_behind_every_row_is_no_new_block(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path, "a_v,b_v\n\n1,2\n\n3,4\n\n5,6\n"), dt_s=0.001)
    assert recording.samples.tolist() == [[1, 3, 5], [2, 4, 6]]


@pytest.mark.parametrize("end", [",,\n,,\n", "\n\n", ",\t,  \n"])
def test_blank_rows_at_the_end_are_no_samples(tmp_path: Path, end: str) -> None:
    recording = read_recording(write(tmp_path, "a_v,b_v,c_v\n1,2,3\n,,\n4,5,6\n" + end), dt_s=0.001)
    np.testing.assert_array_equal(recording.samples[0], [1, np.nan, 4])


def test_infinite_samples_are_named_and_missing(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path, "a_v\n1\ninf\n-inf\n2\n"), dt_s=0.001)
    np.testing.assert_array_equal(recording.samples, [[1, np.nan, np.nan, 2]])
    assert recording.notes == ("a_v: 2 samples are infinite (overload) and taken as missing",)


@pytest.mark.parametrize(
    "line",
    [
        *("# dt: 0.0005 s", "# dt: 0.5 ms", "# fs = 2000", "Sample rate (Hz),2000", "% sampling_rate: 2 kHz"),
        *("fs_hz\t2000", "Sampling rate (kHz): 2", "Sample rate,2,kHz", "fs = 2.0 [kHz]", "dt (ms): 0.5", "fs,2000,,"),
        *("Sample interval: 0.5 msec", "Sample rate: 2 kS/s", "# dt: 500 µs", "fs = 2000 npts=5", "fs [kHz],2,2"),
    ],
)
def test_a_stated_rate(tmp_path: Path, line: str) -> None:
    recording = read_recording(write(tmp_path, line + "\na_v,b_g\n" + "1,2\n" * 5))
    assert recording.dt_s == pytest.approx(0.0005, rel=1e-12)
    assert recording.names == ("a_v", "b_g")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("# fs: 2,000 Hz", ":1: fs is '2,000', in which the comma may stand between thousands"),
        ("# fs: 2 rpm", ":1: fs is stated in 'rpm', which is not known; give it in Hz or kHz"),
        ("# dt (min): 2", ":1: dt is stated in 'min', which is not known; give it in s, ms or us"),
        ("# dt (ms): 0.5 s", ":1: dt has two units that differ"),
        ("Sample rate,2000,1000", ": line 1 (Sample rate) says 2000 Hz (0.0005 s), line 1 (Sample rate) says 1000 Hz"),
    ],
)
def test_a_rate_in_doubt_is_refused(tmp_path: Path, line: str, expected: str) -> None:
    assert the_fault(write(tmp_path, line + "\na_v,b_g\n" + "1,2\n" * 5)).startswith(expected)


BODY = "".join(f"{k / 100},{k},0\n" for k in range(5))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ": is empty"),
        ("\n \n", ": no row of numbers"),
        ("a,b\nc,d\n", ": no row of numbers"),
        ("t,a,b\n" + BODY + "0.05,1\n0.06,1\n", ":7: 2 cells in this row (2 such rows), 3 in the first"),
        ("t,a,b\n0,1,2,3\n", ":1: 3 names above rows of 4 cells"),
        ("t,a,b\n" + BODY + "\n# aside\n0.05,x,1\n0.06,y,1\n", ":9: a: 'x' is not a number"),
        ("t,a,b\n" + BODY + "0.05,1_0,1\n", ":7: a: '1_0' is not a number"),
        ("t,a,b\n0.0,OVER,1\n" + BODY, ":2: 'OVER' is not a number"),
        ("t;a\n0,1;2\n0,2;3\n0.3;4\n", ":4: decimal points and commas are mixed (the other stands in line 2)"),
        ("a,b\n1,2\n3,4\n5,6\n", ": states no sample rate and has no time column; give --rate HZ"),
        ("t,a\n0,1\n1,2\n", ": holds 2 samples; a recording needs at least 3"),
        ("t\n0\n1\n2\n", ": holds no channel beside the time"),
        ("t,time_s,a\n0,0,1\n1,2,2\n2,4,2\n", ": has 2 time columns that differ"),
        ("time (h),a\n0,1\n1,2\n2,3\n", ": the unit of 'time (h)' is not s, ms or us"),
        ('t,a\n"0,0","1,5"\n"0,1","2,5"\n', ":2: '0,0' has a comma, before a fraction or between thousands"),
        ("# fs: 9\na,b\n1,2\n3,4\n\n5,6\n", ":6: another block of rows begins here, and no time says"),
        ("# fs: 0\na\n1\n2\n3\n", ": line 1 (fs) says an interval of inf s"),
        ("PK\x03\x04 xl/workbook.xml", ": is an Excel workbook; save the sheet as CSV"),
        ("PK\x03\x04 a.txt", ": is a zip archive"),
        ("PK\x03\x04 a.npy", ": is a damaged or truncated NumPy file"),
        ("a\x00b", ": is a binary file of unknown kind; give CSV or text, MATLAB .mat, HDF5, TDMS, LabVIEW"),
        ("%PDF-1.4", ": is a PDF document"),
        ("# Created by Octave 9", ": is an Octave text file"),
        ("TDSh", ": is the index of a TDMS file"),
    ],
)
def test_faulty_texts_are_refused_in_one_sentence(tmp_path: Path, text: str, expected: str) -> None:
    assert the_fault(write(tmp_path, text)).startswith(expected)


def test_every_column_with_a_bad_cell_is_named_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, "t,a,b\n" + BODY + "0.05,x,y\n0.06,z,1\n")
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert [fault.partition(" is not")[0] for fault in caught.value.faults] == [
        f"{path}:7: a: 'x'",
        f"{path}:7: b: 'y'",
    ]


def test_absent_files_and_folders_are_refused(tmp_path: Path) -> None:
    assert "No such file" in the_fault(tmp_path / "absent.csv")
    assert "Is a directory" in the_fault(tmp_path)


numbers = st.floats(-1e29, 1e29).filter(lambda value: value != -9999.0) | st.just(float("nan"))
"""Vaster ones and -9999 are taken as missing."""


@settings(derandomize=True, max_examples=60, deadline=None)
@given(
    rows=st.lists(st.tuples(numbers, numbers, numbers), min_size=3, max_size=20),
    delimiter=st.sampled_from([",", ";", "\t"]),
    missing=st.sampled_from(["", "nan", "-"]),
)
def test_any_figures_come_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, ...]], delimiter: str, missing: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "round.csv"
    whole = [(1.0, 2.0, 3.0), *rows, (4.0, 5.0, 6.0)]  # rows without a value end a table
    with path.open("w", newline="") as file:
        written = [[missing if value != value else repr(value) for value in row] for row in whole]
        csv.writer(file, delimiter=delimiter).writerows([["a", "b", "c"], *written])
    np.testing.assert_array_equal(read_recording(path, dt_s=0.01).samples.T, np.array(whole))
