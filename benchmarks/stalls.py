"""What stalls of the runner cost in accuracy, in simulated time: no network, no clock, nothing of this machine.

python benchmarks/stalls.py [--seeds 4]

El Centro at 1 kHz, FF+FB, on the served table. RMS error to SIM over that without a stall, mean and largest of the
storeys over the seeds that place the stalls.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from options import arguments, parsed

TREE = Path(__file__).parents[1]
sys.path[:0] = [str(TREE), str(TREE / "tests" / "helpers")]

from stalling import Laboratory, laboratory_of  # noqa: E402

from rths_cli.numerics.lti import Array  # noqa: E402

SHORT = ("--seeds", "1")

RECORD, RAMP = 53_741, 1_000
LENGTHS_MS = (1, 3, 7, 15, 30, 50, 80, 100)
ROWS = ((12_000, True), (1_000, True), (12_000, False))  # a stall every so many ms, a rig that is told


def ratios(laboratory: Laboratory, calm: Array, every: int, told: bool, length: int, seeds: int) -> Array:
    """Return the errors' ratios (seeds, storeys) with a stall about every so many steps."""
    found = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        at = RAMP + np.cumsum(random.integers(2 * every // 3, 4 * every // 3, RECORD // every))
        run, _ = laboratory.run(at[at < RAMP + RECORD - 200], length, told)
        found.append(laboratory.errors(run) / calm)
    return np.array(found)


def main() -> None:
    """Print the table."""
    parser = arguments(__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    seeds = parsed(parser, SHORT).seeds
    laboratory = laboratory_of(RECORD)
    calm = laboratory.errors(laboratory.run(np.zeros(0, np.int64), 0)[0])
    print(f"without a stall {', '.join(f'{1e3 * error:.3f}' for error in calm)} mm/s^2 RMS, storey by storey")
    print("one every  " + "".join(f"{length:>8} ms  " for length in LENGTHS_MS))
    for every, told in ROWS:
        each = [ratios(laboratory, calm, every, told, length, seeds) for length in LENGTHS_MS]
        cells = "".join(f"{one.mean():>6.2f}{one.max():>7.2f}" for one in each)
        print(f"{every / 1000:>4g} s {'told' if told else 'held'} {cells}", flush=True)


if __name__ == "__main__":
    main()
