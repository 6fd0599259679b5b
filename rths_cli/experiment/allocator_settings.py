"""Memory allocator settings of a batch: the process keeps freed memory, which saves page faults.

A run makes and frees tens of arrays of some megabytes. The C library gives each back to the system at once, which must
clear every page of the next one anew: a tenth of a batch's time.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # of glibc's malloc.h
MOST_KEPT_BYTES = 2**31 - 1
GROWN_BYTES = 1 << 26  # taken from the system at a time
LARGEST_BYTES = 1 << 25  # of an array that is kept: the most that glibc permits


def keep_freed_memory() -> None:
    """Have freed memory used again instead of given back to the system (glibc; elsewhere nothing changes)."""
    if not sys.platform.startswith("linux"):
        return
    option = getattr(ctypes.CDLL(None), "mallopt", None)
    if option is None:  # another C library
        return
    for name, value in ((MMAP_THRESHOLD, LARGEST_BYTES), (TRIM_THRESHOLD, MOST_KEPT_BYTES), (TOP_PAD, GROWN_BYTES)):
        option(name, value)
