"""Where the identified band ends: at the frequency from which on the response shows nothing but noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.identify_table import coherent_up_to
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.numerics.lti import Frf

DT, SEGMENT_S, TURN_HZ, HIGHEST_HZ = 1.0 / 500.0, 4.0, 30.0, 60.0


def with_coherence(above: float, length_s: float, periods: int = 0) -> Frf:
    """Return the response of a gain of one, with a coherence of 1 below 30 Hz and of `above` beyond."""
    random, n = np.random.default_rng(3), round(length_s / DT)
    command = np.tile(random.standard_normal(n // periods), periods) if periods else random.standard_normal(n)
    low, high = (signal.butter(8, TURN_HZ, kind, fs=1.0 / DT, output="sos") for kind in ("lowpass", "highpass"))
    noise = signal.sosfiltfilt(high, random.standard_normal(n))
    answer = signal.sosfiltfilt(low, command) + noise
    if above > 0.0:
        answer = command + np.sqrt(1.0 / above - 1.0) * noise
    record = Record(command, answer[None], Parts(slice(0, n), period_samples=n // periods if periods else 0))
    return estimate([record], DT, (1.0, HIGHEST_HZ), SEGMENT_S, "h1")[0]


@pytest.mark.parametrize("above", [0.35, 0.6])
def test_a_noisy_response_is_used(above: float) -> None:
    assert coherent_up_to(with_coherence(above, 120.0), HIGHEST_HZ) == HIGHEST_HZ


@pytest.mark.parametrize("length_s", [16.0, 30.0, 120.0])
def test_noise_alone_is_not_used(length_s: float) -> None:
    """Also with the fewest averages that a record may have, four segments."""
    assert TURN_HZ / 1.3 < coherent_up_to(with_coherence(0.0, length_s), HIGHEST_HZ) < TURN_HZ * 1.3


@pytest.mark.parametrize("periods", [3, 4, 8])
def test_noise_alone_is_not_used_with_few_periods(periods: int) -> None:
    """Periods do not overlap: the coherence of noise alone is 1 / 3 in the mean with three of them."""
    assert TURN_HZ / 1.3 < coherent_up_to(with_coherence(0.0, 20.0 * periods, periods), HIGHEST_HZ) < TURN_HZ * 1.3
