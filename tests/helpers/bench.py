"""A table, a specimen and their equations of motion as the design states them, written down again for tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.linalg import eigh, expm

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo, Uncertainty
from rths_cli.rigs.virtual import plant_kernel
from rths_cli.rigs.virtual.imperfect.plant import ImperfectPlant
from rths_cli.rigs.virtual.plant_kernel import Plant
from rths_cli.rigs.virtual.virtual_rig import build_plant, fresh_state, normals
from rths_cli.structure import Specimen

DT_S = 5e-4
NO_LIMITS = Limits(1e3, 1e3, 1e6, 1e6)
LINEAR = VirtualPhysics(coulomb_n=0.0, force_limit_n=1e8)


def specimen(stiffness_n_per_m: tuple[float, ...] = (7331.56, 7376.40)) -> Specimen:
    """Return the paper's specimen, or one with other storeys of 6.9 kg; modal damping of 4 %."""
    count = len(stiffness_n_per_m)
    masses = np.array([6.91, 6.95]) if count == 2 else np.full(count, 6.9)
    differences = np.eye(count) - np.eye(count, k=-1)
    stiffness = differences.T @ np.diag(stiffness_n_per_m) @ differences
    squares, shapes = eigh(stiffness, np.diag(masses))
    left = np.diag(masses) @ shapes
    return Specimen(masses, stiffness, left @ np.diag(0.08 * np.sqrt(squares)) @ left.T)


def rig_info(
    *,
    floors: int = 2,
    dt_s: float = DT_S,
    bits: int = 16,
    range_v: float = 10.0,
    latency_samples: int = 1,
    high_pass_hz: float = 0.024,
    low_pass_hz: float = 1549.0,
    limits: Limits | None = None,
) -> RigInfo:
    """Return what a laboratory knows of the table, exactly as it is: 1000 mV/g, 5 g."""
    g = STANDARD_GRAVITY_M_S2
    one = Channel("", 1.0 / g, 5.0 * g, high_pass_hz, low_pass_hz, uncertainty=0.0)
    channels = tuple(replace(one, name=f"channel_{i}") for i in range(1 + floors))
    limits = limits or Limits(0.079, 1.0, 45.0, 445.0)
    return RigInfo(
        "bench", "virtual", dt_s, channels, Converters(bits, range_v), latency_samples, limits, 0.0079, 7.0, 13.86,
        uncertainty=Uncertainty(0.0, 0.0, 0.0),
    )  # fmt: skip


def ideal_info(**options: float) -> RigInfo:
    """Return a rig without quantisation, limits or saturation."""
    info = rig_info(**({"bits": 0, "range_v": 1e6, "high_pass_hz": 0.0, "limits": NO_LIMITS} | options))
    return replace(info, channels=tuple(replace(c, range=1e6) for c in info.channels))


def equations(
    physics: VirtualPhysics, parts: Specimen, interface_mass_kg: float = 0.0
) -> Callable[[Array, float], tuple[Array, Array]]:
    """Return the function of state (x, v, F, floors' disp, floors' vel, rel. to the table) and command in V that gives
    the state's rate and the absolute accelerations of table and floors."""
    n = len(parts.masses_kg)
    mass = physics.moving_mass_kg + interface_mass_kg
    omega = 2.0 * np.pi * physics.loop_frequency_hz

    def rate(state: Array, command_v: float) -> tuple[Array, Array]:
        x, v, force = state[:3]
        disp, vel = state[3 : 3 + n], state[3 + n : 3 + 2 * n]
        floors = np.linalg.solve(np.diag(parts.masses_kg), -parts.K @ disp - parts.C @ vel)
        on_table = -parts.masses_kg @ floors  # Eq. 2.6 without the interface mass
        friction = physics.coulomb_n * np.tanh(v / physics.coulomb_velocity_m_s)
        table = (force - physics.viscous_n_s_per_m * v - friction + on_table) / mass
        wanted = omega**2 * (physics.gain_m_per_v * command_v - x) - 2.0 * physics.loop_damping_ratio * omega * v
        wanted = np.clip((mass + physics.loop_specimen_mass_kg) * wanted, -physics.force_limit_n, physics.force_limit_n)
        force_rate = (wanted - force) / physics.actuator_time_constant_s
        return np.concatenate([[v, table, force_rate], vel, floors - table]), np.concatenate([[table], floors])

    return rate


def linear_table(
    physics: VirtualPhysics,
    parts: Specimen,
    low_pass_hz: float,
    high_pass_hz: float = 0.0,
    interface_mass_kg: float = 0.0,
) -> tuple[Array, Array, Array, Array]:
    """Return A, b of table, specimen and sensors, the rows C of the samples in m/s^2 and the rows T of the true
    accelerations; per channel one state of the low pass z' = w_l (a - z) and one of the high pass s' = w_h (z - s)."""
    rate, n, c = equations(physics, parts, interface_mass_kg), 3 + 2 * len(parts.masses_kg), 1 + len(parts.masses_kg)
    columns = [rate(unit, 0.0) for unit in np.eye(n)]
    mechanics = np.array([derivative for derivative, _ in columns]).T
    true = np.array([accel for _, accel in columns]).T
    low, high = 2.0 * np.pi * low_pass_hz, 2.0 * np.pi * high_pass_hz
    eye, zero = np.eye(c), np.zeros((c, c))
    a = np.block(
        [
            [mechanics, np.zeros((n, 2 * c))],
            [low * true, -low * eye, zero],
            [np.zeros((c, n)), high * eye, -high * eye],
        ]
    )
    b = np.concatenate([rate(np.zeros(n), 1.0)[0], np.zeros(2 * c)])
    return a, b, np.hstack([np.zeros((c, n)), eye, -eye]), np.hstack([true, np.zeros((c, 2 * c))])


def held(a: Array, b: Array, time_s: float) -> tuple[Array, Array]:
    """Return the exact transition over a time in which the input is held."""
    n = len(a)
    both = expm(np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]) * time_s)
    return both[:n, :n], both[:n, n]


def run_plant(
    plant: Plant | ImperfectPlant, info: RigInfo, command_v: Array, noise: Array | None = None
) -> tuple[Array, Array, Array]:
    """Return samples in V (c, n), states (n_states, n) and the velocities in the middle of each interval (c, n).

    Of an imperfect plant the displacement of its deck alone is among the states. `noise` (n, normals); None: none.
    """
    state, count = fresh_state(plant, info.latency_samples), len(command_v)
    samples, shown = np.zeros((len(info.channels), count)), plant.mechanical if isinstance(plant, Plant) else 1
    states, middle, quiet = np.zeros((shown, count)), np.zeros_like(samples), np.zeros(normals(plant))
    one, command = np.zeros(len(info.channels)), np.zeros(1)
    read = plant_kernel.read_samples.bind(plant, state, quiet, one)
    hold = plant_kernel.hold_interval.bind(plant, state, command)
    for k in range(count):
        if noise is not None:
            quiet[:] = noise[k]
        read()
        samples[:, k], states[:, k] = one, state.state[:shown]
        command[0] = command_v[k]
        hold()
        middle[:, k] = state.middle_velocity
    return samples, states, middle


def play_plant(
    info: RigInfo, physics: VirtualPhysics, command_v: Array, *, refine: int = 0, interface_mass_kg: float = 0.0
) -> tuple[Array, Array, Array]:
    """Return what `run_plant` returns for the paper's specimen on a table without sensor noise."""
    plant = build_plant(info, physics, specimen(), 0.0, refine, interface_mass_kg)
    return run_plant(plant, info, command_v)
