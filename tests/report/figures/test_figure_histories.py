"""Lines of the time histories are the file's samples; errors are differences through scipy's own filter."""

import re

import numpy as np
import pytest
from made_up_results import RATE, write_result
from scipy.signal import butter, sosfiltfilt

from rths_cli.files.result_reader import read_result
from rths_cli.report.figures import draw

BLACK, BLUE, VERMILLION, GREEN = "#000000", "#0072B2", "#D55E00", "#009E73"
ORANGE, PURPLE, SKY = "#E69F00", "#CC79A7", "#56B4E9"
RUNS = {"sim": BLACK, "sim_delay": VERMILLION, "exp_rths": BLUE, "shake_table": GREEN}


def banded(series):
    return sosfiltfilt(butter(4, 12.0, fs=RATE, output="sos"), series)


def by_title(figure, text):
    return next(ax for ax in figure.axes if ax.get_title(loc="left").partition(") ")[2] == text)


def thinned_from(line, time, values):
    """Tell whether a line holds samples of a series, its peaks among them."""
    t, v = line
    places = np.searchsorted(time, t)
    assert np.array_equal(time[places], t) and np.array_equal(values[places], v)
    assert (v.max(), v.min()) == (values.max(), values.min())
    return True


def test_tracking_shows_desired_and_measured_of_both_tests(made_up, data, line_of):
    figure = draw("tracking", made_up)
    for whole, close, run in zip(figure.axes[::2], figure.axes[1::2], ("shake_table", "exp_rths"), strict=True):
        time, desired = data[f"{run}/time_s"], data[f"{run}/interface_accel_desired_m_s2"]
        measured = data[f"{run}/interface_accel_measured_m_s2"]
        assert thinned_from(line_of(whole, BLACK), time, desired)
        assert thinned_from(line_of(whole, RUNS[run]), time, measured)
        assert whole.get_xlim() == (0.0, time[-1])
        t, v = line_of(close, RUNS[run])
        assert t[-1] - t[0] == pytest.approx(3.0, abs=0.02)
        assert np.abs(v).max() == pytest.approx(np.abs(desired).max(), rel=0.1)
        assert t[0] < time[np.argmax(np.abs(desired))] < t[-1]
        assert whole.get_ylabel() == "acceleration (m/s²)"
    assert figure.axes[0].get_title(loc="right") == "RMS error 12.3 mm/s²"
    assert figure.axes[2].get_title(loc="right") == "RMS error 0.700 mm/s²"


def test_kalman_shows_the_top_floor_before_and_after_the_filter(made_up, data, line_of):
    whole, close, difference, quiet = draw("kalman", made_up).axes
    time = data["exp_rths/time_s"]
    measured, filtered = (data[f"exp_rths/floor_accel_{kind}_m_s2"][-1] for kind in ("measured", "estimated"))
    assert thinned_from(line_of(whole, SKY), time, measured)
    assert thinned_from(line_of(whole, ORANGE), time, filtered)
    assert thinned_from(line_of(whole, PURPLE), time, data["exp_rths/truth/floor_accel_m_s2"][-1])
    assert thinned_from(line_of(difference, VERMILLION), time, 1e3 * (measured - filtered))
    assert difference.get_ylabel() == "difference (mm/s²)"
    assert whole.get_title(loc="left") == "(a) storey 3, EXP-RTHS"
    t, v = line_of(quiet, SKY)
    assert np.ptp(t) == pytest.approx(1.0, abs=0.02) and np.std(v) < 0.6 * np.std(line_of(close, SKY)[1])


def test_responses_show_every_run_in_every_storey(made_up, data, line_of):
    axes = draw("responses", made_up).axes
    for storey, ax in zip((3, 2, 1), axes[::2], strict=True):
        for run in ("sim", "sim_delay", "exp_rths"):
            values = data[f"{run}/abs_accel_m_s2"][storey - 1]
            assert thinned_from(line_of(ax, RUNS[run]), data[f"{run}/time_s"], values)
    titles = [ax.get_title(loc="left") for ax in axes[::2]]
    assert titles == ["(a) storey 3, on the table", "(c) storey 2, on the table", "(e) storey 1, interface"]


def test_errors_are_differences_in_the_test_band(made_up, data, line_of):
    figure = draw("errors", made_up)
    for run in ("shake_table", "exp_rths"):
        ax = by_title(figure, f"tracking, {'EXP-RTHS' if run == 'exp_rths' else 'shake table test'}")
        error = data[f"{run}/interface_accel_desired_m_s2"] - data[f"{run}/interface_accel_measured_m_s2"]
        t, v = line_of(ax, RUNS[run])
        expected = banded(error)[np.searchsorted(data[f"{run}/time_s"], t)]
        assert np.allclose(v, 1e3 * expected, atol=1e-6)
        assert np.abs(v).max() == pytest.approx(1e3 * np.abs(banded(error)).max())
        assert ax.get_ylabel() == "error (mm/s²)"
    for storey in (1, 2, 3):
        for run, name in (("sim_delay", "SIM-DELAY"), ("exp_rths", "EXP-RTHS")):
            ax = by_title(figure, f"storey {storey}, SIM − {name}")
            error = banded((data["sim/abs_accel_m_s2"] - data[f"{run}/abs_accel_m_s2"])[storey - 1])
            t, v = line_of(ax, RUNS[run])
            assert np.allclose(v, 1e3 * error[np.searchsorted(data["sim/time_s"], t)], atol=1e-6)
            assert v.max() == pytest.approx(1e3 * error.max())
    assert by_title(figure, "storey 2, SIM − SIM-DELAY").get_title(loc="right") == "RMS 160 mm/s²"


def test_the_error_of_a_diverged_sim_delay_is_drawn_up_to_its_end_and_its_response_is_left_out(tmp_path, line_of):
    import h5py

    path = write_result(tmp_path / "diverged.h5", runs=("sim", "sim_delay"))
    with h5py.File(path, "a") as file:
        values = file["sim_delay/abs_accel_m_s2"]
        values[:, 600:900] = 900.0
        values[:, 900:] = np.nan
        error = file["sim/abs_accel_m_s2"][0, :900] - values[0, :900]
        peak = np.abs(file["sim/abs_accel_m_s2"][2]).max()
    result = read_result(path)
    drawn = draw("errors", result)
    t, v = line_of(drawn.axes[-1], VERMILLION)
    known = np.isfinite(v)
    expected = banded(error)[np.round(t[known] * RATE).astype(int)]
    assert np.allclose(v[known], 1e3 * expected, atol=1e-3) and 880 / RATE < t[known].max() <= 899 / RATE
    figure = draw("responses", result)
    top = figure.axes[0].get_ylim()[1]
    assert peak < top < 1.2 * peak
    assert not any(line.get_color() == VERMILLION for ax in figure.axes for line in ax.lines)
    assert re.search(r"SIM-DELAY is \d+ times SIM: not drawn", figure.legends[0].get_texts()[-1].get_text())


@pytest.mark.parametrize(
    ("storeys", "floors", "shown"),
    [(1, 1, [1]), (4, 1, [4, 3, 2, 1]), (10, 2, [10, 8, 4, 1]), (30, 25, [30, 17, 5, 1])],
)
def test_a_tall_building_shows_at_most_four_storeys(tmp_path, storeys, floors, shown):
    runs = ("sim", "exp_rths") if storeys > floors else ("sim",)
    result = read_result(write_result(tmp_path / "tall.h5", runs=runs, storeys=storeys, floors=floors, n=400))
    titles = [ax.get_title(loc="left") for ax in draw("responses", result).axes[::2]]
    assert [int(title.split("storey ")[1].split(",")[0]) for title in titles] == shown


def test_one_column_holds_the_same_lines_below_each_other(made_up):
    one, two = draw("responses", made_up, "one"), draw("responses", made_up, "two")
    assert [one.get_figwidth() * 25.4, two.get_figwidth() * 25.4] == pytest.approx([84.0, 174.0])
    assert len(one.axes) == len(two.axes) and one.get_figheight() * 25.4 <= 235.0
    assert {ax.get_subplotspec().colspan.start for ax in one.axes} == {0}
    assert {ax.get_subplotspec().colspan.start for ax in two.axes} == {0, 1}
