"""How the identification page spells numbers, and how it sets them under each other."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

from rths_cli.report.layout import WIDTH

LABEL = 24
DASH = "-"
MOST_DECIMALS = 6
LARGEST_WRITTEN_OUT = 1e9


def number(value: float, digits: int = 3) -> str:
    """Return a number of so many significant digits, a dash where it is not known."""
    if not math.isfinite(value):
        return DASH
    if value != 0.0 and not 10.0**-MOST_DECIMALS <= abs(value) < LARGEST_WRITTEN_OUT:
        return f"{value:.{digits - 1}e}"
    exponent = math.floor(math.log10(float(f"{abs(value):.{digits - 1}e}"))) if value else 0
    return f"{value:.{max(digits - 1 - exponent, 0)}f}"


def short(value: float) -> str:
    """Return a number of at most three significant digits, a dash where it is not known."""
    return f"{value:.3g}" if math.isfinite(value) else DASH


def with_uncertainty(value: float, standard: float, scale: float = 1.0) -> str:
    """Return value +- two standard uncertainties: two digits of the uncertainty, the value rounded to match.

    Both are multiplied by `scale`; what is not known is a dash.
    """
    value, spread = scale * value, 2.0 * abs(scale * standard)
    if not math.isfinite(value):
        return DASH
    if not math.isfinite(spread):
        return f"{number(value, 5)} +- {DASH}"
    if abs(value) >= LARGEST_WRITTEN_OUT or spread >= LARGEST_WRITTEN_OUT:
        return f"{value:.4e} +- {spread:.1e}"
    least = 10.0**-MOST_DECIMALS
    if spread < least:
        return f"{value:.{MOST_DECIMALS}f} +- <{least:.{MOST_DECIMALS}f}"
    decimals = min(1 - math.floor(math.log10(float(f"{spread:.1e}"))), MOST_DECIMALS)
    shown = max(decimals, 0)
    return f"{round(value, decimals):.{shown}f} +- {round(spread, decimals):.{shown}f}"


def percent(share: float) -> str:
    """Return a share in percent, a dash where it is not known."""
    return number(100.0 * share)


def band(low_hz: float, high_hz: float) -> str:
    """Return a band of frequencies without its unit."""
    return f"{short(low_hz)}-{short(high_hz)}"


def labelled(label: str, text: str) -> str:
    """Return a label, and a text beside it."""
    return f"{label:<{LABEL - 1}} {text}".rstrip()


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of cells as lines: the first column to the left, the others to the right, under each other."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    widths[0] = max(widths[0], LABEL - 4)
    return [
        ("  " + row[0].ljust(widths[0]) + "".join("  " + c.rjust(w) for c, w in zip(row[1:], widths[1:], strict=True)))
        .rstrip()
        for row in rows
    ]  # fmt: skip


def wrapped(lines: Sequence[str]) -> str:
    """Return lines no wider than the page; what does not fit goes on below the text, not below the label."""
    indent = " " * LABEL
    return "\n".join(textwrap.fill(line, WIDTH, subsequent_indent=indent, break_on_hyphens=False) for line in lines)
