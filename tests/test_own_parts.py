"""Parts of the step that the caller of the Python interface makes, and the page that tells how."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from python_models import Inverse, Storeys

import rths_cli
from rths_cli import InputError
from rths_cli.analysis.sim import simulate
from rths_cli.case.load import load_cases
from rths_cli.control import numerical_substructure
from rths_cli.control.interface import Logged
from rths_cli.control.python_parts import PythonFeedforward, PythonSubstructure
from rths_cli.files.result_reader import read_result
from rths_cli.numerics.lti import Block
from rths_cli.report.answer import answer
from rths_cli.report.page.document import page
from rths_cli.report.result_tables import tables
from rths_cli.structure import Building, assemble, build

pytestmark = pytest.mark.campaign

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"
PAGE = ROOT / "docs" / "reference" / "parts.md"


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """Return what makes the default case short: the first 9 s of its record."""
    lines = (ROOT / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in lines if not line.startswith("#")][:450]
    record = tmp_path_factory.mktemp("own_parts") / "short.csv"
    record.write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    return {"record.file": record, "runs": ["sim", "exp_rths"]}


def in_numpy(designed: Block) -> PythonFeedforward:
    return PythonFeedforward("inverse in numpy", lambda: Inverse(designed))


def test_a_part_of_ones_own_runs_in_place_of_the_designed_one(settings: dict[str, object]) -> None:
    """Without a linear block it is refused, as any loop that cannot be judged; the file names its place."""
    parts = {"feedforward": in_numpy}
    refused = rths_cli.run(CASE, settings=settings, parts=parts)
    assert refused.status == "refused" and "inverse in numpy cannot be judged" in refused.status_reason
    ran = rths_cli.run(CASE, settings=settings, parts=parts, overrides=["check"])
    designed = rths_cli.run(CASE, settings=settings)
    assert (ran.status, designed.status) == ("complete", "complete")
    assert (ran.attributes["own_parts"], designed.attributes["own_parts"]) == ("feedforward", "")
    wanted = designed.exp_rths.command_v
    assert np.abs(ran.exp_rths.command_v - wanted).max() < 0.02 * np.abs(wanted).max()


def test_a_place_that_the_step_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="no place 'guard'"):
        rths_cli.check(CASE, parts={"guard": in_numpy})
    assert "no design of a part" in rths_cli.check(CASE, parts={"feedforward": lambda designed: None}).reasons[0]


TALL = {  # two computed storeys below three on the table
    "structure": {
        "numerical": {"masses_kg": [12.0, 12.0], "stiffness_n_per_m": [16000.0, 16000.0]},
        "experimental": {
            "masses_kg": [5.0, 5.0], "stiffness_n_per_m": [9000.0, 9000.0], "damping_ratios": [0.04, 0.04]
        },
    },
    "damping": {"dashpots_n_s_per_m": [90.0, 90.0]},
}  # fmt: skip


@pytest.fixture(scope="module")
def tall(settings: dict[str, object]) -> dict[str, object]:
    """Return the short case with two computed storeys."""
    return {**settings, **TALL, "runs": ["sim", "sim_delay", "exp_rths"], "delay_s": 0.002}


def stiffer(tall: dict[str, object]) -> Building:
    """Return the building whose first storey is a fifth stiffer than the case's."""
    structure = {**TALL["structure"], "numerical": {"masses_kg": [12.0, 12.0], "stiffness_n_per_m": [19200.0, 16000.0]}}
    texts = [f"{key}={rths_value(value)}" for key, value in {**tall, "structure": structure}.items()]
    case = load_cases([CASE], texts)[0]
    return build(case.structure, case.damping)


def rths_value(value: object) -> object:
    return str(value).replace("'", "") if isinstance(value, list | dict) else value


def storeys_of(building: Building, declared: object) -> Callable[[Block], PythonSubstructure]:
    """Return the function that makes the computed storeys of a building in Python, which declare a building or none."""
    block = numerical_substructure.interface(building.numerical, 1.0 / 2000.0)

    def make(designed: Block) -> PythonSubstructure:
        assert designed.A.shape == block.A.shape
        logs = (Logged("storey_1_rel_disp", "m"),)
        return PythonSubstructure("stiffer storeys", lambda: Storeys(block), block, logs, building=declared)  # type: ignore[arg-type]

    return make


@pytest.fixture(scope="module")
def declared(tall: dict[str, object], tmp_path_factory: pytest.TempPathFactory) -> rths_cli.RunResult:
    """Return a run with storeys of one's own that declare their building."""
    own = stiffer(tall)
    output = tmp_path_factory.mktemp("declared")
    return rths_cli.run(CASE, settings=tall, parts={"numerical": storeys_of(own, own)}, output=output)


def test_references_are_those_of_the_building_that_a_part_declares(
    tall: dict[str, object], declared: rths_cli.RunResult
) -> None:
    """SIM is that of the declared building, and EXP-RTHS follows it: interface, floors, and the storey below."""
    own, ran = stiffer(tall), declared
    assert ran.status == "complete"
    wanted = simulate(own, 1.0 / 2000.0, ran.record.ground_accel_m_s2)
    assert np.abs(ran.sim.abs_accel_m_s2 - wanted.abs_accel_m_s2).max() < 1e-6 * np.abs(wanted.abs_accel_m_s2).max()
    error, late = (np.asarray(ran.metrics[f"{run}.rms_error_m_s2"]) for run in ("exp_rths", "sim_delay"))
    assert error.shape == (4,) and (error < 0.15 * late).all()
    for name in ("rel_disp_m", "abs_accel_m_s2"):
        found, sim = getattr(ran.exp_rths, name), getattr(ran.sim, name)
        assert np.abs(found - sim).max(axis=1) == pytest.approx(0.0, abs=0.05 * np.abs(sim).max())
    assert any("those of the building that it declares" in line for line in ran.attributes["warnings"].split("\n"))


def test_storeys_of_a_part_that_declares_nothing_are_not_known(
    tall: dict[str, object], declared: rths_cli.RunResult, tmp_path: Path
) -> None:
    """Below the interface nothing is shown as EXP-RTHS's; the interface is as the part gave it, SIM is the case's."""
    parts = {"numerical": storeys_of(stiffer(tall), None)}
    ran = rths_cli.run(CASE, settings=tall, parts=parts, output=tmp_path)
    assert ran.status == "complete" and np.array_equal(ran.exp_rths.command_v, declared.exp_rths.command_v)
    for name in ("rel_disp_m", "rel_vel_m_s", "abs_accel_m_s2"):
        found, known = getattr(ran.exp_rths, name), getattr(declared.exp_rths, name)
        assert np.isnan(found[0]).all() and np.array_equal(found[1:], known[1:])
    sim = np.asarray(ran.sim.abs_accel_m_s2)
    assert np.abs(sim - declared.sim.abs_accel_m_s2).max() > 0.02 * np.abs(sim).max()
    error = np.asarray(ran.metrics["exp_rths.rms_error_m_s2"])
    assert np.isnan(error[0]) and np.isfinite(error[1:]).all()
    assert "declares no building" in ran.attributes["warnings"]
    result = read_result(ran.path, whole=True)
    shown = tables([result])
    assert "diverged" not in shown and "nan" not in shown.lower()
    assert "<html" in page([result], "rths run")
    assert ["NOT GRADED" in answer(each) for each in (result, read_result(declared.path, whole=True))] == [True, False]


def test_the_interface_moves_as_the_part_says(tall: dict[str, object], declared: rths_cli.RunResult) -> None:
    """The displacement that is stored is the part's own, not that of the declared storeys under the measured shear."""
    own = stiffer(tall)
    soft = rths_cli.run(CASE, settings=tall, parts={"numerical": storeys_of(own, case_building(tall))})
    hard = declared
    assert np.array_equal(soft.exp_rths.rel_disp_m[1], hard.exp_rths.rel_disp_m[1])
    assert np.abs(soft.exp_rths.rel_disp_m[0] - hard.exp_rths.rel_disp_m[0]).max() > 1e-4


def case_building(tall: dict[str, object]) -> Building:
    case = load_cases([CASE], [f"{key}={rths_value(value)}" for key, value in tall.items()])[0]
    return build(case.structure, case.damping)


def test_a_building_that_does_not_fit_the_case_is_refused(tall: dict[str, object]) -> None:
    own = stiffer(tall)
    heavier = replace(own, interface_experimental_mass_kg=1.0)
    texts = [f"{key}={rths_value(value)}" for key, value in tall.items() if key not in TALL]
    short = build(load_cases([CASE], texts)[0].structure, load_cases([CASE], texts)[0].damping)
    for declared, told in (
        (heavier, "has 1 kg of the interface floor on the table, in the case 0 kg stand there"),
        (short, "has 1 computed and 2 experimental storeys, the case's has 2 and 2"),
        ("steel", r"declares is none \(str\)"),
    ):
        with pytest.raises(InputError, match=told):
            rths_cli.check(CASE, settings=tall, parts={"numerical": storeys_of(own, declared)})


def test_the_snippets_of_the_page_run(tmp_path: Path, settings: dict[str, object]) -> None:
    snippets = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    assert len(snippets) >= 2
    with chdir(tmp_path):
        exec("\n".join(snippets), {"SHORT": settings, "__name__": "parts"})


def test_a_declared_building_has_the_specimen_of_the_case(tall: dict[str, object]) -> None:
    """The specimen is what stands on the table; another one would change a virtual table under a kept model."""
    usual = case_building(tall)
    other = replace(usual.specimen, K=1.01 * usual.specimen.K)
    declared = Building(usual.numerical, other, 0.0, *assemble(usual.numerical, other, 0.0))
    with pytest.raises(InputError, match="declares has another specimen than the case"):
        rths_cli.check(CASE, settings=tall, parts={"numerical": storeys_of(usual, declared)})
