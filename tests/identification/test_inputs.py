"""Records in one hand: transformed once, cut into segments that suit them, compared in level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_records import make_info, make_specimen
from numpy.testing import assert_allclose

from rths_cli.identification.inputs import Evidence, IdentificationSettings, evidence
from rths_cli.identification.record_parts import Parts, Record, padded

DT = 5e-4
SPECIMEN = make_specimen()
INFO = make_info(SPECIMEN)


def record(seconds: float, segment_samples: int = 0, size: float = 1.0) -> Record:
    """Return noise of a given length on every channel, after a second of near silence."""
    n, random = round(seconds / DT), np.random.default_rng(4)
    values = size * random.standard_normal((4, n))
    values[:, : round(1.0 / DT)] *= 1e-3
    parts = Parts(slice(round(1.0 / DT), n), slice(0, round(1.0 / DT)), None, 0, segment_samples)
    return Record(values[0], values[1:], parts)


def gathered(*records: Record, quiet: Record | None = None) -> Evidence:
    return evidence(records, quiet, INFO, SPECIMEN.masses_kg, IdentificationSettings())


@pytest.mark.parametrize(
    ("seconds", "segment_s", "expected_s"),
    [(141.0, 0.0, 20.0), (51.0, 0.0, 10.0), (141.0, 1.0, 4.0), (141.0, 6.0, 6.0)],
)
def test_segments_suit_the_shortest_record(seconds: float, segment_s: float, expected_s: float) -> None:
    found = gathered(record(seconds, round(segment_s / DT)), record(200.0))
    assert found.settings.segment_s == pytest.approx(expected_s)
    assert found.longest_s == pytest.approx(min(20.0, (seconds - 1.0) / 5.0))


def test_level_ratio_is_that_of_the_tables_rms() -> None:
    assert gathered(record(60.0)).level_ratio == np.inf
    assert gathered(record(60.0), quiet=record(60.0, size=0.25)).level_ratio == pytest.approx(4.0)


def test_band_ends_where_it_is_told_to() -> None:
    found = gathered(record(60.0)).up_to(33.0)
    assert found.settings.band_hz == (IdentificationSettings().band_hz[0], 33.0)


def test_a_command_is_transformed_once() -> None:
    made = record(60.0)
    count = padded(len(made.command_v), DT)
    lines = made.command_lines(count, DT)
    assert count >= len(made.command_v) + round(30.0 / DT)
    whole = np.concatenate([made.command_v, np.zeros(count - len(made.command_v))])
    assert_allclose(lines.values, np.fft.rfft(whole), rtol=0, atol=1e-9, equal_nan=False)
    assert made.command_lines(count, DT).values is lines.values
    half = made.excited_in(slice(2000, 60000))
    assert half.parts == replace(made.parts, noise=slice(2000, 60000))
    assert half.command_lines(count, DT).values is lines.values
    other = replace(made, command_v=2.0 * made.command_v)
    assert_allclose(other.command_lines(count, DT).values, 2.0 * lines.values, rtol=1e-6, equal_nan=False)
