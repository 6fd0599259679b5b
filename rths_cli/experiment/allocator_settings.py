"""Memory allocator settings of a batch: the process keeps freed memory, which saves page faults.

A run allocates and frees tens of arrays of some megabytes. By default the C library returns each to the system at once,
and the system must then clear every page of the next array, which takes a tenth of a batch's time.
"""

from __future__ import annotations

import ctypes
import sys

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # of glibc's malloc.h
MOST_KEPT_BYTES = 2**31 - 1  # largest amount of freed memory that is kept
GROWN_BYTES = 1 << 26  # taken from the system at a time
LARGEST_BYTES = 1 << 25  # largest array whose memory is kept, the maximum that glibc permits


def keep_freed_memory() -> None:
    """Let the process reuse freed memory instead of returning it to the system (glibc on Linux; else no effect)."""
    if not sys.platform.startswith("linux"):
        return
    option = getattr(ctypes.CDLL(None), "mallopt", None)
    if option is None:  # another C library
        return
    for name, value in ((MMAP_THRESHOLD, LARGEST_BYTES), (TRIM_THRESHOLD, MOST_KEPT_BYTES), (TOP_PAD, GROWN_BYTES)):
        option(name, value)
