"""Buildings, rates and converters of every kind through identify, check and run: what ended in an internal error once,
and a small sample of the benchmark of random cases."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from campaigns.random_case_draw import make_records
from campaigns.random_case_runs import RAN, REFUSED, judged
from scipy.linalg import eigh

from rths_cli.case.load import load_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.identification import identify_specimen
from rths_cli.identification.specimen_fit import Start

ONE_STOREY = {
    "numerical": {"masses_kg": [7.0], "stiffness_n_per_m": [8000.0]},
    "experimental": {"masses_kg": [7.0], "stiffness_n_per_m": [110539.57], "damping_ratios": [0.03]},
}
COARSE = {
    "numerical": {"masses_kg": [14.8, 9.9], "stiffness_n_per_m": [12e4, 9e4]},
    "experimental": {
        "masses_kg": [8.71, 3.99],
        "stiffness_n_per_m": [35505.0, 55589.0],
        "damping_ratios": [0.058, 0.023],
    },
}
SEVEN_FLOORS = {
    "numerical": {
        "masses_kg": [2.915, 4.828, 5.783, 5.712, 2.732],
        "stiffness_n_per_m": [27671.0, 36086.0, 25125.0, 40673.0, 56214.0],
    },
    "experimental": {
        "masses_kg": [2.211, 2.293, 1.620, 1.975, 2.910, 1.179, 1.353],
        "stiffness_n_per_m": [2181.4, 2585.1, 3538.9, 5171.2, 3074.7, 5204.2, 6749.2],
        "damping_ratios": [0.0298, 0.0456, 0.056, 0.0277, 0.0393, 0.0477, 0.0371],
    },
    "interface_experimental_mass_kg": 0.619,
}
SATURATING = {
    "extends": "aps400_virtual",
    "converters": {"bits": 12, "latency_samples": 3},
    "physics": {"force_limit_n": 174.0, "loop_specimen_mass_kg": 22.9, "moving_mass_kg": 8.94},
}


def run(folder: Path, **keys: object) -> Ended:
    """Run EXP-RTHS of a case whose libraries may not warn."""
    path = folder / "case.yaml"
    path.write_text(json.dumps({"record": "el_centro", "scaling": 0.2, "runs": ["exp_rths"], **keys}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return run_case(make_setup(load_cases([path])[0]), folder / "case.h5", Memory(), "test", lambda _: None)


@pytest.mark.campaign
@pytest.mark.parametrize("rate_hz", [500.0, 2000.0])
def test_a_stiff_storey_whose_free_vibration_dies_at_once(rate_hz: float, tmp_path: Path) -> None:
    """20 Hz at 3 %: the second part of its free vibration is within one bit of the converter."""
    ended = run(
        tmp_path, structure=ONE_STOREY, damping={"first_mode_ratio": 0.06}, controller="FF", sample_rate_hz=rate_hz
    )
    assert (ended.status, ended.exit_code) == ("complete", 0), ended.reason
    stored = read_result(tmp_path / "case.h5").attributes
    assert stored["damping_first_mode_ratio"] == pytest.approx(0.06, rel=1e-9)


@pytest.mark.campaign
def test_a_stiff_floor_that_moves_by_three_bits_errs_as_expected(tmp_path: Path) -> None:
    """At 20 Hz the noise-shaped command shakes it, which spreads the rounding of its samples: taken for slow, that was
    expected to cost four to five times as much. What rounding of three bits costs the storey above it (1.0 to 3.3 times
    what is expected) follows the last digit of all numbers, so that the median of four is judged."""
    ratios = []
    for seed in range(4):
        (tmp_path / str(seed)).mkdir()
        ended = run(
            tmp_path / str(seed),
            structure={
                "numerical": {"masses_kg": [20.0] * 6, "stiffness_n_per_m": [3000.0] * 6},
                "experimental": {"masses_kg": [4.0], "natural_frequencies_hz": [20.0], "damping_ratios": [0.02]},
            },
            damping={"first_mode_ratio": 0.03},
            controller="FF+FB",
            sample_rate_hz=500.0,
            table={"extends": "aps400_virtual", "converters": {"bits": 12}},
            seed=seed,
        )
        assert (ended.status, ended.exit_code) == ("complete", 0), ended.reason
        ratios.append(read_result(tmp_path / str(seed) / "case.h5").metrics["exp_rths.error_over_expected"])
    ratio, largest = np.median(ratios, axis=0), np.array([1.5, 1.5, 1.5, 1.5, 1.5, 2.5, 1.5])
    assert np.all((ratio > 1.0 / 1.5) & (ratio < largest)), ratio


@pytest.mark.campaign
def test_coarse_converters_on_a_table_whose_force_ends_before_its_data_sheet_says(tmp_path: Path) -> None:
    ended = run(tmp_path, structure=COARSE, damping={"first_mode_ratio": 0.03}, controller="FF+FB", table=SATURATING)
    assert (ended.status, ended.exit_code) == ("complete", 0), ended.reason
    assert any("measured again at half the level" in warning for warning in ended.warnings)


@pytest.mark.campaign
def test_floors_whose_first_look_goes_astray_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a model of the table the alias of its staircase hides the highest of seven modes, here at 640 Hz."""
    path = tmp_path / "case.yaml"
    converters, exact = {"bits": 18, "latency_samples": 3}, {"corner": 0, "skew_s": 0, "mass": 0, "drift": 0}
    table = {"extends": "aps400_virtual", "converters": converters, "uncertainty": exact}  # evaluated once
    case = {"structure": SEVEN_FLOORS, "damping": {"first_mode_ratio": 0.03}, "table": table, "sample_rate_hz": 640.0}
    path.write_text(json.dumps({"record": "el_centro", "scaling": 0.2, "controller": "FF", **case}))
    setup = make_setup(load_cases([path])[0])
    looks: list[Start] = []
    first_look = identify_specimen.first_look
    monkeypatch.setattr(identify_specimen, "first_look", lambda data: looks.append(first_look(data)) or looks[-1])
    found = Memory().identify(setup, lambda _: None)
    ratios = SEVEN_FLOORS["experimental"]["damping_ratios"]
    assert looks and all(look.damping_ratio == pytest.approx(ratios, rel=0.2) for look in looks)
    K, masses = setup.building.specimen.K, setup.building.specimen.masses_kg
    truth = np.sqrt(eigh(K, np.diag(masses), eigvals_only=True)) / (2.0 * np.pi)
    assert found.verdict.accepted, found.verdict.reasons
    assert found.specimen.natural_frequency_hz == pytest.approx(truth, rel=1e-3)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [18])
def test_random_cases_end_with_a_result_or_a_true_reason(seed: int, tmp_path: Path) -> None:
    make_records(tmp_path)
    row = judged(seed, tmp_path)
    assert row.outcome in (RAN, REFUSED), row.crash
    assert row.honest, row.reasons
