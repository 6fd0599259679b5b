"""Laws of the virtual specimen's storeys: against the same equations by an adaptive solver, restarted at events."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from adaptive_storeys import KINDS
from bench import DT_S, ideal_info, play_plant, run_plant, specimen
from portfolio import parametrize_first
from scipy.integrate import solve_ivp

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import InputError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.rigs.virtual.virtual_rig import build_plant

Stated = Sequence[Sequence[Mapping[str, Any]]]
SPRINGS_N_PER_M = (7331.56, 7376.40)
MASSES_KG = (6.91, 6.95)
BILINEAR = {"kind": "bilinear", "yield_displacement_m": 0.001, "hardening": 0.05}
CLOUGH = {"kind": "clough", "yield_displacement_m": 0.001, "hardening": 0.1, "unloading_exponent": 0.4}
BOUC_WEN = {"kind": "bouc_wen", "yield_displacement_m": 0.001, "hardening": 0.1, "exponent": 2.0}
PINCHED = {**BOUC_WEN, "delta_nu": 0.02, "delta_eta": 0.02, "zeta_s": 0.8, "p": 0.5, "q": 0.1}
FRICTION = {"kind": "friction", "coefficient": 0.03, "sticking_displacement_m": 1e-4, "radius_m": 2.0}
GAP = {"kind": "elastic_gap", "gap_m": 0.001, "contact_n_per_m": 6000.0}
CUBIC = {"kind": "cubic", "cubic_n_per_m3": 4e7, "largest_drift_m": 0.02}
DAMPER = {"kind": "viscous_power", "coefficient": 8.0, "exponent": 0.5, "linear_below_m_per_s": 1e-3}
MAXWELL = {"kind": "maxwell", "spring_n_per_m": 3000.0, "dashpot_n_s_per_m": 40.0}


def peak(values: Array) -> float:
    return float(np.abs(values).max())


def with_laws(stated: Stated, **physics: float) -> VirtualPhysics:
    return VirtualPhysics.model_validate({"specimen_laws": [list(of) for of in stated], **physics})


def command_of(samples: int, size_v: float) -> Array:
    time = np.arange(samples) * DT_S
    return size_v * (np.sin(2.0 * np.pi * 2.0 * time) + 0.4 * np.sin(2.0 * np.pi * 7.3 * time)) * np.tanh(5.0 * time)


def solved(physics: VirtualPhysics, stated: Stated, command_v: Array) -> tuple[Array, Array, int]:
    """Return states (7, n) of table and specimen, absolute accelerations (3, n) and the number of events."""
    parts = specimen()
    weights = STANDARD_GRAVITY_M_S2 * np.cumsum(MASSES_KG[::-1])[::-1]
    laws = [
        (storey, KINDS[one["kind"]](SPRINGS_N_PER_M[storey], {**one, "weight_n": weights[storey]}))
        for storey, of in enumerate(stated)
        for one in of
    ]
    first = np.cumsum([7] + [law.states for _, law in laws])
    own = [slice(a, b) for a, b in pairwise(first)]
    omega, mass = 2.0 * np.pi * physics.loop_frequency_hz, physics.moving_mass_kg

    def drift(y: Array, storey: int) -> tuple[float, float]:
        return (float(y[4] - y[3]), float(y[6] - y[5])) if storey else (float(y[3]), float(y[5]))

    def accelerations(y: Array) -> Array:
        forces = -parts.K @ y[3:5] - parts.C @ y[5:7]
        for (storey, law), mine in zip(laws, own, strict=True):
            force = law.force(*drift(y, storey), y[mine].tolist())
            forces[storey] -= force
            if storey:
                forces[0] += force
        friction = physics.coulomb_n * np.tanh(y[1] / physics.coulomb_velocity_m_s)
        table = (y[2] - physics.viscous_n_s_per_m * y[1] - friction - forces.sum()) / mass
        return np.concatenate([[table], forces / parts.masses_kg])

    def rate(_: float, y: Array, command: float) -> Array:
        accel, made = accelerations(y), np.empty_like(y)
        wanted = omega**2 * (physics.gain_m_per_v * command - y[0]) - 2.0 * physics.loop_damping_ratio * omega * y[1]
        wanted *= mass + physics.loop_specimen_mass_kg
        made[:3] = y[1], accel[0], (wanted - y[2]) / physics.actuator_time_constant_s
        made[3:5], made[5:7] = y[5:7], accel[1:] - accel[0]
        for (storey, law), mine in zip(laws, own, strict=True):
            if law.states:
                made[mine] = law.rates(*drift(y, storey), y[mine].tolist())
        return made

    def ends_of(y: Array, which: int) -> tuple[float, ...]:
        storey, law = laws[which]
        return law.ends(*drift(y, storey), y[own[which]].tolist())

    def watch(which: int, number: int) -> Any:
        def ending(_: float, y: Array, command: float) -> float:
            return ends_of(y, which)[number]

        ending.terminal, ending.direction = True, -1  # type: ignore[attr-defined]
        return ending

    y, events = np.zeros(first[-1]), 0
    states, accels = np.zeros((7, len(command_v))), np.zeros((3, len(command_v)))
    for k in range(len(command_v) - 1):
        t = 0.0
        while t < DT_S:
            endings = [(w, m) for w in range(len(laws)) for m in range(len(ends_of(y, w)))]
            found = solve_ivp(
                rate, (t, DT_S), y, "DOP853", args=(command_v[k],), events=[watch(*one) for one in endings] or None,
                rtol=1e-10, atol=1e-13,
            )  # fmt: skip
            t, y = float(found.t[-1]), found.y[:, -1]
            if found.status == 1:
                which, number = endings[next(m for m, when in enumerate(found.t_events) if when.size)]
                storey, law = laws[which]
                law.next(number, *drift(y, storey), y[own[which]].tolist())
                events += 1
        states[:, k + 1], accels[:, k + 1] = y[:7], accelerations(y)
    return states, accels, events


@pytest.mark.campaign
@parametrize_first(
    2,
    ("stated", "size_v", "least_events"),
    [
        ([[BILINEAR], []], 1.0, 4),
        ([[], [BILINEAR, DAMPER]], 1.0, 4),
        ([[CLOUGH], [MAXWELL]], 1.0, 6),
        ([[PINCHED], [BOUC_WEN]], 1.0, 6),
        ([[FRICTION], [GAP, CUBIC]], 1.0, 6),
    ],
    ids=["bilinear", "bilinear and damper", "clough and maxwell", "bouc-wen", "friction, gap and cubic"],
)
def test_a_specimen_with_laws_agrees_with_an_adaptive_solver(stated: Stated, size_v: float, least_events: int) -> None:
    """Motion and samples within 1e-6 of their peaks; the table has friction as well."""
    info = ideal_info(latency_samples=0, low_pass_hz=0.0)
    command = command_of(800, size_v)
    samples, states, _ = play_plant(info, with_laws(stated), command)
    wanted, accels, events = solved(with_laws(stated), stated, command)
    assert events >= least_events
    for i in range(7):
        assert peak(states[i] - wanted[i]) < 1e-6 * peak(wanted[i]), i
    accel = samples / info.channels[0].sensitivity_v_per_unit
    for c in range(3):
        assert peak(accel[c] - accels[c]) < 1e-6 * peak(accels[c]), c
    linear = play_plant(info, VirtualPhysics(), command)[1]
    assert peak(linear[3] - wanted[3]) > 0.05 * peak(wanted[3])


@pytest.mark.campaign
def test_smaller_inner_steps_bring_a_yielding_specimen_closer() -> None:
    """Beside a change of branch the order is two; halving the step twice takes the error down at least eightfold."""
    info, command = ideal_info(high_pass_hz=0.024), command_of(4000, 0.6)
    physics = with_laws([[BILINEAR], [CLOUGH]])
    plain, finer, finest = (play_plant(info, physics, command, refine=refine) for refine in (0, 2, 4))
    for channel in range(3):
        size, first = peak(finest[0][channel]), peak(plain[0][channel] - finest[0][channel])
        assert 0.0 < 8.0 * peak(finer[0][channel] - finest[0][channel]) < first < 1e-6 * size
        assert peak(plain[2][channel] - finest[2][channel]) < 1e-6 * peak(finest[2][channel])


@pytest.mark.parametrize(
    "stated",
    [
        [[], []],
        [[{**BILINEAR, "hardening": 1.0}], [{**GAP, "contact_n_per_m": 0.0}]],
        [[{**CUBIC, "cubic_n_per_m3": 0.0}], [{**FRICTION, "coefficient": 0.0, "radius_m": None}]],
    ],
)
def test_laws_without_a_force_change_no_byte(stated: Stated) -> None:
    info, command = ideal_info(high_pass_hz=0.024), command_of(1000, 0.6)
    plain, same = play_plant(info, VirtualPhysics(), command), play_plant(info, with_laws(stated), command)
    assert [one.tobytes() for one in plain] == [one.tobytes() for one in same]


def test_laws_that_never_leave_their_first_branch_give_the_linear_specimen() -> None:
    info, command = ideal_info(high_pass_hz=0.024), command_of(1000, 0.6)
    stated = [
        [{**BILINEAR, "yield_displacement_m": 1.0}],
        [{**CLOUGH, "yield_displacement_m": 1.0}, {**GAP, "gap_m": 1.0}],
    ]
    linear, same = play_plant(info, VirtualPhysics(), command)[0], play_plant(info, with_laws(stated), command)[0]
    assert peak(linear - same) < 1e-6 * peak(linear)


def test_a_force_at_its_limit_beside_laws_is_clipped() -> None:
    info, stated = ideal_info(latency_samples=0), [[BILINEAR], []]
    physics = with_laws(stated, force_limit_n=60.0)
    clipped = play_plant(info, physics, command_of(600, 2.0))[1]
    assert 0.95 * 60.0 < peak(clipped[2]) <= 60.0 * (1.0 + 1e-9)


def test_each_run_begins_with_a_specimen_that_has_not_yielded() -> None:
    info, command = ideal_info(), command_of(500, 1.0)
    plant = build_plant(info, with_laws([[CLOUGH], []]), specimen(), 0.0)
    assert np.array_equal(run_plant(plant, info, command)[0], run_plant(plant, info, command)[0])


def test_laws_that_do_not_fit_are_refused() -> None:
    info = ideal_info()
    with pytest.raises(InputError, match=r"specimen_laws: 3 entries for 2 storeys on the table"):
        build_plant(info, with_laws([[BILINEAR], [], []]), specimen(), 0.0)
    steep = {**CUBIC, "cubic_n_per_m3": 1e18}
    with pytest.raises(InputError, match=r"specimen_laws: a law is too steep .* dt = 0\.5 ms; soften it"):
        build_plant(info, with_laws([[steep], []]), specimen(), 0.0)
