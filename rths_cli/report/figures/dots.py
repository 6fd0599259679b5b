"""Rows of marks over labels: several values per label, told apart by colour, shape and filling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.lti import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


@dataclass(frozen=True)
class Mark:
    """Hold how one kind of value looks: name in the legend, colour, shape, size in points, whether it is filled."""

    label: str
    color: str
    shape: str = "o"
    size: float = 3.0
    filled: bool = True


def dot_rows(ax: Axes, labels: Sequence[str], marks: Sequence[tuple[Mark, Array]]) -> None:
    """Draw values (n,) over n labels, the first label at the top; NaN has no mark."""
    places = np.arange(len(labels))
    for mark, values in marks:
        (line,) = ax.plot(values, places, label=mark.label)
        _dress(line, mark)
    ax.set_yticks(places, labels)
    ax.set_ylim(len(labels) - 0.5, -0.5)


def dots_legend(figure: Figure, marks: Sequence[Mark]) -> None:
    """Put one legend for the marks below the axes."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], label=mark.label) for mark in marks]
    for handle, mark in zip(handles, marks, strict=True):
        _dress(handle, mark)
    figure.legend(handles=handles, loc="outside lower center", ncols=2 if figure.get_figwidth() < 4.0 else 4)


def _dress(line: Line2D, mark: Mark) -> None:
    line.set(color=mark.color, linestyle="none", marker=mark.shape, markersize=mark.size)
    line.set_markerfacecolor(mark.color if mark.filled else "none")
