"""The specimen on the identification page: excitation and free vibration side by side, storeys, mode shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.identification.found import Identification, SpecimenFit
from rths_cli.report.identified_document import agreements
from rths_cli.report.identified_text import DASH, aligned, labelled, number, percent, with_uncertainty
from rths_cli.report.layout import WIDTH

UNKNOWN = (DASH, DASH)


def specimen_lines(found: Identification) -> list[str]:
    """Return modes, storeys and mode shapes, as excitation and free vibration show them."""
    known = found.specimen or found.free_vibration
    if known is None:
        return [labelled("specimen", "none: there is no floor channel, or no stretch of motion to use")]
    floors = [channel.name for channel in found.channels[1:]]
    about = "+- 2 standard uncertainties; scatter: standard deviation over stretches of the record"
    storeys = (
        "k, c: stiffness and equivalent dashpot of the storey below a floor; the dashpots together give the same "
        "damping ratios, a single one may be negative"
    )
    return [
        labelled("specimen", about),
        *aligned(_rows(found, known, floors)),
        labelled("", storeys),
        "",
        labelled("mode shapes", "largest floor 1" + _difference(found.specimen, found.free_vibration)),
        *_shapes(known, floors),
    ]


def _rows(found: Identification, known: SpecimenFit, floors: Sequence[str]) -> list[list[str]]:
    """Return a row per quantity: value and scatter of both fits, and whether they agree in a mode."""
    labels = _labels(len(known.damping_ratio), floors)
    noise, free = (_column(fit) if fit else [UNKNOWN] * len(labels) for fit in (found.specimen, found.free_vibration))
    verdicts = [text for same in _agree(found, len(known.damping_ratio)) for text in (same, "")]
    verdicts += [""] * (len(labels) - len(verdicts))
    rows = zip(labels, noise, free, verdicts, strict=True)
    heads = ["", "excitation", "scatter", "free vibration", "scatter", "agree"]
    return [heads, *([label, *one, *other, verdict] for label, one, other, verdict in rows)]


def _agree(found: Identification, modes: int) -> list[str]:
    """Return for each mode yes or no, a dash where only one of the fits exists."""
    agree = agreements(found)
    return [DASH] * modes if agree is None else ["yes" if same else "no" for same in agree]


def _labels(modes: int, floors: Sequence[str]) -> list[str]:
    """Return the names of the rows, in the order of `_column`."""
    names = [text for mode in range(modes) for text in (f"mode {mode + 1} (Hz)", "  damping ratio (%)")]
    names += [f"k {floor} (N/m)" for floor in floors]
    names += [f"c {floor} (N s/m)" for floor in floors]
    return [*names, "unexplained motion (%)"]


def _column(fit: SpecimenFit) -> list[tuple[str, str]]:
    """Return value and scatter of every quantity, in the order of `_labels`."""
    cells = []
    for mode in range(len(fit.damping_ratio)):
        frequency = with_uncertainty(fit.natural_frequency_hz[mode], fit.frequency_error_hz[mode])
        damping = with_uncertainty(fit.damping_ratio[mode], fit.damping_error[mode], 100.0)
        cells.append((frequency, number(fit.frequency_scatter_hz[mode], 2)))
        cells.append((damping, number(100.0 * fit.damping_scatter[mode], 2)))
    for stiffness, error in zip(fit.stiffness_n_per_m, fit.stiffness_error_n_per_m, strict=True):
        cells.append((with_uncertainty(stiffness, error), ""))
    cells += [(number(dashpot, 4), "") for dashpot in fit.dashpots_n_s_per_m]
    return [*cells, (percent(fit.residual), "")]


def _difference(noise: SpecimenFit | None, free: SpecimenFit | None) -> str:
    """Say by how much the shapes of the free vibration differ."""
    if noise is None or free is None:
        return ""
    largest = float(np.max(np.abs(noise.mode_shapes - free.mode_shapes)))
    return f"; excitation, from which free vibration differs by {number(largest, 2)} at most"


def _shapes(fit: SpecimenFit, floors: Sequence[str]) -> list[str]:
    """Return a row per floor and a column per mode, as many modes as stand side by side."""
    label = max(len(floor) for floor in floors)
    count = max((WIDTH - max(label, 20) - 2) // 9, 1)
    lines = []
    for first in range(0, len(fit.damping_ratio), count):
        modes = range(first, min(first + count, len(fit.damping_ratio)))
        rows = [["", *(f"mode {mode + 1}" for mode in modes)]]
        rows += [[floor, *(f"{fit.mode_shapes[i, mode]:.4f}" for mode in modes)] for i, floor in enumerate(floors)]
        lines += aligned(rows)
    return lines
