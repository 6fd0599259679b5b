"""`--to netcdf`: netCDF-4 with CF attributes, for xarray, MATLAB and ncdump.

Source: NetCDF Climate and Forecast (CF) Metadata Conventions, version 1.11; units as UDUNITS-2 spells them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from rths_cli.files.netcdf import NetcdfGroup, write_netcdf
from rths_cli.files.result_listing import Outline
from rths_cli.files.result_reader import Dataset
from rths_cli.report.export.source_and_target import Source, Target
from rths_cli.rigs.description import adjective
from rths_cli.version import __version__

CONVENTIONS = "CF-1.11"
OTHERWISE = {"deg": "degree"}
SYMBOL = r"(?:1|m|s|kg|N|V|Hz|rad|J|g|degree|%)(?:\^\d+)?"
KNOWN = re.compile(rf"{SYMBOL}(?:[*/]{SYMBOL})*")
OWN = ("format", "format_version")  # the copy is no result file


def netcdf_targets(source: Source, folder: Path) -> list[Target]:
    """Return the one file of a result."""
    return [Target(folder / f"{source.stem}.nc", lambda path, _: _write(source, path))]


def udunits(units: str) -> str | None:
    """Return units as UDUNITS-2 spells them, None for words it does not know."""
    spelt = OTHERWISE.get(units, units)
    return spelt if KNOWN.fullmatch(spelt) else None


def _write(source: Source, path: Path) -> None:
    write_netcdf(path, _attributes(source), _groups(source))


def _attributes(source: Source) -> dict[str, Any]:
    """Return what CF asks of a file, and what the result says about itself."""
    about = source.result.attributes
    virtual = adjective(str(about.get("rig_kind", "")))
    case, method, rig = (about.get(key, "") for key in ("case_name", "method", "rig"))
    return {
        "Conventions": CONVENTIONS,
        "title": f"Real-time hybrid simulation {case}, method {method}, {virtual}shake table {rig}",
        "source": f"rths {about.get('rths_version', '')}, {virtual}shake table {rig}",
        "history": f"{about.get('created_utc', '')} {about.get('command_line', '')}\nexported by rths {__version__}",
        **{key: value for key, value in about.items() if key not in OWN},
    }


def _groups(source: Source) -> Iterator[NetcdfGroup]:
    for outline in source.groups.values():
        yield _group(source, outline)


def _group(source: Source, outline: Outline) -> NetcdfGroup:
    """Return a group without empty arrays (a block without states), which netCDF would take for unlimited ones."""
    found = source.read(outline.path)
    read = {name: found[name] for name, shape in outline.datasets.items() if 0 not in shape}
    needed = {dim for item in read.values() for dim in item.dims}
    scales = {name: found[name] for name in outline.scales if name in needed}
    unknown = {name: f"units: {item.units}" for name, item in read.items() if udunits(item.units) is None}
    variables, axes = ({name: _spelt(item) for name, item in items.items()} for items in (read, scales))
    return NetcdfGroup(outline.path, variables, axes, outline.attributes, unknown)


def _spelt(item: Dataset) -> Dataset:
    return replace(item, units=udunits(item.units) or item.units)
