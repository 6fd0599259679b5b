"""The pre-flight check on whole cases: what it starts from, and its verdicts on shipped ones."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.metrics import test_band as in_test_band
from rths_cli.analysis.predicted_error import PredictionInputs
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.stability_check import SAFE, UNSAFE, UNSTABLE
from rths_cli.case.load import load_cases
from rths_cli.control.numerical_substructure import all_storeys
from rths_cli.errors import InputError
from rths_cli.experiment.check import as_identified, judge, known_of, preflight_of
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.results import Identification, NonlinearSpecimen
from rths_cli.rigs.from_case import true_building
from rths_cli.structure import storey_values
from rths_cli.structure.storey_laws import stacked


def setup_of(case: str, *settings: str) -> Setup:
    return make_setup(load_cases([case], settings)[0])


@pytest.mark.campaign
@pytest.mark.parametrize("controller", ["FF", "FF+FB"])
def test_the_papers_building_is_safe(controller: str, default_identification: Identification) -> None:
    setup = setup_of("el_centro_low_ff_fb", f"controller={controller}")
    found = preflight_of(setup, default_identification, design_blocks(setup, default_identification))
    assert (found.verdict, found.reasons) == (SAFE, ())
    assert 1e3 * found.critical.delay_s == pytest.approx(7.94, abs=0.02)
    assert found.stability.radius < 1.0
    assert found.prediction is not None
    assert found.prediction.total.storeys.shape == (3,)
    assert (found.prediction.total.storeys < 0.005).all()
    assert found.largest_scaling > 0.3


def test_a_loop_whose_friction_is_countered_must_tolerate_less_change_with_the_level(
    default_identification: Identification,
) -> None:
    """By the share of it that the low-level record showed to be left."""
    friction = default_identification.friction
    assert friction is not None
    apart = tuple(replace(band, ratio=1.08 + 0j, error=0.0) for band in default_identification.levels)
    known = replace(default_identification, friction=replace(friction, held_out=0.91), levels=apart)
    needed = []
    for counters in ("true", "false"):
        setup = setup_of("el_centro_low_ff_fb", f"controller={{kind: FF, friction_compensation: {counters}}}")
        found = preflight_of(setup, known, design_blocks(setup, known)).stability
        assert 1.0 < found.at_hz < 5.0
        needed.append(found.required)
    assert needed[1] - needed[0] == pytest.approx(0.08 * (1.0 - math.sqrt(1.0 - 0.91)), rel=1e-3)


@pytest.mark.campaign
def test_twice_the_largest_scaling_is_unsafe_and_says_which_limit(default_identification: Identification) -> None:
    safe = setup_of("el_centro_low_ff_fb")
    largest = preflight_of(safe, default_identification, design_blocks(safe, default_identification)).largest_scaling
    for factor, verdict in ((0.99, SAFE), (1.01, UNSAFE)):
        setup = setup_of("el_centro_low_ff_fb", f"scaling={factor * largest}")
        found = preflight_of(setup, default_identification, design_blocks(setup, default_identification))
        assert found.verdict == verdict
        assert found.largest_scaling == pytest.approx(largest, rel=1e-3)
        assert all("the limit is" in reason and "(" in reason for reason in found.reasons)


def test_the_bare_building_is_refused(memory: Memory) -> None:
    setup = setup_of("el_centro_bare_ff_fb")
    identified = memory.identify(setup, lambda _: None)
    found = preflight_of(setup, identified, design_blocks(setup, identified))
    assert found.verdict != SAFE
    assert found.reasons
    assert 1e3 * found.critical.delay_s == pytest.approx(1.2, abs=0.1)


def test_a_loop_that_diverges_is_unstable_and_has_no_prediction(default_identification: Identification) -> None:
    """The blocks designed for one sample of latency on a rig as identified with 24 more."""
    setup = setup_of("el_centro_low_ff_fb", "controller=FF")
    late = replace(
        default_identification,
        best=replace(default_identification.best, delay_s=default_identification.best.delay_s + 24 * setup.rig.dt_s),
    )
    found = preflight_of(setup, late, design_blocks(setup, default_identification))
    assert found.verdict == UNSTABLE
    assert found.prediction is None
    assert "spectral radius" in found.reasons[0]


@pytest.mark.campaign
def test_the_expected_error_is_that_of_the_specimen_as_it_is_at_the_level_of_the_test(
    default_identification: Identification,
) -> None:
    """The specimen of a rig whose joints rub is told as identified: what the sensors will show is SIM of it."""
    setup = setup_of("el_centro_high_ff_fb", "scaling=0.1", "table.imperfections.specimen.joint_friction_n=[0.2, 0.1]")
    declared, true = setup.building, true_building(setup.case, setup.building)
    assert true is not None
    summed, nothing = np.tril(np.ones((2, 2))), np.zeros((2, 0))
    rubbing = NonlinearSpecimen(
        stiffness_n_per_m=storey_values(declared.specimen.K),
        dashpots_n_s_per_m=summed.T @ declared.specimen.C @ summed,
        joint_n=np.array([[0.2], [0.1]]),
        joint_m=np.full((2, 1), 5e-5),
        bend_n_per_m=nothing,
        bend_m=nothing,
    )
    identified = replace(default_identification, nonlinear=rubbing)
    found = judge(setup, identified, design_blocks(setup, identified))
    assert found.expected_m_s2 is not None and found.preflight.prediction is not None
    dt, ground = setup.rig.dt_s, setup.motion.accel_m_s2
    shaken = [reference_of(each).sim(each, dt, ground).abs_accel_m_s2 for each in (true, declared)]
    other = rms(in_test_band(shaken[0] - shaken[1], dt))
    assert (other > 3.0 * found.preflight.prediction.total.storeys).all()
    assert found.expected_m_s2 == pytest.approx(np.hypot(other, found.preflight.prediction.total.storeys), rel=0.02)


@pytest.mark.campaign
def test_a_specimen_whose_laws_sim_cannot_follow_is_expected_as_its_linear_equivalent(
    default_setup: Setup, default_identification: Identification
) -> None:
    nothing, stiffness = np.zeros((2, 0)), storey_values(default_setup.building.specimen.K)
    stuck = NonlinearSpecimen(stiffness, np.diag([1.0, 1.0]), np.ones((2, 1)), np.full((2, 1), 1e-15), nothing, nothing)
    bent = replace(default_identification, nonlinear=stuck)
    blocks = design_blocks(default_setup, default_identification)
    with pytest.raises(InputError, match="SIM: "):
        building = as_identified(default_setup, stuck.specimen(default_setup.building.specimen.masses_kg))
        building = replace(building, laws=stacked(building.laws, stuck.laws, 1))
        reference_of(building).sim(building, default_setup.rig.dt_s, default_setup.motion.accel_m_s2)
    found, linear = (judge(default_setup, each, blocks) for each in (bent, replace(bent, nonlinear=None)))
    assert found.expected_m_s2 is not None
    assert found.expected_m_s2.tolist() == linear.expected_m_s2.tolist()


def of_the_default(setup: Setup, identified: Identification) -> PredictionInputs:
    specimen = identified.specimen.specimen
    rig = identified_rig(identified.best, specimen, setup.rig, setup.removes_sensors)
    storeys = all_storeys(setup.building.numerical, setup.rig.dt_s)
    return known_of(setup, identified, design_blocks(setup, identified), rig, storeys, 0.9998)


def test_a_prediction_starts_from_sim_of_the_building_as_identified(
    default_setup: Setup, default_identification: Identification
) -> None:
    known = of_the_default(default_setup, default_identification)
    building = as_identified(default_setup, default_identification.specimen.specimen)
    assert building.specimen is default_identification.specimen.specimen
    assert building.numerical is default_setup.building.numerical
    sim = simulate(building, default_setup.rig.dt_s, default_setup.motion.accel_m_s2)
    found, lines = known.lines.series(known.sim), known.lines
    at = np.arange(found.shape[1]) * lines.reduced_dt_s
    exact = np.array([np.interp(at, default_setup.motion.time_s, row) for row in sim.abs_accel_m_s2])
    assert np.abs(found - exact).max() < 0.02 * np.abs(exact).max()
    moved = sim.rel_vel_m_s[0] + default_setup.motion.velocity_m_s
    assert_allclose(known.velocity_m_s, moved, rtol=1e-6)


def test_a_prediction_knows_nothing_of_the_declared_specimen(
    default_setup: Setup, default_identification: Identification
) -> None:
    """Other stiffness and damping declared for the experimental storeys: not a byte changes."""
    declared = default_setup.building.specimen
    other = replace(default_setup.building, specimen=replace(declared, K=2.0 * declared.K, C=3.0 * declared.C))
    found = [
        of_the_default(replace(default_setup, building=building), default_identification)
        for building in (default_setup.building, other)
    ]
    assert found[0].sim.tobytes() == found[1].sim.tobytes()
    assert found[0].floors.tobytes() == found[1].floors.tobytes()
    assert found[0].loop.loop.tobytes() == found[1].loop.loop.tobytes()


@pytest.mark.campaign
def test_mains_hum_above_the_test_band_is_no_noise_in_it(
    default_setup: Setup, default_identification: Identification
) -> None:
    """A sine of amplitude a adds a^2 / 2 to the mean square at rest."""

    def noise(hum_hz: float) -> np.ndarray:
        hum = 0.03 if hum_hz else 0.0
        reports = tuple(
            replace(c, rest_rms_m_s2=float(np.hypot(0.005, hum / np.sqrt(2.0))), hum_m_s2=hum, hum_hz=hum_hz)
            for c in default_identification.channels
        )
        return of_the_default(default_setup, replace(default_identification, channels=reports)).noise_m_s2

    quiet = noise(0.0)
    assert (quiet > 0.0).all()
    assert_allclose(noise(50.0), quiet, rtol=1e-9)
    assert_allclose(noise(8.0), quiet * np.hypot(1.0, 0.03 / np.sqrt(2.0) / 0.005), rtol=1e-9)


def test_the_prediction_is_near_what_a_run_measures(
    default_setup: Setup, default_identification: Identification
) -> None:
    found = preflight_of(
        default_setup, default_identification, design_blocks(default_setup, default_identification)
    ).prediction
    assert found.total.storeys == pytest.approx([0.00027, 0.00027, 0.00028], rel=0.5)  # docs/reference/paper_tables.md
    assert found.total.tracking == pytest.approx(4.5e-5, rel=0.5)
