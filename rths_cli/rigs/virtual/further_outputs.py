"""What the virtual table shows in channels beside the accelerometers: displacement, force, strain, acceleration.

Each is a sum of mechanical states and of true accelerations at the instant of the sample, without any imperfection but
range, white noise and the converter's bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.numerics.tiled_products import tiled

if TYPE_CHECKING:
    from rths_cli.rigs.description import Channel, RigInfo


class FurtherOutputs(NamedTuple):
    """Constant arrays of f further channels, n mechanical states, c = 1 + n_floors accelerations.

    The accelerations are those by the states, by friction and by the laws of the specimen's storeys: the first two are
    contained in `states` and `friction`.
    """

    states: Array  # (tiles, n, 4) unit of the channel per state, tiled_products.tiled
    friction: Array  # (f,) the same per tanh(v / v_s)
    accelerations: Array  # (f, c) the same per m/s^2 of table and floors
    range: Array  # (f,) in the unit of the channel
    noise_rms: Array  # (f,)
    v_per_unit: Array  # (f,)


def further_outputs(
    info: RigInfo, accel_rows: Array, accel_friction: Array, floor_masses_kg: Array, interface_mass_kg: float
) -> FurtherOutputs:
    """Return the arrays of a rig's further channels; `accel_rows` (c, n) and `accel_friction` (c,) as in Plant.

    A displacement is absolute, of table or floor, in m. A force at the table is that on all that stands on a load cell,
    its plate included, and at a storey that on the floors above it, in N. The strain of a storey is its drift over 1 m.
    """
    count, names = len(info.further), [channel.name for channel in info.channels]
    states, accelerations = np.zeros((count, accel_rows.shape[1])), np.zeros((count, 1 + len(floor_masses_kg)))
    for row, weights, channel in zip(states, accelerations, info.further, strict=True):
        at = 0 if channel.position == "table" else names.index(channel.position.replace("storey_", "floor_"))
        if channel.kind == "acceleration":
            weights[at] = 1.0
        elif channel.kind == "force":
            weights[1:] = floor_masses_kg
            weights[:at], weights[0] = 0.0, interface_mass_kg + channel.plate_mass_kg if at == 0 else 0.0
        else:
            _place(row, channel, at)
    return FurtherOutputs(
        tiled(states + accelerations @ accel_rows),
        accelerations @ accel_friction,
        accelerations,
        np.array([channel.range for channel in info.further]),
        np.array([channel.noise_rms for channel in info.further]),
        np.array([channel.sensitivity_v_per_unit for channel in info.further]),
    )


def _place(row: Array, channel: Channel, at: int) -> None:
    """Write the states (n,) of a displacement or a strain of floor or storey `at`, counted from the table as 0."""
    floor = 2 + at  # table: position, velocity and force, then the floors relative to it
    if channel.kind == "displacement":
        row[0] = 1.0
    if at > 0:
        row[floor] = 1.0
    if channel.kind == "strain" and at > 1:
        row[floor - 1] = -1.0
