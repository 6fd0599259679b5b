"""The figure of a sweep: the median and the range of the seeds over one key, a heat map over two."""

from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Figure, Sweep
from rths_cli.report.figures import NotDrawn, write_sweep_figures
from rths_cli.report.figures.study_figures import sweep_figure

STOREYS, TRACKING, MARGIN = "exp_rths.rms_error_m_s2", "exp_rths.tracking_rms_m_s2", "check.delay_margin_s"


def made(varied, seeds, statuses):
    """Return a sweep whose run k (from 1) errs by 10 k mm/s^2 in storey 1, by 5 k in storey 2; margins of k ms."""
    runs = np.arange(1.0, len(statuses) + 1) / 1000.0
    figures = {
        TRACKING: Figure(runs, "m/s^2", "t"),
        STOREYS: Figure(np.outer(runs, [10.0, 5.0]), "m/s^2", "s"),
        MARGIN: Figure(runs, "s", "m"),
    }
    attributes = {"case_name": "quake", "rig": "bench"}
    count = len(statuses)
    return Sweep(attributes, "", "", seeds, varied, np.arange(count) % seeds, {"status": statuses}, figures)


@pytest.fixture
def scaled():
    """Return a sweep of three scalings with two seeds each; a run at 0.2 was refused."""
    scaling = tuple(value for value in (0.3, 0.1, 0.2) for _ in range(2))
    return made({"table.scaling": scaling}, 2, ("complete",) * 4 + ("refused", "complete"))


def test_one_key_is_a_line_with_the_range_of_the_seeds(scaled):
    figure = sweep_figure(scaled, "one")
    (ax,) = figure.axes
    middle, failed = ax.lines
    assert np.asarray(middle.get_xdata()) == pytest.approx([0.1, 0.2, 0.3])
    assert np.asarray(middle.get_ydata()) == pytest.approx([35.0, 60.0, 15.0])  # of runs 3 and 4, 6, 1 and 2
    band = ax.collections[0].get_paths()[0].vertices
    ends = {x: (band[band[:, 0] == x, 1].min(), band[band[:, 0] == x, 1].max()) for x in (0.1, 0.3)}
    assert ends == {0.1: pytest.approx((30.0, 40.0)), 0.3: pytest.approx((10.0, 20.0))}
    assert np.asarray(failed.get_xdata()).tolist() == [0.2]
    assert ax.get_xlabel() == "scaling" and ax.get_ylabel() == "EXP-RTHS: RMS error,\nworst storey (mm/s²)"
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["range of the seeds", "median of the seeds", "a run was refused, aborted or failed"]
    assert "quake, EXP-RTHS; virtual shake table bench; 2 seeds" in figure.get_suptitle()
    assert sweep_figure(scaled, "one", headed=False).get_suptitle() == ""


def test_the_metric_and_the_storey_are_chosen(scaled):
    second = sweep_figure(scaled, "two", f"{STOREYS}[2]").axes[0]
    assert np.asarray(second.lines[0].get_ydata()) == pytest.approx([17.5, 30.0, 7.5])
    assert second.get_ylabel() == "EXP-RTHS: RMS error,\nstorey 2 (mm/s²)"
    margin = sweep_figure(scaled, "two", MARGIN).axes[0]
    assert np.asarray(margin.lines[0].get_ydata()) == pytest.approx([3.5, 5.5, 1.5]), "a refused run was checked, too"
    assert margin.get_ylabel() == "predicted: delay margin (ms)"
    for metric, fault in (
        ("check.x", "is not in the sweep; known: exp_rths.tracking"),
        (f"{STOREYS}[3]", "name a storey from 1 to 2"),
        (f"{STOREYS}[two]", "name a storey from 1 to 2"),
        (f"{MARGIN}[1]", "is one number, not one per storey"),
    ):
        with pytest.raises(InputError, match=fault):
            sweep_figure(scaled, "one", metric)


def test_words_stand_beside_each_other_and_are_not_joined():
    sweep = made({"controller": ("FF", "FF+FB")}, 1, ("complete",) * 2)
    ax = sweep_figure(sweep, "one").axes[0]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["FF", "FF+FB"]
    assert ax.lines[0].get_linestyle() == "None" and not ax.collections


def test_equal_ratios_have_a_logarithmic_axis():
    for values, scale in (((1.0, 10.0, 100.0), "log"), ((1.0, 2.0, 3.0), "linear")):
        assert sweep_figure(made({"gain": values}, 1, ("complete",) * 3), "one").axes[0].get_xscale() == scale


def test_two_keys_are_a_heat_map_with_their_numbers():
    varied = {"table.delay_s": (0.1, 0.1, 0.2, 0.2), "method": ("paper", "best", "paper", "best")}
    sweep = made(varied, 1, ("complete", "complete", "aborted", "complete"))
    ax, bar = sweep_figure(sweep, "one").axes
    (image,) = ax.images
    table = np.ma.filled(image.get_array(), np.nan)
    assert table[0] == pytest.approx([10.0, 20.0]) and np.isnan(table[1, 0]) and table[1, 1] == pytest.approx(40.0)
    assert [text.get_text() for text in ax.texts] == ["10.0", "20.0", "none", "40.0"]
    assert [label.get_text() for label in ax.get_xticklabels()] == ["paper", "best"]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["0.1", "0.2"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("method", "delay (s)")
    assert bar.get_ylabel() == "EXP-RTHS: RMS error,\nworst storey (mm/s²)"


def test_other_numbers_of_keys_are_left_out_with_a_reason(scaled, tmp_path):
    none = made({}, 2, ("complete", "complete"))
    nothing = made({"a": (1, 2)}, 1, ("refused", "refused"))
    told = []
    files = [(Path(f"{name}.h5"), sweep) for name, sweep in zip("acd", (none, nothing, scaled), strict=True)]
    paths = write_sweep_figures(files, tmp_path, "svg", "one", told.append)
    assert [path.name for path in paths] == ["d-sweep.svg"] == [path.name for path in tmp_path.iterdir()]
    assert told == [
        "a.h5: figure sweep is left out: it varies 0 keys; a figure shows one or two",
        "c.h5: figure sweep is left out: no run has a finite EXP-RTHS: RMS error, worst storey",
    ]
    with pytest.raises(NotDrawn):
        sweep_figure(none, "one")
    first = paths[0].read_bytes()
    assert write_sweep_figures(files, tmp_path, "svg", "one", told.append)[0].read_bytes() == first
