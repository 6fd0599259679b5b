"""Oracles: times made from a known interval, printed with few digits, cut, jittered or turned around."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.measured_data import Recording, read_recording

TIMES = np.arange(2000) / 2000.0


def write(folder: Path, times: NDArray[np.float64], form: str = "%.10g", name: str = "time_s", head: str = "") -> Path:
    path = folder / "made.csv"
    values = np.arange(len(times))
    rows = "".join(f"{form % t},{v}\n" for t, v in zip(times, values, strict=True))
    path.write_text(f"{head}{name},a_v\n{rows}")
    return path


def read(folder: Path, times: NDArray[np.float64], form: str = "%.10g") -> Recording:
    return read_recording(write(folder, times, form))


def the_fault(path: Path, dt_s: float | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, dt_s)
    assert len(caught.value.faults) == 1
    return caught.value.faults[0].removeprefix(str(path))


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0, 2000.0, 2048.0, 1652.0, 51200.0])
@pytest.mark.parametrize("start", [0.0, -1.0, 12.0])
def test_interval_is_exact_from_printed_times(tmp_path: Path, rate_hz: float, start: float) -> None:
    recording = read(tmp_path, start + np.arange(3000) / rate_hz)
    assert recording.dt_s == 1.0 / rate_hz
    assert recording.samples.shape == (1, 3000)


def test_few_digits_are_a_jitter_that_is_reported(tmp_path: Path) -> None:
    recording = read(tmp_path, np.arange(5000) / 2048.0, "%.4f")
    assert recording.dt_s == pytest.approx(1 / 2048, rel=1e-4)
    assert len(recording.notes) == 1
    assert "'time_s' has a jitter of up to 10." in recording.notes[0]
    assert read_recording(tmp_path / "made.csv", dt_s=1 / 2048).dt_s == 1 / 2048


def test_a_gap_in_time_becomes_missing_samples(tmp_path: Path) -> None:
    kept = np.concatenate([np.arange(100), np.arange(137, 600), np.arange(601, 2000)])
    recording = read(tmp_path, TIMES[kept], "%.5f")
    expected = np.full(2000, np.nan)
    expected[kept] = np.arange(len(kept))
    np.testing.assert_array_equal(recording.samples[0], expected)
    assert recording.dt_s == 0.0005
    assert recording.notes == ("'time_s' has 2 gaps, the first at 0.05 s: 38 samples are missing in every channel",)


def test_a_long_gap_is_counted_to_the_sample_although_times_are_rounded(tmp_path: Path) -> None:
    kept = np.concatenate([np.arange(3000), np.arange(4001, 9000)])
    recording = read(tmp_path, kept / 2048.0, "%.4f")
    assert np.flatnonzero(np.isnan(recording.samples[0])).tolist() == list(range(3000, 4001))


@pytest.mark.parametrize(("name", "factor"), [("time_ms", 1e3), ("t [us]", 1e6), ("Time (sec)", 1.0), ("t", 1.0)])
def test_units_of_time(tmp_path: Path, name: str, factor: float) -> None:
    assert read_recording(write(tmp_path, TIMES * factor, name=name)).dt_s == pytest.approx(0.0005, rel=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({700: 699 / 2000}, ":702: 'time_s' repeats (0.3495 after 0.3495)"),
        ({700: 0.1}, ":702: 'time_s' runs backwards (0.1 after 0.3495)"),
        ({700: 700.35 / 2000}, ":702: 'time_s' is 0.35 of an interval from its even place"),
        ({700: 700.45 / 2000}, ":702: 'time_s' steps by 1.45 intervals here, which is not whole"),
        ({700: np.nan}, ":702: 'time_s' is missing here"),
        ({700: -1.7e308, 701: 1.7e308}, ":702: 'time_s' runs backwards"),
        ({0: -1.7e308, 1999: 1.7e308}, ":3: 'time_s' has gaps longer"),
        ({1999: 9.0}, ":2001: 'time_s' has gaps longer than the recording itself"),
    ],
)
def test_faulty_times_are_named_with_their_row(tmp_path: Path, change: dict[int, float], expected: str) -> None:
    times = TIMES.copy()
    for index, value in change.items():
        times[index] = value
    assert the_fault(write(tmp_path, times)).startswith(expected)


def test_a_gap_that_is_no_whole_number_of_samples_is_refused(tmp_path: Path) -> None:
    times = np.concatenate([TIMES[:1000], TIMES[1000:] + 0.0005 * 20.5])
    assert the_fault(write(tmp_path, times)).startswith(":1002: 'time_s' steps by 21.50 intervals here")


def test_a_drifting_clock_is_refused(tmp_path: Path) -> None:
    assert "of an interval from its even place" in the_fault(write(tmp_path, TIMES + 1e-3 * TIMES**2))


def test_statements_must_agree(tmp_path: Path) -> None:
    path = write(tmp_path, TIMES)
    assert read_recording(path, dt_s=0.0005 * (1 + 5e-7)).dt_s == 0.0005 * (1 + 5e-7)
    assert the_fault(path, 0.0005 * (1 + 2e-6)).startswith(
        ": the time column says 2000 Hz (0.0005 s), --rate says 1999.996 Hz"
    )
    stated = write(tmp_path, TIMES, head="# fs: 1000\n")
    assert the_fault(stated) == (
        ": the time column says 2000 Hz (0.0005 s), line 1 (fs) says 1000 Hz (0.001 s); correct or remove one of them"
    )


@pytest.mark.parametrize("dt_s", [0.0, -0.01, float("nan"), float("inf"), 2.0])
def test_an_interval_out_of_range_is_refused(tmp_path: Path, dt_s: float) -> None:
    path = tmp_path / "made.csv"
    path.write_text("a_v\n1\n2\n3\n")
    assert "it must be above 0 and at most 1 s" in the_fault(path, dt_s)
