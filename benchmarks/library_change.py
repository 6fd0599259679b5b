"""Show that numerics taken over from a library change no figure that anybody reads: record, change the code, compare.

    python benchmarks/library_change.py record BEFORE --seeds 20
    python benchmarks/library_change.py record AFTER --models BEFORE
    python benchmarks/library_change.py compare BEFORE AFTER

A recording holds cases of the paper by method best, one by method paper, the bare specimen and three random buildings:
identified models, result files, and with `--seeds` the errors of EXP-RTHS with that many seeds. `--long` records all
eight cases of the paper and six random buildings. Tests run with models of the folder after `--models`, so that the
controllers of both recordings are designed from the same ones; each recording identifies its own models as well.
`compare` prints one line per demand: the largest difference, its limit, and where it is. Exit code 1 when a demand is
not met. Where every bit must agree, `unchanged.py` compares byte by byte.

Two limits are what rounding itself moves. The same exponential with one more halving changes margins of the bare
specimen by 8e-9: a lightly damped motion sampled fast is a matrix near one, whose last bits are its damping. A last bit
also sets other bits of the converters, and EXP-RTHS is a new draw: 4 standard deviations of the difference of two draws
are 1.5 times the range of twenty.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from options import arguments, parsed
from scipy.optimize import linear_sum_assignment
from unchanged import BARE, PAPER, rths, write_case

SHORT_PAPER, SHORT_RANDOM = ("el_centro_low_ff_fb", "el_centro_high_ff", "hachinohe_high_ff_fb"), (3, 1, 17)
LONG_RANDOM = (*SHORT_RANDOM, 2, 4, 13)
BY_PAPER = "el_centro_low_ff"  # the case that runs by method paper, too
OVERRIDE = ["--override", "check"]  # the check refuses the bare specimen
IDENTIFIED = {  # group of a model file: value and standard error of the same shape
    "roots": (("frequency_hz", "frequency_error_hz"), ("damping_ratio", "damping_error")),
    "specimen/excitation": (
        ("natural_frequency_hz", "frequency_error_hz"),
        ("damping_ratio", "damping_error"),
        ("stiffness_n_per_m", "stiffness_error_n_per_m"),
    ),
    "friction": (("command_v", "error_v"),),
    "latency": (("identified_s", "error_s"),),
}
MARGINS = (  # how names of the margins and poles among the check values begin
    "gain_", "phase_", "delay_", "sensitivity_", "critical_", "tolerated_", "required_", "table_error_", "spectral_",
    "building_", "loop_",
)  # fmt: skip
LIMITS = {
    "SIM and SIM-DELAY over their peak": 1e-9,
    "A, B, C, D of blocks over the largest entry": 1e-9,
    "poles of blocks": 1e-9,
    "margins, relative": 1e-8,
    "other check values, relative": 1e-6,  # a radius to the power of the samples, differences of nearly equal numbers
    "identified values over their standard error": 0.01,
    "EXP-RTHS errors over the range of the seeds": 1.5,
}


@dataclass(frozen=True)
class Difference:
    """A difference between two recordings, over what it is measured by, and where it is."""

    demand: str
    size: float
    where: str


def main() -> int:
    """Record or compare."""
    parser = arguments(__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    record_parser = commands.add_parser("record")
    record_parser.add_argument("folder", type=Path)
    record_parser.add_argument("--models", type=Path, help="recording whose models the tests use [default: its own]")
    record_parser.add_argument("--seeds", type=int, default=0, help="number of seeds of the errors' scatter")
    record_parser.add_argument("--long", action="store_true", help="all cases of the paper, six random buildings")
    compare_parser = commands.add_parser("compare")
    compare_parser.add_argument("before", type=Path)
    compare_parser.add_argument("after", type=Path)
    given = parsed(parser)
    if given.command == "record":
        record(given.folder, (given.models or given.folder).resolve(), given.seeds, given.long)
        return 0
    return compare(given.before, given.after)


def record(folder: Path, models: Path, seeds: int, long: bool) -> None:
    """Identify, run and sweep in an empty folder, with the models of a recording."""
    folder.mkdir(parents=True)
    paper = PAPER if long else list(SHORT_PAPER)
    random = [write_case(folder, seed) for seed in (LONG_RANDOM if long else SHORT_RANDOM)]
    specimens = {"paper": paper, "bare": [BARE], **{name: [name] for name in random}}
    for specimen, cases in specimens.items():
        own, used = f"models/{specimen}.h5", f"identification.model={models / 'models' / specimen}.h5"
        called(folder, "identify", cases[0], "--no-figure", "--quiet", "--output", own)
        called(folder, "run", *cases, "--set", used, *OVERRIDE, "--method", "best", "--output", "best")
        if specimen == "paper":
            called(folder, "run", BY_PAPER, "--set", used, *OVERRIDE, "--method", "paper", "--output", "paper")
        for case in cases if seeds else []:
            words = ["--set", used, *OVERRIDE, "--quiet", "--seeds", str(seeds), "--output", f"seeds/{case}.h5"]
            called(folder, "sweep", case, *words)


def called(folder: Path, *words: str) -> None:
    """Run a command in the folder; end this program where it fails."""
    print(*words[:2], flush=True)
    ended = rths(folder, words)
    if ended.returncode:
        sys.exit(f"rths {' '.join(words)}: exit code {ended.returncode}\n{ended.stdout}{ended.stderr}")


def compare(before: Path, after: Path) -> int:
    """Print one line per demand; return the exit code."""
    found = [*run_differences(before, after), *model_differences(before, after)]
    missed = 0
    for demand, limit in LIMITS.items():
        of_demand = [each for each in found if each.demand == demand]
        worst = max(of_demand, key=lambda each: each.size, default=None)
        met = worst is not None and worst.size <= limit  # NaN is not
        missed += not met
        worst_text = f"{worst.size:.2g} at {worst.where}" if worst else "nothing to compare"
        print(f"{'met' if met else 'NOT MET':8}{demand}: {worst_text} (limit {limit:g}, {len(of_demand)} compared)")
        for each in sorted(of_demand, key=lambda each: -each.size)[1:9] if not met else []:
            print(f"{'':8}{each.size:.2g} at {each.where}")
    return 1 if missed else 0


def run_differences(before: Path, after: Path) -> Iterator[Difference]:
    """Yield the differences of series, blocks and metrics of every run."""
    for path in sorted([*before.glob("best/*.h5"), *before.glob("paper/*.h5")]):
        name = path.relative_to(before)
        with h5py.File(path) as one, h5py.File(after / name) as other:
            for series in (f"{group}/{each}" for group in ("sim", "sim_delay") for each in one[group]):
                if one[series].dtype.kind == "f" and not series.endswith("time_s"):
                    yield Difference("SIM and SIM-DELAY over their peak", apart(one[series], other[series]),
                                     f"{name} {series}")  # fmt: skip
            for block in one["controller"]:
                yield from block_differences(one["controller"][block], other["controller"][block], f"{name} {block}")
            yield from metric_differences(one["metrics"], other["metrics"], before, name)


def block_differences(one: h5py.Group, other: h5py.Group, where: str) -> Iterator[Difference]:
    """Yield the differences of the matrices of a block, and of its poles."""
    for matrix in "ABCD":
        if one[matrix].size:
            yield Difference("A, B, C, D of blocks over the largest entry", apart(one[matrix], other[matrix]),
                             f"{where} {matrix}")  # fmt: skip
    if one["A"].size:
        poles, others = (np.linalg.eigvals(each["A"][()]) for each in (one, other))
        distance = np.abs(poles[:, None] - others)
        yield Difference("poles of blocks", float(distance[linear_sum_assignment(distance)].max()), where)


def metric_differences(one: h5py.Group, other: h5py.Group, before: Path, name: Path) -> Iterator[Difference]:
    """Yield the differences of check values, and of the errors of EXP-RTHS that were recorded with several seeds."""
    for group in ("check", "feedback"):
        for each in one.get(group, ()):
            if one[group][each].dtype.kind == "f":
                kind = "other check values" if group == "check" and not each.startswith(MARGINS) else "margins"
                yield Difference(f"{kind}, relative", apart(one[group][each], other[group][each]),
                                 f"{name} {group}.{each}")  # fmt: skip
    seeds = before / "seeds" / name.name
    if name.parts[0] == "best" and seeds.exists():
        with h5py.File(seeds) as sweep:
            for path in sorted(path for path in sweep if path.startswith("exp_rths.")):
                values, metric = sweep[path][()], path.removeprefix("exp_rths.")
                spread = np.ptp(values, axis=0)
                moved = np.abs(other["exp_rths"][metric][()] - one["exp_rths"][metric][()])
                size = float((moved / np.where(moved > 0.0, spread, 1.0)).max())
                yield Difference("EXP-RTHS errors over the range of the seeds", size, f"{name} {path}")


def model_differences(before: Path, after: Path) -> Iterator[Difference]:
    """Yield the differences of what was identified over its standard error, where the model states one."""
    for path in sorted(before.glob("models/*.h5")):
        with h5py.File(path) as one, h5py.File(after / "models" / path.name) as other:
            for group, value, error in ((group, *pair) for group, pairs in IDENTIFIED.items() for pair in pairs):
                where = f"{path.name} {group}/{value}"
                values, errors = (np.atleast_1d(one[group][each][()]) for each in (value, error))
                others = np.atleast_1d(other[group][value][()])
                stated = np.isfinite(errors)
                alike = values.shape == others.shape and stated.any()
                size = float((np.abs(others - values) / errors)[stated].max()) if alike else float("inf")
                yield Difference("identified values over their standard error", size, where)


def apart(one: h5py.Dataset, other: h5py.Dataset) -> float:
    """Return the largest difference over the largest value; infinite where shapes or infinite values differ."""
    left, right = np.atleast_1d(one[()]), np.atleast_1d(other[()])
    if left.shape != right.shape:
        return float("inf")
    finite = np.isfinite(left)
    if not (np.array_equal(finite, np.isfinite(right)) and np.array_equal(left[~finite], right[~finite], True)):
        return float("inf")
    difference = np.abs(left[finite] - right[finite]).max(initial=0.0)
    return float(difference / np.abs(left[finite]).max()) if difference else 0.0


if __name__ == "__main__":
    sys.exit(main())
