"""Sensors and masses found by the record of an identification, against motions written down as sums of sines."""

from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info
from portfolio import parametrize_first

from rths_cli.control.sensor_correction import correction, recorrected
from rths_cli.identification.sensor_calibration import (
    Priors,
    Problem,
    calibrate,
    calibrated,
    coupling_modes,
    fitted,
    priors_of,
)
from rths_cli.identification.specimen_fit import ChainResponse, Motion, Start, transform
from rths_cli.numerics.lti import Model
from rths_cli.rigs.description import Channel, Uncertainty

MASSES = np.array([6.91, 6.95])
STIFFNESS = np.array([7331.56, 7376.40])
RATIOS = np.array([0.043, 0.039])
CORNER_HZ = 0.024
CHANNELS = tuple(Channel(name, 0.1, 49.0, CORNER_HZ, 1549.0) for name in ("table", "floor_2", "floor_3"))


DECLARED = Uncertainty(0.1, 25e-6, 0.003)


def rig(uncertainty=DECLARED, gain=0.01):
    """Return a rig whose files declare no more than these standard uncertainties."""
    channels = tuple(replace(channel, uncertainty=gain) for channel in CHANNELS)
    return replace(rig_info(), channels=channels, uncertainty=uncertainty)


def priors(uncertainty=DECLARED):
    return priors_of(rig(uncertainty), True, TABLE)


METRES_PER_VOLT = 0.0079
TABLE = Model(np.zeros(2), np.full(3, -30.0), -1.2e5, 0.0, (0.5, 12.0), -1.4, 1, 5e-4, CORNER_HZ)
START = Start(1.02 * STIFFNESS, 1.1 * RATIOS)
BESIDE = coupling_modes(MASSES, START.stiffness_n_per_m)


def transmissibilities(s, masses, stiffness, ratios, dashpots=(0.0, 0.0), rocking=0.0):
    """Return the floors' absolute accelerations per table acceleration (n, m), from the equations of motion.

    `dashpots` in N s/m of the storeys act beside the modal damping, `rocking` in m/N is the top floor's displacement by
    the base's rotation under 1 N on it; the lower floor is half as high.
    """
    K = np.array([[stiffness[0] + stiffness[1], -stiffness[1]], [-stiffness[1], stiffness[1]]])
    M = np.diag(masses)
    squares, vectors = np.linalg.eig(np.linalg.solve(M, K))
    vectors = vectors / np.sqrt(np.einsum("ir,ij,jr->r", vectors, M, vectors))
    order = np.argsort(squares)
    omega, shapes = np.sqrt(squares[order]), vectors[:, order]
    C = M @ shapes @ np.diag(2.0 * ratios * omega) @ shapes.T @ M
    C = C + np.array([[sum(dashpots), -dashpots[1]], [-dashpots[1], dashpots[1]]])
    K = np.linalg.inv(np.linalg.inv(K) + rocking * np.outer([0.5, 1.0], [0.5, 1.0]))
    ones = np.ones(2)
    return np.array([1.0 - at**2 * np.linalg.solve(at**2 * M + at * C + K, M @ ones) for at in s]).T


def motion(
    gain, coupling, late_s, mass, seconds=120.0, dt_s=0.01, noise=1e-3, seed=5, ripple=0.0, joints=0.0, **specimen
):
    """Return what sensors that differ from their declaration show of a table that moves in 400 sines, with an alias of
    its command that is greater by `ripple` than what was taken off.

    `joints` (m/s^2): noise of both floors alike about the second mode, from 7 to 9.5 Hz, as of joints that rub."""
    random = np.random.default_rng(seed)
    hz = np.sort(random.uniform(0.4, 16.0, 400))
    s = 2j * np.pi * hz
    lines = random.uniform(0.5, 1.0, 400) * np.exp(2j * np.pi * random.random(400)) / 10.0
    true = np.vstack([np.ones_like(s), transmissibilities(s, MASSES * mass, STIFFNESS, RATIOS, **specimen)])
    w = 2.0 * np.pi * CORNER_HZ
    sensors = np.array(gain)[:, None] * (s + w) / (s + w * np.array(coupling)[:, None])
    shown = lines * true * sensors * np.exp(-s * np.array(late_s)[:, None])
    time = np.arange(round(seconds / dt_s)) * dt_s
    basis = np.exp(np.outer(s, time))
    signals = (shown @ basis).real + noise * random.standard_normal((3, len(time)))
    if joints:
        rubbing = np.fft.rfft(random.standard_normal(len(time)))
        frequency = np.fft.rfftfreq(len(time), dt_s)
        rubbing = np.fft.irfft(rubbing * ((frequency > 7.0) & (frequency < 9.5)), len(time))
        signals[1:] += joints * rubbing / rubbing.std() * np.array([[1.0], [-0.6]])
    changes = lines / (s**2 * METRES_PER_VOLT) * (1.0 - np.exp(-s * TABLE.dt_s))
    staircase = (changes @ basis).real
    return Motion(signals[0] + ripple * staircase, signals[1:], staircase), dt_s


def chain_of(problem, at):
    """Return the parameters of the chain and of the stiffness that couples its modes."""
    return np.concatenate([at[: 2 * len(MASSES)], problem.values(at)[6]])


def pairs(values):
    """Return the differences of what belongs to floors from what belongs to the table."""
    return values[1:] - values[0]


@pytest.fixture(scope="module")
def off_the_solution():
    """Return a fit's problem and parameters that are not its solution."""
    seen, dt_s = motion([1.01, 0.99, 1.0], np.ones(3), np.zeros(3), np.ones(2), seconds=40.0, ripple=0.02)
    corners = np.full(3, 2.0 * np.pi * CORNER_HZ)
    problem = Problem((transform(seen, dt_s, (0.5, 14.0)),), MASSES, corners, priors(), BESIDE)
    problem = replace(problem, sizes=(np.random.default_rng(4).uniform(0.1, 10.0, problem.lines[0].floors.shape),))
    chain = np.log(np.concatenate([START.stiffness_n_per_m, START.damping_ratio]))
    return problem, np.concatenate([chain, 0.5 * np.random.default_rng(3).standard_normal(problem.free.size)])


def test_slopes_are_the_differences_of_residuals(off_the_solution):
    """Slopes of a variable projection leave out what the linear terms can make (Kaufman)."""
    problem, at = off_the_solution
    slopes, step = problem.posterior(at)[1], 1e-4 * np.eye(len(at))
    data = len(problem.residual(at))
    moved = next(problem.without_sensors(at))[0]
    terms = ChainResponse(moved, MASSES * np.exp(problem.values(at)[3]), chain_of(problem, at), BESIDE)
    for place in range(len(at)):
        wanted = (problem.residual(at + step[place]) - problem.residual(at - step[place])) / 2e-4
        wanted = terms.without_linear_terms(wanted[None])[0]
        assert slopes[place, :data] == pytest.approx(wanted, rel=1e-6, abs=1e-6 * float(np.abs(wanted).max()))


def test_slopes_give_the_slope_of_the_sum_of_squares(off_the_solution):
    problem, at = off_the_solution
    slopes, left = problem.posterior(at)[1], problem.residual(at)
    for place in range(len(at)):
        step = 1e-5 * np.eye(len(at))[place]
        more, less = (problem.residual(at + sign * step) for sign in (1.0, -1.0))
        assert slopes[place, : len(left)] @ left == pytest.approx((more @ more - less @ less) / 4e-5, rel=1e-5)


def test_no_line_shows_masses_stiffnesses_and_couplings_that_all_grow_alike(off_the_solution):
    """The total mass is seen by no accelerometer, however the lines are weighed."""
    problem, at = off_the_solution
    slopes, data = problem.posterior(at)[1], len(problem.residual(at))
    alike, first = np.zeros(len(at)), 2 * len(MASSES)
    alike[: len(MASSES)] = 1.0
    of_masses = (problem.free >= 9) & (problem.free < 11)
    alike[first:][of_masses] = 1.0 / problem.priors.mass
    alike[-len(BESIDE) :] = at[-len(BESIDE) :]
    each = np.linalg.norm(alike[:, None] * slopes[:, :data], axis=1)
    assert np.linalg.norm(alike @ slopes[:, :data]) < 1e-6 * each.max()


def test_masses_may_be_all_that_is_free():
    """One floor on exact sensors whose dynamics stay: nothing but its mass."""
    table, floor = np.random.default_rng(1).standard_normal((2, 4000))
    lines = transform(Motion(table, floor[None]), 0.01, (0.5, 14.0))
    only = Priors(np.zeros(2), np.zeros(2), np.zeros(2), np.array([0.003]))
    problem = Problem((lines,), MASSES[:1], np.zeros(2), only, coupling_modes(MASSES[:1], STIFFNESS[:1]))
    assert problem.posterior(np.array([np.log(7000.0), np.log(0.04), 0.0]))[1].shape[0] == 3


@pytest.mark.campaign
@parametrize_first(1, "seed", range(3))
def test_ratios_are_found_within_their_uncertainty_and_the_common_scale_stays(seed):
    random = np.random.default_rng(100 + seed)
    gain, coupling = np.exp(random.normal(0.0, 0.01, 3)), np.exp(random.normal(0.0, 0.1, 3))
    late_s, mass = random.normal(0.0, 25e-6, 3), np.exp(random.normal(0.0, 0.003, 2))
    seen, dt_s = motion(gain, coupling, late_s, mass)
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    found = chain.calibration
    got = np.concatenate([np.log(found.gain), np.log(found.coupling), found.late_s, np.log(found.mass)])
    off = got - np.concatenate([np.log(gain), np.log(coupling), late_s, np.log(mass)])
    known = np.zeros((7, 11))
    for row, (place, other) in enumerate([(1, 0), (2, 0), (4, 3), (5, 3), (7, 6), (8, 6), (10, 9)]):
        known[row, place], known[row, other] = 1.0, -1.0
    errors = np.array([found.error_of(row) for row in known])
    assert np.all(np.abs(known @ off) < 4.0 * errors)
    assert np.all(errors[:2] < 5e-4) and np.all(errors[4:6] < 3e-6) and errors[6] < 8e-4
    assert np.log(found.gain).mean() == pytest.approx(0.0, abs=1e-4)  # nothing is known of what all sensors share
    assert np.log(found.mass).mean() == pytest.approx(0.0, abs=1e-4)
    wider = [
        max(1.0, np.sqrt((8.0 + differences(known, size, systematic)) / (7.0 + len(known))))
        for known, size, systematic in ((gain, 0.01, 2e-4), (mass, 0.003, 5e-4))
    ]
    assert chain.gain_spread.factor == pytest.approx(np.full(3, wider[0]), rel=0.01)
    assert chain.mass_spread.factor == pytest.approx(np.full(2, wider[1]), rel=0.01)
    common = [found.error_of(np.repeat(row, [3, 6, 2])) for row in ([1.0 / 3.0, 0.0, 0.0], [0.0, 0.0, 0.5])]
    assert common == pytest.approx(np.array(wider) * [0.01 / np.sqrt(3.0), 0.003 / np.sqrt(2.0)], rel=0.02)


def differences(known, size, systematic):
    """Return the sum of squares of the differences of factors from their mean, in a declared standard uncertainty."""
    logs = np.log(known) / np.hypot(size, systematic)
    return float(np.sum((logs - logs.mean()) ** 2))


def test_sensors_and_masses_that_differ_more_than_declared_widen_what_is_not_seen():
    """The common gain of sensors of 4 % is less certain than 1 % / sqrt(3); that they are as declared is unlikely."""
    seen, dt_s = motion(np.exp([0.04, -0.03, -0.01]), np.ones(3), np.zeros(3), np.exp([0.02, -0.02]), seconds=40.0)
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert chain.gain_spread.chance < 1e-5 and chain.mass_spread.chance < 1e-5
    factor = np.sqrt((8.0 + 26.0) / 10.0)
    assert chain.gain_spread.factor == pytest.approx(np.full(3, factor), rel=0.02)
    alike = np.full(11, 0.0)
    alike[:3] = 1.0 / 3.0
    assert chain.calibration.error_of(alike) == pytest.approx(0.01 / np.sqrt(3.0) * factor, rel=0.02)
    assert np.array_equal(chain.calibration.gain_widening, chain.gain_spread.factor)
    assert np.array_equal(chain.calibration.mass_widening, chain.mass_spread.factor)


def test_a_sensor_that_was_compared_keeps_its_uncertainty_beside_others_that_differ():
    seen, dt_s = motion([1.0, 1.03, 0.97], np.ones(3), np.zeros(3), np.ones(2), seconds=40.0)
    compared = replace(priors(), gain=np.array([0.002, 0.01, 0.01]))
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, compared)
    assert chain.gain_spread.factor == pytest.approx([1.0, 26.0**0.5 / 10.0**0.5, 26.0**0.5 / 10.0**0.5], rel=0.02)
    assert chain.calibration.error_of(np.eye(11)[0]) == pytest.approx(0.002, rel=0.02)


def test_sensors_that_agree_are_no_more_certain_than_declared():
    """They agree as well where all were compared with one standard, or are corrected by the ratios of a model."""
    seen, dt_s = motion(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), seconds=40.0)
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert np.all(chain.gain_spread.factor == 1.0) and np.all(chain.mass_spread.factor == 1.0)


def test_errors_that_no_residual_shows_are_no_evidence_against_fine_declarations():
    """Gains 0.03 % and masses 0.05 % apart on a rig that states 0.01 and 0.02 %."""
    seen, dt_s = motion([1.0003, 0.9998, 1.0], np.ones(3), np.zeros(3), [1.0003, 0.9998], seconds=40.0)
    fine = replace(priors(), gain=np.full(3, 1e-4), mass=np.full(2, 2e-4))
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, fine)
    assert chain.gain_spread.chance > 0.05 and chain.mass_spread.chance > 0.05


def test_one_floor_too_stiff_to_be_seen_leaves_everything_as_declared():
    """No stretch shows anything better than the priors."""
    random = np.random.default_rng(1)
    table = random.standard_normal(2000)
    seen = Motion(table, table[None] + 0.3 * random.standard_normal((1, 2000)))
    start, one = (
        Start(np.array([1e9]), np.array([0.02])),
        Priors(*np.full((2, 2), 0.01), np.zeros(2), np.array([0.003])),
    )
    found = calibrate([seen], 0.01, MASSES[:1], CHANNELS[:2], 0.5, start, one)
    assert np.isfinite(found.covariance).all()
    assert found.error_of(np.eye(7)[6]) == pytest.approx(0.003, rel=0.02)


@pytest.mark.campaign
def test_a_record_that_shows_no_differences_leaves_uncertainties_as_declared():
    seen, dt_s = motion(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), seconds=4.0, noise=30.0)
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert chain.gain_spread.chance > 0.05 and np.all(chain.gain_spread.factor < 1.1)
    assert chain.mass_spread.chance > 0.05 and np.all(chain.mass_spread.factor < 1.1)


@pytest.mark.campaign
@pytest.mark.parametrize("joints", [0.0, 1.0])
def test_uncertainties_cover_the_errors_of_many_records(joints):
    """Of 40 records the errors of the gains' ratios over their uncertainty have a mean square of 1, also where one part
    of the band is a hundred times as noisy as the others."""
    over = []
    for seed in range(40):
        noise = 1e-2 if joints else 3e-2
        seen, dt_s = motion(
            np.ones(3), np.ones(3), np.zeros(3), np.ones(2), seconds=20.0, noise=noise, seed=seed, joints=joints
        )
        found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
        for floor in (1, 2):
            pair = np.zeros(11)
            pair[0], pair[floor] = -1.0, 1.0
            over.append(np.log(found.gain[floor] / found.gain[0]) / found.error_of(pair))
    assert 0.7 < np.sqrt(np.mean(np.square(over))) < 1.3


@pytest.mark.campaign
def test_no_record_makes_gains_and_masses_as_certain_as_its_noise():
    """Motion across a sensor and joints that rub leave 0.02 % of a gain and 0.05 % of a mass, at most the declared."""
    seen, dt_s = motion(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), seconds=40.0, noise=1e-6)
    pairs_of = np.zeros((2, 11))
    pairs_of[0, :2], pairs_of[1, 9:] = (-1.0, 1.0), (-1.0, 1.0)
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert [found.error_of(row) for row in pairs_of] == pytest.approx([2e-4 * 2**0.5, 5e-4 * 2**0.5], rel=0.1)
    fine = replace(priors(), gain=np.full(3, 1e-5), mass=np.full(2, 2e-5))
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, fine)
    assert np.all(np.sqrt(np.diag(found.covariance)[[0, 1, 2, 9, 10]]) <= [1e-5, 1e-5, 1e-5, 2e-5, 2e-5])


@pytest.mark.campaign
def test_lines_beyond_the_excited_band_are_left_out():
    """They hold nothing but ends of the record and noise, whose small residuals would weigh much."""
    seen, dt_s = motion(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), seconds=40.0)
    for high_hz, last_hz in ((10.0, 10.0), (50.0, 1.6 * 1.01 * 8.4)):
        chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors(), high_hz)
        assert chain.problem.lines[0].s.imag[-1] / (2.0 * np.pi) == pytest.approx(last_hz, rel=0.02)


def test_what_is_declared_as_exact_stays():
    seen, dt_s = motion(np.array([1.01, 1.0, 0.99]), np.ones(3), np.zeros(3), np.ones(2), seconds=40.0)
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors(Uncertainty(0.0, 0.0, 0.0)))
    assert np.all(found.coupling == 1.0) and np.all(found.late_s == 0.0) and np.all(found.mass == 1.0)
    assert found.gain[1] / found.gain[0] == pytest.approx(1.0 / 1.01, abs=3e-4)
    assert not found.covariance[3:].any()
    kept = priors_of(rig(), False, TABLE)
    assert not kept.coupling.any() and not kept.late_s.any() and kept.gain.all()


@pytest.mark.campaign
def test_gains_that_are_not_exact_as_declared_are_taken_for_no_corner():
    """Far below the first mode the table's gain and its AC corner look alike over an octave."""
    seen, dt_s = motion(np.array([1.01, 1.0, 1.0]), np.ones(3), np.zeros(3), np.ones(2), ripple=0.02)
    exact = replace(priors(), gain=np.zeros(3), mass=np.zeros(2))
    chain = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, exact)
    assert 0 in chain.doubted and np.all(chain.calibration.coupling == 1.0)
    assert np.sqrt(np.diag(chain.calibration.covariance)[3:6]) == pytest.approx(np.full(3, 0.1))
    free = fitted([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert not len(free.doubted) and free.calibration.gain[0] / free.calibration.gain[1] == pytest.approx(
        1.01, abs=5e-4
    )


@pytest.mark.campaign
def test_a_corner_of_the_table_and_an_alias_that_look_the_same_are_both_left_open():
    """The model of the table takes a greater AC corner for a smaller alias; the corner's uncertainty has to say so."""
    coupling = np.array([1.15, 1.0, 1.0])
    alias = 0.15 * 2.0 * np.pi * CORNER_HZ * METRES_PER_VOLT / TABLE.dt_s  # that hides it, far below resonance
    seen, dt_s = motion(np.ones(3), coupling, np.zeros(3), np.ones(2), seconds=60.0, ripple=alias)
    pair = np.zeros(11)
    pair[3], pair[4] = 1.0, -1.0
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert abs(np.log(found.coupling[0] / found.coupling[1]) - np.log(1.15)) < 2.0 * found.error_of(pair)
    known = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, replace(priors(), ripple_m_s2_per_v=0.0))
    assert abs(np.log(known.coupling[0] / known.coupling[1]) - np.log(1.15)) > 10.0 * known.error_of(pair)


@pytest.mark.campaign
@pytest.mark.parametrize("common", [0.8, 1.2])
def test_the_alias_that_the_tables_model_took_for_a_corner_shows_the_corner_of_all_sensors(common):
    """The model's alias, fitted with the declared corner, hides the true one; the floors show what is missing.

    The table here follows its command at all frequencies, so that its own corner and its alias stay alike."""
    coupling = common * np.array([1.03, 1.0, 0.98])
    hidden = (coupling[0] - 1.0) * 2.0 * np.pi * CORNER_HZ * METRES_PER_VOLT / TABLE.dt_s
    seen, dt_s = motion(np.ones(3), coupling, np.zeros(3), np.ones(2), ripple=hidden, noise=1e-4)
    table = replace(TABLE, poles=np.full(3, -300.0), gain=300.0**3 * METRES_PER_VOLT)
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors_of(rig(), True, table, 0.02))
    errors = np.array([found.error_of(row) for row in np.eye(11)[3:6]])
    assert np.all(np.abs(np.log(found.coupling / coupling)) < 3.0 * errors) and np.all(errors[1:] < 0.03)
    alone = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert np.all([alone.error_of(row) > 0.05 for row in np.eye(11)[3:6]])


@pytest.mark.campaign
@parametrize_first(1, "specimen", [{"dashpots": (0.0, 3.0)}, {"dashpots": (5.0, 0.0)}, {"rocking": 2e-6}])
def test_a_specimen_that_is_no_chain_with_modal_damping_shows_no_false_sensors(specimen):
    """A damper in one storey looks like a sensor that lags, a rocking base like other masses, where modes are alone."""
    seen, dt_s = motion(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), **specimen)
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert np.abs(pairs(np.log(found.gain))).max() < 5e-4
    assert np.abs(pairs(found.late_s)).max() < 8e-6
    assert abs(np.log(found.mass[1] / found.mass[0])) < 2e-3


@pytest.mark.campaign
@parametrize_first(1, "specimen", [{"rocking": 2e-6}, {"dashpots": (3.0, 0.0)}])
def test_a_specimen_that_is_no_chain_shows_no_total_mass_either(specimen):
    seen, dt_s = motion(np.ones(3), np.ones(3), np.zeros(3), np.ones(2), **specimen)
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert found.error_of(np.repeat([0.0, 0.5], [9, 2])) == pytest.approx(0.003 / np.sqrt(2.0), rel=0.01)


def test_a_common_gain_alone_changes_nothing():
    seen, dt_s = motion(np.full(3, 1.02), np.ones(3), np.zeros(3), np.ones(2), seconds=40.0)
    found = calibrate([seen], dt_s, MASSES, CHANNELS, 0.5, START, priors())
    assert found.gain == pytest.approx(np.ones(3), abs=5e-4)


def test_calibrated_channels_undo_what_was_found():
    """Samples of a sensor with other gain, corner and lag, corrected as calibrated, are the motion again."""
    dt_s, hz = 0.0005, np.array([0.6, 3.0, 9.0])
    found = calibration_of(np.array([1.02, 0.99, 1.0]), np.array([1.2, 0.9, 1.0]), np.array([2e-5, -2e-5, 0.0]))
    better = calibrated(CHANNELS, found)
    at = np.exp(2j * np.pi * hz * dt_s)
    s = 2j * np.pi * hz
    block = correction(better, dt_s)
    for i, channel in enumerate(CHANNELS):
        w = 2.0 * np.pi * CORNER_HZ
        sensor = channel.sensitivity_v_per_unit * found.gain[i] * s / (s + w * found.coupling[i])
        sensor = sensor / (1.0 + s / (2.0 * np.pi * channel.low_pass_hz)) * np.exp(-s * found.late_s[i])
        undone = [(block.C @ np.linalg.solve(z * np.eye(len(block.A)) - block.A, block.B) + block.D)[i, i] for z in at]
        assert np.abs(sensor * np.array(undone) - 1.0).max() < 1e-4


def test_a_record_is_corrected_for_other_sensors_than_it_was():
    dt_s, samples = 0.0005, np.random.default_rng(2).standard_normal((3, 4000))
    samples[:, 0] = 0.0
    found = calibration_of(np.array([1.02, 0.99, 1.0]), np.array([1.2, 0.9, 1.0]), np.array([2e-5, -2e-5, 0.0]))
    better = calibrated(CHANNELS, found)
    before, after = (played(correction(channels, dt_s), samples) for channels in (CHANNELS, better))
    assert recorrected(before, CHANNELS, better, dt_s) == pytest.approx(after, abs=1e-9 * np.abs(after).max())


def calibration_of(gain, coupling, late_s):
    from rths_cli.identification.results import Calibration

    return Calibration(gain, coupling, late_s, np.ones(2), np.zeros((11, 11)))


def played(block, samples):
    """Return the outputs (p, n) of a block for inputs (m, n), step by step."""
    state, made = np.zeros(len(block.A)), []
    for given in samples.T:
        made.append(block.C @ state + block.D @ given)
        state = block.A @ state + block.B @ given
    return np.array(made).T
