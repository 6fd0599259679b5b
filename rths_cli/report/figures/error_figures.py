"""Figure of the error budget: RMS errors by cause."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.report.error_budget_table import CAUSES
from rths_cli.report.figures.figure_data import NotDrawn, Source, chosen_storeys, interface_storey
from rths_cli.report.figures.panels import (
    ERROR_UNITS,
    MM_PER_M,
    Mark,
    dot_rows,
    dots_legend,
    lettered,
    new_figure,
    trimmed_ticks,
)
from rths_cli.report.figures.style import BLUE, ORANGE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {
    "check": Mark("predicted before the run", ORANGE, "D", 5.0, filled=False),
    "budget": Mark("measured", BLUE),
}
TOGETHER = "together"


def error_budget(source: Source, width: str) -> Figure:
    """Draw RMS errors by cause, predicted and measured: of tracking and of storeys to SIM, test band."""
    kinds = [kind for kind in KINDS if source.metric(f"{kind}.rms_error_coupling_m_s2") is not None]
    if not kinds:
        raise NotDrawn("no error by cause in the result")
    count = np.size(source.result.metrics[f"{kinds[0]}.rms_error_coupling_m_s2"])
    columns = [0, *chosen_storeys(count, interface_storey(source))]
    causes = [cause for cause in CAUSES if any(error_by(source, k, cause, c) > 0.0 for k in kinds for c in columns)]
    labels = [*(CAUSES[cause] for cause in causes), TOGETHER]
    across = len(columns) if width == "two" else 2
    down = -(-len(columns) // across)
    figure = new_figure(source, width, 22.0 + down * (14.0 + 4.2 * len(labels)), source.band)
    axes = list(figure.subplots(down, across, sharey=True, squeeze=False).ravel())
    titles = ["tracking", *(f"storey {column}" for column in columns[1:])]
    for ax, column, title in zip(axes, columns, lettered(titles), strict=False):
        dot_rows(ax, labels, [(KINDS[kind], _errors_mm(source, kind, causes, column)) for kind in kinds])
        ax.set(title=title, xscale="log", xlabel=f"RMS error ({ERROR_UNITS})")
        ax.margins(x=0.1)  # a mark at the end is whole
        trimmed_ticks(ax, log=True)
    for ax in axes[len(columns) :]:
        ax.set_visible(False)
    dots_legend(figure, [KINDS[kind] for kind in kinds])
    return figure


def _errors_mm(source: Source, kind: str, causes: Sequence[str], column: int) -> Array:
    """Return the errors by cause and together in mm/s^2, (n_causes + 1,); what is zero has no place on the axis."""
    values = np.array([error_by(source, kind, cause, column) for cause in (*causes, "")])
    return np.where(values > 0.0, MM_PER_M * values, np.nan)


def error_by(source: Source, kind: str, cause: str, column: int) -> float:
    """Return the RMS error in m/s^2 due to a cause ("": total), of a storey or, for column 0, of tracking."""
    owner = "exp_rths" if kind == "budget" and not cause else kind
    part = f"_{cause}" if cause else ""
    found = source.metric(f"{owner}.rms_error{part}_m_s2" if column else f"{owner}.tracking_rms{part}_m_s2")
    return float("nan") if found is None else float(found[max(column - 1, 0)])
