"""Does the check tell the truth of buildings that yield? Check and play random ones, whatever the verdict.

    python benchmarks/check_laws.py [--seed N] [--count N] [--set KEY=VALUE ...]

Rigs, buildings and records are those of `preflight.py`; each computed storey has a law with a probability of 0.7.
KEY=VALUE are settings of the cases with method `best` and a feedforward. Printed: verdict against outcome, every
contradiction, and how far the predicted errors are from the measured ones.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import random_tests
from options import arguments, parsed

from rths_cli.analysis.metrics import error_figures, rms
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.structural_response import inter_storey_drift_m
from rths_cli.errors import InputError, RthsError
from rths_cli.experiment.check_command import choose_design
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run, play_run
from rths_cli.experiment.run_signals import on_record_clock, whole_building
from rths_cli.experiment.setup import Setup
from rths_cli.numerics.lti import Array
from rths_cli.structure import storey_values

SHORT = ("--count", "1")
PRINTS = "^1 tests drawn"  # the short form at its end

FIRST_SEED, COUNT, PROCESSES = 9000, 30, 1
FACTOR = 2.0
LAW_SHARE = 0.7  # of the computed storeys
DUCTILITY = 1.2, 6.0  # peak drift of the linear building over the yield drift
KINDS = ("bilinear", "bouc_wen", "clough", "elastic_gap", "friction", "viscous_power", "maxwell", "cubic")


@dataclass(frozen=True)
class Row:
    """What came of one test; errors (n_storeys + 1,) in m/s^2, test band, storeys against SIM, then tracking."""

    seed: int
    about: str
    refused: str = ""
    verdict: str = ""
    reasons: tuple[str, ...] = ()
    predicted: Array = field(default_factory=lambda: np.zeros(0))
    measured: Array = field(default_factory=lambda: np.zeros(0))
    sim_rms: Array = field(default_factory=lambda: np.zeros(0))
    stopped: str = ""
    judged_s: float = 0.0

    @property
    def diverged(self) -> bool:
        """Tell whether the test was stopped or a storey's error grew beyond ten times the motion that SIM has."""
        return bool(self.stopped) or bool(np.any(~(self.measured[:-1] <= random_tests.DIVERGED * self.sim_rms)))

    @property
    def worst(self) -> float:
        """Return predicted over measured error of the storey with the largest measured one."""
        at = int(np.argmax(self.measured[:-1]))
        return float(self.predicted[at] / self.measured[at])


def law(random: np.random.Generator, drift_m: float, stiffness: float, rate_m_s: float) -> dict[str, object]:
    """Return a law of a storey whose linear peak drift, stiffness and peak drift rate are given."""
    kind, limit = str(random.choice(KINDS)), drift_m / random.uniform(*DUCTILITY)
    hardening = float(random.uniform(0.0, 0.3))
    yields = {"kind": kind, "yield_displacement_m": limit, "hardening": hardening}
    if kind == "bouc_wen":
        return yields | {"exponent": float(random.choice([1.0, 2.0])), "beta": 0.5, "gamma": 0.5}
    if kind in ("bilinear", "clough"):
        return yields
    if kind == "elastic_gap":
        return {"kind": kind, "gap_m": limit, "contact_n_per_m": stiffness * random.uniform(0.2, 2.0)}
    if kind == "friction":
        return {"kind": kind, "force_n": 0.1 * stiffness * limit, "sticking_displacement_m": 0.1 * limit}
    if kind == "viscous_power":
        exponent = float(random.uniform(0.4, 1.5))
        return {"kind": kind, "exponent": exponent, "coefficient": 0.05 * stiffness * drift_m / rate_m_s**exponent}
    if kind == "maxwell":
        return {
            "kind": kind,
            "spring_n_per_m": 0.3 * stiffness,
            "dashpot_n_s_per_m": 0.1 * stiffness * drift_m / rate_m_s,
        }
    cubic = stiffness * random.uniform(-0.2, 0.5) / drift_m**2
    return {"kind": kind, "cubic_n_per_m3": cubic, "largest_drift_m": drift_m}


def with_laws(setup: Setup, case: dict[str, object], seed: int) -> tuple[dict[str, object], str]:
    """Return a case with laws drawn for the drifts of its linear SIM, and their kinds."""
    random, building = np.random.default_rng((seed, 7)), setup.building
    sim = simulate(building, setup.rig.dt_s, setup.motion.accel_m_s2)
    drifts, rates = (np.abs(inter_storey_drift_m(one)).max(axis=1) for one in (sim.rel_disp_m, sim.rel_vel_m_s))
    laws: list[list[dict[str, object]]] = []
    for i, stiffness in enumerate(storey_values(building.numerical.K)):
        has = random.random() < LAW_SHARE or (not any(laws) and i + 1 == len(building.numerical.masses_kg))
        laws.append([law(random, float(drifts[i]), float(stiffness), float(rates[i]))] if has else [])
    structure = dict(case["structure"])  # type: ignore[call-overload]
    structure["numerical"] = structure["numerical"] | {"law": [one or None for one in laws]}
    kinds = "+".join(str(each["kind"]) for one in laws for each in one)
    return case | {"structure": structure}, kinds


def tested(seed: int, settings: tuple[str, ...] = ()) -> Row:
    """Identify, design, check and play one random test."""
    drawn = random_tests.draw(seed)
    driven = drawn.controller != "none" and drawn.method == "best"
    about = f"{drawn.rate_hz / 1e3:>2g} {drawn.controller:<5} {drawn.method:<5} {drawn.floors[0]} {drawn.floors[1]}"
    try:
        linear = random_tests.setup_of(drawn.case)
        scaling = f"scaling={drawn.share * random_tests.allowed(linear)}"
        linear = random_tests.setup_of(drawn.case, scaling)
        case, kinds = with_laws(linear, drawn.case, seed)
        about = f"{about} {kinds}"
        setup = random_tests.setup_of(case, scaling, *(settings if driven else ()))
        identified = Memory(None).identify(setup, lambda _: None)
        if not identified.accepted:
            return Row(seed, about, f"model rejected: {'; '.join(identified.reasons)}")
        design = design_blocks(setup, identified)
        start = time.monotonic()
        design, judged = choose_design(setup, identified, design)
        judged_s = time.monotonic() - start
    except RthsError as error:
        return Row(seed, about, str(error))
    found = judged.preflight
    measured, sim_rms, stopped = played(setup, design)
    total = found.prediction.total if found.prediction else None
    predicted = np.append(total.storeys, total.tracking) if total else np.full(measured.shape, np.nan)
    return Row(seed, about, "", found.verdict, found.reasons, predicted, measured, sim_rms, stopped, judged_s)


def played(setup: Setup, design: Design) -> tuple[Array, Array, str]:
    """Play EXP-RTHS; return its errors (n_storeys + 1,), SIM's RMS (n_storeys,), both in m/s^2, and why it stopped."""
    dt, ground = setup.rig.dt_s, setup.motion.accel_m_s2
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    try:
        sim = reference_of(setup.building).sim(setup.building, dt, ground).abs_accel_m_s2
    except InputError as error:
        return np.full(setup.building.storeys + 1, np.nan), np.zeros(setup.building.storeys), f"no SIM: {error}"
    if stopped := outcome.stopped_by_limit or outcome.rig_fault:
        return np.full(len(sim) + 1, np.nan), rms(sim), f"{stopped} at {outcome.steps * dt:.2f} s"
    series = on_record_clock(outcome, design.blocks.lead_samples, dt, len(ground))
    hybrid = whole_building(setup.building, series, ground, dt)[2]
    tracking = error_figures(series.desired[0], series.measured[0], dt).rms
    return np.append(error_figures(sim, hybrid, dt).rms, tracking), rms(sim), ""


def summary(rows: list[Row]) -> Iterator[str]:
    """Yield verdict against outcome, contradictions, and the agreement of predicted and measured errors."""
    yield "verdict    tests  stable  stopped or diverged"
    for verdict in ("safe", "unsafe", "unstable"):
        of = [row for row in rows if row.verdict == verdict]
        bad = sum(row.diverged for row in of)
        yield f"{verdict:<9}{len(of):>7}{len(of) - bad:>8}{bad:>21}"
    for row in rows:
        if row.verdict == "safe" and row.diverged:
            yield f"  seed {row.seed}: called safe, {row.stopped or 'diverged'}"
    compared = [row for row in rows if row.verdict == "safe" and not row.diverged]
    if compared:
        worst = np.array([row.worst for row in compared])
        within = np.abs(np.log(worst)) <= np.log(FACTOR)
        yield f"safe tests: predicted over measured error of the worst storey within {FACTOR:g}: {within.mean():.0%}"
        ends = f"{worst.min():.2f} {np.median(worst):.2f} {worst.max():.2f}"
        yield f"  of {len(compared)}; least, median, greatest {ends}"
        yield f"median time of a check {np.median([row.judged_s for row in compared]):.1f} s"


def main() -> None:
    """Print each test and the summary."""
    parser = arguments(__doc__, FIRST_SEED, COUNT)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    asked = parsed(parser, SHORT)
    rows, settings = [], tuple(asked.set)
    with ProcessPoolExecutor(PROCESSES) as pool:
        for row in pool.map(partial(tested, settings=settings), range(asked.seed, asked.seed + asked.count)):
            rows.append(row)
            ratio = f"{row.worst:5.2f}" if row.measured.size and not row.stopped and row.predicted.size else "  -  "
            why = row.refused or row.stopped or "; ".join(row.reasons)
            print(f"{row.seed} {row.about}: {row.verdict:<8} {ratio} {why[:200]}", flush=True)
    run = [row for row in rows if not row.refused]
    print(f"{len(rows)} tests drawn, {len(rows) - len(run)} not run (model or controller refused)")
    print("\n".join(summary(run)))


if __name__ == "__main__":
    main()
