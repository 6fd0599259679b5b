"""Print how long the step, its rivals, SIM and whole commands take on this machine: make bench.

python benchmarks/run.py [--short] [step] [rivals] [sim] [commands] [growth] [sweep] [channels] [laws]

--short: everything as small as it can be, to see that it runs; the figures mean nothing.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # before numpy is imported: one core against one core
TREE = Path(__file__).parents[1]
sys.path[:0] = [str(TREE), str(TREE / "tests" / "helpers")]  # the sources this file belongs to

from options import arguments, parsed  # noqa: E402
from speed.machine import machine  # noqa: E402
from speed.parts import PARTS, rows_of, shorten  # noqa: E402
from speed.rows import Row, text  # noqa: E402


def main() -> None:
    """Print the parts named, or all."""
    parser = arguments(__doc__)
    parser.add_argument("parts", nargs="*", help=f"of {', '.join(PARTS)}; default: all")
    parser.add_argument("--short", action="store_true", help="as small as can be")
    words = parsed(parser)
    if words.short:
        shorten()
    asked = words.parts or list(PARTS)
    if unknown := [name for name in asked if name not in PARTS]:
        sys.exit(f"no part is called {', '.join(unknown)}: choose from {', '.join(PARTS)}")
    rows: list[Row] = []
    for name in asked:
        start = time.perf_counter()
        rows += rows_of(name)
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    print(f"{machine()}\n\n{text(rows)}")


if __name__ == "__main__":
    main()
