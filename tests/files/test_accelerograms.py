"""Oracles: hand-written files with known figures, units from their definitions, the facts of the shipped records."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rths_cli.errors import InputError
from rths_cli.files import accelerograms
from rths_cli.files.accelerograms import find_unit, read_accelerogram

RECORDS = Path(__file__).parents[2] / "records"
OLD_AT2 = """PACIFIC ENGINEERING AND ANALYSIS STRONG-MOTION DATA
 SOMEWHERE 02/09/71 14:00, A DAM, 164 (CDMG STATION 279)
 ACCELERATION TIME HISTORY IN UNITS OF G. FILTER POINTS: HP=0.1 Hz LP=25.0 Hz
{counts}
  .1000E-02  -.2000E-02   .3000E-02
 -.1500E+00   .5000E-02
"""
NEW_AT2 = """PEER NGA STRONG MOTION DATABASE RECORD
Made Up-01, 5/19/1940, Array #9, 180
ACCELERATION TIME SERIES IN UNITS OF G
NPTS=      5, DT=   .0100 SEC,
   .1000000E-02  -.2000000E-02   .3000000E-02  -.1500000E+00   .5000000E-02
"""
AT2_FIGURES = np.array([0.001, -0.002, 0.003, -0.15, 0.005]) * 9.80665


def write(folder: Path, text: str, name: str = "made.csv") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def faults(path: Path, unit: str | None = None, dt_s: float | None = None) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        read_accelerogram(path, unit, dt_s)
    return caught.value.faults


def the_fault(path: Path, unit: str | None = None, dt_s: float | None = None) -> str:
    found = faults(path, unit, dt_s)
    assert len(found) == 1
    assert "\n" not in found[0]
    return found[0].removeprefix(str(path))


@pytest.mark.parametrize(
    ("name", "samples", "index", "peak_gal", "first", "last"),
    [("el_centro", 2688, 106, 341.7, -1.4, -1.4), ("hachinohe", 2550, 908, 229.7, -1.5, -0.6)],
)
def test_shipped_records_have_the_facts_of_their_headers(
    name: str, samples: int, index: int, peak_gal: float, first: float, last: float
) -> None:
    record = read_accelerogram(RECORDS / f"{name}.csv")
    assert len(record.accel_m_s2) == samples
    assert np.argmax(np.abs(record.accel_m_s2)) == index
    assert record.accel_m_s2[[index, 0, -1]] == pytest.approx([peak_gal / 100, first / 100, last / 100], rel=1e-12)
    assert (record.dt_s, record.unit_read) == (0.02, "cm/s^2")
    assert "MIT licence" in record.origin
    assert record.sha256 == hashlib.sha256((RECORDS / f"{name}.csv").read_bytes()).hexdigest()


def test_hachinohe_peak_is_at_its_stated_time() -> None:
    record = read_accelerogram(RECORDS / "hachinohe.csv")
    assert record.dt_s * np.argmax(np.abs(record.accel_m_s2)) == pytest.approx(18.16)


@pytest.mark.parametrize(
    ("unit", "in_m_s2"),
    [("m/s^2", 1.0), ("cm/s^2", 0.01), ("gal", 0.01), ("g", 9.80665), ("mm/s^2", 0.001), ("in/s^2", 0.0254)],
)
def test_every_unit_is_converted(tmp_path: Path, unit: str, in_m_s2: float) -> None:
    path = write(tmp_path, "1\n-2\n0.5\n")
    record = read_accelerogram(path, unit=unit, dt_s=0.005)
    assert record.accel_m_s2 == pytest.approx(np.array([1.0, -2.0, 0.5]) * in_m_s2)
    assert (record.dt_s, record.unit_read, record.title) == (0.005, unit, "made")


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("cm/s^2 (gal)", "cm/s^2"),
        ("G", "g"),
        ("M/SEC/SEC", "m/s^2"),
        ("cm/sec2", "cm/s^2"),
        ("mm/s²", "mm/s^2"),
        ("in/s**2", "in/s^2"),
        ("cm/s", None),
        ("g (gal)", None),
        ("", None),
        ("%g", "%g"),
    ],
)
def test_spellings_of_units(text: str, unit: str | None) -> None:
    assert find_unit(text) == unit


def test_own_format_keeps_title_and_origin(tmp_path: Path) -> None:
    text = (
        "# A title\n# units: g\n# dt: 0.02 s\n# samples: 3\n# origin: one\n# origin: two\n# note: any\n0.1\n\n-0.2\n0\n"
    )
    record = read_accelerogram(write(tmp_path, text))
    assert record.accel_m_s2 == pytest.approx([0.980665, -1.96133, 0.0])
    assert (record.title, record.origin, record.dt_s) == ("A title", "one two", 0.02)
    assert record.format == "one column"


@pytest.mark.parametrize(
    "text",
    [
        NEW_AT2,
        OLD_AT2.format(counts="    5    0.0100    NPTS, DT"),
        OLD_AT2.format(counts="NPTS=  5, DT= .01000 SEC"),
    ],
)
def test_peer_at2_old_and_new(tmp_path: Path, text: str) -> None:
    record = read_accelerogram(write(tmp_path, text, "RSN1.AT2"))
    assert record.accel_m_s2 == pytest.approx(AT2_FIGURES, rel=1e-12)
    assert (record.dt_s, record.unit_read, record.format) == (0.01, "g", "PEER AT2")
    assert record.title == text.splitlines()[1].strip()


@pytest.mark.parametrize(
    "head",
    [
        "time_s,accel_m_s2",
        "time (s), acceleration (m/s^2)",
        "Time [sec]\tAcc [m/s2]",
        "t acc_ms2",
        '"time";"a (M/S/S)"',
        "# units: m/s^2",
        "# units: m/s^2\n# dt: 0.005\ntime,accel",
    ],
)
def test_two_columns_with_a_unit_in_the_head(tmp_path: Path, head: str) -> None:
    record = read_accelerogram(write(tmp_path, f"{head}\n0.000,0.5\n0.005,-1.5\n0.010,2.5\n0.015,0\n"))
    assert record.accel_m_s2 == pytest.approx([0.5, -1.5, 2.5, 0.0])
    assert (record.dt_s, record.format) == (0.005, "time and acceleration")


@pytest.mark.parametrize("name", ["time,accel_g", "time;acceleration (g)", "time acceleration [g]", "time,a (G)"])
def test_column_names_in_g(tmp_path: Path, name: str) -> None:
    record = read_accelerogram(write(tmp_path, f"{name}\n0 0.1\n0.5 0.2\n1 0.3\n"))
    assert record.accel_m_s2 == pytest.approx(np.array([0.1, 0.2, 0.3]) * 9.80665)


def test_rounded_times_are_an_even_interval(tmp_path: Path) -> None:
    rows = "".join(f"{k / 256:.4f} {k}e-3\n" for k in range(2561))
    assert read_accelerogram(write(tmp_path, rows), unit="g").dt_s == pytest.approx(1 / 256, rel=1e-6)


def test_missing_unit_and_interval_name_the_keys_to_add(tmp_path: Path) -> None:
    first, second = faults(write(tmp_path, "1\n2\n3\n"))
    assert "record: {file: made.csv, unit: g}" in first
    assert "record: {file: made.csv, dt_s: 0.01}" in second


HEAD = "# units: gal\n# dt: 0.02 s\n"


@pytest.mark.parametrize(
    ("text", "unit", "dt_s", "expected"),
    [
        (HEAD + "1\n2\n3\n", "g", None, ":1: the file states the unit gal, the case record.unit: g"),
        (HEAD + "1\n2\n3\n", None, 0.01, ":2: the file states an interval of 0.02 s, the case record.dt_s: 0.01"),
        (
            HEAD + "0 1\n0.01 2\n0.02 3\n",
            None,
            None,
            ":2: the header states dt = 0.02 s, the time column steps by 0.01",
        ),
        (HEAD + "# samples: 4\n1\n2\n3\n", None, None, ":3: the header states 4 samples, the file holds 3"),
        (HEAD + "1\n2\n", None, None, ": holds 2 samples, an accelerogram needs at least 3"),
        ("time (s),acc (g)\n0,1\n", None, None, ": holds 1 sample, an accelerogram needs at least 3"),
        (HEAD + "1\n2\nnan\n", None, None, ":5: sample 3 is not a finite number"),
        (HEAD + "1\n2\n\n# aside\n-inf\n", None, None, ":7: sample 3 is not a finite number"),
        (HEAD + "1\n2\nthree\n", None, None, ":5: 'three' is not a number"),
        (HEAD + "1,2,3\n4,5,6\n7,8,9\n", None, None, ":3: 3 columns; give one"),
        (HEAD + "0,1\n0.02,2\n0.04\n", None, None, ":5: holds 1 of 2 numbers"),
        (HEAD + "1\n20000\n3\n", None, None, ":4: the peak of 200 m/s^2 is above the limit of 100 m/s^2, the unit gal"),
        ("# units: gal\n0 1\n0.02 2\n0.04 3\n0.07 4\n", None, None, ":5: the time (first column) steps by 0.03 s here"),
        ("# units: gal\n0 1\n0.02 2\n0.01 3\n", None, None, ":4: the time (first column) does not increase here"),
        ("# units: furlong\n1\n2\n3\n", None, 0.02, ":1: 'furlong' is not one of the units m/s^2, cm/s^2"),
        ("# dt: 20 ms\n1\n2\n3\n", "g", None, ":1: dt: '20 ms' is not an interval in s"),
        ("# units: g\n# units: gal\n1\n2\n3\n", None, 0.02, ":2: unit is stated here and in line 1"),
        ("# units: g\n# samples: few\n1\n2\n3\n", None, 0.02, ":2: samples: 'few' is not a whole number"),
        ("# units: g\n# dt: 20\n1\n2\n3\n", None, None, ":2: the interval 20 s must be above 0 and at most 1 s"),
        ("time_s,velocity_m_s\n0,1\n1,2\n2,3\n", "g", None, ":1: the column 'velocity_m_s' is not an acceleration"),
        ("time (ms),acc (g)\n0,1\n1,2\n2,3\n", None, None, ":1: the column 'time (ms)' is not a time in s"),
        ("time (s),acc (knots)\n0,1\n1,2\n2,3\n", None, None, ":1: 'knots' is not one of the units"),
        ("", "g", 0.01, ": holds no numbers"),
        ("0.00, 0\n0.01, 0\n0.02, 0.0\n0.03, 0\n", "g", None, ": every acceleration is zero"),
        ("# units: g\n# dt: 0.01\n", None, None, ": holds no numbers"),
        (NEW_AT2.replace("5,", "6,"), None, None, ":4: the header states 6 samples, the file holds 5"),
        (NEW_AT2.replace("UNITS OF G", "UNITS OF CM/S"), None, None, ":3: 'CM/S' is not one of the units"),
        (NEW_AT2.replace(".3000000E-02", "******"), None, None, ":5: '******' is not a number"),
        (NEW_AT2, "gal", None, ":3: the file states the unit g, the case record.unit: gal"),
        (NEW_AT2, None, 0.02, ":4: the file states an interval of 0.01 s"),
    ],
)
def test_faulty_files_are_refused_in_one_sentence_with_their_line(
    tmp_path: Path, text: str, unit: str | None, dt_s: float | None, expected: str
) -> None:
    assert the_fault(write(tmp_path, text), unit, dt_s).startswith(expected)


@pytest.mark.parametrize("dt_s", [0.0, -0.01, float("nan"), float("inf"), 2.0])
def test_stated_interval_out_of_range_is_refused(tmp_path: Path, dt_s: float) -> None:
    assert the_fault(write(tmp_path, "1\n2\n3\n"), "g", dt_s).startswith("record.dt_s: the interval")


def test_unknown_stated_unit_is_refused(tmp_path: Path) -> None:
    assert the_fault(write(tmp_path, "1\n2\n3\n"), "feet", 0.01).startswith(
        "record.unit: 'feet' is not one of the units"
    )


def test_agreeing_statements_are_accepted(tmp_path: Path) -> None:
    path = write(tmp_path, HEAD + "1\n2\n3\n")
    assert read_accelerogram(path, unit="cm/s^2", dt_s=0.02).accel_m_s2 == pytest.approx([0.01, 0.02, 0.03])


def test_binary_missing_folder_and_huge_files_are_refused(tmp_path: Path) -> None:
    binary, huge = tmp_path / "a.mat", tmp_path / "huge.csv"
    binary.write_bytes(b"\x89HDF\r\n\x1a\n\x00\x00")
    with huge.open("wb") as file:
        file.truncate(1_000_000_000)
    assert the_fault(binary).startswith(": is damaged and cannot be opened")
    assert the_fault(huge) == ": 1000 MB; an accelerogram may have 60 MB, cut it"
    assert "No such file" in the_fault(tmp_path / "absent.csv")
    assert "Is a directory" in the_fault(tmp_path)


def test_latin_1_header_windows_lines_and_byte_order_mark_are_read(tmp_path: Path) -> None:
    old, new = tmp_path / "old.csv", tmp_path / "new.csv"
    old.write_bytes("# Tōkachi 43°N\r\n# units: g\r\n# dt: 0.01\r\n1\r\n2\r\n3\r\n".replace("ō", "o").encode("latin-1"))
    new.write_bytes(b"\xef\xbb\xbf# units: g\n# dt: 0.01\n1\n2\n3\n")
    assert read_accelerogram(old).title == "Tokachi 43°N"
    assert read_accelerogram(new).accel_m_s2 == pytest.approx(np.array([1, 2, 3]) * 9.80665)


WORDS = [
    "# units: g",
    "# dt: 0.01",
    "NPTS= 3, DT= .01 SEC",
    "3 .01 NPTS, DT",
    "time_s,accel_g",
    "nan",
    "1e999",
    "0 1",
    "0.01,2",
    "-3",
]


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.one_of(st.binary(max_size=60), st.lists(st.sampled_from(WORDS)).map(lambda rows: "\n".join(rows).encode())))
def test_any_bytes_give_a_record_or_a_sentence(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(data)
    try:
        record = read_accelerogram(path)
    except InputError as fault:
        assert fault.faults
    else:
        assert np.isfinite(record.accel_m_s2).all()
        assert len(record.accel_m_s2) >= 3


def test_a_file_of_too_many_lines_is_refused_before_they_are_split(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_bytes(b"1\n" * (accelerograms.MAX_LINES + 1))
    with pytest.raises(InputError, match="has 5000001 lines, the limit is 5000000; cut or resample the record"):
        read_accelerogram(path)
