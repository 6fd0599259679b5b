"""What every published number is: path, unit, axes, meaning, origin and which way is better, declared once.

`metrics` declares the numbers of a run and of its check (`exp_rths.rms_error_m_s2`). Writers take plain values by path
and refuse a path that is not declared; files, sweeps, `accept`, reports, reference pages and JSON read this.
"""

from rths_cli.quantities.declaration import ACCEL, LESS, MORE, NONE, ONE, ZERO, Quantity, Values
from rths_cli.quantities.metrics import KINDS, LATENCIES, METRICS, declared, kinds_of, metric, metrics_of, variants

__all__ = [
    "ACCEL",
    "KINDS",
    "LATENCIES",
    "LESS",
    "METRICS",
    "MORE",
    "NONE",
    "ONE",
    "ZERO",
    "Quantity",
    "Values",
    "declared",
    "kinds_of",
    "metric",
    "metrics_of",
    "variants",
]
