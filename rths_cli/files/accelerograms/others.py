"""Formats of records that are known by their content and not read: their names, and the way to convert them."""

from __future__ import annotations

import re
from collections.abc import Sequence

CONVERT = "convert it to CSV (time_s,accel_m_s2); gmprocess (USGS) reads it"
_TEXTS = (
    (r"^[0-4] +(UNCORRECTED|CORRECTED|VELOCITY|DISPLACEMENT|RESPONSE|RAW|ACCELERATION)", "an SMC file (USGS)"),
    (r"^(un)?corrected accelerogram .*GNS Science", "a GeoNet file (New Zealand)"),
    (r"^strong ground motion records of turki?y?e?", "a file of the Turkish network (AFAD, older layout)"),
    (r"^#Earthquake Information", "a file of CWB (Taiwan)"),
    (r"^\* VOL1DS FILE", "a file of BHRC (Iran)"),
    (r"^INSTITUTO DE INGENIERIA,? UNAM|^ARCHIVO ESTANDAR DE ACELERACION", "a file of UNAM (Mexico)"),
)  # fmt: skip
_PACKED = (
    (b"PK\x03\x04", "a zip archive or a workbook"), (b"\x1f\x8b", "compressed (gzip)"), (b"BZh", "compressed (bzip2)"),
    (b"\xfd7zXZ", "compressed (xz)"), (b"7z\xbc\xaf", "an archive (7-Zip)"), (b"Rar!", "an archive (RAR)"),
    (b"\xd0\xcf\x11\xe0", "a workbook (.xls)"),
)  # fmt: skip
_V3 = re.compile(r"response and fourier amplitude spectra|response spectra", re.IGNORECASE)


def named(lines: Sequence[str]) -> str:
    """Return what a text is that has to be converted, as the end of a sentence; "" for any other."""
    first = next((line for line in lines[:5] if line.strip() and line.strip("*= \t-")), "")
    if _V3.search(first) and not first.startswith("#"):
        return (
            "is a file of spectra (V3), which holds no acceleration history; give the corrected record (V2) of the "
            "same station"
        )
    for pattern, name in _TEXTS:
        if re.search(pattern, first.strip(), re.IGNORECASE):
            return f"is {name}; {CONVERT}"
    return ""


def is_asdf(data: bytes) -> bool:
    """Say whether bytes are a file of the Adaptable Seismic Data Format, an HDF5 file of waveforms."""
    return data.startswith(b"\x89HDF") and b"Waveforms" in data and b"ASDF" in data


def named_binary(data: bytes) -> str:
    """Return what binary data are that have to be converted, as the end of a sentence."""
    if is_asdf(data):
        return (
            "is an ASDF file; write the wanted trace as CSV (time_s,accel_m_s2) with pyasdf or gmprocess (USGS), or as "
            "miniSEED"
        )
    packed = next((name for sign, name in _PACKED if data.startswith(sign)), "")
    if packed or data[257:262] == b"ustar":
        return f"is {packed or 'an archive (tar)'}; unpack it, or save a workbook's sheet as CSV (time_s,accel_m_s2)"
    return "is a binary file; convert the accelerogram to CSV (time_s,accel_m_s2)"
