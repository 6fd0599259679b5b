"""DYNA ASCII files of ESM and ITACA: 64 lines `KEY: value`, then one sample a line in cm/s^2.

Source: ESM working group, "DYNA 1.2 file format", esm-db.eu.
"""

from __future__ import annotations

import re
from pathlib import Path

from rths_cli.errors import InputError
from rths_cli.files.acceleration_units import FACTORS_M_S2
from rths_cli.files.accelerograms.columns import series
from rths_cli.files.accelerograms.record import (
    Channel,
    Header,
    check_duration,
    component_names,
    count_of,
    interval_of,
    known_unit,
    stated_peak,
)

_LINE = re.compile(r"([A-Z][A-Z0-9_/^]*)\s*:\s*(.*)", re.IGNORECASE)
_MOST_LINES = 80
_NEEDED = ("SAMPLING_INTERVAL_S", "NDATA", "UNITS")


def read(path: Path, lines: list[str]) -> list[Channel] | None:
    """Return the record of a DYNA file, None for any other text; raises InputError."""
    value: dict[str, str] = {}
    line: dict[str, int] = {}
    for number, text in enumerate(lines[:_MOST_LINES], 1):
        match = _LINE.match(text)
        if match is None and (value or text.strip()):
            break
        if match is None:
            continue  # a blank line above the header
        key = match[1].upper()
        value[key], line[key] = match[2].strip(), number
    if not {"SAMPLING_INTERVAL_S", "NDATA"} & set(value):
        return None
    if missing := [key for key in _NEEDED if not value.get(key)]:
        raise InputError(
            f"{path}: is a DYNA file that states no {', '.join(missing)}; take the file as its agency gives it"
        )
    kind = value.get("DATA_TYPE", "ACCELERATION") or "ACCELERATION"
    if kind.upper() not in ("ACC", "ACCELERATION"):
        raise InputError(
            f"{path}:{line['DATA_TYPE']}: is a record of {kind.lower()[:40]}; give the acceleration record"
        )
    header = Header(
        "DYNA",
        first_line=max(line.values()),
        title=f"{value.get('STATION_CODE', '')} {value.get('STREAM', '')}, {value.get('EVENT_NAME', '')} "
        f"{value.get('EVENT_DATE_YYYYMMDD', '')}".strip(", "),
        origin="; ".join(filter(None, (value.get("DATA_LICENSE"), value.get("DATA_CITATION")))),
        unit=known_unit(f"{path}:{line['UNITS']}", value["UNITS"]),
        unit_line=line["UNITS"],
        dt_s=interval_of(f"{path}:{line['SAMPLING_INTERVAL_S']}", value["SAMPLING_INTERVAL_S"]),
        dt_line=line["SAMPLING_INTERVAL_S"],
        samples=count_of(f"{path}:{line['NDATA']}", value["NDATA"]),
        samples_line=line["NDATA"],
    )
    channel = series(path, lines, header)
    if re.fullmatch(r"\d+\.?\d*", value.get("DURATION_S", "")) and header.dt_s:
        check_duration(f"{path}:{line['DURATION_S']}", float(value["DURATION_S"]), channel.figures.size, header.dt_s)
    ratio = FACTORS_M_S2["cm/s^2"] / FACTORS_M_S2[header.unit or "cm/s^2"]
    peak = stated_peak(value.get("PGA_CM/S^2", ""), line.get("PGA_CM/S^2", 0), ratio)
    return [
        Channel(
            header,
            channel.figures,
            channel.line_of,
            ".".join(filter(None, (value.get("NETWORK"), value.get("STATION_CODE")))),
            component_names(value.get("STREAM", "")),
            _corrected(value),
            peak,
        )
    ]


def _corrected(value: dict[str, str]) -> str:
    """Return what the agency did, in a few words."""
    low, high = value.get("LOW_CUT_FREQUENCY_HZ"), value.get("HIGH_CUT_FREQUENCY_HZ")
    band = f"{low or '?'} to {high or '?'} Hz" if low or high else ""
    kind = f"{value.get('FILTER_TYPE', '').lower()} filter {band}" if band else ""
    return ", ".join(filter(None, (value.get("BASELINE_CORRECTION", "").lower(), kind)))
