"""SipHash-2-4, the keyed hash that closes every packet (Aumasson and Bernstein, INDOCRYPT 2012)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rths_cli.numerics.compiled import borrowed, entry, part

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint64]


@part
def get_word(data: Bytes, at: int) -> np.uint64:
    """Return the 8 bytes of `data` from `at` on as an unsigned number, the least significant byte first."""
    word = np.uint64(0)
    for i in range(8):
        word |= np.uint64(data[at + i]) << np.uint64(8 * i)
    return word


@part
def rotated(word: np.uint64, by: int) -> np.uint64:
    """Return the word rotated left."""
    return (word << np.uint64(by)) | (word >> np.uint64(64 - by))


@part
def sip_round(
    a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return the four words of state after one round (figure 2.1 of the paper)."""
    a, c = a + b, c + d
    b, d = rotated(b, 13) ^ a, rotated(d, 16) ^ c
    a = rotated(a, 32)
    c, a = c + b, a + d
    b, d = rotated(b, 17) ^ c, rotated(d, 21) ^ a
    return a, b, rotated(c, 32), d


@part
def siphash(data: Bytes, size: int, key: Words) -> np.uint64:
    """Return SipHash-2-4 of the first `size` bytes of `data` under the key (2,)."""
    a, b = key[0] ^ np.uint64(0x736F6D6570736575), key[1] ^ np.uint64(0x646F72616E646F6D)
    c, d = key[0] ^ np.uint64(0x6C7967656E657261), key[1] ^ np.uint64(0x7465646279746573)
    whole = size // 8
    for i in range(whole + 1):
        if i < whole:
            word = get_word(data, 8 * i)
        else:
            word = np.uint64(size & 255) << np.uint64(56)
            for j in range(size - 8 * whole):
                word |= np.uint64(data[8 * whole + j]) << np.uint64(8 * j)
        d ^= word
        a, b, c, d = sip_round(a, b, c, d)
        a, b, c, d = sip_round(a, b, c, d)
        a ^= word
    c ^= np.uint64(255)
    for _ in range(4):
        a, b, c, d = sip_round(a, b, c, d)
    return a ^ b ^ c ^ d


@entry
def siphash_into(data: Bytes, size: int, key: Words, result: Words) -> None:
    """Write SipHash-2-4 of the first `size` bytes of `data` under the key (2,) into result[0]."""
    data, key, result = borrowed((data, key, result))
    result[0] = siphash(data, size, key)
