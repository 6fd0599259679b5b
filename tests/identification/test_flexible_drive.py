"""A deck on a flexible drive, without friction: its identified model against its equations of motion."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from made_linear import transmissibility
from made_records import make_info, make_specimen
from portfolio import parametrize_first

from rths_cli.identification.excitation import ExcitationSettings, plan
from rths_cli.identification.identify import identify
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array, ComplexArray

REST_S, NOISE_M_S2 = 10.0, 3e-4
COIL_KG, DECK_KG, GAIN_M_PER_V, LAG_S = 1.8, 5.2, 0.0079, 2e-3
LOOP_HZ, LOOP_RATIO, LOOP_KG = 14.0, 0.7, 20.86
SPECIMEN = make_specimen()


def plant(deck_hz: float, deck_ratio: float = 0.03) -> tuple[Array, Array, Array]:
    """Return A, B of the state (positions of coil, deck and floors, their rates, force) and the deck's row of A."""
    deck_n_per_m = DECK_KG * (2.0 * np.pi * deck_hz) ** 2
    deck_n_s_per_m = 2.0 * deck_ratio * np.sqrt(deck_n_per_m * DECK_KG)
    floors = len(SPECIMEN.masses_kg)
    bodies = 2 + floors
    spring, dashpot = np.zeros((2, bodies, bodies))
    for matrix, drive, storeys in (
        (spring, deck_n_per_m, SPECIMEN.K),
        (dashpot, deck_n_s_per_m, SPECIMEN.C),
    ):
        matrix[:2, :2] = drive * np.array([[1.0, -1.0], [-1.0, 1.0]])
        relative = np.hstack([-np.ones((floors, 1)), np.eye(floors)])  # drifts from the deck
        matrix[1:, 1:] += relative.T @ storeys @ relative
    mass = np.concatenate([[COIL_KG, DECK_KG], SPECIMEN.masses_kg])
    omega = 2.0 * np.pi * LOOP_HZ
    a = np.zeros((2 * bodies + 1, 2 * bodies + 1))
    a[:bodies, bodies:-1] = np.eye(bodies)
    a[bodies:-1, :bodies], a[bodies:-1, bodies:-1] = -spring / mass[:, None], -dashpot / mass[:, None]
    a[bodies, -1] = 1.0 / COIL_KG
    a[-1, [0, bodies, -1]] = [-LOOP_KG * omega**2 / LAG_S, -2.0 * LOOP_RATIO * omega * LOOP_KG / LAG_S, -1.0 / LAG_S]
    b = np.zeros((len(a), 1))
    b[-1] = LOOP_KG * omega**2 * GAIN_M_PER_V / LAG_S
    return a, b, a[[bodies + 1]]


def true_response(deck_hz: float, frequency_hz: Array, dt_s: float) -> ComplexArray:
    """Return the response of the deck with the declared delay (one sample of latency, half a sample of hold)."""
    a, b, c = plant(deck_hz)
    s = 2j * np.pi * frequency_hz[:, None, None]
    response = c @ np.linalg.solve(s * np.eye(len(a)) - a, np.tile(b.astype(complex), (len(s), 1, 1)))
    return np.asarray((response * np.exp(-1.5 * s * dt_s))[:, 0, 0])


@cache
def identified(deck_hz: float, dt_s: float, noise_m_s2: float = NOISE_M_S2) -> Identification:
    info = make_info(SPECIMEN, dt_s=dt_s)
    planned = plan(info, ExcitationSettings(duration_s=40.0), 1)
    n = len(planned.command_v) + round(REST_S / dt_s)
    frequency = np.fft.rfftfreq(n, dt_s)
    low = (frequency < 100.0) & (frequency > 0.0)
    hold = np.sinc(frequency[low] * dt_s)
    table = np.fft.rfft(planned.command_v, n)[low] * true_response(deck_hz, frequency[low], dt_s) * hold
    lines = np.zeros((1 + len(SPECIMEN.masses_kg), len(frequency)), dtype=complex)
    lines[:, low] = np.vstack([table, table * transmissibility(SPECIMEN, frequency[low])])
    accel = np.fft.irfft(lines, n)[:, : len(planned.command_v)]
    accel += noise_m_s2 * np.random.default_rng(1).standard_normal(accel.shape)
    return identify([Record(planned.command_v, accel, planned.parts)], info, SPECIMEN.masses_kg)


@parametrize_first(
    1,
    ("deck_hz", "rate_hz", "within"),
    [(45.0, 1000, 0.005), (60.0, 1000, 0.005), (25.0, 500, 0.012), (40.0, 500, 0.012)],
)
def test_a_flexible_drive_without_friction_is_accepted_and_true(deck_hz: float, rate_hz: int, within: float) -> None:
    """At 500 Hz it is found only where the search begins at several resonances of the deck (`table_fit.DECK_HZ`)."""
    dt_s = 1.0 / rate_hz
    found = identified(deck_hz, dt_s)
    assert found.accepted
    f = np.linspace(0.7, 40.0, 400)
    assert np.abs(found.best.response(f) / true_response(deck_hz, f, dt_s) - 1.0).max() < within
    low = f[f < 11.0]
    assert np.abs(found.paper.response(low) / true_response(deck_hz, low, dt_s) - 1.0).max() < 0.005
    assert len(found.paper.poles) == 2 * len(SPECIMEN.masses_kg) + 4


@pytest.mark.parametrize("deck_hz", [45.0, 60.0])
def test_the_poles_are_those_of_the_equations_of_motion(deck_hz: float) -> None:
    found = identified(deck_hz, 1e-3).best.poles
    true = np.linalg.eigvals(plant(deck_hz)[0])
    true = true[np.abs(true) < 2.0 * np.pi * 60.0]  # the measured band
    assert len(true) == 7
    assert np.abs(found[:, None] / true[None, :] - 1.0).min(axis=0).max() < 0.02


def test_a_deck_beyond_the_band_is_not_taken_for_a_wrong_latency() -> None:
    """Noise leaves the deck's roots undetermined and the model without them; the delay is not known then."""
    found = identified(130.0, 1e-3, noise_m_s2=0.01)
    assert found.accepted
    assert len(found.best.poles) == 2 * len(SPECIMEN.masses_kg) + 4  # without the deck
    assert found.latency is None
    assert not [warning for warning in found.warnings if warning.startswith("delay")]
