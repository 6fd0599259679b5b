"""Check the text heaps of an HDF5 file before the library reads them, as it hangs on damaged ones.

The library does not come to the end of a collection in which zeros stand where an object begins, and no signal reaches
a process that waits for it. Layout: HDF5 File Format Specification 3.0, III.E "Global Heap".
"""

from __future__ import annotations

import mmap
import os
import re
import struct
from functools import lru_cache
from pathlib import Path

from rths_cli.files.hdf5_safety import LayoutError

_SIGNATURE_BYTES = 8
_START = re.compile(rb"GCOL\x01\0{3}")
_SIZE = struct.Struct("<Q")  # of a collection, after its signature
_OBJECT = struct.Struct("<H6xQ")  # index (0: what is free, its header included) and size of an object
_KEPT = 4096
PART_BYTES = 1 << 26  # whole pages
_DAMAGED = "has a damaged collection of texts"


def check_heaps(path: Path) -> None:
    """Raise LayoutError for an HDF5 file with a collection of texts that does not end; OSError where it is not read."""
    about = os.stat(path)
    if not _ends(path, about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns):
        raise LayoutError(_DAMAGED)


def check_image(image: bytes) -> None:
    """Raise LayoutError for the bytes of an HDF5 file with a collection of texts that does not end."""
    if not _all_end(image):
        raise LayoutError(_DAMAGED)


@lru_cache(_KEPT)
def _ends(path: Path, *_: int) -> bool:
    """Tell whether the collections of a file end; a file is looked at again when it has changed."""
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as image:
        return _all_end(image)


def _all_end(image: bytes | mmap.mmap) -> bool:
    """Tell whether every collection of texts in the bytes of an HDF5 file ends.

    It is searched by parts, and a part is given back before the next: a file may be larger than the memory.
    """
    for first in range(0, len(image), PART_BYTES):
        end = min(first + PART_BYTES, len(image))
        starts = _START.finditer(image, first, min(end + _SIGNATURE_BYTES - 1, len(image)))
        if not all(_collection_ends(image, match.start()) for match in starts):
            return False
        if isinstance(image, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):  # Windows gives parts back by itself
            image.madvise(mmap.MADV_DONTNEED, first, end - first)
    return True


def _collection_ends(image: bytes | mmap.mmap, start: int) -> bool:
    place = start + _SIGNATURE_BYTES + _SIZE.size
    if place > len(image):
        return True
    end = min(start + _SIZE.unpack_from(image, start + _SIGNATURE_BYTES)[0], len(image))
    while place + _OBJECT.size <= end:
        index, size = _OBJECT.unpack_from(image, place)
        step = size if index == 0 else _OBJECT.size + -(-size // 8) * 8
        if step == 0:
            return False
        place += step
    return True
