"""Damage files: bits flipped, pieces cut, doubled or zeroed, headers and names edited, attributes and datasets of other
types and shapes, datasets declared as terabytes, links to elsewhere and in circles."""

from __future__ import annotations

import contextlib
import hashlib
import random
import re
import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from rths_cli.files.model_file import BLOCK, LEAD
from rths_cli.files.raw_log import CHECK, START


@dataclass(frozen=True)
class Target:
    """A kind of file: a valid one, how it is damaged, the commands that read it (FILE stands for it), which take the
    valid file without a complaint, and those that refuse it because it is no file for them."""

    kind: str
    valid: Path
    hdf5: bool
    commands: tuple[tuple[str, ...], ...]
    seal: Callable[[bytes], bytes] | None = None
    beside: tuple[Path, ...] = ()
    refusing: tuple[tuple[str, ...], ...] = ()


def damaged(target: Target, file: Path, rng: random.Random) -> str:
    """Write a damaged copy of a valid file and return what was done."""
    done = []
    if target.hdf5 and rng.random() < 0.6:
        shutil.copy(target.valid, file)
        done += [edited(file, rng) for _ in range(rng.randint(1, 2))]
        data = file.read_bytes()
    else:
        data = target.valid.read_bytes()
        is_text = b"\0" not in data[:2000]
        for _ in range(rng.randint(1, 3)):
            damage = rng.choice(TEXT_DAMAGES if is_text and rng.random() < 0.8 else DAMAGES)
            data = damage(data, rng)
            done.append(damage.__name__)
    if target.seal and rng.random() < 0.7:
        data = target.seal(data)
        done.append("sealed")
    file.write_bytes(data)
    return "+".join(done)


def flipped(data: bytes, rng: random.Random) -> bytes:
    """Flip up to 16 bits, rather at the beginning, where the header stands."""
    found = bytearray(data)
    for _ in range(rng.randint(1, 16)):
        if found:
            place = int(len(found) * rng.random() ** rng.choice((1, 3)))
            found[place] ^= 1 << rng.randrange(8)
    return bytes(found)


def cut(data: bytes, rng: random.Random) -> bytes:
    """Cut the end off."""
    return data[: int(len(data) * rng.random())]


def zeroed(data: bytes, rng: random.Random) -> bytes:
    """Overwrite a piece by zeros, ones or noise."""
    start = rng.randrange(len(data) + 1)
    length = min(rng.choice((1, 8, 64, 4096)), len(data) - start)
    return data[:start] + rng.choice((bytes(length), b"\xff" * length, rng.randbytes(length))) + data[start + length :]


def doubled(data: bytes, rng: random.Random) -> bytes:
    """Put a piece in again elsewhere."""
    start, place = rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)
    return data[:place] + data[start : start + rng.choice((1, 16, 512))] + data[place:]


def taken(data: bytes, rng: random.Random) -> bytes:
    """Take a piece out."""
    start = rng.randrange(len(data) + 1)
    return data[:start] + data[start + rng.choice((1, 16, 512)) :]


def number_replaced(data: bytes, rng: random.Random) -> bytes:
    """Put another number in the place of one."""
    found = list(re.finditer(rb"-?\d+(\.\d*)?([eE][-+]?\d+)?", data[: rng.choice((200, len(data)))]))
    if not found:
        return data
    match = rng.choice(found)
    return data[: match.start()] + rng.choice(NUMBERS) + data[match.end() :]


def text_put_in(data: bytes, rng: random.Random) -> bytes:
    """Put hostile text somewhere, rather into the first lines."""
    place = rng.randrange(min(len(data), rng.choice((40, 200, 10**9))) + 1)
    return data[:place] + rng.choice(TEXTS) + data[place:]


def line_put_in(data: bytes, rng: random.Random) -> bytes:
    """Put a hostile line before one of the first."""
    lines = data.split(b"\n")
    place = rng.randrange(min(len(lines), 6) + 1)
    return b"\n".join([*lines[:place], rng.choice(LINES), *lines[place:]])


def lines_shuffled(data: bytes, rng: random.Random) -> bytes:
    """Put one line elsewhere."""
    lines = data.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    return b"\n".join([*lines[: (place := rng.randrange(len(lines) + 1))], line, *lines[place:]])


WRITABLE = 1 << 20  # numbers: a dataset declared huge is not filled, that would take the bench its own memory
NUMBERS = (
    b"9" * 5000, b"1e308", b"-1e308", b"1e999", b"nan", b"NaN", b"inf", b"-inf", b"0", b"-1", b"1e-320", b"", b"x",
    b"0x10", b"1_000", b"1e18", b"99999999999", b"0." + b"1" * 5000, b"1e" + b"9" * 5000, "\u0663".encode(), b"=1+1",
)  # fmt: skip
TEXTS = (
    b" " * 300, b" " * 20_000, b"\t" * 3000, b"(" * 40_000, b"[" * 40_000, b")" * 40_000, b"a" * 150_000, b"\0",
    b"\x1b[2J", b"\x1b]0;x\x07", b"\xff\xfe", b"\xef\xbb\xbf", "\u202e".encode(), b"\r", b'"' * 1001, b"," * 5000,
    b"#", b"=1+1", b"{" * 3000, b"'" * 999, b"- " * 5000, b"&a " * 100, b"!!python/object/apply:os.system ",
    b"<script>", b"\\" * 100, b"%s%n", b"\n" * 3000,
)  # fmt: skip
LINES = (
    b"# samples: " + b"7" * 5000, b"# units: " + b"(" * 3000, b"# dt: " + b"1" * 5000, b" " * 300 + b"x",
    b"dt" + b" " * 3000, b"NPTS= " + b"8" * 5000 + b", DT= 0.01", b"NPTS" + b" " * 20_000 + b"x", b"# dt: 0.01",
    b"# units: g", b"# origin: \x1b[31m", b"# \x1b[2J", b"dt = " + b" " * 3000, b"fs: " + b"9" * 4000,
    b"sample rate" + b"=" * 4000, b"UNITS " * 3000, b"1 " * 3000, b"a" + b" " * 5000 + b"=" + b" " * 5000 + b"1",
    b",".join([b"command"] * 3000), b"\x9b2J\xc2\x9b", b'"' + b"x" * 140_000,
)  # fmt: skip
DAMAGES = (flipped, flipped, flipped, cut, zeroed, doubled, taken)
TEXT_DAMAGES = (number_replaced, number_replaced, text_put_in, line_put_in, lines_shuffled, flipped, cut, taken)


def sealed_model(data: bytes) -> bytes:
    """Return a model file whose sum fits its bytes."""
    after = data[BLOCK:]
    return (LEAD + hashlib.sha256(after).hexdigest().encode() + b"\n").ljust(BLOCK, b"\0") + after


def sealed_log(data: bytes) -> bytes:
    """Return a raw log whose header's length and sum fit again; some of its frames may not."""
    if len(data) < START.size:
        return data
    magic, version, length = START.unpack_from(data)
    match = re.search(rb"\}(?=.{4}RTHF)", data, re.DOTALL)
    end = match.end() if match else min(START.size + length, len(data))
    with contextlib.suppress(struct.error):
        start = START.pack(magic, version, end - START.size) + data[START.size : end]
        return start + CHECK.pack(zlib.crc32(start)) + data[end + CHECK.size :]
    return data


def edited(path: Path, rng: random.Random) -> str:
    """Edit the structure of an HDF5 file; return what was done."""
    names: list[str] = []
    try:
        with h5py.File(path, "r+") as file:
            file.visit(names.append)
            edit = rng.choice(EDITS)
            edit(file, rng.choice(_weighted(names, rng)) if names else "x", rng)
            return edit.__name__
    except (OSError, RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
        return f"nothing ({type(error).__name__})"


def _weighted(names: list[str], rng: random.Random) -> list[str]:
    """Return names, half of the time those of figures alone."""
    small = [name for name in names if name.startswith(("metrics", "case", "record"))]
    return small if small and rng.random() < 0.5 else names


def attribute_replaced(file: Any, name: str, rng: random.Random) -> None:
    """Give an attribute of the root, or of an object, another value."""
    node = file if rng.random() < 0.6 else file[name]
    key = rng.choice([*node.attrs, *(("new", "\x1b[2J") if rng.random() < 0.2 else ())])
    node.attrs[key] = rng.choice(VALUES)


def attribute_removed(file: Any, name: str, rng: random.Random) -> None:
    """Remove an attribute."""
    node = file if rng.random() < 0.6 else file[name]
    del node.attrs[rng.choice(list(node.attrs))]


def object_removed(file: Any, name: str, rng: random.Random) -> None:
    """Remove a group or dataset."""
    del file[name]


def object_replaced(file: Any, name: str, rng: random.Random) -> None:
    """Put a dataset of other values, type or shape in the place of an object, its attributes kept."""
    old = dict(file[name].attrs)
    del file[name]
    node = file.create_dataset(name, data=rng.choice(VALUES))
    node.attrs.update({key: value for key, value in old.items() if isinstance(value, str)})


def values_replaced(file: Any, name: str, rng: random.Random) -> None:
    """Write other numbers into a dataset."""
    node = file[name]
    if node.size > WRITABLE:
        return
    node[...] = rng.choice((np.nan, np.inf, -np.inf, 1e308, -1e308, 0.0, 1e-320, -1.0, 1e30))


def made_huge(file: Any, name: str, rng: random.Random) -> None:
    """Declare a dataset of terabytes without a value in it."""
    old = dict(file[name].attrs)
    del file[name]
    shape = rng.choice(((10**12,), (10**6, 10**6), (2**40,), (10**9,), (3, 10**9)))
    node = file.create_dataset(
        name, shape, dtype=rng.choice(("f8", "f4", "i1")), chunks=(1,) * (len(shape) - 1) + (1024,)
    )
    node.attrs.update({key: value for key, value in old.items() if isinstance(value, str)})


def linked(file: Any, name: str, rng: random.Random) -> None:
    """Put a link elsewhere or in a circle in the place of an object."""
    del file[name]
    other = rng.choice(["/", "/nowhere", name, *file])
    if rng.random() < 0.4:
        file[name] = file[rng.choice([".", name.rpartition("/")[0] or "."])]  # a hard link: a circle
    elif rng.random() < 0.5:
        file[name] = h5py.SoftLink(other)
    else:
        file[name] = h5py.ExternalLink(rng.choice(("fifo", "/dev/zero", "/etc/passwd", "nowhere.h5")), "/")


def nested(file: Any, name: str, rng: random.Random) -> None:
    """Put groups inside groups, or very many beside each other."""
    if rng.random() < 0.5:
        group = file
        for _ in range(rng.choice((60, 1500))):
            group = group.create_group("g")
        group["x"] = 1.0
    else:
        group = file.require_group(rng.choice(("metrics", "sim", "many")))
        for number in range(5000):
            group.create_group(f"g{number}")


def named_oddly(file: Any, name: str, rng: random.Random) -> None:
    """Move an object to a hostile name."""
    odd = rng.choice(
        ("\x1b[31mred", "=1+1", "a" * 5000, "..", "<script>", "ü\u202e", "x y", "1", "-h", "\x07", "class")
    )
    file.move(name, f"{name.rpartition('/')[0]}/{odd}")


def outside(file: Any, name: str, rng: random.Random) -> None:
    """Keep the values of a dataset in another file."""
    del file[name]
    file.create_dataset(
        name, (1000,), dtype="f8", external=[(rng.choice(("fifo", "/dev/zero", "/etc/passwd")), 0, 8000)]
    )


EDITS = (
    attribute_replaced, attribute_replaced, attribute_replaced, attribute_removed, object_removed, object_replaced,
    object_replaced, values_replaced, values_replaced, made_huge, linked, linked, nested, named_oddly, outside,
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    "x", "", "\x1b[2Jred", "=1+1", "9" * 5000, "a\nb", "<script>alert(1)</script>", "[1]", "{", "null", "\u202e",
    0, -1, 7, 2**62, 1e308, -1e308, float("nan"), float("inf"), 1e-320, True, np.uint8(3), np.float16(2), 1 + 2j,
    np.zeros(0), np.zeros((0, 3)), np.ones(3), np.ones(4), np.ones((3, 3)), np.ones((2, 2, 2)), np.full(3, np.nan),
    np.full(3, 1e308), np.arange(1000.0), np.bytes_(b"\xff\xfe"), np.array([b"a", b"\x1b"]), np.array([1, 2], "i1"),
    np.zeros(2, dtype=[("a", "f8"), ("b", "i4")]), np.array(["a", "b"], dtype=h5py.string_dtype()), h5py.Empty("f8"),
    h5py.Empty(h5py.string_dtype()), np.void(b"\0\1"),
)  # fmt: skip
