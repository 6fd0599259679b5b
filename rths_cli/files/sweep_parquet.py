"""The table of a sweep as Apache Parquet, with the unit and meaning of every column in its schema."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.errors import InputError
from rths_cli.files.durable_files import written_whole
from rths_cli.files.result_writer import refusal
from rths_cli.files.sweep_file import Sweep, stored_values
from rths_cli.quantities.declaration import AXES, unit_of_name
from rths_cli.quantities.sweep_datasets import SWEEP_DATASETS

INSTALL = "pip install 'rths-cli[parquet]'"
Column = tuple[str, Any, str, str]
"""Name, values (n,), unit and meaning."""


def check_parquet() -> None:
    """Raise InputError where the package that writes Parquet is missing."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise InputError(f"--parquet: the package pyarrow is missing; install it: {INSTALL}") from error


def write_parquet(path: Path, sweep: Sweep) -> None:
    """Write one row per run; raises InputError when the disk refuses.

    Columns are those of the CSV table. Each has `units` and `long_name` as metadata; the file has the attributes of the
    sweep, as JSON under `rths`, and its case and study. A figure that a run has not is null.
    """
    import pyarrow as pa
    from pyarrow import parquet

    arrays, fields = [], []
    for name, values, units, meaning in _parquet_columns(sweep):
        array = pa.array(values, from_pandas=True)  # NaN is null
        arrays.append(array)
        fields.append(pa.field(name, array.type, metadata={"units": units, "long_name": meaning}))
    about = {"rths": json.dumps(sweep.attributes), "case_yaml": sweep.case_yaml, "case_resolved": sweep.resolved_yaml}
    about |= {"study_yaml": sweep.study_yaml} if sweep.study_yaml else {}
    table = pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=about))
    try:
        with written_whole(path) as part:
            parquet.write_table(table, part)
    except OSError as error:
        raise InputError(refusal(path, "cannot write the table", error)) from error


def _parquet_columns(sweep: Sweep) -> Iterator[Column]:
    """Yield coordinates, texts and figures, those per storey with the storey in brackets."""
    runs = len(sweep.seed)
    yield "variant", np.arange(1, runs + 1), AXES["variant"].units, AXES["variant"].text
    for key, values in sweep.varied.items():
        yield key, stored_values(values), unit_of_name(key), f"varied key {key}"
    stated = {"seed": sweep.seed, **{name: list(texts) for name, texts in sweep.texts.items()}}
    for name, column in stated.items():
        yield name, column, SWEEP_DATASETS[name].units, SWEEP_DATASETS[name].text
    for path, figure in sweep.figures.items():
        if figure.values.ndim == 1:
            yield path, figure.values, figure.units, figure.definition
            continue
        for storey, values in enumerate(figure.values.T, 1):
            yield f"{path}[{storey}]", values, figure.units, f"{figure.definition}, storey {storey}"
