"""Which parts of a rig a sentence of the guard blames, and whether the part that failed is among them."""

from __future__ import annotations

import re

from rths_cli.loop.guard import REASONS

TABLE, SENSORS, SPECIMEN, MOTION, LINK, HOST = "table", "all sensors", "specimen", "motion", "link", "host"
TABLE_SENSOR, FIRST, TOP = "channel_0", "channel_1", "channel_2"
ALL = {TABLE_SENSOR, FIRST, TOP}

FAILED: dict[str, set[str]] = {
    "table sensor NaN": {TABLE_SENSOR},
    "floor sensor NaN": {TOP},
    "table sensor stuck": {TABLE_SENSOR},
    "floor sensor stuck": {TOP},
    "all sensors stuck": ALL,
    "table sensor unplugged": {TABLE_SENSOR},
    "floor sensor unplugged": {TOP},
    "table sensor saturated": {TABLE_SENSOR},
    "floor sensor saturated": {FIRST},
    "table sensor sign flipped": {TABLE_SENSOR},
    "first floor sign flipped": {FIRST},
    "top floor sign flipped": {TOP},
    "all signs flipped": ALL,
    "sensitivity doubled": {TABLE_SENSOR},
    "sensitivity halved": {TABLE_SENSOR},
    "floor sensitivity doubled": {FIRST},
    "offset jumps": {TABLE_SENSOR},
    "floor offset jumps": {FIRST},
    "sensor drifts": {TABLE_SENSOR},
    "floor sensor drifts": {FIRST},
    "noise of 0.3 V": ALL,
    "floor noise of 0.3 V": {TOP},
    "channels swapped": {TABLE_SENSOR, FIRST},
    "floors swapped": {FIRST, TOP},
    "loose contact": ALL,
    "loose contact of one floor": {FIRST},
    "floating input, mains hum": ALL,
    "amplifier dead": {TABLE},
    "amplifier holds": {TABLE},
    "polarity reversed": {TABLE},
    "amplifier gain 1.5": {TABLE},
    "amplifier gain 0.5": {TABLE},
    "offset of the amplifier": {TABLE},
    "friction jump to 30 N": {TABLE},
    "actuator weak": {TABLE},
    "actuator's loop goes soft": {TABLE},
    "motion ten times too large": {MOTION},
    "command saturates": {MOTION},
    "ground jumps by 0.2 m": {MOTION},
}


def blamed(sentence: str) -> set[str]:
    """Return the parts that are named first."""
    first = min((sentence.partition(f": {reason}")[0] for reason in REASONS if reason), key=len).partition(";")[0]
    found = set(re.findall(r"channel_\d", first))
    if "kept their values" in first:
        return {*ALL, TABLE}
    if "all sensors are wrong" in first:
        found |= ALL
    for words, part in (
        ("the table", TABLE), ("specimen", SPECIMEN), ("answers of the rig", LINK), ("overran", HOST),
        ("estimated from the command", MOTION), ("converter's range", MOTION), ("command changes faster", MOTION),
        ("motion asked for", MOTION), ("samples were lost", LINK),
    ):  # fmt: skip
        if words in first:
            found.add(part)
    return found or {MOTION}


def verdict(failed: set[str], sentence: str) -> str:
    """Return `true` where just what failed is named, `group` where it is among what is named, else `false`."""
    named = blamed(sentence)
    return "true" if named <= failed else "group" if named & failed else "false"
