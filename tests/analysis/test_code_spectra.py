"""Spectra of Eurocode 8 and ASCE 7 at values worked out by hand from their formulae, and the factor to a target."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.analysis.code_spectra import asce7, compared_periods, ec8, least_squares_factor, misfit
from rths_cli.analysis.intensity import spectrum

G = 9.80665


@pytest.mark.parametrize(
    ("ground", "kind", "damping", "period_s", "expected"),
    [  # ag = 2 m/s^2
        ("B", 1, 0.05, 0.0, 2.0 * 1.2),  # ag S
        ("B", 1, 0.05, 0.075, 2.0 * 1.2 * 1.75),  # half of the way to 2.5
        ("B", 1, 0.05, 0.3, 6.0),  # 2.5 ag S
        ("B", 1, 0.05, 1.0, 3.0),  # x TC / T
        ("B", 1, 0.05, 4.0, 0.375),  # x TC TD / T^2 = 1 / 16
        ("D", 2, 0.05, 0.2, 9.0),  # 2.5 x 2 x 1.8
        ("D", 2, 0.05, 2.4, 9.0 * 0.3 * 1.2 / 5.76),
        ("A", 1, 0.10, 0.3, 5.0 * np.sqrt(10.0 / 15.0)),
        ("A", 1, 0.30, 0.3, 5.0 * 0.55),  # not below 0.55
        ("E", 1, 0.05, 0.5, 7.0),
        ("C", 2, 0.05, 0.5, 3.75),
    ],
)
def test_eurocode_8(ground: str, kind: int, damping: float, period_s: float, expected: float) -> None:
    assert ec8(np.array([period_s]), ground, 2.0, kind, damping) == pytest.approx([expected])


@pytest.mark.parametrize(
    ("period_s", "expected_g"), [(0.0, 0.4), (0.06, 0.7), (0.3, 1.0), (0.6, 1.0), (1.2, 0.5), (6.0, 0.1), (12.0, 0.025)]
)
def test_asce_7(period_s: float, expected_g: float) -> None:
    assert asce7(np.array([period_s]), 1.0, 0.6, 6.0) == pytest.approx([expected_g * G])


def test_the_factor_is_the_geometric_mean_and_the_misfit_what_remains() -> None:
    accel = np.random.default_rng(3).normal(size=2000)
    periods = compared_periods(0.2, 2.0)
    assert (periods[0], periods[-1], periods.size) == (pytest.approx(0.2), pytest.approx(2.0), 41)
    own = spectrum(accel, 0.01, periods, 0.05).sa_m_s2
    wave = np.where(np.arange(41) % 2, 1.25, 0.8)
    wave[-1] = 1.0
    assert least_squares_factor(accel, 0.01, periods, 3.0 * own * wave, 0.05) == pytest.approx(3.0)
    assert misfit(3.0 * accel, 0.01, periods, 3.0 * own / wave, 0.05) == (
        pytest.approx((20 * 0.2 + 20 * 0.25) / 41),
        pytest.approx(0.25),
    )
