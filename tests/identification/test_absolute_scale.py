"""The gain that all accelerometers share and the total mass, by a displacement sensor and a load cell."""

from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info

from rths_cli.identification.absolute_scale import observations, with_scale
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.identification.results import Calibration
from rths_cli.rigs.description import Channel

DT, COUNT = 0.01, 12000
MASSES = np.array([6.91, 6.95])
SENSOR = Channel("lvdt", 1.0, 1.0, 0.0, 0.0, kind="displacement", position="table", uncertainty=0.002)
CELL = Channel("cell", 1.0, 1.0, 0.0, 0.0, kind="force", position="table", uncertainty=0.005, plate_mass_kg=1.5)
STRAIN = Channel("strain", 1.0, 1.0, 0.0, 0.0, kind="strain", position="storey_2")
RIG = replace(rig_info(dt_s=DT), further=(SENSOR, CELL, STRAIN))


def record(gain, mass, of_sensor=1.0, of_cell=1.0, noise=1e-6):
    """Return what sensors show of floors that all move with the table, in 300 sines; the displacement by hand."""
    random = np.random.default_rng(3)
    hz, phase = random.uniform(0.3, 8.0, 300), random.uniform(0.0, 2.0 * np.pi, 300)
    time, w = np.arange(COUNT) * DT, 2.0 * np.pi * hz
    accel = np.sin(np.outer(time, w) + phase) @ np.ones(300) * 0.1
    moved = -np.sin(np.outer(time, w) + phase) @ (0.1 / w**2)
    force = of_cell * (float(MASSES @ mass) + CELL.plate_mass_kg) * accel
    further = np.vstack([of_sensor * moved, force, np.zeros(COUNT)])
    shown = np.array(gain)[:, None] * accel + noise * random.standard_normal((3, COUNT))
    return Record(np.zeros(COUNT), shown, Parts(slice(0, COUNT)), further)


def prior(gain=0.01, mass=0.003):
    """Return what is known of sensors whose ratios are known and whose common gain and total mass are not."""
    spread = np.zeros((11, 11))
    spread[:3, :3], spread[9:, 9:] = gain**2 / 3.0, mass**2 / 2.0
    return Calibration(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), spread)


def test_a_displacement_sensor_finds_the_gain_that_all_share():
    seen = observations([record([1.012, 1.012, 1.012], np.ones(2))], RIG, MASSES, 0.5, 3.2)
    assert [one.place for one in seen] == [0, 1]
    found = with_scale(prior(), seen[:1])
    variance = 0.01**2 / 3.0
    assert np.log(found.gain) == pytest.approx(np.full(3, np.log(1.012) * variance / (variance + 0.002**2)), rel=0.03)
    common = np.repeat([1.0 / 3.0, 0.0], [3, 8])
    assert found.error_of(common) == pytest.approx((1.0 / variance + 1.0 / 0.002**2) ** -0.5, rel=0.06)
    assert np.all(found.mass == 1.0)


def test_a_load_cell_finds_mass_over_gain():
    (of_cell,) = observations([record([0.99] * 3, np.array([1.004, 1.004]))], RIG, MASSES, 0.5, 3.2)[1:]
    plate = CELL.plate_mass_kg / MASSES.sum()  # its inertia is taken off as the table's sensor shows it
    assert of_cell.value == pytest.approx(np.log(1.004 / 0.99) + 0.01 * plate, abs=2e-4)
    found = with_scale(prior(), (of_cell,))
    product = np.concatenate([[0.0, -0.5, -0.5], np.zeros(6), [0.5, 0.5]])
    known = 0.01**2 / 3.0 + 0.003**2 / 2.0
    assert found.error_of(product) == pytest.approx((1.0 / known + 1.0 / 0.005**2) ** -0.5, rel=0.05)
    assert np.log(found.mass).mean() > 0.0 > np.log(found.gain).mean()


def test_a_reversed_channel_and_one_without_uncertainty_change_nothing():
    reversed_one = observations([record([1.0] * 3, np.ones(2), of_sensor=-1.0)], RIG, MASSES, 0.5, 3.2)[:1]
    assert np.isnan(reversed_one[0].value)
    assert np.array_equal(with_scale(prior(), reversed_one).gain, np.ones(3))
    exact = prior(gain=0.0, mass=0.0)
    assert np.array_equal(
        with_scale(exact, observations([record([1.01] * 3, np.ones(2))], RIG, MASSES, 0.5, 3.2)).gain, np.ones(3)
    )
    assert observations([replace(record([1.0] * 3, np.ones(2)), further=None)], RIG, MASSES, 0.5, 3.2) == ()


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(4))
def test_a_short_record_of_noise_shows_the_same_scale(seed):
    """40 s at 100 Hz: a motion of 2,000 sines from 0.3 Hz up, nearly all of its displacement at the lowest ones."""
    random = np.random.default_rng(seed)
    hz, phase = random.uniform(0.3, 8.0, 2000), random.uniform(0.0, 2.0 * np.pi, 2000)
    time, w = np.arange(4000) * DT, 2.0 * np.pi * hz
    waves = np.sin(np.outer(time, w) + phase)
    accel, moved = 0.05 * waves.sum(axis=1), -waves @ (0.05 / w**2)
    further = np.vstack([moved, np.zeros((2, 4000))])
    short = Record(np.zeros(4000), 1.012 * np.tile(accel, (3, 1)), Parts(slice(0, 4000)), further)
    seen = observations([short], replace(RIG, further=(SENSOR,)), MASSES, 0.5, 3.2)[0]
    assert seen.value == pytest.approx(-np.log(1.012), abs=5e-4)
    assert seen.error == pytest.approx(SENSOR.uncertainty, rel=0.05)
