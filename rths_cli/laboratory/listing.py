"""The work of `rths list` and `rths records`: the files that a name may stand for here, a ground motion."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.load import load_cases, load_reference, load_rig, load_structure
from rths_cli.case.named_files import find, is_bare, known_files
from rths_cli.case.shipped_files import is_shipped
from rths_cli.case.yaml_reader import display
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import (
    CORNER_HZ,
    GroundMotion,
    baseline_of,
    compressed,
    peaks,
    prepare,
    response_spectrum,
    rounded,
    start_fault,
    straight_line,
    told_of,
    without_baseline,
)
from rths_cli.files.accelerograms import Accelerogram, read_accelerogram
from rths_cli.numerics.lti import Array
from rths_cli.structure import similitude_of
from rths_cli.structure.similitude import factors_text

if TYPE_CHECKING:
    from rths_cli.case.structure_schema import ScaleSpec

Details = Mapping[str, Any]

PERIODS_S = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
SPECTRUM_DAMPING = 0.05


@dataclass(frozen=True)
class Listed:
    """One file that can be named."""

    name: str
    file: str  # path as a user would type it
    own: bool  # whether it is the user's own, not a shipped one
    description: str  # one line, or why the file cannot be used
    details: Details  # for JSON; empty if the file cannot be used


def list_files(kind: str) -> list[Listed]:
    """Return the files of a kind (cases, structures, rigs, records or references), the user's own first."""
    found = [_listed(kind, name, path) for name, path in sorted(known_files(kind, Path.cwd()).items())]
    return sorted(found, key=lambda one: not one.own)


def _listed(kind: str, name: str, path: Path) -> Listed:
    own = not is_shipped(path)
    where = display(path) if own else str(path)
    try:
        description, details = DESCRIBED[kind](Path(where))
    except InputError as error:
        more = f" (and {len(error.faults) - 1} more)" if len(error.faults) > 1 else ""
        return Listed(name, where, own, f"cannot be used: {error.faults[0]}{more}", {})
    return Listed(name, where, own, description, details)


def _case(path: Path) -> tuple[str, Details]:
    case = load_cases([path])[0]
    details: dict[str, Any] = {
        "structure": case.structure.name,
        "damping": case.damping.name,
        "record": case.record.name,
        "scaling": case.scaling,
        "controller": case.controller.kind,
        "rig": case.table.name,
        "method": case.method,
    }
    text = "{structure}, damping {damping}, {record} x {scaling:g}, {controller}, rig {rig}".format(**details)
    return text, details


def _structure(path: Path) -> tuple[str, Details]:
    spec, levels, *_ = load_structure(str(path.absolute()))
    numerical, experimental = len(spec.numerical.masses_kg), len(spec.experimental.masses_kg)
    mass = sum(spec.numerical.masses_kg) + sum(spec.experimental.masses_kg)
    named = [level.name for level in levels]
    text = f"{numerical + experimental} storeys, {experimental} on the table, {mass:g} kg; damping "
    details = {"numerical_storeys": numerical, "experimental_storeys": experimental, "mass_kg": mass}
    return text + (", ".join(named) or "levels: none"), {**details, "damping_levels": named}


def _rig(path: Path) -> tuple[str, Details]:
    rig = load_rig(path)
    details = {
        "kind": rig.kind,
        "payload_kg": rig.nominal.payload_kg,
        "stroke_m": rig.limits.stroke_m,
        "force_n": rig.limits.force_n,
    }
    text = f"{rig.kind}, {rig.nominal.payload_kg:g} kg payload, +-{1e3 * rig.limits.stroke_m:g} mm, "
    return f"{text}{rig.limits.force_n:g} N", details


def _record(path: Path) -> tuple[str, Details]:

    details = facts_of(path)
    text = "{title}; {samples} samples every {dt_s:g} s, {duration_s:.2f} s, peak {peak_m_s2:.4f} m/s^2"
    return text.format(**details), details


def _reference(path: Path) -> tuple[str, Details]:
    reference = load_reference(path)
    details = {"title": reference.title, "source": reference.source, "entries": len(reference.entries)}
    return f"{reference.title}; {reference.source}", details


DESCRIBED: Mapping[str, Callable[[Path], tuple[str, Details]]] = {
    "cases": _case,
    "structures": _structure,
    "rigs": _rig,
    "records": _record,
    "references": _reference,
}


def facts_of(path: Path) -> dict[str, Any]:
    """Return name, title, sampling and peak of a record's file; raises InputError if it cannot be read."""
    return _facts(path.stem, read_accelerogram(path))


def show(
    name: str,
    unit: str | None,
    dt_s: float | None,
    width: int = 100,
    scale: ScaleSpec | None = None,
    baseline: str | None = None,
) -> tuple[dict[str, Any], str]:
    """Return data, peaks and 5 % response spectrum of a record, as a document for JSON and as text of some width.

    The record is neither scaled nor filtered; with `scale` it is compressed to the model's time and acceleration.
    `baseline` (mean, linear) is removed from it; what is left of one is told as the high pass of a case changes it.
    Raises InputError if it cannot be read.
    """
    path = find(name, "records", Path.cwd()) if is_bare(name) else Path(name)
    accelerogram = read_accelerogram(path, unit, dt_s)
    accelerogram = without_baseline(accelerogram, baseline)
    similitude = similitude_of(scale) if scale is not None else None
    accelerogram = compressed(accelerogram, similitude) if similitude is not None else accelerogram
    motion = prepare(accelerogram, 1.0, 1.0 / accelerogram.dt_s, corner_hz=0.0)
    largest, spectrum = peaks(motion), response_spectrum(motion, PERIODS_S, SPECTRUM_DAMPING)
    facts = _facts(path.stem, accelerogram)
    facts |= {"peak_velocity_m_s": largest.velocity_m_s, "origin": accelerogram.origin, "sha256": accelerogram.sha256}
    accel_m_s2 = [float(v) for v in spectrum]
    facts |= {"periods_s": list(PERIODS_S), "pseudo_accel_m_s2": accel_m_s2}
    mean, drift = straight_line(accelerogram)
    doubt = _doubt(path, accelerogram)
    facts |= {"first_m_s2": float(accelerogram.accel_m_s2[0]), "mean_m_s2": mean, "drift_m_s2": drift}
    facts |= {"baseline_removed": baseline or "none", "baseline_doubt": doubt}
    factors = similitude.factors if similitude is not None else {}
    facts |= {"scale_factors": factors} if factors else {}
    told = f"  scale        of the model; prototype over model: {factors_text(factors)}"
    lines = [
        *textwrap.wrap(f"{facts['name']}: {facts['title']}", width, subsequent_indent="  "),
        *textwrap.wrap(f"  origin       {accelerogram.origin or 'not stated'}", width, subsequent_indent=" " * 15),
        *(textwrap.wrap(told, width, subsequent_indent=" " * 15) if factors else ()),
        f"  samples      {facts['samples']} every {facts['dt_s']:.6g} s, {facts['duration_s']:.2f} s",
        f"  peak         {facts['peak_m_s2']:.4f} m/s^2, {largest.velocity_m_s:.4f} m/s",
        "  baseline     mean {:g} m/s^2, drift {:g} m/s^2, first sample {:g} m/s^2".format(
            *(rounded(facts[f"{name}_m_s2"]) for name in ("mean", "drift", "first"))
        ),
        *(textwrap.wrap(f"  doubt        {doubt}", width, subsequent_indent=" " * 15) if doubt else ()),
        "  response spectrum, 5 % damping (pseudo-acceleration)",
    ]
    fit = max((width - 15) // 8, 1)
    for first in range(0, len(PERIODS_S), fit):
        some = slice(first, first + fit)
        lines.append("    period s   " + "".join(f"{p:>8g}" for p in list(PERIODS_S)[some]))
        lines.append("    m/s^2      " + "".join(f"{v:>8.3f}" for v in accel_m_s2[some]))
    return facts, "\n".join(lines) + "\n"


def _doubt(path: Path, record: Accelerogram) -> str:
    """Return what the usual high pass makes of a record's baseline, or of a first sample that is a step; "" for a clean
    record and for one too short for that filter."""

    def motion(accel: Array) -> GroundMotion:
        return prepare(replace(record, accel_m_s2=accel), 1.0, 1.0 / record.dt_s)

    try:
        filtered = motion(record.accel_m_s2)
    except InputError:
        return ""
    found = baseline_of(record, lambda accel: motion(accel).displacement_m)
    told = told_of(found, path.stem, CORNER_HZ, path.name) if found else None
    return start_fault(filtered, record, found, told) or str(told or "")


def _facts(name: str, record: Accelerogram) -> dict[str, Any]:
    samples = len(record.accel_m_s2)
    return {
        "name": name,
        "title": record.title,
        "samples": samples,
        "dt_s": record.dt_s,
        "duration_s": (samples - 1) * record.dt_s,
        "peak_m_s2": float(np.abs(record.accel_m_s2).max()),
    }
