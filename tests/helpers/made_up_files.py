"""Result files with made-up numbers, written by the writer of real ones."""

from __future__ import annotations

from pathlib import Path

import h5py

from rths_cli.files.result_reader import ResultWriter
from rths_cli.quantities import METRICS

ABOUT = {
    "case_name": "demo",
    "method": "best",
    "rig": "r",
    "rig_kind": "virtual",
    "record_name": "el_centro",
    "damping_name": "low",
    "controller": "FF",
    "scaling": 0.3,
    "seed": 0,
    "rths_version": "1.0",
    "git_commit": "abcdef0123",
    "created_utc": "2026-01-02T03:04:05Z",
}
FIGURES = {
    "exp_rths.tracking_rms_m_s2": (0.002, "m/s^2"),
    "exp_rths.rms_error_m_s2": ([0.01, 0.02, 0.03], "m/s^2"),
    "exp_rths.fei_delay_s": (-0.0003, "s"),
}


def write(
    path: Path, figures=None, status="complete", reason="", accept="{}", resolved="scaling: 0.3\n", **about
) -> Path:
    """Write a result; `figures` (value, unit) by path, `accept` and `resolved` as YAML text."""
    with ResultWriter(path, {**ABOUT, **about}) as writer:
        writer.case("a case\n", f"name: demo\n{resolved}accept: {accept}\nseed: {about.get('seed', 0)}\n")
        chosen = FIGURES if figures is None else figures
        writer.metrics({name: value for name, (value, unit) in chosen.items()})
        writer.finish(status, reason)
    other = {name: unit for name, (_, unit) in chosen.items() if unit != METRICS[name].units}
    if other:  # units that no version of ours writes
        with h5py.File(path, "r+") as file:
            for name, unit in other.items():
                file[f"metrics/{name.replace('.', '/')}"].attrs["units"] = unit
    return path
