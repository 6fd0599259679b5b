"""What compensators with a feedback of the measured displacement share: the actuator's model, and the reference.

A controller K(s) from reference r and displacement x to the command u closes a loop with the identified actuator, whose
response from r to x is T. The reference is r = a_0 d + a_1 d' + a_2 d'', which the numerical substructure knows; the a
are those with which (a_0 + a_1 s + a_2 s^2) T(s) is nearest to 1 in the compared band, errors over
frequency: the loop's own lag is led.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.control.feedback import delayed
from rths_cli.control.state_space import discretise, from_roots
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array, Block, StateSpace

if TYPE_CHECKING:
    from rths_cli.control.compensator import Plant

LINES = 200  # of the compared band
TRACKS = ("reference", "measured_disp_m")
INPUTS = ("desired_accel_m_s2", "desired_vel_m_s", "desired_disp_m", "measured_disp_m")


def actuator(plant: Plant, kind: str) -> StateSpace:
    """Return the identified actuator from command to displacement without its delay; raises InputError on a table of
    which accelerations are measured."""
    plant.needs_displacement(kind)
    zeros = plant.model.zeros
    system = from_roots(zeros[np.abs(zeros) > 1e-9], plant.model.poles, plant.model.gain)
    if system.D.any():
        raise InputError(f"controller: {kind} needs an actuator whose displacement lags its command; use another kind")
    return system


def late_samples(plant: Plant) -> int:
    """Return the whole samples of the actuator's delay beside that of its hold."""
    return max(round(plant.model.delay_s / plant.dt_s - 0.5), 0)


def led(controller: Block, plant: Plant, kind: str) -> Block:
    """Return a discrete controller from `TRACKS` to the command with the reference made of the desired motion; raises
    InputError where its loop with the identified actuator is not stable."""
    system = actuator(plant, kind)
    held = discretise(system, plant.dt_s, "zoh", kind, ("command",), ("displacement",))
    moved = delayed(StateSpace(held.A, held.B, held.C, held.D), late_samples(plant))
    closed = loop(controller, moved)
    radius = float(np.abs(np.linalg.eigvals(closed.A)).max())
    if radius >= 1.0:
        raise InputError(
            f"controller: {kind}: its own loop with the identified actuator is unstable (spectral radius "
            f"{radius:.6f}); change its options"
        )
    frequency_hz = np.linspace(*plant.band_hz, LINES)
    s = 2j * np.pi * frequency_hz
    response = Block(kind, closed.A, closed.B, closed.C, closed.D, plant.dt_s).response(frequency_hz)[0, 0]
    weight = plant.band_hz[0] / frequency_hz
    columns = np.stack([weight * s**i * response for i in range(3)], axis=1)
    both, wanted = np.vstack([columns.real, columns.imag]), np.concatenate([weight, np.zeros(LINES)])
    scale = np.linalg.norm(both, axis=0)
    a = np.linalg.lstsq(both / scale, wanted, rcond=None)[0] / scale
    mix = np.array([[a[2], a[1], a[0], 0.0], [0.0, 0.0, 0.0, 1.0]])
    return replace(controller, B=controller.B @ mix, D=controller.D @ mix, inputs=INPUTS, outputs=("command_v",))


def loop(controller: Block, moved: StateSpace) -> StateSpace:
    """Return the loop from reference to displacement of a controller and an actuator, both discrete; the actuator has
    no direct term."""
    c, p = controller, moved
    a = np.block([[c.A, c.B[:, 1:] @ p.C], [p.B @ c.C, p.A + p.B @ c.D[:, 1:] @ p.C]])
    b = np.vstack([c.B[:, :1], p.B @ c.D[:, :1]])
    return StateSpace(a, b, np.hstack([np.zeros((1, len(c.A))), p.C]), np.zeros((1, 1)))


def balanced(system: StateSpace) -> tuple[StateSpace, Array]:
    """Return a system in coordinates T x' = x in which the Riccati equations are well scaled, and T (n,)."""
    from scipy.linalg import matrix_balance

    scale = matrix_balance(system.A, permute=False, separate=True)[1][0]
    b, c = system.B[:, 0] / scale, system.C[0] * scale
    scale = scale * np.sqrt(np.linalg.norm(b) / max(float(np.linalg.norm(c)), np.finfo(float).tiny))
    return StateSpace(
        system.A * scale / scale[:, None], system.B / scale[:, None], system.C * scale, system.D
    ), scale  # fmt: skip
