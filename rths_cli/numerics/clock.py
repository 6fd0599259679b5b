"""The monotonic clock in compiled code: read it, sleep until an instant."""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from rths_cli.errors import InputError
from rths_cli.numerics.compiled import external, part

IntArray = NDArray[np.int64]
REAL_TIME = sys.platform == "linux"
SPIN_NS, LONGEST_SPIN_NS = 60_000, 250_000  # of the wait before a deadline: longer than nearly every wake-up takes

if sys.platform == "win32":  # no clock_gettime there: steps of offline runs are not timed

    @part
    def monotonic_ns(scratch: IntArray) -> int:
        """Return 0."""
        return 0

else:
    _clock_gettime = external("clock_gettime", "intc", "intc", "uintp")
    _MONOTONIC = 6 if sys.platform == "darwin" else 1

    @part
    def monotonic_ns(scratch: IntArray) -> int:
        """Return the monotonic time in ns; `scratch` (2,) int64 receives seconds and nanoseconds."""
        _clock_gettime(_MONOTONIC, scratch.ctypes.data)
        return scratch[0] * 1_000_000_000 + scratch[1]


_clock_nanosleep = external("clock_nanosleep", "intc", "intc", "intc", "uintp", "uintp")  # Linux only
_LINUX_MONOTONIC, _ABSOLUTE = 1, 1


def spin_of(interval_ns: int) -> int:
    """Return how long before each deadline of a clock with this interval a thread looks at the time, in ns: an eighth
    of it, so that it also wakes up in time where others hold the processor for a while."""
    return min(max(interval_ns // 8, SPIN_NS), LONGEST_SPIN_NS)


@part
def sleep_until(deadline_ns: int, spin_ns: int, scratch: IntArray) -> int:
    """Sleep until `spin_ns` before a monotonic time, spin until it, return how late it is then in ns.

    A signal does not end the sleep. Nothing is waited for after the deadline: who is always late never sleeps, and
    Linux takes the processor from a SCHED_FIFO thread that has not slept for 0.95 s.
    """
    wake_ns = deadline_ns - spin_ns
    now = monotonic_ns(scratch)
    while now < wake_ns:
        scratch[0], scratch[1] = wake_ns // 1_000_000_000, wake_ns % 1_000_000_000
        _clock_nanosleep(_LINUX_MONOTONIC, _ABSOLUTE, scratch.ctypes.data, 0)
        now = monotonic_ns(scratch)
    while now < deadline_ns:
        now = monotonic_ns(scratch)
    return now - deadline_ns


def require_real_time() -> None:
    """Raise InputError where the system has no real-time clock and scheduling that rths knows."""
    if not REAL_TIME:
        raise InputError(f"real time needs Linux, this is {sys.platform}; offline runs on a virtual rig work here")
