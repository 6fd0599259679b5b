"""Hybrid tests whose motion is half a bit to fifty bits of their converters, drawn at random and played.

A laboratory has a specimen, converters of 9 to 16 bits, friction, and sensors whose zeros lie anywhere within a bit or
at zero; each of its tests has computed storeys, a record and a controller of its own. Tests are played whatever the
check says of them; those that diverge or have no loop to be checked are told apart.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.analysis.references import reference_of
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.check_command import verdict_on
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import HYBRID_TEST, errors_of, plan_run, play_run, run_of
from rths_cli.experiment.run_case import sim_of
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.numerics.lti import Array
from rths_cli.numerics.shared_values import SharedValues

BITS = (9, 16)
MOTION_BITS = (0.5, 50.0)  # largest acceleration of interface and floors in SIM
LARGEST_M_S2 = 3.0  # the same, so that the table has the stroke for it
RANGE_V = 20.0  # of the default rig's converters, from end to end
TESTS = 5  # of each laboratory
RIGHT = 1.5  # predicted over measured error, or the other way
PULSE_HZ = (1.0, 4.0)
DT_S, PULSE_S = 0.01, 12.0


@dataclass(frozen=True)
class Row:
    """One test: errors in m/s^2 of the worst storey, the one with the largest measured error."""

    about: str
    predicted: float = np.nan  # `check.expected_error_m_s2`
    measured: float = np.nan
    true_over_bound: float = np.nan  # of the storey where it is largest
    size: float = np.nan  # measured over SIM's RMS
    refused: str = ""  # why it was not played

    @property
    def ratio(self) -> float:
        """Return predicted over measured."""
        return self.predicted / self.measured

    @property
    def right(self) -> bool:
        """Return whether prediction and measurement agree."""
        return 1.0 / RIGHT <= self.ratio <= RIGHT


def laboratory(number: int, folder: Path) -> Iterator[Row]:
    """Yield the tests of a laboratory; `folder` receives its records."""
    random, memory = np.random.default_rng((number, 44)), Memory()
    rig, experimental = _laboratory(random)
    for place in range(TESTS):
        yield _played(_case(random, rig, experimental, folder, f"{number}_{place}"), random, memory)


def _laboratory(random: np.random.Generator) -> tuple[dict[str, object], dict[str, object]]:
    bits, floors = int(random.integers(BITS[0], BITS[1] + 1)), int(random.integers(1, 4))
    step_v = RANGE_V / 2**bits
    rig = {
        "extends": "aps400_virtual",
        "physics": {"coulomb_n": float(random.uniform(0.0, 1.5))},
        "converters": {"bits": bits, "latency_samples": int(random.integers(0, 4))},
    }
    if random.random() < 0.5:
        rig["imperfections"] = {"channels": {"offset_v": (step_v * random.uniform(-0.5, 0.5, 1 + floors)).tolist()}}
    masses = random.uniform(2.0, 6.0, floors)
    stiffness = masses.mean() * (2.0 * np.pi * _log(random, 3.0, 8.0) * floors) ** 2 * random.uniform(0.7, 1.4, floors)
    experimental = {
        "masses_kg": masses.tolist(),
        "stiffness_n_per_m": stiffness.tolist(),
        "damping_ratios": random.uniform(0.01, 0.06, floors).tolist(),
    }
    return rig, experimental


def _case(
    random: np.random.Generator, rig: dict[str, object], experimental: dict[str, object], folder: Path, name: str
) -> dict[str, object]:
    storeys = int(random.integers(1, 4))
    masses = random.uniform(3.0, 12.0, storeys)
    stiffness = (
        masses.mean() * (2.0 * np.pi * _log(random, 1.5, 5.0) * storeys) ** 2 * random.uniform(0.7, 1.4, storeys)
    )
    record = str(random.choice(["pulse", "el_centro", "hachinohe"], p=[0.5, 0.25, 0.25]))
    if record == "pulse":
        record = str(_pulse(folder / f"pulse_{name}.csv", _log(random, *PULSE_HZ)))
    return {
        "name": f"few_bits_{name}",
        "structure": {
            "numerical": {"masses_kg": masses.tolist(), "stiffness_n_per_m": stiffness.tolist()},
            "experimental": experimental,
        },
        "damping": {"first_mode_ratio": _log(random, 0.01, 0.06)},
        "record": record,
        "controller": str(random.choice(["FF+FB", "FF"])),
        "method": "paper" if random.random() < 0.1 else "best",
        "sample_rate_hz": float(random.choice([1000.0, 2000.0])),
        "runs": ["sim", "exp_rths"],
        "table": rig,
    }


def _pulse(path: Path, hz: float) -> Path:
    """Write a Ricker wavelet of 1 m/s^2 and return its path."""
    time_s = np.arange(0.0, PULSE_S, DT_S)
    argument = (np.pi * hz * (time_s - 1.5 / hz)) ** 2
    rows = np.stack([time_s, (1.0 - 2.0 * argument) * np.exp(-argument)], axis=1)
    np.savetxt(path, rows, delimiter=",", header="time_s,accel_m_s2", comments="")
    return path


def _played(case: dict[str, object], random: np.random.Generator, memory: Memory) -> Row:
    try:
        whole = _setup(case, 1.0)
    except InputError as error:  # damping that equal dashpots cannot give
        return Row(str(case["name"]), refused=str(error))
    first = len(whole.building.numerical.masses_kg) - 1
    sim = reference_of(whole.building).sim(whole.building, whole.rig.dt_s, whole.motion.accel_m_s2)
    step = whole.rig.converters.step_v / whole.rig.channels[0].sensitivity_v_per_unit
    asked = _log(random, MOTION_BITS[0], min(MOTION_BITS[1], LARGEST_M_S2 / step))
    setup = _setup(case, asked * step / float(np.abs(sim.abs_accel_m_s2[first:]).max()))
    about = f"{_bits(case)} bits, {asked:4.1f} of motion, {Path(str(case['record'])).stem}, {case['controller']}"
    about += f", {case['method']}" * (case["method"] != "best")
    try:
        known = memory.known(setup, lambda _: None)
        setup = setup.calibrated(known.found)
        checked = verdict_on(setup, known)
    except InputError as error:
        return Row(about, refused=str(error))
    if checked.design is None or checked.loop is None:
        return Row(about, refused="; ".join(checked.reasons))
    plan = plan_run(setup, checked.design, HYBRID_TEST, known.found)
    run = run_of(play_run(plan, 0), setup, HYBRID_TEST, checked.design.blocks.lead_samples, plan.expected)
    if run.stopped is not None:
        return Row(about, refused=f"{checked.verdict}; stopped: {run.stopped.reason}")
    reference = sim_of(setup, SharedValues())
    found = errors_of(run, setup, reference)
    measured, true = (np.asarray(found[f"exp_rths.rms_error_m_s2{end}"]) for end in ("", "_true"))
    expected = np.asarray(checked.figures["check.expected_error_m_s2"])
    bound = np.asarray(checked.figures["check.true_error_bound_m_s2"])
    worst = int(np.argmax(measured))
    size = float(measured[worst] / np.sqrt(np.mean(reference.abs_accel_m_s2[worst] ** 2)))
    return Row(about, float(expected[worst]), float(measured[worst]), float(np.max(true / bound)), size)


def _bits(case: dict[str, object]) -> int:
    table = case["table"]
    assert isinstance(table, dict)
    return int(table["converters"]["bits"])


def _setup(case: dict[str, object], scaling: float) -> Setup:
    return make_setup(load_cases([case | {"scaling": scaling}])[0], ("check", "model"))


def _log(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def summary(rows: Sequence[Row]) -> str:
    """Return the counts that are asked for."""
    played = [row for row in rows if not row.refused]
    ratios: Array = np.array([row.ratio for row in played])
    low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
    right, above = sum(row.right for row in played), sum(row.true_over_bound > 1.0 for row in played)
    return (
        f"{len(played)} played, {len(rows) - len(played)} not; predicted / measured within {RIGHT} in {right} of "
        f"{len(played)} ({low:.2f} 5 %, {middle:.2f}, {high:.2f} 95 %); true error above the bound in {above}"
    )
