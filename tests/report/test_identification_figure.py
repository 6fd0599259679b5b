"""The figure of an identification: its axes hold the data, its files are the same twice, a refusal is a sentence."""

import errno
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from made_up_identification import ABOUT, MODEL, identification, specimen
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.experiment.identify_output import FIGURE_FORMATS
from rths_cli.numerics.lti import StateSpace, staircase
from rths_cli.report.identification_figure import METADATA, figure, transmissibility, write_figure


@pytest.fixture(scope="module")
def found():
    return identification()


@pytest.fixture(scope="module")
def axes(found):
    drawn = figure(found, ABOUT)
    drawn.draw_without_rendering()
    return drawn.axes


def line(ax, label):
    """Return frequencies and values of a line."""
    return next(drawn for drawn in ax.lines if drawn.get_label() == label).get_data()


def test_magnitude_of_data_model_and_noise(found, axes):
    ax, table = axes[0], found.frfs[0]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log") and "m/s$^2$/V" in ax.get_ylabel()
    measured, model = line(ax, "measured"), line(ax, "model, 5 poles, 4 zeros")
    assert np.array_equal(measured, (table.frequency_hz, np.abs(table.response)))
    assert np.allclose(model[1], np.abs(MODEL.sampled_response(table.frequency_hz)))
    assert np.array_equal(line(ax, "noise floor")[1], found.noise_floors[0])
    silent = figure(identification(noise_floors=(0.0 * table.frequency_hz, None, None)), ABOUT).axes[0]
    assert len(silent.lines) == 2, "a channel that showed one code at rest has no noise floor to draw"


@pytest.mark.parametrize(("sign", "start"), [(1.0, 180.0), (-1.0, 0.0)])
@pytest.mark.parametrize("delay_s", [-0.06, 0.02])
def test_phase_is_unwrapped_and_starts_at_one_branch(found, sign, start, delay_s):
    """It starts near half a turn (command and acceleration at 0 Hz), whichever side of it the first line is on."""
    model = replace(MODEL, gain=sign * MODEL.gain, delay_s=delay_s)
    f = found.frfs[0].frequency_hz
    table = replace(found.frfs[0], response=model.sampled_response(f) * (1.0 + 0.05 * np.exp(-9j * f)))
    drawn = figure(identification(frfs=(table, *found.frfs[1:]), best=model), ABOUT).axes[1].lines
    for phase, response in zip(drawn, (table.response, model.sampled_response(f)), strict=True):
        turns = (phase.get_ydata() - np.degrees(np.angle(response))) / 360.0
        assert np.allclose(turns, np.round(turns), atol=1e-9) and len(np.unique(np.round(turns))) > 1
        assert np.abs(np.diff(phase.get_ydata())).max() < 90.0
        assert phase.get_ydata()[0] == pytest.approx(start, abs=30.0)


def test_coherence_of_every_channel(found, axes):
    for channel, frf in zip(found.channels, found.frfs, strict=True):
        assert np.array_equal(line(axes[2], channel.name), (frf.frequency_hz, frf.coherence))
    assert axes[2].get_ylim()[0] == 0.0


def test_residual_with_limits_scatter_and_the_verdict_s_band(found, axes):
    ax, table = axes[3], found.frfs[0]
    f = table.frequency_hz
    bottom = ax.get_ylim()[0]
    residual = 100.0 * np.abs(MODEL.sampled_response(f) / table.response - 1.0)
    assert np.allclose(line(ax, "each line")[1], residual.clip(min=bottom)) and np.median(residual) > bottom
    bars = [d for d in ax.lines if len(d.get_xdata()) == 2 and d.get_linewidth() > 2.0]
    assert [list(bar.get_xdata()) for bar in bars] == [[0.7, 2.0], [2.0, 5.0]]
    assert [bar.get_ydata()[0] for bar in bars] == pytest.approx([100.0 * band.rms for band in found.residuals])
    limits = [d.get_ydata()[0] for d in ax.lines if d.get_linestyle() == "--"]
    assert limits == [1.0, 3.0] and {"1 % rms", "3 % largest"} <= {text.get_text() for text in ax.texts}
    usable = next(patch for patch in ax.patches if patch.get_label() == "fit for feedforward, 0.7 to 58.7 Hz")
    assert [usable.get_x(), usable.get_x() + usable.get_width()] == pytest.approx([0.7, 58.7])
    (scatter,) = (shape for shape in ax.collections if "scatter" in shape.get_label())
    top = scatter.get_paths()[0].vertices[:, 1].max()
    assert top == pytest.approx(100.0 * np.sqrt(2.0) * table.relative_error.max())


def test_floors_over_table_measured_and_identified(found, axes):
    """The staircase alias is no motion of the table: it must not stand under the floors'."""
    ax, table = axes[4], found.frfs[0]
    f = table.frequency_hz
    moved = table.response - MODEL.ripple_m_s2_per_v * staircase(f, 1, MODEL.dt_s)
    for index, name in enumerate(("floor_2", "floor_3")):
        assert np.allclose(line(ax, f"measured, {name}")[1], np.abs(found.frfs[index + 1].response / moved))
        identified = np.abs(transmissibility(found.specimen.specimen, f)[index])
        assert np.allclose(line(ax, f"identified, {name}")[1], identified)
    marks = [d.get_xdata()[0] for d in ax.lines if d.get_linestyle() == "--" and d.get_color() == "#D55E00"]
    assert marks == [3.2, 8.4] and [text.get_text() for text in ax.texts] == ["3.200 Hz", "8.400 Hz"]


def test_transmissibility_against_the_state_space_solution():
    """Oracle: states displacement and velocity relative to the table; output relative plus table acceleration."""
    part = specimen().specimen
    n, f = 2, np.geomspace(0.1, 50.0, 60)
    M = np.linalg.inv(np.diag(part.masses_kg))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-M @ part.K, -M @ part.C]])
    system = StateSpace(A, np.vstack([np.zeros((n, 1)), -np.ones((n, 1))]), A[n:], np.zeros((n, 1)))
    assert np.allclose(transmissibility(part, f), system.response(f)[:, 0], rtol=1e-10)


def test_axes_show_all_data_and_legends_cover_none(axes):
    low, high = axes[0].get_xlim()
    assert (low, high) == (0.5, pytest.approx(54.8))
    for ax in axes[:4]:
        bottom, top = ax.get_ylim()
        for drawn in ax.lines:
            values = np.asarray(drawn.get_ydata())
            assert bottom <= values.min() and values.max() <= top
    for ax in axes:
        if legend := ax.get_legend():
            assert not any(legend.get_window_extent().overlaps(other.bbox.padded(-1.0)) for other in axes)


def test_heading_says_rig_virtual_verdict_and_source():
    found = identification(reasons=("the fit misses its limit " * 9,))
    drawn = figure(found, replace(ABOUT, rig="a$b$c_{\\x"))
    drawn.draw_without_rendering()
    title, verdict, source = (text.get_text() for text in drawn.texts)
    assert title == "Virtual table a\\$b\\$c_{\\x, identified from its channels" and source == ABOUT.source
    assert verdict.startswith("rejected: the fit misses") and verdict.endswith(" ...")
    assert drawn.axes[3].patches[0].get_label() == "keeps its limits, 0.7 to 58.7 Hz"
    extent = drawn.texts[1].get_window_extent()
    assert extent.x1 < drawn.bbox.x1


def test_a_table_without_floors_has_four_axes(found):
    bare = identification(frfs=found.frfs[:1], channels=found.channels[:1], specimen=None, free_vibration=None)
    drawn = figure(bare, ABOUT)
    drawn.draw_without_rendering()
    assert len(drawn.axes) == 4 and drawn.axes[3].get_xlabel() == "frequency (Hz)"


@pytest.mark.campaign
@parametrize_first(1, ("suffix", "start"), [(".svg", b"<?xml"), (".png", b"\x89PNG"), (".PDF", b"%PDF")])
def test_the_same_identification_gives_the_same_bytes(found, tmp_path, monkeypatch, suffix, start):
    """Neither the date nor the user's own matplotlib settings show, and these are left as they were."""
    one, other = tmp_path / f"one{suffix}", tmp_path / f"other{suffix}"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000")
    write_figure(found, ABOUT, one)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1500000000")
    monkeypatch.setitem(matplotlib.rcParams, "lines.linestyle", "--")
    monkeypatch.setitem(matplotlib.rcParams, "svg.hashsalt", "mine")
    before = dict(matplotlib.rcParams)
    write_figure(found, ABOUT, other)
    assert one.read_bytes() == other.read_bytes() and one.read_bytes().startswith(start)
    assert dict(matplotlib.rcParams) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([one.name, other.name])


@pytest.mark.campaign
def test_a_file_that_cannot_be_written_is_one_sentence_and_leaves_nothing(found, tmp_path):
    (tmp_path / "taken.svg").mkdir()
    for path, words in (("no/x.svg", "No such file or directory"), ("taken.svg", "Is a directory")):
        with pytest.raises(InputError) as caught:
            write_figure(found, ABOUT, tmp_path / path)
        assert caught.value.faults == (
            f"{tmp_path / path}: cannot write the figure: {words}; choose another file",
        )  # fmt: skip
    with pytest.raises(InputError, match=r"x\.jpg: a figure's file name must end in \.png, \.svg or \.pdf$"):
        write_figure(found, ABOUT, tmp_path / "x.jpg")
    assert [path.name for path in tmp_path.iterdir()] == ["taken.svg"]


@pytest.mark.campaign
def test_a_full_disk_leaves_the_figure_that_was_there(found, tmp_path, monkeypatch):
    path = tmp_path / "x.svg"
    path.write_text("before")

    def full(source, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(InputError, match=r"x\.svg: cannot write the figure: No space left on device; choose another"):
        write_figure(found, ABOUT, path)
    assert path.read_text() == "before" and list(tmp_path.iterdir()) == [path]


def test_the_formats_that_are_asked_for_are_those_that_can_be_written():
    assert tuple(METADATA) == FIGURE_FORMATS


@pytest.mark.campaign
def test_the_page_needs_no_matplotlib_and_the_figure_no_pyplot():
    code = """
import sys
import rths_cli.report.identification_page, rths_cli.report.identification_figure
assert not [name for name in sys.modules if name.startswith("matplotlib")]
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from made_up_identification import ABOUT, identification
from rths_cli.report.identification_figure import figure
figure(identification(), ABOUT)
assert "matplotlib.figure" in sys.modules and "matplotlib.pyplot" not in sys.modules
"""
    helpers = str(Path(__file__).parents[1] / "helpers")
    done = subprocess.run([sys.executable, "-c", code, helpers], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
