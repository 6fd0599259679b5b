"""Spikes, clipping, held samples and cut ends: put into a clean motion, each is found, and nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_record_baseline import DT_S, TIME_S, case_of, load_case, motion

from rths_cli.experiment.case_warnings import baseline_note
from rths_cli.experiment.record_defects import defects
from rths_cli.experiment.setup import make_setup
from rths_cli.files.accelerograms import Accelerogram, read_accelerogram
from rths_cli.numerics.lti import Array

RECORDS = Path(__file__).parents[2] / "records"


def found(accel: Array) -> list[tuple[str, float, float]]:
    """Return code, instant and figure of each defect."""
    record = Accelerogram(DT_S, accel, "", "", "m/s^2", "", "")
    return [(one.code, one.values["at_s"], one.values["accel_m_s2"]) for one in defects(record, "own")]  # type: ignore[misc]


@pytest.mark.parametrize("seed", range(20))
def test_clean_motions_have_no_defect(seed: int) -> None:
    t = TIME_S - 3.0
    half_sine = np.where((t > 0.0) & (t < 0.1), np.sin(10.0 * np.pi * t), 0.0)  # corners are no spikes
    steps = np.round(motion(seed), 2)  # few digits: equal samples mean nothing
    noise = np.random.default_rng(seed).normal(size=TIME_S.size) * np.exp(-(((TIME_S - 9.0) / 4.0) ** 2))
    rest = np.where(TIME_S < 21.0, np.where(TIME_S < 19.0, motion(seed), 0.0), 0.3)  # rest, then a baseline that steps
    assert found(motion(seed)) == found(half_sine) == found(steps) == found(noise) == found(rest) == []


@pytest.mark.parametrize("name", ["el_centro", "hachinohe"])
def test_shipped_records_have_no_defect(name: str) -> None:
    assert defects(read_accelerogram(RECORDS / f"{name}.csv"), name) == ()


@pytest.mark.parametrize("size", [0.8, -3.0])
def test_spikes_are_found_at_their_instants(size: float) -> None:
    accel = motion()
    accel[[900, 1300, 300]] += np.array([1.5, 1.0, 1.2]) * size
    ((code, at_s, value),) = found(accel)
    assert (code, at_s) == ("record.spikes", 9.0) and value == pytest.approx(accel[900])
    record = Accelerogram(DT_S, accel, "", "", "m/s^2", "", "")
    assert "own has 3 spikes, the largest" in str(defects(record, "own")[0])


def test_clipping_is_found_at_the_level_of_the_recorder() -> None:
    whole = motion()
    clipped = np.clip(whole, -0.8, 0.75)
    told = {round(value, 9): code for code, _, value in found(clipped)}
    assert told == {0.75: "record.clipped", -0.8: "record.clipped"}


def test_samples_that_were_held_are_found() -> None:
    accel = motion()
    first = int(np.argmax(np.abs(accel) > 0.5)) + 3
    accel[first : first + 40] = accel[first]
    ((code, at_s, value),) = found(accel)
    assert (code, value) == ("record.held", accel[first]) and at_s == pytest.approx(first * DT_S)


def test_a_crest_that_was_held_for_long_needs_no_jump() -> None:
    time_s = np.arange(0.0, 20.0, DT_S)
    accel = 2.0 * np.sin(2.0 * np.pi * 0.4 * time_s) * np.exp(-(((time_s - 9.0) / 4.0) ** 2))
    crest = int(np.argmax(accel)) - 60
    accel[crest : crest + 40] = accel[crest]
    told = found(accel)
    assert [code for code, *_ in told] == ["record.held"]


def test_a_record_that_was_cut_within_its_motion_is_told() -> None:
    accel = motion()[: 100 + int(np.argmax(np.abs(motion())))]
    accel = accel[: int(np.flatnonzero(np.abs(accel) > 0.4)[-1]) + 1]
    ((code, at_s, value),) = found(accel)
    assert (code, value) == ("record.cut", accel[-1]) and at_s == pytest.approx((accel.size - 1) * DT_S)


def test_a_case_warns_of_the_defects_of_its_record(tmp_path: Path) -> None:
    accel = motion()
    accel[900] += 3.0
    setup = make_setup(load_case(case_of(tmp_path, accel, baseline="none")))
    (told,) = baseline_note(setup)
    assert str(told).startswith(f"{tmp_path}/own.yaml:1:") and "record: own has 1 spike, the largest" in str(told)
