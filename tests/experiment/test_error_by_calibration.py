"""What an error of the calibration costs: the check's columns against tests on rigs that err by a known amount."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from portfolio import parametrize_first

from rths_cli.analysis.true_error import Sensitivities
from rths_cli.case.load import load_cases
from rths_cli.experiment import check
from rths_cli.experiment.check import judge
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import save
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.numerics.lti import Array

pytestmark = pytest.mark.campaign

CERTAIN = "table.uncertainty={corner: 0, skew_s: 0, mass: 0, drift: 0}"
QUICK = ("sample_rate_hz=1000", "identification.duration_s=60", "runs=[sim, sim_delay, exp_rths]")
GAIN, CORNER, LAG = range(3), range(3, 6), range(6, 9)  # places of the table's and two floors' parameters
STATED = "table.imperfections.channels."


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], (*QUICK, *settings))[0], ("check", "model"))


@pytest.fixture(scope="module")
def columns(memory: Memory) -> Sensitivities:
    """Return what the check takes for the errors by each parameter, of a rig that is uncertain in its corners."""
    made: list[Sensitivities] = []
    with pytest.MonkeyPatch.context() as patch:
        original = check.sensitivities
        patch.setattr(check, "sensitivities", lambda *given: made.append(original(*given)) or made[-1])
        setup = setup_of()
        found = memory.identify(setup, lambda _: None)
        judge(setup, found, design_blocks(setup, found))
    return made[0]


def true_error(path: Path, memory: Memory, *settings: str) -> Array:
    """Return the true errors (3,) in m/s^2 of a test whose identification takes its sensors for certain."""
    path.unlink(missing_ok=True)
    assert run_case(setup_of(CERTAIN, *settings), path, memory, "test", lambda _: None).status == "complete"
    return np.asarray(read_result(path).metrics["exp_rths.true_reference_rms_error_m_s2"])


@parametrize_first(
    1,
    ("stated", "places", "off", "within"),
    [
        ("gain_error=0.005", GAIN, np.log(1.005), 0.1),
        ("high_pass_error=[0.2, 0, 0]", CORNER[:1], np.log(1.2), 0.35),
        ("high_pass_error=0.2", CORNER, np.log(1.2), 0.2),
        ("skew_s=[5e-5, 0, 0]", LAG[:1], -5e-5, 0.25),
    ],
    ids=["all gains", "corner of the table", "all corners", "instant of the table"],
)
def test_an_error_of_the_calibration_costs_what_is_expected(
    tmp_path: Path, memory: Memory, columns: Sensitivities, stated: str, places: range, off: float, within: float
) -> None:
    """A wrong corner of the table's sensor looks like the alias of the held command, which takes most of it up; taken
    for a wrong motion of the table it would cost four times as much."""
    path = tmp_path / "result.h5"
    right, wrong = true_error(path, memory), true_error(path, memory, STATED + stated)
    deviation = np.zeros(columns.gram.shape[-1])
    deviation[list(places)] = off
    expected = np.sqrt(np.einsum("p,spq,q->s", deviation, columns.gram, deviation))
    np.testing.assert_allclose(expected, np.sqrt(wrong**2 - right**2), rtol=within)


@pytest.mark.campaign
def test_sensors_and_masses_that_differ_more_than_declared_are_told(memory: Memory) -> None:
    """Larger differences than these are refused, as a wrong number in a file."""
    declared = ("table.sensors.sensitivity_uncertainty=0.004", "table.uncertainty.mass=0.001")
    gains, masses = f"{STATED}gain_error=", "table.imperfections.masses.weighing_error="
    wrong = setup_of(*declared, f"{gains}[0.01, -0.01, 0.01]", f"{masses}[0.004, -0.004]")
    told = " ".join(memory.identify(wrong, lambda _: None).verdict.warnings)
    assert (
        "the sensors differ more than their uncertainty explains (channel floor_2 by -1.3 % from what is declared"
        in told
    )
    assert (
        "the masses differ from what is stated by more than their uncertainty explains (floor 1 of the specim" in told
    )
    ordinary = setup_of(*declared, f"{gains}[0.004, -0.004, 0.002]", f"{masses}[0.001, 0]")
    assert not any("differ" in told for told in memory.identify(ordinary, lambda _: None).verdict.warnings)


@pytest.mark.campaign
def test_pitch_is_seen_and_costs_what_is_expected(tmp_path: Path, memory: Memory) -> None:
    """The rig's equations of motion hold the weight along the pitched floors and the base's inertia, too."""
    pitches = ("table.imperfections.pitch.frequency_hz=30", "table.imperfections.pitch.storey_height_m=0.2")
    uncertain = ("table.sensors.sensitivity_uncertainty=0.01", "table.uncertainty.mass=0.003")
    setup = setup_of(*pitches, *uncertain)
    found = memory.identify(setup, lambda _: None)
    heights, masses = np.array([0.2, 0.4]), setup.building.specimen.masses_kg
    inertia = setup.case.table.imperfections.pitch.inertia_kg_m2 + masses @ heights**2
    true = heights[-1] ** 2 / (inertia * (2.0 * np.pi * 30.0) ** 2)
    assert found.pitch is not None and found.pitch.seen
    assert abs(found.pitch.flexibility_m_per_n - true) < 2.0 * found.pitch.error_m_per_n < 0.3 * true
    assert run_case(setup, tmp_path / "result.h5", memory, "test", lambda _: None).status == "complete"
    result = read_result(tmp_path / "result.h5").metrics
    went_wrong = np.asarray(result["exp_rths.true_reference_rms_error_m_s2"])
    np.testing.assert_allclose(np.asarray(result["check.pitch_error_m_s2"]), went_wrong, rtol=0.15)
    assert np.all(went_wrong < np.asarray(result["check.true_error_bound_m_s2"]))


@pytest.mark.campaign
def test_a_model_of_a_certain_rig_gets_the_bound_of_the_uncertainties_that_the_rig_states(
    tmp_path: Path, memory: Memory
) -> None:
    """Its record showed no sensor. What the record of the session shows, changes, is not all that is uncertain."""
    off = STATED + "high_pass_error=0.1"
    certain = setup_of(CERTAIN, off)
    save(tmp_path / "model.h5", certain, memory.identify(certain, lambda _: None), "made for this test", "0" * 64)
    path, named = tmp_path / "result.h5", f"identification.model={tmp_path / 'model.h5'}"
    assert run_case(setup_of(off, named), path, Memory(), "test", lambda _: None).status == "complete"
    metrics = read_result(path).metrics
    error, bound, usual = (
        np.asarray(metrics[name])
        for name in ("exp_rths.true_reference_rms_error_m_s2", "check.true_error_bound_m_s2", "check.rms_error_m_s2")
    )
    assert np.all(error > 3.0 * usual) and np.all(error < bound)
