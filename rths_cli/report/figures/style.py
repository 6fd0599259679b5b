"""Colours, line styles, fonts, widths and resolution of all figures of results.

A figure of a command is written to the file that the user names: .png, .svg or .pdf by its suffix, whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.interrupts import interruptible

WIDTHS_MM = {"one": 84.0, "two": 174.0}
FORMS = ("pdf", "svg", "png")
MM_PER_INCH = 25.4
DPI = 300
DENSE_LINEWIDTH = 0.5  # of a whole record, whose oscillations touch each other
DENSE_BROAD = 1.0  # of the line below the others there, which shows around them

# Okabe and Ito's colours, which colour-blind readers tell apart
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILLION, PURPLE, GREY = "#0072B2", "#D55E00", "#CC79A7", "#777777"

STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],
    "mathtext.fontset": "dejavusans",
    "font.size": 7.0,
    "axes.labelsize": 7.0,
    "axes.titlesize": 7.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 3.0,
    "axes.labelpad": 2.0,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E0E0E0",
    "grid.linewidth": 0.4,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "legend.borderaxespad": 0.2,
    "legend.columnspacing": 1.4,
    "lines.linewidth": 0.9,
    "lines.markersize": 4.0,
    "hatch.linewidth": 0.5,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "rths",
    "path.simplify": False,
}
METADATA: dict[str, dict[str, str | None]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}

SINGLE_FIGURE_FORMS = ("png", "svg", "pdf")


@dataclass(frozen=True)
class Look:
    """The appearance of a line."""

    label: str  # in the legend
    color: str
    dashes: Any = "solid"  # line style
    width: float = 0.9  # points
    below: bool = False  # drawn first, and broader than what follows where lines are dense

    def line(self, dense: bool = False) -> dict[str, Any]:
        """Return the arguments of a line; `dense`: thin and solid, since dashes of a whole record cannot be seen."""
        if dense:
            return {"color": self.color, "ls": "solid", "lw": DENSE_BROAD if self.below else DENSE_LINEWIDTH}
        return {"color": self.color, "ls": self.dashes, "lw": self.width}


RUNS = {
    "sim": Look("SIM", BLACK, below=True),
    "sim_delay": Look("SIM-DELAY", VERMILLION, (0, (5.0, 1.5))),
    "exp_rths": Look("EXP-RTHS", BLUE, (0, (1.5, 1.0)), 1.2),
    "shake_table": Look("shake table test", GREEN, (0, (4.0, 1.0, 1.0, 1.0)), 1.0),
}
DESIRED = Look("desired", BLACK, below=True)
TRUE = Look("true", PURPLE, (0, (1.0, 1.5)), 1.0)
ESTIMATED = Look("Kalman filter", ORANGE, (0, (5.0, 1.5)), 1.0)
MEASURED_FRF = Look("measured", SKY, "solid", 2.4)
MODEL = Look("model", BLACK, "solid", 0.8)


def in_house_style() -> AbstractContextManager[None]:
    """Return a context in which matplotlib draws in this style, independent of the user's settings."""
    from matplotlib import style

    return style.context(STYLE, after_reset=True)


def plain(text: str) -> str:
    """Return a text with escaped dollar signs, which would otherwise begin a formula."""
    return text.replace("$", r"\$")


def write_figure_file(path: Path, image: Callable[[str], bytes]) -> None:
    """Write what `image` returns for the form that the suffix of `path` names.

    Raises InputError for another suffix, or if the file cannot be written; then no file is left behind.
    """
    form = path.suffix.lower().removeprefix(".")
    if form not in SINGLE_FIGURE_FORMS:
        raise InputError(f"{path}: a figure's file name must end in .png, .svg or .pdf")
    content = interruptible(lambda: image(form))
    try:
        with written_whole(path) as part:
            part.write_bytes(content)
    except OSError as error:
        raise InputError(f"{path}: cannot write the figure: {error.strerror}; choose another file") from error
