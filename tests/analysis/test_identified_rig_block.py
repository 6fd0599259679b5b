"""The identified rig against the exact held table, made from the equations of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import DT_S, LINEAR, held, ideal_info, linear_table, specimen
from hybrid import true_model
from open_loop import floors_per_table, points, rig_as_identified, true_rig

from rths_cli.analysis.identified_rig_block import identified_rig
from rths_cli.numerics.lti import Array, Block, Model

RNG = np.random.default_rng(5)
BAND = np.linspace(0.5, 60.0, 40)


def played(block: Block, command: Array) -> Array:
    """Return the outputs (c, n) of a block from rest."""
    x, out = np.zeros(len(block.A)), []
    for u in command:
        out.append(block.C @ x + block.D[:, 0] * u)
        x = block.A @ x + block.B[:, 0] * u
    return np.array(out).T


@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("interface_mass", [0.0, 1.2])
def test_its_samples_are_those_of_the_exact_table(latency: int, interface_mass: float) -> None:
    info, command = ideal_info(latency_samples=latency), RNG.standard_normal(800)
    found, _ = rig_as_identified(info, interface_mass)
    wanted = played(true_rig(info, interface_mass), command)
    assert wanted.shape == (3, 800)
    assert np.abs(played(found.plant, command) - wanted).max() < 1e-9 * np.abs(wanted).max()


@pytest.mark.parametrize(("delay_samples", "finer"), [(1.25, 4), (0.9, 10), (2.5 + 0.375, 8)])
def test_a_part_of_a_sample_of_delay_is_a_shifted_hold(delay_samples: float, finer: int) -> None:
    """The table stepped `finer` times per sample, the command late by whole fine steps."""
    info, command = ideal_info(), RNG.standard_normal(300)
    found, _ = rig_as_identified(info, delay_samples=delay_samples)
    a, b, rows, _ = linear_table(LINEAR, specimen(), info.channels[0].low_pass_hz)
    step, drive = held(a, b, DT_S / finer)
    late = round((delay_samples - 0.5) * finer)
    fine = np.concatenate([np.zeros(late), np.repeat(command, finer)])
    x, wanted = np.zeros(len(a)), []
    for k in range(300 * finer):
        if k % finer == 0:
            wanted.append(rows @ x * info.channels[0].sensitivity_v_per_unit)
        x = step @ x + drive * fine[k]
    exact = np.array(wanted).T
    assert np.abs(played(found.plant, command) - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("ripple", [0.0, -1.35])
@pytest.mark.parametrize("delay_samples", [0.5, 1.5, 1.25, 3.5])
def test_corrected_it_answers_as_the_model_says(delay_samples: float, ripple: float) -> None:
    """Model, its hold and its staircase alias, in 0.5-60 Hz."""
    info = ideal_info(latency_samples=round(delay_samples - 0.5))
    rig, model = rig_as_identified(info, ripple=ripple, delay_samples=delay_samples)
    found = rig.correction.response(BAND)[0, 0] * rig.plant.response(BAND)[0, 0]
    late = points(BAND, DT_S) ** -max(info.latency_samples, 1)
    found = found + rig.ripple_m_s2_per_v * late * (1.0 - 1.0 / points(BAND, DT_S))
    assert np.abs(found / model.sampled_response(BAND) - 1.0).max() < 2e-3


def test_floors_follow_the_table_as_the_specimen_does() -> None:
    rig, _ = rig_as_identified(ideal_info())
    samples = rig.plant.response(BAND)[:, 0]
    # the hold's alias, which floors hardly have, is in the table's sample
    assert samples[1:] / samples[0] == pytest.approx(floors_per_table(BAND)[1:], rel=0.03, abs=0.01)


@pytest.mark.parametrize("removes_sensors", [True, False])
@pytest.mark.parametrize("delay_s", [1.25 * DT_S, 0.0])
def test_a_model_with_as_many_zeros_as_poles_has_a_direct_path(delay_s: float, removes_sensors: bool) -> None:
    """Its step, its size above the poles, reaches table and floors."""
    pairs = np.array([-30.0 + 40.0j, -30.0 - 40.0j]), np.array([-90.0 + 60.0j, -90.0 - 60.0j])
    model = Model(*pairs, 20.0, delay_s, (0.5, 60.0), 0.0, 1, DT_S if delay_s else 0.0)
    rig = identified_rig(model, specimen(), ideal_info(), removes_sensors)
    f = np.linspace(1.0, 20.0, 20)
    found = np.einsum("cdm,dm->cm", rig.correction.response(f), rig.plant.response(f)[:, 0])
    whole = found[0] + rig.ripple_m_s2_per_v * (points(f, DT_S) ** -1 - points(f, DT_S) ** -2)
    assert np.abs(whole / model.response(f) - 1.0).max() < 5e-3
    # the floors hold the table's average between samples, its samples do not: the model's response is the average
    assert np.abs(found[1:] / (model.response(f) * floors_per_table(f)[1:]) - 1.0).max() < 5e-3


def test_a_model_without_delay_has_no_hold_of_its_own() -> None:
    """Straight lines between samples: right to second order of the step, no half sample late."""
    model = replace(true_model(0.0), dt_s=0.0)
    rig = identified_rig(model, specimen(), ideal_info(), True)
    f = np.linspace(0.5, 20.0, 20)
    over = rig.correction.response(f)[0, 0] * rig.plant.response(f)[0, 0] / model.response(f)
    assert np.abs(over - 1.0).max() < 2e-3
    assert rig.ripple_m_s2_per_v == model.ripple_m_s2_per_v


def test_sensors_are_left_alone_when_the_model_holds_them() -> None:
    """Then the samples are the chain's own outputs, in V, and the correction is a gain."""
    info = ideal_info()
    model = true_model(1.5 * DT_S)
    rig = identified_rig(model, specimen(), info, False)
    a, b, _, true = linear_table(LINEAR, specimen(), 1549.0)
    step, drive = held(a, b, DT_S)
    z = points(BAND, DT_S)
    exact = np.array([true @ np.linalg.solve(p * np.eye(len(a)) - step, drive) / p for p in z]).T
    sensitivity = info.channels[0].sensitivity_v_per_unit
    assert np.abs(rig.plant.response(BAND)[:, 0] / (sensitivity * exact) - 1.0).max() < 1e-8
    gain = rig.correction.response(BAND)
    assert np.abs(gain - np.eye(3)[:, :, None] / sensitivity).max() < 1e-12


def test_the_ac_coupling_is_left_out_with_its_correction() -> None:
    info = ideal_info(high_pass_hz=0.024)
    with_coupling, _ = rig_as_identified(info)
    without, _ = rig_as_identified(ideal_info())
    assert with_coupling.correction.D.tobytes() == without.correction.D.tobytes()
    assert with_coupling.correction.A.tobytes() == without.correction.A.tobytes()
    assert np.abs(np.linalg.eigvals(with_coupling.correction.A)).max() < 0.5


@pytest.mark.parametrize("delay_s", [1.25 * DT_S, 0.0])
def test_each_channel_has_the_corner_of_its_own_sensor(delay_s: float) -> None:
    """A sensor without low pass leaves the others theirs: row by row, the rigs whose sensors are all alike."""
    pairs = np.array([-30.0 + 40.0j, -30.0 - 40.0j]), np.array([-90.0 + 60.0j, -90.0 - 60.0j])
    model = Model(*pairs, 20.0, delay_s, (0.5, 60.0), 0.0, 1, DT_S if delay_s else 0.0)

    def samples(*low_pass_hz: float) -> Array:
        info = ideal_info()
        channels = [replace(one, low_pass_hz=hz) for one, hz in zip(info.channels, low_pass_hz, strict=True)]
        return identified_rig(model, specimen(), replace(info, channels=tuple(channels)), True).plant.response(BAND)

    mixed = samples(1549.0, 0.0, 300.0)
    for row, hz in enumerate((1549.0, 0.0, 300.0)):
        alike = samples(hz, hz, hz)
        assert np.abs(mixed[row] / alike[row] - 1.0).max() < 1e-9
    assert np.abs(samples(0.0, 0.0, 0.0)[2] / mixed[2] - 1.0).max() > 0.02
