"""The figure of `rths structure`: the building, its cut, its shapes; the file appears whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.laboratory.describe import inspect_structure
from rths_cli.report.figures.structural_figures import draw_structure, write_figure
from rths_cli.report.figures.style import in_house_style


def test_each_mode_is_drawn_over_the_floors_and_the_cut_at_the_interface() -> None:
    found = inspect_structure("three_storey")
    with in_house_style():
        sketch, *modes = draw_structure(found).axes
    assert sketch.get_title(loc="left") == "three_storey" and {t.get_text() for t in sketch.texts} == {
        "on the table", "computed", "cut"
    }  # fmt: skip
    assert [ax.get_title(loc="left") for ax in modes] == ["mode 1, 2.31 Hz", "mode 2, 6.47 Hz", "mode 3, 9.35 Hz"]
    for mode, ax in enumerate(modes):
        zero, cut, shape = ax.lines
        assert np.asarray(shape.get_xdata()) == pytest.approx([0.0, *found.mode_shapes[:, mode]])
        assert np.asarray(shape.get_ydata()) == pytest.approx([0.0, 1.0, 2.0, 3.0])
        assert list(cut.get_ydata()) == [1.0, 1.0] and list(zero.get_xdata()) == [0.0, 0.0]


def test_heights_are_drawn_where_they_are_known(tmp_path: Path) -> None:
    path = tmp_path / "tall.yaml"
    path.write_text("extends: three_storey\nname: a_name_longer_than_the_sketch\nheights_m: [0.5, 0.3, 0.2]\n")
    with in_house_style():
        sketch, first, *_ = draw_structure(inspect_structure(str(path))).axes
    assert sketch.get_ylabel() == "height (m)" and sketch.get_title(loc="left") == "a_name_longer_t..."
    assert np.asarray(first.lines[2].get_ydata()) == pytest.approx([0.0, 0.5, 0.8, 1.0])


@pytest.mark.campaign
@parametrize_first(1, "form", ["svg", "pdf", "png"])
def test_the_same_building_gives_the_same_file(form: str, tmp_path: Path) -> None:
    found = inspect_structure("three_storey")
    files = [tmp_path / f"{name}.{form}" for name in "ab"]
    for path in files:
        write_figure(found, path)
    assert files[0].read_bytes() == files[1].read_bytes() and files[0].stat().st_size > 1000


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    found = inspect_structure("three_storey")
    for name, fault in (("a.jpg", "must end in .png, .svg or .pdf"), ("no/a.png", "cannot write the figure")):
        with pytest.raises(InputError, match=fault):
            write_figure(found, tmp_path / name)
    assert not list(tmp_path.iterdir())
