"""Oracles: gaps cut into polynomials and sines of known values; counts made by hand."""

import numpy as np
import pytest

from rths_cli.files.measured_data import mend, missing

N = 20_000
K = np.arange(N, dtype=float)
BEND = 2.0 - 0.3 * (K / N) + 5.0 * (K / N) ** 2 - 4.0 * (K / N) ** 3


def cut(values: np.ndarray, *gaps: tuple[int, int]) -> np.ndarray:
    holed = np.array([values])
    for start, length in gaps:
        holed[0, start : start + length] = np.nan
    return holed


def test_missing_samples_are_named() -> None:
    samples = np.zeros((3, 1000))
    samples[0, 250:260] = np.nan
    samples[0, 900:] = np.nan
    samples[2, 0] = np.nan
    assert missing(samples, ("command", "table", "floor 2"), 0.002) == (
        "command: 110 samples are missing (11 % of the record), the longest run 100 (0.2 s), the first at 0.5 s",
        "floor 2: 1 sample is missing (0.1 % of the record), the longest run 1 (0.002 s), the first at 0 s",
    )


@pytest.mark.parametrize("length", [1, 2, 3])
def test_a_cubic_is_bridged_exactly(length: int) -> None:
    holed = cut(BEND, (100, length), (100 + length + 2, length), (N - length - 2, length))
    mended, notes = mend(holed, ("table",))
    np.testing.assert_allclose(mended[0], BEND, rtol=0, atol=1e-12)
    what = "missing samples bridged by cubic interpolation"
    assert notes == (f"table: {3 * length} {what}",)


def test_one_sample_is_one(tmp_path: object) -> None:
    assert mend(cut(BEND, (100, 1)), ("table",))[1] == ("table: 1 missing sample bridged by cubic interpolation",)


def test_input_is_not_changed_and_other_samples_stay_bit_for_bit() -> None:
    holed = cut(np.sin(K / 50), (100, 2), (5000, 40))
    kept = holed.copy()
    mended, _ = mend(holed, ("table",))
    np.testing.assert_array_equal(holed, kept)
    known = ~np.isnan(holed)
    assert mended[known].tobytes() == holed[known].tobytes()


def test_a_sine_at_the_edge_of_the_band_is_met_within_the_stated_error() -> None:
    sine = np.sin(2 * np.pi * 0.049 * K + 0.3)
    gaps = [(100 + 1003 * k, 1 + k % 3) for k in range(9)]
    mended, _ = mend(cut(sine, *gaps), ("table",))
    assert 0.005 < np.abs(mended[0] - sine).max() < 0.016


@pytest.mark.parametrize("gap", [(100, 4), (0, 1), (1, 1), (N - 1, 1), (N - 2, 1), (N - 4, 3)])
def test_long_gaps_and_gaps_at_the_ends_stay(gap: tuple[int, int]) -> None:
    holed = cut(BEND, gap)
    mended, notes = mend(holed, ("table",))
    np.testing.assert_array_equal(mended, holed)
    assert notes == ()


def test_gaps_too_close_to_each_other_stay() -> None:
    holed = cut(BEND, (100, 2), (103, 2), (500, 1))
    mended, notes = mend(holed, ("table",))
    assert np.flatnonzero(np.isnan(mended[0])).tolist() == [100, 101, 103, 104]
    assert notes == ("table: 1 missing sample bridged by cubic interpolation",)


@pytest.mark.parametrize(("gaps", "bridged"), [(20, True), (21, False)])
def test_more_than_a_thousandth_of_the_record_stays(gaps: int, bridged: bool) -> None:
    mended, notes = mend(cut(BEND, *[(100 + 50 * k, 1) for k in range(gaps)]), ("table",))
    assert np.isnan(mended).sum() == (0 if bridged else gaps)
    assert len(notes) == 1
    if not bridged:
        assert (
            notes[0]
            == "table: 21 missing samples in short gaps are not bridged, because they are more than 0.1 % of the record"
        )


@pytest.mark.parametrize(
    ("part_of_nyquist", "power", "bridged"),
    [(0.09, 1.0, True), (0.12, 1.0, False), (0.5, 0.005, True), (0.5, 0.02, False)],
)
def test_only_channels_whose_content_is_slow_are_bridged(part_of_nyquist: float, power: float, bridged: bool) -> None:
    slow, other = np.sin(2 * np.pi * 0.002 * K), np.sin(np.pi * part_of_nyquist * K)
    values = np.sqrt(1 - power) * slow + np.sqrt(power) * other
    mended, notes = mend(cut(values, (100, 1), (5000, 3)), ("table",))
    assert np.isnan(mended).sum() == (0 if bridged else 4)
    assert ("not bridged" in notes[0]) is not bridged
    if not bridged:
        assert "of the channel's power lies above 0.1 of half the sample rate" in notes[0]


def test_silent_empty_and_whole_channels() -> None:
    samples = np.zeros((3, N))
    samples[0, 500] = np.nan
    samples[1] = np.nan
    mended, notes = mend(samples, ("a", "b", "c"))
    assert mended[0, 500] == 0.0
    assert np.isnan(mended[1]).all()
    assert notes == ("a: 1 missing sample bridged by cubic interpolation",)
    assert len(missing(samples, ("a", "b", "c"), 0.001)) == 2
