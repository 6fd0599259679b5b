"""The verdict on cases: the same for `rths check` and `rths run`, without a rig that moves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from made_up_check import LINEAR, TRUE_ERROR
from portfolio import parametrize_first
from watched_references import watch_references

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, RigError
from rths_cli.experiment import check, check_command, identify_on_rig, real_rig_readiness
from rths_cli.experiment.check_command import Checked
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.model_files import save
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import Result, read_result
from rths_cli.findings import stated
from rths_cli.identification.results import Identification
from rths_cli.quantities import METRICS
from rths_cli.quantities.metrics import REACH

CASE, BARE = "el_centro_low_ff_fb", "el_centro_bare_ff_fb"


def nothing(_: str) -> None:
    """Show nothing."""


def setup_of(*settings: str, case: str = CASE, overrides: tuple[str, ...] = ()) -> Setup:
    return make_setup(load_cases([case], settings)[0], overrides)


def checked(memory: Memory, *settings: str, case: str = CASE) -> Checked:
    return check_command.check_case(setup_of(*settings, case=case), memory, nothing)


def value(found: Checked, path: str) -> np.ndarray:
    return np.asarray(found.metrics[f"check.{path}"], dtype=float)


def run(path: Path, setup: Setup, memory: Memory) -> tuple[Ended, Result]:
    ended = run_case(setup, path, memory, "test", nothing)
    return ended, read_result(path)


OF_GUARD = ("check.shake_table_", "check.exp_rths_")  # what a run needs, and the limits of its guard


@pytest.fixture(scope="module")
def file(
    tmp_path_factory: pytest.TempPathFactory, default_setup: Setup, default_identification: Identification
) -> Path:
    path = tmp_path_factory.mktemp("checked") / "table.h5"
    save(path, default_setup, default_identification, "made for this test", "0" * 64)
    return path


@pytest.fixture
def no_rig(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no rig be opened."""

    def refuse(*_: object) -> None:
        raise AssertionError("a rig was opened")

    for module in (identify_on_rig, real_rig_readiness):
        monkeypatch.setattr(module, "open_rig", refuse)


@pytest.mark.campaign
@pytest.mark.usefixtures("no_rig")
def test_a_named_model_is_read_and_nothing_is_played(file: Path) -> None:
    found = checked(Memory(), f"identification.model={file}")
    assert (found.verdict, found.reasons, found.exit_code) == ("safe", (), 0)
    assert "table.h5, identified 20" in found.about.model and "verifies it by a short record" in found.about.model
    computed = {path: value for path, value in found.metrics.items() if path.startswith("check.")}
    assert set(computed) == LINEAR | TRUE_ERROR
    assert all(np.ndim(value) == (METRICS[path].over != "") for path, value in computed.items())


@pytest.mark.campaign
@pytest.mark.usefixtures("no_rig")
def test_a_real_rig_is_judged_with_a_model_and_bad_input_without(
    tmp_path: Path, default_identification: Identification
) -> None:
    def real(*settings: str) -> Setup:
        setup = setup_of(*settings)
        return replace(setup, rig=replace(setup.rig, kind="udp"))

    path = tmp_path / "real.h5"
    save(path, real(), default_identification, "made for this test", "0" * 64)
    assert check_command.check_case(real(f"identification.model={path}"), Memory(), nothing).verdict == "safe"
    with pytest.raises(InputError, match=r"identification\.model: is missing"):
        check_command.check_case(real(), Memory(), nothing)


@pytest.mark.campaign
def test_a_virtual_rig_without_a_model_is_identified_and_that_is_said(memory: Memory) -> None:
    assert "identified just now" in checked(memory).about.model


@parametrize_first(
    1,
    ("settings", "case", "verdict", "word"),
    [
        ((), BARE, "unsafe", "with 0.931 times the table's gain the loop tolerates only"),
        (("table.uncertainty.table_gain=0.01",), BARE, "safe", ""),
        ((), CASE, "safe", ""),
        (("method=paper",), CASE, "safe", ""),
        (("controller=none",), CASE, "unstable", "spectral radius"),
        (("scaling=0.9",), CASE, "unsafe", "the largest safe scaling is"),
    ],
)
def test_verdicts(memory: Memory, settings: tuple[str, ...], case: str, verdict: str, word: str) -> None:
    found = checked(memory, *settings, case=case)
    assert found.verdict == verdict
    assert (word in " ".join(found.reasons)) if word else found.reasons == ()
    assert (value(found, "spectral_radius") >= 1.0) == (verdict == "unstable")
    assert ("check.rms_error_m_s2" in found.metrics) == (verdict != "unstable")
    assert (value(found, "largest_scaling") == 0.0) == (verdict == "unstable" or (case == BARE and verdict == "unsafe"))


@pytest.mark.campaign
def test_figures_against_known_ones(memory: Memory) -> None:
    found = checked(memory)
    assert value(found, "critical_delay_s") == pytest.approx(7.94e-3, abs=0.01e-3)
    assert value(found, "gain_at_infinity") == 0.0
    assert value(found, "building_frequency_hz") == pytest.approx([2.306, 6.475, 9.334], abs=2e-3)
    assert value(found, "loop_frequency_hz") == pytest.approx(value(found, "building_frequency_hz"), rel=1e-4)
    assert value(found, "loop_damping_ratio") == pytest.approx([0.026, 0.0663, 0.0563], abs=1e-4)
    assert value(found, "sim_delay_rms_error_m_s2") == pytest.approx([0.0763, 0.1278, 0.1581], rel=0.005)
    assert {leaf: float(value(found, f"limit_{leaf}")) for leaf in REACH} == pytest.approx(
        {
            "displacement_m": 0.079,
            "velocity_m_s": 1.0,
            "acceleration_m_s2": 45.0,
            "sensor_m_s2": 5 * 9.80665,
            "force_n": 445.0,
            "command_v": 10.0,
        }
    )
    with_mass = checked(memory, "structure.interface_experimental_mass_kg=1.386")
    assert value(with_mass, "gain_at_infinity") == pytest.approx(0.25, abs=1e-3)


def test_no_feedback_to_be_designed_is_a_reason_and_no_crash(
    tmp_path: Path, memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("controller: no feedback is of use")

    monkeypatch.setattr(check_command, "design_blocks", refuse)
    found = checked(memory)
    assert (found.verdict, found.reasons, found.metrics) == ("unsafe", ("controller: no feedback is of use",), {})
    ended, result = run(tmp_path / "r.h5", setup_of("runs=[sim, exp_rths]"), memory)
    assert (ended.exit_code, ended.status, ended.reason) == (1, "refused", "controller: no feedback is of use")
    assert "sim.solution_error" in result.metrics


def test_a_rig_that_cannot_be_identified_makes_a_case_unsafe(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RigError("identification of rig x: channel table is dead")

    memory = Memory()
    monkeypatch.setattr(memory, "at_rest", fail)
    found = checked(memory)
    assert (found.verdict, found.exit_code) == ("unsafe", 1) and "dead" in found.reasons[0]


@pytest.mark.campaign
def test_a_rejected_model_is_a_reason_unless_overridden(default_identification: Identification) -> None:
    verdict = replace(default_identification.verdict, accepted=False, refusals=(stated("made up"),))
    known = IdentifiedModel(replace(default_identification, verdict=verdict), "made up")
    memory = SimpleNamespace(at_rest=lambda *_: known)
    found = check_command.check_case(setup_of(), memory, nothing)  # type: ignore[arg-type]
    assert found.verdict == "unsafe" and "made up" in found.reasons[0] and "--override model" in found.reasons[0]
    insisted = check_command.check_case(setup_of(overrides=("model",)), memory, nothing)  # type: ignore[arg-type]
    assert (insisted.verdict, insisted.reasons) == ("safe", ())
    assert "made up" in insisted.warnings and insisted.about.overrides == ("model",)


def test_a_controller_that_a_rejected_model_leaves_none_is_no_reason_of_its_own(
    default_identification: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise InputError("controller: no feedback is of use")

    monkeypatch.setattr(check_command, "design_blocks", refuse)
    verdict = replace(default_identification.verdict, accepted=False, refusals=(stated("made up"),))
    known = IdentifiedModel(replace(default_identification, verdict=verdict), "made up")
    memory = SimpleNamespace(at_rest=lambda *_: known)
    (reason,) = check_command.check_case(setup_of(), memory, nothing).reasons  # type: ignore[arg-type]
    assert "made up" in reason and "controller" not in reason
    insisted = check_command.check_case(setup_of(overrides=("model",)), memory, nothing)  # type: ignore[arg-type]
    assert insisted.reasons == ("controller: no feedback is of use",)


@pytest.mark.campaign
def test_a_run_stores_what_its_check_says(tmp_path: Path, memory: Memory) -> None:
    ended, result = run(tmp_path / "r.h5", setup_of("runs=[exp_rths]", "accept={check.largest_scaling: 0.5}"), memory)
    assert result.attributes["check_verdict"] == "safe" and ended.exit_code == 1
    assert "check.largest_scaling = 0.855" in ended.reason
    predicted, measured = (np.asarray(result.metrics[f"{of}.rms_error_m_s2"]) for of in ("check", "exp_rths"))
    assert measured == pytest.approx(predicted, rel=0.3)
    found = checked(memory)
    assert value(found, "rms_error_m_s2") == pytest.approx(predicted, rel=1e-12)


@pytest.mark.campaign
def test_a_run_without_exp_rths_is_judged_by_its_shake_table_test_alone(tmp_path: Path, memory: Memory) -> None:
    ended, result = run(tmp_path / "r.h5", setup_of("runs=[shake_table]", "scaling=0.1", case=BARE), memory)
    assert (ended.exit_code, result.attributes["check_verdict"]) == (0, "safe")
    of_check = [path for path in result.metrics if path.startswith("check.")]
    assert of_check and all(path.startswith("check.shake_table_") for path in of_check)


def test_what_is_not_safe_is_refused_and_the_other_runs_go_on(tmp_path: Path, memory: Memory) -> None:
    ended, result = run(tmp_path / "r.h5", setup_of("runs=[sim, shake_table, exp_rths]", case=BARE), memory)
    assert (ended.exit_code, ended.status) == (1, "refused")
    assert result.attributes["status"] == "refused" and result.attributes["check_verdict"] == "unsafe"
    reason = str(result.attributes["status_reason"])
    assert reason == ended.reason and "the loop tolerates only" in reason and "--override check" in reason
    assert "shake_table.tracking_rms_m_s2" in result.metrics and "check.spectral_radius" in result.metrics
    with h5py.File(tmp_path / "r.h5") as stored:
        assert "exp_rths" not in stored and "shake_table" in stored


@pytest.mark.campaign
def test_two_faults_are_both_told(tmp_path: Path, memory: Memory) -> None:
    ended, _ = run(tmp_path / "r.h5", setup_of("runs=[shake_table, exp_rths]", "scaling=3"), memory)
    assert (ended.exit_code, ended.status) == (1, "refused")
    assert "shake-table test refused, unsafe" in ended.reason and "EXP-RTHS refused, unsafe" in ended.reason


@pytest.mark.campaign
@pytest.mark.parametrize("case", [CASE, "hachinohe_high_ff"])
def test_the_largest_safe_scaling_is_safe_and_a_third_more_is_stopped(
    tmp_path: Path, memory: Memory, case: str
) -> None:
    largest = float(value(checked(memory, case=case), "largest_scaling"))
    assert checked(memory, f"scaling={largest}", case=case).verdict == "safe"
    assert checked(memory, f"scaling={1.005 * largest}", case=case).verdict == "unsafe"
    ended, _ = run(tmp_path / "safe.h5", setup_of("runs=[exp_rths]", f"scaling={largest}", case=case), memory)
    assert (ended.exit_code, ended.status) == (0, "complete")
    beyond = ("runs=[exp_rths]", f"scaling={1.3 * largest}")
    ended, _ = run(tmp_path / "refused.h5", setup_of(*beyond, case=case), memory)
    assert (ended.exit_code, ended.status) == (1, "refused")
    ended, result = run(tmp_path / "stopped.h5", setup_of(*beyond, case=case, overrides=("check",)), memory)
    assert (ended.exit_code, ended.status) == (3, "aborted")
    assert result.attributes["overrides"] == "check" and result.attributes["check_verdict"] == "unsafe"
    assert "check of EXP-RTHS is overridden" in str(result.attributes["warnings"])


@pytest.mark.parametrize(
    ("path", "word"), [("check.rms_eror_m_s2", "did you mean"), ("check.largest_scaling[2]", "one number")]
)
def test_an_accepted_figure_of_the_check_that_cannot_be_is_refused(path: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        setup_of(f"accept={{'{path}': 1}}")


def test_a_building_as_identified_without_a_sim_is_unsafe_and_no_fault_of_the_case(
    default_setup: Setup, default_identification: Identification, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a fit leaves it that went astray; the case's own building was solved before."""

    def unsolved(_: object) -> None:
        raise InputError("SIM: its storeys are too unlike")

    watch_references(monkeypatch, check, unsolved)
    verdict = check_command.verdict_on(default_setup, IdentifiedModel(default_identification, "made up"))
    others = [path for path in verdict.figures if not path.startswith((*OF_GUARD, "check.shake_table_"))]
    assert (verdict.verdict, others) == ("unsafe", [])
    assert verdict.reasons == ("the building as identified: SIM: its storeys are too unlike",)
