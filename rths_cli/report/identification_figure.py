"""The figure of `rths identify`: measured and fitted response as in the paper's Fig. 4.1a, residual, floors."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.identification.results import Identification
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.report.figures.style import write_figure_file
from rths_cli.report.identification_page import verdict_sentence
from rths_cli.report.numbers import rounded
from rths_cli.structure import Specimen

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rths_cli.experiment.identify_command import About

# Okabe and Ito's colours, which colour-blind readers tell apart; lightness and dashes tell them apart in grey
SKY, BLUE, VERMILLION, GREY, LIGHT = "#56B4E9", "#0072B2", "#D55E00", "#999999", "#F0F0F0"
FLOORS = ("#E69F00", BLUE, "#009E73", "#CC79A7", SKY, VERMILLION)
DASHES = ("solid", (0, (5, 1.5)), (0, (1.5, 1)), (0, (5, 1, 1.5, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
A4_INCH = (8.27, 11.69)
DPI = 150
LONGEST_NAME = 16
CLOSE = 1.45  # ratio of two frequencies whose texts would overlap
LEAST_PERCENT = 1e-3
STYLE = {
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "legend.fontsize": 8.5,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "legend.frameon": False,
    "svg.hashsalt": "rths",
}
METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
}


def write_figure(found: Identification, about: About, path: Path) -> None:
    """Write the figure as .png, .svg or .pdf, by the suffix of `path`; equal identifications give equal bytes.

    Raises InputError for another suffix, or if the file cannot be written; then no file is left behind.
    """
    write_figure_file(path, lambda form: _image(found, about, form))


def _image(found: Identification, about: About, kind: str) -> bytes:
    """Return the file of the figure as bytes, independent of the user's matplotlib settings."""
    from matplotlib import style

    buffer = io.BytesIO()
    with style.context(STYLE, after_reset=True):
        figure(found, about).savefig(buffer, format=kind, dpi=DPI, metadata=METADATA[kind])
    return buffer.getvalue()


def figure(found: Identification, about: About) -> Figure:
    """Draw magnitude, phase, coherence and residual of the table and, if there are floors, their transmissibility."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=A4_INCH)
    specimen = found.specimen or found.free_vibration
    ratios = [2.6, 1.5, 0.9, 1.9] + ([2.2] if specimen else [])
    grid = drawn.add_gridspec(
        len(ratios), 1, height_ratios=ratios, left=0.11, right=0.89, top=0.895, bottom=0.085, hspace=0.24
    )
    axes = [drawn.add_subplot(grid[0])]
    axes += [drawn.add_subplot(grid[row], sharex=axes[0]) for row in range(1, len(ratios))]
    _magnitude(axes[0], found)
    _phase(axes[1], found)
    _coherence(axes[2], found)
    _residual(axes[3], found)
    if specimen:
        _floors(axes[4], found, specimen.specimen, specimen.natural_frequency_hz)
    _identified_axis(axes, found.frfs[0].frequency_hz)
    _heading(drawn, found, about)
    return drawn


def transmissibility(specimen: Specimen, frequency_hz: Array) -> ComplexArray:
    """Return the floors' absolute acceleration over the table's, (n_floors, n_frequencies), by Eq. 2.5."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)[:, None, None]
    M = np.diag(specimen.masses_kg)
    relative = np.linalg.solve(s**2 * M + s * specimen.C + specimen.K, -M.sum(axis=1)[:, None].astype(complex))
    return (1.0 + s[:, :, 0] ** 2 * relative[:, :, 0]).T.astype(complex)


def _magnitude(ax: Axes, found: Identification) -> None:
    table = found.frfs[0]
    size = f"model, {len(found.best.poles)} poles, {len(found.best.zeros)} zeros"
    f, floor = table.frequency_hz, found.noise_floors[0]
    ax.plot(f, np.abs(table.response), color=SKY, lw=3.0, label="measured")
    ax.plot(f, np.abs(found.best.sampled_response(f)), color="black", label=size)
    if floor is not None and np.any(floor > 0.0):
        ax.plot(f[floor > 0.0], floor[floor > 0.0], color=GREY, lw=0.8, label="noise floor")
    ax.set_yscale("log")
    ax.set_ylabel("|acceleration / command|\n(m/s$^2$/V)")
    _legend(ax)


def _phase(ax: Axes, found: Identification) -> None:
    """Draw the unwrapped phases; the measured phase is the model's plus the phase of measured over model response."""
    from matplotlib.ticker import MaxNLocator

    table = found.frfs[0]
    model = found.best.sampled_response(table.frequency_hz)
    unwrapped = np.unwrap(np.angle(model))
    unwrapped += 2.0 * np.pi * (unwrapped[0] < -0.5 * np.pi)  # near 0 Hz an acceleration is 180 deg before its cause
    measured = unwrapped + np.angle(table.response / model)
    ax.plot(table.frequency_hz, np.degrees(measured), color=SKY, lw=3.0)
    ax.plot(table.frequency_hz, np.degrees(unwrapped), color="black")
    ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1.0, 1.8, 4.5, 9.0, 10.0]))
    ax.set_ylabel("phase (deg)")


def _coherence(ax: Axes, found: Identification) -> None:
    for index, (frf, channel) in enumerate(zip(found.frfs, found.channels, strict=True)):
        look: dict[str, Any] = {"color": "black", "zorder": 3.0}
        if index > 0:
            look = {"color": FLOORS[(index - 1) % 6], "ls": DASHES[(index - 1) % 6], "lw": 0.9}
        ax.plot(frf.frequency_hz, frf.coherence, label=_name(channel.name), **look)
    ax.set_ylim(0.0, 1.06)
    ax.set_ylabel("coherence")
    _legend(ax)


def _residual(ax: Axes, found: Identification) -> None:
    """Draw |model / FRF - 1| by line and by band, with its uncertainty in the data and the limits."""
    table = found.frfs[0]
    f = table.frequency_hz
    error = 100.0 * np.abs(found.best.sampled_response(f) / table.response - 1.0)
    scatter = 100.0 * np.sqrt(2.0) * table.relative_error
    low, high = found.verdict.feedforward_hz
    if high > low:
        what = "fit for feedforward" if found.accepted else "keeps its limits"
        ax.axvspan(low, high, color=LIGHT, lw=0.0, label=f"{what}, {rounded(low)} to {rounded(high)} Hz")
    least = max(0.5 * min((100.0 * band.rms for band in found.residuals), default=0.1), LEAST_PERCENT)
    ax.fill_between(f, least, scatter.clip(min=least), color="#BBBBBB", lw=0.0, label="data's own scatter")
    ax.plot(f, error.clip(min=least), color=BLUE, lw=0.7, label="each line")
    _bands(ax, found)
    for value, name in ((LIMITS.rms, "rms"), (LIMITS.largest, "largest")):
        ax.axhline(100.0 * value, color=VERMILLION, ls=(0, (4, 2)), lw=1.1)
        ax.annotate(f"{100.0 * value:g} % {name}", (1.0, 100.0 * value), xycoords=("axes fraction", "data"),
                    xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.0, color=VERMILLION)  # fmt: skip
    ax.set_yscale("log")
    ax.set_ylim(least, max(10.0, 1.5 * float(error.max())))
    ax.set_ylabel("|model / FRF $-$ 1| (%)")
    _legend(ax)


def _bands(ax: Axes, found: Identification) -> None:
    """Draw the rms of each band as a horizontal bar over the band."""
    for i, band in enumerate(found.residuals):
        label = "rms by band" if i == 0 else None
        ax.plot([band.low_hz, band.high_hz], [100.0 * band.rms] * 2, color="black", lw=2.2, label=label)


def _floors(ax: Axes, found: Identification, specimen: Specimen, natural_hz: Array) -> None:
    """Draw |floor / table|, measured and of the identified specimen, and mark the natural frequencies."""
    table = found.frfs[0]
    f = table.frequency_hz
    clean = table.response - found.best.alias(f)
    identified = np.abs(transmissibility(specimen, f))
    for index, frf in enumerate(found.frfs[1:]):
        name, colour = _name(found.channels[index + 1].name), FLOORS[index % 6]
        ax.plot(f, np.abs(frf.response / clean), color=colour, lw=3.0, alpha=0.6, label=f"measured, {name}")
        ax.plot(f, identified[index], color="black", ls=DASHES[index % 6], label=f"identified, {name}")
    ax.set_yscale("log")
    ax.set_ylim(0.5 * float(identified.min()), 2.0 * float(identified.max()))
    _mark_natural_frequencies(ax, natural_hz)
    ax.set_ylabel("|floor / table|")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.17), ncols=min(len(identified), 5), handlelength=2.6)


def _mark_natural_frequencies(ax: Axes, natural_hz: Array) -> None:
    """Mark the natural frequencies; if two are close, the text of the second one is higher."""
    above, last = 2.0, 0.0
    for value in natural_hz:
        above = 11.0 if above < 11.0 and value < CLOSE * last else 2.0
        last = value
        ax.axvline(value, color=VERMILLION, ls=(0, (4, 2)), lw=0.9)
        ax.annotate(f"{value:.3f} Hz", (value, 1.0), xycoords=("data", "axes fraction"), xytext=(0, above),
                    textcoords="offset points", ha="center", va="bottom", fontsize=8.0, color=VERMILLION)  # fmt: skip


def _legend(ax: Axes) -> None:
    """Draw the legend above the axes, clear of the data."""
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5, borderaxespad=0.15, columnspacing=1.4)


def _identified_axis(axes: Sequence[Axes], frequency_hz: Array) -> None:
    """Set the measured band on all axes, with frequencies as plain numbers and one label at the bottom."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    low, high = float(frequency_hz[0]), float(frequency_hz[-1])
    marks = [m * 10.0**k for k in range(-4, 5) for m in (1.0, 2.0, 5.0) if low <= m * 10.0**k <= high]
    axes[0].set_xscale("log")
    axes[0].set_xlim(low, high)
    for ax in axes:
        ax.yaxis.set_label_coords(-0.075, 0.5)
        ax.tick_params(axis="x", which="both", labelbottom=ax is axes[-1])
    axes[-1].xaxis.set_major_locator(FixedLocator(marks))
    axes[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[-1].xaxis.set_minor_formatter(NullFormatter())
    axes[-1].set_xlabel("frequency (Hz)", labelpad=1.0)


def _heading(drawn: Figure, found: Identification, about: About) -> None:
    """Write rig, verdict and source above the axes, one line each."""
    kind = about.rig_kind[:1].upper() + about.rig_kind[1:]
    lines: list[tuple[float, str, dict[str, Any]]] = [
        (0.975, f"{kind} table {about.rig}, identified from its channels", {"fontsize": 12.0, "fontweight": "bold"}),
        (0.955, textwrap.shorten(verdict_sentence(found.verdict), 118, placeholder=" ..."), {"fontsize": 9.0}),
        (0.938, textwrap.shorten(about.source, 125, placeholder=" ..."), {"fontsize": 8.5, "color": "#555555"}),
    ]
    for height, text, look in lines:
        drawn.text(0.11, height, _plain(text), va="center", **look)


def _plain(text: str) -> str:
    """Return a text with escaped dollar signs, which would otherwise begin a formula."""
    return text.replace("$", r"\$")


def _name(channel: str) -> str:
    """Return the name of a channel, shortened for a legend."""
    return _plain(channel if len(channel) <= LONGEST_NAME else channel[: LONGEST_NAME - 1] + ".")
