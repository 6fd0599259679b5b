"""The hybrid test as a linear loop in the frequency domain: what ground motion and every disturbance make of it.

On each line the loop is two equations for base shear f and command u (signals at k + n_p for the numerical part, at k
for the table; z^-n_p leads from one clock to the other):

    f = S_c c + S_d d,  d = N_g g + N_f f,  u = F_a d + F_v v + F_x x + B (z^-n_p d - c_0),  c = P u + e,

c the corrected samples, e what disturbs them, d, v, x the desired motion of the interface, g the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rths_cli.analysis.identified_rig_block import IdentifiedRig
from rths_cli.control.designed_blocks import Blocks
from rths_cli.numerics.lti import Array, Block, ComplexArray


@dataclass(frozen=True)
class LoopResponse:
    """Responses on m lines: `rig` (c, m) command to corrected samples, `from_samples` (c, m) and `from_desired` (m,) to
    the base shear, `numerical` (3, 2, m) ground acceleration and base shear to the interface's motion, `storeys`
    (p, 2, m) the same to all numerical storeys' accelerations, `feedforward` (3, m), `feedback` (m,), `ahead` (m,) is
    z^n_p."""

    rig: ComplexArray
    from_samples: ComplexArray
    from_desired: ComplexArray
    numerical: ComplexArray
    storeys: ComplexArray
    feedforward: ComplexArray
    feedback: ComplexArray
    ahead: ComplexArray

    @property
    def loop(self) -> ComplexArray:
        """Return the loop gain (m,) broken at the command, negative feedback: gain and delay of the table act on it."""
        return self._loop(self.rig)

    def with_rig(self, factor: ComplexArray) -> ComplexArray:
        """Return the loop gain (m,) with the rig's response multiplied by a factor (m,)."""
        return self._loop(self.rig * factor)

    def _loop(self, rig: ComplexArray) -> ComplexArray:
        inner = 1.0 - self.from_desired * self.numerical[0, 1]
        through = np.sum(self.from_samples * rig, axis=0) / inner
        return self.feedback * rig[0] - self._command_of_shear() * through

    def _command_of_shear(self) -> ComplexArray:
        desired = self.numerical[0, 1]
        return np.sum(self.feedforward * self.numerical[:, 1], axis=0) + self.feedback * desired / self.ahead


@dataclass(frozen=True)
class Motion:
    """Signals on m lines: `desired` (m,) interface acceleration and `shear_n` on the record's clock, `corrected`
    (c, m) samples and `command_v` (m,) on the table's, `storeys` (p + c - 1, m) absolute accelerations as reported."""

    desired: ComplexArray
    shear_n: ComplexArray
    command_v: ComplexArray
    corrected: ComplexArray
    storeys: ComplexArray

    @property
    def tracking(self) -> ComplexArray:
        """Return desired - measured table acceleration (m,), of the same instant."""
        return self.desired - self.storeys[len(self.storeys) - len(self.corrected)]


def loop_response(rig: IdentifiedRig, blocks: Blocks, storeys: Block, z: ComplexArray) -> LoopResponse:
    """Return the loop's responses at points z (m,) on the unit circle; `storeys` is numerical.all_storeys."""
    frequency = np.angle(z) / (2.0 * np.pi * blocks.numerical.dt_s)
    samples = np.einsum("cdm,dm->cm", _at(rig.correction, frequency), _at(rig.plant, frequency)[:, 0])
    change, total = rig.alias_left(blocks)
    samples[0] += (change * (1.0 - 1.0 / z) + total * (1.0 + 1.0 / z)) * z ** -max(rig.latency_samples, 1)
    estimator = _at(blocks.estimator, frequency)
    late = z[None, :] ** (np.arange(blocks.lead_samples) - blocks.lead_samples)[:, None]
    numerical, accels = _numerical(blocks.numerical, storeys, frequency)
    return LoopResponse(
        rig=samples,
        from_samples=np.einsum("e,ecm->cm", blocks.shear_estimate, estimator) + blocks.shear_measured[:, None],
        from_desired=blocks.shear_recent @ late + blocks.shear_desired,
        numerical=numerical,
        storeys=accels,
        feedforward=_at(blocks.feedforward, frequency)[0],
        feedback=_at(blocks.feedback, frequency)[0, 0],
        ahead=z**blocks.lead_samples,
    )


def _numerical(interface: Block, storeys: Block, frequency_hz: Array) -> tuple[ComplexArray, ComplexArray]:
    """Return the responses of the interface's motion and of all storeys' accelerations: one block, read out twice."""
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
    """Return the hybrid test's motion for ground acceleration, velocity and displacement (3, m), disturbances of the
    corrected samples (c, m), and what is added to the command before it leaves (m,)."""
    added = np.zeros(loop.feedback.shape, dtype=complex) if rounding is None else rounding
    disturbed = samples + loop.rig * added
    free = loop.numerical[:, 0] * ground[0]
    inner = 1.0 - loop.from_desired * loop.numerical[0, 1]
    shear = np.sum(loop.from_samples * disturbed, axis=0) + loop.from_desired * free[0]
    whole = np.vstack([free[:1], free[1:] + ground[1:]])
    command = np.sum(loop.feedforward * whole, axis=0) + loop.feedback * (free[0] / loop.ahead - disturbed[0])
    to_command = loop._command_of_shear()
    sent = (command + to_command * shear / inner) / (1.0 + loop.loop)
    shear = (np.sum(loop.from_samples * loop.rig, axis=0) * sent + shear) / inner
    corrected = loop.rig * sent + disturbed
    desired = free[0] + loop.numerical[0, 1] * shear
    computed = loop.storeys[:, 0] * ground[0] + loop.storeys[:, 1] * shear
    reported = np.vstack([computed[:-1], corrected * loop.ahead])
    return Motion(desired, shear, sent + added, corrected, reported)


def on_perfect_table(loop: LoopResponse, floors: ComplexArray, ground: ComplexArray) -> Motion:
    """Return the hybrid test's motion on a table that does at once what is desired: `floors` (c, m) are the
    accelerations of table (one) and floors per table acceleration. What is left is the coupling's own error."""
    through = np.sum(loop.from_samples * floors, axis=0) / loop.ahead + loop.from_desired
    free = loop.numerical[0, 0] * ground[0]
    desired = free / (1.0 - loop.numerical[0, 1] * through)
    shear = through * desired
    computed = loop.storeys[:, 0] * ground[0] + loop.storeys[:, 1] * shear
    measured = floors * desired / loop.ahead
    return Motion(desired, shear, np.zeros_like(desired), measured, np.vstack([computed[:-1], floors * desired]))
