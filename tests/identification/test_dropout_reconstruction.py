"""Lost samples put back: a known system's output, with holes, against the output without them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from rths_cli.errors import InputError
from rths_cli.identification.record_parts import clusters, filled
from rths_cli.numerics.lti import Array

DT_S, N = 1e-3, 12_000
NOISE = 1e-3


def made(seed: int) -> tuple[Array, Array]:
    """Return a command (n,) and two channels (2, n) of resonances at 3.2 and 8.4 Hz, by scipy, with noise."""
    rng = np.random.default_rng(seed)
    low = signal.butter(2, 30.0, fs=1 / DT_S, output="sos")
    command = signal.sosfilt(low, rng.standard_normal(N))
    channels = []
    for hz, ratio in ((3.2, 0.04), (8.4, 0.03)):
        w = 2 * np.pi * hz
        b, a, _ = signal.cont2discrete(([w * w], [1, 2 * ratio * w, w * w]), DT_S, "foh")
        channels.append(signal.lfilter(b.ravel(), a, command))
    whole = np.array(channels)
    return command, whole / whole.std(axis=1, keepdims=True) + NOISE * rng.standard_normal((2, N))


def holes(seed: int) -> Array:
    """Return where samples are missing: stalls of 1 to 8, about 1 % in all, two close together, one at the end."""
    rng, missing = np.random.default_rng(seed), np.zeros(N, dtype=bool)
    for start in rng.integers(100, N - 100, 25):
        missing[start : start + rng.integers(1, 9)] = True
    missing[5000:5004] = missing[5010:5012] = missing[-2:] = True
    return missing


def test_what_is_put_back_is_what_was_there_to_a_few_times_the_noise() -> None:
    command, whole = made(1)
    missing = holes(2)
    seen = np.where(missing, 7.0, whole)
    found = filled(command, seen, missing, DT_S)
    error = (found - whole)[:, missing]
    assert np.sqrt((error**2).mean()) < 4 * NOISE
    assert np.array_equal(found[:, ~missing], whole[:, ~missing])
    straight = np.array([np.interp(np.arange(N), np.flatnonzero(~missing), c[~missing]) for c in whole])
    assert np.abs(found - whole)[:, missing].max() < 0.5 * np.abs(straight - whole)[:, missing].max() + 5 * NOISE


def test_what_stood_where_samples_are_missing_does_not_matter() -> None:
    command, whole = made(3)
    missing = holes(4)
    one, other = (filled(command, np.where(missing, junk, whole), missing, DT_S) for junk in (0.0, 1e3))
    assert one == pytest.approx(other, abs=1e-9)


def test_a_whole_record_stays_as_it_is() -> None:
    command, whole = made(5)
    assert filled(command, whole, np.zeros(N, dtype=bool), DT_S) is whole


def test_too_many_lost_samples_are_refused_with_what_to_do() -> None:
    command, whole = made(6)
    missing = np.zeros(N, dtype=bool)
    missing[::10] = True
    with pytest.raises(InputError, match=r"1200 of 12000 samples \(10\.0 %\) were lost on the link, at most 5 %"):
        filled(command, whole, missing, DT_S)
    missing[:] = False
    missing[::30] = True  # 3 %, but no row of a prediction is whole
    with pytest.raises(InputError, match="were lost on the link"):
        filled(command, whole, missing, DT_S)


def test_clusters_are_apart_by_more_than_a_prediction_looks_back() -> None:
    assert [list(c) for c in clusters(np.array([3, 4, 14, 25, 26]), 10)] == [[3, 4, 14], [25, 26]]
