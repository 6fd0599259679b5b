"""Random table runs, judged before they move and compared with what the virtual table truly did.

Buildings of 1 to 6 storeys on tables that nobody has looked at, at 500 Hz to 4 kHz: the specimen's modes lie in the
identified band and above it, controllers are FF and FF+FB, methods best and paper. The truth is read here alone."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from campaigns.random_case_draw import frequencies, log_uniform, varied_rig
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment import identify_on_rig
from rths_cli.experiment.check_command import Verdict, verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import TABLE_RUNS, RunKind, plan_run, play_run
from rths_cli.experiment.run_case import why_none, why_unsafe
from rths_cli.experiment.run_signals import mean_accelerations
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.findings import sentences
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.numerics.lti import Array

ACCEL_FACTOR, LEAST_ACCEL_M_S2 = 3.0, 1.0  # true acceleration: times the planned peak, or this where that is less
PLACE_FACTOR, LEAST_PLACE_M = 1.5, 1e-3  # true displacement: times the planned peak, or that and this
RATES_HZ = 500.0, 1000.0, 2000.0, 4000.0
FIRST_MODE_HZ = 2.0, 40.0  # of the specimen; the highest of four floors lies at 3 to 6 times as much
SHARES = 0.05, 0.7  # of the stroke or speed that SIM of the building takes
UNPLANNED = "identification"


@dataclass(frozen=True)
class Moved:
    """What one run did: peaks planned and true of acceleration in m/s^2 and displacement in m; `refused`: why it was
    not to be run (it was, by override), "" if it was; `stopped`: why the guard ended it."""

    run: str
    planned_m_s2: float
    true_m_s2: float
    planned_m: float
    true_m: float
    refused: str = ""
    stopped: str = ""

    @property
    def kept(self) -> bool:
        """Return whether the table moved as planned, in proportion to the test."""
        accel = max(ACCEL_FACTOR * self.planned_m_s2, LEAST_ACCEL_M_S2)
        place = max(PLACE_FACTOR * self.planned_m, self.planned_m + LEAST_PLACE_M)
        return bool(self.true_m_s2 <= accel and self.true_m <= place)

    @property
    def would_run(self) -> bool:
        """Return whether the run reaches its end and the table moves as planned."""
        return self.kept and not self.stopped


@dataclass(frozen=True)
class Trial:
    """What came of one random test; `fault`: why there is no model or design."""

    seed: int
    about: str
    runs: tuple[Moved, ...]
    fault: str = ""
    seconds: float = 0.0


def draw(seed: int) -> dict[str, object]:
    """Return a random case as a mapping, with scaling 1."""
    random = np.random.default_rng((seed, 44))
    floors, storeys = int(random.integers(1, 5)), int(random.integers(1, 4))
    masses = random.uniform(3.0, 9.0, floors)
    shape = 2.0 ** random.uniform(-0.5, 0.5, floors)
    hz = log_uniform(random, *FIRST_MODE_HZ)
    springs = shape * (2.0 * np.pi * hz / frequencies(masses, shape)[0]) ** 2
    own = masses.mean() * 2.0 ** random.uniform(-0.5, 1.5, storeys)
    own_shape = 2.0 ** random.uniform(-0.5, 0.5, storeys)
    own_hz = hz * 2.0 ** random.uniform(-1.0, 1.0)
    own_springs = own_shape * (2.0 * np.pi * own_hz / frequencies(own, own_shape)[0]) ** 2
    dashpots = own_springs * 2.0 * log_uniform(random, 0.005, 0.08) / (2.0 * np.pi * own_hz)
    table = varied_rig(random, float(masses.sum()), float(masses.sum()) * 1.3)
    table["converters"] = {"bits": int(random.choice([14, 16, 18])), "latency_samples": int(random.integers(0, 5))}
    return {
        "name": f"judged_{seed}",
        "structure": {
            "numerical": {"masses_kg": own.tolist(), "stiffness_n_per_m": own_springs.tolist()},
            "experimental": {
                "masses_kg": masses.tolist(),
                "stiffness_n_per_m": springs.tolist(),
                "damping_ratios": np.exp(random.uniform(np.log(0.01), np.log(0.06), floors)).tolist(),
            },
        },
        "damping": {"dashpots_n_s_per_m": dashpots.tolist()},
        "record": str(random.choice(["el_centro", "hachinohe"])),
        "scaling": 1.0,
        "controller": str(random.choice(["FF+FB", "FF"], p=[0.75, 0.25])),
        "method": "paper" if random.random() < 0.25 else "best",
        "sample_rate_hz": float(random.choice(RATES_HZ)),
        "seed": seed,
        "identification": {"duration_s": 60.0},
        "runs": ["sim", "shake_table", "exp_rths"],
        "table": table,
        "test_band_hz": 12.0,
    }  # fmt: skip


def setup_of(seed: int, folder: Path) -> Setup:
    """Return the setup of a random case, scaled to a share of the table's stroke and speed."""
    from campaigns.random_case_truth import Truth

    path = folder / f"judged_{seed}.yaml"
    path.write_text(json.dumps(draw(seed)))
    setup = make_setup(load_cases([path])[0])
    share = log_uniform(np.random.default_rng((seed, 45)), *SHARES)
    return make_setup(load_cases([path], [f"scaling={share / max(Truth(setup).shares.values())!r}"])[0])


def tried(seed: int, folder: Path) -> Trial:
    """Identify, check and play one random test: what is refused is played as well, to know what it would have done."""
    begun = time.monotonic()
    try:
        setup = setup_of(seed, folder)
    except InputError as error:
        return Trial(seed, "", (), "; ".join(error.faults))
    runs: list[Moved] = []
    with _watched(runs):
        try:
            known = Memory().known(setup, lambda _: None)
        except (InputError, RigError, LimitError) as error:
            return Trial(seed, about(setup), tuple(runs), str(error), time.monotonic() - begun)
    checked = verdict_on(setup, known)
    fault = "; ".join(checked.reasons) if checked.design is None else ""
    if checked.design is not None:
        unfit = why_none(setup, known, checked)
        for kind in TABLE_RUNS:
            plan = plan_run(setup, checked.design, kind)
            outcome = play_run(plan, setup.case.seed)
            refused = "; ".join(sentences(unfit)) or str(why_unsafe(setup, checked, kind) or "")
            runs.append(replace(_moved(kind.name, outcome, setup), refused=refused, **_planned(setup, checked, kind)))
    return Trial(seed, about(setup), tuple(runs), fault, time.monotonic() - begun)


def _planned(setup: Setup, checked: Verdict, kind: RunKind) -> dict[str, float]:
    """Return the planned peaks of a run; those of an unstable loop are zero, because nothing was predicted."""
    part = "check.shake_table_peak_" if kind.name == "shake_table" else "check.peak_"
    accel, command = (checked.figures.get(part + leaf) for leaf in ("acceleration_m_s2", "command_v"))
    place = 0.0 if command is None else setup.rig.gain_m_per_v * float(np.asarray(command))
    return {"planned_m_s2": 0.0 if accel is None else float(np.asarray(accel)), "planned_m": place}


def _moved(run: str, outcome: Outcome, setup: Setup) -> Moved:
    """Return the true peaks of a run."""
    log = outcome.log
    table = slice(0, log.true_velocity_m_s.shape[1])
    accel = mean_accelerations(log.true_velocity_m_s, table, setup.rig.dt_s)[0]
    stopped = outcome.stopped_by_limit or outcome.rig_fault or ""
    return Moved(run, 0.0, _peak(accel), 0.0, _peak(log.true_displacement_m), "", stopped)


def _peak(series: Array) -> float:
    seen = series[np.isfinite(series)]
    return float(np.abs(seen).max(initial=0.0))


@contextmanager
def _watched(runs: list[Moved]) -> Iterator[None]:
    """Add to `runs` what each excitation did, with the peaks of its command on the nominal table."""
    played = identify_on_rig.play_excitation

    def watched(setup: Setup, drive: Array, *more: object) -> Outcome:
        outcome = played(setup, drive, *more)
        command, dt_s = drive[:, 0], setup.rig.dt_s
        f = np.fft.rfftfreq(len(command), dt_s)
        lines = np.fft.rfft(command) * (2.0 * np.pi * f) ** 2 * (f <= 1.2 * setup.case.identification.high_hz)
        accel = setup.rig.gain_m_per_v * _peak(np.fft.irfft(lines, len(command)))
        place = setup.rig.gain_m_per_v * _peak(command)
        runs.append(replace(_moved(UNPLANNED, outcome, setup), planned_m_s2=accel, planned_m=place))
        return outcome

    identify_on_rig.play_excitation = watched
    try:
        yield
    finally:
        identify_on_rig.play_excitation = played


def about(setup: Setup) -> str:
    """Return what a reader needs to see of a test, in one line."""
    from campaigns.random_case_truth import Truth

    case, hz = setup.case, Truth(setup).modes_hz
    return (
        f"{1.0 / setup.rig.dt_s:4.0f} Hz l={setup.rig.latency_samples} {case.controller.kind:<5} {case.method:<5} "
        f"{len(setup.building.numerical.masses_kg)}+{len(hz)} specimen {hz[0]:.3g}-{hz[-1]:.3g} Hz x{case.scaling:.2g}"
    )
