"""Studies without runs: a million rows in memory, and Sobol indices against known ones.

    python benchmarks/studies.py [ROWS]

The first part plans ROWS rows (default 1,000,000) of six axes, four of them correlated samples, goes through all of
them, fills the table with made-up figures, writes it, reads it back and makes its page; it prints the time and the
largest memory of a process that does only this. The second samples Ishigami's function and Sobol's g function by
`samples.method: sobol_indices` with N = 4096 and 20 seeds; it prints the largest deviation from the known indices in
bootstrap standard errors, and that of the mean over the seeds in standard errors of the scatter between seeds.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.synthetic_study import deviations, ishigami, one_point, sampled_indices, sobol_g, tabulate

COUNT, SEEDS = 4096, 20


def million(rows: int) -> None:
    """Print time and memory of a study of so many rows."""
    start = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        found = tabulate(rows, Path(folder), one_point())
        size = (Path(folder) / "many.h5").stat().st_size
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(
        f"{found.plan.variants} rows planned, tabulated, written and read: {time.monotonic() - start:.0f} s, "
        f"largest memory {peak / 1e6:.0f} MB, file {size / 1e6:.0f} MB"
    )


def indices() -> None:
    """Print how far the indices are off the known ones."""
    for name, known in (("Ishigami", ishigami()), ("Sobol g", sobol_g())):
        with tempfile.TemporaryDirectory() as folder:
            each = [sampled_indices(known, COUNT, seed, Path(folder)) for seed in range(SEEDS)]
        off = np.array([deviations(found, known) for found in each])
        values = np.array([[found.first, found.total] for found in each])
        mean_error = np.std(values, axis=0, ddof=1) / np.sqrt(SEEDS)
        mean_off = np.abs(values.mean(axis=0) - [known.first, known.total])
        print(
            f"{name}, N = {COUNT}, {SEEDS} seeds: largest deviation {np.abs(off).max():.2f} bootstrap standard errors, "
            f"{np.count_nonzero(np.abs(off) > 3)} of {off.size} beyond 3; mean over the seeds off by at most "
            f"{(mean_off / mean_error).max():.2f} of its standard errors ({mean_off.max():.5f})"
        )


if __name__ == "__main__":
    process = get_context("spawn").Process(target=million, args=(int(sys.argv[1]) if sys.argv[1:] else 1_000_000,))
    process.start()
    process.join()
    indices()
    sys.exit(process.exitcode)
