"""An empty periodic loop: how late this machine wakes up a thread that has nothing else to do."""

from __future__ import annotations

import numpy as np

from rths_cli.clocks import IntArray, monotonic_ns, sleep_until, spin_of
from rths_cli.compiled import entry

CHUNK_S = 0.25  # between two looks at signals


@entry
def wait_periodically(interval_ns: int, spin_ns: int, late_ns: IntArray, scratch: IntArray) -> None:
    """Wait for late_ns.size deadlines, one every interval, note how late each wait ended in ns, (n,).

    Deadlines that have passed while it waited for another are left out. `scratch` is (2,) int64.
    """
    deadline = monotonic_ns(scratch) + interval_ns
    for k in range(late_ns.size):
        late_ns[k] = sleep_until(deadline, spin_ns, scratch)
        deadline += interval_ns * (1 + late_ns[k] // interval_ns)


def wake_up_delays(rate_hz: float, seconds: float, spins: bool = True) -> IntArray:
    """Return the delay in ns of every wake-up at a rate, (n,); `spins`: as a run does before each deadline."""
    interval_ns = round(1e9 / rate_hz)
    spin_ns = spin_of(interval_ns) if spins else 0
    steps, chunk = max(round(seconds * rate_hz), 1), max(round(CHUNK_S * rate_hz), 1)
    late_ns, scratch = np.zeros(steps, dtype=np.int64), np.zeros(2, dtype=np.int64)
    for first in range(0, steps, chunk):
        wait_periodically(interval_ns, spin_ns, late_ns[first : first + chunk], scratch)
    return late_ns
