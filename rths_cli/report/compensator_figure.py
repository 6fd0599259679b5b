"""The figure of `rths benchmark --responses`: frequency response and step response of every compensator."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rths_cli.benchmark.responses import FREQUENCY_HZ, RISE_S, Followed
from rths_cli.report.figures.style import write_figure_file
from rths_cli.report.identification_figure import BLUE, DPI, GREY, METADATA, STYLE

ROW_INCH, WIDTH_INCH = 1.3, 8.27


def write_responses(found: Sequence[Followed], path: Path) -> None:
    """Write a row of panels for each compensator as .png, .svg or .pdf: gain, delay and a fast rise."""
    write_figure_file(path, lambda form: _image(found, form))


def _image(found: Sequence[Followed], form: str) -> bytes:
    from matplotlib import style
    from matplotlib.figure import Figure

    buffer = io.BytesIO()
    with style.context(STYLE, after_reset=True):
        drawn = Figure(figsize=(WIDTH_INCH, 0.9 + ROW_INCH * len(found)), layout="constrained")
        axes = drawn.subplots(len(found), 3, squeeze=False, sharex="col")
        for one, (gain, delay, rise) in zip(found, axes, strict=True):
            gain.semilogx(FREQUENCY_HZ, np.abs(one.response), color=BLUE)
            gain.set(ylim=(0.0, 2.0), ylabel=one.label)
            phase = np.unwrap(np.angle(one.response))
            late = -1e3 * phase / (2.0 * np.pi * FREQUENCY_HZ)
            delay.semilogx(FREQUENCY_HZ, late, color=BLUE)
            delay.set_ylim(-15.0, 30.0)
            rise.plot(1e3 * one.time_s, one.desired, color=GREY, linestyle="--")
            rise.plot(1e3 * one.time_s, one.moved, color=BLUE)
            rise.set_ylim(-0.2, 1.6)
        for axis, title in zip(axes[0], ("gain", "delay in ms", f"rise in {1e3 * RISE_S:g} ms"), strict=True):
            axis.set_title(title, fontsize=9.0)
        for axis, label in zip(axes[-1], ("Hz", "Hz", "ms"), strict=True):
            axis.set_xlabel(label)
        drawn.savefig(buffer, format=form, dpi=DPI, metadata=METADATA[form])
    return buffer.getvalue()
