"""Figures of a study of hand-made rows: tornado, parallel coordinates, Sobol indices, boundary of stability."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from campaigns.synthetic_study import ishigami

from rths_cli.errors import InputError
from rths_cli.files.sweep_file import Figure, Sweep
from rths_cli.report.figures import NotDrawn
from rths_cli.report.figures.study_figures import (
    has_boundary,
    parallel,
    sobol,
    stability,
    sweep_figure,
    tornado,
    value_name,
)
from rths_cli.report.sweep_page import indices_document, indices_of, indices_section
from rths_cli.report.to_text import text as printed
from rths_cli.studies.study_plan import unit_samples

STOREYS, TRACKING, RADIUS = "exp_rths.rms_error_m_s2", "exp_rths.tracking_rms_m_s2", "check.spectral_radius"


def made(varied, errors, statuses=None, more=None, study=""):
    """Return a sweep with errors (n,) in mm/s^2 of the worst storey."""
    count = len(errors)
    figures = {
        TRACKING: Figure(np.asarray(errors) / 1e3, "m/s^2", "t"),
        STOREYS: Figure(np.outer(np.asarray(errors) / 1e3, [1.0, 0.5]), "m/s^2", "s"),
        **(more or {}),
    }
    texts = {"status": statuses or ("complete",) * count}
    about = {"case_name": "quake", "rig": "bench"}
    return Sweep(about, "", "", 1, varied, np.zeros(count, int), texts, figures, study)


def test_a_tornado_has_the_medians_at_both_ends_of_each_key_the_longest_bar_on_top():
    weak, strong = np.tile([0.0, 1.0, 2.0], 3), np.repeat([1.0, 2.0, 3.0], 3)
    figure = tornado(made({"weak": tuple(weak), "strong": tuple(strong)}, weak + 10 * strong), "one")
    (ax,) = figure.axes
    assert [text.get_text() for text in ax.get_yticklabels()] == ["weak", "strong"]
    ends = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in ax.patches]
    assert ends == [pytest.approx((20.0, 22.0)), pytest.approx((11.0, 31.0))]
    assert [text.get_text() for text in ax.texts] == ["0", "2", "1", "3"]
    with pytest.raises(NotDrawn, match="2 varied keys or more"):
        tornado(made({"weak": tuple(weak)}, weak), "one")


def test_parallel_coordinates_go_from_each_key_to_the_metric_and_unfinished_points_end_before():
    sweep = made({"a": (0.0, 1.0, 2.0), "b": ("x", "y", "x"), "c": (3.0, 3.0, 5.0)}, [1.0, 2.0, 3.0],
                 ("complete", "refused", "complete"))  # fmt: skip
    unknown, known = parallel(sweep, "two").axes[0].collections[:2]
    (grey,) = unknown.get_segments()
    assert grey == pytest.approx(np.array([[0, 0.5], [1, 1.0], [2, 0.0]]))
    first, last = known.get_segments()
    assert first == pytest.approx(np.array([[0, 0.0], [1, 0.0], [2, 0.0], [3, 0.0]]))
    assert last == pytest.approx(np.array([[0, 1.0], [1, 0.0], [2, 1.0], [3, 1.0]]))


@pytest.mark.campaign
@pytest.mark.parametrize(("width", "keys"), [("one", 3), ("one", 6), ("one", 12), ("two", 6), ("two", 12)])
def test_no_text_of_parallel_coordinates_lies_on_another(width, keys):
    rng = np.random.default_rng(1)
    varied = {
        f"table.imperfections.k{k}.gain_change_between_runs": tuple(1e-3 * rng.random(20)) for k in range(keys - 1)
    }
    varied["record"] = ("./records/a_long_folder/el_centro.csv", "./records/b.csv") * 10
    figure = parallel(made(varied, rng.random(20) * 1000), width)
    figure.canvas.draw()
    (ax,) = figure.axes
    boxes = [text.get_window_extent() for text in (*ax.texts, *ax.get_xticklabels())]
    assert len(boxes) == 3 * (keys + 1) and all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in boxes)
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_labels_of_a_tornado_stay_within_its_axes():
    names = ("./records/a_long_folder_name/a_long_record_of_1994.csv", "./records/b.csv")
    figure = tornado(made({"record": names * 2, "a": (1.0, 1.0, 2.0, 2.0)}, [1.0, 2.0, 3.0, 4.0]), "one")
    figure.canvas.draw()
    (ax,) = figure.axes
    assert {text.get_text() for text in ax.texts} == {"a_long_record_of_…", "b", "1", "2"}
    box = ax.get_window_extent()
    assert all(box.x0 <= (one := text.get_window_extent()).x0 and one.x1 <= box.x1 for text in ax.texts)


def test_the_boundary_is_where_the_spectral_radius_is_one():
    delay, mass = (each.ravel() for each in np.meshgrid(np.linspace(1, 3, 5), np.linspace(0, 1, 5)))
    radius = 0.8 + 0.1 * delay
    statuses = tuple(np.where(radius > 1.05, "refused", np.where(radius > 1.0, "aborted", "complete")))
    sweep = made({"delay": tuple(delay), "mass": tuple(mass)}, delay, statuses, {RADIUS: Figure(radius, "1", "r")})
    ax = stability(sweep, "one").axes[0]
    line = ax.collections[1].get_paths()[0].vertices
    assert line[:, 1] == pytest.approx(2.0) and np.ptp(line[:, 0]) == pytest.approx(1.0)
    shown = {one.get_label(): len(one.get_xdata()) for one in ax.lines}
    assert shown["simulated: reached the end"] == 15 and shown["simulated: stopped by a limit"] == 5
    assert shown["refused by the check, not simulated"] == 5
    safe = replace(sweep, figures=sweep.figures | {RADIUS: Figure(radius / 2, "1", "r")})
    assert has_boundary(sweep) and not has_boundary(safe)
    with pytest.raises(NotDrawn):
        stability(safe, "one")


def test_two_sampled_keys_are_dots_and_a_grid_a_map():
    rng = np.random.default_rng(3)
    first, second = rng.uniform(size=(2, 12))
    errors = np.where(np.arange(12) == 4, np.nan, 1.0 + first)
    figure = sweep_figure(made({"a": tuple(first), "b": tuple(second)}, errors), "one")
    (dots,) = figure.axes[0].collections
    known = np.isfinite(errors)
    assert np.array_equal(dots.get_offsets(), np.column_stack([second, first])[known])
    assert np.array_equal(dots.get_array(), 1e3 * errors[known] / 1e3)
    (crosses,) = figure.axes[0].lines
    assert (crosses.get_xdata(), crosses.get_ydata()) == (second[4:5], first[4:5])
    grid = {"a": (1.0, 1.0, 2.0, 2.0), "b": (3.0, 4.0, 3.0, 4.0)}
    assert sweep_figure(made(grid, [1.0, 2.0, 3.0, 4.0]), "one").axes[0].images


@pytest.fixture
def sampled() -> Sweep:
    """Return a study of Ishigami's function, sampled for Sobol indices."""
    known = ishigami()
    rows = -np.pi + 2 * np.pi * unit_samples("sobol_indices", 1024, 3, 0)
    keys = ("one", "two", "three")
    axes = "".join(f"  {key}: {{distribution: uniform, low: -3, high: 3}}\n" for key in keys)
    study = f"case: x\naxes:\n{axes}samples: {{method: sobol_indices, count: 1024}}\n"
    return made(
        {key: tuple(column) for key, column in zip(keys, rows.T, strict=True)}, 20 + known.of(rows), study=study
    )


def test_sobol_indices_are_drawn_and_printed_as_they_are_estimated(sampled):
    _, found = indices_of(sampled)
    assert found.first == pytest.approx(ishigami().first, abs=0.1)
    order = np.argsort(found.total)
    first, total = (each[0].get_xdata() for each in sobol(sampled, "one").axes[0].containers)
    assert first == pytest.approx(found.first[order]) and total == pytest.approx(found.total[order])
    text = printed([indices_section(sampled)])
    assert f"{found.total[1]:.4f} +- {found.total_error[1]:.4f}" in text
    assert indices_document(sampled)[f"{STOREYS}[1]"]["two"]["total"] == pytest.approx(found.total[1])
    other = replace(sampled, study_yaml="")
    assert indices_section(other) == [] == list(indices_document(other))


def test_indices_need_every_run_and_no_other_key(sampled):
    lost = replace(sampled, texts={"status": ("refused", *sampled.texts["status"][1:])})
    assert "1 of 5120 have none" in printed([indices_section(lost)])
    with pytest.raises(NotDrawn, match="1 of 5120 have none"):
        sobol(lost, "one")
    other = replace(sampled, varied=sampled.varied | {"method": ("best",) * 5120})
    with pytest.raises(InputError, match="also varies method"):
        indices_of(other)


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("{kind: FF+FB}", "FF+FB"),
        ("{kind: lead, lead_s: 0.01}", "lead, lead_s 0.01"),
        ("{file: records/pulse.csv}", "pulse"),
        ("{extends: three_storey, numerical: {law: null}}", "three_storey, num…"),
    ],
)
def test_a_value_that_is_a_mapping_is_told_in_words(value: str, told: str) -> None:
    assert value_name(value) == told
