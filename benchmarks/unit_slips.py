"""Put slips of units into right files and print those that nothing refuses, doubts or warns of before a table moves.

    python benchmarks/unit_slips.py [--drawn 3] [--right 200] [--bases NAME ...]

Every number of case, structure, rig and record of the base cases (shipped ones, real rigs, some drawn at random) is
multiplied and divided by 9.81, 1e3, 1e6, 0.4536 and 25.4, one value or one list at a time. Then right buildings and
rigs are drawn at random (tables of 1 kg to 2 t payload, 1 to 10 storeys, 0.5 to 30 Hz), which are not to be doubted.
What is silent here may still be refused by the check, which needs an identification. Exit code 1 when more than 5 % of
the right files are doubted, or a slip by 1e3 or 1e6 of a limit, a sensor or a mass is silent.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests" / "helpers")]

from campaigns.unit_slips import FACTORS, bases, factor_of, fates, must_be_noticed, right_doubts  # noqa: E402
from options import arguments, parsed  # noqa: E402

SHORT = ("--bases", "none", "--right", "5")
PRINTS = "^right files doubted: 0 of 5"  # the short form at its end

LARGEST_SHARE = 0.05  # of right files that may be doubted


def main() -> int:
    """Print the fate of every slip, and the right files that are doubted."""
    parser = arguments(__doc__)
    parser.add_argument("--drawn", type=int, default=3, help="base cases drawn at random")
    parser.add_argument("--right", type=int, default=200, help="right files drawn at random")
    parser.add_argument("--bases", nargs="*", help="names of the base cases; default: all")
    given = parsed(parser, SHORT)
    chosen = {name: case for name, case in bases(given.drawn).items() if not given.bases or name in given.bases}
    counts: Counter[tuple[str, float]] = Counter()
    silent: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        for fate in fates(chosen, Path(folder)):
            counts[fate.found, factor_of(fate.slip)] += 1
            missed += fate.found == "silent" and must_be_noticed(fate.slip)
            if fate.found in ("silent", "doubted elsewhere"):
                entry = fate.slip.place[-1] if isinstance(fate.slip.place[-1], int) else ""
                silent[fate.slip.base, f"{fate.slip.key} {entry}"].append(f"{fate.slip.factor:.4g}")
    print(f"{'':18}" + "".join(f"{factor:>10g}" for factor in FACTORS))
    for found in ("refused", "doubted", "warned", "doubted elsewhere", "silent"):
        print(f"{found:18}" + "".join(f"{counts[found, factor]:>10}" for factor in FACTORS))
    for (base, key), factors in silent.items():
        print(f"  {base}: {key}: {', '.join(factors)}")
    doubted = [(seed, found) for seed in range(given.right) if (found := right_doubts(seed))]
    print(f"right files doubted: {len(doubted)} of {given.right}")
    for seed, found in doubted:
        print(f"  {seed}: {found[0]}")
    return 1 if missed or len(doubted) > LARGEST_SHARE * given.right else 0


if __name__ == "__main__":
    sys.exit(main())
