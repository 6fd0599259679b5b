"""Offset, drift and jumps of channels. Oracle: they are added here, to noise, rounding and leftovers of motion."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rths_cli.analysis.sensor_drift import MOST_JUMPS, channel_drifts, coupled_again
from rths_cli.control.sensor_correction import correction
from rths_cli.loop.block_replay import run_block
from rths_cli.rigs.description import Channel

DT_S, SAMPLES, BIT = 1e-3, 58_000, 3e-3
JUMP = 0.049  # 5 mV at 1000 mV/g


def left_over(seed: int, share: float = 1.0) -> np.ndarray:
    """Return what three healthy channels show beside the model: modes it misses by a little, friction, noise."""
    random = np.random.default_rng(seed)
    time_s = DT_S * np.arange(SAMPLES)
    envelope = np.hanning(SAMPLES)
    waves = [
        share * 3e-3 * size * envelope * np.sin(2 * np.pi * (f * time_s + random.random()))
        for f, size in ((0.9, 0.3), (2.3, 1.0), (7.1, 0.5))
    ]
    friction = np.zeros(SAMPLES)
    for at in random.integers(3000, SAMPLES - 3000, 150):
        friction[at : at + 300] += (
            random.choice([-1, 1]) * 0.08 * np.exp(-np.arange(300) / 8.0) * np.cos(np.arange(300) / 10.0)
        )
    series = np.array([sum(waves) + friction, sum(waves), 0.8 * sum(waves)])
    return np.asarray(np.round((series + 1e-3 * random.standard_normal(series.shape)) / BIT) * BIT)


def found(series: np.ndarray) -> tuple:
    return channel_drifts(series, DT_S, [BIT] * len(series))


@pytest.mark.parametrize("seed", range(3))
def test_healthy_channels_have_nothing(seed: int) -> None:
    for channel in found(left_over(seed, 5.0)):
        assert not channel.drifts and channel.jumps == () and channel.unusable_from is None


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize(("rate_per_min", "size"), [(0.005, JUMP), (-0.05, -JUMP)])
def test_offset_drift_and_jump_of_a_channel_are_found_and_no_other(
    channel: int, rate_per_min: float, size: float
) -> None:
    random = np.random.default_rng(channel)
    series, at = left_over(channel + 10), int(random.integers(4000, SAMPLES - 4000))
    series[channel] += JUMP + rate_per_min / 60.0 * DT_S * np.arange(SAMPLES)
    series[channel, at:] += size
    all_found = found(series)
    for other, one in enumerate(all_found):
        assert one.unusable_from is None
        assert one.drifts == (other == channel) and len(one.jumps) == (other == channel)
    one = all_found[channel]
    middle = JUMP + rate_per_min / 60.0 * DT_S * one.middle
    assert one.offset == pytest.approx(middle, abs=2e-3)
    assert one.rate == pytest.approx(rate_per_min / 60.0, abs=4.0 * one.rate_uncertainty)
    assert one.rate_uncertainty < 2e-5
    assert one.jumps[0].size == pytest.approx(size, rel=0.05)
    assert abs(one.jumps[0].at - at) * DT_S < 0.01
    shown = series[channel] - one.shown(SAMPLES, DT_S)
    assert np.abs(shown.reshape(-1, 1000).mean(axis=1)).max() < 5e-3


def test_what_all_channels_show_is_motion_and_no_jump() -> None:
    series = left_over(20)
    series[:, 30_000:] += JUMP
    assert all(channel.jumps == () and channel.unusable_from is None for channel in found(series))


def test_a_level_that_changes_without_an_edge_makes_a_channel_unusable_from_there() -> None:
    series = left_over(21)
    series[1, 30_000:] += JUMP * np.clip(np.arange(28_000) / 1500.0, 0.0, 1.0)
    one = found(series)[1]
    assert one.unusable_from is not None and 28.5 < one.unusable_from * DT_S < 30.8
    assert found(series)[0].unusable_from is None


def test_two_channels_that_jump_at_different_instants_are_both_dated() -> None:
    series = left_over(22)
    series[0, 12_345:] += JUMP
    series[2, 40_001:] -= JUMP
    first, second, third = found(series)
    assert abs(first.jumps[0].at - 12_345) < 10 and abs(third.jumps[0].at - 40_001) < 10 and second.jumps == ()


def test_the_coupling_put_back_undoes_the_steps_correction() -> None:
    channels = (
        Channel("a", 0.1, 50.0, 0.3, 0.0),
        Channel("b", 0.1, 50.0, 0.024, 0.0),
        Channel("c", 0.1, 50.0, 0.0, 0.0),
    )
    series = left_over(23) + 0.01
    corrected = run_block(correction(channels, DT_S), 0.1 * series)
    assert np.abs(corrected - series).max() > 0.01
    corners = [channel.high_pass_hz for channel in channels]
    assert_allclose(coupled_again(corrected, corners, DT_S), series, rtol=0, atol=1e-9)


def test_a_run_too_short_for_levels_still_has_its_line() -> None:
    series = left_over(24)[:, :3000] + 0.05
    assert all(channel.drifts and channel.jumps == () for channel in found(series))


def test_channels_that_show_nothing_at_all_on_a_converter_without_bits_have_nothing() -> None:
    with np.errstate(all="raise"):
        for channel in channel_drifts(np.zeros((3, SAMPLES)), DT_S, [0.0] * 3):
            assert not channel.drifts and channel.jumps == () and channel.unusable_from is None


def test_a_channel_that_jumps_too_often_is_not_usable_from_the_first_jump_on_not_from_the_largest() -> None:
    series = left_over(5)
    places = np.linspace(0.1, 0.9, MOST_JUMPS) * SAMPLES
    for number, at in enumerate(places.astype(int)):
        series[1, at:] += JUMP * (-1) ** number * (1.0 + 0.5 * number)
    one = found(series)[1]
    assert one.unusable_from is not None and one.unusable_from <= places[0]
