"""Draw the hidden values of a virtual laboratory: the same number makes the same laboratory in every run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from rths_cli.case.virtual_imperfections_schema import LARGEST_DRAW, Values
from rths_cli.errors import InputError
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from rths_cli.case.virtual_imperfections_schema import ActuatorImperfections, VirtualImperfections

PER_RUN, HUM_PHASE = "channels.gain_change_between_runs", "channels.hum_phase_rad"
PER_FLOOR = ("masses.", "specimen.", "pitch.storey_height_m")


def number_of(stated: VirtualImperfections | ActuatorImperfections, seed: int) -> int | None:
    """Return the number of a laboratory: that of its file, else the seed of the case; None for one as declared."""
    if stated.off:
        return None
    return seed if stated.laboratory is None else stated.laboratory


@dataclass(frozen=True)
class Laboratory:
    """A laboratory as it is.

    `values` by dotted key: an array with an entry per channel, floor or storey, or of one entry.
    """

    number: int
    stated: VirtualImperfections
    values: Mapping[str, Array] = field(default_factory=dict)

    def one(self, key: str) -> float:
        """Return a value of which there is one."""
        return float(self.values[key][0])


def laboratory_of(
    stated: VirtualImperfections, number: int, accelerometers: int, floors: int, further: Sequence[float] = ()
) -> Laboratory:
    """Return the laboratory of this number; raises InputError for a list with another number of entries.

    Each key has a stream of its own: what is switched on or off elsewhere changes no other value. `further`: declared
    uncertainty of each channel beside the accelerometers of table and floors, with which its gain error is drawn.
    """
    values, channels = {}, accelerometers + len(further)
    for part, imperfections in stated.parts():
        for name in type(imperfections).model_fields:
            given, key = getattr(imperfections, name), f"{part}.{name}"
            if isinstance(given, Values) and key != PER_RUN:
                values[key] = drawn(given, key, number, _places(key, channels, floors))
    gain, std = values["channels.gain_error"], stated.channels.gain_error.std
    if std > 0.0:
        mean = np.resize(stated.channels.gain_error.mean, channels)
        gain[accelerometers:] = ((gain - mean) / std)[accelerometers:] * further
    return Laboratory(number, stated, values)


def of_run(
    laboratory: Laboratory, run: tuple[int, ...], channels: int, session: tuple[int, ...] | None = None
) -> dict[str, Array]:
    """Return what is drawn anew, (channels,) each: changes of gain for each session, phases of the hum in rad for each
    run. `session` names the runs that follow each other closely; None: the run stands alone."""
    gains, session = laboratory.stated.channels.gain_change_between_runs, run if session is None else session
    change = drawn(gains, PER_RUN, laboratory.number, channels, session)
    phase = _stream(HUM_PHASE, laboratory.number, run).uniform(0.0, 2.0 * np.pi, channels)
    return {PER_RUN: change, HUM_PHASE: phase}


def drawn(values: Values, key: str, number: int, count: int, run: tuple[int, ...] = ()) -> Array:
    """Return exact or drawn values (count,) of a key."""
    if len(values.mean) not in (1, count):
        what = "floors on the table" if key.startswith(PER_FLOOR) else "channels" if count > 1 else "value"
        raise InputError(
            f"table.imperfections.{key}: {len(values.mean)} entries for {count} {what}; state one for each"
        )
    mean = np.broadcast_to(np.asarray(values.mean, dtype=float), (count,)).copy()
    if values.std == 0.0:
        return mean
    normal = _stream(key, number, run).standard_normal(count)
    return mean + values.std * np.clip(normal, -LARGEST_DRAW, LARGEST_DRAW)


def _stream(key: str, number: int, run: tuple[int, ...]) -> np.random.Generator:
    return np.random.default_rng((crc32(key.encode()), number, *run))


def _places(key: str, channels: int, floors: int) -> int:
    if key.startswith(PER_FLOOR):
        return floors
    return channels if key.startswith("channels.") else 1
