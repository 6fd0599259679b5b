"""What an identification is made from: a command, the accelerations it caused, and which samples are what."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from rths_cli.filters import fast_length
from rths_cli.lti import Array, ComplexArray

TAIL_S = 30.0  # rest appended to a command, in which a table's response dies out


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
class PaddedLines:
    """Fourier lines (count // 2 + 1,) of a signal with rest at its end, of `count` samples in all."""

    values: ComplexArray
    count: int
    dt_s: float


def padded(samples: int, dt_s: float) -> int:
    """Return how many samples a signal has with rest at its end, a length that transforms fast."""
    return fast_length(samples + round(TAIL_S / dt_s))


@dataclass(frozen=True)
class Record:
    """Command (n,) in V as it left, accelerations (c, n) in m/s^2 of table and floors, and the parts of the record."""

    command_v: Array
    accel_m_s2: Array
    parts: Parts
    _lines: dict[int, ComplexArray] = field(default_factory=dict, init=False, repr=False, compare=False)

    def command_lines(self, count: int, dt_s: float) -> PaddedLines:
        """Return the Fourier lines of the command with rest up to so many samples; they are computed once."""
        if count not in self._lines:
            self._lines[count] = np.fft.rfft(self.command_v, count)
        return PaddedLines(self._lines[count], count, dt_s)

    def excited_in(self, noise: slice) -> Record:
        """Return the same record with another part of it as its excitation; what is computed stays known."""
        other = replace(self, parts=replace(self.parts, noise=noise))
        other._lines.update(self._lines)
        return other
