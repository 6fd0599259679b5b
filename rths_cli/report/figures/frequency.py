"""Figures over frequency: the table's response (the paper's Fig. 4.1a), spectra, gain and delay of the tracking."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.numerics.bands import with_test_band
from rths_cli.numerics.lti import Array, Block, ComplexArray, Model
from rths_cli.quantities import DATASETS
from rths_cli.quantities.declaration import typeset
from rths_cli.report.figures.figure_data import DESIRED, MEASURED, NotDrawn, Source, phases
from rths_cli.report.figures.panels import ACCELERATION_UNITS, Mark, dress, legend_below, lettered, new_figure
from rths_cli.report.figures.style import BLACK, GREY, MEASURED_FRF, MODEL, ORANGE, PURPLE, RUNS, TRUE, VERMILLION, Look
from rths_cli.report.figures.style import DESIRED as DESIRED_LOOK
from rths_cli.report.results_by_case import TABLE_RUNS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FREQUENCY = "frequency (Hz)"
FRF_UNITS = typeset(DATASETS["identification/frf"].units)
SPECTRAL_S = 8.0  # with the usual test band, length of a segment of Welch's method: lines every 0.125 Hz
SPECTRAL_HZ = (0.1, 100.0)  # with that band, the frequencies of the spectra
ROOTS = ("zeros", "poles")
TRACKED_HZ = (0.25, 20.0)  # with the usual test band, the frequencies of gain and delay
LEAST_COHERENCE = 0.998  # with a dozen averages or more a line of H1 is then known to some 1 % or better
LEAST_POWER = 1e-4  # of the largest of the desired motion: below, the record has no energy to measure a gain with
BANDS_PER_OCTAVE = 48  # of spectra: lines that are closer are averaged
DECADES = 9.0  # of power below the largest that spectra show
LATENCY = {
    "compensated": Mark("compensated", "#AAAAAA", "s", 6.0),
    "total": Mark("of the loop", VERMILLION, "D", 3.5, filled=False),
    "left": Mark("left", BLACK, "x", 4.0),
}
"""Known at a few frequencies, and no line between them is."""
THIN = 0.6


def table_response(source: Source, width: str) -> Figure:
    """Draw the table's measured and fitted response from command to acceleration, and the coherence (Fig. 4.1a)."""
    if "identification" not in source.result.groups:
        raise NotDrawn("no identification in the result")
    f = source.read("identification/frequency_hz")
    measured = source.read("identification/frf_real") + 1j * source.read("identification/frf_imag")
    fitted = fitted_response(source, f)
    figure = new_figure(source, width, 105.0)
    axes = figure.subplots(3, 1, sharex=True, height_ratios=(2.4, 1.4, 1.0))
    sizes = (np.abs(measured), np.abs(fitted))
    for ax, (seen, model) in zip(axes[:2], (sizes, phases(measured, fitted)), strict=True):
        ax.plot(f, seen, **MEASURED_FRF.line())
        ax.plot(f, model, **MODEL.line())
    axes[0].set(yscale="log", ylabel=f"acceleration / command\n({FRF_UNITS})")
    axes[1].set(ylabel="phase (deg)")
    axes[1].yaxis.set_major_locator(_quarter_turns())
    axes[2].plot(f, source.read("identification/coherence"), **replace(MEASURED_FRF, width=1.0).line())
    axes[2].set(ylabel="coherence", ylim=(0.0, 1.08))
    _natural_frequencies(axes, source.read("identification/natural_frequency_hz"))
    _frequency_axis(axes, float(f[0]), float(f[-1]))
    size = f"model, {len(source.read('identification/poles_real'))} poles, "
    size += f"{len(source.read('identification/zeros_real'))} zeros"
    marks = Look("natural frequencies", VERMILLION, (0, (4.0, 2.0)))
    legend_below(figure, [MEASURED_FRF, replace(MODEL, label=size), marks])
    return figure


def fitted_response(source: Source, frequency_hz: Array) -> ComplexArray:
    """Return the model's response of the table's samples (n,) in m/s^2/V, what the hold's staircase adds included."""
    group = "identification/"
    parts = {name: source.read(f"{group}{name}_real") + 1j * source.read(f"{group}{name}_imag") for name in ROOTS}
    gain, delay_s = (float(source.read(f"{group}{name}")) for name in ("gain", "delay_s"))
    dt_s = 1.0 / source.rate_hz
    response = Model(parts["zeros"], parts["poles"], gain, delay_s, (0.0, 0.0), dt_s=dt_s).response(frequency_hz)
    if float(source.read(f"{group}ripple_m_s2_per_v")) == 0.0:
        return response
    A, B, C, D = (source.read(f"controller/staircase/{name}") for name in "ABCD")
    alias = Block("staircase", A, B, C, D, dt_s)
    return np.asarray(response + alias.response(frequency_hz)[0, 0], dtype=complex)


def _quarter_turns() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5, steps=[1.0, 1.8, 4.5, 9.0, 10.0])


def _natural_frequencies(axes: Sequence[Axes], natural_hz: Array) -> None:
    for ax in axes:
        for value in natural_hz:
            ax.axvline(float(value), color=VERMILLION, ls=(0, (4.0, 2.0)), lw=0.6)


def spectra(source: Source, width: str) -> Figure:
    """Draw power spectral densities (PSD) of desired, measured and desired - measured table acceleration (Welch)."""
    runs = source.runs(TABLE_RUNS)
    figure = new_figure(source, width, 75.0 if width == "two" or len(runs) == 1 else 120.0)
    shape = (1, len(runs)) if width == "two" else (len(runs), 1)
    axes = list(figure.subplots(*shape, squeeze=False).ravel())
    looks: list[Look] = []
    for ax, run, title in zip(axes, runs, lettered(RUNS[run].label for run in runs), strict=True):
        looks += _spectra_of(ax, source, run)
        ax.set_title(title)
        ax.set_ylabel(f"PSD (({ACCELERATION_UNITS})²/Hz)")
        ax.axvline(source.result.test_band_hz, color=GREY, ls=(0, (4.0, 2.0)), lw=0.7)
    low, high = _following(source, SPECTRAL_HZ)
    _frequency_axis(axes, low, min(high, 0.5 * source.rate_hz), every=True)
    figure.align_ylabels()
    legend_below(figure, [*looks, Look("edge of the test band", GREY, (0, (4.0, 2.0)), 0.7)])
    return figure


def _spectra_of(ax: Axes, source: Source, run: str) -> list[Look]:
    from scipy.signal import welch

    desired, measured = source.read(f"{run}/{DESIRED}"), source.read(f"{run}/{MEASURED}")
    looks = [
        replace(DESIRED_LOOK, width=1.4),
        replace(RUNS[run], label=f"measured, {RUNS[run].label}", width=0.7),
        Look("desired − measured", ORANGE, "solid", 1.6),
    ]
    series = [desired, measured, desired - measured]
    if source.has_truth:
        looks.append(Look("desired − true", PURPLE, (0, (3.0, 1.0)), 0.8))
        series.append(desired - source.read(f"{run}/truth/table_accel_m_s2"))
    top, (low, high) = 0.0, _following(source, SPECTRAL_HZ)
    for look, values in zip(looks, series, strict=True):
        f, power = welch(values, source.rate_hz, nperseg=_segment(source, values.size))
        inside = (f >= low) & (f <= high)
        f, power = in_bands(f[inside], power[inside])
        ax.plot(f, power, **replace(look, width=max(look.width, THIN)).line())
        top = max(top, float(power.max(initial=0.0)))
    ax.set_yscale("log")
    if top > 0.0:
        ax.set_ylim(top * 10.0**-DECADES, 3.0 * top)
    return looks


def in_bands(frequency_hz: Array, power: Array) -> tuple[Array, Array]:
    """Return the means of frequency and power (n,) over bands of 1/48 octave; a line alone in its band is unchanged."""
    if not frequency_hz.size:
        return frequency_hz, power
    bands = np.floor(BANDS_PER_OCTAVE * np.log2(frequency_hz))
    starts = np.flatnonzero(np.diff(bands, prepend=-np.inf))
    counts = np.diff(starts, append=frequency_hz.size)
    return np.add.reduceat(frequency_hz, starts) / counts, np.add.reduceat(power, starts) / counts


def delay_and_gain(source: Source, width: str) -> Figure:
    """Draw gain and delay from desired to measured table acceleration by frequency, and the loop's latency."""
    runs = source.runs(TABLE_RUNS)
    latency = source.metric("latency.frequency_hz")
    figure = new_figure(source, width, 75.0 if latency is None else 105.0)
    axes = list(figure.subplots(2 if latency is None else 3, 1, sharex=True))
    looks: list[Look] = []
    for run, name, look in _tracked(source, runs):
        f, gain, delay_s = gain_and_delay(source, run, name)
        axes[0].plot(f, gain, **look.line())
        axes[1].plot(f, 1e3 * delay_s, **look.line())
        looks.append(look)
    axes[0].set_ylabel("gain")
    axes[1].set_ylabel("delay (ms)")
    if latency is not None:
        _latency(axes[2], source, latency)
    titles = ("gain of the table, measured / desired", "delay of the table, late is positive", "latency, as designed")
    for ax, title in zip(axes, lettered(titles), strict=False):
        ax.set_title(title)
    _frequency_axis(axes, *_following(source, TRACKED_HZ))
    figure.align_ylabels()
    legend_below(figure, looks)
    return figure


def _tracked(source: Source, runs: Sequence[str]) -> Iterator[tuple[str, str, Look]]:
    """Yield run, series and look of what is compared with the desired acceleration; the last run's true one too."""
    for run in runs:
        yield run, MEASURED, replace(RUNS[run], label=f"measured, {RUNS[run].label}")
    if source.has_truth:
        yield runs[-1], "truth/table_accel_m_s2", replace(TRUE, label=f"true, {RUNS[runs[-1]].label}")


def gain_and_delay(source: Source, run: str, name: str) -> tuple[Array, Array, Array]:
    """Return frequencies, |H1| and -arg(H1) / (2 pi f) from desired to a series of a run, each (n,).

    There is NaN where the coherence is below 0.998, because noise has no gain, and where the desired motion has less
    than 1e-4 of its largest power: a record without energy measures none.
    """
    from scipy.signal import coherence, csd, welch

    desired, seen = source.read(f"{run}/{DESIRED}"), source.read(f"{run}/{name}")
    segment, rate = _segment(source, desired.size), source.rate_hz
    f, power = welch(desired, rate, nperseg=segment)
    low, high = _following(source, TRACKED_HZ)
    inside = (f >= low) & (f <= high) & (power > 0.0)
    cross = csd(desired, seen, rate, nperseg=segment)[1][inside]
    poor = ~(coherence(desired, seen, rate, nperseg=segment)[1][inside] >= LEAST_COHERENCE)
    poor |= power[inside] < LEAST_POWER * power.max(initial=0.0)
    response = np.where(poor, np.nan, cross / power[inside])
    return f[inside], np.abs(response), -np.angle(response) / (2.0 * np.pi * f[inside])


def _latency(ax: Axes, source: Source, frequency_hz: Array) -> None:
    shown = frequency_hz <= _following(source, TRACKED_HZ)[1]
    for name, mark in LATENCY.items():
        value = source.metric(f"latency.{name}_s")
        if value is not None:
            (line,) = ax.plot(frequency_hz[shown], 1e3 * value[shown], label=mark.label)
            dress(line, mark)
            line.set_clip_on(False)
    ax.set_ylabel("latency (ms)")
    low, high = ax.get_ylim()
    ax.set_ylim(low - 0.1 * (high - low), high + 0.45 * (high - low))  # room for the legend
    ax.legend(loc="upper left", ncols=len(LATENCY), borderpad=0.2, handletextpad=0.2)


def _segment(source: Source, samples: int) -> int:
    """Return the number of samples of a segment of Welch's method; a short record has four overlapping segments."""
    return min(
        round(SPECTRAL_S / with_test_band(1.0, source.result.test_band_hz) * source.rate_hz),
        max(samples // 2, 8),
        samples,
    )


def _following(source: Source, usual_hz: tuple[float, float]) -> tuple[float, float]:
    """Return the ends in Hz of a band that keeps its ratio to the test band of the result."""
    low, high = (with_test_band(hz, source.result.test_band_hz) for hz in usual_hz)
    return low, high


def _frequency_axis(axes: Sequence[Axes], low: float, high: float, every: bool = False) -> None:
    """Set the same band on all axes, with plain numbers; one label at the bottom, or with `every` one for each."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    marks = [m * 10.0**k for k in range(-4, 5) for m in (1.0, 2.0, 5.0) if low <= m * 10.0**k <= high]
    for ax in axes:
        ax.set_xscale("log")
        ax.set_xlim(low, high)
        ax.xaxis.set_major_locator(FixedLocator(marks))
        ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.xaxis.set_minor_formatter(NullFormatter())
        if every or ax is axes[-1]:
            ax.set_xlabel(FREQUENCY)
