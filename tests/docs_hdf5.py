"""The reference page of result and model files, from files that a short run writes."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import chdir
from itertools import groupby
from pathlib import Path
from typing import Any

import h5py
from docs_running import run_words, shortened
from docs_words_hdf5 import ATTRIBUTES, BLOCKS, MODEL_ATTRIBUTES, MODEL_GROUPS, REAL_ATTRIBUTES, RUN_ATTRIBUTES, SIZES

from rths_cli.experiment.result_contents import DRIFT_TAKEN_OUT, LIVE

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"
ON_TABLE = ("shake_table_", "exp_rths_")
COLUMNS = ("dataset", "shape", "unit", "source", "holds")
HEAD = """# Result and model files (HDF5)

Made from the files of a short run by `python tests/docs_reference.py`; a test compares. Format version 1.

Every dataset has the attributes `units`, `long_name` (below: holds) and `source` (computed, measured, estimated,
true). Time or frequency is the last axis. Every group holds its own scales, so that a run that was stopped is shorter
than the record. Complex values are two datasets, `_real` and `_imag`. Runs that a case does not name are not there;
method `paper` has no `base_shear_unexplained_n`. [export.md](../export.md) shows how to read the files from Python and
MATLAB.

Shapes are given by their scales:

{sizes}
"""


def hdf5_page() -> str:
    """Return the page as Markdown: attributes, a table per group of a result, then a model file."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        shortened(ROOT / "records" / "el_centro.csv", Path("short.csv"), 400)
        run_words(["run", CASE, "--set", "record.file=short.csv", "--quiet"])
        run_words(["identify", CASE, "--output", "model.h5", "--no-figure"])
        with h5py.File(f"results/{CASE}.h5") as result, h5py.File("model.h5") as model:
            return "\n\n".join([*_result(result), *_model(model)]) + "\n"


def _result(file: Any) -> Iterator[str]:
    sizes = "\n".join(f"- `{name}`: {words}" for name, words in SIZES.items())
    yield HEAD.format(sizes=sizes).rstrip()
    yield "## Attributes of a result"
    own = [name for name in sorted(file.attrs) if not name.startswith(ON_TABLE)]
    yield _table(("attribute", "holds"), [(f"`{name}`", ATTRIBUTES[name]) for name in own])
    yield "For each run RUN on the table (`shake_table`, `exp_rths`), the second part on a real rig alone:"
    of_run = {**RUN_ATTRIBUTES, **REAL_ATTRIBUTES}
    yield _table(("attribute", "holds"), [(f"`RUN_{name}`", words) for name, words in of_run.items()])
    rows = [row for row in _rows(file) if not row[0].startswith(("`/metrics", "`/controller"))]
    for group, members in groupby(rows, key=lambda row: row[0].rpartition("/")[0]):
        yield f"## `{group.strip('`')}`"
        yield _table(COLUMNS, [*members, *_of_other_runs(group.strip("`"))])
    yield from _blocks(file["controller"])
    figures = (
        "One dataset per figure: [metrics.md](../metrics.md) lists them all. `/metrics/exp_rths/rms_error_m_s2` is "
    )
    yield "## `/metrics`"
    yield figures + "`exp_rths.rms_error_m_s2`. Beside the attributes above each has its `definition`."


def _of_other_runs(group: str) -> Iterator[tuple[str, ...]]:
    """Yield the rows of what only a run on a real rig, or on sensors that drift, writes."""
    if group in ("/exp_rths", "/shake_table"):
        about = f"{DRIFT_TAKEN_OUT} (only where there was any)"
        yield f"`{group}/sensor_drift_m_s2`", "(channel, time_s)", "m/s^2", "estimated", about
    if group == "/exp_rths/timing":
        for name, (unit, about) in LIVE.items():
            yield f"`{group}/{name}`", "(time_s)", unit, "measured", f"{about} (real rig only)"


def _blocks(controller: Any) -> Iterator[str]:
    yield "## `/controller/BLOCK`"
    yield (
        "A discrete block of the step, x[k+1] = A x + B u, y = C x + D u, with the attributes `name`, `dt_s` (s), "
        "`inputs` and `outputs` (names with units). The blocks are:"
    )
    yield _table(("block", "does"), [(f"`{name}`", BLOCKS[name]) for name in sorted(controller)])
    first = next(iter(controller.values()))
    rows = [("`/controller/BLOCK/" + row[0].rpartition("/")[2], *row[1:]) for row in _rows(first)]
    yield _table(
        COLUMNS, [tuple(cell.replace(f"of {first.attrs['name']}", "of the block") for cell in r) for r in rows]
    )


def _model(file: Any) -> Iterator[str]:
    yield "## Model files"
    yield "What `rths identify` writes; what was not found is left out."
    yield _table(("attribute", "holds"), [(f"`{name}`", MODEL_ATTRIBUTES[name]) for name in sorted(file.attrs)])
    groups = groupby(_rows(file), key=lambda row: row[0].strip("`").rpartition("/")[0])
    rows = [(f"`{group}`", MODEL_GROUPS[group.split("/")[1]], _named(members)) for group, members in groups]
    yield _table(("group", "holds", "datasets (unit)"), rows)


def _named(rows: Iterable[tuple[str, ...]]) -> str:
    """Return the datasets of a group with their units."""
    return ", ".join(f"`{row[0].strip('`').rpartition('/')[2]}` ({row[2]})" for row in rows)


def _rows(group: Any) -> Iterator[tuple[str, ...]]:
    """Yield a row per dataset of a file or group, group by group, in alphabetical order."""
    found: list[Any] = []
    group.visititems(lambda _, node: found.append(node) if isinstance(node, h5py.Dataset) else None)
    for node in sorted(found, key=lambda one: one.name.rpartition("/")[::2]):
        about = {key: str(node.attrs[key]) for key in ("units", "source", "long_name")}
        yield f"`{node.name}`", _shape(node), about["units"], about["source"], about["long_name"].replace("|", "\\|")


def _shape(node: Any) -> str:
    """Return the axes of a dataset by the names of their scales."""
    if node.is_scale:
        return f"({node.name.rpartition('/')[2]})"
    names = [axis[0].name.rpartition("/")[2] if len(axis) else "?" for axis in node.dims]
    return f"({', '.join(names)})" if names else "one value"


def _table(columns: tuple[str, ...], rows: Any) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (columns, ("---",) * len(columns), *rows))
