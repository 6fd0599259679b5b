"""Figures of a check with made-up numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rths_cli.experiment.check_command import Checked, Tested
from rths_cli.findings import stated
from rths_cli.quantities import Values, metrics_of

ABOUT = Tested(
    case="my_case",
    file="my_case.yaml",
    structure="three_storey",
    damping="low",
    record="el_centro",
    scaling=0.3,
    controller="FF+FB",
    method="best",
    rig="aps400",
    rig_kind="virtual",
    sample_rate_hz=2000.0,
    delay_s=0.005,
    model="cache, identified an hour ago",
)


OF_LAWS = (
    "check.tangent_", "check.critical_delay_least_s", "check.critical_delay_most_s", "check.ductility",
    "check.residual_drift_m", "check.restoring_work_j", "check.peak_inter_storey_drift_m",
)  # fmt: skip
OF_CALIBRATION, OF_BASE = ("check.true_error", "check.calibration_error"), "check.pitch_error"
OF_ACTUATOR = "check.interface_disp_error"
LINEAR = {
    path for path in metrics_of("check") if not path.startswith((*OF_LAWS, *OF_CALIBRATION, OF_BASE, OF_ACTUATOR))
}
"""The figures of a check of a linear building on a rig that is as declared, whose base is not seen to pitch."""
OF_RUNS = {
    path
    for path in LINEAR
    if path.startswith(("check.shake_table_", *(f"check.exp_rths_{of}_" for of in ("planned", "guard"))))
}
"""Those that the verdict adds to what is found of the hybrid loop: the table test, and plan and guard of each run."""
TRUE_ERROR = {path for path in metrics_of("check") if path.startswith(OF_CALIBRATION)}
"""Those that a rig has beside them some of whose sensors, instants or masses are uncertain."""


def metrics(seed: int = 0) -> Values:
    """Return every figure of a check of a linear building, each with a number of its own."""
    random = np.random.default_rng(seed)
    return {
        path: random.uniform(0.1, 0.9, 3) if one.over else random.uniform(0.1, 0.9)
        for path, one in metrics_of("check").items()
        if path in LINEAR
    }


def checked(verdict: str = "safe", reasons: tuple[str, ...] = (), drop: tuple[str, ...] = (), **about: Any) -> Checked:
    """Return a checked case; figures whose path starts with one of `drop` are missing."""
    found = {path: metric for path, metric in metrics().items() if not path.startswith(drop or ("none",))}
    return Checked(
        replace(ABOUT, **about), verdict, tuple(map(stated, reasons)), (stated("a warning", "notes"),), found
    )
