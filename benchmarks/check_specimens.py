"""Is a test safe that the check calls so, when its specimen yields or loses stiffness after the identification?

    python benchmarks/check_specimens.py [--seed N] [--count N]

Rigs, buildings and records are those of `preflight.py`, controllers with feedforward, method `best`. After the
identification the specimen has 0.5 to 1 of its stiffness, or its storeys yield at 1/1.2 to 1/6 of their linear peak
drift. The case states `check.specimen_range: [0.5, 1]`. Each test is checked, and played whatever the verdict, with
both `controller.reaction_feedforward` and `controller.friction_compensation` off, on, and automatic, each with the
design that a run gets. Printed: verdict, outcome, and the worst storey's error in percent of SIM of the specimen as it
is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import random_tests
from options import arguments, parsed

from rths_cli.analysis.metrics import rms
from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import simulate
from rths_cli.analysis.structural_response import inter_storey_drift_m
from rths_cli.errors import RthsError
from rths_cli.experiment.check_command import choose_design
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run, play_run, run_of, true_accelerations
from rths_cli.experiment.setup import Setup
from rths_cli.identification.results import Identification
from rths_cli.numerics.lti import Array
from rths_cli.rigs.from_case import true_building

SHORT = ("--count", "1")

FIRST_SEED, COUNT = 11000, 200
RANGE = 0.5, 1.0  # of the specimen's stiffness
DUCTILITY = 1.2, 6.0
KINDS = ("bilinear", "bouc_wen", "clough")
KEYS = "controller.reaction_feedforward", "controller.friction_compensation"
SWITCHES = {"false": "off", "true": "on", "automatic": "automatic"}


@dataclass(frozen=True)
class Outcome:
    """One test: the check's verdict, why it was stopped, and the worst storey's error over SIM (both true)."""

    verdict: str
    stopped: str = ""
    error: float = np.nan

    @property
    def diverged(self) -> bool:
        """Tell whether it was stopped or is farther from SIM than ten times SIM's motion."""
        return bool(self.stopped) or not self.error <= random_tests.DIVERGED

    def __str__(self) -> str:
        return f"{self.verdict:<9}{'stopped' if self.stopped else f'{100.0 * self.error:.2f} %':<10}"


def changed(seed: int, setup: Setup) -> tuple[str, str]:
    """Return what becomes of the specimen, in words and as a setting."""
    random = np.random.default_rng((seed, 11))
    if random.random() < 0.5:
        factor = float(random.uniform(*RANGE))
        return f"{factor:.2f} k", f"table.after_identification.specimen_stiffness_factor={factor}"
    sim = simulate(setup.building, setup.rig.dt_s, setup.motion.accel_m_s2)
    drifts = np.abs(inter_storey_drift_m(sim.rel_disp_m)).max(axis=1)[len(setup.building.numerical.masses_kg) :]
    kind, stated = str(random.choice(KINDS)), []
    for drift in drifts:
        limit, hardening = drift / random.uniform(*DUCTILITY), random.uniform(0.0, 0.3)
        stated.append(f"{{kind: {kind}, yield_displacement_m: {limit:.6g}, hardening: {hardening:.3f}}}")
    return kind, f"table.physics.specimen_laws=[{', '.join(stated)}]"


def tested(seed: int) -> tuple[str, tuple[Outcome, ...], str]:
    """Return what is tested, the outcome with each of `SWITCHES`, and why nothing was run."""
    drawn = random_tests.draw(seed)
    kind = drawn.controller if drawn.controller != "none" else "FF"
    case = drawn.case | {"method": "best", "controller": kind, "check": {"specimen_range": list(RANGE)}}
    about = f"{drawn.rate_hz / 1e3:>2g} {kind:<5} {drawn.floors[0]} {drawn.floors[1]}"
    try:
        setup = random_tests.setup_of(case)
        scaling = f"scaling={drawn.share * random_tests.allowed(setup)}"
        identified = Memory(None).identify(setup, lambda _: None)
        if not identified.accepted:
            return about, (), f"model rejected: {'; '.join(identified.reasons)}"
        told, setting = changed(seed, random_tests.setup_of(case, scaling))
        about = f"{about} {told:<9}"
        plain = random_tests.setup_of(case, scaling, setting)
        building = true_building(plain.case, plain.building)
        assert building is not None  # a virtual rig
        truth = reference_of(building).sim(building, plain.rig.dt_s, plain.motion.accel_m_s2).abs_accel_m_s2
    except RthsError as error:
        return about, (), str(error)
    found = []
    for switch in SWITCHES:
        settings = [f"{key}={switch}" for key in KEYS]
        try:
            found.append(outcome(random_tests.setup_of(case, scaling, setting, *settings), identified, truth))
        except RthsError as error:
            return about, tuple(found), str(error)
    return about, tuple(found), ""


def outcome(setup: Setup, identified: Identification, truth: Array) -> Outcome:
    """Check a test and play it whatever the verdict; `truth` (n_storeys, n) are SIM's accelerations in m/s^2."""
    design, judged = choose_design(setup, identified, design_blocks(setup, identified))
    verdict = judged.preflight.verdict
    played = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    run = run_of(played, setup, HYBRID_TEST, design.blocks.lead_samples, None)
    accel = true_accelerations(run, setup)
    if run.stopped is not None or accel is None:
        return Outcome(verdict, run.stopped.reason if run.stopped else "not complete")
    return Outcome(verdict, "", worst(accel, truth))


def worst(accel: Array, sim: Array) -> float:
    """Return the largest error of a storey over its motion in SIM, both (n_storeys, n)."""
    return float((rms(accel - sim) / rms(sim)).max())


def summary(rows: list[tuple[Outcome, ...]]) -> Iterator[str]:
    """Yield verdict against outcome with each of `SWITCHES`."""
    for place, name in enumerate(SWITCHES.values()):
        of = [row[place] for row in rows if len(row) > place]
        yield f"feedforward of the reaction and of friction {name}: {len(of)} tests"
        for verdict in ("safe", "unsafe", "unstable"):
            these = [one for one in of if one.verdict == verdict]
            bad = sum(one.diverged for one in these)
            errors = [100.0 * one.error for one in these if not one.diverged]
            told = f", error median {np.median(errors):.2f} %, largest {max(errors):.2f} %" if errors else ""
            yield f"  {verdict:<9}{len(these):>4}, stopped or diverged {bad}{told}"


def main() -> None:
    """Print each test and the summary."""
    asked = parsed(arguments(__doc__, FIRST_SEED, COUNT), SHORT)
    first, count = asked.seed, asked.count
    rows = []
    for seed in range(first, first + count):
        about, found, why = tested(seed)
        rows.append(found)
        reasons = "; ".join(one.stopped for one in found if one.stopped) or why
        print(f"{seed} {about} {' | '.join(map(str, found))} {reasons[:160]}", flush=True)
    print("\n".join(summary(rows)))


if __name__ == "__main__":
    main()
