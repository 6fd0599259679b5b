"""Is the exported step in C the compiled step? Drawn cases, played open loop by both on the same samples.

    python benchmarks/c_step_cases.py [--seed 1] [--count 30]

Linear storeys and one to three storeys of each law with drawn figures, three methods, lost samples, and an end: none,
the operator's, a limit of the guard, a sample that is no number, too many lost ones. Each is played without rounding
(every signal within 1e-10 of its peak) and with it (every code of the converter equal). The guard has to act at the
same sample for the same reason. Last: speed of C over ours, by turns. Exit code 1 where a case differs.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

import numpy as np
from bench import rig_info
from campaigns.exported_step import (
    EQUAL,
    FAST,
    RAMP,
    STILL,
    STOPPED,
    bench_step,
    compiled,
    compiler,
    differences,
    played,
    recorded,
)
from hybrid import best_like, ground, open_limits, paper_like, reacting, storeys
from numpy.random import Generator
from options import arguments, parsed

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.storeys_with_laws import StoreysWithLaws
from rths_cli.experiment.designed_step import DesignedStep
from rths_cli.loop.recorded_steps import Conducted, Recorded, conduct_over
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import storey_matrix
from rths_cli.structure.storey_laws import (
    Bilinear,
    BoucWen,
    Clough,
    Cubic,
    ElasticGap,
    Friction,
    Law,
    Maxwell,
    Softening,
    ViscousPower,
    arranged,
)

SHORT = ("--count", "2")
PRINTS = "2 of 2 cases agree"  # the short form at its end
SAME, STEPS, PAIRS = 1e-10, 1200, 5  # demand: difference of signals over their peaks
Draw = Callable[[float], float]

LAWS: dict[str, Callable[[Draw], Law]] = {
    "bilinear": lambda f: Bilinear(f(5000.0), f(2e-4), 0.05),
    "friction": lambda f: Friction(f(3.0), f(1e-4)),
    "clough": lambda f: Clough(f(4000.0), f(2e-4), 0.05, f(0.3)),
    "gap": lambda f: ElasticGap(f(20000.0), f(2e-4)),
    "cubic": lambda f: Cubic(f(7000.0) / 0.004**2, 0.01),
    "softening": lambda f: Softening(f(3000.0), 0.3, f(1e-3)),
    "viscous": lambda f: ViscousPower(f(8.0), f(0.4)),
    "maxwell": lambda f: Maxwell(f(4000.0), f(60.0)),
    "Bouc-Wen": lambda f: BoucWen(f(5000.0), f(2e-4), 0.05, f(2.0)),
    "Bouc-Wen that degrades": lambda f: BoucWen(
        f(5000.0), f(2e-4), 0.05, 1.0, 0.6, 0.4, f(2e-3), f(0.02), f(0.05), 0.7, 1.0, 0.1, 0.2, 0.01, 0.3
    ),
}
KINDS = ("linear", "reaction and friction countered", "printed method", *LAWS)
ENDS = ("none", "operator", "acceleration", "saturation", "force", "no number", "lost")


def blocks_of(kind: str, info: RigInfo, rng: Generator) -> Blocks:
    """Return the blocks of a kind of case, with drawn figures."""
    if kind == "printed method":
        return paper_like(info, dashpot_n_s_per_m=rng.uniform(5.0, 60.0))
    if kind == "reaction and friction countered":
        blocks = reacting(info)
        counters = FrictionFeedforward(blocks.feedforward, 0.05, 2e-3, rng.uniform(0.2, 1.0), 1e-3, 0.1)  # type: ignore[arg-type]
        return replace(blocks, feedforward=counters, command_limit_v=9.0, feedback_limit_v=rng.choice([1e-4, 1.0]))
    blocks = best_like(info, numerical_storeys=int(rng.integers(1, 4)))
    if kind == "linear":
        return blocks
    laws = tuple((LAWS[kind](lambda x: x * 2.0 ** rng.uniform(-0.5, 0.5)),) for _ in range(rng.integers(1, 4)))
    whole = storeys(len(laws))
    stiff, damped = (storey_matrix([sum(law.at_rest[i] for law in one) for one in laws]) for i in range(2))
    numerical = replace(whole, K=whole.K + stiff, C=whole.C + damped)
    return replace(blocks, numerical=StoreysWithLaws(numerical, arranged(laws), info.dt_s))


def drawn(number: int, seed: int) -> tuple[str, DesignedStep, Recorded]:
    """Return what a case is, its step without rounding, and its samples; limits are shares of its own peaks."""
    rng = np.random.default_rng((seed, number))
    kind, end = KINDS[number % len(KINDS)], ENDS[number % len(ENDS)]
    info = rig_info(latency_samples=int(rng.integers(1, 3)))
    drive = rng.uniform(0.5, 2.0) * (8.0 if kind in LAWS else 1.0) * np.roll(ground(STEPS), rng.integers(0, 99), axis=0)
    step = bench_step(info, blocks_of(kind, info, rng), open_limits(info), drive)
    samples = _samples(info, drive / (8.0 if kind in LAWS else 1.0), rng)
    lost = set(map(int, rng.integers(STILL + RAMP + 50, 500, 4))) | {500, 501}
    free = conduct_over(info, step.blocks, step.limits, recorded(step, samples, sorted(lost)))
    share, limits = rng.uniform(0.4, 0.8), step.limits
    if end == "acceleration":
        limits = limits._replace(abort=share * np.abs(free.log.corrected).max(axis=1))
    elif end == "saturation":
        limits = limits._replace(saturation_v=share * np.abs(samples).max(axis=0))
    elif end == "force":
        limits = limits._replace(force_n=share * float(np.abs(free.log.base_shear_n).max()))
    elif end == "no number":
        samples[700, rng.integers(3)] = np.nan
    elif end == "lost":
        lost |= set(range(600, 610))
    stop_at = int(rng.integers(600, 1100)) if end == "operator" else None
    about = f"{kind}, latency {info.latency_samples}, {len(lost)} lost, end: {end}"
    return about, replace(step, limits=limits), recorded(step, samples, sorted(lost), stop_at)


def _samples(info: RigInfo, drive: Array, rng: Generator) -> Array:
    """Return samples (n, c) in V: the ground's acceleration, later at each floor, and noise."""
    samples = 1e-3 * rng.standard_normal((STILL + RAMP + len(drive), len(info.channels)))
    for c, one in enumerate(info.channels):
        late = 3 + 20 * c
        samples[STILL + RAMP + late :, c] += 0.3 * one.sensitivity_v_per_unit * drive[: len(drive) - late, 0]
    return samples


def faults(step: DesignedStep, given: Recorded, ends: bool, folder: Path) -> tuple[list[str], float, Conducted]:
    """Return what differs in a case, the largest difference of commands over their peak, and what ours did."""
    ours = conduct_over(step.info, step.blocks, step.limits, given)
    theirs = played(compiled(step, folder, EQUAL), given)
    found = list(differences(ours, theirs, SAME))
    if ends != (ours.reason != 0):
        found.append(f"was to end otherwise than with reason {ours.reason}")  # the draw says nothing
    moving = ours.log.state < STOPPED
    peak = float(np.abs(ours.log.command_v).max())
    apart = float(np.abs(ours.log.command_v - theirs.command_v)[moving].max()) / peak
    step_v = step.info.converters.step_v
    rounded = replace(step, blocks=replace(step.blocks, shaping_step_v=step_v))
    ours_v = conduct_over(step.info, rounded.blocks, step.limits, given).log.command_v[moving]
    theirs_v = played(compiled(rounded, folder, EQUAL), given).command_v[moving]
    if other := int(np.count_nonzero(np.rint(ours_v / step_v) != np.rint(theirs_v / step_v))):
        found.append(f"{other} codes of the converter differ")
    return found, apart, ours


def ratio(step: DesignedStep, given: Recorded, options: tuple[str, ...], folder: Path) -> float:
    """Return the median time of C over ours, by turns."""
    library = compiled(step, folder, options)
    pairs = [
        (played(library, given).seconds, conduct_over(step.info, step.blocks, step.limits, given).seconds)
        for _ in range(PAIRS)
    ]
    return statistics.median(theirs / ours for theirs, ours in pairs)


def main() -> int:
    """Play the cases, print a line of each; return 1 where one differs."""
    given = parsed(arguments(__doc__, seed=1, count=30), SHORT)
    if compiler() is None:
        print("no C compiler here")
        return 0
    good, worst, ratios = 0, 0.0, []
    with tempfile.TemporaryDirectory() as name:
        for number in range(given.count):
            about, step, samples = drawn(number, given.seed)
            found, apart, ours = faults(step, samples, not about.endswith("none"), Path(name))
            good, worst = good + (not found), max(worst, apart)
            peak_v = np.abs(ours.log.command_v).max()
            said = "; ".join(found) or f"agree, commands within {apart:.1e} of {peak_v:.2g} V, reason {ours.reason}"
            print(f"{number:>3} {about}: {said}", flush=True)
            if number < len(KINDS) and about.endswith(("none", "operator")):
                ratios.append([ratio(step, samples, options, Path(name)) for options in (FAST, EQUAL[:1])])
    for options, column in zip((FAST, EQUAL[:1]), np.transpose(ratios), strict=True):
        print(f"C, {' '.join(options)}, over ours: {np.median(column):.2f} ({column.min():.2f} to {column.max():.2f})")
    print(f"{good} of {given.count} cases agree; commands before rounding within {worst:.1e} of their peak")
    return int(good < given.count)


if __name__ == "__main__":
    sys.exit(main())
