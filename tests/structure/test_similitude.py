"""Scale factors against the published table of model types, and against each other by Newton's law."""

from __future__ import annotations

import math

import pytest

from rths_cli.case.structure_schema import ScaleSpec
from rths_cli.quantities import METRICS
from rths_cli.structure import Similitude, similitude_of
from rths_cli.structure.similitude import UNITS, dimensions

LENGTH, STRESS, DENSITY = 2.4, 3.0, 1.6
# Moncarz and Krawinkler, Theory and application of experimental model analysis in earthquake engineering, Report 50,
# John A. Blume Center, Stanford, 1981; Harris and Sabnis, Structural Modeling, 2nd ed., 1999: exponents of the scale
# factors of length, elastic modulus and mass density. A true replica and a model with artificial mass have the same
# factors except that of the density; where gravity is neglected, time follows from the wave speed of the material.
ARTIFICIAL_MASS = {
    "length": (1, 0, 0), "time": (0.5, 0, 0), "frequency": (-0.5, 0, 0), "velocity": (0.5, 0, 0),
    "acceleration": (0, 0, 0), "stress": (0, 1, 0), "force": (2, 1, 0), "energy": (3, 1, 0),
}  # fmt: skip
GRAVITY_NEGLECTED = {
    "length": (1, 0, 0), "time": (1, -0.5, 0.5), "frequency": (-1, 0.5, -0.5), "velocity": (0, 0.5, -0.5),
    "acceleration": (-1, 1, -1), "stress": (0, 1, 0), "force": (2, 1, 0), "energy": (3, 1, 0), "mass": (3, 0, 1),
}  # fmt: skip


def of_table(row: tuple[float, float, float]) -> float:
    return LENGTH ** row[0] * STRESS ** row[1] * DENSITY ** row[2]


def test_artificial_mass_simulation_has_the_factors_of_the_published_table() -> None:
    found = similitude_of(ScaleSpec(length=LENGTH, stress=STRESS)).factors
    assert {name: found[name] for name in ARTIFICIAL_MASS} == pytest.approx(
        {name: of_table(row) for name, row in ARTIFICIAL_MASS.items()}, rel=1e-14
    )


def test_a_model_that_neglects_gravity_has_the_factors_of_the_published_table() -> None:
    acceleration = of_table(GRAVITY_NEGLECTED["acceleration"])
    found = similitude_of(ScaleSpec(length=LENGTH, acceleration=acceleration, stress=STRESS)).factors
    assert {name: found[name] for name in GRAVITY_NEGLECTED} == pytest.approx(
        {name: of_table(row) for name, row in GRAVITY_NEGLECTED.items()}, rel=1e-14
    )


def test_the_scale_of_the_issue() -> None:
    found = similitude_of(ScaleSpec(length=2.4, acceleration=1.0)).factors
    expected = {"time": math.sqrt(2.4), "mass": 5.76, "force": 5.76, "stiffness": 2.4, "dashpot": 2.4**1.5}
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-14)
    assert found["acceleration"] == 1.0  # exactly: a record is not changed by a factor of 1


def test_a_mass_that_is_stated_gives_the_stress() -> None:
    found = similitude_of(ScaleSpec(length=2.0, acceleration=1.5, mass=32.0)).factors
    assert found["stress"] == pytest.approx(32.0 * 1.5 / 2.0**2)
    assert found["mass"] == 32.0


def test_newtons_law_holds_between_the_factors() -> None:
    f = Similitude(2.7, 1.3, 9.0).factors
    inertia, spring, dashpot = (
        f["mass"] * f["acceleration"],
        f["stiffness"] * f["length"],
        f["dashpot"] * f["velocity"],
    )
    assert (inertia, spring, dashpot) == pytest.approx((f["force"],) * 3)
    assert f["energy"] == pytest.approx(f["mass"] * f["velocity"] ** 2)
    assert f["frequency"] == pytest.approx(math.sqrt(f["stiffness"] / f["mass"]))


def test_units_have_their_dimensions() -> None:
    assert dimensions("m^2/s^4") == (0, 2, -4)
    assert dimensions("N*s/m") == (1, 0, -1)
    assert dimensions("N/m^2") == (1, -1, -2)
    assert dimensions("J") == dimensions("N*m") == dimensions("kg*m^2/s^2")
    assert Similitude(2.4, 1.0, 5.76).factor("%") == 1.0


@pytest.mark.parametrize("units", ["V", "m/V", "", "/s", "m s", "m//s", "(m)", "mm", "m/s^"])
def test_what_is_no_mechanical_unit_is_refused(units: str) -> None:
    with pytest.raises(ValueError, match="no mechanical dimensions"):
        dimensions(units)


def test_every_figure_that_scales_has_a_factor() -> None:
    scaled = {path: one for path, one in METRICS.items() if one.scales_as}
    assert {"exp_rths.peak_rel_disp_m", "sim.peak_storey_shear_n", "budget.rms_error_rest_m_s2"} <= set(scaled)
    scale = Similitude(2.4, 1.3, 7.0)
    assert all(scale.factor(one.scales_as) > 0.0 for one in scaled.values())
    # a ratio to the weight and Arias' intensity scale otherwise than their units: gravity is not scaled
    assert {path.partition(".")[2] for path, one in scaled.items() if one.scales_as != one.units} == {
        "arias_m_s",
        "building_base_shear_ratio",
    }


def test_figures_of_rig_and_loop_do_not_scale() -> None:
    for path in ("exp_rths.tracking_delay_s", "sim_delay.critical_delay_s", "sim_delay.psi", "check.peak_force_n",
                 "latency.total_s", "exp_rths.high_pass_hz", "check.limit_displacement_m"):  # fmt: skip
        assert METRICS[path].scales_as == ""


def test_all_printed_factors_have_units() -> None:
    assert set(Similitude(2.0, 1.0, 4.0).factors) == set(UNITS)
