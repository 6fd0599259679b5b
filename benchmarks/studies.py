"""Studies without runs: a million rows in memory, and Sobol indices against known ones.

    python benchmarks/studies.py [ROWS]

The first part plans ROWS rows (default 1,000,000) of six axes, four of them correlated samples, goes through all of
them, fills the table with made-up figures, writes it, reads it back and makes its page; it prints the time and the
largest memory of a process that does only this. So it does of a process that joins ten parts of that table, and of one
that takes the rows of an interrupted sweep. The last part samples Ishigami's function and Sobol's g function by
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
from options import arguments, parsed

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from campaigns.synthetic_study import (
    about,
    deviations,
    ishigami,
    kept_rows,
    one_point,
    planned,
    sampled_indices,
    sobol_g,
    tabulate,
    written_parts,
)

from rths_cli.report.sweep_page import page
from rths_cli.studies.merge import merge_parts
from rths_cli.studies.sweep_output import Begun, take_rows
from rths_cli.studies.sweep_table import Table

SHORT = ("--rows", "1000")

COUNT, SEEDS, PARTS = 4096, 20, 10


def million(rows: int, folder: Path) -> None:
    """Print time and memory of a study of so many rows."""
    start = time.monotonic()
    found = tabulate(rows, folder, one_point())
    size = (folder / "many.h5").stat().st_size
    tell(f"{found.plan.variants} rows planned, tabulated, written and read (file {size / 1e6:.0f} MB)", start)


def prepare(rows: int, folder: Path) -> None:
    """Write the parts of a study, and the rows of an interrupted one."""
    written_parts(rows, PARTS, folder, one_point())
    kept_rows(rows, folder, one_point())


def join(rows: int, folder: Path) -> None:
    """Print time and memory of joining the parts."""
    start = time.monotonic()
    paths = [folder / f"part{k}.h5" for k in range(1, PARTS + 1)]
    sweep, *_ = merge_parts(paths, folder / "merged.h5", True, "benchmarks/studies.py")
    page(sweep, folder / "merged.h5")
    tell(f"{len(sweep.seed)} rows of {PARTS} parts joined", start)


def resume(rows: int, folder: Path) -> None:
    """Print time and memory of taking the rows of an interrupted sweep."""
    points = planned(rows, folder, one_point())
    start = time.monotonic()
    table = Table(points.columns, points.storeys, np.arange(rows))
    take_rows(Begun(folder / "kept.h5", about(points), True), table)
    tell(f"{rows - table.left} kept rows taken", start)


def tell(what: str, start: float) -> None:
    """Print what was done since a time, how long it took, and the largest memory of this process."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    print(f"{what}: {time.monotonic() - start:.0f} s, largest memory {peak / 1e6:.0f} MB", flush=True)


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


def main() -> int:
    """Run each part in a process of its own, return the first exit code that is not 0."""
    parser = arguments(__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    rows = parsed(parser, SHORT).rows
    with tempfile.TemporaryDirectory() as name:
        for part in (million, prepare, join, resume):
            process = get_context("spawn").Process(target=part, args=(rows, Path(name)))
            process.start()
            process.join()
            if process.exitcode:
                return process.exitcode
    indices()
    return 0


if __name__ == "__main__":
    sys.exit(main())
