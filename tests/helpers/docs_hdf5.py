"""The reference page of result, model and sweep files, from the declarations of what they hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any

from rths_cli.quantities import AXES, BLOCKS, AttributeDeclaration, DatasetDeclaration
from rths_cli.quantities.attributes import OF_BLOCK, OF_FILE, OF_RUN
from rths_cli.quantities.datasets import GROUPS, declared_datasets
from rths_cli.quantities.declaration import ROUNDED_BITS
from rths_cli.quantities.model_datasets import GROUPS as MODEL_GROUPS
from rths_cli.quantities.model_datasets import MODEL_ATTRIBUTES, declared_model_datasets
from rths_cli.quantities.sweep_datasets import OF_SWEEP, SWEEP_DATASETS

COLUMNS = ("dataset", "shape", "unit", "source", "holds")
HEAD = """# Result, model and sweep files (HDF5)

Made from their declarations in `rths_cli/quantities` by `python tests/helpers/docs_reference.py`; a test compares.
Format version 1.

Every dataset has the attributes `units`, `long_name` (below: holds) and `source` (computed, measured, estimated,
true). Time or frequency is the last axis. Every group holds its own scales, so that a run that was stopped is shorter
than the record. Complex values are two datasets, `_real` and `_imag`. Runs that a case does not name are not there.
Numbers are double precision. Series marked "32 binary digits", which follow from others of their group, are rounded to
that many of each row's largest value (an error of at most 2.3e-10 of it). `rths run --series essential` keeps, of all
runs and the record, the datasets marked as essential, in single precision; `--series none` keeps none of these.
[Read a result](../howto/reading_results.md) shows how to read the files from Python and MATLAB.

In a path, `RUN` is `shake_table` or `exp_rths`, `SOLUTION` is `sim` or `sim_delay`. Shapes are given by the scales:
"""


def hdf5_page() -> str:
    """Return the page as Markdown: attributes and a table per group of a result, of a model, of a sweep."""
    return "\n\n".join([*_result(), *_model(), *_sweep()]) + "\n"


def _result() -> Iterator[str]:
    scales = [(f"`{one.name}`", one.units, escaped(one.text)) for one in AXES.values()]
    yield HEAD.rstrip()
    yield _table(("scale", "unit", "holds"), scales)
    yield "## Attributes of a result"
    yield _attributes(OF_FILE)
    yield "For each run RUN on the table (`shake_table`, `exp_rths`):"
    yield _attributes(OF_RUN)
    declared: dict[str, list[DatasetDeclaration]] = {}
    for one in declared_datasets():
        declared.setdefault(one.group, []).append(one)
    for group, about in GROUPS.items():
        yield f"## `/{group}`"
        yield about
        if group == "controller/BLOCK":
            yield from _blocks()
        yield _table(COLUMNS, [_row(path, one) for one in declared[group] for path in one.stored_paths])
    yield "## `/metrics`"
    yield (
        "One dataset per metric: [metrics](metrics.md) lists them all. `/metrics/exp_rths/rms_error_m_s2` is "
        "`exp_rths.rms_error_m_s2`. Beside the attributes above each has its `definition`, and one with an "
        "interval has `low`, `high` (of its shape) and `probability`."
    )


def _attributes(declared: Iterable[AttributeDeclaration]) -> str:
    rows = [(f"`{one.name}`", escaped(one.text + _condition(one.present))) for one in declared]
    return _table(("attribute", "holds"), rows)


def _row(path: str, one: DatasetDeclaration) -> tuple[str, ...]:
    """Return the row of a dataset as it stands in a file."""
    part = {"_real": ", real part", "_imag": ", imaginary part"}.get(path.removeprefix(one.path), "")
    may = f"; a file may add: {', '.join(one.remarks)}" if one.remarks else ""
    shape = f"({', '.join(one.axes)})" if one.axes else "one value"
    rounded = f"{ROUNDED_BITS} binary digits" if one.follows else ""
    marks = "; ".join(filter(None, (one.present, "essential" if one.essential else "", rounded)))
    return f"`/{path}`", shape, one.units, one.source, escaped(one.text + part + may + _condition(marks))


def _condition(present: str) -> str:
    return f" ({present})" if present else ""


def _blocks() -> Iterator[str]:
    yield "Its attributes:"
    yield _attributes(OF_BLOCK)
    yield "The blocks are:"
    yield _table(("block", "does"), [(f"`{name}`", escaped(about)) for name, about in BLOCKS.items()])


def _model() -> Iterator[str]:
    yield "## Model files"
    yield "What `rths identify` writes; what was not found is left out. True and false are 1 and 0."
    yield _attributes(MODEL_ATTRIBUTES.values())
    yield "`METHOD` is best or paper, `RECORD` excitation, free_vibration or low_level, `CHANNEL` a channel's name."
    for group, members in groupby(declared_model_datasets(), key=lambda one: one.group):
        yield f"### `/{group}` of a model"
        yield escaped(MODEL_GROUPS[group])
        yield _table(COLUMNS, [_row(path, one) for one in members for path in one.stored_paths])


def _sweep() -> Iterator[str]:
    yield "## Sweep files"
    yield (
        "What `rths sweep` writes, without groups: a row per run. Beside what is below it holds each varied key under "
        "its dotted name, and each metric of the runs under its path, (variant) or (variant, storey)."
    )
    yield _table(COLUMNS, [_row(path, one) for path, one in SWEEP_DATASETS.items()])
    yield "Its attributes, beside those of a result:"
    yield _attributes(OF_SWEEP)


def escaped(text: str) -> str:
    """Return a text as a cell of a table in Markdown holds it."""
    return text.replace("|", "\\|")


def _table(columns: tuple[str, ...], rows: Any) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (columns, ("---",) * len(columns), *rows))
