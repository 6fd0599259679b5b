"""The work of `rths calibrate`: measurements and a model's ratios become a calibration file of a rig."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rths_cli.case.calibration_schema import TIME, CalibratedChannel, CalibratedMass, CalibrationSpec
from rths_cli.case.further_channel_schema import UNITS
from rths_cli.case.load import load_cases
from rths_cli.case.resolve import VARIED
from rths_cli.case.yaml_reader import dump, printable
from rths_cli.errors import InputError
from rths_cli.experiment.model_files import load
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.durable_files import write_new
from rths_cli.identification.absolute_scale import Belief, Measured, after, before, contradiction
from rths_cli.numerics.constants import FACTORS
from rths_cli.rigs.from_case import declared_info, weighed
from rths_cli.safe_text import LONGEST_NAME, shortened

CONTRADICTS = 5.0  # standard uncertainties from which a measurement is a mistake in a file, a unit or a reading
KG = "kg"
LEAST, FARTHEST = 1e-6, 0.5  # relative uncertainty that a measurement may have
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
MEASURED = re.compile(rf"\s*({NUMBER})\s*(.*?)\s*(?:\+-|\+/-|±)\s*({NUMBER})\s*(.*?)\s*")
HEAD = """\
# Calibration of rig {rig}, written by rths calibrate. The rig file names it: calibration: {name}
# Sensitivities are in V per m/s^2, m, N or 1; uncertainties are relative, one standard deviation.
"""


@dataclass(frozen=True)
class Question:
    """What a person is asked of one sensitivity or mass."""

    what: str  # such as "sensitivity of table"
    declared: str  # value with its unit
    uncertainty: float  # of it, relative, one standard deviation
    refused: str = ""  # why the answer before was none


Ask = Callable[[Question], str]
"""Ask a person what was measured; "" for nothing."""


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
    """A sensitivity or mass; `base` is what the belief's logarithms refer to, `units` in what it may be stated."""

    option: str
    name: str
    unit: str
    declared: float
    base: float
    units: Mapping[str, float]

    @property
    def told(self) -> str:
        """Return the declared value in words, of an accelerometer also as its data sheet has it."""
        beside = f" ({self.declared / self.units['mV/g']:.6g} mV/g)" if "mV/g" in self.units else ""
        return f"{self.declared:.6g} {self.unit}{beside}"


def calibrate_rig(asked: CalibrateRequest, ask: Ask | None) -> CalibrationMade:
    """Write the calibration file of a case's rig; raises InputError before anything is written.

    `ask`: asks a person for what the request does not hold; None: nobody is asked.
    """
    _check_request(asked)
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
    if not belief.alone.any():
        raise InputError(
            f"{setup.case.table.name}: the rig file declares all sensors and masses as exact; state "
            "sensors.sensitivity_uncertainty and uncertainty.mass there"
        )
    said, made = _measurements(asked, parameters), belief
    for one in said:
        made = _with(made, one, parameters[one.place])
    if ask is not None:
        made = _asked(ask, parameters, made, said)
    if not said and found is None:
        raise InputError("nothing was measured; give --sensitivity table=VALUE+-UNCERTAINTY, --mass or --model")
    rows = _rows(parameters, belief, made, said)
    calibration = _calibration(setup, asked, rows)
    text = dump(calibration.model_dump(mode="json", exclude_defaults=True))
    write_new(asked.output, HEAD.format(rig=printable(calibration.rig), name=printable(asked.output.name)) + text)
    return CalibrationMade(asked.output, calibration, rows, tuple(_notes(setup, calibration)))


def _check_request(asked: CalibrateRequest) -> None:
    """Raise InputError for what can be refused before anything is read, or anybody asked."""
    folder = asked.output.absolute().parent
    if asked.output.exists():
        raise InputError(f"{asked.output}: exists; a calibration is never replaced, choose another name")
    if not folder.is_dir():
        raise InputError(f"{asked.output}: there is no folder {printable(str(folder))}; make it first")
    if len(asked.by) > LONGEST_NAME or not asked.by.isprintable():
        raise InputError(f"--by: must be one line of at most {LONGEST_NAME} characters")


def _parameters(setup: Setup) -> tuple[_Parameter, ...]:
    declared = declared_info(setup.case).all_channels
    channels = tuple(
        _Parameter(
            "--sensitivity",
            one.name,
            f"V per {one.unit}",
            one.sensitivity_v_per_unit,
            now.sensitivity_v_per_unit,
            {
                f"{sign}/{unit}": volt / size
                for sign, volt in FACTORS["voltage"].items()
                for unit, size in UNITS[one.kind].items()
            },
        )
        for one, now in zip(declared, setup.rig.all_channels, strict=True)
    )
    floors = zip((one.name for one in setup.rig.channels[1:]), setup.floor_masses_kg.tolist(), strict=True)
    return (*channels, *(_Parameter("--mass", name, KG, mass, mass, FACTORS["mass"]) for name, mass in floors))


def _measurements(asked: CalibrateRequest, parameters: Sequence[_Parameter]) -> list[Measured]:
    """Return the measurements that the options state."""
    found: list[Measured] = []
    faults: list[str] = []
    for option, texts in (("--sensitivity", asked.sensitivities), ("--mass", asked.masses)):
        places = {one.name: i for i, one in enumerate(parameters) if one.option == option}
        for text in texts:
            name, _, told = text.partition("=")
            text = shortened(text)
            place = places.get(name.strip())
            try:
                if place is None:
                    raise InputError(
                        f"{option} {text}: there is no {shortened(name.strip())!r}, only {', '.join(places)}"
                    )
                if any(one.place == place for one in found):
                    raise InputError(f"{option} {text}: {name.strip()} is given before; give one value, the mean")
                found.append(_read(told, place, parameters[place]))
            except InputError as error:
                faults += error.faults
    if faults:
        raise InputError(*faults)
    return found


def _asked(ask: Ask, parameters: Sequence[_Parameter], belief: Belief, said: list[Measured]) -> Belief:
    """Ask for what was not given, again where an answer is none; add the measurements, return what is then known."""
    given = {one.place for one in said}
    for place, one in enumerate(parameters):
        if place in given or belief.alone[place] == 0.0:
            continue
        what = f"{'mass' if one.option == '--mass' else 'sensitivity'} of {one.name}"
        question = Question(what, one.told, float(belief.alone[place]))
        while (told := ask(question)).strip():
            try:
                measured = _read(told, place, one)
                belief = _with(belief, measured, one)
            except InputError as error:
                question = replace(question, refused=str(error))
                continue
            said.append(measured)
            break
    return belief


def _read(told: str, place: int, parameter: _Parameter) -> Measured:
    """Return the measurement that a text VALUE+-UNCERTAINTY states, in the parameter's unit or in the one it names."""
    label = f"{parameter.option} {parameter.name}={shortened(told.strip())}"
    matched = MEASURED.fullmatch(told) if len(told) <= LONGEST_NAME else None  # a long one takes the pattern minutes
    if "," in told:
        raise InputError(f"{label}: write a decimal point and no comma")
    if matched is None:
        example = f"{parameter.name}={parameter.declared:.5g}+-0.2%"
        raise InputError(f"{label}: state value and standard uncertainty in {parameter.unit}, such as {example}")
    of_value, of_error = (matched[i].replace("(", "").replace(")", "").strip() for i in (2, 4))
    in_percent = of_error == "%"
    units = {unit for unit in (of_value, "" if in_percent else of_error) if unit}
    if len(units) > 1 and not units - parameter.units.keys():
        raise InputError(f"{label}: value and uncertainty have two units; state both in one, or the uncertainty in %")
    if units - parameter.units.keys():
        raise InputError(f"{label}: the unit must be one of {', '.join(parameter.units)} (none: {parameter.unit})")
    size = parameter.units[units.pop()] if units else 1.0
    value, error = float(matched[1]) * size, float(matched[3]) * size
    if not (math.isfinite(value) and value > 0.0):
        sign = "; a sign belongs to the rig file (sign: -1)" if parameter.unit != KG else "; weigh again"
        raise InputError(f"{label}: the value must be finite and > 0 {parameter.unit}{sign}")
    relative = float(matched[3]) / 100.0 if in_percent else error / value
    if not LEAST <= relative <= FARTHEST:
        raise InputError(
            f"{label}: the standard uncertainty must be {100 * LEAST:g} to {100 * FARTHEST:g} % of the value, got "
            f"{100 * relative:.3g} %"
        )
    return Measured(place, math.log(value / parameter.base), relative)


def _with(belief: Belief, one: Measured, parameter: _Parameter) -> Belief:
    """Return what is known with one measurement more, which what is known before it permits."""
    label = f"{parameter.option} {parameter.name}"
    if belief.alone[one.place] == 0.0:
        key = "uncertainty.mass" if parameter.option == "--mass" else "sensitivity_uncertainty"
        raise InputError(f"{label}: the rig file declares it as exact ({key}: 0); state its uncertainty there")
    far = contradiction(belief, one)
    if far > CONTRADICTS:
        value, known = (parameter.base * math.exp(log) for log in (one.value, float(belief.mean[one.place])))
        where = "structure" if parameter.option == "--mass" else "rig file"
        raise InputError(
            f"{label}: {value:.5g} {parameter.unit} is {far:.3g} standard uncertainties from what is known of it, "
            f"{known:.5g}, more than {CONTRADICTS:g}; check value and unit, measure again, or correct the {where} and "
            "identify again first"
        )
    return after(belief, one)


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
    before_kg = {one.floor for one in weighed(setup.case)}
    masses = [row for row in rows if row.unit == KG and (row.measured is not None or row.name in before_kg)]
    return CalibrationSpec(
        rig=setup.case.table.name.removesuffix(VARIED),
        made_utc=datetime.now(UTC).strftime(TIME),
        by=asked.by,
        model=printable(asked.model.name) if asked.model else "",
        channels=tuple(
            CalibratedChannel(
                name=row.name, declared_v_per_unit=row.declared, sensitivity_v_per_unit=_digits(row.found, 8),
                sensitivity_uncertainty=_digits(row.alone, 4), joint_uncertainty=_digits(row.after, 4),
            )
            for row in channels
        ),
        specimen=setup.case.structure.name.removesuffix(VARIED) if masses else "",
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
    before_it = setup.case.table.calibration
    if before_it is not None and before_it.masses and not weighed(setup.case):
        notes.append(
            f"masses of {printable(before_it.specimen)} in the calibration before are left out: a calibration holds "
            "those of one structure; keep that file for it"
        )
    return [
        *notes,
        "name the file in the rig file (calibration: FILE) and identify again: the model refers to its sensors",
    ]
