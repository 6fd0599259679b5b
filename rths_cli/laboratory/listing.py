"""The work of `rths list` and `rths records`: the files that a name may stand for here, a ground motion."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.analysis.intensity import measures, spectrum
from rths_cli.case.load import load_benchmark, load_cases, load_reference, load_rig, load_structure
from rths_cli.case.named_files import find, is_bare, known_files
from rths_cli.case.shipped_files import is_shipped
from rths_cli.case.yaml_reader import display
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import (
    CORNER_HZ,
    GroundMotion,
    baseline_of,
    compressed,
    prepare,
    rounded,
    start_fault,
    straight_line,
    told_of,
    without_baseline,
)
from rths_cli.experiment.record_defects import defects
from rths_cli.files.accelerograms import Accelerogram, read_accelerogram, read_components
from rths_cli.numerics.lti import Array
from rths_cli.structure import frame_of, masses_of, similitude_of
from rths_cli.structure.similitude import factors_text

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import RigSpec
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
    masses = masses_of(spec)
    numerical, experimental = len(masses), len(spec.experimental.masses_kg)
    own = sum(masses) if spec.numerical.matrices is None else frame_of(spec.numerical.matrices).mass_kg
    attached = spec.experimental.attached  # its mass is part of the interface floor's
    mass = own if attached else own + sum(spec.experimental.masses_kg)
    named = [level.name for level in levels]
    where = "a specimen at an actuator" if attached else f"{experimental} on the table"
    text = f"{numerical if attached else numerical + experimental} storeys, {where}, {mass:g} kg; damping "
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


def _benchmark(path: Path) -> tuple[str, Details]:
    spec = load_benchmark(path)
    details = {
        "heading": spec.heading,
        "published_in": spec.published_in,
        "cases": [case.name for case in spec.cases],
        "compensators": [one.label for one in spec.compensators],
    }
    return f"{spec.heading}: {len(spec.cases)} cases, {len(spec.compensators)} compensators", details


DESCRIBED: Mapping[str, Callable[[Path], tuple[str, Details]]] = {
    "cases": _case,
    "structures": _structure,
    "rigs": _rig,
    "records": _record,
    "references": _reference,
    "benchmarks": _benchmark,
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
    component: str | None = None,
) -> tuple[dict[str, Any], str]:
    """Return measures and 5 % response spectrum of a record, as a document for JSON and as text of some width.

    The record is neither scaled nor filtered; with `scale` it is compressed to the model's time and acceleration.
    `baseline` (mean, linear) is removed from it; what is left of one is told as the high pass of a case changes it.
    Raises InputError if it cannot be read, and for several components of which none is named.
    """
    path = _found(name)
    accelerogram = read_accelerogram(path, unit, dt_s, component)
    facts = _examined(path, accelerogram, scale, baseline)
    return facts, _page(facts, width)


def components_of(
    name: str, unit: str | None, dt_s: float | None, scale: ScaleSpec | None = None, baseline: str | None = None,
    rig: str | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Return what `show` says of every component of a record's file, and with a `rig` the largest scale that its table
    can play; raises InputError if one of them cannot be read."""
    path = _found(name)
    table = None if rig is None else load_rig(find(rig, "rigs", Path.cwd()))
    return [_examined(path, each, scale, baseline, table) for each in read_components(path, unit, dt_s)]


def _found(name: str) -> Path:
    return find(name, "records", Path.cwd()) if is_bare(name) else Path(name)


def _examined(
    path: Path, accelerogram: Accelerogram, scale: ScaleSpec | None, baseline: str | None, table: RigSpec | None = None
) -> dict[str, Any]:
    """Return all that is told of a component, its baseline removed and compressed as asked."""
    accelerogram = without_baseline(accelerogram, baseline)
    similitude = similitude_of(scale) if scale is not None else None
    accelerogram = compressed(accelerogram, similitude) if similitude is not None else accelerogram
    accel, dt_s = accelerogram.accel_m_s2, accelerogram.dt_s
    found = measures(accel, dt_s)
    facts = _facts(path.stem, accelerogram)
    facts |= {"peak_velocity_m_s": found.pgv_m_s, "origin": accelerogram.origin, "sha256": accelerogram.sha256}
    accel_m_s2 = spectrum(accel, dt_s, PERIODS_S, SPECTRUM_DAMPING).sa_m_s2.tolist()
    facts |= {"periods_s": list(PERIODS_S), "pseudo_accel_m_s2": accel_m_s2}
    mean, drift = straight_line(accelerogram)
    facts |= {"first_m_s2": float(accel[0]), "mean_m_s2": mean, "drift_m_s2": drift}
    facts |= {"baseline_removed": baseline or "none", "baseline_doubt": _doubt(path, accelerogram)}
    facts |= {"file": str(path), "format": accelerogram.format, "unit": accelerogram.unit_read}
    facts |= {"station": accelerogram.station, "component": accelerogram.component}
    facts |= {"corrected": accelerogram.corrected, "measures": asdict(found), "defects": _defects(path, accelerogram)}
    if table is not None:
        from rths_cli.laboratory.playable_scale import playable  # numba, which no other list needs

        facts |= {"playable": asdict(playable(accelerogram, table))}
    return facts | ({"scale_factors": similitude.factors} if similitude is not None else {})


def _page(facts: dict[str, Any], width: int) -> str:
    """Return the facts of a component as text."""
    found, doubt, factors = facts["measures"], facts["baseline_doubt"], facts.get("scale_factors", {})

    def said(label: str, text: str) -> list[str]:
        return textwrap.wrap(f"  {label:<13}{text}", width, subsequent_indent=" " * 15) if text else []

    where = ", component ".join(filter(None, (facts["station"], facts["component"])))
    lines = [
        *textwrap.wrap(f"{facts['name']}: {facts['title']}", width, subsequent_indent="  "),
        *said("origin", facts["origin"] or "not stated"),
        *said("station", where),
        *said("corrected", facts["corrected"]),
        *said("scale", f"of the model; prototype over model: {factors_text(factors)}" if factors else ""),
        *said("samples", f"{facts['samples']} every {facts['dt_s']:.6g} s, {facts['duration_s']:.2f} s"),
        *said(
            "peak",
            f"{facts['peak_m_s2']:.4f} m/s^2, {facts['peak_velocity_m_s']:.4f} m/s, {1e3 * found['pgd_m']:.4g} mm",
        ),
        *said(
            "intensity",
            "Arias {arias_m_s:.4g} m/s, CAV {cav_m_s:.4g} m/s, Housner {housner_m:.4g} m".format(**found),
        ),
        *said(
            "duration",
            "5-75 % {d5_75_s:.4g} s, 5-95 % {d5_95_s:.4g} s; mean period {mean_period_s:.4g} s".format(**found),
        ),
        *said(
            "baseline",
            "mean {:g} m/s^2, drift {:g} m/s^2, first sample {:g} m/s^2".format(
                *(rounded(facts[f"{name}_m_s2"]) for name in ("mean", "drift", "first"))
            ),
        ),
        *said("doubt", doubt),
        *(line for defect in facts["defects"] for line in said("doubt", defect)),
        "  response spectrum, 5 % damping (pseudo-acceleration)",
    ]
    fit = max((width - 15) // 8, 1)
    for first in range(0, len(PERIODS_S), fit):
        some = slice(first, first + fit)
        lines.append("    period s   " + "".join(f"{p:>8g}" for p in list(PERIODS_S)[some]))
        lines.append("    m/s^2      " + "".join(f"{v:>8.3f}" for v in facts["pseudo_accel_m_s2"][some]))
    return "\n".join(lines) + "\n"


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


def _defects(path: Path, record: Accelerogram) -> list[str]:
    return [str(each).removeprefix("record: ") for each in defects(record, path.stem)]


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
