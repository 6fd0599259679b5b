"""What every published number, dataset and attribute is, declared once: path, unit, axes, meaning, origin.

`metrics` declares the numbers of a run and of its check (`exp_rths.rms_error_m_s2`), `datasets` what else a result file
holds, `axes` and `attributes` their scales and its attributes. Writers take plain values by path and refuse a path that
is not declared; the reader's checks, sweeps, `accept`, reports, reference pages and JSON read this.
"""

from rths_cli.quantities.attributes import ATTRIBUTES, STATUSES, attribute_fault
from rths_cli.quantities.datasets import BLOCKS, DATASETS, dataset, stored_dataset
from rths_cli.quantities.declaration import (
    ACCEL,
    AXES,
    LESS,
    MORE,
    NONE,
    ONE,
    TABLE_RUNS,
    ZERO,
    AttributeDeclaration,
    Axis,
    DatasetDeclaration,
    Interval,
    Quantity,
    Source,
    Values,
    intervals_of,
    over_samples,
)
from rths_cli.quantities.metrics import KINDS, LATENCIES, METRICS, declared, kinds_of, metric, metrics_of, variants

__all__ = [
    "ACCEL",
    "ATTRIBUTES",
    "AXES",
    "BLOCKS",
    "DATASETS",
    "KINDS",
    "LATENCIES",
    "LESS",
    "METRICS",
    "MORE",
    "NONE",
    "ONE",
    "STATUSES",
    "TABLE_RUNS",
    "ZERO",
    "AttributeDeclaration",
    "Axis",
    "DatasetDeclaration",
    "Interval",
    "Quantity",
    "Source",
    "Values",
    "attribute_fault",
    "dataset",
    "declared",
    "intervals_of",
    "kinds_of",
    "metric",
    "metrics_of",
    "over_samples",
    "stored_dataset",
    "variants",
]
