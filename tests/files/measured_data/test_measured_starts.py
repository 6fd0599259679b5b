"""Channels that start at different times: aligned by what the file states, or refused with the shift.

Oracle: a sum of sines, evaluated at the instants at which each channel is sampled.
"""

import logging
from datetime import datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from nptdms import ChannelObject, TdmsWriter
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.files.measured_data import read_recording

Array = NDArray[np.float64]
N, DT_S = 3000, 0.0005
NAMES = ("command_v", "table_m_s2", "floor_2_m_s2")
HZ = np.random.default_rng(3).uniform(0.5, 300.0, 12)


def motion(time_s: Array, channel: int) -> Array:
    return np.asarray(np.sum(np.sin(2.0 * np.pi * np.outer(HZ, time_s) + channel + np.arange(12.0)[:, None]), axis=0))


def sampled(late_samples: tuple[float, ...], counts: tuple[int, ...] = (N, N, N)) -> list[Array]:
    """Return the channels, each sampled `late_samples` intervals after the start of the recording."""
    return [
        motion((np.arange(n) + late) * DT_S, k) for k, (late, n) in enumerate(zip(late_samples, counts, strict=True))
    ]


def refusal(path: Path, dt_s: float | None = None) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, dt_s)
    (told,) = caught.value.faults
    return told.removeprefix(str(path))


def check(path: Path, first: float, tolerance: float, dt_s: float | None = None) -> str:
    """Check that all channels are those at the same instants, the first `first` intervals after the start."""
    found = read_recording(path, dt_s)
    assert found.dt_s == DT_S
    time_s = (np.arange(found.samples.shape[1]) + first) * DT_S
    for k, name in enumerate(NAMES):
        np.testing.assert_allclose(found.samples[found.names.index(name)], motion(time_s, k), atol=tolerance)
    return " ".join(found.notes)


def tdms(path: Path, channels: list[Array], properties: list[dict[str, object]], group: str = "daq") -> None:
    objects = [
        ChannelObject(group, name, values, properties={"wf_increment": DT_S, **stated})
        for name, values, stated in zip(NAMES, channels, properties, strict=True)
    ]
    with TdmsWriter(path) as writer:
        writer.write_segment(objects)


@pytest.mark.parametrize("late", [(0.0, 3.0, 3.0), (50.0, 0.0, 0.0), (7.0, 2.0, 0.0)])
def test_channels_that_start_whole_samples_apart_are_moved(tmp_path: Path, late: tuple[float, ...]) -> None:
    tdms(tmp_path / "d.tdms", sampled(late), [{"wf_start_offset": each * DT_S} for each in late])
    note = check(tmp_path / "d.tdms", max(late), 1e-12)
    assert "start at different times" in note and "moved by whole samples" in note
    assert f"{1e3 * DT_S * (late[0] - min(late)):.6g} ms" in note


@pytest.mark.parametrize("late", [(0.0, 0.2, 0.2), (0.5, 0.0, 0.0), (0.0, 3.4, 3.4), (0.0, 49.7, 0.3)])
def test_channels_that_start_between_samples_are_interpolated(tmp_path: Path, late: tuple[float, ...]) -> None:
    tdms(tmp_path / "d.tdms", sampled(late), [{"wf_start_offset": each * DT_S} for each in late])
    found = read_recording(tmp_path / "d.tdms")
    assert "interpolated between samples" in " ".join(found.notes)
    grid = [each % 1.0 for each in late]
    common = max(set(grid), key=grid.count)
    first = next(  # the common instant that fits the channel with the fewest moves
        start + common
        for start in range(100)
        if np.allclose(found.samples[0][:50], motion((np.arange(50) + start + common) * DT_S, 0), atol=2e-3)
    )
    check(tmp_path / "d.tdms", first, 2e-3)


def test_start_times_of_tdms_count_with_their_fractions(tmp_path: Path) -> None:
    starts = [np.datetime64("2026-02-03T10:00:00.000000"), *[np.datetime64("2026-02-03T10:00:00.001500")] * 2]
    tdms(tmp_path / "d.tdms", sampled((0.0, 3.0, 3.0)), [{"wf_start_time": each} for each in starts])
    check(tmp_path / "d.tdms", 3.0, 1e-12)


def test_equal_starts_change_nothing(tmp_path: Path) -> None:
    start = {"wf_start_time": np.datetime64("2026-02-03T10:00:00.123456"), "wf_start_offset": 0.002}
    tdms(tmp_path / "d.tdms", sampled((0.0, 0.0, 0.0)), [start] * 3)
    assert check(tmp_path / "d.tdms", 0.0, 1e-12) == ""


@pytest.mark.parametrize("unit", ["ms", "min"])
def test_the_unit_of_the_increment_of_tdms_counts(tmp_path: Path, unit: str) -> None:
    late = (0.0, 3.0, 3.0)
    stated: list[dict[str, object]] = [
        {"wf_increment": 1e3 * DT_S, "wf_start_offset": 1e3 * one * DT_S, "wf_xunit_string": unit} for one in late
    ]
    tdms(tmp_path / "d.tdms", sampled(late), stated)
    if unit == "ms":
        check(tmp_path / "d.tdms", 3.0, 1e-12)
    else:
        assert "the unit 'min' of its abscissa" in refusal(tmp_path / "d.tdms")


def test_channels_that_share_no_time_are_refused_with_the_shift(tmp_path: Path) -> None:
    tdms(tmp_path / "d.tdms", sampled((0.0, 0.0, 0.0)), [{}, {}, {"wf_start_offset": 60.0}])
    assert "floor_2_m_s2 60000 ms) and share 0 samples" in refusal(tmp_path / "d.tdms")


def test_a_channel_without_a_start_time_beside_others_is_refused(tmp_path: Path) -> None:
    start = {"wf_start_time": np.datetime64("2026-02-03T10:00:00.123456")}
    tdms(tmp_path / "d.tdms", sampled((0.0, 0.0, 0.0)), [{}, start, start])
    assert "command_v state no start" in refusal(tmp_path / "d.tdms")


def test_missing_samples_in_a_channel_between_the_samples_are_refused(tmp_path: Path) -> None:
    channels = sampled((0.0, 0.0, 0.4))
    channels[2][7] = np.nan
    tdms(tmp_path / "d.tdms", channels, [{}, {}, {"wf_start_offset": 0.4 * DT_S}])
    assert "missing samples" in refusal(tmp_path / "d.tdms")


def test_unknown_scalings_are_refused_by_name_without_a_word_of_the_library(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    scale = {"NI_Number_Of_Scales": 1, "NI_Scaling_Status": "unscaled", "NI_Scale[0]_Scale_Type": "Quadratic"}
    tdms(tmp_path / "d.tdms", sampled((0.0, 0.0, 0.0)), [{}, scale, {}])
    told = refusal(tmp_path / "d.tdms")
    assert "channel 'table_m_s2'" in told and "Quadratic" in told and "export it scaled" in told
    assert capfd.readouterr() == ("", "") and logging.getLogger("nptdms").propagate is not False
    tdms(tmp_path / "d.tdms", sampled((0.0, 0.0, 0.0)), [{}, {**scale, "NI_Scaling_Status": "scaled"}, {}])
    check(tmp_path / "d.tdms", 0.0, 1e-12)


@pytest.mark.parametrize(
    ("kind", "parts"),
    [("Linear", ("Y_Intercept", "Slope")), ("Polynomial", ("Coefficients[0]", "Coefficients[1]"))],
)
def test_plain_samples_with_the_scalings_of_daqmx_are_scaled(tmp_path: Path, kind: str, parts: tuple[str, str]) -> None:
    """Scale 0, the source, is DAQmx's scaler, which files that were written again do not have."""
    late = (0.0, 1.0, 25.0)
    scale = {"NI_Number_Of_Scales": 2, "NI_Scaling_Status": "unscaled", "NI_Scale[1]_Scale_Type": kind}
    scale |= {f"NI_Scale[1]_{kind}_Input_Source": 0, "NI_Scale[1]_Polynomial_Coefficients_Size": 2}
    scale |= {f"NI_Scale[1]_{kind}_{part}": value for part, value in zip(parts, (0.25, 1e-4), strict=True)}
    stored = [np.round((each - 0.25) / 1e-4).astype(np.int32) for each in sampled(late)]
    tdms(tmp_path / "d.tdms", stored, [{**scale, "wf_start_offset": each * DT_S} for each in late])
    check(tmp_path / "d.tdms", 25.0, 1e-4)


LATE = (0.0, 3.0, 3.0)


@pytest.mark.parametrize("form", ["number", "text", "matrix", "group"])
def test_hdf5_that_states_starts_is_aligned(tmp_path: Path, form: str) -> None:
    channels = sampled(LATE)
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file.attrs["dt"] = DT_S
        if form == "matrix":
            file["data"], file["names"] = np.array(channels), list(NAMES)
            file["data"].attrs["start_times"] = np.array(LATE) * DT_S
        for name, values, late in zip(NAMES, channels, LATE, strict=True) if form != "matrix" else ():
            if form == "group":
                file[f"{name}_at/{name}"], file[f"{name}_at/t0"] = values, late * DT_S
                continue
            file[name] = values
            start = f"{datetime.fromtimestamp(1.8e9 + late * DT_S).isoformat()}" if form == "text" else late * DT_S
            file[name].attrs["start_time" if form == "text" else "wf_start_offset"] = start
    check(tmp_path / "d.h5", 3.0, 1e-12)


def test_matlab_that_states_starts_is_aligned(tmp_path: Path) -> None:
    parts = {
        f"part_{k}": {name: values, "t0": late * DT_S}
        for k, (name, values, late) in enumerate(zip(NAMES, sampled(LATE), LATE, strict=True))
    }
    scipy.io.savemat(tmp_path / "d.mat", {"fs": 1.0 / DT_S, **parts})
    check(tmp_path / "d.mat", 3.0, 1e-12)


def rows(path: Path, head: list[str], columns: list[Array], separator: str = ",") -> None:
    lines = [separator.join(f"{value:.9g}" for value in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([*head, *lines]))


@pytest.mark.parametrize(("key", "values"), [("X0", "0\t0.0015\t0.0015"), ("Delta_X", "0.0005\t0.0004\t0.0005")])
def test_text_that_states_other_clocks_than_its_time_is_refused(tmp_path: Path, key: str, values: str) -> None:
    time_s = np.arange(N) * DT_S
    head = [f"{key}\t{values}", "X_Value\tcommand (V)\ttable (m/s^2)\tfloor_2 (m/s^2)"]
    rows(tmp_path / "d.txt", head, [time_s, *sampled((0.0, 0.0, 0.0))], "\t")
    assert ("1.5 ms" if key == "X0" else "Delta_X") in refusal(tmp_path / "d.txt")


@pytest.mark.parametrize(
    "stated", ["X0,0,0.0015,0.0015", "Start offset (ms),0,1.5,1.5,", "start_offsets,0,0.0015", "X0 (min),0,1,1"]
)
def test_text_without_a_time_gives_each_channel_its_start(tmp_path: Path, stated: str) -> None:
    rows(tmp_path / "d.csv", [f"dt,{DT_S}", stated, ",".join(NAMES)], sampled(LATE))
    if stated.startswith("start_offsets"):
        assert ":2: start_offsets states 2 starts above rows of 3 channels" in refusal(tmp_path / "d.csv")
    elif "min" in stated:
        assert ":2: X0 is stated in 'min', which is not known" in refusal(tmp_path / "d.csv")
    else:
        check(tmp_path / "d.csv", 3.0, 1e-6)


def test_starts_that_differ_by_their_rounding_are_one_and_lengths_must_agree(tmp_path: Path) -> None:
    for count in (N, N - 1):
        with h5py.File(tmp_path / f"{count}.h5", "w") as file:
            file.attrs["dt_s"] = DT_S
            for name, values, start in zip(
                NAMES, sampled((0.0, 0.0, 0.0), (N, count, N)), (0.0, 1e-8, 0.0), strict=True
            ):
                file[name] = values
                file[name].attrs["t0"] = start
    check(tmp_path / f"{N}.h5", 0.0, 1e-12)
    assert "samples" in refusal(tmp_path / f"{N - 1}.h5")
