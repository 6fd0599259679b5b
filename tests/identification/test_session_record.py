"""What changed between two sessions, found by the same record in both, against records of a plant by scipy."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bench import rig_info
from portfolio import parametrize_first
from scipy.linalg import expm
from scipy.signal import dlsim

from rths_cli.identification.record_parts import Parts, Record
from rths_cli.identification.session_record import low_level_lines, session_change
from rths_cli.numerics.lti import Model
from rths_cli.rigs.description import Channel
from rths_cli.structure import Specimen

DT, LATENCY, DRIFT = 1e-3, 1, 5e-4
MASSES = np.array([6.91, 6.95])
STIFFNESS = np.array([7331.56, 7376.40])
RATIOS = np.array([0.043, 0.039])
LOOP_HZ, LOOP_RATIO, LAG_S, M_PER_V = 14.0, 0.6, 0.0015, 0.0079
RIPPLE = -1.4
NOISE = 3e-4


def specimen(stiffness):
    """Return M, C, K and frequencies of two storeys with modal damping."""
    K = np.array([[stiffness[0] + stiffness[1], -stiffness[1]], [-stiffness[1], stiffness[1]]])
    M = np.diag(MASSES)
    squares, vectors = np.linalg.eig(np.linalg.solve(M, K))
    order = np.argsort(squares)
    squares, vectors = squares[order], vectors[:, order]
    vectors = vectors / np.sqrt(np.einsum("ir,ij,jr->r", vectors, M, vectors))
    C = M @ vectors @ np.diag(2.0 * RATIOS * np.sqrt(squares)) @ vectors.T @ M
    return K, C, np.sqrt(squares) / (2.0 * np.pi)


def command(seconds=24.0):
    """Return a command in V that begins and ends at rest."""
    count = round(seconds / DT)
    f = np.fft.rfftfreq(count, DT)
    random = np.random.default_rng(11)
    lines = np.where((f > 0.3) & (f < 40.0), 1.0 / np.maximum(f, 0.3), 0.0) * np.exp(2j * np.pi * random.random(f.size))
    noise = np.fft.irfft(lines, count)
    at_rest, fade = round(2.0 / DT), round(1.0 / DT)
    window = np.ones(count)
    window[:at_rest] = window[-at_rest:] = 0.0
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(fade) / fade)
    window[at_rest : at_rest + fade], window[-at_rest - fade : -at_rest] = ramp, ramp[::-1]
    noise = noise * window
    return 0.05 * noise / noise.std()


def motions(stiffness, late_s, table_gain=1.0):
    """Return accelerations (3, n) of table and floors under the held command, sampled `late_s` (3,) after the clock.

    The table is a second-order loop behind a lag, driven by the command alone; the specimen rides on it.
    """
    K, C, _ = specimen(stiffness)
    w = 2.0 * np.pi * LOOP_HZ
    a, b = np.zeros((7, 7)), np.zeros((7, 1))
    a[0, 1], a[1, 0], a[1, 1], a[1, 6] = 1.0, -(w**2), -2.0 * LOOP_RATIO * w, table_gain * M_PER_V * w**2
    a[6, 6], b[6, 0] = -1.0 / LAG_S, 1.0 / LAG_S
    a[2:4, 4:6] = np.eye(2)
    a[4:6, 2:4], a[4:6, 4:6] = -K / MASSES[:, None], -C / MASSES[:, None]
    out = np.vstack([a[1], a[4:6]])  # of floors: absolute, by the storeys' forces
    a[4:6] -= a[1]  # relative to the table
    u = np.concatenate([[0.0], command()[:-1]])  # held from the next instant on
    whole = np.block([[a, b], [np.zeros((1, 8))]])
    full = expm(DT * whole)
    states = dlsim((full[:7, :7], full[:7, 7:], np.eye(7), np.zeros((7, 1)), DT), u)[2]
    later = [expm(late * whole)[:7] for late in late_s]
    return np.array(
        [(states @ part[:, :7].T + np.outer(u, part[:, 7])) @ row for row, part in zip(out, later, strict=True)]
    )


def record(accel, gain=(1.0, 1.0, 1.0), ripple=0.0, noise=NOISE, seed=0):
    u = command()
    made = accel * np.asarray(gain)[:, None]
    before = np.concatenate([np.zeros(LATENCY + 1), u])
    made[0] += gain[0] * ripple * (before[1 : len(u) + 1] - before[: len(u)])
    made = made + noise * np.random.default_rng(seed).standard_normal(made.shape)
    return Record(u, made, Parts(slice(0, len(u)), slice(0, round(2.0 / DT))))


def rig():
    channels = tuple(Channel(name, 10.0, 49.0, 0.0, 0.0) for name in ("table", "floor_2", "floor_3"))

    return replace(rig_info(), channels=channels, dt_s=DT)


def known(reference, ripple=RIPPLE):
    """Return what an identification keeps: specimen, alias, lines of its record at low level."""
    K, C, hz = specimen(STIFFNESS)
    w = 2.0 * np.pi * LOOP_HZ
    fit = SimpleNamespace(
        specimen=Specimen(MASSES, K, C), stiffness_n_per_m=STIFFNESS, damping_ratio=RATIOS, natural_frequency_hz=hz
    )
    poles = np.append(np.roots([1.0, 2.0 * LOOP_RATIO * w, w**2]), -1.0 / LAG_S).astype(complex)
    table = Model(np.zeros(2, complex), poles, M_PER_V * w**2 / LAG_S, 1.5 * DT, (0.5, 40.0), ripple, LATENCY, DT, 0.0)
    return SimpleNamespace(low_level_lines=low_level_lines(reference, rig(), 0.3, hz[-1]), specimen=fit, best=table)


NO_LAG = np.zeros(3)
QUIET = motions(STIFFNESS, NO_LAG)


def test_gains_lags_and_alias_are_recovered():
    gain, late_s, ripple = np.array([1.0, 1.0012, 0.9991]), np.array([0.0, 3e-5, -2e-5]), -2.4
    before = record(QUIET, ripple=RIPPLE, seed=1)
    after = record(motions(STIFFNESS, -late_s), gain, RIPPLE + ripple, seed=2)
    found = session_change(known(before), after, rig(), DRIFT)
    assert found.ratio == pytest.approx([0.0012, -0.0009], abs=3.0 * found.ratio_error.max())
    assert found.ratio_error.max() < 1e-4
    assert found.late_s[1:] == pytest.approx(late_s[1:], abs=4.0 * found.late_error_s.max())
    assert found.late_error_s.max() < 2e-6
    assert found.ripple_m_s2_per_v == pytest.approx(ripple, abs=4.0 * found.ripple_error_m_s2_per_v)
    assert found.ripple_error_m_s2_per_v < 0.1


def test_a_specimen_and_a_table_that_changed_are_taken_for_nothing_else():
    """1 % of stiffness and 0.5 % of the table's gain are far more than the sensors' 0.05 %: a fiftieth may be left."""
    before = record(QUIET, ripple=RIPPLE, seed=1)
    after = record(motions(STIFFNESS * [1.01, 0.995], NO_LAG, table_gain=1.005), (1.0, 1.0005, 1.0), RIPPLE, seed=2)
    found = session_change(known(before), after, rig(), DRIFT)
    assert found.ratio == pytest.approx([0.0005, 0.0], abs=2e-4)
    assert abs(found.ripple_m_s2_per_v) < 0.1 and np.abs(found.late_s).max() < 5e-6


def test_an_earlier_command_is_told_with_its_delay():
    """All channels are sampled 60 us later in the motion, which is what a command earlier by as much makes of them."""
    before = record(QUIET, ripple=RIPPLE, seed=1)
    after = record(motions(STIFFNESS * [1.003, 1.0], np.full(3, 6e-5)), (1.0, 1.0004, 1.0), RIPPLE, seed=2)
    found = session_change(known(before), after, rig(), DRIFT)
    assert found.ripple_m_s2_per_v != 0.0  # the instant at which the hold's ripple is sampled
    assert found.delay_s == pytest.approx(-6e-5, abs=2e-6) and found.delay_error_s < 1e-6


@pytest.mark.campaign
def test_what_a_damaged_specimen_does_is_not_taken_for_sensors():
    """Its storeys have lost 15 and 50 % of their stiffness; 3 % are followed, a hundredth of it may be left."""
    before = record(QUIET, ripple=RIPPLE, seed=1)
    for factor in (0.85, 0.5):
        after = record(motions(STIFFNESS * factor, NO_LAG), ripple=RIPPLE, seed=2)
        assert not session_change(known(before), after, rig(), DRIFT).believed
    after = record(motions(STIFFNESS * 0.97, NO_LAG), (1.0, 1.0005, 1.0), RIPPLE, seed=2)
    found = session_change(known(before), after, rig(), DRIFT)
    assert found.believed and found.ratio == pytest.approx([0.0005, 0.0], abs=3e-4)


def test_hum_beyond_the_band_is_no_noise_in_it():
    """50 Hz of 20 times the noise, in another phase in each record."""
    records = []
    for seed in (1, 2):
        made = record(QUIET, ripple=RIPPLE, seed=seed)
        hum = 20.0 * NOISE * np.sin(2.0 * np.pi * 50.0 * DT * np.arange(len(made.command_v)) + seed)
        records.append(replace(made, accel_m_s2=made.accel_m_s2 + hum))
    found = session_change(known(records[0]), records[1], rig(), DRIFT)
    assert 0.7 < found.unexplained < 1.5 and found.ratio_error.max() < 4e-5


def test_the_noise_of_a_band_that_the_rest_is_too_short_for_is_that_of_its_lowest_lines():
    """A specimen of one slow storey: two lines of the record, none of the two seconds of rest before it."""
    made = record(QUIET, ripple=RIPPLE)
    slow, wide = (low_level_lines(made, rig(), 0.41, highest_hz) for highest_hz in (0.3, 8.0))
    assert len(slow.frequency_hz) in (1, 2)
    assert slow.noise == pytest.approx(wide.noise, rel=0.6)
    assert low_level_lines(made, rig(), 0.41, 0.2) is None


def test_instants_are_as_they_were_unless_the_record_shows_another():
    found = session_change(
        known(record(QUIET, ripple=RIPPLE, seed=1)), record(QUIET, ripple=RIPPLE, seed=2), rig(), DRIFT
    )
    assert found.ripple_m_s2_per_v == 0.0 and not found.late_s.any()
    assert found.ripple_error_m_s2_per_v == 0.0


@pytest.mark.campaign
@pytest.mark.parametrize("noise", [3e-4, 2e-3])
def test_two_standard_uncertainties_hold_as_often_as_they_say(noise):
    """40 drifts of 0.05 %, instants that move in half of them, 0.5 % of stiffness in half; 0.88 to 1."""
    random, within = np.random.default_rng(5), {"ratio": [], "common": []}
    late_s, softer = np.array([0.0, -2e-5, 3e-5]), STIFFNESS * [1.005, 0.995]
    kinds = [motions(stiffness, late) for stiffness in (STIFFNESS, softer) for late in (NO_LAG, late_s)]
    for number in range(40):
        gain, kind = 1.0 + DRIFT * random.standard_normal(3), number % 4
        before = record(QUIET, ripple=RIPPLE, noise=noise, seed=(number, 0))
        after = record(kinds[kind], gain, RIPPLE + kind % 2, noise=noise, seed=(number, 1))
        found = session_change(known(before), after, rig(), DRIFT)
        within["ratio"] += list(np.abs(found.ratio - (gain[1:] - gain[0])) <= 2.0 * found.ratio_error)
        common = np.sqrt(np.mean(found.covariance[:3, :3]))
        within["common"].append(abs(np.mean(found.gain - gain + 1.0)) <= 2.0 * common)
        assert found.ratio_error.max() < 0.4 * noise  # the record tells, not the prior of 0.07 %
    for name, hits in within.items():
        assert 0.88 <= np.mean(hits) <= 1.0, name


@pytest.mark.campaign
def test_instants_that_have_not_changed_are_seldom_taken_for_changed_ones():
    alarms = 0
    for number in range(30):
        before, after = (record(QUIET, ripple=RIPPLE, seed=(number, part)) for part in (0, 1))
        alarms += session_change(known(before), after, rig(), DRIFT).ripple_m_s2_per_v != 0.0
    assert alarms <= 1


def through(accel, channel, corner_hz, factor):
    """Return accelerations with what one AC coupling makes whose corner is `factor` times the declared one."""
    made, s = accel.copy(), 2j * np.pi * np.fft.rfftfreq(accel.shape[1], DT)
    w = 2.0 * np.pi * corner_hz
    made[channel] = np.fft.irfft((s + w) / (s + factor * w) * np.fft.rfft(accel[channel]), accel.shape[1])
    return made


@parametrize_first(1, "channel", [0, 1])
def test_a_corner_that_moved_is_taken_for_nothing_else(channel):
    coupled = replace(rig(), channels=tuple(replace(one, high_pass_hz=0.024) for one in rig().channels))
    before = record(QUIET, ripple=RIPPLE, seed=1)
    after = record(through(QUIET, channel, 0.024, 1.05), ripple=RIPPLE, seed=2)
    found = session_change(known(before), after, coupled, DRIFT)
    assert found.ripple_m_s2_per_v == 0.0 and not found.late_s.any()
    assert np.all(np.abs(found.ratio) < 3.0 * found.ratio_error) and found.ratio_error.max() < 1e-4


def test_gains_are_found_on_a_rig_that_states_no_drift():
    before = record(QUIET, ripple=RIPPLE, seed=1)
    found = session_change(known(before), record(QUIET, (1.0, 1.001, 1.0), RIPPLE, seed=2), rig(), 0.0)
    assert found.ratio == pytest.approx([0.001, 0.0], abs=3.0 * found.ratio_error.max())
    assert found.ripple_m_s2_per_v == 0.0 and not found.late_s.any()


def test_another_command_or_length_is_not_compared():
    reference = record(QUIET, ripple=RIPPLE, seed=1)
    other = replace(reference, command_v=np.roll(reference.command_v, 40))
    assert session_change(known(reference), other, rig(), DRIFT) == "it has another command"
    short = Record(reference.command_v[:-100], reference.accel_m_s2[:, :-100], reference.parts)
    assert session_change(known(reference), short, rig(), DRIFT) == "it has another length"
    lost = reference.accel_m_s2.copy()
    lost[1, 5000] = np.nan
    assert session_change(known(reference), replace(reference, accel_m_s2=lost), rig(), DRIFT) == "samples are lost"
