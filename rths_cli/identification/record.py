"""What an identification is made from: a command, the accelerations it caused, and which samples are what."""

from __future__ import annotations

from dataclasses import dataclass

from rths_cli.lti import Array


@dataclass(frozen=True)
class Parts:
    """Which samples of a record are excitation, silence and free vibration (command held); None: the record has none.

    `noise` names the excitation whatever its kind. `period_samples`: the excitation repeats after so many samples
    (0: it does not, or not so that whole periods should be evaluated). `segment_samples`: length of the Hann segments
    that suit it (0: any).
    """

    noise: slice
    silence: slice | None = None
    free_vibration: slice | None = None
    period_samples: int = 0
    segment_samples: int = 0


@dataclass(frozen=True)
class Record:
    """Command (n,) in V as it left, accelerations (c, n) in m/s^2 of table and floors, and the parts of the record."""

    command_v: Array
    accel_m_s2: Array
    parts: Parts
