"""Hybrid tests nobody has looked at: draw one, check it without moving anything, play it whatever the verdict."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import random_tables

from rths_cli.analysis.metrics import error_figures, rms
from rths_cli.analysis.sim import simulate
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError, RthsError
from rths_cli.experiment.check_command import choose_design
from rths_cli.experiment.design import Design, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import Cache
from rths_cli.experiment.one_table_run import HYBRID_TEST, plan_run, play_run
from rths_cli.experiment.run_signals import on_record_clock, whole_building
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.numerics.lti import Array

SHARES = 0.1, 1.1  # of the scaling at which the building's motion fills the table's stroke or reaches its speed
DAMPING_RATIOS = (0.003, 0.08)
DIVERGED = 10.0  # times SIM's RMS
DRAWS = 50  # of a damping ratio, until dashpots can give it
PAYLOAD_KG = 40.0


@dataclass(frozen=True)
class Drawn:
    """A random test: the case as a mapping, and the scaling as a share of what the table's stroke and speed allow."""

    case: dict[str, object]
    share: float
    rate_hz: float
    latency_samples: int
    controller: str
    method: str
    loop_hz: float
    coulomb_n: float
    floors: tuple[int, int]
    mass_share: float
    ratio: float


@dataclass(frozen=True)
class Row:
    """What came of one test: `refused` says why it was not run, `stopped` why it did not reach the end of the record.

    `predicted` and `measured` (n_storeys + 1,): RMS errors in m/s^2, test band, storeys against SIM, then tracking.
    """

    seed: int
    drawn: Drawn
    refused: str = ""
    verdict: str = ""
    reasons: tuple[str, ...] = ()
    radius: float = np.nan
    tolerates: float = np.nan
    scaling: float = np.nan
    predicted: Array = field(default_factory=lambda: np.zeros(0))
    measured: Array = field(default_factory=lambda: np.zeros(0))
    sim_rms: Array = field(default_factory=lambda: np.zeros(0))
    causes: dict[str, Array] = field(default_factory=dict)
    stopped: str = ""

    @property
    def diverged(self) -> bool:
        """Tell whether the test was stopped or a storey's error grew beyond ten times the motion that SIM has."""
        return bool(self.stopped) or bool(np.any(~(self.measured[:-1] <= DIVERGED * self.sim_rms)))

    @property
    def ratios(self) -> Array:
        """Return predicted over measured errors (n_storeys + 1,)."""
        return self.predicted / self.measured


def draw(seed: int) -> Drawn:
    """Draw a rig as `random_tables` does, and a building, a record, a controller and a sampling for it."""
    random = np.random.default_rng((seed, 1))
    rig = random_tables.draw(seed)
    storeys = int(random.integers(1, 4))
    masses = rig.masses_kg.mean() * 2.0 ** random.uniform(-1.0, 1.0, storeys)
    stiffness = rig.stiffness_n_per_m.mean() * 2.0 ** random.uniform(-1.0, 1.0, storeys)
    mass_share = float(random.uniform(0.05, 0.7)) if random.random() < 0.3 else 0.0
    latency, rate = int(random.integers(0, 5)), float(random.choice([1000.0, 2000.0, 4000.0]))
    controller = str(random.choice(["FF+FB", "FF", "none"], p=[0.5, 0.35, 0.15]))
    method = "paper" if random.random() < 0.15 else "best"
    structure = {
        "numerical": {"masses_kg": masses.tolist(), "stiffness_n_per_m": stiffness.tolist()},
        "experimental": {
            "masses_kg": rig.masses_kg.tolist(),
            "stiffness_n_per_m": rig.stiffness_n_per_m.tolist(),
            "damping_ratios": rig.damping_ratios.tolist(),
        },
        "interface_experimental_mass_kg": mass_share * float(masses[-1]),
    }
    case = {
        "name": f"random_{seed}",
        "structure": structure,
        "record": str(random.choice(["el_centro", "hachinohe"])),
        "scaling": 1.0,
        "controller": controller,
        "method": method,
        "sample_rate_hz": rate,
        "seed": seed,
        "runs": ["sim", "exp_rths"],
        "table": _table(rig, latency),
    }
    share = float(random.uniform(*SHARES))
    ratio = _damping(case, random)
    return Drawn(
        case | {"damping": {"first_mode_ratio": ratio}}, share, rate, latency, controller, method, rig.loop_hz,
        rig.coulomb_n, (storeys, len(rig.masses_kg)), mass_share, ratio,
    )  # fmt: skip


def _table(rig: random_tables.Drawn, latency_samples: int) -> dict[str, object]:
    """Return the default rig with drawn physics; its data sheet states the moving mass."""
    physics = {
        "loop_frequency_hz": rig.loop_hz,
        "loop_damping_ratio": rig.loop_ratio,
        "moving_mass_kg": rig.mass_kg,
        "coulomb_n": rig.coulomb_n,
        "loop_specimen_mass_kg": float(rig.masses_kg.sum()),
    }
    return {
        "extends": "aps400_virtual",
        "physics": physics,
        "converters": {"latency_samples": latency_samples},
        "nominal": {"moving_mass_kg": rig.mass_kg, "payload_kg": PAYLOAD_KG},
    }


def _damping(case: dict[str, object], random: np.random.Generator) -> float:
    """Return a ratio, even on a logarithmic scale, that dashpots of the numerical storeys can give the first mode."""
    low, high = np.log(DAMPING_RATIOS)
    for _ in range(DRAWS):
        ratio = float(np.exp(random.uniform(low, high)))
        try:
            setup_of(case | {"damping": {"first_mode_ratio": ratio}})
        except InputError:
            continue
        return ratio
    raise InputError(f"{case['name']}: no first-mode damping ratio in {DAMPING_RATIOS} can be had")


def setup_of(case: dict[str, object], *settings: str) -> Setup:
    """Return the setup of a case given as a mapping, by way of a file as a user would write it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{case['name']}.yaml"
        path.write_text(json.dumps(case))
        return make_setup(load_cases([path], settings)[0])


def judged(seed: int, cache: Cache | None = None) -> Row:
    """Identify, design, check and play one random test."""
    drawn = draw(seed)
    setup = setup_of(drawn.case)
    try:
        identified = Memory(cache).identify(setup, lambda _: None)
        if not identified.accepted:
            return Row(seed, drawn, f"model rejected: {'; '.join(identified.reasons)}")
        design = design_blocks(setup, identified)
    except RthsError as error:
        return Row(seed, drawn, str(error))
    setup = setup_of(drawn.case, f"scaling={drawn.share * allowed(setup)}")
    try:
        design, judgement = choose_design(setup, identified, design)
    except RthsError as error:
        return Row(seed, drawn, str(error))
    found = judgement.preflight
    prediction = found.prediction
    predicted = {"total": prediction.total, **prediction.causes} if prediction else {}
    errors = {name: np.append(error.storeys, error.tracking) for name, error in predicted.items()}
    measured, sim_rms, stopped = played(setup, design)
    nothing = np.full(measured.shape, np.nan)
    return Row(
        seed, drawn, "", found.verdict, found.reasons, found.stability.radius, found.stability.tolerates,
        setup.case.scaling, errors.pop("total", nothing), measured, sim_rms, errors, stopped,
    )  # fmt: skip


def allowed(setup: Setup) -> float:
    """Return the scaling at which the interface's motion in SIM fills the stroke or reaches the speed limit."""
    motion, floor = setup.motion, len(setup.building.numerical.masses_kg) - 1
    sim = simulate(setup.building, setup.rig.dt_s, motion.accel_m_s2)
    place = np.abs(sim.rel_disp_m[floor] + motion.displacement_m).max()
    speed = np.abs(sim.rel_vel_m_s[floor] + motion.velocity_m_s).max()
    limits = setup.rig.limits
    return setup.case.scaling * min(limits.stroke_m / place, limits.velocity_m_s / speed)


def played(setup: Setup, design: Design) -> tuple[Array, Array, str]:
    """Play EXP-RTHS; return RMS errors (n_storeys + 1,) as a run reports them, SIM's RMS (n_storeys,) in the test
    band, both in m/s^2, and why it was stopped."""
    dt, ground = setup.rig.dt_s, setup.motion.accel_m_s2
    outcome = play_run(plan_run(setup, design, HYBRID_TEST), setup.case.seed)
    series = on_record_clock(outcome, design.blocks.lead_samples, dt, len(ground))
    sim = simulate(setup.building, dt, ground).abs_accel_m_s2
    stopped = outcome.stopped_by_limit or outcome.rig_fault
    if stopped:
        return np.full(len(sim) + 1, np.nan), rms(sim), f"{stopped} at {_ended_s(outcome, dt):.2f} s"
    hybrid = whole_building(setup.building, series, ground, dt, setup.case.integration)[2]
    storeys = error_figures(sim, hybrid, dt).rms
    tracking = error_figures(series.desired[0], series.measured[0], dt).rms
    return np.append(storeys, tracking), rms(sim), ""


def _ended_s(outcome: Outcome, dt_s: float) -> float:
    return outcome.stopped_at_s if outcome.stopped_by_limit else outcome.steps * dt_s
