"""How each compensator makes the nominal actuator follow: frequency response and a fast rise, for the figure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.benchmark.displacement import Designed, DisplacementBenchmark
from rths_cli.numerics.lti import Array, Block, ComplexArray
from rths_cli.rigs.virtual.servo_hydraulic import DISPLACEMENT, sampled_actuator

FREQUENCY_HZ = np.logspace(-1.0, 2.0, 300)
RISE_S, SHOWN_S = 0.05, 0.3  # duration of the rise from 0 to 1; time that is shown


@dataclass(frozen=True)
class Followed:
    """The actuator's displacement over the desired one."""

    label: str
    response: ComplexArray  # (f,) at FREQUENCY_HZ
    time_s: Array  # (n,)
    desired: Array  # (n,)
    moved: Array  # (n,)


def followed(bench: DisplacementBenchmark) -> list[Followed]:
    """Return how every compensator of a benchmark follows, one that adapts as it is at its start; those without a
    linear block are left out. Nominal actuator within its limit, without noise, rounding and numerical storeys."""
    made = [bench.designed(one) for one in bench.spec.compensators]
    return [_followed(bench, one, one.judged) for one in made if one.judged is not None]


def _followed(bench: DisplacementBenchmark, designed: Designed, block: Block) -> Followed:
    plant = sampled_actuator(bench.plant(0, 0), bench.dt_s)
    feedback = np.zeros((1, len(plant.sampled)))
    feedback[0, DISPLACEMENT] = 1.0
    width = block.B.shape[1]
    of_disp = np.zeros((width, 1))  # inputs: desired acceleration, velocity, displacement, then those measured
    if width > 3:
        of_disp[3] = 1.0
    a = np.block([
        [block.A, block.B @ of_disp @ feedback],
        [plant.driven[:, None] @ block.C, plant.sampled + plant.driven[:, None] @ block.D @ of_disp @ feedback],
    ])  # fmt: skip
    b = np.vstack([block.B[:, :3], plant.driven[:, None] @ block.D[:, :3]])
    out = np.hstack([np.zeros((1, len(block.A))), feedback])
    s = 2j * np.pi * FREQUENCY_HZ
    whole = Block(designed.label, a, b, out, np.zeros((1, 3)), bench.dt_s).response(FREQUENCY_HZ)[0]
    response = whole[0] * s**2 + whole[1] * s + whole[2]
    time_s = np.arange(0.0, SHOWN_S, bench.dt_s)
    x = np.clip(time_s / RISE_S, 0.0, 1.0)
    desired = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    velocity = 30.0 * x**2 * (1.0 - x) ** 2 / RISE_S
    accel = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / RISE_S**2
    state, moved = np.zeros(len(a)), np.zeros(len(time_s))
    for k, given in enumerate(np.stack([accel, velocity, desired], axis=1)):
        moved[k] = (out @ state).item()
        state = a @ state + b @ given
    return Followed(designed.label, response, time_s, desired, moved)
