"""The Python interface: what the commands do, for scripts. Import it as `import rths_cli`."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rths_cli.api.results import CheckResult, Group, ModelResult, RunResult
from rths_cli.errors import InputError, LimitError, RigError, RthsError
from rths_cli.findings import as_data
from rths_cli.numerics.compiler_messages import announce
from rths_cli.quantities import METRICS, intervals_of
from rths_cli.quantities.datasets import KEPT_SERIES
from rths_cli.rigs.description import capabilities_of

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from rths_cli.case.case_schema import Case
    from rths_cli.control.interface import OwnParts
    from rths_cli.control.python_control import System
    from rths_cli.experiment.run_case import Ended
    from rths_cli.experiment.setup import OwnSamples, Setup
    from rths_cli.identification.results import Identification
    from rths_cli.loop.live_view import View
    from rths_cli.numerics.lti import Block, Frf, StateSpace

Settings = Mapping[str, object]
CaseGiven = str | Path | Mapping[str, Any]
Progress = Callable[[str], object]
Method = Literal["paper", "best"]
KeptSeries = Literal["all", "essential", "none"]
Samples = Sequence[str | Path] | Callable[["Identification"], Sequence["Identification"]]
BY_CODE = {3: LimitError, 4: RigError}


def load(path: str | Path) -> RunResult:
    """Return the result of a run; its arrays are read when they are asked for.

    Raises InputError unless the file is a whole result file.
    """
    return RunResult(Path(path))


def resolve(case: CaseGiven, *, settings: Settings | None = None) -> Case:
    """Return a case, checked, with all its defaults; printed it is one screen.

    Raises InputError, with a sentence per fault, when it cannot be read.
    """
    from rths_cli.case.load import load_all

    return load_all([_given(case)], _texts(settings, None), ())[0]


def run(
    case: CaseGiven,
    *,
    method: Method | None = None,
    settings: Settings | None = None,
    output: str | Path | None = None,
    overrides: Sequence[str] = (),
    fresh: bool = False,
    yes: bool = False,
    parts: OwnParts | None = None,
    samples: Samples = (),
    series: KeptSeries = "all",
    replace: bool = True,
    progress: Progress | None = None,
) -> RunResult:
    """Run a case as `rths run` does and return its result, also one that was refused or stopped: see its `status`.

    `case` is a case file, the name of a shipped one, or a mapping with the keys of a case (names and files are looked
    up from the present folder); `method` None: the case's own; `settings` as `--set`, for
    instance {"scaling": 0.2, "table.physics.coulomb_n": 0}. `output` is the folder of the result file, where a virtual
    result of that name is replaced; None: a temporary one that lives as long as the result. `yes` moves a real rig
    whose file says `unattended: true`; nothing else moves a real rig. `parts`: functions that make a part of the step
    from the designed one, by its place: numerical, feedforward or feedback (docs/reference/parts.md). `samples`:
    further, equally likely identifications, on which the check judges the design too: model files of this rig and
    specimen, or a function that makes them from the nominal one. `series`: those that the file keeps, "all",
    "essential" or "none", as `--series`. `replace` False: a result that exists is refused, as `--no-replace` does.

    Raises InputError when the case cannot be run, RigError, LimitError or RthsError when there is no result.
    """
    given = _texts(settings, method)
    _check_rig(_given(case), given, output is None)
    if series not in KEPT_SERIES:
        raise InputError(f"series is {series!r}; it must be one of {', '.join(KEPT_SERIES)}")
    folder = Path(tempfile.mkdtemp(prefix="rths-")) if output is None else Path(output)
    try:
        with _signals() as poll:
            tell = _telling(progress, poll)
            ended = _run(
                _given(case),
                given,
                folder,
                tuple(overrides),
                fresh,
                yes,
                tell,
                _places(parts),
                _files(samples),
                series,
                replace,
            )
        if ended.path is None:
            raise BY_CODE.get(ended.exit_code, RthsError)(ended.reason)
        result = RunResult(ended.path)
    except BaseException:
        if output is None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    if output is None:
        weakref.finalize(result, shutil.rmtree, folder, ignore_errors=True)
    return result


def check(
    case: CaseGiven,
    *,
    method: Method | None = None,
    settings: Settings | None = None,
    overrides: Sequence[str] = (),
    parts: OwnParts | None = None,
    samples: Samples = (),
    progress: Progress | None = None,
) -> CheckResult:
    """Judge a case as `rths check` does: whether EXP-RTHS is safe, and the figures predicted; nothing moves.

    `parts` and `samples` as in `run`: with samples, safe means safe with each, and figures that differ between them
    carry an interval.

    Raises InputError when the case cannot be read.
    """
    from rths_cli.case.load import load_all
    from rths_cli.experiment.check_command import check_cases

    cases = load_all([_given(case)], _texts(settings, method), ())
    given = _places(parts), _files(samples)
    found = check_cases(cases, tuple(overrides), _telling(progress, lambda: None), None, *given)[0]
    return CheckResult(
        verdict=found.verdict,
        reasons=found.reasons,
        warnings=found.warnings,
        metrics={path: _figure(value) for path, value in found.metrics.items()},
        units={path: METRICS[path].units for path in found.metrics},
        definitions={path: METRICS[path].definition for path in found.metrics},
        intervals=intervals_of(found.metrics),
        findings=tuple(as_data(one) for one in (*found.refusals, *found.notes, *found.of_guard)),
    )


def identify(
    case: str | Path,
    output: str | Path,
    *,
    settings: Settings | None = None,
    yes: bool = False,
    replace: bool = True,
    progress: Progress | None = None,
) -> ModelResult:
    """Identify the rig and specimen of a case as `rths identify` does and write the model file `output`.

    `replace` False: a model file that exists is refused. A real rig is moved only with `yes`, and only when its file
    says `unattended: true`. Raises InputError when the case or the output cannot be used, LimitError or RigError when
    the excitation was stopped or gave no usable channels.
    """
    from rths_cli.experiment.identify_command import Asked, make_model
    from rths_cli.experiment.real_rig_readiness import ask_to_move

    def permit(setup: Setup) -> None:
        ask_to_move([setup], yes, _refuse)

    given = ("identification.model=null", *_texts(settings, None))
    _check_rig(str(case), given, False)
    with _signals() as poll:
        made = make_model(
            Asked(str(case), given, output=Path(output), draw=False, replace=replace), _telling(progress, poll), permit
        )
    found = made.found
    if found is None:
        raise RigError("; ".join(made.unfit.faults) if made.unfit else "no model can be made from these channels")
    model, specimen = found.best, found.specimen
    return ModelResult(
        path=Path(output).absolute(),
        accepted=found.accepted,
        reasons=found.reasons,
        warnings=found.warnings,
        zeros=model.zeros,
        poles=model.poles,
        gain=model.gain,
        delay_s=model.delay_s,
        natural_frequency_hz=specimen.natural_frequency_hz if specimen else None,
        damping_ratio=specimen.damping_ratio if specimen else None,
        table=model,
    )


def open_loop(
    case: str | Path,
    *,
    method: Method | None = None,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Block:
    """Return the loop of a case's hybrid test, broken at the command, for negative feedback; nothing moves.

    It goes from the command that is sent to minus the command that follows from it, both in V, sample by sample, and
    holds the identified rig with its delay and the designed blocks. Raises InputError when the case cannot be read or
    no controller exists, RigError or LimitError if its virtual rig cannot be identified.
    """
    from rths_cli.case.load import load_all
    from rths_cli.experiment.check_command import loop_of

    return loop_of(load_all([str(case)], _texts(settings, method), ())[0], _telling(progress, lambda: None))


def to_control(
    system: System | ModelResult | Group, frequency_hz: ArrayLike | None = None, dt_s: float | None = None
) -> control.StateSpace | control.FRD:
    """Return a block of a result (`result.controller.feedback`), the table's response that a run was designed from
    (`result.identification`), the table of an identification, or an open loop as python-control has it.

    With `frequency_hz` (n,) it is a `control.FRD`, otherwise a `control.StateSpace`; a model with a delay asks for
    `dt_s` in s there, and is the one on which a feedback is designed. Raises InputError for what has no such form.
    """
    import numpy as np

    from rths_cli.control import python_control

    given = system.table if isinstance(system, ModelResult) else system
    found = _system(given) if isinstance(given, Group) else given
    return python_control.to_control(found, None if frequency_hz is None else np.asarray(frequency_hz, float), dt_s)


def _system(group: Group) -> Block | Frf:
    """Return a controller's block, or the identified response of the table; raises InputError for another group."""
    import numpy as np

    from rths_cli.numerics.lti import Block, Frf

    if {"A", "B", "C", "D"} <= set(group):
        about = group.attributes
        signals = tuple(about["inputs"]), tuple(about["outputs"])
        return Block(str(about["name"]), group.A, group.B, group.C, group.D, float(about["dt_s"]), *signals)
    if {"frequency_hz", "frf_real", "frf_imag", "coherence"} <= set(group):
        response, unknown = group.frf_real + 1j * group.frf_imag, np.full(len(group.frequency_hz), np.nan)
        return Frf(group.frequency_hz, response, group.coherence, unknown, 1)
    raise InputError(
        f"{group!r} is neither a block nor a frequency response; give a block, as result.controller.kalman"
    )


def from_control(system: control.StateSpace | control.TransferFunction | control.FRD) -> StateSpace | Block | Frf:
    """Return a system of python-control with plain arrays: `A`, `B`, `C`, `D` and, sampled, `dt_s` and the names of
    its signals; of an FRD `frequency_hz` and `response`. Raises InputError for what has no such form.
    """
    from rths_cli.control import python_control

    return python_control.from_control(system)


def plot(
    result: RunResult | str | Path, name: str, width: Literal["one", "two"] = "two",
    header: Literal["case", "none"] = "case",
) -> Figure:  # fmt: skip
    """Draw a figure of a result or its file, say "tracking", for one column of a page (84 mm) or two (174 mm).

    A case with a scale and `report_in: prototype` is drawn in prototype scale.

    `plot(result, "tracking").savefig("tracking.pdf")` writes it; `header="none"` leaves case and table out. Raises
    InputError for a name that is none of the figures, and when the result does not hold what the figure shows.
    """
    from rths_cli.report.figures import draw
    from rths_cli.report.result_scale import reported

    opened = result if isinstance(result, RunResult) else load(result)
    opened.check_unchanged()
    return draw(name, reported([opened.contents])[0], width, header)


def _given(case: CaseGiven) -> CaseGiven:
    """Return a case as it is loaded: a mapping, or the text of a path or name."""
    return case if isinstance(case, Mapping) else str(case)


def _run(
    case: CaseGiven,
    settings: tuple[str, ...],
    folder: Path,
    overrides: tuple[str, ...],
    fresh: bool,
    yes: bool,
    tell: Callable[[str], None],
    parts: OwnParts,
    samples: OwnSamples,
    series: str,
    replace: bool,
) -> Ended:
    """Run one case by the workflow of `rths run`."""
    from rths_cli.case.load import load_cases
    from rths_cli.experiment.run_command import Request, run_batch

    request = Request(
        cases=tuple(load_cases([case], settings)),
        methods=(),
        output=folder,
        replace=replace,
        command_line=" ".join(["rths_cli.run", "{...}" if isinstance(case, Mapping) else str(case), *settings]),
        overrides=overrides,
        parts=parts,
        samples=samples,
        fresh=fresh,
        yes=yes,
        series=series,
    )
    return run_batch(request, _Script(tell))[0]


def _places(parts: OwnParts | None) -> OwnParts:
    """Return the parts as given; raises InputError for a place that the step does not have."""
    from rths_cli.control.interface import PLACES

    for place in parts or {}:
        if place not in PLACES:
            raise InputError(f"parts: there is no place {place!r} in the step; use {', '.join(PLACES)}")
    return parts or {}


def _files(samples: Samples) -> OwnSamples:
    """Return samples with the names of files as paths."""
    if callable(samples):
        return samples
    if isinstance(samples, str | Path):
        raise InputError(f"samples: {samples} is one file; give a list of model files")
    return tuple(Path(path) for path in samples)


def _check_rig(case: CaseGiven, settings: tuple[str, ...], temporary: bool) -> None:
    """Raise InputError where a real rig would run into a temporary folder, or in a thread that no signal reaches."""
    from rths_cli.case.load import load_cases

    table = load_cases([case], settings)[0].table
    if capabilities_of(table.kind).moves_hardware and temporary:
        raise InputError(f"output: rig {table.name} is real and its result must last; give a folder")
    if capabilities_of(table.kind).moves_hardware and threading.current_thread() is not threading.main_thread():
        raise InputError(f"rig {table.name} is real: call this in the main thread, where Ctrl-C and SIGTERM arrive")


class _Script:
    """Takes the place of the screen where a script runs a case: nobody is asked, nobody presses a key."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.doing = tell

    def started(self, number: int, count: int, name: str) -> None:
        """Take no note."""

    def ended(self, ended: Ended, seconds: float) -> None:
        """Take no note: the result says it."""

    def message(self, text: str) -> None:
        """Pass a sentence on."""
        self.doing(text)

    def warning(self, text: str) -> None:
        """Pass a warning on."""
        self.doing(text)

    def moving(self, label: str, view: View) -> bool:
        """Let the run go on."""
        return False

    def confirm(self, lines: Sequence[str]) -> bool:
        """Refuse."""
        return _refuse(lines)


def _refuse(lines: Sequence[str]) -> bool:
    """Say that no real rig moves because a script says so."""
    what = "nobody confirms here; yes=True moves rigs whose file says `unattended: true`, rths run asks for others"
    raise InputError(f"{lines[0]} {what}")


def _telling(progress: Progress | None, poll: Callable[[], None]) -> Callable[[str], None]:
    """Return what passes sentences on to the script, and raises a signal that a library swallowed on its way."""
    told = progress or (lambda _: None)
    if progress is not None:
        announce(progress)

    def tell(text: str) -> None:
        poll()
        if text:
            told(text)

    return tell


def _texts(settings: Settings | None, method: Method | None) -> tuple[str, ...]:
    """Return settings as KEY=VALUE, the value in JSON, which YAML reads; raises InputError for what has no form."""
    given: dict[str, object] = dict(settings or {})
    if method is not None:
        given["method"] = method
    return tuple(f"{key}={_value(key, value)}" for key, value in given.items())


def _value(key: str, value: object) -> str:
    try:
        return json.dumps(value, default=_plain, allow_nan=False, ensure_ascii=False)
    except TypeError as error:
        raise InputError(f"settings: {key} must be a number, text, list or mapping, got {error}") from None
    except ValueError:
        raise InputError(f"settings: {key} must be finite, got {value!r}") from None


def _plain(item: Any) -> Any:
    """Return an array or number of numpy, or a path, in Python's own types; raise TypeError naming any other type."""
    if isinstance(item, Path):
        return str(item)
    if hasattr(item, "tolist"):
        return item.tolist()
    raise TypeError(type(item).__name__)


def _figure(value: Any) -> Any:
    """Return a figure as a number or an array (n_storeys,)."""
    import numpy as np

    numbers = np.asarray(value, dtype=float)
    return numbers if numbers.ndim else float(numbers)


@contextmanager
def _signals() -> Iterator[Callable[[], None]]:
    """Turn SIGTERM and SIGHUP into exceptions meanwhile, so that a table that moves is led to rest as by Ctrl-C.

    What it gives raises one that arrived and was swallowed; in another thread than the main one no signal is taken.
    """
    import signal

    from rths_cli.interrupts import Signals

    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {name: signal.getsignal(getattr(signal, name)) for name in names}
    hook = sys.unraisablehook
    signals = Signals()
    signals.install()
    try:
        yield signals.poll
        signals.poll()
    finally:
        sys.unraisablehook = hook
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler or signal.SIG_DFL)
