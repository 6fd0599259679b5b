"""An OpenSees model as a program, against the equations of a frame with ties, and against our exact SIM."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lsim

from rths_cli.analysis.program_sim import simulate_with_program
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import simulate
from rths_cli.programs import Description, ProgramFault, described
from rths_cli.structure import Building, Numerical, Specimen, assemble, build
from rths_cli.structure.programs import ProgramPart, laws_of_program, tangent_of_program
from rths_cli.structure.storey_laws import arranged

pytest.importorskip("opensees", reason="the package opensees is not installed (pip install 'rths-cli[opensees]')")

EXAMPLE = Path(__file__).parents[2] / "examples" / "opensees" / "first_storey.py"
FRAME = """
import openseespy.opensees as ops
def build():
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for i in range(3):
        ops.node(1 + i, 4.0 * i, 0.0)
        ops.fix(1 + i, 1, 1, 1)
        ops.node(11 + i, 4.0 * i, 3.0)
        ops.fix(11 + i, 0, 0, 1)
    {ties}
    ops.geomTransf("Linear", 1)
    for i in range(3):
        ops.element("elasticBeamColumn", 1 + i, 1 + i, 11 + i, 1.0, 2e11, 1e-8, 1)
    ops.mass(11, 500.0, {other}, 0.0)
    {call}
"""
TIED = "ops.equalDOF(11, 12, 1); ops.equalDOF(11, 13, 1)"


LINK = (
    "ops.node(90, 0.0, 3.0 - {}); ops.fix(90, 1, 1, 1); ops.uniaxialMaterial('Elastic', 9, 1e5); "
    "ops.element('zeroLength', 90, 11, 90, '-mat', 9, '-dir', 1)"
)


def frame(folder: Path, ties: str = TIED, other: str = "0.0", call: str = "") -> Description:
    file = folder / "frame.py"
    file.write_text(FRAME.format(ties=ties, other=other, call=call), encoding="utf-8")
    return Description("opensees", str(file), "", "build", 11, 1)


def test_the_force_on_a_floor_has_those_of_the_nodes_tied_to_it(tmp_path: Path) -> None:
    """Three columns of 12 E I / h^3; the reaction at the floor's own node is that of one."""
    found = described(frame(tmp_path))
    assert found.stiffness == pytest.approx(np.array([[3 * 12.0 * 2e11 * 1e-8 / 27.0]]), rel=1e-6)
    assert found.first_hz == pytest.approx(np.sqrt(found.stiffness[0, 0] / 500.0) / (2.0 * np.pi), rel=1e-6)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"other": "500.0"}, "node 11 has 500 kg in degree of freedom 2"),
        ({"call": "ops.rayleigh(0.1, 0.0, 0.0, 0.0)"}, "calls rayleigh"),
        ({"call": "ops.mass(12, 5.0, 0.0, 0.0)"}, "at the same height"),
        ({"call": LINK.format(0.5)}, "element 90 (zeroLength) joins nodes 11 and 90, which are 0.5 apart"),
        ({"call": "raise RuntimeError('no steel')"}, "RuntimeError: no steel"),
    ],
)
def test_what_a_model_may_not_be_is_one_sentence(tmp_path: Path, change: dict[str, str], told: str) -> None:
    with pytest.raises(ProgramFault, match="opensees program frame") as refused:
        described(frame(tmp_path, **change))
    assert told in str(refused.value)


def test_a_zero_length_element_at_one_place_has_its_force(tmp_path: Path) -> None:
    found = described(frame(tmp_path, call=LINK.format(0.0)))
    assert found.stiffness == pytest.approx(np.array([[3 * 12.0 * 2e11 * 1e-8 / 27.0 + 1e5]]), rel=1e-6)


@pytest.mark.campaign
def test_mass_of_elements_is_seen_by_the_first_frequency(tmp_path: Path) -> None:
    part = ProgramPart(frame(tmp_path), 200.0)
    heavy = (tmp_path / "frame.py").read_text(encoding="utf-8").replace(", 1e-8, 1)", ", 1e-8, 1, '-mass', 50.0)")
    (tmp_path / "frame.py").write_text(heavy, encoding="utf-8")
    with pytest.raises(ProgramFault, match="it has mass elsewhere"):
        tangent_of_program(part, np.array([500.0]))


@pytest.mark.campaign
def test_the_monolithic_sim_of_a_linear_model_is_the_exact_one() -> None:
    experimental = SimpleNamespace(
        masses_kg=(6.91, 6.95), natural_frequencies_hz=None, stiffness_n_per_m=(7331.56, 7376.4),
        damping_ratios=(0.043, 0.039), dashpots_n_s_per_m=None,
    )  # fmt: skip
    numerical = SimpleNamespace(masses_kg=(6.93,), stiffness_n_per_m=(7353.976,))
    spec = SimpleNamespace(numerical=numerical, experimental=experimental, interface_experimental_mass_kg=0.0)
    linear = build(spec, SimpleNamespace(first_mode_ratio=None, dashpots_n_s_per_m=(22.163,)))
    part = ProgramPart(Description("opensees", str(EXAMPLE), "", "build", 2, 1, 1e-3, 1.0), 200.0)
    whole = replace(linear, program=part, laws=laws_of_program(1))
    assert pytest.approx(tangent_of_program(part, np.array([6.93])), rel=1e-6) == whole.numerical.K
    time_s = np.arange(0.0, 3.0, 1e-3)
    ground = 2.0 * np.sin(2.0 * np.pi * 2.0 * time_s) * np.exp(-((time_s - 1.0) ** 2))
    found, exact = reference_of(whole).sim(whole, 1e-3, ground), simulate(linear, 1e-3, ground)
    peak = np.abs(exact.abs_accel_m_s2).max()
    assert np.abs(found.abs_accel_m_s2 - exact.abs_accel_m_s2).max() < 3e-4 * peak
    assert found.error_estimate < 2e-4
    late, known = (
        reference_of(one).sim_delay(one, 1e-3, ground, 0.005, sim)
        for one, sim in ((whole, found), (replace(whole, program=None, laws=arranged(())), exact))
    )
    assert np.abs(late.abs_accel_m_s2 - known.abs_accel_m_s2).max() < 3e-4 * np.abs(known.abs_accel_m_s2).max()


SHEAR = """
import openseespy.opensees as ops
def build():
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    ops.geomTransf("Linear", 1)
    ops.node(1, 0.0, 0.0)
    ops.fix(1, 1, 1, 1)
    for i, stiffness in enumerate((9e4, 7e4, 8e4)):
        ops.node(i + 2, 0.0, 3.0 * (i + 1))
        ops.fix(i + 2, 0, 1, 1)
        ops.mass(i + 2, 100.0, 0.0, 0.0)
        ops.element("elasticBeamColumn", i + 1, i + 1, i + 2, 1.0, stiffness, 27.0 / 12.0, 1)
"""


def test_the_monolithic_sim_has_the_dashpots_between_floors_at_different_heights(tmp_path: Path) -> None:
    """Three floors below two, a damping matrix of the frame without a zero, against `scipy.signal.lsim`."""
    file = tmp_path / "shear.py"
    file.write_text(SHEAR, encoding="utf-8")
    storeys = np.eye(3) - np.eye(3, k=-1)
    stiffness, dashpots = storeys.T @ np.diag((9e4, 7e4, 8e4)) @ storeys, storeys.T @ np.diag((300, 200, 250)) @ storeys
    numerical = Numerical(np.full(3, 100.0), stiffness, dashpots + 40.0)
    pair = np.array([[2.0, -1.0], [-1.0, 1.0]])
    specimen = Specimen(np.full(2, 100.0), 7e4 * pair, 200.0 * pair)
    part = ProgramPart(Description("opensees", str(file), "", "build", 4, 1), 200.0)
    whole = replace(
        Building(numerical, specimen, 0.0, *assemble(numerical, specimen, 0.0)), program=part, laws=laws_of_program(3)
    )
    time_s = np.arange(0.0, 1.2, 0.004)
    ground = np.sin(2.0 * np.pi * 2.0 * time_s) * np.exp(-((6.0 * (time_s - 0.5)) ** 2))
    found = simulate_with_program(whole, 0.004, ground)
    rates = [-np.linalg.solve(whole.M, matrix) for matrix in (whole.K, whole.C)]
    A = np.block([[np.zeros((5, 5)), np.eye(5)], rates])
    B = np.concatenate([np.zeros(5), -np.ones(5)])[:, None]
    exact = lsim((A, B, np.eye(10)[:5], np.zeros((5, 1))), ground, time_s)[1].T
    assert np.abs(found.rel_disp_m - exact).max() < 2e-4 * np.abs(exact).max()
    assert found.laws is not None
    assert np.abs(found.laws.force_n).max() < 1e-4 * 9e4 * np.abs(exact[0]).max()  # no residual
