"""Pitch of a base, found from motions of specimens whose equations of motion are written down here."""

import numpy as np
import pytest
from bench import rig_info
from portfolio import parametrize_first

from rths_cli.identification.pitch import pitch
from rths_cli.identification.sensor_calibration import Priors, fitted
from rths_cli.identification.specimen_fit import Motion, Start

MASSES = {1: [6.9], 2: [6.91, 6.95], 3: [6.91, 6.95, 4.2], 6: [2.0] * 6}
STIFFNESS = {1: [7000.0], 2: [7331.56, 7376.40], 3: [9000.0, 7376.40, 5200.0], 6: [2500.0] * 6}
DT_S, SECONDS, HIGHEST_HZ = 0.01, 120.0, 16.0


def rising(count):
    return np.arange(1.0, count + 1.0)


def motion(count, rocking, heights, noise=1e-3, seed=5, ties=0.0, dashpots=0.0, seconds=SECONDS):
    """Return what a table in 400 sines and its floors show: floors of a chain whose base pitches so that the top floor
    moves by `rocking` m per N on it. `ties` in N/m is a spring from the table to the top floor, `dashpots` (n,) in
    N s/m stand beside damping that is proportional to the stiffness."""
    random = np.random.default_rng(seed)
    hz = np.sort(random.uniform(0.4, HIGHEST_HZ, 400))
    s = 2j * np.pi * hz
    lines = random.uniform(0.5, 1.0, 400) * np.exp(2j * np.pi * random.random(400)) / 10.0
    drifts = np.eye(count) - np.eye(count, k=-1)
    M, K = np.diag(MASSES[count]), drifts.T @ np.diag(STIFFNESS[count]) @ drifts
    K[-1, -1] += ties
    C = 0.003 * K + drifts.T @ np.diag(np.broadcast_to(dashpots, count)) @ drifts
    up = np.asarray(heights) / heights[-1]
    K = np.linalg.inv(np.linalg.inv(K) + rocking * np.outer(up, up))
    ones = M @ np.ones(count)
    floors = np.array([1.0 - at**2 * np.linalg.solve(at**2 * M + at * C + K, ones) for at in s]).T
    basis = np.exp(np.outer(s, np.arange(round(seconds / DT_S)) * DT_S))
    signals = (np.vstack([lines, lines * floors]) @ basis).real
    signals += noise * random.standard_normal(signals.shape)
    return Motion(signals[0], signals[1:])


def pitch_of(seen, heights=None, gain=0.01, mass=0.003):
    """Return what is found of a base, gains and masses of these uncertainties."""
    return pitch(chain_of(seen, gain, mass), heights)


def chain_of(seen, gain=0.01, mass=0.003):
    """Return the chain that is fitted with gains and masses of these uncertainties."""
    count = len(seen.floors)
    channels = rig_info().channels[:1] * (count + 1)
    start = Start(1.02 * np.array(STIFFNESS[count]), np.full(count, 0.04))
    every = np.ones(count + 1)
    priors = Priors(gain * every, 1e-3 * every, 1e-6 * every, np.full(count, mass))
    return fitted([seen], DT_S, np.array(MASSES[count]), channels, 0.5, start, priors, HIGHEST_HZ)


@pytest.mark.campaign
@parametrize_first(1, "count", [2, 3])
@parametrize_first(1, "rocking", [2e-7, 2e-6])
def test_pitch_is_found_with_the_storeys_on_a_rigid_base(count, rocking):
    seen = motion(count, rocking, rising(count), noise=1e-4)
    found = pitch_of(seen)
    assert found.seen and found.flexibility_m_per_n == pytest.approx(rocking, rel=0.15)
    assert abs(found.flexibility_m_per_n - rocking) < 2.0 * found.error_m_per_n
    channels = rig_info().channels[:1] * (count + 1)
    start = Start(np.array(STIFFNESS[count]), np.full(count, 0.04))
    none = np.zeros(count + 1)
    chain = fitted([seen], DT_S, np.array(MASSES[count]), channels, 0.5, start, Priors(none, none, none, none[1:]))
    changed = np.abs(chain.stiffness_n_per_m / STIFFNESS[count] - 1.0).max()
    rigid = np.abs(chain.stiffness_n_per_m * found.stiffness_ratio / STIFFNESS[count] - 1.0).max()
    assert rigid < 0.2 * changed


@pytest.mark.campaign
def test_stated_heights_count():
    heights = np.array([1.0, 1.4, 3.0])
    seen = motion(3, 2e-6, heights)
    told, untold = pitch_of(seen, np.diff(heights, prepend=0.0)), pitch_of(seen)
    assert told.flexibility_m_per_n == pytest.approx(2e-6, rel=0.04)
    assert untold.error_m_per_n > 3.0 * told.error_m_per_n  # couplings of other heights do not fit
    assert abs(untold.flexibility_m_per_n - 2e-6) < 2.0 * untold.error_m_per_n  # widened by what is left


@pytest.mark.campaign
def test_uncertainties_cover_the_errors_of_many_records():
    """A systematic tenth of what is found is in them as well."""
    over = []
    for seed in range(30):
        found = pitch_of(motion(2, 1e-7, rising(2), noise=2e-3, seed=seed))
        over.append((found.flexibility_m_per_n - 1e-7) / found.error_m_per_n)
    assert 0.5 < np.sqrt(np.mean(np.square(over))) < 1.2


@pytest.mark.campaign
def test_a_rigid_base_is_not_said_to_pitch():
    assert not pitch_of(motion(3, 0.0, rising(3))).seen


@pytest.mark.campaign
def test_another_stiffness_that_couples_modes_is_not_taken_for_a_base():
    """A spring from the table to the top floor stiffens, pitch only softens."""
    assert not pitch_of(motion(3, 0.0, rising(3), ties=40.0)).seen


@pytest.mark.campaign
@parametrize_first(1, "dashpots", [(20.0, 0.0), (0.0, 20.0), (60.0, 0.0)])
def test_unequal_dampers_are_not_taken_for_a_base_or_masses(dashpots):
    seen = motion(2, 0.0, rising(2), noise=1e-4, dashpots=dashpots)
    assert not pitch_of(seen).seen
    both = motion(2, 2e-6, rising(2), noise=1e-4, dashpots=dashpots)
    assert pitch_of(both).flexibility_m_per_n == pytest.approx(2e-6, rel=0.15)


@pytest.mark.campaign
def test_sensors_or_masses_taken_as_exact_leave_no_statement():
    seen = motion(2, 2e-6, rising(2))
    assert pitch_of(seen, gain=0.0) is None and pitch_of(seen, mass=0.0) is None


@pytest.mark.campaign
def test_six_floors_with_unequal_dampers_settle_at_their_masses():
    """Eigenvectors of either sign made what couples modes jump, and the fit stop with masses that were 1 % off."""
    found = chain_of(motion(6, 0.0, rising(6), noise=1e-4, dashpots=(9.0, 1.0, 4.0, 1.0, 1.0, 1.0)))
    assert found.settled
    assert found.calibration.mass == pytest.approx(np.ones(6), abs=1e-3)


@pytest.mark.campaign
def test_a_storey_too_stiff_to_be_seen_settles(monkeypatch):
    """Its stiffness and the damping of its mode may be almost anything, which says nothing of sensors and masses."""
    monkeypatch.setitem(STIFFNESS, 3, [9000.0, 7376.40, 1e10])
    found = chain_of(motion(3, 0.0, rising(3), noise=1e-4, seconds=30.0))
    assert found.settled
    assert found.calibration.gain == pytest.approx(np.ones(4), abs=1e-3)


def test_a_fit_that_has_not_settled_leaves_no_statement(monkeypatch):
    seen = motion(2, 2e-6, rising(2))
    monkeypatch.setattr("rths_cli.identification.sensor_calibration.TOLERANCE", 0.5)
    monkeypatch.setattr("rths_cli.identification.sensor_calibration.ROUNDS", 1)
    assert pitch_of(seen) is None


def test_one_floor_shows_no_base():
    assert pitch_of(motion(1, 0.0, rising(1))) is None
