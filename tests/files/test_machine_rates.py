"""Measured rates are kept per machine and rig, and a higher rate that was held answers for a lower one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rths_cli.files import machine_rates
from rths_cli.files.machine_rates import RateMeasured, held_rate, keep_rates

GOOD = RateMeasured(1000.0, 3000, 0.1, 20.0, 200.0, 900.0, 0, 0, "2026-01-01T00:00:00+00:00")


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "rths" / "held_rates.json"


def test_what_is_held_follows_the_rule_at_its_edges() -> None:
    assert GOOD.held
    assert replace(GOOD, late=15, p99_us=500.0).held
    assert not replace(GOOD, late=16).held
    assert not replace(GOOD, p99_us=500.1).held
    assert replace(GOOD, p99_us=125.0, share=0.125).held and not replace(GOOD, p99_us=126.0, share=0.125).held
    assert replace(GOOD, rate_hz=2000.0, p99_us=250.0).held and not replace(GOOD, rate_hz=2000.0, p99_us=251.0).held


def test_rates_are_read_back_for_the_rig_they_were_measured_with() -> None:
    bad = replace(GOOD, late=500, rate_hz=2000.0)
    keep_rates([GOOD, bad])
    keep_rates([replace(GOOD, p99_us=44.0)], "lab")
    assert held_rate(1000.0) == GOOD and held_rate(2000.0) == bad
    assert held_rate(1000.0, "lab") == replace(GOOD, p99_us=44.0)
    assert held_rate(2000.0, "lab") is None and held_rate(1000.0, "other") is None


def test_a_higher_rate_that_was_held_answers_and_one_that_was_not_does_not() -> None:
    keep_rates([replace(GOOD, rate_hz=4000.0, p99_us=5.0), replace(GOOD, rate_hz=2000.0, late=500)])
    assert held_rate(1000.0) == replace(GOOD, rate_hz=4000.0, p99_us=5.0)
    assert held_rate(5000.0) is None


def test_a_new_measurement_replaces_the_old_one() -> None:
    keep_rates([GOOD])
    keep_rates([replace(GOOD, late=900)])
    found = held_rate(1000.0)
    assert found is not None and not found.held


def test_another_kernel_or_machine_was_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    keep_rates([GOOD])
    monkeypatch.setattr(machine_rates.platform, "release", lambda: "9.9.9-rt")
    assert held_rate(1000.0) is None


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "null", '{"a": 1}', '{"HERE": {"1000": {"rate_hz": 1}}}', '{"HERE": {"1": 2}}']
)
def test_a_damaged_or_foreign_file_counts_as_nothing_measured(own_cache: Path, text: str) -> None:
    keep_rates([GOOD])
    (here,) = json.loads(own_cache.read_text())  # the name of this machine and kernel
    own_cache.write_text(text.replace("HERE", here))
    assert held_rate(1000.0) is None
    keep_rates([GOOD])
    assert held_rate(1000.0) == GOOD


def test_a_cache_that_cannot_be_written_is_no_fault(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    keep_rates([GOOD])
    assert held_rate(1000.0) is None
