"""Take random legitimate tests through identify, check and run, and judge each refusal and stop by the true cause.

Warnings of libraries count as failures. A refused test is run again with both overrides, which tells what it would
have done."""

from __future__ import annotations

import json
import time
import traceback
import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from campaigns.random_case_draw import draw
from campaigns.random_case_truth import GOOD, Played, Truth, judge, loop_figures
from rths_cli.analysis.metrics import rms
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, LimitError, RigError, RthsError
from rths_cli.experiment.check_command import Verdict, verdict_on
from rths_cli.experiment.identify_on_rig import UnfitRig
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.findings import sentences
from rths_cli.rigs.virtual.plant import continuous

RAN, REFUSED, STOPPED, CRASHED, WARNED = "ran", "refused", "stopped", "crashed", "warned"
OVERRIDES = ("check", "model")
SETTLED = 0.02  # least damping ratio of the bare table's own poles: a table that rings on by itself is not legitimate
DRAWS = 50


@dataclass(frozen=True)
class Row:
    """What came of one test: `kinds` and `true` of each of the reasons given; `error` as it ran, or would have run."""

    seed: int
    outcome: str
    about: str
    reasons: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    true: tuple[bool, ...] = ()
    verdict: str = ""
    error: float = float("nan")
    measured: float = float("nan")
    predicted: float = float("nan")
    stopped: str = ""
    crash: str = ""
    seconds: float = 0.0
    loop: dict[str, float] = field(default_factory=dict)

    @property
    def honest(self) -> bool:
        """Tell whether it ran, or every reason why it did not is true."""
        return self.outcome == RAN or (self.outcome in (REFUSED, STOPPED) and bool(self.true) and all(self.true))

    @property
    def would_do(self) -> bool:
        """Tell whether it ran, or would have run, with an error worth having."""
        return not self.stopped and self.error < GOOD


def legitimate(seed: int, folder: Path) -> Setup:
    """Draw a test of a seed whose bare table stands by itself, and scale it to its share of the limits.

    Raises InputError where the program refuses the case's file.
    """
    for attempt in range(DRAWS):
        drawn = draw(seed + 10**6 * attempt, folder)
        path = folder / f"case_{seed}.yaml"
        path.write_text(json.dumps(drawn.case | {"name": f"random_{seed}"}))
        setup = make_setup(load_cases([path])[0])
        if _stands(setup):
            largest = max(Truth(setup).shares.values())
            return make_setup(load_cases([path], [f"scaling={drawn.share / largest!r}"])[0])
    raise AssertionError(f"seed {seed}: no table of {DRAWS} stands by itself")


def _stands(setup: Setup) -> bool:
    """Tell whether the table's poles are damped, those that lie near the specimen's apart."""
    building = setup.building
    a, *_ = continuous(setup.case.table.physics, building.specimen, building.interface_experimental_mass_kg)
    poles = np.linalg.eigvals(a)
    ratio = -poles.real / np.abs(poles)
    least = min(SETTLED, 0.5 * setup.case.structure.experimental.damping_ratios[0])
    return bool(ratio.min() > least)


def judged(seed: int, folder: Path) -> Row:
    """Draw one test and take it through identify, check and run."""
    begun = time.monotonic()
    try:
        setup = legitimate(seed, folder)
    except InputError as error:
        known = all("is unstable at dt = " in fault for fault in error.faults)
        return Row(seed, REFUSED, "", error.faults, ("scheme" if known else "input",), (known,))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            row = _taken_through(seed, setup, folder)
        except Warning as warning:
            row = Row(seed, WARNED, about(setup), (str(warning),), crash=traceback.format_exc())
        except Exception as error:
            row = Row(seed, CRASHED, about(setup), (repr(error),), crash=traceback.format_exc())
    return replace(row, seconds=time.monotonic() - begun)


def _taken_through(seed: int, setup: Setup, folder: Path) -> Row:
    memory = Memory()
    try:
        known = memory.known(setup, lambda _: None)
    except (InputError, RigError, LimitError) as error:
        faults = _faults(error)
        outcome = STOPPED if isinstance(error, LimitError) else REFUSED
        said = [judge(fault, Truth(setup)) for fault in faults]
        kinds, true = zip(*said, strict=True)
        return Row(seed, outcome, about(setup), faults, kinds, true)
    checked = verdict_on(setup, known)
    ended, played = _run(setup, memory, folder)
    predicted = _predicted(setup, checked)
    loop = loop_figures(Truth(setup, known.found, checked.design), known.found, checked)
    row = Row(seed, RAN, about(setup), verdict=checked.verdict, predicted=predicted, loop=loop)
    if ended.status == "complete":
        return replace(row, error=played.error, measured=played.measured)
    if ended.status == "refused":
        reasons = _reasons(known, checked)
        if checked.design is not None:
            again = make_setup(setup.case, OVERRIDES)
            _, played = _run(again, memory, folder)
        truth = Truth(setup, known.found, checked.design, played if checked.design else None)
    else:
        reasons, truth = (ended.reason,), Truth(setup, known.found, checked.design, None)
    said = [judge(reason, truth) for reason in reasons]
    return replace(
        row,
        outcome=REFUSED if ended.status == "refused" else STOPPED,
        reasons=tuple(reasons),
        kinds=tuple(kind for kind, _ in said),
        true=tuple(holds for _, holds in said),
        error=played.error,
        measured=played.measured,
        stopped=played.stopped,
    )


def _faults(error: RthsError) -> tuple[str, ...]:
    """Return why an identification came to nothing, one sentence each."""
    if isinstance(error, UnfitRig):
        return error.unfit.faults
    return error.faults if isinstance(error, InputError) else (str(error),)


def _reasons(known: IdentifiedModel, checked: Verdict) -> tuple[str, ...]:
    """Return why a test is refused, one sentence each: the model's reasons are joined in the verdict."""
    faults = sentences(known.faults(()))
    model = known.found.reasons if faults else ()
    return (*model, *(reason for reason in checked.reasons if reason not in faults))


def _run(setup: Setup, memory: Memory, folder: Path) -> tuple[Ended, Played]:
    """Run a test to a result file, as `rths run` does, and read what is true of it."""
    path = folder / f"result_{setup.case.seed}.h5"
    ended = run_case(setup, path, memory, "random_cases", lambda _: None)
    try:
        figures = read_result(path).metrics
    finally:
        path.unlink()
    if ended.status != "complete":
        return ended, Played(ended.reason, float("nan"), float("nan"))
    sim, as_it_is = (rms(one.abs_accel_m_s2) for one in (Truth(setup).sim, Truth(setup).sim_as_it_is))
    true, measured = (np.asarray(figures[f"exp_rths.{name}rms_error_m_s2"]) for name in ("true_reference_", ""))
    return ended, Played("", float((true / as_it_is).max()), float((measured / sim).max()))


def _predicted(setup: Setup, checked: Verdict) -> float:
    """Return the predicted error over SIM's RMS, worst storey."""
    found = checked.figures.get("check.rms_error_m_s2")
    if found is None:
        return float("nan")
    return float((np.asarray(found) / rms(Truth(setup).sim.abs_accel_m_s2)).max())


def about(setup: Setup) -> str:
    """Return what a reader needs to see of a test, in one line."""
    case, rig = setup.case, setup.rig
    truth, physics = Truth(setup), case.table.physics
    hz = truth.modes_hz
    return (
        f"{1.0 / rig.dt_s:4.0f} Hz {rig.converters.bits} bit l={rig.latency_samples} {case.controller.kind:<5} "
        f"{case.method:<5} {case.integration:<7} {len(setup.building.numerical.masses_kg)}+{len(hz)} "
        f"{hz[0]:5.2f}-{hz[-1]:4.1f} Hz z {min(case.structure.experimental.damping_ratios):.2%} "
        f"Fc {physics.coulomb_n:4.2f} N {case.record.name} x{case.scaling:.2g}, {truth.bits:.0f} bits rms"
    )
