"""Declarations of the columns of a raw log, the file of a run on a real rig (docs/reference/raw_log.md)."""

from __future__ import annotations

from rths_cli.quantities.datasets import DATASETS
from rths_cli.quantities.declaration import ACCEL, DatasetDeclaration

STEPS, OF_CHANNELS, OF_ESTIMATES = ("step",), ("channel", "step"), ("estimate", "step")
OF_FURTHER = ("further_channel", "step")
OF_LOGGED = ("value", "step")
RAW_LOG_COLUMNS: dict[str, DatasetDeclaration] = {
    one.path: one
    for one in (
        DatasetDeclaration(
            "corrected", ACCEL, OF_CHANNELS, "measured", "accelerations as the step used them: samples corrected for "
            "their sensors, or what stood in for samples that did not come",
        ),
        DatasetDeclaration(
            "further", "m/s^2, m, N or 1", OF_FURTHER, "measured", "values of the channels beside the "
            "accelerometers, in the order of the rig file",
        ),
        DatasetDeclaration("desired_accel_m_s2", ACCEL, STEPS, "computed", "desired acceleration of the table"),
        DatasetDeclaration("desired_velocity_m_s", "m/s", STEPS, "computed", "desired velocity of the table"),
        DatasetDeclaration("desired_displacement_m", "m", STEPS, "computed", "desired displacement of the table"),
        DatasetDeclaration("command_v", "V", STEPS, "computed", DATASETS["exp_rths/command_v"].text),
        DatasetDeclaration("base_shear_n", "N", STEPS, "estimated", DATASETS["exp_rths/base_shear_n"].text),
        DatasetDeclaration(
            "estimated", "m, m/s, m/s^2 or N", OF_ESTIMATES, "estimated", "outputs of the Kalman filter, in the order "
            "of its block in the result file",
        ),
        DatasetDeclaration(
            "logged", "as its name", OF_LOGGED, "computed", "what the parts of the step log, in the order of "
            "`exp_rths/part_values` of the result file; most parts log nothing",
        ),
        DatasetDeclaration("samples_v", "V", OF_CHANNELS, "measured", "samples as the rig gave them"),
        DatasetDeclaration("further_v", "V", OF_FURTHER, "measured", "the same of the further channels"),
        *(
            DatasetDeclaration(f"{name}_ns", "ns", STEPS, "measured", DATASETS[f"exp_rths/timing/{name}_s"].text)
            for name in ("late", "exchange")
        ),
        *(
            DatasetDeclaration(name, "1", STEPS, "measured", DATASETS[f"exp_rths/timing/{name}"].text)
            for name in ("lost", "state")
        ),
        DatasetDeclaration("compute_ns", "ns", STEPS, "measured", DATASETS["exp_rths/timing/compute_s"].text),
    )
}  # fmt: skip
"""Every column by its name, in the order of a log; one of several channels or estimates ends in its number, from 0.

Desired motion and base shear of step k are those of k + n_p, everything else of k.
"""
