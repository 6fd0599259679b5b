"""Tracking fidelity: frequency evaluation index (amplitude ratio and delay) and tracking indicator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rths_cli.analysis.metrics.lowest_fourier_lines import low_lines
from rths_cli.analysis.metrics.response_errors import check_pair
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.numerics.lti import Array, ComplexArray


@dataclass(frozen=True)
class FrequencyEvaluation:
    """Frequency evaluation index (FEI)."""

    amplitude: float  # amplitude ratio, 1: exact
    delay_s: float  # positive: late; within half a period of `frequency_hz`, because whole turns of phase are unknown
    frequency_hz: float  # equivalent frequency, the mean of the lines weighted by the power of the desired series


def frequency_evaluation(
    desired: ArrayLike, measured: ArrayLike, dt_s: float, high_hz: float = TEST_BAND_HZ
) -> FrequencyEvaluation:
    """Return the frequency evaluation index of `measured` (n,) against `desired` (n,), both in the same unit.

    FEI = sum (Y / X) |X|^2 / sum |X|^2, summed over the lines 0 < f <= `high_hz` of the discrete Fourier transforms X
    of desired and Y of measured. The amplitude is |FEI|, the frequency sum f |X|^2 / sum |X|^2, and the delay
    -arg(FEI) / (2 pi frequency). All are NaN if `desired` has no power on these lines or a series is not finite. Raises
    InputError if the lengths differ. Source: Guo, Chen, Xu, Sanchez, Smart Mater. Struct. 23 (2014) 045042,
    with the power l = 2.
    """
    return frequency_evaluations(desired, (measured,), dt_s, high_hz)[0]


def frequency_evaluations(
    desired: ArrayLike, measured: Sequence[ArrayLike], dt_s: float, high_hz: float = TEST_BAND_HZ
) -> list[FrequencyEvaluation]:
    """Return `frequency_evaluation` of several series (n,) against one; that one is transformed only once."""
    pairs = [check_pair(desired, each) for each in measured]
    n = len(pairs[0][0])
    frequency = np.arange(n // 2 + 1) / (n * dt_s)
    frequency = frequency[(frequency > 0) & (frequency <= high_hz)]
    X, *others = low_lines(np.stack([pairs[0][0], *(y for _, y in pairs)]), len(frequency) + 1, n)[:, 1:]
    return [_evaluation(X, Y, frequency) for Y in others]


def _evaluation(X: ComplexArray, Y: ComplexArray, frequency_hz: Array) -> FrequencyEvaluation:
    """Return the frequency evaluation index of Fourier lines Y (m,) against X (m,)."""
    power = np.abs(X) ** 2
    total = power.sum()
    if not (total > 0 and np.isfinite(Y).all()):
        return FrequencyEvaluation(np.nan, np.nan, np.nan)
    index = np.sum(np.conj(X) * Y) / total
    equivalent = float(np.sum(frequency_hz * power) / total)
    return FrequencyEvaluation(float(np.abs(index)), float(-np.angle(index)) / (2 * np.pi * equivalent), equivalent)


def tracking_indicator(desired: ArrayLike, measured: ArrayLike) -> Array:
    """Return the tracking indicator (n,) of `measured` (n,) against `desired` (n,), in their unit squared.

    TI = (A - TA) / 2 with the areas A = int x dy and TA = int y dx of the plot of measured y over desired x, by the
    trapezoidal rule. It increases while the table is late and decreases while it is early. Raises InputError if the
    lengths differ. Source: Mercan and Ricles, Earthquake Eng. Struct. Dyn. 36 (2007) 1523.
    """
    x, y = check_pair(desired, measured)
    return 0.5 * np.concatenate([[0.0], np.cumsum(x[:-1] * y[1:] - x[1:] * y[:-1])])
