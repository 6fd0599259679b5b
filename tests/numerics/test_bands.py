"""Test band and compared band: usual values bit for bit, and what keeps its ratio to them."""

from __future__ import annotations

import pytest

from rths_cli.numerics.bands import USUAL, ComparedBand, with_test_band


def test_the_usual_bands_change_nothing() -> None:
    """Every usual frequency comes back bit for bit, whatever it is."""
    for hz in (0.1, 0.3, 0.7, 1.0 / 3.0, 7.0, 11.0, 15.0, 40.0, 1e3 / 7.0):
        assert with_test_band(hz, 12.0) == USUAL.with_low(hz) == USUAL.with_high(hz) == hz
    assert USUAL.hz == (0.7, 11.0) and USUAL.mid_hz == (2.0, 10.0) and str(USUAL) == "0.7-11 Hz"
    assert USUAL.edges_hz == (0.7, 2.0, 5.0, 11.0, 20.0, 40.0, 60.0)


def test_other_bands_keep_the_ratios() -> None:
    band = ComparedBand(1.4, 33.0)
    assert with_test_band(40.0, 30.0) == pytest.approx(100.0)
    assert band.with_low(0.35) == pytest.approx(0.7) and band.with_high(12.0) == pytest.approx(36.0)
    assert band.mid_hz == pytest.approx((4.0, 30.0)) and str(band) == "1.4-33 Hz"
    assert band.edges_hz == pytest.approx((1.4, 4.0, 15.0, 33.0, 60.0, 120.0, 180.0))


def test_the_narrowest_band_that_a_case_may_state_has_its_parts_in_order() -> None:
    edges = ComparedBand(1.0, 8.0).edges_hz
    assert list(edges) == sorted(set(edges))
