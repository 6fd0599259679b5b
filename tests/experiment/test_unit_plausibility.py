"""Masses in tonnes, stiffnesses in kN/m and records in another unit are asked about first; plausible cases are not."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from campaigns.random_case_draw import draw, make_records
from scipy.linalg import eigh

from rths_cli.case.load import load_cases
from rths_cli.case.unit_comparison import Comparison
from rths_cli.cli.terminal import Screen
from rths_cli.errors import InputError, RigError
from rths_cli.experiment import identify_command
from rths_cli.experiment.check_command import check_cases, verdict_on
from rths_cli.experiment.identify_command import Asked, make_model
from rths_cli.experiment.identify_on_rig import UnfitRig
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.real_rig_readiness import ask_to_move
from rths_cli.experiment.run_case import why_none
from rths_cli.experiment.run_command import Request, run_batch
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.experiment.unit_plausibility import keys_in_doubt, unit_doubts, unknown_consents
from rths_cli.files.result_reader import read_result
from rths_cli.findings import sentences, stated
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.results import Identification
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.structure.unit_comparisons import drift_under_1_g

NUMERICAL, EXPERIMENTAL = (
    ("numerical.masses_kg", "numerical.stiffness_n_per_m"),
    (
        "experimental.masses_kg",
        "experimental.stiffness_n_per_m",
    ),
)
LISTS = dict(zip((*NUMERICAL, *EXPERIMENTAL), ([8.0, 8.0, 8.0], [8e3, 8e3, 7e3], [7.0, 6.0], [7e3, 6e3]), strict=True))
STIFF, SOFT = (
    r"own\.yaml:1:\d+: structure\.numerical\.masses_kg: the first mode, 4[67](\.\d+)? Hz; usual is .*factor of 1000 .*"
    r": are masses in kg",
    r"own\.yaml:1:\d+: structure\.numerical\.stiffness_n_per_m: mode 1 0\.047 Hz, drift 1 under 1 g sideways, "
    r"45\.\d+ m; .*factor of 1000 .*: are masses in kg",
)
LIGHT, UNEQUAL = (
    r"structure\.experimental\.masses_kg: the specimen, 0\.013 kg is 0\.13 times the lightest specimen .*: is it in kg",
    r"structure\.numerical\.masses_kg: floor 1, 0\.008 kg is 0\.00123 times the mean floor .*factor of 1000 .* in kg",
)


def case_of(folder: Path, lists: dict[str, Sequence[float]] = LISTS, **keys: object) -> Path:
    """Write a case of five storeys whose lists of masses and stiffnesses are given."""
    structure: dict[str, dict[str, object]] = {"numerical": {}, "experimental": {}}
    for key, values in lists.items():
        part, _, name = key.partition(".")
        structure[part][name] = list(values)
    structure["experimental"]["damping_ratios"] = [0.02] * len(lists["experimental.masses_kg"])
    dashpots = {"dashpots_n_s_per_m": [1.0] * len(lists["numerical.masses_kg"])}
    case = {"structure": structure, "damping": dashpots, "record": "el_centro", "scaling": 0.1, "controller": "FF+FB"}
    path = folder / "own.yaml"
    path.write_text(json.dumps({**case, **keys}))
    return path


def mistaken(*units: str, factor: float) -> dict[str, Sequence[float]]:
    return {key: [factor * value for value in values] if key in units else values for key, values in LISTS.items()}


def setup_of(path: Path | str, *settings: str) -> Setup:
    return make_setup(load_cases([path], settings)[0])


MASSES, SPRINGS = (NUMERICAL[0], EXPERIMENTAL[0]), (NUMERICAL[1], EXPERIMENTAL[1])
MISTAKES = {
    "masses in t": (mistaken(*MASSES, factor=1e-3), STIFF),
    "stiffness in kN/m": (mistaken(*SPRINGS, factor=1e-3), SOFT),
    "stiffness in N/mm, numerical only": (
        mistaken(NUMERICAL[1], factor=1e-3),
        r"structure\.numerical\.stiffness_n_per_m: .*drift 1 under 1 g sideways, 45\.\d+ m",
    ),
    "stiffness in kN/m, experimental only": (
        mistaken(EXPERIMENTAL[1], factor=1e-3),
        r"structure\.experimental\.stiffness_n_per_m: .*drift 4 under",
    ),
    "masses in t, stiffness in kN/m": (mistaken(*LISTS, factor=1e-3), LIGHT),
    "masses in t, numerical only": (mistaken(NUMERICAL[0], factor=1e-3), UNEQUAL),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_building_in_other_units_is_asked_about(mistake: str, tmp_path: Path) -> None:
    lists, sentence = MISTAKES[mistake]
    doubt = str(unit_doubts(setup_of(case_of(tmp_path, lists)))[0])
    assert re.search(sentence, doubt) and "in kg" in doubt


def test_the_first_mode_and_the_drift_are_those_of_the_building(tmp_path: Path) -> None:
    setup = setup_of(case_of(tmp_path, mistaken(*SPRINGS, factor=1e-3)))
    M, K = setup.building.M, setup.building.K
    first_hz = np.sqrt(eigh(K, M, eigvals_only=True)[0]) / (2.0 * np.pi)
    pushed = np.linalg.solve(K, STANDARD_GRAVITY_M_S2 * np.diag(M))
    assert drift_under_1_g(setup.building) == pytest.approx(np.diff(pushed, prepend=0.0), rel=1e-9)
    doubt = str(unit_doubts(setup)[0])
    assert f"mode 1 {first_hz:.2g} Hz" in doubt and f"under 1 g sideways, {pushed[0]:.6g} m" in doubt


def test_masses_in_grams_are_asked_about_where_the_table_cannot_carry_them(tmp_path: Path) -> None:
    for factor, advice in ((1e3, "are masses_kg those of the model on the table, in kg?"), (2.0, "put fewer storeys")):
        with pytest.raises(InputError, match=r"rig aps400_virtual carries at most 23 kg") as caught:
            setup_of(case_of(tmp_path, mistaken(*MASSES, factor=factor)))
        assert advice in str(caught.value)


def test_a_refusal_names_a_shipped_case_as_it_is_typed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"^el_centro_low_ff(:\d+:\d+)?: structure: the specimen weighs 13\.86 kg"):
        setup_of("el_centro_low_ff", "table.nominal.payload_kg=1")


@pytest.mark.parametrize(
    "settings",
    [
        ("structure=three_storey",),
        ("structure=three_storey_bare", "damping=bare"),
        # a mass of 20 Hz on a numerical storey; a small light model; an isolated one with a period of 5 s
        ("structure.experimental={masses_kg: [7], stiffness_n_per_m: [1.1e5], damping_ratios: [0.03]}",),
        ("structure.experimental={masses_kg: [0.2], stiffness_n_per_m: [900], damping_ratios: [0.03]}",
         "structure.numerical={masses_kg: [0.2], stiffness_n_per_m: [900]}"),
        ("structure.numerical={masses_kg: [10], stiffness_n_per_m: [38]}",),
    ],
)  # fmt: skip
def test_plausible_models_are_not_asked_about(settings: tuple[str, ...]) -> None:
    damping = () if "damping=bare" in settings else ("damping={dashpots_n_s_per_m: [1]}",)
    assert unit_doubts(setup_of("el_centro_low_ff_fb", *damping, *settings)) == ()


@pytest.mark.parametrize(("storeys", "period_s"), [(40, 5.0), (100, 9.0), (198, 12.0)])
def test_tall_soft_buildings_are_not_asked_about(storeys: int, period_s: float, tmp_path: Path) -> None:
    """A uniform chain of n storeys has w1 = 2 sqrt(k / m) sin(pi / (4 n + 2))."""
    k = 8.0 * (np.pi / period_s / np.sin(np.pi / (4.0 * (storeys + 2) + 2.0))) ** 2
    lists = dict(zip(LISTS, ([8.0] * storeys, [k] * storeys, [8.0, 8.0], [k, k]), strict=True))
    setup = setup_of(case_of(tmp_path, lists))
    assert np.sqrt(eigh(setup.building.K, setup.building.M, eigvals_only=True)[0]) * period_s == pytest.approx(
        2 * np.pi
    )
    assert unit_doubts(setup) == ()


@pytest.mark.campaign
def test_random_legitimate_cases_are_not_asked_about(tmp_path: Path) -> None:
    make_records(tmp_path)
    for seed in range(40):
        path = tmp_path / "case.yaml"
        path.write_text(json.dumps({**draw(seed, tmp_path).case, "runs": ["sim"]}))
        assert unit_doubts(setup_of(path)) == (), seed


@pytest.mark.parametrize(
    ("unit", "scaling", "sentence"),
    [
        (
            "g",
            0.1,
            r"1:\d+: record: pulse, its peak before scaling, 33\.5\d* m/s\^2 is 3\.42 times 1 g, "
            r".* of 9\.81 .*: is its unit",
        ),
        ("m/s^2", 0.1, ""),
        (
            "cm/s^2",
            0.9,
            r"1:\d+: record: pulse, its peak before scaling, 0\.0342\d* m/s\^2 is 0\.00349 times 1 g, .*: is its unit",
        ),
        ("cm/s^2", 1.0, r"record: pulse, its peak before scaling, 0\.0342"),  # a weak record, or one in another unit
        ("cm/s^2", 20.0, ""),  # a weak record that is known to be weak
    ],
)
def test_a_record_in_another_unit_is_asked_about(unit: str, scaling: float, sentence: str, tmp_path: Path) -> None:
    time_s = 0.01 * np.arange(400)
    accel = 3.42 * np.sin(2.0 * np.pi * (time_s - 1.75)) * np.exp(-(((time_s - 2.0) / 1.0) ** 2))
    np.savetxt(tmp_path / "pulse.csv", np.column_stack([time_s, accel]), delimiter=",")
    record = {"file": "pulse.csv", "unit": unit}
    doubts = unit_doubts(setup_of(case_of(tmp_path, record=record, scaling=scaling, record_filter={"corner_hz": 0})))
    assert len(doubts) == bool(sentence) and all(re.search(sentence, str(doubt)) for doubt in doubts)


class Unfit(Memory):
    """A memory whose rig cannot be identified."""

    def known(self, setup: Setup, progress: object) -> IdentifiedModel:
        raise RigError("channel floor_5: dead; check sensor and cable")

    at_rest = known


def test_a_run_keeps_the_question_in_its_result_and_prints_it_once(tmp_path: Path) -> None:
    cases = load_cases([case_of(tmp_path, MISTAKES["masses in t"][0], runs=["sim"])])
    printed = StringIO()
    (ended,) = run_batch(Request(tuple(cases), (), tmp_path, True, "test"), Screen(stream=printed))
    assert ended.exit_code == 0 and re.search(STIFF, ended.warnings[0])
    lines = printed.getvalue().splitlines()
    assert lines[0].startswith("[1/1] own: complete") and lines[1] == f"  note: {ended.warnings[0]}"
    assert not any(ended.warnings[0] in line for line in lines[2:])
    assert str(read_result(tmp_path / "own.h5").attributes["warnings"]).splitlines()[0] == ended.warnings[0]


def test_a_rig_that_cannot_be_identified_is_not_the_first_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = load_cases([case_of(tmp_path, MISTAKES["stiffness in kN/m"][0])])
    (checked,) = check_cases(cases, (), lambda _: None, Unfit())
    assert re.search(SOFT, checked.reasons[0]) and checked.reasons[1:] == ("it would explain: channel floor_5: dead",)
    assert checked.warnings == checked.reasons[:1]
    monkeypatch.setattr("rths_cli.experiment.run_command.Memory", lambda _: Unfit())
    (ended,) = run_batch(Request(tuple(cases), (), tmp_path, True, "test"), Screen(quiet=True))
    assert ended.exit_code == 4 and ended.reason == "; ".join(checked.reasons)


@pytest.mark.campaign
def test_a_rejected_model_is_not_the_first_reason(tmp_path: Path, default_identification: Identification) -> None:
    setup = setup_of(case_of(tmp_path, MISTAKES["masses in t"][0]))
    known = IdentifiedModel(default_identification, "test", (stated("the specimen has changed"),))
    verdict = verdict_on(setup, known)
    doubt, *_ = unit_doubts(setup)
    assert verdict.findings[0] == doubt and any("the specimen has changed" in reason for reason in verdict.reasons[1:])
    assert why_none(setup, known, verdict)[0] == doubt
    assert why_none(setup, IdentifiedModel(default_identification, "test"), verdict_on(setup, known, False)) in (
        (),
        (doubt,),
    )


@pytest.mark.parametrize(("rig", "moves"), [("aps400_virtual", True), ("udp_example", False)])
def test_identification_doubts_before_it_excites_a_real_rig_and_before_it_blames_a_channel(
    rig: str, moves: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []

    def measure(setup: Setup, progress: object, planned: object) -> object:
        said.append("excited")
        raise UnfitRig(rig, UnfitRecord((stated("channel floor_5: dead"),)))

    monkeypatch.setattr(identify_command, "measure", measure)
    path = case_of(tmp_path, MISTAKES["stiffness in kN/m"][0], table=rig)
    wanted = Asked(str(path), (), output=tmp_path / "m.h5", draw=False)

    def permit(setup: Setup) -> None:
        ask_to_move([setup], False, lambda lines: True)

    if not moves:
        with pytest.raises(InputError) as refused:
            make_model(wanted, lambda _: None, permit)
        assert re.search(SOFT, refused.value.faults[0]) and "plausible: [structure" in refused.value.faults[-1]
        assert said == []
        return
    made = make_model(wanted, lambda _: None, permit)
    assert made.unfit is not None and re.search(SOFT, made.unfit.faults[0])
    assert made.unfit.faults[1:] == ("channel floor_5: dead",) and said == ["excited"]


def test_a_stricter_limit_of_the_case_hides_no_doubt_on_the_rig() -> None:
    slips = ("table.limits.velocity_m_s=9", "table.limits.force_n=400000", "table.limits.stroke_m=0.75")
    wanted = {"table.limits.velocity_m_s", "table.limits.stroke_m"}
    for stricter in ((), ("limits.acceleration_m_s2=40",), ("limits.stroke_m=0.07",)):
        setup = make_setup(load_cases(["el_centro_low_ff_fb"], (*slips, *stricter))[0])
        assert wanted & set(keys_in_doubt(setup)), stricter
        assert len(keys_in_doubt(setup)) == len(
            keys_in_doubt(make_setup(load_cases(["el_centro_low_ff_fb"], slips)[0]))
        )
    assert keys_in_doubt(make_setup(load_cases(["el_centro_low_ff_fb"], ("limits.stroke_m=0.004",))[0])) == ()


def test_consent_is_asked_for_the_keys_that_are_played_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rths_cli.numerics.clock.require_real_time", lambda: None)
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], ("table=udp_example", "scaling=30"))[0])
    (doubted,) = keys_in_doubt(setup)
    assert doubted == "scaling"
    with pytest.raises(InputError, match="scaling"):
        ask_to_move([setup], False, lambda lines: True)
    with pytest.raises(InputError, match="nobody can be asked"):
        ask_to_move([setup], False, lambda lines: True, played=("structure.", "table."))


@pytest.mark.parametrize(
    ("unit", "ratio", "named"),
    [
        ("kg", 1.0 / 25.4, "25.4"),
        ("kg", 2.20462, "2.205 (lb for kg)"),
        ("mm", 25.4, "25.4 (inch for mm)"),
        ("", 25.4, "25.4 (inch for mm)"),
        ("Hz", 9.80665, "9.81"),
        ("m/s^2", 1.0 / 9.80665, "9.81 (g for m/s^2, kgf for N)"),
        ("s", 1e3, "1000 (k or m before a unit)"),
    ],
)
def test_a_slip_has_its_usual_reason_only_where_that_can_be_true(unit: str, ratio: float, named: str) -> None:
    slip = Comparison("key", ratio, unit, "its neighbour", 1.0, 0.9, 1.1).slip
    assert slip is not None and slip[1] == named


def test_a_consent_to_a_key_that_the_case_does_not_have_is_told() -> None:
    keys = "plausible=[structure.experimental.mases_kg, structure.experimental.masses_kg, scaling]"
    (told,) = sentences(unknown_consents(make_setup(load_cases(["el_centro_low_ff_fb"], (keys,))[0])))
    assert "structure.experimental.mases_kg" in told and "did you mean structure.experimental.masses_kg?" in told
