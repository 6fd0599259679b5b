"""Is the error predicted where the motion is a few bits of the converters?

    python benchmarks/few_bits.py [--laboratories 12] [--first 0]

Each laboratory has five tests of 9 to 16 bits and motions of half a bit to fifty
(`tests/helpers/campaigns/few_bits.py`). Each row: predicted and measured error of the worst storey in mm/s^2, their
ratio, measured over SIM's RMS, and the true error over the bound that is stated with 95 %. Demanded: the ratio within
1.5 in 90 % of sixty tests, and at most six true errors above their bound; exit code 1 otherwise.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.few_bits import Row, laboratory, summary
from options import arguments, parsed

SHORT = ("--laboratories", "1")

WITHIN, ABOVE = 0.9, 0.1  # demanded shares


def main() -> int:
    """Play the tests and print their table; return the exit code."""
    parser = arguments(__doc__)
    parser.add_argument("--laboratories", type=int, default=12)
    parser.add_argument("--seed", "--first", dest="first", type=int, default=0, help="number of the first laboratory")
    asked = parsed(parser, SHORT)
    rows: list[Row] = []
    print(f"{'predicted':>9} {'measured':>9} {'ratio':>6} {'of SIM':>7} {'true/bound':>10}")
    with tempfile.TemporaryDirectory() as folder:
        for number in range(asked.first, asked.first + asked.laboratories):
            for row in laboratory(number, Path(folder)):
                rows.append(row)
                print(_line(row), flush=True)
    print(summary(rows))
    played = [row for row in rows if not row.refused]
    right, above = (sum(each) for each in zip(*((row.right, row.true_over_bound > 1.0) for row in played), strict=True))
    return 0 if right >= WITHIN * len(played) and above <= ABOVE * len(played) else 1


def _line(row: Row) -> str:
    if row.refused:
        return f"not played  {row.about}: {row.refused}"
    marks = "" if row.right else "  WRONG"
    return (
        f"{1e3 * row.predicted:9.3f} {1e3 * row.measured:9.3f} {row.ratio:6.2f} {row.size:7.1%} "
        f"{row.true_over_bound:10.2f}  {row.about}{marks}"
    )


if __name__ == "__main__":
    sys.exit(main())
