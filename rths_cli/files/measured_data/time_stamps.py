"""Dates and times of day as programs write them: ISO 8601, day or month first, 12 or 24 hours."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

_DAY_NS, _S_NS = 86_400 * 10**9, 10**9
_DATE = r"(?:(?P<y>\d{4})[-/.](?P<m>\d\d?)[-/.](?P<d>\d\d?)|(?P<a>\d\d?)[-/.](?P<b>\d\d?)[-/.](?P<z>\d{4}))"
_CLOCK = r"(?P<h>\d\d?):(?P<min>\d\d)(?::(?P<s>\d\d))?(?:[.,](?P<f>\d{1,18}))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_ZONE = r"\s*(?:[Zz]|(?:UTC|GMT)|(?P<sign>[+-])(?P<zh>\d\d):?(?P<zm>\d\d))?"
_STAMP = re.compile(rf"(?:{_DATE})?(?:(?(y)[T\s]+|(?(a)[T\s]+|)){_CLOCK}{_ZONE})?")


def stamps_ns(words: Sequence[str]) -> NDArray[np.int64] | None:
    """Return the stamps (n,) in ns on one clock, from 1970 where they have a date; None where a word is none.

    Times of day alone pass midnight. Where a day and a month could be either, the order that leaves the shorter steps
    is taken. `12:34.5`, without seconds but with a fraction, is minutes and seconds.
    """
    matches = [_STAMP.fullmatch(word) if word else None for word in words]
    if any(match is None for match in matches):
        return None
    tried = []
    for day_first in (True, False):
        try:
            tried.append([_ns(match, day_first) for match in matches if match is not None])
        except ValueError:
            continue
    if not tried:
        return None
    found = min(tried, key=lambda times: max((abs(b - a) for a, b in pairwise(times)), default=0))
    has_date = matches[0] is not None and bool(matches[0]["y"] or matches[0]["z"])
    found = found if has_date else _past_midnight(found)
    return np.array(found, dtype=np.int64) if max(map(abs, found), default=0) < 2**63 else None


def _ns(match: re.Match[str], day_first: bool) -> int:
    """Return one stamp in ns; raise ValueError for a date or an hour that does not exist."""
    part = match.groupdict()
    days = 0
    if part["y"]:
        days = date(int(part["y"]), int(part["m"]), int(part["d"])).toordinal()
    elif part["z"]:
        day, month = (part["a"], part["b"]) if day_first else (part["b"], part["a"])
        days = date(int(part["z"]), int(month), int(day)).toordinal()
    if days:
        days -= date(1970, 1, 1).toordinal()
    fraction = int((part["f"] or "0").ljust(9, "0")[:9])
    hours, minutes, seconds = int(part["h"] or 0), int(part["min"] or 0), int(part["s"] or 0)
    if part["f"] and part["s"] is None:
        hours, minutes, seconds = 0, hours, minutes
    if part["half"]:
        hours = hours % 12 + (12 if part["half"].lower().startswith("p") else 0)
    if hours > 23 or minutes > 59 or seconds > 60:
        raise ValueError(match[0])
    zone = (60 * int(part["zh"]) + int(part["zm"])) * (-1 if part["sign"] == "-" else 1) if part["zh"] else 0
    return days * _DAY_NS + ((hours * 60 + minutes - zone) * 60 + seconds) * _S_NS + fraction


def _past_midnight(times: Sequence[int]) -> list[int]:
    """Return times of day in ns with a day added at each midnight."""
    days, told = 0, [times[0]] if times else []
    for before, after in pairwise(times):
        days += after < before - _DAY_NS // 2
        told.append(after + days * _DAY_NS)
    return told
