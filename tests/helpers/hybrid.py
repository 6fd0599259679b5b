"""Blocks of whole hybrid tests, and the exact closed loop of the same blocks as one matrix."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from bench import DT_S, LINEAR, held, linear_table, specimen

from rths_cli.control import feedback, feedforward, kalman_filter, numerical_substructure, reaction, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Interface
from rths_cli.loop.guard import GuardLimits
from rths_cli.numerics.lti import Array, Block, Model
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Numerical


def storeys(count: int = 1, dashpot_n_s_per_m: float = 22.163, mass_kg: float = 6.93) -> Numerical:
    """Return numerical storeys of 7354 N/m each."""
    differences = np.eye(count) - np.eye(count, k=-1)
    chain = differences.T @ differences
    return Numerical(np.full(count, mass_kg), 7353.98 * chain, dashpot_n_s_per_m * chain)


def true_model(delay_s: float, interface_mass_kg: float = 0.0) -> Model:
    """Return the linear table from command to acceleration by its roots, from the equations of motion."""
    a, b, _, true = linear_table(LINEAR, specimen(), 1.0, 0.0, interface_mass_kg)
    a, b, row = a[:7, :7], b[:7], true[0, :7]
    poles = np.linalg.eigvals(a)
    # zeros of C adj(sI - A) b: two at the origin, four of the specimen on a table held still
    parts = specimen()
    inverse = 1.0 / parts.masses_kg[:, None]
    fixed = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse * parts.K, -inverse * parts.C]])
    zeros = np.concatenate([np.linalg.eigvals(fixed), np.zeros(2)]).astype(complex)
    s = 2j * np.pi * 5.0
    there = row @ np.linalg.solve(s * np.eye(7) - a, b)
    gain = float(np.real(there / np.prod(s - zeros) * np.prod(s - poles)))
    return Model(zeros, poles, gain, delay_s, (0.5, 60.0), 0.0, 1, DT_S)


def best_like(
    info: RigInfo, interface_mass_kg: float = 0.0, numerical_storeys: int = 1, ripple: float = -1.35
) -> Blocks:
    """Return prediction over two samples, lagged inverse, feedback and correction of the staircase and its integral."""
    lead = 2
    model = true_model((info.latency_samples + 0.5) * info.dt_s, interface_mass_kg)
    if info.latency_samples == 2:
        lead = 3
    shear = kalman_filter.predicted_shear(specimen(), interface_mass_kg, lead, info.dt_s)
    return Blocks(
        sensor_correction.correction(info.channels, info.dt_s),
        kalman_filter.kalman_block(specimen(), 1e3, 1.0, info.dt_s, knows_table=True),
        numerical_substructure.interface(storeys(numerical_storeys, mass_kg=6.93 - interface_mass_kg), info.dt_s),
        feedforward.lagged_inverse(model, info.dt_s, lead),
        feedback.lqg(model, 1.0, info.dt_s),
        Interface(shear),
        0.0,
        ripple,
        info.latency_samples,
        ripple_sum_m_s2_per_v=1e-3 * ripple,
        open_loop=kalman_filter.open_loop(specimen(), info.dt_s),
    )


def reacting(info: RigInfo, interface_mass_kg: float = 0.0) -> Blocks:
    """Return the same with a feedforward of the reaction, which expects a specimen of 70 % of the stiffness."""
    blocks, softer = best_like(info, interface_mass_kg), specimen((0.7 * 7331.56, 0.7 * 7376.40))
    counter = reaction.reaction_block(softer, reaction.Compliance(8e-4, 1.5e-3, 0.0), 7.5e-4, 40.0, info.dt_s)
    return replace(blocks, feedforward=reaction.with_reaction(blocks.feedforward, counter))


def paper_like(info: RigInfo, interface_mass_kg: float = 0.0, dashpot_n_s_per_m: float = 22.163) -> Blocks:
    """Return the printed method: leaky inverse, Kalman filter on the floors alone, base shear as measured."""
    model = true_model((info.latency_samples + 0.5) * info.dt_s, interface_mass_kg)
    shear = kalman_filter.measured_shear(specimen(), interface_mass_kg)
    return Blocks(
        sensor_correction.correction(info.channels, info.dt_s),
        kalman_filter.kalman_block(specimen(), 1e3, 1.0, info.dt_s, knows_table=False),
        numerical_substructure.interface(storeys(1, dashpot_n_s_per_m, 6.93 - interface_mass_kg), info.dt_s),
        feedforward.leaky_inverse(model, info.dt_s, 0.05),
        feedback.none(info.dt_s),
        Interface(shear),
        latency_samples=info.latency_samples,
    )


def open_limits(info: RigInfo) -> GuardLimits:
    """Return a guard that lets everything pass."""
    wide, channels = 1e9, len(info.channels)
    return GuardLimits(
        wide,
        wide,
        wide,
        wide,
        wide,
        np.inf,
        info.gain_m_per_v,
        info.dt_s,
        np.ones(channels),
        np.full(channels, wide),
        np.full(channels, wide),
        np.full(channels, wide),
    )


def ground(count: int, dt_s: float = DT_S) -> Array:
    """Return a source (n, 3) of band-limited noise: acceleration, and its integrals by the trapezoidal rule."""
    white = np.random.default_rng(11).standard_normal(count)
    kernel = np.hanning(41) / 20.0
    accel = np.convolve(white, kernel, "same") * np.tanh(np.arange(count) / 100.0)
    velocity = np.concatenate([[0.0], np.cumsum(0.5 * (accel[1:] + accel[:-1]) * dt_s)])
    place = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * dt_s)])
    return np.column_stack([accel, velocity, place])


class Signals:
    """Rows over (state of everything, inputs): every signal of the loop as a linear function of both."""

    def __init__(self, sizes: dict[str, int]) -> None:
        ends = np.cumsum(list(sizes.values()))
        self.width = int(ends[-1])
        self.places = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    def rows(self, name: str) -> Array:
        return np.eye(self.width)[self.places[name]]


@dataclass(frozen=True)
class ClosedLoop:
    """x[k+1] = M x[k] + N u[k]; `rows` gives each logged signal from (x, u)."""

    M: Array
    N: Array
    rows: dict[str, Array]

    @property
    def spectral_radius(self) -> float:
        return float(np.abs(np.linalg.eigvals(self.M)).max())

    def run(self, drive: Array) -> dict[str, Array]:
        """Return each signal (m, n) for a source (n, 3)."""
        n = self.M.shape[0]
        state, both = np.zeros(n), np.zeros((len(drive), n + 3))
        for k, u in enumerate(drive):
            both[k] = np.concatenate([state, u])
            state = self.M @ state + self.N @ u
        return {name: rows @ both.T for name, rows in self.rows.items()}


def closed_loop(info: RigInfo, blocks: Blocks, interface_mass_kg: float = 0.0) -> ClosedLoop:
    """Assemble the sampled loop of table, sensors, latency and blocks with the numerical part as source."""
    channel, lead = info.channels[0], blocks.lead_samples
    a, b, sensed, _ = linear_table(LINEAR, specimen(), channel.low_pass_hz, 0.0, interface_mass_kg)
    table, drive = held(a, b, info.dt_s)
    late, sent = info.latency_samples, max(info.latency_samples, 1) + 1
    sizes = {"table": len(a), "queue": late, "recent": lead, "sent": sent}
    sizes |= {block.name: block.A.shape[0] for block in blocks.named()} | {"input": 3}
    signal = Signals(sizes)
    rows = signal.rows

    def output(block: Block, u: Array) -> Array:
        return block.C @ rows(block.name) + block.D @ u

    def following(block: Block, u: Array) -> Array:
        return block.A @ rows(block.name) + block.B @ u

    samples = sensed @ rows("table") * channel.sensitivity_v_per_unit
    corrected = output(blocks.correction, samples)
    now, before = rows("sent")[-2:]
    corrected[0] -= blocks.ripple_m_s2_per_v * (now - before) + blocks.ripple_sum_m_s2_per_v * (now + before)
    estimated = output(blocks.estimator, corrected)
    weights, recent_weights, sample_weights, share = blocks.interface.force.of_one()
    known = weights @ estimated + recent_weights @ rows("recent") + sample_weights @ corrected
    # desired and base shear at the same instant: two linear equations
    free = output(blocks.numerical, np.vstack([rows("input")[0], np.zeros(signal.width)]))[0]
    coupled = np.array([[1.0, -blocks.numerical.D[0, 1]], [-share, 1.0]])
    desired, shear = np.linalg.solve(coupled, np.vstack([free, known]))
    into = np.vstack([rows("input")[0], shear])
    interface = output(blocks.numerical, into)
    assert np.allclose(interface[0], desired)
    interface[1:] += rows("input")[1:]
    recent = np.vstack([rows("recent"), desired])
    error = np.vstack([recent[0] - corrected[0], np.zeros(signal.width)])  # no limit acts: no shortfall
    command = output(blocks.feedforward, interface) + output(blocks.feedback, error)
    queue = np.vstack([rows("queue"), command])
    following_rows = [
        table @ rows("table") + np.outer(drive, queue[0]),
        queue[1:],
        recent[1:],
        np.vstack([command, rows("sent")[:-1]]),
        following(blocks.correction, samples),
        following(blocks.estimator, corrected),
        following(blocks.numerical, into),
        following(blocks.feedforward, interface),
        following(blocks.feedback, error),
    ]
    whole = np.vstack(following_rows)
    logged = {
        "command_v": command, "desired": interface, "corrected": corrected,
        "estimated": estimated, "base_shear_n": shear[None], "true_displacement_m": rows("table")[:1],
    }  # fmt: skip
    return ClosedLoop(whole[:, :-3], whole[:, -3:], logged)
