"""Friction from records, against the force that the virtual tables really have and against made-up friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from made_linear import DT
from made_records import make_info, make_specimen
from portfolio import parametrize_first

from rths_cli.case.load import load_cases
from rths_cli.experiment.identify_command import About
from rths_cli.experiment.identify_on_rig import evaluated, measure
from rths_cli.experiment.model_files import from_groups, to_groups
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.frequency_response import simulate
from rths_cli.identification.friction import estimate
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.identification.results import Friction, Identification
from rths_cli.numerics.lti import Model
from rths_cli.report.identification_page import as_document, page

MINUTE = "identification.duration_s=60"
KILOHERTZ, LATE = "sample_rate_hz=1000", "table.converters={latency_samples: 4}"
FRICTIONLESS = "table.physics={coulomb_n: 0}"
ONE_BIT_V = 3.1e-4
INFO = make_info(make_specimen())
NAMES = ("table", "floor_2", "floor_3")
LIGHT = (
    "structure={numerical: {masses_kg: [6.93], stiffness_n_per_m: [7354]}, experimental: {masses_kg: [1.0], "
    "stiffness_n_per_m: [600], damping_ratios: [0.005]}, damping_levels: {low: {dashpots_n_s_per_m: [22]}}}"
)


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])


@cache
def identified(*settings: str) -> tuple[Setup, Identification]:
    setup = setup_of(*settings)
    measured = measure(setup, lambda _: None)
    return setup, evaluated(setup, measured)


def true_command_v(setup: Setup) -> float:
    """Return the command that holds the friction force in the displacement loop: F_c / ((m_t + m_s) w_c^2 g)."""
    physics = setup.case.table.physics
    omega = 2.0 * np.pi * physics.loop_frequency_hz
    stiffness = (physics.moving_mass_kg + physics.loop_specimen_mass_kg) * omega**2
    return float(physics.coulomb_n / (stiffness * physics.gain_m_per_v))


@parametrize_first(
    2,
    ("settings", "within"),
    [
        ((MINUTE,), 0.01),
        ((MINUTE, KILOHERTZ, LATE, "table.physics={coulomb_n: 1.5, loop_frequency_hz: 20, moving_mass_kg: 11}"), 0.015),
        ((MINUTE, KILOHERTZ, "identification.accel_rms_m_s2=0.5", "identification.latency=kept", LIGHT), 0.02),
        ((MINUTE, KILOHERTZ, "identification.excitation=multisine"), 0.02),
        ((MINUTE, KILOHERTZ, "identification.excitation=sweep", "identification.period_s=20"), 0.055),
        ((MINUTE, KILOHERTZ, "identification.excitation=step"), 0.07),
    ],
    ids=["noise", "strong, stiff loop, late", "low level, light", "multisine", "sweep", "step"],
)
def test_friction_is_that_of_the_table(settings: Sequence[str], within: float) -> None:
    setup, found = identified(*settings)
    assert found.friction is not None
    assert found.friction.command_v == pytest.approx(true_command_v(setup), rel=within)
    assert found.friction.error_v < within * found.friction.command_v
    assert found.friction.scale_m_s == pytest.approx(1e-3, rel=1.5)
    assert found.friction.explained > 0.7


@pytest.mark.campaign
@parametrize_first(1, "kind", ["noise", "step"])
def test_a_table_without_friction_shows_none(kind: str) -> None:
    _, found = identified(KILOHERTZ, MINUTE, FRICTIONLESS, f"identification.excitation={kind}")
    assert found.friction is not None
    assert abs(found.friction.command_v) < 3.0 * found.friction.error_v
    assert found.friction.error_v < ONE_BIT_V / 30.0
    assert found.friction.explained < 0.1


def test_the_disturbance_foretells_what_another_record_at_another_level_leaves() -> None:
    _, found = identified(MINUTE)
    setup = setup_of(MINUTE, "identification.accel_rms_m_s2=0.8", "identification.seed=9")
    record = measure(setup, lambda _: None).records[0]
    friction, model, dt = found.friction, found.best, setup.rig.dt_s
    assert friction is not None
    part, n = record.parts.noise, len(record.command_v)
    f = np.fft.rfftfreq(n, dt)
    accel = np.fft.rfft(record.accel_m_s2[0])
    accel[f < 0.2] = 0.0
    velocity = np.fft.irfft(accel / (2j * np.pi * np.maximum(f, 0.2)), n)
    acts = np.fft.rfft(friction.disturbance_v(velocity)) * np.exp(2j * np.pi * f * model.delay_s)
    inside = (f > 1.0) & (f < 12.0)
    foretold = np.fft.irfft(np.where(inside, acts * model.response(f), 0.0), n)[part]
    left = record.accel_m_s2[0] - simulate(model, record.command_v, 60.0)
    left = np.fft.irfft(np.where(inside, np.fft.rfft(left), 0.0), n)[part]
    assert foretold.std() == pytest.approx(left.std(), rel=0.1)
    assert (left - foretold).std() < 0.3 * left.std()


def test_the_disturbance_is_what_the_model_does_not_hold() -> None:
    friction = Friction(2e-4, 1e-6, 0.06, 0.9, 1e-3)
    velocity = 0.06 * np.random.default_rng(1).standard_normal(200_000)
    drawn = friction.disturbance_v(velocity)
    assert friction.disturbance_v(np.array([0.0])) == 0.0
    assert friction.disturbance_v(np.array([0.02]))[0] < 0.0 < friction.disturbance_v(np.array([-0.02]))[0]
    assert np.abs(drawn).max() > 2e-4
    assert np.mean(drawn * velocity) == pytest.approx(0.0, abs=0.01 * 2e-4 * 0.06)
    assert drawn.std() == pytest.approx(2e-4 * np.sqrt(1.0 - 2.0 / np.pi), rel=0.02)


SIMPLE = Model(
    zeros=np.zeros(2, dtype=complex),
    poles=np.array([-53.0 + 70.0j, -53.0 - 70.0j]),
    gain=0.0079 * (53.0**2 + 70.0**2),
    delay_s=1.5 * DT,
    band_hz=(0.5, 60.0),
    dt_s=DT,
)


def made_up(
    seed: int, kappa_v: float, noise_m_s2: float, duration_s: float = 40.0, scale_m_s: float = 1e-3,
    stuck_m: float = 0.0,
) -> Record:  # fmt: skip
    """Return noise played on a simple table with sign(v) friction by fixed-point iteration, less what is linear.

    With `stuck_m` friction is that of Dahl instead.
    """
    random = np.random.default_rng(seed)
    n = round(duration_s / DT)
    f = np.fft.rfftfreq(n, DT)
    s = 2j * np.pi * np.maximum(f, 1e-3)
    lines = np.where((f > 0.3) & (f < 60.0), np.fft.rfft(random.standard_normal(n)) / np.maximum(f, 0.1), 0.0)
    command = np.fft.irfft(lines, n)
    command *= 0.4 / command.std()
    response = np.where(f < 200.0, SIMPLE.response(f), 0.0)
    linear = np.fft.rfft(command) * response
    accel = linear
    for _ in range(4):
        velocity = np.fft.irfft(accel / s, n)
        force = dahl(velocity, stuck_m) if stuck_m else np.tanh(velocity / scale_m_s)
        pushed = force - np.mean(force * velocity) / np.mean(velocity**2) * velocity
        accel = linear - kappa_v * response * np.exp(s * SIMPLE.delay_s) * np.fft.rfft(pushed)
    measured = np.fft.irfft(accel, n) + noise_m_s2 * random.standard_normal(n)
    return Record(command, measured[None], Parts(slice(round(2.0 / DT), n)))


def dahl(velocity: np.ndarray, stuck_m: float) -> np.ndarray:
    """Return the force (n,) of Dahl friction of 1 at a velocity (n,), exact for a constant one in each interval."""
    force, found = 0.0, []
    for one in velocity.tolist():
        limit = np.copysign(1.0, one)
        force = limit + (force - limit) * np.exp(-abs(one) * DT / stuck_m)
        found.append(force)
    return np.array(found)


@pytest.mark.campaign
def test_made_up_friction_is_found_with_an_uncertainty_that_holds() -> None:
    kappa, info = 3e-4, make_info(make_specimen())
    found = [estimate([made_up(seed, kappa, 0.1)], SIMPLE, info) for seed in range(16)]
    sizes = np.array([friction.command_v for friction in found if friction is not None])
    errors = np.array([friction.error_v for friction in found if friction is not None])
    assert len(sizes) == 16
    assert 0.02 * kappa < errors.mean() < 0.2 * kappa
    assert 0.6 < np.sqrt(np.mean(((sizes - kappa) / errors) ** 2)) < 1.5
    assert abs(sizes.mean() - kappa) < 3.0 * errors.mean() / 4.0


def test_the_velocity_is_that_of_the_excited_table() -> None:
    record, info = made_up(4, 3e-4, 0.0), make_info(make_specimen())
    n = len(record.command_v)
    f = np.maximum(np.fft.rfftfreq(n, DT), 0.2)
    velocity = np.fft.irfft(np.fft.rfft(record.accel_m_s2[0]) / (2j * np.pi * f), n)[record.parts.noise]
    found = estimate([record], SIMPLE, info)
    assert found is not None and found.velocity_rms_m_s == pytest.approx(velocity.std(), rel=0.005)


def test_friction_that_fades_near_standstill_is_found_too() -> None:
    found = estimate([made_up(1, 3e-4, 1e-3, scale_m_s=4e-3)], SIMPLE, make_info(make_specimen()))
    assert found is not None and found.command_v == pytest.approx(3e-4, rel=0.006)


@pytest.mark.campaign
@parametrize_first(1, ("stuck_m", "most"), [(1e-4, 0.3), (2e-4, 0.8), (6e-4, 1.5)])
def test_friction_in_slip_is_found_where_it_holds_like_a_spring_at_reversals(stuck_m: float, most: float) -> None:
    """Dahl's law, dz = v - abs(v) z / stuck: the force after a way x from a reversal is 1 - 2 exp(-x / stuck)."""
    found = estimate([made_up(3, 3e-4, 1e-2, stuck_m=stuck_m)], SIMPLE, INFO)
    assert found is not None and found.sliding_v is not None and found.sliding_error_v is not None
    assert abs(found.sliding_v - 3e-4) < 2.0 * found.sliding_error_v < most * 3e-4
    assert found.command_v < 0.7 * 3e-4


def test_friction_in_slip_is_that_of_sign_where_nothing_sticks() -> None:
    found = estimate([made_up(2, 3e-4, 1e-2)], SIMPLE, INFO)
    assert found is not None and found.sliding_v is not None and found.sliding_error_v is not None
    assert abs(found.sliding_v - 3e-4) < 2.0 * found.sliding_error_v < 0.1 * 3e-4


def test_what_every_period_repeats_counts_as_uncertain() -> None:
    ratios = []
    for seed in range(6):
        once = made_up(seed, 3e-4, 0.1, 2.5)
        accel = np.tile(once.accel_m_s2, 16)
        found = estimate([Record(np.tile(once.command_v, 16), accel, Parts(slice(5000, 75000)))], SIMPLE, INFO)
        assert found is not None
        ratios.append((found.command_v - 3e-4) / found.error_v)
    assert np.sqrt(np.mean(np.square(ratios))) < 2.5


def test_friction_is_that_of_all_records_together() -> None:
    info = make_info(make_specimen())
    one, other = made_up(1, 1e-4, 1e-3), made_up(2, 3e-4, 1e-3, 50.0)
    both = estimate([one, other], SIMPLE, info)
    assert both is not None and 1.3e-4 < both.command_v < 2.9e-4


def test_what_does_not_tell_friction_gives_none() -> None:
    info, record = make_info(make_specimen()), made_up(1, 3e-4, 0.0)
    short = replace(record, parts=Parts(slice(4000, 4000 + round(15.0 / DT))))
    assert estimate([short], SIMPLE, info) is None
    assert estimate([record], replace(SIMPLE, band_hz=(0.5, 6.0)), info) is None
    still = Record(np.zeros(80_000), np.zeros((1, 80_000)), Parts(slice(0, 80_000)))
    assert estimate([still], SIMPLE, info) is None


def test_a_model_file_keeps_friction_and_one_from_before_is_read() -> None:
    _, found = identified(MINUTE)
    groups = to_groups(found, NAMES)
    assert groups["friction"]["command_v"].units == groups["friction"]["error_v"].units == "V"
    assert groups["friction"]["velocity_rms_m_s"].units == groups["friction"]["scale_m_s"].units == "m/s"
    values = {group: {name: entry.data for name, entry in entries.items()} for group, entries in groups.items()}
    assert from_groups(values, NAMES).friction == found.friction
    del values["friction"]
    assert from_groups(values, NAMES).friction is None


def test_page_and_document_say_how_large_friction_is() -> None:
    about = About("aps400", "virtual", "made for this test")
    _, found = identified(MINUTE)
    seen = replace(found, friction=Friction(2.353e-4, 0.5e-6, 0.066, 0.984, 1e-3))
    text = " ".join(page(seen, about).split())
    moved = 2.353e-4 * seen.best.low_frequency_gain_m_per_v
    assert f"friction like 0.2353 +- 0.0010 mV of command ({1e6 * moved:.3g} um of the table)" in text
    assert "98.4 % of the power" in text
    shown = as_document(seen, about)["friction"]
    assert shown["displacement_m"] == pytest.approx(moved) and shown["command_v"] == 2.353e-4
    none = replace(found, friction=Friction(-1e-6, 0.5e-6, 0.066, 0.0, 1e-3))
    assert "friction none beyond the scatter: -0.0010 +- 0.0010 mV" in " ".join(page(none, about).split())
    without = replace(found, friction=None)
    assert "mV of command" not in page(without, about) and as_document(without, about)["friction"] is None
