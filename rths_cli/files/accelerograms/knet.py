"""K-NET and KiK-net ASCII files of NIED: integers, a scale factor, the mean of the record taken off.

Source: NIED, "K-NET ASCII format", kyoshin.bosai.go.jp.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.accelerograms.columns import series
from rths_cli.files.accelerograms.record import Channel, Header, check_duration, component_names, stated_peak

_KEYS = (
    "Origin Time", "Station Code", "Record Time", "Sampling Freq(Hz)", "Duration Time(s)", "Dir.", "Scale Factor",
    "Max. Acc. (gal)", "Memo.",
)  # fmt: skip
_SCALE = re.compile(r"([\d.]+) ?\(gal\) ?/ ?([\d.]+)", re.IGNORECASE)
_DIRECTIONS = {"1": "NS1", "2": "EW1", "3": "UD1", "4": "NS2", "5": "EW2", "6": "UD2"}  # KiK-net: 1 borehole, 2 surface


def read(path: Path, lines: list[str]) -> list[Channel] | None:
    """Return the record of a K-NET or KiK-net file in gal, None for any other text; raises InputError."""
    head = [(n, line.lstrip()) for n, line in enumerate(lines[:30], 1)]
    found = {key: (n, line) for n, line in head for key in _KEYS if line.upper().startswith(key.upper())}
    if "Origin Time" not in found or not {"Scale Factor", "Sampling Freq(Hz)"} & set(found):
        return None
    if missing := [key for key in _KEYS[3:] if key not in found]:
        raise InputError(f"{path}: is a K-NET file without {', '.join(missing)}; take the file as NIED gives it")
    begins = [n for n, line in enumerate(lines, 1) if line.lstrip().upper().startswith("ORIGIN TIME")]
    if len(begins) > 1:
        raise InputError(f"{path}:{begins[1]}: a further record begins here; give each a file of its own")
    value = {key: " ".join(line[len(key) :].split()) for key, (_, line) in found.items()}
    dt_s = 1.0 / _positive(path, found, value, "Sampling Freq(Hz)", r"([\d.]+)(?: ?Hz)?")
    factor = _factor(f"{path}:{found['Scale Factor'][0]}", value["Scale Factor"])
    duration_s = _positive(path, found, value, "Duration Time(s)", r"([\d.]+)")
    station, label = value.get("Station Code", ""), value["Dir."]
    line = {key: number for key, (number, _) in found.items()}
    header = Header(
        "K-NET ASCII",
        first_line=line["Memo."],
        title=f"{station} {_DIRECTIONS.get(label, label)}, {value['Origin Time']}",
        origin="NIED K-NET/KiK-net",
        unit="gal",
        unit_line=line["Scale Factor"],
        dt_s=dt_s,
        dt_line=line["Sampling Freq(Hz)"],
    )
    counts = series(path, lines, header)
    check_duration(f"{path}:{line['Duration Time(s)']}", duration_s, counts.figures.size, dt_s)
    figures = (counts.figures - counts.figures.mean()) * factor
    if np.abs(figures).max() <= 1e-9 * factor:
        raise InputError(f"{path}: every sample is the same; name a record that moves the ground")
    peak = stated_peak(value["Max. Acc. (gal)"], line["Max. Acc. (gal)"])
    corrected = "offset (mean of the record) removed on reading, as NIED prescribes"
    names = component_names(_DIRECTIONS.get(label, label))
    return [Channel(header, figures, counts.line_of, station, names, corrected, peak)]


def _positive(path: Path, found: dict[str, tuple[int, str]], value: dict[str, str], key: str, pattern: str) -> float:
    match = re.fullmatch(pattern, value[key], re.IGNORECASE)
    try:
        number = float(match[1]) if match else 0.0
    except ValueError:
        number = 0.0
    if number <= 0.0:
        raise InputError(f"{path}:{found[key][0]}: {key}: {value[key][:40]!r} is no positive number; correct it")
    return number


def _factor(where: str, text: str) -> float:
    """Return what a count is in gal: numerator over denominator."""
    match = _SCALE.fullmatch(text)
    numerator, denominator = (float(match[1]), float(match[2])) if match else (0.0, 0.0)
    if numerator <= 0.0 or denominator <= 0.0:
        raise InputError(f"{where}: the scale factor {text[:40]!r} is not written as 3920(gal)/6170270; correct it")
    return numerator / denominator
