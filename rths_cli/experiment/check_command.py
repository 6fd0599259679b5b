"""What `rths check` does, and `rths run` before EXP-RTHS: load cases, get a model, design, check; `Verdict` and
`Checked`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rths_cli.analysis.stability_check import SAFE, UNSAFE, UNSTABLE
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment import result_contents
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.check import judge
from rths_cli.experiment.check_metrics import check_figures
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.setup import make_setups, shown
from rths_cli.interrupts import interruptible

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.analysis.predicted_error import Known as LoopKnown
    from rths_cli.case.case_schema import Case
    from rths_cli.experiment.design import Design
    from rths_cli.experiment.model_choice import Known
    from rths_cli.experiment.setup import Progress, Setup
    from rths_cli.numerics.shared_values import SharedValues
    from rths_cli.quantities import Values


@dataclass(frozen=True)
class Verdict:
    """Whether EXP-RTHS may be run, why not, the blocks it would run with (None: there are none), the figures, and what
    an error budget starts from (None: the loop is unstable, or there is none)."""

    verdict: str
    reasons: tuple[str, ...]
    design: Design | None
    figures: dict[str, ArrayLike]
    loop: LoopKnown | None = None

    @property
    def refused(self) -> bool:
        """Tell whether there is a hybrid test and it is not safe."""
        return self.verdict in (UNSAFE, UNSTABLE)


@dataclass(frozen=True)
class Tested:
    """What a check is about: the case as a reader knows it, the model used and where it comes from."""

    case: str
    file: str
    structure: str
    damping: str
    record: str
    scaling: float
    controller: str
    method: str
    rig: str
    rig_kind: str
    sample_rate_hz: float
    delay_s: float
    model: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Checked:
    """The verdict on a case, why it is not safe, what a reader should know beside, and the figures by path."""

    about: Tested
    verdict: str
    reasons: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    metrics: Values = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """Return 0 for a safe case, else 1."""
        return 0 if self.verdict == SAFE else 1


def verdict_on(
    setup: Setup, known: Known, hybrid: bool = True, design: Design | None = None, shared: SharedValues | None = None
) -> Verdict:
    """Return the verdict on a case's hybrid test from what is known of its rig and specimen; "" when `hybrid` says that
    there is none, unless no blocks can be designed. `design`: the blocks, where another record had them designed; with
    `shared`, cases share what they have in common. That no controller can be designed for a rejected model, or its
    building not be solved, follows from why it was rejected, and is not said beside it."""
    faults = known.faults(setup.overrides)
    try:
        design = design or interruptible(lambda: design_blocks(setup, known.found, shared))
    except InputError as error:
        return Verdict(UNSAFE, faults or error.faults, None, {})
    if not hybrid:
        return Verdict("", faults, design, {})
    chosen = design
    try:
        judged = interruptible(lambda: judge(setup, known.found, chosen, shared))
    except InputError as error:
        return Verdict(UNSAFE, faults or error.faults, design, {})
    found = judged.preflight
    verdict = UNSAFE if faults and found.verdict == SAFE else found.verdict
    return Verdict(verdict, (*faults, *found.reasons), design, check_figures(judged), judged.known)


def load_all(paths: Sequence[str], settings: Sequence[str], methods: Sequence[str]) -> list[Case]:
    """Return the cases, once for each method (none: their own); raises InputError with all faults."""
    cases: list[Case] = []
    for method in methods or ("",):
        chosen = (f"method={method}",) if method else ()
        cases += load_cases(paths, (*settings, *chosen))
    return cases


def check_cases(
    cases: Sequence[Case], overrides: tuple[str, ...], progress: Progress, memory: Memory | None = None
) -> list[Checked]:
    """Return the verdict on each case; all are read before the first is judged. Raises InputError with all faults."""
    memory = memory or Memory(Cache())
    setups = make_setups(cases, overrides)
    for setup in setups:
        memory.prepare(setup)
    return [check_case(setup, memory, progress) for setup in setups]


def check_case(setup: Setup, memory: Memory, progress: Progress) -> Checked:
    """Return the verdict on one case; a virtual rig that cannot be identified makes it unsafe."""
    progress(f"check of {setup.case.name}")
    try:
        known = memory.at_rest(setup, progress)
    except (RigError, LimitError) as error:
        return Checked(_about(setup, "none"), UNSAFE, (str(error),))
    found = verdict_on(setup, known)
    figures = (
        {} if found.design is None else result_contents.design_figures(setup, known.found, found.design) | found.figures
    )
    told = () if "model" in setup.overrides else known.found.reasons
    notes = tuple(note for note in of_case(setup, known.found, found.design) if note not in told)
    return Checked(_about(setup, known.source), found.verdict, found.reasons, notes, figures)


def _about(setup: Setup, model: str) -> Tested:
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
    )
