"""Marks of the figures of merit, limits, margins and step times are those of the file."""

import h5py
import numpy as np
import pytest
from made_up_results import CAUSES, PREDICTED, RATE, write_result

from rths_cli.files.result_reader import read_result
from rths_cli.report.case_metric_tables import CAUSES as WORDS
from rths_cli.report.figures import NotDrawn, draw
from rths_cli.report.figures.limit_bars import exceedance

BLACK, BLUE, VERMILLION, GREEN, ORANGE = "#000000", "#0072B2", "#D55E00", "#009E73", "#E69F00"


def marks(ax, color):
    """Return values by label of the marks of a colour."""
    line = next(line for line in ax.lines if line.get_color() == color and line.get_linestyle() == "None")
    name = ax.yaxis.get_major_formatter()  # labels are hidden where axes share them
    labels = [name(place, place) for place in range(len(line.get_xdata()))]
    return dict(zip(labels, np.asarray(line.get_xdata(), float), strict=True))


@pytest.mark.parametrize("width", ["one", "two"])
def test_error_by_cause_of_tracking_and_storeys(made_up, data, width):
    axes = [ax for ax in draw("error_budget", made_up, width).axes if ax.get_visible()]
    titles = [ax.get_title(loc="left") for ax in axes]
    assert titles == ["(a) tracking", "(b) storey 1", "(c) storey 2", "(d) storey 3"]
    for column, ax in enumerate(axes):
        what = "rms_error_{}_m_s2" if column else "tracking_rms_{}_m_s2"
        for group, color in (("check", ORANGE), ("budget", BLUE)):
            for cause in CAUSES if group == "budget" else PREDICTED:
                value = np.atleast_1d(data[f"metrics/{group}/{what.format(cause)}"])[max(column - 1, 0)]
                drawn = marks(ax, color)[WORDS[cause]]
                assert drawn == pytest.approx(1e3 * value) if value > 0.0 else np.isnan(drawn)
        whole = {ORANGE: "check", BLUE: "exp_rths"}
        for color, group in whole.items():
            name = "rms_error_m_s2" if column else "tracking_rms_m_s2"
            value = np.atleast_1d(data[f"metrics/{group}/{name}"])[max(column - 1, 0)]
            assert marks(ax, color)["together"] == pytest.approx(1e3 * value)
        assert ax.get_xlabel() == "RMS error (mm/s²)" and ax.get_xscale() == "log"


def test_peaks_in_percent_of_their_limits(made_up, data):
    ax = draw("limits", made_up).axes[0]
    predicted, hybrid, table = (marks(ax, color) for color in (ORANGE, BLUE, GREEN))
    for label, share in (("command\n(10 V)", 30.0), ("force\n(445 N)", 100.0 * 40.0 / 445.0)):
        assert predicted[label] == pytest.approx(share)
    for run, found in (("exp_rths", hybrid), ("shake_table", table)):
        channels = ("interface_accel_measured_m_s2", "floor_accel_measured_m_s2")
        loudest = max(np.abs(data[f"{run}/{name}"]).max() for name in channels)
        assert found["command\n(10 V)"] == pytest.approx(10.0 * np.abs(data[f"{run}/command_v"]).max())
        assert found["acceleration\n(45 m/s²)"] == pytest.approx(100.0 * loudest / 45.0)
        moved = np.abs(data[f"{run}/truth/table_disp_m"]).max()
        assert found["displacement\n(0.079 m)"] == pytest.approx(100.0 * moved / 0.079)
        assert np.isnan(found["velocity\n(1 m/s)"])
    assert [line.get_xdata()[0] for line in ax.lines if line.get_color() == VERMILLION] == [100.0]


def test_margins_with_their_values_and_those_that_are_infinite(made_up):
    axes = draw("limits", made_up).axes[1:]
    shown = {ax.get_title(loc="left")[4:]: marks(ax, BLACK) for ax in axes}
    assert shown["delay margin"] == pytest.approx({"hybrid loop": 6.8, "feedback": 6.8})
    assert shown["gain reduction margin"]["hybrid loop"] == pytest.approx(1.6)
    assert np.isnan(shown["gain reduction margin"]["feedback"])
    assert [text.get_text() for text in axes[1].texts] == ["1.6", "none found"]


def test_steps_in_real_time_show_lateness_exchange_and_lost_samples(tmp_path):
    path = write_result(tmp_path / "live.h5", kind="udp", live=True)
    with h5py.File(path, "r+") as file:
        file["exp_rths/timing/lost"][7] = 3  # samples of another instant, brought to the right one
    figure = draw("timing", read_result(path))
    with h5py.File(path) as file:
        timing = {name: node[()] for name, node in file["exp_rths/timing"].items()}
    history, share = figure.axes[2:]
    for name, color in (("compute_s", BLUE), ("late_s", ORANGE), ("exchange_s", GREEN)):
        drawn = next(line for line in history.lines if line.get_color() == color)
        assert np.max(drawn.get_ydata()) == pytest.approx(1e6 * timing[name].max())
        longest, part = next(line for line in share.lines if line.get_color() == color).get_data()
        for duration, percent in list(zip(longest, part, strict=True))[::50]:
            assert percent == pytest.approx(100.0 * np.mean(1e6 * timing[name] >= duration * (1 - 1e-12)))
    lost = next(line for line in history.lines if line.get_marker() == "|")
    assert np.array_equal(lost.get_xdata(), timing["time_s"][np.isin(timing["lost"], (1, 2))])
    assert history.get_title(loc="right") == "3 steps without samples"
    limits = [line.get_ydata()[0] for line in history.lines if line.get_color() == VERMILLION and line is not lost]
    assert limits[0] == pytest.approx(1e6 / RATE)


def test_a_virtual_table_s_steps_are_not_drawn(made_up):
    with pytest.raises(NotDrawn, match="a run on a virtual table has no real time to keep"):
        draw("timing", made_up)


def test_exceedance_of_a_few_durations():
    longest, share = exceedance(np.array([3.0, np.nan, 1.0, 2.0, 2.0]))
    assert longest.tolist() == [3.0, 2.0, 2.0, 1.0] and share.tolist() == [0.25, 0.5, 0.75, 1.0]


def test_a_run_without_prediction_or_budget_has_no_error_by_cause(tmp_path):
    result = read_result(write_result(tmp_path / "sim.h5", runs=("sim",)))
    with pytest.raises(NotDrawn, match="no error by cause in the result"):
        draw("error_budget", result)
