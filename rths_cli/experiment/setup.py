"""`Setup`: a case with everything that is known before the table moves: ground motion, building, rig, parts that
the caller of the Python interface makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.case.compensator_schema import CompensatorSpec
from rths_cli.case.rig_capabilities import capabilities_of
from rths_cli.case.shipped_files import is_shipped
from rths_cli.control.interface import PartDesign
from rths_cli.control.storeys_with_laws import computed_storeys
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import (
    GroundMotion,
    baseline_of,
    compressed,
    prepare,
    start_fault,
    told_of,
)
from rths_cli.experiment.record_defects import defects
from rths_cli.experiment.record_scaling import scaled_to
from rths_cli.experiment.record_treatment import treated
from rths_cli.files.accelerograms import Accelerogram, read_accelerogram
from rths_cli.findings import Finding
from rths_cli.identification.sensor_calibration import calibrated
from rths_cli.interrupts import interruptible
from rths_cli.numerics.bands import ComparedBand
from rths_cli.numerics.lti import Array
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import metrics_of
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.from_case import calibration_faults, rig_info, skew_faults, true_values
from rths_cli.structure import Building, Similitude, Specimen, build, modes, similitude_of, with_masses
from rths_cli.structure.programs import laws_of_program

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.sim import Response
    from rths_cli.case.case_schema import Case
    from rths_cli.control.compensator import Compensator
    from rths_cli.control.interface import OwnParts
    from rths_cli.identification.results import Identification
    from rths_cli.loop.simulated_time_run import Outcome

NUMERICAL = "numerical"
SAME = 1e-9  # largest relative difference of a declared specimen from the case's

OwnSamples = Sequence[Path] | Callable[["Identification"], Sequence["Identification"]]
"""Samples of an identified model that the caller gives: model files, or a function that makes them from the nominal
one."""
RUNS = ("sim", "sim_delay", "shake_table", "exp_rths")
Progress = Callable[[str], None]
FAR_TOO_HEAVY = 30.0  # times the payload: a specimen in another unit, or a whole building


def made(place: str, make: Callable[[Any], Any], designed: Any) -> PartDesign:
    """Return the caller's part in place of a designed one; raises InputError for what is no design of a part."""
    design = make(designed)
    if not isinstance(design, PartDesign):
        raise InputError(
            f"parts: what was made for {place} is no design of a part ({type(design).__name__}); return a Block, a "
            "PythonSubstructure, a PythonFeedforward or an object with the same attributes"
        )
    return design


def with_own_storeys(setup: Setup) -> Setup:
    """Return the setup with the caller's numerical substructure, if there is one, and the building that it declares.

    Raises InputError for a building whose number of storeys, specimen or mass on the table are not the case's.
    """
    if NUMERICAL not in setup.parts:
        return setup
    designed = computed_storeys(setup.building, setup.rig.dt_s, setup.case.integration)
    design = made(NUMERICAL, setup.parts[NUMERICAL], designed)
    setup = replace(setup, own_numerical=design)
    declared = getattr(design, "building", None)
    if declared is None:
        return setup
    _check(design.name, declared, setup.building)
    return replace(setup, building=declared, declared=True)


def _matrices(specimen: Specimen) -> tuple[Array, Array, Array]:
    return specimen.masses_kg, specimen.C, specimen.K


def _check(name: str, declared: object, case: Building) -> None:
    """Raise InputError unless a declared building has the specimen and the number of storeys of the case's."""
    if not isinstance(declared, Building):
        raise InputError(
            f"parts: the building that {name} declares is none ({type(declared).__name__}); give a "
            "rths_cli.structure.Building"
        )
    own, wanted = ((len(each.numerical.masses_kg), len(each.specimen.masses_kg)) for each in (declared, case))
    if own != wanted:
        raise InputError(
            f"parts: the building that {name} declares has {own[0]} computed and {own[1]} experimental storeys, the "
            f"case's has {wanted[0]} and {wanted[1]}; declare a building with the case's storeys"
        )
    matrices = zip(_matrices(declared.specimen), _matrices(case.specimen), strict=True)
    if not all(np.allclose(one, other, rtol=SAME, atol=0.0) for one, other in matrices):
        raise InputError(
            f"parts: the building that {name} declares has another specimen than the case, which is what stands on the "
            "table; take the case's: rths_cli.structure.build(case.structure, case.damping).specimen"
        )
    mass, there = (each.interface_experimental_mass_kg for each in (declared, case))
    if mass != there:
        raise InputError(
            f"parts: the building that {name} declares has {mass:g} kg of the interface floor on the table, in the "
            f"case {there:g} kg stand there; declare these"
        )


@dataclass(frozen=True)
class RecordedRun:
    """The signals of a run that was made elsewhere, on the clock of the record, as long as `samples`.

    `told` belongs to the result, `figures` are metrics by path, `attributes` those of the result's root.
    """

    run: str  # its name, as a group of the result
    outcome: Outcome
    samples: int
    names: Mapping[str, str]  # of the channels by role
    ground: Array | None = None  # (n,) m/s^2, the recorded one where SIM takes that; None: the case's
    told: tuple[Finding, ...] = ()
    figures: Mapping[str, ArrayLike] = field(default_factory=dict)
    attributes: Mapping[str, str | int | float] = field(default_factory=dict)


@dataclass(frozen=True)
class Setup:
    """A case with its ground motion, building and rig, before anything moves."""

    case: Case
    motion: GroundMotion  # scaled and filtered
    record_sha256: str  # of the record's file
    building: Building
    rig: RigInfo
    floor_masses_kg: Array  # (n_exp,) weighed masses
    overrides: tuple[str, ...] = ()  # as given by --override
    parts: OwnParts = field(default_factory=dict)  # of the step, made by the caller in place of the designed ones
    samples: OwnSamples = ()  # of the identified model, the caller's
    own_numerical: PartDesign | None = None  # the caller's numerical substructure
    declared_rig: RigInfo | None = None  # with the sensors as declared, where `rig` has them as calibrated
    session_seed: int | None = None  # of the session of its table runs, of a row of a sweep that of the sweep's case
    declared: bool = False  # whether `building` is the one that it declares, and not the case's
    baseline: Finding | None = None  # of the record: what it does and what mends it; None for a clean record
    baseline_share: float = 0.0  # ground displacement that the baseline adds, over that without it
    compensator: Compensator | None = None  # of a case whose controller is one
    as_written_m_s2: Array | None = None  # (n,) the record neither changed nor filtered; None where it is not changed
    record_treatment: tuple[str, ...] = ()  # what was done to the record before it was scaled, in its order
    record_defects: tuple[Finding, ...] = ()  # of the record as it is played
    recorded: Mapping[str, RecordedRun] = field(default_factory=dict)  # runs made elsewhere, by name

    def calibrated(self, found: Identification) -> Setup:
        """Return the setup on a rig whose sensors are those that an identification found."""
        if found.calibration is None:
            return self
        declared = self.declared_rig or self.rig
        gains = [*found.calibration.further_gain, *np.ones(len(declared.further))]  # an older model knows none
        further = tuple(
            replace(one, sensitivity_v_per_unit=one.sensitivity_v_per_unit * float(gain))
            for one, gain in zip(declared.further, gains, strict=False)
        )
        rig = replace(declared, channels=calibrated(declared.channels, found.calibration), further=further)
        return replace(self, rig=rig, declared_rig=declared)

    @property
    def moves_hardware(self) -> bool:
        """Return whether a real table moves in the runs of the case; none does where they were made elsewhere."""
        return self.rig.can.moves_hardware and not self.case.recorded

    @property
    def session(self) -> int:
        """Return the seed of the session of the case's table runs: the case's own where none is stated."""
        return self.case.seed if self.session_seed is None else self.session_seed

    @property
    def knows_storeys(self) -> bool:
        """Return whether the storeys below the interface follow from ground motion and interface force."""
        return "numerical" not in self.parts or (self.declared and self.building.linear)

    @property
    def similitude(self) -> Similitude | None:
        """Return the scale of the model, prototype over model; None where the case states none."""
        return None if self.case.scale is None else similitude_of(self.case.scale)

    @property
    def compared(self) -> ComparedBand:
        """Return the band in which the table's model is compared with its data."""
        return ComparedBand(*self.case.identification.compared_hz)

    @property
    def removes_sensors(self) -> bool:
        """Return whether the step corrects the channels for the sensors' known dynamics."""
        return self.case.identification.sensor_dynamics == "removed"


def make_setup(
    case: Case,
    overrides: tuple[str, ...] = (),
    shared: SharedValues | None = None,
    parts: OwnParts | None = None,
    samples: OwnSamples = (),
    progress: Progress = lambda _: None,
) -> Setup:
    """Read the record, and prepare the building and the rig's description; raises InputError.

    With `shared`, cases with the same record or building compute it once. `progress` is told of what takes long.
    """
    faults = [*_payload_faults(case), *_accept_faults(case), *calibration_faults(case)]
    faults += unserved(case, bool(parts), bool(samples)) if case.structure.experimental.attached else []
    if faults:
        raise InputError(*(placed(case, fault) for fault in faults))
    shared = shared or SharedValues()
    case = _with_masses(case)
    motion, record_sha256, baseline, share, begins, done, wrong, written = shared.get(
        "motion", motion_key(case), lambda: interruptible(lambda: _judged_motion(case, shared))
    )
    if begins and not case.record.keeps_baseline:
        raise InputError(placed(case, begins))
    building = shared.get(
        "building", building_key(case), lambda: interruptible(lambda: build(case.structure, case.damping))
    )
    if set(case.runs) - {"sim", "sim_delay"}:
        refuse_unstable_steps(case, building)
        if building.program is not None:
            progress(f"SIM of the program: {building.program.description.name}")
            building = _at_met_tangents(case, building, motion, shared)
    masses, info = np.asarray(case.structure.experimental.masses_kg, dtype=float), rig_info(case)
    try:
        true_values(case, info)
    except InputError as error:
        raise InputError(*(placed(case, fault) for fault in error.faults)) from error
    if faults := skew_faults(case, info):
        raise InputError(*(placed(case, fault) for fault in faults))
    compensator = _compensator(case)
    setup = Setup(
        case, motion, record_sha256, building, info, masses, overrides, dict(parts or {}), samples, baseline=baseline,
        baseline_share=share, compensator=compensator, record_treatment=done, record_defects=wrong,
        as_written_m_s2=written,
    )  # fmt: skip
    return with_own_storeys(setup)


def _with_masses(case: Case) -> Case:
    """Return a case whose numerical part states its masses; of a frame they are those of its matrices."""
    try:
        structure = with_masses(case.structure)
    except InputError as error:
        raise InputError(*(placed(case, fault) for fault in error.faults)) from error
    return case if structure is case.structure else case.model_copy(update={"structure": structure})


def _at_met_tangents(case: Case, building: Building, motion: GroundMotion, shared: SharedValues) -> Building:
    """Return a building with a program that knows the tangents which its forces have in SIM, the pre-run of the check.

    Raises InputError for a rig that moves hardware.
    """
    from rths_cli.analysis.program_sim import met_tangents
    from rths_cli.analysis.references import reference_of

    if capabilities_of(case.table.kind).moves_hardware:
        raise InputError(
            placed(
                case,
                f"structure.numerical: a program runs in simulated time only, and the rig {case.table.name} moves "
                "hardware: a late answer there has not been tested; use a virtual rig, or computed storeys with laws",
            )
        )
    dt_s, asked = 1.0 / case.sample_rate_hz, (motion_key(case), building_key(case))

    def solve() -> Response:
        return reference_of(building).sim(building, dt_s, motion.accel_m_s2)

    sim = shared.get("sim", asked, lambda: interruptible(solve))
    found = met_tangents(building, sim)
    return replace(building, laws=laws_of_program(len(found), found))


def _compensator(case: Case) -> Compensator | None:
    """Return the compensator that a case states, loaded; None for FF, FF+FB and none."""
    if not isinstance(case.controller, CompensatorSpec):
        return None
    from rths_cli.control.compensator import compensator_of  # with numba, for which other cases need not wait

    try:
        return compensator_of(case.controller)
    except InputError as error:
        raise InputError(*(placed(case, fault) for fault in error.faults)) from error


def ground_motion(case: Case) -> tuple[GroundMotion, str]:
    """Return the scaled, filtered record of a case and the hash of its file; raises InputError."""
    record, _, _ = _record(case, SharedValues())
    return _prepared(case, record), record.sha256


def _judged_motion(
    case: Case, shared: SharedValues
) -> tuple[GroundMotion, str, Finding | None, float, str, tuple[str, ...], tuple[Finding, ...], Array | None]:
    """Return what `ground_motion` does, a finding on the record's baseline, None without one, with its share of the
    displacement, a sentence on a motion that begins with a step, what was done to the record, its defects, and, where
    something was, the record as it is written at the samples of the motion, scaled alike."""
    record, done, written = _record(case, shared)
    motion = _prepared(case, record)
    before = case.scaling * np.interp(
        motion.time_s, written.dt_s * np.arange(written.accel_m_s2.size), written.accel_m_s2
    )
    found = baseline_of(record, lambda accel: _prepared(case, replace(record, accel_m_s2=accel)).displacement_m)
    named = case.record
    told = told_of(found, named.name, case.record_filter.corner_hz, named.path.name) if found else None
    share = found.added_m / max(found.own_m, np.finfo(float).tiny) if found else 0.0
    return (
        motion,
        record.sha256,
        told,
        share,
        start_fault(motion, record, found, told),
        done,
        defects(record, named.name),
        before if done else None,
    )


def _record(case: Case, shared: SharedValues) -> tuple[Accelerogram, tuple[str, ...], Accelerogram]:
    """Return the record of a case, treated as the case says and compressed by its scale, what was done to it, and the
    record as it is written, compressed alike."""
    asked = case.record

    def read() -> tuple[Accelerogram, Accelerogram, tuple[str, ...]]:
        found = read_accelerogram(asked.path, asked.unit, asked.dt_s, asked.component)
        return (found, *treated(found, asked))

    written, record, done = shared.get("record", asked.model_dump_json(exclude={"scale_to"}), read)
    if asked.scale_to is not None:
        first = partial(first_period_s, case)
        scale = None if case.scale is None else case.scale.model_dump_json()
        of_building = (*building_key(case), scale)
        period_s = shared.get("first period", of_building, first) if asked.scale_to.measure == "sa_t1" else None
        record, told = scaled_to(record, asked.scale_to, period_s)
        done = (*done, told)
    if case.scale is not None:
        record, written = (compressed(each, similitude_of(case.scale)) for each in (record, written))
    return record, done, written


def first_period_s(case: Case) -> float:
    """Return the first period in s of a case's declared building, of the prototype where the case states a scale."""
    building = build(case.structure, case.damping)
    model_s = 1.0 / float(modes(building.M, building.C, building.K)[0][0])
    return model_s if case.scale is None else model_s * similitude_of(case.scale).factor("s")


def _prepared(case: Case, record: Accelerogram) -> GroundMotion:
    """Return the ground motion of a record in the model's time; raises InputError."""
    corner_hz, order = case.record_filter.corner_hz, case.record_filter.order
    try:
        return prepare(record, case.scaling, case.sample_rate_hz, corner_hz, order)
    except InputError as error:
        if case.scale is None:
            raise
        scale = similitude_of(case.scale)
        told = f"(scale compresses the record in time by {scale.factor('s'):.4g})"
        raise InputError(*(f"{fault} {told}" for fault in error.faults)) from error


def motion_key(case: Case) -> tuple[object, ...]:
    """Return the key of a case's ground motion for SharedValues: everything that it depends on."""
    sampling = (case.scaling, case.sample_rate_hz)
    # of the scale, what the record is compressed by: mass and stress change no motion
    scale = None if case.scale is None else (case.scale.length, case.scale.acceleration)
    asked = case.record.scale_to
    building = building_key(case) if asked is not None and asked.measure == "sa_t1" else ()
    return (case.record.model_dump_json(), case.record_filter.model_dump_json(), *sampling, scale, *building)


def building_key(case: Case) -> tuple[str, str]:
    """Return the key of a case's building for SharedValues: everything that it depends on."""
    return case.structure.model_dump_json(), case.damping.model_dump_json()


def refuse_unstable_steps(case: Case, building: Building) -> None:
    """Raise InputError where the loop cannot integrate the computed storeys at the case's rate; SIM may know them."""
    try:
        computed_storeys(building, 1.0 / case.sample_rate_hz, case.integration)
    except InputError as error:
        raise InputError(*(placed(case, fault) for fault in error.faults)) from error


def make_setups(
    cases: Sequence[Case],
    overrides: tuple[str, ...] = (),
    shared: SharedValues | None = None,
    parts: OwnParts | None = None,
    samples: OwnSamples = (),
    progress: Progress = lambda _: None,
) -> list[Setup]:
    """Read and check all cases completely before the first one starts; raises InputError with all faults.

    Cases with the same record or building compute it once; with `shared`, also across several calls.
    """
    shared = shared or SharedValues()
    setups, faults = [], []
    for case in cases:
        try:
            setups.append(make_setup(case, overrides, shared, parts, samples, progress))
        except InputError as error:
            faults += [fault if _named(case, fault) else placed(case, fault) for fault in error.faults]
    if faults:
        raise InputError(*faults)
    return setups


def placed(case: Case, fault: str) -> str:
    """Return a sentence with the case's file before it, and with the place of the key by which the sentence begins."""
    return f"{place_of(case, fault.partition(': ')[0])}: {fault}"


def place_of(case: Case, key: str) -> str:
    """Return file and place of a key of a case, or of what it stands in."""
    keys = key.split(".")
    paths = (".".join(keys[:count]) for count in range(len(keys), 0, -1))
    return str(next((case.places[path] for path in paths if path in case.places), shown(case.path)))


def _named(case: Case, fault: str) -> bool:
    """Return whether a sentence names the case's file, or the place of one of its keys, already."""
    labels = {mark.source.label for mark in case.places.values()}
    return str(case.path) in fault or fault.startswith(tuple(f"{label}:" for label in (shown(case.path), *labels)))


def _payload_faults(case: Case) -> list[str]:
    """Return a sentence if the specimen is heavier than the table's data sheet permits."""
    weight = sum(case.structure.experimental.masses_kg) + case.structure.interface_experimental_mass_kg
    payload = case.table.nominal.payload_kg
    if weight <= payload:
        return []
    doubted = weight > FAR_TOO_HEAVY * payload
    advice = "are masses_kg those of the model on the table, in kg?" if doubted else "put fewer storeys on the table"
    return [
        f"structure: the specimen weighs {weight:g} kg, rig {case.table.name} carries at most "
        f"{payload:g} kg (nominal.payload_kg); {advice}"
    ]


def unserved(case: Case, parts: bool = False, samples: bool = False) -> list[str]:
    """Return a sentence for each thing that a case asks for and that a test with an actuator does not have yet."""
    controller, runs = case.controller, [run for run in case.runs if run not in ("sim", "exp_rths")]
    asked = {
        "method: paper is the control of a table": case.method == "paper",
        "controller: FF+FB tracks an acceleration; use FF, none, or a compensator such as pi_lead": (
            controller.kind == "FF+FB"
        ),
        "controller.reaction_feedforward: counters what a specimen does to a table": (
            getattr(controller, "reaction_feedforward", None) is True
        ),
        "controller.friction_compensation: counters the friction of a table": (
            getattr(controller, "friction_compensation", None) is True
        ),
        f"runs: {' and '.join(runs)} are of a table; remove them, sim and exp_rths are left": bool(runs),
        "session_record: compares the accelerometers of a table": case.session_record == "always",
        "identification.excitation: an actuator is excited by a multisine": (
            "identification.excitation" in case.stated and case.identification.excitation != "multisine"
        ),
        "shear_from: the force is the load cell's": "shear_from" in case.stated,
        "check.specimen_range: is judged on a table only": case.check is not None,
        "scale: a model of a prototype stands on a table": case.scale is not None,
        "parts: of the caller's own stand in tests on a table only": parts,
        "samples: of an identified model are judged on a table only": samples,
        f"{next(iter(case.recorded), '')}: recordings of tests on a table only are judged": bool(case.recorded),
    }
    return [told for told, is_asked in asked.items() if is_asked]


def _accept_faults(case: Case) -> list[str]:
    """Return a sentence for each limit in `accept` whose metric does not exist, or whose index does not fit it."""
    known, faults = metrics_of(*RUNS, "check"), []
    for path in case.accept:
        name, _, index = path.partition("[")
        if name.split(".")[0] not in (*RUNS, "check"):
            continue
        if name not in known:
            near = get_close_matches(name, known, 1)
            advice = f"did you mean {near[0]}?" if near else "rths report --json lists the metrics of a result"
            faults.append(f"accept: there is no metric {name}; {advice}")
        elif index and not known[name].over:
            faults.append(f"accept: {name} is one number, not one per storey; drop [{index}")
    return faults


def shown(path: Path) -> str:
    """Return a path as a user would type it here: of a shipped file elsewhere, its name."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return path.stem if is_shipped(path) else str(path)
