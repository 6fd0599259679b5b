"""Comparisons of sensors and weighings together with a model's ratios, against Gaussian updates solved by hand."""

from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info

from rths_cli.identification.absolute_scale import Measured, after, before, contradiction
from rths_cli.identification.results import Calibration
from rths_cli.rigs.description import Channel, Uncertainty

MASSES = np.array([6.91, 6.95])
SENSOR = Channel("lvdt", 1.0, 1.0, 0.0, 0.0, kind="displacement", position="table", uncertainty=0.003)
CELL = Channel("cell", 1.0, 1.0, 0.0, 0.0, kind="force", position="table", uncertainty=0.005, plate_mass_kg=1.5)
STRAIN = Channel("strain", 1.0, 1.0, 0.0, 0.0, kind="strain", position="storey_2", uncertainty=0.02)
TABLE, FLOOR_2, FLOOR_3 = 0, 1, 2


def rig(*further, mass=0.003):
    base = rig_info()
    sensors = tuple(replace(channel, uncertainty=0.01) for channel in base.channels)
    return replace(base, channels=sensors, further=further, uncertainty=Uncertainty(mass=mass))


def identified(common=0.006, own=0.0008, further=()):
    """Return a calibration whose gains share an error `common` and have each one of their `own`; masses likewise."""
    spread = np.zeros((11, 11))
    spread[:3, :3] = common**2 + own**2 * np.eye(3)
    spread[9:, 9:] = 0.002**2 + 0.0015**2 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    spread[0, 9] = spread[9, 0] = -1e-7
    gain, mass = np.array([1.014, 0.996, 0.990]), np.array([0.9998, 1.0001])
    return Calibration(gain, np.ones(3), np.zeros(3), mass, spread, np.array(further))


def solved(mean, covariance, seen):
    """Return mean and covariance after observations (place, value, error), by normal equations of all at once."""
    inverse = np.linalg.inv(covariance)
    information, right = inverse.copy(), inverse @ mean
    for place, value, error in seen:
        information[place, place] += error**-2
        right[place] += value * error**-2
    covariance = np.linalg.inv(information)
    return covariance @ right, covariance


def test_without_a_model_each_measurement_is_of_its_own_parameter_alone():
    belief = after(before(rig(), MASSES, None), Measured(TABLE, 0.023, 0.002))
    weight = 0.01**2 / (0.01**2 + 0.002**2)
    assert belief.mean == pytest.approx([weight * 0.023, 0.0, 0.0, 0.0, 0.0])
    left = 1.0 / np.sqrt(0.01**-2 + 0.002**-2)
    assert belief.joint == pytest.approx([left, 0.01, 0.01, 0.003, 0.003])
    assert belief.alone == pytest.approx(belief.joint)


def test_with_a_models_ratios_one_comparison_and_one_weighing_move_all():
    found, seen = identified(), [(TABLE, np.log(1.0233), 0.002), (3, np.log(1.001), 0.001)]
    belief = before(rig(), MASSES, found)
    assert np.exp(belief.mean) == pytest.approx([*found.gain, *found.mass])
    places = [0, 1, 2, 9, 10]
    mean, covariance = solved(belief.mean, found.covariance[np.ix_(places, places)], seen)
    for one in seen:
        belief = after(belief, Measured(*one))
    assert belief.mean == pytest.approx(mean, abs=1e-12)
    assert belief.covariance == pytest.approx(covariance, abs=1e-15)
    # by hand: the floors' sensors go with the table's by the share of their error that they have in common
    share = 0.006**2 / (0.006**2 + 0.0008**2)
    moved = belief.mean[TABLE] - np.log(found.gain[TABLE])
    assert belief.mean[FLOOR_2] - np.log(found.gain[1]) == pytest.approx(share * moved, rel=1e-2)
    assert belief.joint[FLOOR_3] < 0.0023 < before(rig(), MASSES, found).joint[FLOOR_3]


def test_a_parameter_by_itself_forgets_the_ratios():
    belief = after(before(rig(), MASSES, identified()), Measured(TABLE, np.log(1.02), 0.002))
    assert belief.alone == pytest.approx([(0.01**-2 + 0.002**-2) ** -0.5, 0.01, 0.01, 0.003, 0.003])


def test_differences_that_widened_the_prior_stay_in_it():
    """The next identification sees the sensors as calibrated, and no differences any more."""
    found = replace(identified(), gain_widening=np.array([1.9, 1.9, 1.0]), mass_widening=np.array([1.0, 1.5]))
    assert before(rig(), MASSES, found).alone == pytest.approx([0.019, 0.019, 0.01, 0.003, 0.0045])
    weighed = replace(rig(), uncertainty=Uncertainty(masses=(0.0005, 0.003)))  # after that identification
    assert before(weighed, MASSES, found).alone[3:] == pytest.approx([0.0005, 0.0045])


def test_sensors_that_the_identification_took_up_follow_accelerometers_and_masses():
    known = rig(SENSOR, CELL, STRAIN)
    found = identified(further=(1.002, 0.997, 1.0))
    belief = before(known, MASSES, found)
    moved = after(belief, Measured(TABLE, float(belief.mean[TABLE]) + 0.004, 1e-9))
    gain, mass = moved.mean[:3] - belief.mean[:3], moved.mean[6:] - belief.mean[6:]
    assert gain[0] == pytest.approx(0.004)
    # a table that moves less by what its accelerometer shows too much: the same volts are of a shorter way
    assert moved.mean[3] - belief.mean[3] == pytest.approx(gain[0])
    share, plate = MASSES / MASSES.sum(), CELL.plate_mass_kg / MASSES.sum()
    demanded = share @ (mass - gain[1:]) - plate * gain[0]
    assert moved.mean[4] - belief.mean[4] == pytest.approx(-demanded)
    assert (moved.mean[5], moved.joint[5]) == (belief.mean[5], pytest.approx(0.02))


def test_a_comparison_of_the_displacement_sensor_finds_the_gain_of_all_accelerometers():
    belief = before(rig(SENSOR), MASSES, identified(own=1e-6, further=(1.002,)))
    after_it = after(belief, Measured(3, float(belief.mean[3]) + 0.005, 0.001))
    weight = 0.006**2 / (0.006**2 + 0.001**2)
    assert after_it.mean[:3] - belief.mean[:3] == pytest.approx(np.full(3, 0.005 * weight), rel=1e-4)
    assert after_it.joint[:3] == pytest.approx(np.full(3, 0.006 * np.sqrt(1.0 - weight)), rel=1e-4)


def test_what_is_declared_as_exact_stays():
    belief = before(rig(mass=0.0), MASSES, None)
    assert after(belief, Measured(4, 0.01, 0.001)) == belief


def test_a_measurement_contradicts_by_the_uncertainties_of_both():
    belief = before(rig(), MASSES, None)
    assert contradiction(belief, Measured(TABLE, -0.05, 0.005)) == pytest.approx(0.05 / np.hypot(0.01, 0.005))
    assert contradiction(belief, Measured(3, 0.003, 0.0)) == pytest.approx(1.0)
