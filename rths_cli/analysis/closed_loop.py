"""The closed loop of identified rig, building and blocks: its block matrix, its response line by line, and the
critical delay of a building.

On each line the loop is two equations for base shear f and command u. Signals of the numerical substructure are taken
at k + n_p and signals of the table at k; z^-n_p converts from the first clock to the second:

    f = S_c c + S_d d,  d = N_g g + N_f f,  u = F_a d + F_v v + F_x x + R c + B (z^-n_p d - c_0),  c = P u + e,

with the corrected samples c and their disturbances e, desired acceleration, velocity and displacement d, v, x of the
interface, and ground acceleration g.

Without ground motion, the loop goes from the interface floor's absolute acceleration a through the specimen to the base
shear f(t - delay), and through the numerical substructure back to a: 1 = L(s) exp(-s delay). At a frequency with
|L(j w)| = 1 a delay of (arg L mod 2 pi) / w puts a pole on the imaginary axis; the smallest such delay is critical.

A building with laws has one critical delay per tangent: a range. That is an indication, no proof: a loop that is stable
at every frozen tangent may still diverge, and one that is not may end in a bounded vibration. SIM-DELAY shows which.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.numerics.lti import Array, Block, ComplexArray, StateSpace
from rths_cli.structure import Building
from rths_cli.structure.tangents import at_tangents

FORGOTTEN = 0.1  # a smaller eigenvalue decays within a few samples: it is no motion of table or building
# Highest frequency of a motion that may outlast the padding after a record, whose length sets it and no band; fraction
# of the motion that must be left to count
SLOW_HZ, LEFT = 0.3, 1e-4
COINCIDENT = 1e-3  # relative difference of two real roots that count as one double root

ON_AXIS = 1e-6  # largest real part over size of an eigenvalue that counts as imaginary


class _Rows:
    """Signals of the loop as rows (signals, n + 1) that multiply (state, command); a block has a slice of the state."""

    def __init__(self, sizes: dict[str, int]) -> None:
        ends = np.cumsum(list(sizes.values()))
        self.width = int(ends[-1]) + 1
        self.places = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    def of(self, name: str) -> Array:
        """Return the rows that select the state of a block."""
        return np.eye(self.width)[self.places[name]]

    def output(self, name: str, block: Block, inputs: Array) -> Array:
        """Return the rows of a block's outputs for the rows of its first inputs; further inputs are zero."""
        count = len(inputs)
        return block.C @ self.of(name) + block.D[:, :count] @ inputs

    def following(self, name: str, block: Block, inputs: Array) -> Array:
        """Return the rows of a block's next state for the rows of its first inputs; further inputs are zero."""
        return block.A @ self.of(name) + block.B[:, : len(inputs)] @ inputs


def closed_loop_matrix(rig: IdentifiedRig, blocks: Blocks) -> Array:
    """Return the matrix M (n, n) of a hybrid test without ground motion, guard and rounding: `open_loop`, closed.

    If the rig has a direct path from command to samples, the resulting algebraic loop is solved.
    """
    loop = open_loop(rig, blocks)
    return loop.A - loop.B @ loop.C / (1.0 + loop.D.item())


def open_loop(rig: IdentifiedRig, blocks: Blocks) -> Block:
    """Return the loop of a hybrid test broken at the command, for negative feedback: the command that is sent (V) to
    minus the command that follows from it (V), without ground motion, guard and rounding.

    The order is that of the step. The samples are corrected and give the estimate and the base shear n_p samples ahead.
    The numerical substructure, feedforward and feedback give the command of the same instant. The rig's delay is in the
    states.
    """
    lead, sent = blocks.lead_samples, max(rig.latency_samples, 1) + 1
    numerical, feedforward, feedback = blocks.linear_parts()
    parts = {"rig": rig.plant, "correction": rig.correction, "estimator": blocks.estimator}
    parts |= {"numerical": numerical, "feedforward": feedforward, "feedback": feedback}
    sizes = {"recent": lead, "sent": sent} | {name: len(block.A) for name, block in parts.items()}
    rows = _Rows(sizes)
    command = np.eye(rows.width)[-1:]
    samples = rows.output("rig", rig.plant, command)
    corrected = rows.output("correction", rig.correction, samples)
    (change, total), (now, before) = rig.alias_left(blocks), rows.of("sent")[-2:]
    corrected[0] += change * (now - before) + total * (now + before)
    estimated = rows.output("estimator", blocks.estimator, corrected)
    shear_desired = _coupled(rows, blocks, numerical, corrected, estimated)
    into = np.vstack([np.zeros(rows.width), shear_desired[0]])
    interface = rows.output("numerical", numerical, into)
    driving = np.vstack([interface, corrected])[: feedforward.B.shape[1]]
    recent = np.vstack([rows.of("recent"), interface[0]])
    error = (recent[0] - corrected[0])[None]
    wanted = rows.output("feedforward", feedforward, driving) + rows.output("feedback", feedback, error)
    following = {
        "recent": recent[1:],
        "sent": np.vstack([command, rows.of("sent")[:-1]]),
        "rig": rows.following("rig", rig.plant, command),
        "correction": rows.following("correction", rig.correction, samples),
        "estimator": rows.following("estimator", blocks.estimator, corrected),
        "numerical": rows.following("numerical", numerical, into),
        "feedforward": rows.following("feedforward", feedforward, driving),
        "feedback": rows.following("feedback", feedback, error),
    }
    whole, signals = np.vstack([following[name] for name in sizes]), (("command_v",), ("command_v",))
    return Block("loop", whole[:, :-1], whole[:, -1:], -wanted[:, :-1], -wanted[:, -1:], rig.plant.dt_s, *signals)


def _coupled(rows: _Rows, blocks: Blocks, numerical: Block, corrected: Array, estimated: Array) -> Array:
    """Return the rows (2, n + 1) of base shear and desired acceleration at k + n_p, which depend on each other."""
    estimates, recent, measured, desired_weight = blocks.interface.force.of_one()
    known = estimates @ estimated + measured @ corrected
    if blocks.lead_samples:
        known = known + recent @ rows.of("recent")
    free = numerical.C[0] @ rows.of("numerical")
    direct = numerical.D[0, 1]
    desired = (free + direct * known) / (1.0 - direct * desired_weight)
    return np.vstack([known + desired_weight * desired, desired])


def spectral_radius(matrix: Array) -> float:
    """Return the largest absolute eigenvalue of a matrix (n, n); below one, every motion decays."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())


def loop_roots(matrix: Array, dt_s: float) -> ComplexArray:
    """Return the closed loop's oscillating modes as roots log(z) / dt_s in rad/s, (n,), the slowest to decay first.

    Of each conjugate pair the root above the real axis is returned.
    """
    z = np.linalg.eigvals(matrix).astype(complex)
    roots = np.log(z[(np.abs(z) > FORGOTTEN) & (z.imag > 0.0)]) / dt_s
    return roots[np.argsort(-roots.real)]


def slow_roots(matrix: Array, dt_s: float, time_s: float) -> ComplexArray:
    """Return the closed loop's slow roots log(z) / dt_s in rad/s, (n,).

    They are below SLOW_HZ, and more than the fraction LEFT of their motion is left after `time_s`. Real roots are
    included, and of each conjugate pair the root above the real axis. Two real roots that coincide, as those of a
    leaky inverse, are returned as a pair that is nearly real: the motions of both together are exp(r t) and t exp(r t).
    """
    z = np.linalg.eigvals(matrix).astype(complex)
    roots = np.log(z[(np.abs(z) > FORGOTTEN) & (z.imag >= 0.0)]) / dt_s
    slow = roots[(np.abs(roots) < 2.0 * np.pi * SLOW_HZ) & (roots.real * time_s > np.log(LEFT))]
    return _without_coincident(slow)


def _without_coincident(roots: ComplexArray) -> ComplexArray:
    """Return roots (k,) in which each two real ones within COINCIDENT of their size are one root of a pair."""
    real, found = np.sort(roots[roots.imag == 0.0].real), list(roots[roots.imag != 0.0])
    while len(real):
        if len(real) > 1 and real[1] - real[0] <= COINCIDENT * abs(real[0]):
            middle = 0.5 * (real[0] + real[1])
            found.append(middle + 1j * COINCIDENT * abs(middle))
            real = real[2:]
        else:
            found.append(complex(real[0]))
            real = real[1:]
    return np.array(found, dtype=complex)


def modes_in_loop(roots: ComplexArray, frequency_hz: Array, damping_ratio: Array) -> tuple[Array, Array]:
    """Return frequencies in Hz and damping ratios (m,) of the loop's roots nearest to those of given modes (m,).

    Each root is assigned to one mode only. An overdamped mode gets NaN, because it has no frequency.
    """
    size = 2.0 * np.pi * frequency_hz
    wanted = size * (-damping_ratio + 1j * np.sqrt(np.maximum(1.0 - damping_ratio**2, 0.0)))
    nearest, free = np.full(len(wanted), np.nan, dtype=complex), np.asarray(roots)
    for mode in np.flatnonzero(damping_ratio < 1.0):
        taken = np.abs(free - wanted[mode]).argmin()
        nearest[mode], free = free[taken], np.delete(free, taken)
    return np.abs(nearest) / (2.0 * np.pi), -nearest.real / np.abs(nearest)


@dataclass(frozen=True)
class LoopResponse:
    """Frequency responses of the parts of the loop, on m lines."""

    rig: ComplexArray  # (c, m) command to corrected samples
    from_samples: ComplexArray  # (c, m) corrected samples to base shear
    from_desired: ComplexArray  # (m,) desired acceleration to base shear
    numerical: ComplexArray  # (3, 2, m) ground acceleration and base shear to the interface's motion
    storeys: ComplexArray  # (p, 2, m) ground acceleration and base shear to all numerical storeys' accelerations
    feedforward: ComplexArray  # (3, m) desired motion to command
    feedback: ComplexArray  # (m,) tracking error to command
    ahead: ComplexArray  # (m,) z^n_p
    reaction: ComplexArray  # (c, m) corrected samples to command, by the feedforward of the specimen's reaction

    @property
    def loop(self) -> ComplexArray:
        """Return the gain (m,) of the loop broken at the command, for negative feedback."""
        return self._loop(self.rig)

    def with_rig(self, factor: ComplexArray) -> ComplexArray:
        """Return the loop gain (m,) with the rig's response multiplied by a factor (m,)."""
        return self._loop(self.rig * factor)

    def _loop(self, rig: ComplexArray) -> ComplexArray:
        inner = 1.0 - self.from_desired * self.numerical[0, 1]
        through = np.sum(self.from_samples * rig, axis=0) / inner
        returned = np.sum(self.reaction * rig, axis=0)
        return self.feedback * rig[0] - returned - self._command_of_shear() * through

    def _command_of_shear(self) -> ComplexArray:
        desired = self.numerical[0, 1]
        return np.sum(self.feedforward * self.numerical[:, 1], axis=0) + self.feedback * desired / self.ahead


@dataclass(frozen=True)
class Motion:
    """Signals of a hybrid test on m lines."""

    desired: ComplexArray  # (m,) acceleration of the interface, on the record's clock
    shear_n: ComplexArray  # (m,) base shear, on the record's clock
    command_v: ComplexArray  # (m,) on the table's clock
    corrected: ComplexArray  # (c, m) samples, on the table's clock
    storeys: ComplexArray  # (p + c - 1, m) absolute accelerations as a result reports them

    @property
    def tracking(self) -> ComplexArray:
        """Return desired minus measured table acceleration (m,) of the same instant."""
        return self.desired - self.storeys[len(self.storeys) - len(self.corrected)]


def loop_response(rig: IdentifiedRig, blocks: Blocks, storeys: Block, z: ComplexArray) -> LoopResponse:
    """Return the loop's responses at points z (m,) on the unit circle; `storeys` is numerical.all_storeys."""
    interface, feedforward, feedback = blocks.linear_parts()
    frequency = np.angle(z) / (2.0 * np.pi * interface.dt_s)
    samples = np.einsum("cdm,dm->cm", _at(rig.correction, frequency), _at(rig.plant, frequency)[:, 0])
    change, total = rig.alias_left(blocks)
    samples[0] += (change * (1.0 - 1.0 / z) + total * (1.0 + 1.0 / z)) * z ** -max(rig.latency_samples, 1)
    estimator = _at(blocks.estimator, frequency)
    late = z[None, :] ** (np.arange(blocks.lead_samples) - blocks.lead_samples)[:, None]
    numerical, accels = _numerical(interface, storeys, frequency)
    driving, reaction = _at(feedforward, frequency)[0], np.zeros_like(samples)
    reaction[: len(driving) - 3] = driving[3:]
    estimates, recent, measured, desired = blocks.interface.force.of_one()
    return LoopResponse(
        rig=samples,
        from_samples=np.einsum("e,ecm->cm", estimates, estimator) + measured[:, None],
        from_desired=recent @ late + desired,
        numerical=numerical,
        storeys=accels,
        feedforward=driving[:3],
        feedback=_at(feedback, frequency)[0, 0],
        ahead=z**blocks.lead_samples,
        reaction=reaction,
    )


def _numerical(interface: Block, storeys: Block, frequency_hz: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the responses of the interface's motion and of all storeys' accelerations.

    If both blocks have the same dynamics, they are evaluated together.
    """
    accels = slice(2 * len(storeys.C) // 3, None)
    rows = replace(storeys, C=storeys.C[accels], D=storeys.D[accels])
    if not (np.array_equal(interface.A, storeys.A) and np.array_equal(interface.B, storeys.B)):
        return _at(interface, frequency_hz), _at(rows, frequency_hz)
    both = replace(rows, C=np.vstack([interface.C, rows.C]), D=np.vstack([interface.D, rows.D]))
    found = _at(both, frequency_hz)
    return found[: len(interface.C)], found[len(interface.C) :]


def _at(block: Block, frequency_hz: Array) -> ComplexArray:
    return block.response(frequency_hz)


def hybrid(
    loop: LoopResponse, ground: ComplexArray, samples: ComplexArray, rounding: ComplexArray | None = None
) -> Motion:
    """Return the motion of the hybrid test.

    `ground` (3, m): acceleration, velocity and displacement of the ground. `samples` (c, m): disturbances that are
    added to the corrected samples. `rounding` (m,): a disturbance that is added to the command.
    """
    added = np.zeros(loop.feedback.shape, dtype=complex) if rounding is None else rounding
    disturbed = samples + loop.rig * added
    free = loop.numerical[:, 0] * ground[0]
    inner = 1.0 - loop.from_desired * loop.numerical[0, 1]
    shear = np.sum(loop.from_samples * disturbed, axis=0) + loop.from_desired * free[0]
    whole = np.vstack([free[:1], free[1:] + ground[1:]])
    command = np.sum(loop.feedforward * whole, axis=0) + loop.feedback * (free[0] / loop.ahead - disturbed[0])
    command = command + np.sum(loop.reaction * disturbed, axis=0)
    to_command = loop._command_of_shear()
    sent = (command + to_command * shear / inner) / (1.0 + loop.loop)
    shear = (np.sum(loop.from_samples * loop.rig, axis=0) * sent + shear) / inner
    corrected = loop.rig * sent + disturbed
    desired = free[0] + loop.numerical[0, 1] * shear
    computed = loop.storeys[:, 0] * ground[0] + loop.storeys[:, 1] * shear
    reported = np.vstack([computed[:-1], corrected * loop.ahead])
    return Motion(desired, shear, sent + added, corrected, reported)


def on_perfect_table(loop: LoopResponse, floors: ComplexArray, ground: ComplexArray) -> Motion:
    """Return the motion of the hybrid test on a table that follows the desired motion exactly and without delay.

    `floors` (c, m): accelerations of table (one) and floors per table acceleration. The remaining error is that of the
    coupling: filter, prediction and integration.
    """
    through = np.sum(loop.from_samples * floors, axis=0) / loop.ahead + loop.from_desired
    free = loop.numerical[0, 0] * ground[0]
    desired = free / (1.0 - loop.numerical[0, 1] * through)
    shear = through * desired
    computed = loop.storeys[:, 0] * ground[0] + loop.storeys[:, 1] * shear
    measured = floors * desired / loop.ahead
    return Motion(desired, shear, np.zeros_like(desired), measured, np.vstack([computed[:-1], floors * desired]))


@dataclass(frozen=True)
class CriticalDelay:
    """The critical delay of a building."""

    delay_s: float  # infinite: every delay is stable; 0: none is
    frequency_hz: float  # at which stability is lost
    gain_at_infinity: float  # of the loop: the interface floor's mass on the table over its computed mass


def critical_delay(building: Building) -> CriticalDelay:
    """Return the critical pure delay of a building without table dynamics."""
    loop = open_loop_of_building(building)
    high = abs(float(loop.D[0, 0]))
    if high >= 1.0:
        return CriticalDelay(0.0, math.inf, high)
    crossings = unit_gain_rad_s(loop)
    if not crossings.size:
        return CriticalDelay(math.inf, math.nan, high)
    phase = np.angle(loop.response(crossings / (2.0 * np.pi))[0, 0])
    delays = np.mod(phase, 2.0 * np.pi) / crossings
    first = int(np.argmin(delays))
    return CriticalDelay(float(delays[first]), float(crossings[first] / (2.0 * np.pi)), high)


@dataclass(frozen=True)
class CriticalDelayRange:
    """The critical delays of a building with laws: at rest, the smallest and the largest of all its tangents."""

    at_rest: CriticalDelay
    smallest: CriticalDelay
    largest: CriticalDelay
    unstable: int  # tangents left out, because the undivided building is unstable there without a delay


def critical_delay_range(building: Building) -> CriticalDelayRange:
    """Return the range of `critical_delay` over the tangents of a building's laws.

    It has the building at rest and those of `structure.tangents.at_tangents`.
    """
    at_rest = critical_delay(building)
    frozen = [one.building for one in at_tangents(building)]
    stable = [one for one in frozen if _stable(one)]
    found = [at_rest, *map(critical_delay, stable)]
    largest = max(found, key=lambda one: one.delay_s)
    return CriticalDelayRange(at_rest, min(found, key=lambda one: one.delay_s), largest, len(frozen) - len(stable))


def _stable(building: Building) -> bool:
    """Return whether the undivided building is stable; a storey without stiffness may drift."""
    inverse, n = np.linalg.inv(building.M), len(building.M)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ building.K, -inverse @ building.C]])
    values = np.linalg.eigvals(a)
    return bool(values.real.max() <= ON_AXIS * np.abs(values).max())


def open_loop_of_building(building: Building) -> StateSpace:
    """Return the loop from the interface floor's acceleration through the base shear back to it, without delay.

    Specimen: f = 1^T (C v + K x) - m_I a for displacements x relative to the table (Eq. 2.5, 2.6); numerical part:
    a = (f e_p - C v - K x)_p / m_p for displacements relative to the ground (Eq. 2.3).
    """
    specimen, numerical = building.specimen, building.numerical
    if specimen.attached:
        return _loop_of_attached(building)
    n, p = len(specimen.masses_kg), len(numerical.masses_kg)
    inverse, pushed = 1.0 / specimen.masses_kg[:, None], numerical.per_force[:, None]
    shear = np.concatenate([specimen.K.sum(axis=0), specimen.C.sum(axis=0)])
    motion = -np.hstack([numerical.per_mass(numerical.K), numerical.per_mass(numerical.C)])
    a = np.zeros((2 * (n + p), 2 * (n + p)))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, : 2 * n] = -np.hstack([inverse * specimen.K, inverse * specimen.C])
    a[2 * n : 2 * n + p, 2 * n + p :] = np.eye(p)
    a[2 * n + p :, 2 * n :] = motion
    a[2 * n + p :, : 2 * n] = pushed * shear + 0.0  # no zero with a sign
    high = -building.interface_experimental_mass_kg * float(pushed[-1, 0])
    b = np.zeros((len(a), 1))
    b[n : 2 * n, 0] = -1.0
    b[2 * n + p :] = -building.interface_experimental_mass_kg * pushed + 0.0
    c = a[-1:].copy()
    return StateSpace(a, b, c, np.array([[high]]))


def _loop_of_attached(building: Building) -> StateSpace:
    """Return the same loop of an attached specimen, from the force through the interface's motion back to the force:
    L(s) = -(m s^2 + c s + k) e' (M s^2 + C s + K)^-1 e of the numerical part (state x, x')."""
    specimen, numerical = building.specimen, building.numerical
    p, pushed = len(numerical.masses_kg), numerical.per_force[:, None]
    motion = -np.hstack([numerical.per_mass(numerical.K), numerical.per_mass(numerical.C)])
    a = np.vstack([np.hstack([np.zeros((p, p)), np.eye(p)]), motion])
    mass, rows = building.interface_experimental_mass_kg, np.eye(2 * p)
    c = specimen.K[0, 0] * rows[p - 1] + specimen.C[0, 0] * rows[2 * p - 1] + mass * motion[-1]
    return StateSpace(a, np.vstack([0.0 * pushed, pushed]), -c[None], np.array([[-mass * float(pushed[-1, 0])]]))


def unit_gain_rad_s(loop: StateSpace) -> Array:
    """Return the frequencies in rad/s, ascending, at which |L| = 1, for |D| below 1.

    They are the imaginary eigenvalues of the Hamiltonian matrix of the bounded real lemma (Boyd, Balakrishnan, Kabamba,
    Math. Control Signals Systems 2, 1989).
    """
    d = float(loop.D[0, 0])
    rest = 1.0 - d * d
    inner = loop.A + loop.B @ loop.C * (d / rest)
    corner = loop.C.T @ loop.C * (-1.0 - d * d / rest)
    hamiltonian = np.block([[inner, loop.B @ loop.B.T / rest], [corner, -inner.T]])
    values = np.linalg.eigvals(hamiltonian)
    on_axis = (np.abs(values.real) < ON_AXIS * np.abs(values)) & (values.imag > 0.0)
    return np.sort(values.imag[on_axis])
