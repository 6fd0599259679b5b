"""Results with made-up numbers: every figure of a result is told by `base`, so that each can be found in the text."""

import json
from pathlib import Path

from rths_cli.files.result_reader import Result

SUFFIXES = ("", "_true", "_full", "_true_full")
PUBLISHED = {
    ("el_centro", "low", "FF"): {
        "shake_table.tracking_max_m_s2": 0.0376,
        "shake_table.tracking_rms_m_s2": 0.0030,
        "exp_rths.tracking_max_m_s2": 0.1007,
        "exp_rths.tracking_rms_m_s2": 0.0058,
    },
    ("el_centro", "low", "FF+FB"): {
        "shake_table.tracking_max_m_s2": 0.0086,
        "shake_table.tracking_rms_m_s2": 0.0004,
        "exp_rths.tracking_max_m_s2": 0.1922,
        "exp_rths.tracking_rms_m_s2": 0.0027,
        "sim_delay.rms_error_m_s2": [0.0236, 0.1050, 0.1228],
        "exp_rths.rms_error_m_s2": [0.0158, 0.0466, 0.0615],
    },
    ("el_centro", "high", "FF+FB"): {
        "sim_delay.rms_error_m_s2": [0.0297, 0.0759, 0.0913],
        "exp_rths.rms_error_m_s2": [0.0023, 0.0428, 0.0500],
    },
}


def result(metrics, method="best", record="el_centro", damping="low", controller="FF+FB", **attributes):
    """Return a result with the given metrics and the paper's figures of its case."""
    name = f"{record}_{damping}_{controller.lower().replace('+', '_')}"
    about = {
        "case_name": name,
        "method": method,
        "rig": "aps400",
        "rig_kind": "virtual",
        "status": "complete",
        "status_reason": "",
        "record_name": record,
        "damping_name": damping,
        "controller": controller,
        "scaling": 0.3,
        "reference_json": json.dumps(PUBLISHED.get((record, damping, controller), {})),
        "reference_title": "Zhang et al.",
        **attributes,
    }
    units = dict.fromkeys(metrics, "m/s^2")
    return Result(Path(f"{name}.h5"), about, "", "", dict(metrics), units, dict.fromkeys(metrics, "made up"), ("sim",))


def figures(tracking, delayed, errors, true=1.0):
    """Return metrics: tracking (max, rms of the shake table test; max, rms of RTHS), errors per storey.

    True figures are `true` times the measured ones, full-band figures 2 times, true ones in full band 3 times.
    """
    names = ("shake_table.tracking_max", "shake_table.tracking_rms", "exp_rths.tracking_max", "exp_rths.tracking_rms")
    metrics = {"sim_delay.rms_error_m_s2": list(delayed), "sim_delay.rms_error_m_s2_full": [2 * v for v in delayed]}
    for suffix, factor in zip(SUFFIXES, (1.0, true, 2.0, 3.0), strict=True):
        metrics |= {f"{name}_m_s2{suffix}": factor * value for name, value in zip(names, tracking, strict=True)}
        metrics[f"exp_rths.rms_error_m_s2{suffix}"] = [factor * value for value in errors]
    return metrics


LOW = (0.08, 0.12, 0.16)
HIGH = (0.05, 0.10, 0.10)


def paper_cases():
    """Return El Centro with both dampings and controllers and both methods, as if all had gone well."""
    made = []
    for method, worse in (("paper", 2.0), ("best", 1.0)):
        for damping, delayed, scale in (("low", LOW, 1.0), ("high", HIGH, 0.5)):
            for controller, rms, peak in (("FF", 0.0012, 0.0090), ("FF+FB", 0.0006, 0.0095)):
                tracking = (worse * 0.0050, worse * rms, worse * peak, worse * (rms + 0.0001))
                errors = [worse * scale * v * (0.02 if controller == "FF" else 0.01) for v in delayed]
                made.append(result(figures(tracking, delayed, errors, 0.9), method, "el_centro", damping, controller))
    return made
