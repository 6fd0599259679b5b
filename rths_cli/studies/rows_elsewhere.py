"""Rows of a sweep that another process computes: what it is told, and what it does. It has no file of the sweep."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from rths_cli.case.load import PlacedSettings, WrittenCase, load_written
from rths_cli.errors import RthsError
from rths_cli.experiment.allocator_settings import keep_freed_memory
from rths_cli.experiment.model_files import software
from rths_cli.numerics.shared_values import SharedValues
from rths_cli.quantities import METRICS
from rths_cli.studies.sweep_runs import Shared, not_ready, play_variant
from rths_cli.studies.sweep_table import Row
from rths_cli.version import __version__

SEVERAL = "a worker runs rths {theirs}, this process rths {ours}{why}; install the same on all of them"
SAME_NUMBER = ", with other sources or another Python, numpy, scipy or numba"
_SHARED = SharedValues(size=1)  # what rows share, of the sweep that this process works for


class OtherSoftwareError(RthsError):
    """A worker has another rths, Python or numerical package than the process that asks it."""

    exit_code = 2

    def __init__(self, theirs: str, ours: str) -> None:
        super().__init__(SEVERAL.format(theirs=theirs, ours=ours, why=SAME_NUMBER if theirs == ours else ""))
        self._told = theirs, ours

    def __reduce__(self) -> tuple[type[OtherSoftwareError], tuple[str, str]]:
        """Return how the error is made again in the process that asked."""
        return type(self), self._told


@dataclass(frozen=True)
class Work:
    """What all rows of a sweep have in common: its case as written, with absolute paths, the settings of all rows, the
    metrics that are kept, how many storeys a row has room for, and the software that asks."""

    plan_sha256: str
    case: WrittenCase
    settings: PlacedSettings
    overrides: tuple[str, ...]
    metrics: tuple[str, ...]
    storeys: int
    software_sha256: str
    version: str


@dataclass(frozen=True)
class PointRows:
    """Rows of one grid point: its varied values as settings, and number and seed of each row."""

    varied: PlacedSettings
    rows: tuple[tuple[int, int], ...]


Chunk = tuple[PointRows, ...]
"""Rows that one process computes one after another."""


def check_software(sha256: str, version: str) -> None:
    """Raise OtherSoftwareError where this process runs another software."""
    if software() != sha256:
        raise OtherSoftwareError(__version__, version)


def play_chunk(work: Work, chunk: Chunk) -> list[Row]:
    """Return the rows of a chunk; raises OtherSoftwareError before the first where this is another software."""
    check_software(work.software_sha256, work.version)
    shared = _SHARED.get("shared", (work.plan_sha256, work.overrides), lambda: _begun(work))
    return [row for point in chunk for row in _rows(shared, work, point)]


def _begun(work: Work) -> Shared:
    keep_freed_memory()
    return Shared(work.overrides, lambda _: None)


def _rows(shared: Shared, work: Work, point: PointRows) -> Iterator[Row]:
    columns = [METRICS[path] for path in work.metrics]
    try:
        ready = shared.ready(load_written(work.case, work.settings, point.varied))
    except Exception as error:
        blank = not_ready(point.rows[0][0], columns, work.storeys, error)
        yield from (replace(blank, variant=variant) for variant, _ in point.rows)
        return
    for variant, seed in point.rows:
        yield play_variant(ready, variant, seed, columns, work.storeys)
