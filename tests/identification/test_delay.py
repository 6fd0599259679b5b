"""The identified delay against the latency that a virtual rig really has, and against made-up responses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_records import excite, make_info, make_specimen
from portfolio import parametrize_first

from rths_cli.control import sensor_correction
from rths_cli.identification.delay import channel_response, doubts, estimate
from rths_cli.identification.identify import identify
from rths_cli.identification.results import DelayEstimate, Identification
from rths_cli.identification.table_fit import Fit, Layout, Timing, fit, pack, response_and_slopes
from rths_cli.numerics.lti import Frf, Model, staircase
from rths_cli.rigs.description import RigInfo

FREQUENCY_HZ = np.arange(0.5, 60.0, 0.2)
LAYOUT = Layout(2, 1, 1, 7.5e-4)
START = np.append(
    pack(
        0.0079,
        np.array([[2.0 * np.pi * 3.15, 0.045], [2.0 * np.pi * 16.0, 0.6]]),
        np.array([2.0 * np.pi * 60.0]),
        np.array([[2.0 * np.pi * 3.2, 0.04]]),
    ),
    -2.0,
)


def identified(latency_samples: int, declared: int, seed: int, dt_s: float = 5e-4) -> tuple[Identification, float]:
    """Identify the default table; return what was found and the true delay in s."""
    specimen = make_specimen()
    made = excite(specimen, seed, 60.0, make_info(specimen, dt_s=dt_s, latency_samples=latency_samples))
    info = replace(made.info, latency_samples=declared)
    return identify([made.record], info, specimen.masses_kg), (latency_samples + 0.5) * dt_s


@parametrize_first(2, ("latency", "seed"), [(0, 1), (1, 2), (2, 3), (4, 4)])
def test_the_identified_delay_is_the_rigs(latency: int, seed: int) -> None:
    found, true_s = identified(latency, latency, seed)
    assert found.latency is not None
    assert found.latency.declared_s == pytest.approx(true_s)
    assert abs(found.latency.identified_s - true_s) < 2.5 * found.latency.error_s
    assert found.latency.error_s < 3e-5  # so that a tenth of a millisecond shows
    assert not [warning for warning in found.warnings if warning.startswith("delay")]


@parametrize_first(1, ("latency", "declared", "dt_s"), [(2, 1, 5e-4), (0, 1, 1e-3)])
def test_a_rig_that_lies_about_its_latency_is_found_out(latency: int, declared: int, dt_s: float) -> None:
    found, true_s = identified(latency, declared, 3, dt_s)
    assert found.latency is not None
    assert found.latency.declared_s == pytest.approx((declared + 0.5) * dt_s)
    assert abs(found.latency.identified_s - true_s) < 2.5 * found.latency.error_s
    assert found.latency.error_s < 3e-5
    said = [warning for warning in found.warnings if warning.startswith("delay")]
    assert len(said) == 1
    assert f"{1e3 * found.latency.declared_s:.3f} ms are declared" in said[0]


def made_up(delay_s: float, noise: float, seed: int = 0, latency: int = 1) -> tuple[Fit, Frf, RigInfo]:
    """Return a response of known roots and delay as a rig's channels show it, scatter `noise` per line, and a first
    fit that takes the declared delay."""
    info = make_info(make_specimen((7331.56,), (0.04,)), latency_samples=1)
    truth = fit(_blank(), LAYOUT, START, Timing(1, info.dt_s), (0.5, 60.0), ripple=True).model
    value = replace(truth, delay_s=delay_s).response(FREQUENCY_HZ)
    value += truth.ripple_m_s2_per_v * staircase(FREQUENCY_HZ, latency, info.dt_s)
    value *= channel_response(info, FREQUENCY_HZ, True)
    rng = np.random.default_rng(seed)
    scatter = rng.standard_normal((2, FREQUENCY_HZ.size)) * noise
    frf = replace(_blank(), response=value * (1.0 + scatter[0] + 1j * scatter[1]))
    frf = replace(frf, relative_error=np.full(FREQUENCY_HZ.size, max(noise, 1e-6)))
    return fit(frf, LAYOUT, START, Timing(1, info.dt_s), (0.5, 60.0), ripple=True), frf, info


def _blank() -> Frf:
    """Return the response of the layout at its start, without scatter."""
    size = FREQUENCY_HZ.size
    frf = Frf(FREQUENCY_HZ, np.ones(size, dtype=complex), np.ones(size), np.full(size, 1e-6), 100)
    s = (2j * np.pi * FREQUENCY_HZ).astype(complex)
    value, _ = response_and_slopes(LAYOUT, START, s)
    return replace(frf, response=value + START[-1] * staircase(FREQUENCY_HZ, 1, 5e-4))


@pytest.mark.parametrize("delay_s", [2.5e-4, 6.1e-4, 7.5e-4, 1.31e-3])
def test_a_made_up_delay_is_recovered(delay_s: float) -> None:
    """To 0.1 us without scatter, longer or shorter than declared."""
    first, frf, info = made_up(delay_s, 0.0, latency=max(round(delay_s / 5e-4 - 0.5), 0))
    found = estimate((first,), frf, info)
    assert found is not None
    assert found.identified_s == pytest.approx(delay_s, abs=1e-7)


@pytest.mark.campaign
def test_the_uncertainty_is_the_scatter_over_many_records() -> None:
    """25 responses with other noise: their delays scatter as stated, without the share of the channels' timing."""
    timing_s = 0.01 * 5e-4
    delays, stated = [], []
    for seed in range(25):
        first, frf, info = made_up(7.5e-4, 0.02, seed)
        found = estimate((first,), frf, info)
        assert found is not None
        delays.append(found.identified_s)
        stated.append(np.sqrt(found.error_s**2 - timing_s**2))
    assert np.std(delays) == pytest.approx(np.mean(stated), rel=0.35)
    assert abs(np.mean(delays) - 7.5e-4) < 3.0 * np.mean(stated) / 5.0


def test_a_larger_structure_counts_only_where_it_leaves_less() -> None:
    """One more lag beside the delay is not told from it: the small structure's estimate stands."""
    first, frf, info = made_up(7.5e-4, 0.005)
    layout = replace(LAYOUT, single_poles=2)
    start = np.insert(first.parameters, 5, np.log(2.0 * np.pi * 300.0))
    larger = fit(frf, layout, start, Timing(1, info.dt_s), (0.5, 60.0), ripple=True)
    alone, both, other = (estimate(fits, frf, info) for fits in ((first,), (first, larger), (larger,)))
    assert both == alone
    assert alone is not None
    assert other is None or other.error_s > 3.0 * alone.error_s
    rich = replace(frf, response=frf.response / (1.0 + 2j * np.pi * FREQUENCY_HZ / (2.0 * np.pi * 25.0)))
    poor = fit(rich, LAYOUT, first.parameters, Timing(1, info.dt_s), (0.5, 60.0), ripple=True)
    good = fit(rich, layout, np.insert(first.parameters, 5, np.log(2.0 * np.pi * 25.0)), Timing(1, info.dt_s),
               (0.5, 60.0), ripple=True)  # fmt: skip
    assert estimate((poor, good), rich, info) == estimate((good,), rich, info)


@pytest.mark.parametrize("dt_s", [5e-4, 1e-3])
def test_what_the_channel_adds_is_the_correction_times_the_sensor(dt_s: float) -> None:
    info = make_info(make_specimen(), dt_s=dt_s)
    channel, s = info.channels[0], 2j * np.pi * FREQUENCY_HZ
    high, low = 2.0 * np.pi * channel.high_pass_hz, 2.0 * np.pi * channel.low_pass_hz
    sensor = s / (s + high) / (1.0 + s / low)
    corrected = (
        sensor_correction.correction(info.channels, dt_s).response(FREQUENCY_HZ)[0, 0] * channel.sensitivity_v_per_unit
    )
    assert channel_response(info, FREQUENCY_HZ, True) == pytest.approx(sensor * corrected, rel=1e-5)
    assert channel_response(info, FREQUENCY_HZ, False) == pytest.approx(sensor, rel=1e-9)


def test_a_difference_is_said_when_it_is_large_and_clear() -> None:
    assert doubts(None) == ()
    assert doubts(DelayEstimate(7.5e-4, 1e-5, 7.5e-4)) == ()
    assert doubts(DelayEstimate(8.4e-4, 1e-5, 7.5e-4)) == ()  # clear, and less than 0.1 ms
    assert doubts(DelayEstimate(1.25e-3, 2e-4, 7.5e-4)) == ()  # large, and not clear
    assert doubts(DelayEstimate(1.25e-3, 1e-5, 7.5e-4), 2e-4) == ()  # the declared instants explain it
    assert doubts(DelayEstimate(1.25e-3, 1e-5, 7.5e-4), 5e-5)
    for identified_s in (8.6e-4, 6.4e-4):
        (said,) = doubts(DelayEstimate(identified_s, 1e-5, 7.5e-4))
        assert f"{1e3 * identified_s:.3f} +- 0.020 ms" in str(said)


def test_what_a_link_adds_is_declared() -> None:
    first, frf, info = made_up(7.5e-4, 0.0)
    found = estimate((first,), frf, replace(info, transport_s=2e-3))
    assert found is not None
    assert found.declared_s == pytest.approx(2.75e-3)
    assert isinstance(first.model, Model)
    assert found.identified_s == pytest.approx(7.5e-4, abs=1e-7)
