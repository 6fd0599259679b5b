"""Files as laboratories have them that are not read: the true reason, at its place, from both readers of numbers."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.files.foreign_texts import format_of, rounded_times
from rths_cli.files.measured_data import mend, read_recording

TIME_S = np.arange(400) * 0.004
WAVE = np.sin(2.0 * np.pi * 1.5 * TIME_S)
Reader = Callable[[Path], object]
BOTH = pytest.mark.parametrize("read", [read_accelerogram, read_recording])


def refusal(path: Path, read: Reader, text: str | bytes) -> str:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as caught:
        read(path)
    (told,) = caught.value.faults
    return told.removeprefix(str(path))


def table(head: str, times: list[str], *columns: list[float]) -> str:
    rows = (",".join([t, *(f"{value:.6f}" for value in row)]) for t, *row in zip(times, *columns, strict=True))
    return "\n".join([head, *rows])


@BOTH
@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("    -1\n    55\nmade here\n", ": is a universal file (dataset 55); export it as CSV"),
        ("TIMESERIES XX_AB__HNE_D, 3 samples, 100 sps\n", ": is an IRIS time series"),
    ],
)
def test_named_formats_are_named(tmp_path: Path, read: Reader, head: str, words: str) -> None:
    assert refusal(tmp_path / "a.txt", read, f"{head}1 2\n3 4\n5 6\n").startswith(words)


@pytest.mark.parametrize("stamp", ["2026-03-04T05:06:07.{:06d}", "2026/03/04 05:06:07.{:06d}", "05:06:07.{:06d}"])
def test_dates_in_place_of_times_are_read_below_names_and_told_without_them(tmp_path: Path, stamp: str) -> None:
    times = [stamp.format(4000 * k) for k in range(200)]
    text = table("stamp,table (m/s^2)", times, WAVE[:200].tolist())
    (tmp_path / "a.csv").write_text(text)
    assert read_accelerogram(tmp_path / "a.csv").dt_s == pytest.approx(0.004, rel=1e-9)
    told = refusal(tmp_path / "b.csv", read_accelerogram, text.partition("\n")[2])
    assert told.startswith(":1: ") and "is a date or a time of day; give the time in s from the start" in told


@BOTH
@pytest.mark.parametrize("digits", [2, None])
def test_times_of_too_few_digits_have_one_reason(tmp_path: Path, read: Reader, digits: int | None) -> None:
    times = [f"{t:.2f}" if digits else f"{np.float32(40_000.0 + t):.4f}" for t in TIME_S]
    told = refusal(tmp_path / "a.csv", read, table("time_s,accel_m_s2", times, WAVE.tolist()))
    assert "has too few digits: it is even but rounded to 0.0" in told


def test_a_time_that_jumps_is_not_told_as_rounded() -> None:
    assert rounded_times(np.array([0.0, 0.01, 0.02, 0.2, 0.21, 0.22])) is None
    assert rounded_times(TIME_S) is None
    assert rounded_times(np.round(TIME_S, 2)) == pytest.approx(0.01)


def test_lost_scans_of_a_recording_are_missing_samples(tmp_path: Path) -> None:
    values = WAVE.copy()
    values[[50, 51, 300]] = -9999.0
    path = tmp_path / "a.csv"
    path.write_text(table("time_s,table (m/s^2)", [f"{t:.3f}" for t in TIME_S], values.tolist()))
    found = read_recording(path)
    assert np.flatnonzero(np.isnan(found.samples[0])).tolist() == [50, 51, 300]
    assert "table (m/s^2): 3 samples read exactly -9999" in found.notes[0]
    counts = np.where(np.arange(400) == 7, -9999.0, 8000.0 * WAVE)
    path.write_text(table("time_s,raw", [f"{t:.3f}" for t in TIME_S], counts.tolist()))
    assert not np.isnan(read_recording(path).samples).any()  # a channel that reads as much elsewhere
    assert not np.isnan(mend(np.where(np.arange(4000) == 70, np.nan, 1.0)[None], ("a",))[0]).any()


def test_a_lost_sample_of_a_record_is_not_a_wrong_unit(tmp_path: Path) -> None:
    values = WAVE.copy()
    values[7] = -9999.0
    told = refusal(
        tmp_path / "a.csv", read_accelerogram, table("time_s,accel_m_s2", [f"{t:.3f}" for t in TIME_S], values.tolist())
    )
    assert told.startswith(":9: 1 sample reads exactly -9999") and "unit" not in told


@pytest.mark.parametrize("kind", ["VELOCITY", "DISPLACEMENT"])
def test_a_record_of_velocity_is_named_so(tmp_path: Path, kind: str) -> None:
    head = f"PEER NGA\nmade\n{kind} TIME SERIES IN UNITS OF CM\nNPTS= 4, DT= .01 SEC\n 1 2 3 4\n"
    told = refusal(tmp_path / "a.VT2", read_accelerogram, head)
    assert told == f":3: is a {kind.lower()} record; give the acceleration record of the same station (.AT2)"


@pytest.mark.parametrize("last", ["1 2 3 4\n", "1 2\n"])
def test_several_values_a_line_are_not_to_be_completed_or_removed(tmp_path: Path, last: str) -> None:
    told = refusal(tmp_path / "a.g3", read_accelerogram, "0 1 2 3\n4 5 6 7\n" + last)
    assert "write one value a line" in told and "remove" not in told


def test_text_above_the_figures_of_a_record_is_skipped_and_its_columns_are_chosen_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    for text in (
        "Made here\nby: us\n\nTime [s]\tAcc [g]\n0 0\n0.1 1\n0.2 0\n",
        "Time (s)  Acc (g)  Vel (cm/s)\n0 0 1\n0.1 1 2\n0.2 0 3\n",
    ):
        path.write_text(text)
        assert read_accelerogram(path).accel_m_s2 == pytest.approx([0.0, 9.80665, 0.0])
    told = refusal(path, read_accelerogram, "Made here by us\n0 0\n0.1 1\n0.2 0\n")
    assert told.startswith(":1: text above the figures, which begin in line 2")
    told = refusal(path, read_accelerogram, "Time (s)  Vel (cm/s)  Disp (cm)\n0 0 1\n0.1 1 2\n0.2 0 3\n")
    assert told.startswith(":1: none of the columns (Time (s), Vel (cm/s), Disp (cm)) is an acceleration")


@pytest.mark.parametrize(("unit", "in_m_s2"), [("mg", 9.80665e-3), ("%g", 9.80665e-2), ("ft/sec2", 0.3048)])
@pytest.mark.parametrize("coding", ["utf-8", "utf-16"])
def test_both_readers_know_the_same_units_and_codings(tmp_path: Path, unit: str, in_m_s2: float, coding: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(table(f"time_s,accel ({unit})", [f"{t:.3f}" for t in TIME_S], WAVE.tolist()).encode(coding))
    assert read_accelerogram(path).accel_m_s2 == pytest.approx(WAVE * in_m_s2, abs=1e-6)
    assert read_recording(path).units != ("",)


def test_a_megagram_is_no_acceleration(tmp_path: Path) -> None:
    assert "'Mg' is not one of the units" in refusal(tmp_path / "a.csv", read_accelerogram, "t (s),a (Mg)\n0,1\n1,2\n")


def test_a_column_of_whole_numbers_is_no_universal_file() -> None:
    assert format_of(["-1", "4", "9", "12"]) == "" == format_of(["-1", "100", "-3"])
    assert format_of(["    -1", "    58", "made here"]).startswith("is a universal file (dataset 58)")
