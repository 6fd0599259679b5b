"""Doubts that numbers of a case are in another unit than their keys say; what specimen, record and the case's own
numbers must agree with."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.case_schema import CaseKeys
from rths_cli.case.unit_comparison import Comparison, doubts_of, of_defaults
from rths_cli.experiment.setup import place_of
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.findings import Finding, stated
from rths_cli.numerics.bands import TEST_BAND_HZ
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.rigs.unit_comparisons import of_rig
from rths_cli.structure.unit_comparisons import of_building, of_damping

if TYPE_CHECKING:
    from rths_cli.case.case_schema import Case
    from rths_cli.case.structure_schema import DampingSpec, StructureSpec
    from rths_cli.experiment.setup import Setup
    from rths_cli.structure import Building

LIGHTEST_SPECIMEN = 5e-3  # of the payload of its table
STRONGEST_G, WEAKEST_G = 1.5, 0.05  # peaks of a record before scaling
WEAKEST_TEST_G = 0.01  # peak of a scaled record
MEAN_PERIOD_S = (0.06, 2.5)  # of a record: the inverse of its mean frequency, weighted by power
DURATION_S = (2.0, 400.0)
NARROW = (1.0 / 8.0, 8.0)
OVER_DEFAULT = {  # a stated number over its default; those that follow the test band over what follows from it
    "sample_rate_hz": NARROW, "test_band_hz": NARROW, "delay_s": NARROW, "record_filter.corner_hz": NARROW,
    "kalman.q": (1.0 / 300.0, 300.0), "kalman.r": (1.0 / 300.0, 300.0), "kalman.residual_hz": NARROW,
    "identification.duration_s": NARROW, "identification.accel_rms_m_s2": NARROW, "identification.low_hz": NARROW,
    "identification.high_hz": NARROW, "controller.max_sensitivity": (0.7, 3.0),
    "base_shear_uncertainty": NARROW, "grade_limits.good_percent": NARROW, "grade_limits.good_ratio": NARROW,
    "grade_limits.usable_percent": NARROW, "table.uncertainty.corner": NARROW, "table.uncertainty.skew_s": NARROW,
    "table.uncertainty.specimen": NARROW, "table.uncertainty.table_gain": NARROW,
    "table.watchdog_s": (0.125, 25.0), "table.limits.energy_ratio": NARROW,
}  # fmt: skip
OF_TEST_BAND = {  # numbers in Hz without a default of their own, over the test band
    "controller.feedback_bandwidth_hz": ((0.05, 8.0),), "controller.disturbance_hz": ((2e-3, 0.5), (0.1, 5.0)),
    "identification.compared_hz": ((7.0 / 960.0, 0.45), (0.12, 5.0)),
}  # fmt: skip
FOLLOWS = ("kalman.residual_hz", "identification.low_hz", "identification.high_hz")  # the test band
MASSES = "structure.experimental.masses_kg"

OF_RIG = ("table.",)  # beginnings of the keys of a rig
OF_IDENTIFICATION = ("structure.", "damping.", *OF_RIG, "identification.")  # of all that an identification plays


def of_specimen_on_table(setup: Setup) -> Iterator[Comparison]:
    """Yield the comparison of the specimen with the payload of its table; more than the payload is refused."""
    weight = float(setup.building.specimen.masses_kg.sum()) + setup.building.interface_experimental_mass_kg
    payload, name = setup.case.table.nominal.payload_kg, setup.case.table.name
    of = ("table.nominal.payload_kg",)
    yield Comparison(
        MASSES, weight, "kg", f"what rig {name} carries", payload, LIGHTEST_SPECIMEN, 1.0, of, "the specimen",
        "are they in kg?",
    )  # fmt: skip


def of_record(setup: Setup) -> Iterator[Comparison]:
    """Yield the comparisons of the record, as its file states it, with ground motions, and of what is left of it."""
    case, record = setup.case, setup.case.record
    raw = _raw_record(record.path, record.unit, record.dt_s, record.component, setup.record_sha256)
    scaled = float(np.abs(setup.motion.accel_m_s2).max())
    name, asked = f"{record.name}, its peak before scaling", "is its unit right (m/s^2, cm/s^2, g)?"
    # a weak record that is scaled up is known to be weak
    as_written = case.scaling <= 1.0 and record.scale_to is None
    weakest = WEAKEST_G if as_written or scaled < WEAKEST_G * STANDARD_GRAVITY_M_S2 else 0.0
    yield Comparison(
        "record", raw.peak_m_s2, "m/s^2", "1 g", STANDARD_GRAVITY_M_S2, weakest, STRONGEST_G, (), name, asked
    )
    yield Comparison(
        "scaling", scaled, "m/s^2", "1 g", STANDARD_GRAVITY_M_S2, WEAKEST_TEST_G, STRONGEST_G, ("record",),
        "the peak of the scaled record", "are scaling and the record's unit right?",
    )  # fmt: skip
    step = "is its time step in s?"
    for named, value, (low, high) in (
        ("its mean period", raw.mean_period_s, MEAN_PERIOD_S),
        ("its duration", raw.duration_s, DURATION_S),
    ):
        yield Comparison("record", value, "s", "1 s", 1.0, low, high, (), f"{record.name}, {named}", step)


@dataclass(frozen=True)
class RawRecord:
    """A record as its file states it; the mean period is the inverse of the mean frequency, weighted by power."""

    peak_m_s2: float
    mean_period_s: float
    duration_s: float


@lru_cache(maxsize=32)
def _raw_record(path: Path, unit: str | None, dt_s: float | None, component: str | None, sha256: str) -> RawRecord:
    """Return what is compared of a record's file, which `sha256` tells from others of its name."""
    record = read_accelerogram(path, unit, dt_s, component)
    accel = record.accel_m_s2 - record.accel_m_s2.mean()
    power = np.abs(np.fft.rfft(accel)) ** 2
    mean_hz = float(power @ np.fft.rfftfreq(accel.size, record.dt_s) / max(float(power.sum()), np.finfo(float).tiny))
    peak, duration = float(np.abs(record.accel_m_s2).max()), record.dt_s * (accel.size - 1)
    return RawRecord(peak, 1.0 / max(mean_hz, np.finfo(float).tiny), duration)


def of_case(case: Case) -> Iterator[Comparison]:
    """Yield the comparisons of a case's own numbers, as far as they are stated, with their defaults."""
    follows = case.test_band_hz / TEST_BAND_HZ
    for key, (low, high) in OVER_DEFAULT.items():
        value, default = value_at(case, key), _default(key, case)
        if value is None or default is None or not _stated(case, key) or not value > 0.0:
            continue
        figure = default * (follows if key in FOLLOWS else 1.0)
        what = "what follows from test_band_hz" if key in FOLLOWS else "its default"
        unit = key.rpartition("_")[2] if key.endswith(("_hz", "_s")) and "rms" not in key else ""
        yield Comparison(key, value, unit.replace("hz", "Hz"), what, figure, low, high)
    for key, ranges in OF_TEST_BAND.items():
        found = value_at(case, key) if _stated(case, key) else None
        ends = found if isinstance(found, tuple) else (found,) * len(ranges)
        for value, (low, high) in zip(ends, ranges, strict=True):
            if value is not None:
                yield Comparison(key, value, "Hz", "the test band", case.test_band_hz, low, high, ("test_band_hz",))
    if case.check is not None and case.check.specimen_range is not None:
        for end, value in zip(("least", "greatest"), case.check.specimen_range, strict=True):
            key = "check.specimen_range"
            yield Comparison(key, value, "", "the identified stiffness", 1.0, 0.15, 4.0, (), f"the {end}")
    if case.scale is not None:
        yield Comparison("scale.length", case.scale.length, "", "a model as large as its prototype", 1.0, 0.9, 60.0)
        accel = case.scale.acceleration
        yield Comparison("scale.acceleration", accel, "", "the same acceleration", 1.0, 0.15, 6.0)


def _stated(case: Case, key: str) -> bool:
    """Return whether the case or its rig file states a key; a default needs no comparison with itself."""
    return key in case.stated or key in case.places


def value_at(data: Any, key: str) -> Any:
    """Return what stands at a key of a case, None where nothing does."""
    for name in key.split("."):
        data = getattr(data, name, None)
    return data


def _default(key: str, case: Case) -> float | None:
    """Return the default of a number, which its schema declares."""
    above, _, name = key.rpartition(".")
    fields = getattr(type(value_at(case, above)), "model_fields", {}) if above else CaseKeys.model_fields
    value = fields[name].default if name in fields else None
    return float(value) if isinstance(value, int | float) else None


def doubts(setup: Setup) -> tuple[Comparison, ...]:
    """Return the doubts on the units of a case, those on the building first, without those that the case calls
    plausible (`plausible`)."""
    consented = setup.case.plausible or ()
    return tuple(doubts_of(one for one in _comparisons(setup) if one.key not in consented))


def unknown_consents(setup: Setup) -> tuple[Finding, ...]:
    """Return a finding for each key of `plausible` that the case does not have: it permits nothing."""
    case, known = setup.case, dict.fromkeys(one.key for one in _comparisons(setup))
    told = []
    for key in case.plausible or ():
        if key not in known and value_at(case, key) is None:
            near = next(iter(get_close_matches(key, known, 1)), None)
            found = Finding("units.unknown_consent", {"key": key, "near": near})
            told.append(found.at("at.place", place=place_of(case, "plausible")))
    return tuple(told)


def unit_doubts(setup: Setup) -> tuple[Finding, ...]:
    """Return the doubts on the units of a case: building, specimen on its table, rig, record, numbers; each with file
    and line of its key."""
    return tuple(_placed(setup, one) for one in doubts(setup))


def _placed(setup: Setup, doubt: Comparison) -> Finding:
    return doubt.finding.at("at.place", place=place_of(setup.case, doubt.key))


def keys_in_doubt(setup: Setup) -> tuple[str, ...]:
    """Return the keys whose values speak for another unit than they must have, each once."""
    return tuple(dict.fromkeys(one.key for one in doubts(setup)))


def doubts_building(setup: Setup) -> bool:
    """Return whether the building or its record is doubted: all that follows from them is then of no use."""
    return any(key.partition(".")[0] in ("structure", "damping", "record") for key in keys_in_doubt(setup))


def specimen_doubts(setup: Setup) -> tuple[Finding, ...]:
    """Return each doubt that concerns an identification: on the building, its specimen and the rig."""
    return tuple(_placed(setup, one) for one in doubts(setup) if one.key.startswith(OF_IDENTIFICATION))


def building_doubts(spec: StructureSpec, damping: Sequence[DampingSpec], building: Building) -> tuple[str, ...]:
    """Return a sentence for each doubt on the units of a building, () if its numbers are plausible.

    Each begins with the key in a structure file.
    """
    found = doubts_of((*of_building(spec, building), *of_damping(spec, damping, building)))
    return tuple(replace(one, key=one.key.removeprefix("structure.")).sentence for one in found)


def _comparisons(setup: Setup) -> Iterator[Comparison]:
    case = setup.case
    if setup.rig.interface == "displacement":  # what is known of tables says nothing of actuators
        yield from of_record(setup)
        return
    yield from of_building(case.structure, setup.building)
    yield from of_damping(case.structure, (case.damping,), setup.building)
    yield from of_specimen_on_table(setup)
    yield from of_rig(case)
    yield from of_record(setup)
    yield from of_case(case)
    yield from of_defaults(case)


def before_error(setup: Setup, error: Exception) -> tuple[Finding, ...]:
    """Return doubts on units and the error that followed; where building or record are doubted, without its figures and
    advice, which are of other causes."""
    told, said = unit_doubts(setup), str(error)
    if doubts_building(setup):
        followed = re.split("[,;] ", said)[0].removeprefix(f"identification of rig {setup.rig.name}: ")
        said = f"it would explain: {followed}"
    return (*told, stated(said))
