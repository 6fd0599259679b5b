"""A record with an offset, a drift, a step or a wrong first sample: the cause, what it does, the key that mends it.

Oracles: records made of known parts; the analogue high pass from rest turns a constant c into c / w^2 (1 + e^-pi) of
displacement, a slope s into s (T - sqrt(2) / w) / w^2 at the end.
Refusals are those of `make_setup`, which every command calls.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from rths_cli.case.case_schema import Case
from rths_cli.case.load import load_cases
from rths_cli.cli.entry_point import cli
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import baseline_note
from rths_cli.experiment.check_command import check_cases
from rths_cli.experiment.setup import Setup, make_setup, motion_key
from rths_cli.numerics.lti import Array

PEAK_M_S2, DT_S, LENGTH_S = 1.3, 0.01, 24.0
CORNER = 2.0 * math.pi * 0.25
TIME_S = np.arange(round(LENGTH_S / DT_S)) * DT_S


def motion(seed: int = 5) -> Array:
    """Return an acceleration (n,) that begins and ends at rest and has no mean: a sum of smooth bursts."""
    draw = np.random.default_rng(seed)
    whole = np.zeros(TIME_S.size)
    for _ in range(12):
        hz, at_s, phase = draw.uniform(1.5, 6.0), draw.uniform(5.0, 14.0), draw.uniform(0.0, 2.0 * math.pi)
        whole += draw.normal() * np.sin(2.0 * math.pi * hz * TIME_S + phase) * np.exp(-(((TIME_S - at_s) / 1.5) ** 2))
    return np.asarray(PEAK_M_S2 * whole / np.abs(whole).max())


def case_of(folder: Path, accel: Array, **record: object) -> Path:
    np.savetxt(
        folder / "own.csv", np.column_stack([TIME_S, accel]), "%.7f", ",", header="time_s,accel_m_s2", comments=""
    )
    case = {
        "structure": "three_storey", "damping": "low", "record": {"file": "own.csv", **record}, "scaling": 1.0,
        "controller": "FF+FB",
    }  # fmt: skip
    path = folder / "own.yaml"
    path.write_text(json.dumps(case))
    return path


def load_case(path: Path, settings: Sequence[str] = ()) -> Case:
    return load_cases([path], settings)[0]


def setup_of(folder: Path, accel: Array, **record: object) -> Setup:
    return make_setup(load_case(case_of(folder, accel, **record)))


def refusal_of(folder: Path, accel: Array, **record: object) -> str:
    with pytest.raises(InputError) as caught:
        setup_of(folder, accel, **record)
    (told,) = caught.value.faults
    return told


def displacement_mm(sentence: str) -> float:
    return float(sentence.split(" mm of ground displacement")[0].rpartition(" ")[2])


@pytest.mark.parametrize("offset", [0.3, -0.12])
def test_an_offset_is_refused_with_its_effect_and_the_key_that_mends_it(tmp_path: Path, offset: float) -> None:
    told = refusal_of(tmp_path, motion() + offset)
    assert told.startswith(f"{tmp_path}/own.yaml:1:") and "record: own has an offset" in told
    assert f"first sample {offset:g} m/s^2, mean {offset:g}" in told
    assert "record: {file: own.csv, baseline: mean}" in told and "the table would be kicked" in told
    settled = abs(offset) / CORNER**2 * (1.0 + math.exp(-math.pi))
    assert displacement_mm(told) == pytest.approx(1e3 * settled, rel=0.02)


def test_the_stated_key_removes_the_offset(tmp_path: Path) -> None:
    clean, mended = setup_of(tmp_path, motion()), setup_of(tmp_path, motion() + 0.3, baseline="mean")
    assert mended.motion.accel_m_s2 == pytest.approx(clean.motion.accel_m_s2, abs=2e-4)
    assert mended.baseline is None is clean.baseline


def test_a_drift_is_told_and_its_key_mends_it(tmp_path: Path) -> None:
    drifting = motion() + 0.4 * TIME_S / LENGTH_S
    told = str(setup_of(tmp_path, drifting).baseline)
    assert (
        "own has a baseline that drifts; state baseline: linear" in told
        and "first sample 0 m/s^2" in told
        and "baseline: linear}" in told
    )
    lag_s = math.sqrt(2.0) / CORNER
    assert displacement_mm(told) == pytest.approx(1e3 * 0.4 * (1.0 - lag_s / LENGTH_S) / CORNER**2, rel=0.01)
    mended = setup_of(tmp_path, drifting, baseline="linear")
    assert mended.motion.displacement_m == pytest.approx(setup_of(tmp_path, motion()).motion.displacement_m, abs=5e-4)
    assert mended.baseline is None


def test_a_step_is_told_with_its_instant_and_no_key_that_would_not_mend_it(tmp_path: Path) -> None:
    told = str(setup_of(tmp_path, motion() + 0.2 * (TIME_S >= 9.0)).baseline)
    size, at_s = told.split("steps by ")[1].split(" m/s^2 at ")
    assert float(size) == pytest.approx(0.2, rel=0.05) and float(at_s.split(" s")[0]) == pytest.approx(9.0, abs=0.3)
    assert "baseline: mean" not in told and "baseline: linear" not in told and "piece by piece" in told


def test_a_wrong_first_sample_is_refused_and_named(tmp_path: Path) -> None:
    accel = motion()
    accel[0] = 0.5
    told = refusal_of(tmp_path, accel)
    assert "sample 1 of the record reads 0.5 m/s^2" in told and "offset" not in told


def test_a_zero_before_an_offset_is_no_rest(tmp_path: Path) -> None:
    accel = motion() + 0.3
    accel[0] = 0.0
    told = refusal_of(tmp_path, accel)
    assert "has an offset" in told and "first remove the zero before it" in told


def test_a_record_cut_within_its_motion_is_refused(tmp_path: Path) -> None:
    accel = np.where(TIME_S < 20.0, np.roll(motion(), -800), 0.0)
    assert "the record begins at" in refusal_of(tmp_path, accel)
    accel += 0.6 * np.sin(2 * np.pi * 20.0 * TIME_S + 0.9) * (TIME_S < 12.0)  # a few samples a period
    assert "the record begins at" in refusal_of(tmp_path, accel)


@pytest.mark.parametrize(("share", "runs"), [(0.019, True), (0.021, False)])
def test_the_first_filtered_sample_may_be_2_percent_of_the_peak(tmp_path: Path, share: float, runs: bool) -> None:
    accel = motion()
    accel[0] = share * PEAK_M_S2
    if runs:
        assert setup_of(tmp_path, accel).baseline is None
    else:
        assert "2 % is allowed" in refusal_of(tmp_path, accel)


def test_none_keeps_the_motion_as_it_is(tmp_path: Path) -> None:
    setup = setup_of(tmp_path, motion() + 0.3, baseline="none")
    assert setup.motion.accel_m_s2[0] == pytest.approx(0.3, rel=0.01)
    assert "has an offset" in str(setup.baseline) and baseline_note(setup) == ()


def test_nothing_is_changed_without_the_key(tmp_path: Path) -> None:
    drifting = motion() + 0.4 * TIME_S / LENGTH_S
    stated = setup_of(tmp_path, drifting, baseline="none")
    assert np.array_equal(setup_of(tmp_path, drifting).motion.accel_m_s2, stated.motion.accel_m_s2)
    assert baseline_note(setup_of(tmp_path, drifting))


def test_cases_that_differ_in_the_baseline_alone_share_no_motion(tmp_path: Path) -> None:
    keys = {motion_key(load_case(case_of(tmp_path, motion(), baseline=one))) for one in ("mean", "linear", "none")}
    assert len(keys) == 3


def test_a_record_of_an_offset_alone_leaves_no_motion(tmp_path: Path) -> None:
    assert "record.baseline: mean leaves no motion" in refusal_of(tmp_path, np.full(TIME_S.size, 0.3), baseline="mean")


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(20))
def test_clean_records_and_one_sided_pulses_are_not_doubted(tmp_path: Path, seed: int) -> None:
    pulse = np.where((seed < TIME_S) & (seed + 1.0 > TIME_S), np.sin(math.pi * (TIME_S - seed)), 0.0)
    assert setup_of(tmp_path, motion(seed)).baseline is None is setup_of(tmp_path, 0.3 * pulse).baseline


@pytest.mark.parametrize("name", ["el_centro", "hachinohe"])
def test_shipped_records_are_not_doubted(name: str) -> None:
    result = CliRunner().invoke(cli, ["records", name, "--json"])
    assert json.loads(result.stdout)["baseline_doubt"] == ""


def test_records_lists_the_baseline_and_shows_the_record_without_it(tmp_path: Path) -> None:
    case_of(tmp_path, motion() + 0.3)
    told = {key: CliRunner().invoke(cli, ["records", str(tmp_path / "own.csv"), "--baseline", key]).stdout for key in
            ("none", "mean")}  # fmt: skip
    assert "baseline     mean 0.3 m/s^2" in told["none"] and "doubt        record: own has an offset" in told["none"]
    assert "baseline     mean 0 m/s^2" in told["mean"] and "doubt" not in told["mean"]


@pytest.mark.campaign
def test_the_check_names_the_baseline_and_not_the_stroke(tmp_path: Path) -> None:
    path = case_of(tmp_path, motion() + 0.4 * TIME_S / LENGTH_S)
    (checked,) = check_cases([load_case(path)], (), lambda _: None)
    assert checked.verdict == "unsafe" and "a baseline that drifts" in checked.reasons[0]
    assert not any("limits.stroke_m" in reason or "largest safe scaling" in reason for reason in checked.reasons)
    (mended,) = check_cases([load_case(path, ["record.baseline=linear"])], (), lambda _: None)
    assert not any("baseline" in each for each in (*mended.reasons, *mended.warnings))
