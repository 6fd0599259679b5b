"""Lines over frequency against definitions: roots of the model, scipy's Welch, a known gain and delay."""

import math

import h5py
import numpy as np
import pytest
from made_up_results import POLES, RATE, ZEROS, exact_response, write_result
from scipy.signal import butter, csd, sosfilt, welch

from rths_cli.files.result_reader import read_result
from rths_cli.report.figures import draw

BLACK, BLUE, VERMILLION, GREEN, SKY, PURPLE = "#000000", "#0072B2", "#D55E00", "#009E73", "#56B4E9", "#CC79A7"
ORANGE = "#E69F00"


def test_table_response_is_the_file_s_and_the_model_s(made_up, data, line_of):
    size, phase, coherence = draw("table_response", made_up).axes
    f = data["identification/frequency_hz"]
    measured = data["identification/frf_real"] + 1j * data["identification/frf_imag"]
    assert np.array_equal(line_of(size, SKY), (f, np.abs(measured)))
    assert np.allclose(line_of(size, BLACK)[1], np.abs(exact_response(f)), rtol=1e-9)
    for color, response in ((SKY, measured), (BLACK, exact_response(f))):
        turns = (line_of(phase, color)[1] - np.degrees(np.angle(response))) / 360.0
        assert np.allclose(turns, np.round(turns), atol=1e-9)
        assert np.abs(np.diff(line_of(phase, color)[1])).max() < 90.0
    assert line_of(phase, BLACK)[1][0] == pytest.approx(180.0, abs=30.0)
    assert np.array_equal(line_of(coherence, SKY)[1], data["identification/coherence"])
    marks = [line.get_xdata()[0] for line in size.lines if line.get_color() == VERMILLION]
    assert marks == [3.2, 8.4]
    legend = [text.get_text() for text in draw("table_response", made_up).legends[0].get_texts()]
    assert f"model, {POLES.size} poles, {ZEROS.size} zeros" in legend


def test_a_model_without_staircase_needs_no_controller(tmp_path, line_of):
    path = write_result(tmp_path / "paper.h5")
    with h5py.File(path, "a") as file:
        file["identification/ripple_m_s2_per_v"][()] = 0.0
        del file["controller"]
        f = file["identification/frequency_hz"][()]
    s = 2j * np.pi * f
    alias = exact_response(f) - (-0.9) * np.exp(-s / RATE) * (1.0 - np.exp(-s / RATE))
    assert np.allclose(line_of(draw("table_response", read_result(path)).axes[0], BLACK)[1], np.abs(alias))


def test_spectra_are_welch_s(made_up, data, line_of):
    figure = draw("spectra", made_up)
    for ax, run, color in zip(figure.axes, ("shake_table", "exp_rths"), (GREEN, BLUE), strict=True):
        desired, measured = (data[f"{run}/interface_accel_{kind}_m_s2"] for kind in ("desired", "measured"))
        true = data[f"{run}/truth/table_accel_m_s2"]
        segment = desired.size // 2
        series = {BLACK: desired, color: measured, ORANGE: desired - measured, PURPLE: desired - true}
        for look, values in series.items():
            f, power = welch(values, RATE, nperseg=segment)
            inside = (f >= 0.1) & (f <= 100.0)
            drawn = line_of(ax, look)
            band = [math.floor(48 * math.log2(hz)) for hz in f[inside]]
            means = [
                np.mean([f[inside], power[inside]], axis=1, where=[b == one for b in band]) for one in sorted(set(band))
            ]
            assert np.allclose(np.array(means).T, drawn, rtol=1e-9) and len(means) < 0.7 * inside.sum()
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
        assert ax.get_ylabel() == "PSD ((m/s²)²/Hz)"
        edge = [line.get_xdata()[0] for line in ax.lines if len(line.get_xdata()) == 2]
        assert edge == [12.0]


def test_a_long_record_has_lines_every_eighth_of_a_hertz(tmp_path, line_of):
    result = read_result(write_result(tmp_path / "long.h5", runs=("shake_table",), n=8000))
    f = line_of(draw("spectra", result).axes[0], BLACK)[0]
    assert np.allclose(np.diff(f[f < 8.6]), 0.125), "above, bands of 1/48 octave hold several lines"


def test_gain_and_delay_of_a_table_that_is_late_by_a_sample(made_up, data, line_of):
    """Made up: 1 % too much, 5 ms late; the measured one in noise is left out where it is not coherent."""
    gain, delay, _ = draw("delay_and_gain", made_up).axes
    f, size = line_of(gain, BLUE)
    desired, measured = (data[f"exp_rths/interface_accel_{kind}_m_s2"] for kind in ("desired", "measured"))
    lines, power = welch(desired, RATE, nperseg=desired.size // 2)
    response = csd(desired, measured, RATE, nperseg=desired.size // 2)[1] / power
    inside = (lines >= 0.25) & (lines <= 20.0)
    known = np.isfinite(size)
    assert 10 < known.sum() < known.size and np.array_equal(f, lines[inside])
    assert np.allclose(size[known], np.abs(response[inside])[known])
    late = -np.angle(response[inside]) / (2.0 * np.pi * f)
    assert np.allclose(line_of(delay, BLUE)[1][known], 1e3 * late[known])
    busy = known & (np.abs(f - 6.1) < 0.3)
    assert np.median(size[busy]) == pytest.approx(1.01, abs=0.01)
    assert np.median(late[busy]) == pytest.approx(0.005, abs=1e-4)
    assert np.isfinite(line_of(gain, PURPLE)[1]).sum() > known.sum(), "the true motion has no noise"


def test_nothing_is_drawn_where_the_record_has_no_energy(tmp_path, line_of):
    """The true motion follows without noise at every frequency, so that coherence alone would leave nothing out."""
    path = write_result(tmp_path / "slow.h5", runs=("exp_rths",))
    sections = butter(8, 5.0, fs=RATE, output="sos")
    with h5py.File(path, "a") as file:
        for name in ("interface_accel_desired_m_s2", "truth/table_accel_m_s2"):
            file[f"exp_rths/{name}"][:] = sosfilt(sections, file[f"exp_rths/{name}"][()])
        desired = file["exp_rths/interface_accel_desired_m_s2"][()]
    f, gain = line_of(draw("delay_and_gain", read_result(path)).axes[0], PURPLE)
    lines, power = welch(desired, RATE, nperseg=desired.size // 2)
    power = power[(lines >= 0.25) & (lines <= 20.0)]
    assert np.isnan(gain[power < 1e-4 * power.max()]).all() and np.isnan(gain[f > 12.0]).all()
    assert np.isfinite(gain[power > 1e-2 * power.max()]).all()


def test_latency_of_the_loop_is_the_budget_s(made_up, data, line_of):
    ax = draw("delay_and_gain", made_up).axes[2]
    for name, color in (("total", VERMILLION), ("compensated", "#AAAAAA"), ("left", BLACK)):
        f, value = line_of(ax, color)
        assert np.array_equal(f, data["metrics/latency/frequency_hz"])
        assert np.allclose(value, 1e3 * data[f"metrics/latency/{name}_s"])
    assert {line.get_linestyle() for line in ax.lines} == {"None"}, "nothing is known between the points"
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["compensated", "of the loop", "left"]
