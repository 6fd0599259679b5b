"""The check of cases by `rths check`, and by `rths run` before EXP-RTHS: load, get a model, design, judge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.closed_loop_matrix import open_loop
from rths_cli.analysis.stability_check import SAFE, UNSAFE, UNSTABLE
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment import result_contents
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check_metrics import check_figures
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.design_choice import choose_design
from rths_cli.experiment.loop_stability_of_case import loop_parts
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import make_setups, refuse_unstable_steps, shown
from rths_cli.experiment.unit_plausibility import before_error, keys_in_doubt, unit_doubts
from rths_cli.interrupts import interruptible
from rths_cli.numerics.bands import COMPARED_HZ, TEST_BAND_HZ
from rths_cli.numerics.shared_values import SharedValues

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.predicted_error import Known as LoopKnown
    from rths_cli.analysis.true_error import TrueError
    from rths_cli.case.case_schema import Case
    from rths_cli.control.part_designs import OwnParts
    from rths_cli.experiment.check import Judged
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_choice import Known
    from rths_cli.experiment.setup import OwnSamples, Progress, Setup
    from rths_cli.experiment.simulated_test import Replayed
    from rths_cli.numerics.lti import Block
    from rths_cli.quantities import Values


@dataclass(frozen=True)
class Verdict:
    """The verdict on EXP-RTHS, with the design that was judged."""

    verdict: str  # SAFE, UNSAFE or UNSTABLE; "" if the case has no hybrid test
    reasons: tuple[str, ...]  # why it is not safe, one sentence each
    design: Design | None  # None: no blocks can be designed
    figures: dict[str, ArrayLike]  # metrics `check.*` by path
    loop: LoopKnown | None = None  # inputs of the error budget; None: the loop is unstable or was not judged
    replay: Callable[[], Replayed] | None = None  # the test of storeys with laws for the budget; None: it has none
    tangents: tuple[str, ...] = ()  # what the metrics check.tangent_* are of, in words
    said: str = ""  # a sentence on the true error; "" where nothing is uncertain
    advice: str = ""  # a sentence on the measurement that would lower its bound; "" without one
    true_error: TrueError | None = None  # its distribution; None: sensors and masses are exactly as declared

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
    verdict: str  # SAFE, UNSAFE or UNSTABLE
    reasons: tuple[str, ...]  # why it is not safe, one sentence each
    warnings: tuple[str, ...] = ()  # further sentences, which do not change the verdict
    metrics: Values = field(default_factory=dict)  # by path
    tangents: tuple[str, ...] = ()  # what the metrics check.tangent_* are of, in words
    doubted: tuple[str, ...] = ()  # keys whose numbers seem to be in another unit; the verdict holds if they are right

    @property
    def exit_code(self) -> int:
        """Return 0 for a safe case, else 1."""
        return 0 if self.verdict == SAFE else 1


def verdict_on(
    setup: Setup, known: Known, hybrid: bool = True, design: Design | None = None, shared: SharedValues | None = None
) -> Verdict:
    """Return the verdict on a case's hybrid test, from the identification `known` of its rig and specimen.

    If `hybrid` is False, there is no hybrid test: the verdict is "", or UNSAFE if no blocks can be designed. `design`:
    blocks that were designed already, for example for another record; None: they are designed here. With `shared`,
    cases compute common results once. If the model is rejected and, for that reason, no controller can be designed or
    the building cannot be solved, only the reasons of the rejection are returned. Doubts on units precede the reasons.
    """
    found = _judged(setup, known, hybrid, design, shared)
    return replace(found, reasons=(*unit_doubts(setup), *found.reasons)) if found.reasons else found


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
    found = judged.preflight
    verdict = UNSAFE if faults and found.verdict == SAFE else found.verdict
    tangents = tuple(one.name for one in judged.tangents)
    said, advice = _on_true_error(setup, judged)
    reasons, figures = (*faults, *found.reasons), check_figures(judged)
    return Verdict(
        verdict, reasons, design, figures, judged.known, judged.replay, tangents, said, advice, judged.true_error
    )  # fmt: skip


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
    found = verdict_on(setup, known)
    figures = (
        {} if found.design is None else result_contents.design_figures(setup, known.found, found.design) | found.figures
    )
    told = () if "model" in setup.overrides else known.found.reasons
    notes = tuple(note for note in of_case(setup, known.found, found.design) if note not in told)
    notes = (*filter(None, (found.said, found.advice)), *notes)
    about, doubted = _about(setup, known.source), keys_in_doubt(setup)
    return Checked(about, found.verdict, found.reasons, notes, figures, found.tangents, doubted)


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
