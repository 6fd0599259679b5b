"""The true error after a run: what the run measured is in its bound, and a specimen that changed is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.analysis.grade import changes_of, deviations_of
from rths_cli.case.load import load_cases
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.error_after_run import of_declaration
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import Result, read_result
from rths_cli.report.answer import grade, verdict
from rths_cli.structure import storey_matrix, storey_values
from rths_cli.structure.tangents import on_specimen

QUICK = ("sample_rate_hz=500", "identification.duration_s=40", "runs=[sim, sim_delay, exp_rths]", "scaling=0.3")


@pytest.fixture(scope="module")
def memory() -> Memory:
    return Memory()


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> str:
    time_s = np.arange(0.0, 12.0, 0.01)
    parts = ((1.0, 1.1, 3.0), (0.7, 2.3, 5.0), (0.5, 4.1, 4.0))
    accel = sum(a * np.sin(2.0 * np.pi * f * time_s) * np.exp(-(((time_s - at) / 1.5) ** 2)) for a, f, at in parts)
    path = tmp_path_factory.mktemp("record") / "short.csv"
    rows = "\n".join(f"{value:.6g}" for value in 3.0 * np.asarray(accel))
    path.write_text(f"# dt: 0.01 s\n# units: m/s^2\n{rows}\n")
    return str(path)


def played(folder: Path, memory: Memory, record: str, *settings: str) -> Result:
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], (*QUICK, f"record={record}", *settings))[0], ("check",))
    path = folder / "result.h5"
    assert run_case(setup, path, memory, "test", lambda _: None, series="none").status == "complete"
    return read_result(path)


def of(result: Result, name: str) -> np.ndarray:
    return np.atleast_1d(np.asarray(result.metrics[f"exp_rths.{name}"], dtype=float))


def test_a_specimen_as_identified_has_a_bound_that_holds_and_no_finding(
    tmp_path: Path, memory: Memory, record: str
) -> None:
    result = played(tmp_path, memory, record)
    true, bound = of(result, "true_reference_nrmse_percent"), of(result, "true_error_bound_percent")
    assert np.all(true <= bound) and grade(result) is not None
    assert changes_of(result.metrics) == () and "CHANGED" not in verdict(result)
    assert "hardly matters" not in verdict(result)


@pytest.mark.campaign
@parametrize_first(1, "factor", [0.8, 1.15])
def test_a_specimen_that_changed_since_its_identification_is_the_reference_s(
    tmp_path: Path, memory: Memory, record: str, factor: float
) -> None:
    """Its error against SIM as declared is large, its true one is not: the test is that of the specimen there."""
    result = played(tmp_path, memory, record, f"table.after_identification={{specimen_stiffness_factor: {factor}}}")
    found = changes_of(result.metrics)
    assert [one.place for one in found] == [2, 3]
    assert all(abs(one.percent - 100.0 * (factor - 1.0)) < 3.0 for one in found)
    true, bound = of(result, "true_reference_nrmse_percent"), of(result, "true_error_bound_percent")
    assert of(result, "nrmse_percent").max() > 5.0 * true.max()
    assert np.all(true <= bound) and np.all(bound < of(result, "nrmse_percent"))
    assert of(result, "identified_reference_nrmse_percent").max() < 0.5 * of(result, "nrmse_percent").max()
    assert "THE SPECIMEN CHANGED since its identification: stiffness of storey" in verdict(result)


@pytest.mark.campaign
def test_another_specimen_than_declared_is_named_with_storey_and_sign(memory: Memory, record: str) -> None:
    """Declared 5 % stiffer in storey 3 than the one that was identified."""
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], (*QUICK, f"record={record}"))[0])
    uncertain = verdict_on(setup, memory.known(setup, lambda _: None)).uncertain
    assert uncertain is not None
    there = setup.building.specimen
    other = replace(there, K=storey_matrix(storey_values(there.K) * np.array([1.0, 1.05])))
    declared = replace(setup, building=on_specimen(setup.building, other))
    assert not [one for one in deviations_of(of_declaration(uncertain)) if one.what.startswith("stiffness")]
    (found,) = (
        one
        for one in deviations_of(of_declaration(replace(uncertain, setup=declared)))
        if one.what.startswith("stiffness")
    )
    assert found.place == 3 and -7.0 < found.percent < -3.0 and found.error < 2.5


@pytest.mark.campaign
def test_a_motion_that_its_samples_hardly_show_is_no_changed_specimen(tmp_path: Path, memory: Memory) -> None:
    """A floor of 20 Hz on six soft storeys moves with the table; 12 bits round what is left."""
    numerical = "{masses_kg: [30, 25, 25, 20, 20, 15], stiffness_n_per_m: [3000, 3000, 2600, 2400, 2200, 2000]}"
    floor = "{masses_kg: [3.5], natural_frequencies_hz: [20.0], damping_ratios: [0.02]}"
    converters = "{bits: 12, latency_samples: 2}"
    result = played(
        tmp_path, memory, "hachinohe", f"structure={{numerical: {numerical}, experimental: {floor}}}", "scaling=0.2",
        "damping={first_mode_ratio: 0.02}", f"table={{extends: aps400_virtual, converters: {converters}}}",
    )  # fmt: skip
    assert of(result, "specimen_unexplained") > 0.1 and grade(result) is None
    assert changes_of(result.metrics) == ()
    assert "noise and rounding of the samples alone are" in verdict(result) and "CHANGED" not in verdict(result)
