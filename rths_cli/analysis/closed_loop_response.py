"""The closed loop of a hybrid test in the frequency domain: response to ground motion and to every disturbance.

On each line the loop is two equations for base shear f and command u. Signals of the numerical substructure are taken
at k + n_p and signals of the table at k; z^-n_p converts from the first clock to the second:

    f = S_c c + S_d d,  d = N_g g + N_f f,  u = F_a d + F_v v + F_x x + R c + B (z^-n_p d - c_0),  c = P u + e,

with the corrected samples c and their disturbances e, desired acceleration, velocity and displacement d, v, x of the
interface, and ground acceleration g.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.numerics.lti import Array, Block, ComplexArray


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
