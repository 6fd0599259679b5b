"""The work of `rths calibrate`: measurements and a model's ratios become a calibration file of a rig."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rths_cli.case.calibration_schema import TIME, CalibratedChannel, CalibratedMass, CalibrationSpec
from rths_cli.case.load import load_cases
from rths_cli.case.resolve import VARIED
from rths_cli.case.yaml_reader import dump
from rths_cli.errors import InputError
from rths_cli.experiment.model_files import load
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.durable_files import write_new
from rths_cli.identification.compared_sensors import Belief, Measured, after, before, contradiction
from rths_cli.rigs.from_case import declared_info

CONTRADICTS = 5.0  # standard uncertainties from which a measurement is a mistake in a file, a unit or a reading
KG = "kg"
FARTHEST = 0.5  # relative uncertainty that a measurement may have
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
MEASURED = re.compile(rf"\s*({NUMBER})\s*(?:\+-|\+/-|±)\s*({NUMBER})\s*(%?)\s*")
HEAD = """\
# Calibration of rig {rig}, written by rths calibrate. The rig file names it: calibration: {name}
# Sensitivities are in V per m/s^2, m, N or 1; uncertainties are relative, one standard deviation.
"""
Ask = Callable[[str, str, float, float, str], str]
"""Ask a person for what was measured of a parameter: its option, name, declared value, its uncertainty and unit."""


@dataclass(frozen=True)
class CalibrateRequest:
    """Arguments of `rths calibrate`; each measurement is NAME=VALUE+-UNCERTAINTY."""

    case: str
    output: Path
    model: Path | None
    sensitivities: tuple[str, ...]
    masses: tuple[str, ...]
    by: str
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Row:
    """One parameter of a calibration; uncertainties are relative, one standard deviation."""

    name: str
    unit: str
    declared: float  # in the rig file or structure file
    measured: float | None
    found: float
    before: float  # uncertainty with all that was known before somebody measured
    after: float  # with the measurements
    alone: float  # of this parameter by itself, the prior of later identifications


@dataclass(frozen=True)
class CalibrationMade:
    """The result of `rths calibrate`."""

    file: Path
    calibration: CalibrationSpec
    rows: tuple[Row, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Parameter:
    """A sensitivity or mass; `base` is what the belief's logarithms refer to."""

    option: str
    name: str
    unit: str
    declared: float
    base: float


def calibrate_rig(asked: CalibrateRequest, ask: Ask | None) -> CalibrationMade:
    """Write the calibration file of a case's rig; raises InputError before anything is written.

    `ask`: asks a person for what the request does not hold; None: nobody is asked.
    """
    if asked.output.exists():
        raise InputError(f"{asked.output}: exists; a calibration is never replaced, choose another name")
    setup = make_setup(load_cases([asked.case], asked.settings)[0])
    found = None
    if asked.model is not None:
        found = load(asked.model, setup).found.calibration
        if found is None:
            raise InputError(
                f"{asked.model}: holds no calibration, because the rig declares its sensors as exact; state "
                "sensors.sensitivity_uncertainty and identify again, or leave out --model"
            )
    parameters = _parameters(setup)
    belief = before(setup.rig, setup.floor_masses_kg, found)
    said = _measurements(asked, parameters)
    if ask is not None:
        said = _asked(ask, parameters, belief, said)
    if not said and found is None:
        raise InputError("nothing was measured; give --sensitivity table=VALUE+-UNCERTAINTY, --mass or --model")
    measured = [_checked(one, belief, parameters[one.place]) for one in said]
    made = after(belief, measured)
    rows = _rows(parameters, belief, made, measured)
    calibration = _calibration(setup, asked, rows)
    text = dump(calibration.model_dump(mode="json", exclude_defaults=True))
    write_new(asked.output, HEAD.format(rig=calibration.rig, name=asked.output.name) + text)
    return CalibrationMade(asked.output, calibration, rows, tuple(_notes(setup, calibration)))


def _parameters(setup: Setup) -> tuple[_Parameter, ...]:
    declared = declared_info(setup.case).all_channels
    channels = tuple(
        _Parameter(
            "--sensitivity", one.name, f"V per {one.unit}", one.sensitivity_v_per_unit, now.sensitivity_v_per_unit
        )
        for one, now in zip(declared, setup.rig.all_channels, strict=True)
    )
    floors = zip((one.name for one in setup.rig.channels[1:]), setup.floor_masses_kg.tolist(), strict=True)
    return (*channels, *(_Parameter("--mass", name, KG, mass, mass) for name, mass in floors))


def _measurements(asked: CalibrateRequest, parameters: Sequence[_Parameter]) -> list[Measured]:
    """Return the measurements that the options state."""
    found, faults = [], []
    for option, texts in (("--sensitivity", asked.sensitivities), ("--mass", asked.masses)):
        places = {one.name: i for i, one in enumerate(parameters) if one.option == option}
        for text in texts:
            name, _, told = text.partition("=")
            if name.strip() not in places:
                faults.append(f"{option} {text}: there is no {name.strip()!r}; the rig has {', '.join(places)}")
                continue
            place = places[name.strip()]
            try:
                found.append(_read(told, place, parameters[place]))
            except InputError as error:
                faults += error.faults
    if faults:
        raise InputError(*faults)
    return found


def _asked(
    ask: Ask, parameters: Sequence[_Parameter], belief: Belief, said: Sequence[Measured]
) -> list[Measured]:  # fmt: skip
    """Return the measurements with those that a person states of what was not given."""
    given, found = {one.place for one in said}, list(said)
    for place, one in enumerate(parameters):
        if place in given or belief.alone[place] == 0.0:
            continue
        told = ask(one.option, one.name, one.declared, float(belief.alone[place]), one.unit)
        if told.strip():
            found.append(_read(told, place, one))
    return found


def _read(told: str, place: int, parameter: _Parameter) -> Measured:
    """Return the measurement that a text VALUE+-UNCERTAINTY states."""
    matched, label = MEASURED.fullmatch(told), f"{parameter.option} {parameter.name}={told.strip()}"
    if matched is None:
        example = f"{parameter.name}={parameter.declared:.5g}+-0.2%"
        raise InputError(f"{label}: state value and standard uncertainty in {parameter.unit}, such as {example}")
    value, error = float(matched[1]), float(matched[2])
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{label}: the value must be > 0 {parameter.unit}; a sign belongs to the rig file (sign: -1)")
    relative = error / 100.0 if matched[3] else error / value
    if not 0.0 < relative <= FARTHEST:
        raise InputError(
            f"{label}: the uncertainty must be > 0 and <= {100 * FARTHEST:g} %, got {100 * relative:.3g} %"
        )
    return Measured(place, math.log(value / parameter.base), relative)


def _checked(one: Measured, belief: Belief, parameter: _Parameter) -> Measured:
    """Return a measurement that the declared and identified values permit."""
    label = f"{parameter.option} {parameter.name}"
    if belief.alone[one.place] == 0.0:
        key = "uncertainty.mass" if parameter.option == "--mass" else "sensitivity_uncertainty"
        raise InputError(f"{label}: the rig file declares it as exact ({key}: 0); state its uncertainty there")
    far = contradiction(belief, one)
    if far > CONTRADICTS:
        value, known = (parameter.base * math.exp(log) for log in (one.value, float(belief.mean[one.place])))
        where = "structure" if parameter.option == "--mass" else "rig file"
        raise InputError(
            f"{label}: {value:.5g} {parameter.unit} is {far:.2g} standard uncertainties from what is known of it, "
            f"{known:.5g}, more than {CONTRADICTS:g}; measure again, or correct the {where} and identify again first"
        )
    return one


def _rows(
    parameters: Sequence[_Parameter], belief: Belief, made: Belief, measured: Sequence[Measured]
) -> tuple[Row, ...]:
    said = {one.place: one.value for one in measured}
    return tuple(
        Row(
            one.name, one.unit, one.declared, one.base * math.exp(said[i]) if i in said else None,
            float(one.base * np.exp(made.mean[i])), float(belief.joint[i]), float(made.joint[i]), float(made.alone[i]),
        )
        for i, one in enumerate(parameters)
    )  # fmt: skip


def _calibration(setup: Setup, asked: CalibrateRequest, rows: Sequence[Row]) -> CalibrationSpec:
    channels = [row for row in rows if row.unit != KG]
    before_kg = {one.floor: one for one in setup.case.table.calibration.masses} if setup.case.table.calibration else {}
    masses = [row for row in rows if row.unit == KG and (row.measured is not None or row.name in before_kg)]
    return CalibrationSpec(
        rig=setup.case.table.name.removesuffix(VARIED),
        made_utc=datetime.now(UTC).strftime(TIME),
        by=asked.by,
        model=asked.model.name if asked.model else "",
        channels=tuple(
            CalibratedChannel(
                name=row.name, declared_v_per_unit=row.declared, sensitivity_v_per_unit=_digits(row.found, 8),
                sensitivity_uncertainty=_digits(row.alone, 4), joint_uncertainty=_digits(row.after, 4),
            )
            for row in channels
        ),
        masses=tuple(
            CalibratedMass(floor=row.name, mass_kg=_digits(row.found, 6), mass_uncertainty=_digits(row.alone, 4))
            for row in masses
        ),
    )  # fmt: skip


def _digits(value: float, digits: int) -> float:
    """Return a number with so many significant digits, as a person reads it in the file."""
    return float(f"{value:.{digits}g}")


def _notes(setup: Setup, calibration: CalibrationSpec) -> list[str]:
    """Return what a person has to do before the file is used."""
    masses = dict(zip((one.name for one in setup.rig.channels[1:]), setup.floor_masses_kg.tolist(), strict=True))
    wrong = [one for one in calibration.masses if abs(masses[one.floor] / one.mass_kg - 1.0) > one.mass_uncertainty]
    notes = [
        f"state {one.mass_kg:.6g} kg for {one.floor} in structure {setup.case.structure.name}, which has "
        f"{masses[one.floor]:.6g}; until then a case with this calibration is refused"
        for one in wrong
    ]
    return [
        *notes,
        "name the file in the rig file (calibration: FILE) and identify again: the model refers to its sensors",
    ]
