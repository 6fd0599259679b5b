"""Files of figures: the same bytes twice, small, nothing cut, "virtual" where the table is, reasons for what is not."""

import itertools
import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import h5py
import matplotlib
import numpy as np
import pytest
from made_up_results import write_result
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.files.result_reader import read_result
from rths_cli.findings import Finding, as_json, stated
from rths_cli.report.figures import NotDrawn, draw, figure_names, write, write_figures

HERE = Path(__file__).parent
VIRTUAL = [
    name for name in figure_names() if name not in ("timing", "part_values")
]  # what a run on a virtual table has
OF_SIM = ["responses", "profiles", "hysteresis", "ground_motion"]
AGAIN = """
import sys
from pathlib import Path
from rths_cli.files.result_reader import read_result
from rths_cli.report.figures import write_figures
short, folder = map(Path, sys.argv[1:])
for form in ("svg", "pdf", "png"):
    write_figures([read_result(short)], folder, form, "one", lambda _: None)
assert "matplotlib.pyplot" not in sys.modules
"""


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """Return a result of SIM alone."""
    return read_result(write_result(tmp_path_factory.mktemp("short") / "sim.h5", runs=("sim",), n=300))


@pytest.fixture(scope="module")
def tall(tmp_path_factory):
    """Return a long result of a tall building."""
    return read_result(write_result(tmp_path_factory.mktemp("tall") / "tall.h5", storeys=30, n=6_000))


@pytest.fixture(scope="module")
def written(tall, short, tmp_path_factory):
    """Return the folder with all figures of a long record as SVG, and some as PDF and PNG."""
    folder, told = tmp_path_factory.mktemp("written"), []
    paths = write_figures([tall], folder, "svg", "two", told.append)
    assert [path.name for path in paths] == [f"tall-{name}.svg" for name in VIRTUAL]
    assert told == [f"{tall.path}: figure timing is left out: a run on a virtual table has no real time to keep"]
    for form in ("svg", "pdf", "png"):
        write_figures([short], folder, form, "one", told.append)
    return folder


def texts(figure):
    return [text.get_text() for text in figure.findobj(matplotlib.text.Text)]


def test_names_are_those_of_the_issue():
    assert {"table_response", "tracking", "kalman", "responses", "errors", "spectra"} < set(figure_names())
    assert {"delay_and_gain", "error_budget", "limits", "timing"} < set(figure_names())


@pytest.mark.campaign
def test_another_process_with_other_settings_writes_the_same_bytes(written, short, tmp_path):
    (tmp_path / "matplotlibrc").write_text("font.size: 20\nlines.linestyle: --\nsvg.hashsalt: other\n")
    environment = os.environ | {"PYTHONHASHSEED": "7", "SOURCE_DATE_EPOCH": "1000000000"}
    environment |= {"MATPLOTLIBRC": str(tmp_path), "TZ": "Asia/Tokyo"}
    again = tmp_path / "again"
    command = [sys.executable, "-c", AGAIN, str(short.path), str(again)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    ours, theirs = ({path.name: path.read_bytes() for path in where.glob("sim-*")} for where in (written, again))
    assert len(ours) == len(OF_SIM) * 3
    assert [name for name in ours if ours[name] != theirs.get(name)] == []


@pytest.mark.campaign
def test_files_are_what_they_say_small_and_with_their_fonts(written):
    starts = {".svg": b"<?xml", ".pdf": b"%PDF", ".png": b"\x89PNG"}
    for path in written.iterdir():
        image = path.read_bytes()
        assert image.startswith(starts[path.suffix]) and b"virtual" in image
        assert len(image) < 300_000, path.name
        if path.suffix == ".pdf":
            assert b"/FontFile2" in image and b"/Type3" not in image
        if path.suffix == ".svg":
            assert b"<text" not in image and re.search(rb'width="(493|238)\.\d+pt"', image[:500])


@pytest.mark.campaign
@parametrize_first(1, "width", ["one", "two"])
@parametrize_first(4, "name", VIRTUAL)
def test_every_figure_says_virtual_and_nothing_is_cut(made_up, name, width):
    figure = draw(name, made_up, width)
    assert "virtual shake table bench" in " ".join(texts(figure)).replace("\n", " ")
    figure.draw_without_rendering()
    assert overlapping(figure) == []
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert drawn.x0 > -0.01 and drawn.y0 > -0.01 and drawn.x1 < width + 0.01 and drawn.y1 < height + 0.01


def overlapping(figure):
    """Return pairs of titles and names of axes that overlap each other."""
    named = {ax.get_title(loc=place) for ax in figure.axes for place in ("left", "center", "right")}
    named |= {text for ax in figure.axes if ax.get_visible() for text in (ax.get_xlabel(), ax.get_ylabel())} - {""}
    found = [text for text in figure.findobj(matplotlib.text.Text) if text.get_text() in named - {""}]
    boxes = [(text.get_text(), text.get_window_extent()) for text in found if text.get_visible()]
    return [(a, b) for (a, one), (b, other) in itertools.combinations(boxes, 2) if one.overlaps(other)]


@pytest.mark.campaign
@pytest.mark.parametrize("name", VIRTUAL)
def test_a_figure_without_header_holds_no_word_on_case_and_table(made_up, name):
    figure = draw(name, made_up, "one", header="none")
    assert figure.get_suptitle() == "" and not any("bench" in text for text in texts(figure))
    assert len(figure.axes) == len(draw(name, made_up, "one").axes)


@pytest.mark.campaign
def test_a_measured_table_is_not_called_virtual(tmp_path):
    result = read_result(write_result(tmp_path / "real.h5", kind="udp", n=600))
    for name in [*VIRTUAL, "timing"]:
        assert not any("virtual" in text for text in texts(draw(name, result)))


def test_parameters_of_a_law_that_adapts_are_drawn_as_changes_from_their_start(tmp_path, monkeypatch):
    path = write_result(tmp_path / "adapts.h5", n=600)
    with pytest.raises(NotDrawn, match="no part of the step logs values of its own"):
        draw("part_values", read_result(path))
    with h5py.File(path, "r+") as file:
        run = file["exp_rths"]
        n = len(run["time_s"])
        values = np.vstack([np.linspace(1.0, 1.1, n), np.full(n, 7.0)])
        logged = run.create_dataset("part_values", data=values)
        logged.attrs.update({"units": "as their names", "long_name": "what parts log", "source": "computed"})
        run["value"] = np.array([1.0, 2.0])
        run["value"].make_scale("value")
        run["value"].attrs.update({"units": "1", "long_name": "rows", "source": "computed"})
        for axis, scale in enumerate(("value", "time_s")):
            logged.dims[axis].attach_scale(run[scale])
        names = run.create_dataset("part_value_names", data="b_0 ()\nlaw_force_1_n (N)")
        names.attrs.update({"units": "1", "long_name": "names", "source": "computed"})
    figure = draw("part_values", read_result(path), "two")
    whole, _ = figure.axes
    assert "b_0" in whole.get_title() + whole.get_title(loc="left") and "start 1" in whole.get_title(loc="right")
    assert whole.lines[0].get_ydata()[[0, -1]] == pytest.approx([0.0, 0.1])
    assert not any("law_force" in text for text in texts(figure))
    monkeypatch.setattr(write, "FIGURES", {"part_values": write.FIGURES["part_values"]})
    (written,) = write_figures([read_result(path)], tmp_path, "svg")
    assert written.name == "adapts-part_values.svg"


@pytest.mark.campaign
def test_an_aborted_run_is_drawn_as_far_as_it_goes_and_says_so(tmp_path):
    result = read_result(write_result(tmp_path / "stopped.h5", stop=600))
    for name in VIRTUAL:
        assert "aborted: EXP-RTHS: force beyond its limit" in draw(name, result).get_suptitle()
    close = draw("responses", result).axes[1]
    exp = next(line for line in close.lines if line.get_color() == "#0072B2")
    assert exp.get_xdata()[-1] == pytest.approx(599 / 200.0)
    errors = draw("errors", result).axes[1]
    assert np.max(errors.lines[0].get_xdata()) == pytest.approx(599 / 200.0)


@pytest.mark.campaign
def test_what_a_result_does_not_hold_is_left_out_with_a_reason(short, tmp_path, caplog):
    result, told = short, []
    paths = write_figures([result], tmp_path / "out", "svg", "one", told.append)
    assert [path.name for path in paths] == [f"sim-{name}.svg" for name in OF_SIM]
    assert f"{result.path}: figure timing is left out: no shake_table and no exp_rths in the result" in told
    assert len(told) == len(VIRTUAL) + 1 - len(OF_SIM)
    with caplog.at_level(logging.WARNING):
        write_figures([result], tmp_path / "out", "svg")
    *again, replaced = [record.getMessage() for record in caplog.records]
    assert again == told and replaced.startswith("replaced ") and all(str(path) in replaced for path in paths[:3])
    with pytest.raises(NotDrawn, match="no identification in the result"):
        draw("table_response", result)


@pytest.mark.campaign
def test_results_of_one_name_get_files_of_their_own(tmp_path):
    results = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        results.append(read_result(write_result(tmp_path / folder / "case.h5", runs=("sim",), n=300)))
    names = [path.name for path in write_figures(results, tmp_path / "out", "svg", tell=lambda _: None)]
    assert names == [f"{stem}-{name}.svg" for stem in ("case", "case-2") for name in OF_SIM]


def test_bad_words_and_folders_are_one_sentence(made_up, tmp_path):
    with pytest.raises(InputError, match=r"^figure is 'trakcing'; it must be one of table_response, tracking, "):
        draw("trakcing", made_up)
    with pytest.raises(InputError, match=r"^width is 'three'; it must be one of one, two\.$"):
        draw("tracking", made_up, "three")
    with pytest.raises(InputError, match=r"^form is 'jpg'; it must be one of pdf, svg, png\.$"):
        write_figures([made_up], tmp_path, "jpg")
    with pytest.raises(InputError, match=r"^header is 'no'; it must be one of case, none\.$"):
        write_figures([made_up], tmp_path, header="no")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file.*: cannot write the figure: .*; choose another folder\.$"):
        write_figures([made_up], tmp_path / "file", "png")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.campaign
def test_a_result_that_cannot_be_read_leaves_no_figure_at_all(tmp_path, monkeypatch):
    monkeypatch.setattr(write, "FIGURES", {name: write.FIGURES[name] for name in ("profiles", "limits", "tracking")})
    path = write_result(tmp_path / "short.h5", n=300)
    with h5py.File(path, "r+") as file:
        command = file["exp_rths/command_v"][:100]
        del file["exp_rths/command_v"]
        file["exp_rths/command_v"] = command
        file["exp_rths/command_v"].attrs["units"] = "V"
    with pytest.raises(InputError, match="has not the scale time_s"):
        write_figures([read_result(path)], tmp_path / "new" / "out", "svg", "one", lambda _: None)
    assert [entry.name for entry in tmp_path.iterdir()] == ["short.h5"]


def test_the_user_s_own_settings_stay(made_up, monkeypatch):
    monkeypatch.setitem(matplotlib.rcParams, "font.size", 31.0)
    before = dict(matplotlib.rcParams)
    draw("profiles", made_up)
    assert dict(matplotlib.rcParams) == before


def test_importing_the_figures_is_cheap():
    heavy = "{'matplotlib', 'scipy', 'numba', 'h5py'}"
    code = f"import sys, rths_cli.report.figures; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_a_long_reason_ends_with_dots_in_the_fourth_line_of_the_heading(tmp_path):
    unsafe = stated("unsafe: " + "with much of the gain the loop tolerates little; " * 5)
    refused = Finding("run.refused", {"run": "EXP-RTHS", "why": unsafe, "case": "own.yaml"})
    path = write_result(tmp_path / "refused.h5", n=600)
    with h5py.File(path, "a") as file:
        file.attrs.update({"status": "refused", "status_reason": str(refused), "findings": as_json([refused])})
    lines = draw("errors", read_result(path), "one").get_suptitle().splitlines()
    assert len(lines) == 4 and lines[-1].endswith(" ...") and len(lines[-1]) > 30
    assert any(line.startswith("refused: unsafe: with much") for line in lines)
