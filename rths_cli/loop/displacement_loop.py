"""The loop of a test whose actuator tracks the displacement of a numerical substructure and returns the force.

One compiled loop for all compensators. At sample k the storeys' state is x[k], the actuator shows displacement d[k] and
force f[k], noise included. The compensator makes the command u[k] from the desired motion and from d[k], f[k], through
A/D and D/A; then plant, storeys and reference go on to k + 1 with u[k] held, the ground acceleration of the middle of
the sample, and a force that is held: f[k-1], one sample late, or that force predicted to the middle of the sample,

    f[k-1] + k (x + x' dt / 2 - x[k-1]) + c (x' + x'' dt / 2 - x'[k-1]) + 3/2 m (x'' - x''[k-1])

with the identified specimen m, c, k and the interface's desired motion. Predicting changes by how much the force grows
over a sample and a half; what the specimen does more than its model is measured all the same.
"""

from __future__ import annotations

from typing import NamedTuple

from rths_cli.loop.adapted_states import Held, hold
from rths_cli.numerics.compiled import borrowed, entry, part
from rths_cli.numerics.lti import Array, Integers
from rths_cli.numerics.user_functions import call_command
from rths_cli.rigs.virtual.servo_hydraulic import DISPLACEMENT, FORCE, SampledActuator, advance, limited

MOST_M = 1.0  # a displacement beyond which the loop has diverged
INTO = 5  # inputs of a block: desired acceleration, velocity, displacement; measured displacement, force
REMEMBERED = 6  # force of the sample before, desired displacement, velocity, acceleration before, command, force held
FORCE_BEFORE, DISP_BEFORE, VELOCITY_BEFORE, ACCEL_BEFORE, SENT, HELD = range(REMEMBERED)


class Storeys(NamedTuple):
    """Numerical storeys for a held ground acceleration a_g and interface force f, state (2 n,): x, then x'."""

    sampled: Array  # (2 n, 2 n)
    driven: Array  # (2 n, 2) by a_g and f
    accel: Array  # (2 n + 2,) row of x'' of the interface, the first of x, from state, a_g and f


class Law(NamedTuple):
    """A compensator: a block of n states, desired motion (acceleration, velocity, displacement), measured displacement
    and force, or where `address` is not 0 a compiled command."""

    address: int
    parameters: Array  # (p,)
    rows: Integers  # (m,) of what is not 0 in [A B; C D], (n + 1, n + 5)
    columns: Integers  # (m,)
    values: Array  # (m,)
    given: Array  # (n + 5,) handed over
    after: Array  # (n + 1,) the next state, and of a block the command
    desired: Array  # (3,) handed over
    measured: Array  # (2,) handed over
    held: Held  # the parameters that move; its state is the law's


class Converters(NamedTuple):
    """Converters, noise of the sensors, and the specimen by which the force is predicted; all 0: it is not."""

    dt_s: float
    quantum: float  # of A/D and D/A in m (of velocity and acceleration in their units); 0: none
    range_m: float
    disp_noise_m: float  # standard deviation per sample; both sensors have the same draw
    force_noise_n: float
    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float


class State(NamedTuple):
    """All states of the loop, which it changes."""

    storeys: Array  # (2 n,)
    actuator: Array  # (5,)
    law: Array  # (n,)
    before: Array  # (REMEMBERED,)
    work: Array  # (2 n,)
    late: Array  # (l,) commands on their way to the actuator, the next one first


class Series(NamedTuple):
    """What the loop is given, and what it writes, (samples,) or (storeys, samples)."""

    ground_now: Array  # m/s^2 at the samples
    ground_mid: Array  # between them
    noise: Array  # one standard normal number a sample
    disp: Array  # (storeys, samples) of the numerical storeys, the interface first, m
    moved: Array  # displacement of the actuator, m
    measured: Array  # the same with noise, m
    force: Array  # measured, N
    adapted: Array  # (k, samples) of the parameters of a law that adapts


@part
def _rounded(value: float, quantum: float) -> float:
    return value if quantum == 0.0 else quantum * round(value / quantum)


@part
def _command(law: Law, state: Array, sent: float) -> float:
    """Return the command, and make the next state the state."""
    n = state.size
    if law.address != 0:
        made = call_command(law.address, law.parameters, state, law.after, law.desired, law.measured, sent)
    else:
        for i in range(n):
            law.given[i], law.after[i] = state[i], 0.0
        for q in range(3):
            law.given[n + q] = law.desired[q]
        for q in range(2):
            law.given[n + 3 + q] = law.measured[q]
        law.after[n] = 0.0
        for e in range(law.values.size):
            law.after[law.rows[e]] += law.values[e] * law.given[law.columns[e]]
        made = law.after[n]
    for i in range(n):
        state[i] = law.after[i]
    return made


@part
def _arriving(late: Array, sent: float) -> float:
    """Return the command that reaches the actuator, and move those on their way on."""
    if late.size == 0:
        return sent
    first = late[0] + 0.0
    for i in range(late.size - 1):
        late[i] = late[i + 1] + 0.0
    late[late.size - 1] = sent
    return first


@part
def _advance_storeys(storeys: Storeys, state: State, ground: float, force: float) -> None:
    x, after = state.storeys, state.work
    for i in range(x.size):
        after[i] = storeys.driven[i, 0] * ground + storeys.driven[i, 1] * force
        for j in range(x.size):
            after[i] += storeys.sampled[i, j] * x[j]
    for i in range(x.size):
        x[i] = after[i]


@entry
def play(
    storeys: Storeys, plant: SampledActuator, law: Law, made: Converters, state: State, series: Series, first: int,
    end: int,
) -> int:  # fmt: skip
    """Play samples `first` to `end` and return where it ended: `end`, or the sample in which it diverged."""
    storeys, plant, law, made = borrowed((storeys, plant, law, made))
    state, series = borrowed((state, series))
    x, before, n = state.storeys, state.before, state.storeys.size // 2
    for k in range(first, end):
        for i in range(n):
            series.disp[i, k] = x[i]
        series.moved[k] = state.actuator[DISPLACEMENT]
        series.measured[k] = series.moved[k] + made.disp_noise_m * series.noise[k]
        series.force[k] = limited(state.actuator[FORCE], plant.limit_n) + made.force_noise_n * series.noise[k]
        if not (abs(series.moved[k]) < MOST_M and abs(x[0]) < MOST_M):
            return k
        accel = storeys.accel[2 * n] * series.ground_now[k] + storeys.accel[2 * n + 1] * before[HELD]
        for j in range(2 * n):
            accel += storeys.accel[j] * x[j]
        law.desired[0] = _rounded(accel, made.quantum)
        law.desired[1] = _rounded(x[n], made.quantum)
        law.desired[2] = _rounded(limited(x[0], made.range_m), made.quantum)
        law.measured[0] = _rounded(limited(series.measured[k], made.range_m), made.quantum)
        law.measured[1] = series.force[k]
        wanted = _rounded(_command(law, state.law, before[SENT]), made.quantum)
        hold(law.held, abs(law.held.wanted[0]) > made.range_m)
        law.held.wanted[0] = wanted
        for i in range(law.held.values.size):
            series.adapted[i, k] = law.held.values[i]
        before[SENT] = limited(wanted, made.range_m)
        force = before[FORCE_BEFORE]
        force += made.stiffness_n_per_m * (x[0] + 0.5 * made.dt_s * x[n] - before[DISP_BEFORE])
        force += made.damping_n_s_per_m * (x[n] + 0.5 * made.dt_s * accel - before[VELOCITY_BEFORE])
        force += 1.5 * made.mass_kg * (accel - before[ACCEL_BEFORE])
        before[FORCE_BEFORE], before[HELD] = series.force[k], force
        before[DISP_BEFORE], before[VELOCITY_BEFORE], before[ACCEL_BEFORE] = x[0], x[n], accel
        advance(plant, state.actuator, _arriving(state.late, before[SENT]))
        _advance_storeys(storeys, state, series.ground_mid[k], force)
    return end
