"""The check of cases by `rths check`, and by `rths run` before EXP-RTHS: load, get a model, design, judge."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.closed_loop_matrix import open_loop
from rths_cli.analysis.stability_check import DISPLACEMENT, SAFE, UNSAFE, UNSTABLE, VERDICTS, Fault
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment import result_contents
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check_metrics import check_figures, table_test_figures
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.design_choice import choose_design
from rths_cli.experiment.loop_stability_of_case import loop_parts
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.one_table_run import TABLE_RUNS, drive_of
from rths_cli.experiment.planned_motion import guard_figures, guard_sentences, planned_motion
from rths_cli.experiment.session import wants_session_record
from rths_cli.experiment.setup import make_setups, placed, refuse_unstable_steps, shown
from rths_cli.experiment.table_test_check import judge_table_test
from rths_cli.experiment.unit_plausibility import before_error, keys_in_doubt, unit_doubts
from rths_cli.interrupts import interruptible
from rths_cli.numerics.bands import COMPARED_HZ, TEST_BAND_HZ
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.predicted_error import PredictionInputs
    from rths_cli.analysis.stability_check import Preflight
    from rths_cli.analysis.true_error import TrueError
    from rths_cli.case.case_schema import Case
    from rths_cli.control.part_designs import OwnParts
    from rths_cli.experiment.check import Judged, Uncertain
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_choice import Known
    from rths_cli.experiment.one_table_run import RunKind
    from rths_cli.experiment.planned_motion import PlannedMotion
    from rths_cli.experiment.setup import OwnSamples, Progress, Setup
    from rths_cli.experiment.simulated_test import Replayed
    from rths_cli.numerics.lti import Block
    from rths_cli.quantities import Values

MOVED_BY_BASELINE = (DISPLACEMENT, "velocity", "command")  # reaches that an offset or a drift of the record makes


@dataclass(frozen=True)
class Verdict:
    """The verdict on EXP-RTHS, with the design that was judged."""

    verdict: str  # SAFE, UNSAFE or UNSTABLE; "" if the case has no hybrid test
    reasons: tuple[str, ...]  # why it is not safe, one sentence each
    design: Design | None  # None: no blocks can be designed
    figures: dict[str, ArrayLike]  # metrics `check.*` by path
    loop: PredictionInputs | None = None  # inputs of the error budget; None: the loop is unstable or was not judged
    replay: Callable[[], Replayed] | None = None  # the test of storeys with laws for the budget; None: it has none
    tangents: tuple[str, ...] = ()  # what the metrics check.tangent_* are of, in words
    said: str = ""  # a sentence on the true error; "" where nothing is uncertain
    advice: str = ""  # a sentence on the measurement that would lower its bound; "" without one
    true_error: TrueError | None = None  # its distribution; None: sensors and masses are exactly as declared
    uncertain: Uncertain | None = None  # for that distribution after the run; None: the loop is unstable, not judged
    # what each run on the table needs, by its name; no entry where nothing is known of it
    planned: Mapping[str, PlannedMotion] = field(default_factory=dict)
    of_guard: tuple[str, ...] = ()  # sentences on the guard's limits in these runs
    table_test: Preflight | None = None  # the check of the shake-table test; None: there is none, or no design

    @property
    def worst(self) -> str:
        """Return the worst verdict of all table runs; "" without one."""
        told = (self.verdict, self.table_test.verdict if self.table_test else "")
        return max(told, key=("", *VERDICTS).index)

    def of_run(self, run: str) -> tuple[str, tuple[str, ...]]:
        """Return verdict and reasons of one table run by its name, shake_table or exp_rths."""
        if run == "shake_table" and self.table_test is not None:
            return self.table_test.verdict, self.table_test.reasons
        return self.verdict, self.reasons

    def refuses(self, run: str) -> bool:
        """Return whether a table run is not safe."""
        return self.of_run(run)[0] in (UNSAFE, UNSTABLE)

    @property
    def remarks(self) -> dict[str, str]:
        """Return remarks on the metrics by path: what each tangent is."""
        named = "; ".join(f"{number}: {name}" for number, name in enumerate(self.tangents, 1))
        return {path: named for path in self.figures if path.startswith("check.tangent_")}

    @property
    def refused(self) -> bool:
        """Return whether there is a hybrid test and it is not safe."""
        return self.verdict in (UNSAFE, UNSTABLE)


@dataclass(frozen=True)
class Tested:
    """Description of a checked case, for the page and the document."""

    case: str  # name
    file: str  # path as a user would type it
    structure: str  # name
    damping: str  # name
    record: str  # name
    scaling: float  # factor on the record
    controller: str  # kind: none, FF or FF+FB
    method: str  # paper or best
    rig: str  # name
    rig_kind: str  # kind of the rig
    sample_rate_hz: float
    delay_s: float  # of the base shear in SIM-DELAY
    model: str  # source of the identified model, in words
    overrides: tuple[str, ...] = ()  # as given by --override
    test_band_hz: float = TEST_BAND_HZ
    compared_hz: tuple[float, float] = COMPARED_HZ  # band in which the table's model is compared with its data
    scale: dict[str, float] | None = None  # factors by quantity, prototype over model; None: the case states none
    record_s: float = 0.0  # length of the record in the laboratory
    calibration: str = ""  # day and person of the rig's calibration file; "": it has none


@dataclass(frozen=True)
class Checked:
    """The result of the check of one case."""

    about: Tested
    verdict: str  # SAFE, UNSAFE or UNSTABLE: the worst of all table runs
    reasons: tuple[str, ...]  # why it is not safe, one sentence each
    warnings: tuple[str, ...] = ()  # further sentences, which do not change the verdict
    metrics: Values = field(default_factory=dict)  # by path
    tangents: tuple[str, ...] = ()  # what the metrics check.tangent_* are of, in words
    of_guard: tuple[str, ...] = ()  # sentences on the guard's limits
    runs: tuple[tuple[str, str], ...] = ()  # label and verdict of each table run
    doubted: tuple[str, ...] = ()  # keys whose numbers seem to be in another unit; the verdict holds if they are right

    @property
    def exit_code(self) -> int:
        """Return 0 for a safe case, else 1."""
        return 0 if self.verdict == SAFE else 1


def verdict_on(
    setup: Setup, known: Known, hybrid: bool = True, design: Design | None = None, shared: SharedValues | None = None,
    table_test: bool = True,
) -> Verdict:  # fmt: skip
    """Return the verdict on a case's table runs, from the identification `known` of its rig and specimen.

    If `hybrid` is False, there is no hybrid test: the verdict is "", or UNSAFE if no blocks can be designed. `design`:
    blocks that were designed already, for example for another record; None: they are designed here. With `shared`,
    cases compute common results once. If the model is rejected and, for that reason, no controller can be designed or
    the building cannot be solved, only the reasons of the rejection are returned. The shake-table test of a case that
    has one is judged with the same design unless `table_test` is False. Doubts on units precede the reasons.
    """
    found = _with_plans(setup, known, _judged(setup, known, hybrid, design, shared))
    if found.design is not None and table_test and "shake_table" in setup.case.runs:
        blocks = found.design
        of_table = interruptible(lambda: judge_table_test(setup, known.found, blocks, shared))
        of_table = _without_innocent_limits(setup, of_table)
        if faults := known.faults(setup.overrides):
            worse = UNSAFE if of_table.verdict == SAFE else of_table.verdict
            unfit = tuple(Fault("model", fault, math.nan) for fault in faults)
            of_table = replace(of_table, verdict=worse, faults=(*unfit, *of_table.faults))
        figures = {f"check.shake_table_{name}": value for name, value in table_test_figures(of_table).items()}
        found = replace(found, table_test=of_table, figures=found.figures | figures)
    return replace(found, reasons=(*unit_doubts(setup), *found.reasons)) if found.reasons else found


def _with_plans(setup: Setup, known: Known, found: Verdict) -> Verdict:
    """Return a verdict with what each run of the case needs of the table, and with the limits of its guard."""
    if found.design is None:
        return found
    planned: dict[str, PlannedMotion] = {}
    said: list[str] = []
    figures = dict(found.figures)
    for kind in TABLE_RUNS:
        if kind.name not in setup.case.runs:
            continue
        one = _plan(setup, known, found.design, kind)
        if one is not None:
            planned[kind.name] = one
        figures |= guard_figures(setup, kind.name, one)
        said += guard_sentences(setup, kind.label, one)
    return replace(found, planned=planned, figures=figures, of_guard=tuple(said))


def _plan(setup: Setup, known: Known, design: Design, kind: RunKind) -> PlannedMotion | None:
    try:
        drive = drive_of(setup, design)
        return interruptible(lambda: planned_motion(setup, known.found, design, drive, kind.source))
    except InputError:  # no model of the rig, or a building that has no SIM: the verdict says so
        return None


def _judged(setup: Setup, known: Known, hybrid: bool, design: Design | None, shared: SharedValues | None) -> Verdict:
    """Return the verdict without doubts on units."""
    faults, shared = known.faults(setup.overrides), shared or SharedValues()
    try:
        design = design or interruptible(lambda: design_blocks(setup, known.found, shared))
    except InputError as error:
        return Verdict(UNSAFE, faults or error.faults, None, {})
    designed = design
    if not hybrid:
        return Verdict("", faults, designed.without_reaction(), {})
    try:
        design, judged = interruptible(lambda: choose_design(setup, known.found, designed, shared))
    except InputError as error:
        return Verdict(UNSAFE, faults or error.faults, designed.without_reaction(), {})
    found = _without_innocent_limits(setup, judged.preflight)
    verdict = UNSAFE if faults and found.verdict == SAFE else found.verdict
    tangents = tuple(one.name for one in judged.tangents)
    said, advice = _on_true_error(setup, judged)
    reasons, figures = (*faults, *found.reasons), check_figures(judged)
    return Verdict(
        verdict, reasons, design, figures, judged.known, judged.replay, tangents, said, advice, judged.true_error,
        judged.uncertain,
    )  # fmt: skip


def _without_innocent_limits(setup: Setup, found: Preflight) -> Preflight:
    """Return a check whose reasons tell limits that the record's baseline exceeds as what it does, and not as too small
    a table."""
    exceeded = [fault for fault in found.faults if fault.cause in MOVED_BY_BASELINE]
    if not setup.baseline or not exceeded:
        return found
    if any(fault.beyond > 1.0 + setup.baseline_share for fault in exceeded):  # without the baseline, too
        return replace(found, faults=(Fault("baseline", placed(setup.case, setup.baseline), math.nan), *found.faults))
    names = " and ".join(dict.fromkeys(fault.cause for fault in exceeded))
    told = f"with this baseline the record exceeds the limit of {names}; check again without it"
    moved = (Fault("baseline", text, math.nan) for text in (placed(setup.case, setup.baseline), told))
    others = (fault for fault in found.faults if fault.cause not in MOVED_BY_BASELINE)
    return replace(found, faults=(*moved, *others))


def _on_true_error(setup: Setup, judged: Judged) -> tuple[str, str]:
    """Return a sentence on the true error at the worst storey, and one on the measurement that would lower its bound
    most, "" where there is none.

    Errors are given in percent of SIM-DELAY's, or of SIM's where that diverges.
    """
    uncertain, remedy = judged.true_error, judged.remedy
    if uncertain is None:
        return "", ""
    scale, of_what = judged.sim_delay_rms_m_s2, "SIM-DELAY's error"
    if scale is None or not np.all(scale > 0.0):
        scale, of_what = judged.sim_rms_m_s2, "SIM's RMS"
    worst = int(np.argmax(uncertain.bound / scale))
    share = 100.0 / float(scale[worst])
    told = (
        f"true error: with 95 % below {share * uncertain.bound[worst]:.2g} % of {of_what} (storey {worst + 1}), below "
        f"{share * uncertain.median[worst]:.2g} % with 50 %, {share * uncertain.calibration[worst]:.2g} % by sensors "
        "and masses as far as the identification did not calibrate them"
    )
    if uncertain.pitch is not None:
        told += f", {share * uncertain.pitch[worst]:.2g} % by pitch of the specimen's base"
    if remedy is None:
        return told, ""
    channels, error = setup.rig.channels, f"{100.0 * remedy.error:.2g}"
    if remedy.parameter < len(channels):
        name = channels[remedy.parameter].name
        what, option = f"a comparison of the sensor of {name}", f"--sensitivity {name}=VALUE"
    else:
        name = channels[1 + remedy.parameter - 3 * len(channels)].name
        what, option = f"weighing {name}", f"--mass {name}=KG"
    return told, (
        f"{what} to {error} % would lower the bound of the true error from "
        f"{share * uncertain.bound[worst]:.2g} to {share * remedy.bound[worst]:.2g} % of {of_what} "
        f"(storey {worst + 1}): rths calibrate {shown(setup.case.path)} {option}+-{error}% --output FILE takes it"
    )


def check_cases(
    cases: Sequence[Case],
    overrides: tuple[str, ...],
    progress: Progress,
    memory: Memory | None = None,
    parts: OwnParts | None = None,
    samples: OwnSamples = (),
) -> list[Checked]:
    """Return the verdict on each case; all cases and model files are read before the first one is judged.

    `memory`: identifications to use; None: a new memory with the cache of virtual rigs. Raises InputError with all
    faults of the cases.
    """
    memory = memory or Memory(Cache())
    setups = make_setups(cases, overrides, parts=parts, samples=samples)
    for setup in setups:
        refuse_unstable_steps(setup.case, setup.building)
    for setup in setups:
        memory.prepare(setup)
    return [check_case(setup, memory, progress) for setup in setups]


def loop_of(case: Case, progress: Progress) -> Block:
    """Return the open loop of a case's hybrid test, from the identified rig and the designed blocks.

    Raises InputError for a case that cannot be read, and where no blocks can be designed; RigError or LimitError if
    its virtual rig cannot be identified.
    """
    memory, setup = Memory(Cache()), make_setups([case], ())[0]
    known = memory.at_rest(setup, progress)
    design = interruptible(lambda: choose_design(setup, known.found, design_blocks(setup, known.found))[0])
    return open_loop(loop_parts(setup, known.found)[0], design.blocks)


def check_case(setup: Setup, memory: Memory, progress: Progress) -> Checked:
    """Return the verdict on one case; the case is unsafe if its virtual rig cannot be identified."""
    progress(f"check of {setup.case.name}")
    try:
        known = memory.at_rest(setup, progress)
    except (RigError, LimitError) as error:
        doubts = unit_doubts(setup)
        return Checked(_about(setup, "none"), UNSAFE, before_error(setup, error), doubts, doubted=keys_in_doubt(setup))
    hybrid = "exp_rths" in setup.case.runs or "shake_table" not in setup.case.runs
    found = verdict_on(setup, known, hybrid)
    figures = (
        {} if found.design is None else result_contents.design_figures(setup, known.found, found.design) | found.figures
    )
    told = () if "model" in setup.overrides else known.found.reasons
    notes = tuple(note for note in of_case(setup, known.found, found.design) if note not in told)
    notes = (*filter(None, (found.said, found.advice)), *notes)
    runs = [("EXP-RTHS", found.verdict)] if hybrid else []
    excited = excitations(setup, known)
    reasons = (*found.reasons, *(f"{label}: {fault}" for label, faults in excited for fault in faults))
    if found.table_test is not None:
        told = tuple(reason for reason in found.table_test.reasons if reason not in reasons)
        reasons = (*reasons, *(f"shake-table test: {reason}" for reason in told))
        runs.insert(0, ("shake-table test", found.table_test.verdict))
    runs = [*((label, UNSAFE if faults else SAFE) for label, faults in excited), *runs]
    worst = max((found.worst, *(verdict for _, verdict in runs)), key=("", *VERDICTS).index)
    return Checked(
        _about(setup, known.source), worst, reasons, notes, figures, found.tangents, found.of_guard, tuple(runs),
        keys_in_doubt(setup),
    )  # fmt: skip


def excitations(setup: Setup, known: Known) -> list[tuple[str, tuple[str, ...]]]:
    """Return label and faults of the excitations that are played before the table runs of a case; () if it is safe."""
    from rths_cli.experiment.excitation_check import excitation_faults
    from rths_cli.experiment.excitation_plan import excitation_settings, plan
    from rths_cli.identification.low_level_probe import probe_plan

    settings = excitation_settings(setup.case.identification)
    found = []
    if setup.case.identification.model is None:
        found.append(("identification", plan(setup).command_v))
    if setup.case.identification.model is not None or wants_session_record(setup):
        most_m_s2 = known.found.low_level_m_s2 or math.inf
        low = probe_plan(setup.rig, settings, setup.case.identification.seed, most_m_s2)
        found.append(("verification" if setup.case.identification.model else "record of the session", low.command_v))
    return [(label, excitation_faults(setup, command_v)) for label, command_v in found]


def _about(setup: Setup, model: str) -> Tested:
    """Return the description of a case; `model`: source of the identified model, in words."""
    case = setup.case
    return Tested(
        case=case.name,
        file=shown(case.path),
        structure=case.structure.name,
        damping=case.damping.name,
        record=case.record.name,
        scaling=case.scaling,
        controller=case.controller.kind,
        method=case.method,
        rig=setup.rig.name,
        rig_kind=setup.rig.kind,
        sample_rate_hz=case.sample_rate_hz,
        delay_s=case.delay_s,
        model=model,
        overrides=setup.overrides,
        test_band_hz=case.test_band_hz,
        compared_hz=setup.compared.hz,
        record_s=float(setup.motion.time_s[-1]),
        calibration="" if case.table.calibration is None else case.table.calibration.told,
        scale=None if setup.similitude is None else setup.similitude.factors,
    )
