"""Small result files with made-up but whole contents, written by the writer of real ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from rths_cli.files.result_reader import Result, ResultWriter, read_result
from rths_cli.quantities import Values

RATE_HZ = 1000.0
ABOUT: dict[str, str | int | float] = {
    "case_name": "made_up",
    "created_utc": "2026-01-02T03:04:05Z",
    "rths_version": "0.1.0",
    "seed": 7,
    "sample_rate_hz": RATE_HZ,
    "method": "best",
    "rig": "aps400_virtual",
    "rig_kind": "virtual",
    "driver_verified": "",
    "overrides": "",
    "command_line": "rths run made_up.yaml",
    "platform": "Linux-6.1",
    "package_versions": json.dumps({"python": "3.11.7", "numpy": "2.0.0"}),
    "git_commit": "0123abc",
    "record_sha256": "f" * 64,
    "model_sha256": "a" * 64,
    "record_name": "el_centro",
    "damping_name": "low",
    "controller": "FF+FB",
    "scaling": 0.3,
    "check_verdict": "safe",
}
RESOLVED = (
    "runs: [sim, sim_delay, shake_table, exp_rths]\ntable: {converters: {latency_samples: 2}}\n"
    "structure: {numerical: {masses_kg: [7.0]}, experimental: {masses_kg: [6.0, 5.0]}}\n"
)
POLES = np.array([-5.0 + 40.0j, -5.0 - 40.0j, -60.0, -200.0])
ZEROS = np.array([0.0, 0.0, -4.0 + 30.0j])


def motion(seed: int, samples: int, storeys: int) -> np.ndarray:
    """Return accelerations (storeys, samples): some sines, noise, and one spike of a single sample."""
    random = np.random.default_rng(seed)
    t = np.arange(samples) / RATE_HZ
    waves = [np.sin(2 * np.pi * (1.0 + 0.7 * k) * t + seed) for k in range(storeys)]
    found = np.array(waves) + 0.01 * random.standard_normal((storeys, samples))
    found[:, samples // 3 : samples // 3 + 1] += 5.0
    return found


def write(
    path: Path,
    storeys: int = 3,
    samples: int = 40_000,
    stopped: int | None = None,
    runs: tuple[str, ...] = ("sim", "sim_delay", "shake_table", "exp_rths"),
    resolved: str = RESOLVED,
    status: str = "complete",
    reason: str = "",
    cut: int | None = None,
    metrics: Values | None = None,
    **attributes: str | int | float,
) -> Result:
    """Write a result and read it back: EXP-RTHS of `stopped` samples, SIM-DELAY not a number from sample `cut` on."""
    with ResultWriter(path, {**ABOUT, **attributes}) as writer:
        writer.case("scaling: 0.3\n", resolved)
        if runs:
            writer.group("record", {"ground_accel_m_s2": motion(9, samples, 1)[0]}, _time(samples))
        for seed, run in enumerate(("sim", "sim_delay")):
            if run in runs:
                accel = motion(seed, samples, storeys)
                if cut is not None and run == "sim_delay":
                    accel[:, cut:] = np.nan
                writer.group(run, {"abs_accel_m_s2": accel}, _time(samples), np.arange(1, storeys + 1))
        for run in ("shake_table", "exp_rths"):
            if run in runs:
                _write_table_run(writer, run, storeys, samples if stopped is None else stopped)
        if "exp_rths" in runs or "shake_table" in runs:
            _write_identification(writer)
        writer.metrics(metrics or {})
        writer.finish(status, reason)  # type: ignore[arg-type]
    return read_result(path)


def _write_table_run(writer: ResultWriter, run: str, storeys: int, samples: int) -> None:
    desired, measured = motion(5, samples, 1)[0], motion(6, samples, 1)[0]
    sets = {
        "interface_accel_desired_m_s2": desired,
        "interface_accel_measured_m_s2": measured,
    }
    if run == "exp_rths":
        sets["abs_accel_m_s2"] = motion(2, samples, storeys)
    floors = np.arange(storeys - 1, storeys + 1)
    writer.group(run, sets, _time(samples), np.arange(1, storeys + 1), {"floor": floors})
    timing = {name: np.arange(samples) * 1e-8 for name in ("compute_s", "late_s")}
    timing["lost"] = (np.arange(samples) % 10_000 == 1).astype(float)
    timing["lost"][5::9_000] = 3.0  # samples of another instant, brought to the right one: not without samples
    writer.group(f"{run}/timing", timing, _time(samples), np.arange(1, storeys + 1))


def _write_identification(writer: ResultWriter) -> None:
    frequency = np.linspace(0.5, 60.0, 200)
    response = 3.0 * np.exp(1j * frequency / 20.0)
    sets = {
        "frf": response,
        "coherence": np.linspace(1.0, 0.9, 200),
        "zeros": ZEROS,
        "poles": POLES,
        "gain": 1e3,
        "delay_s": 0.001,
        "ripple_m_s2_per_v": 0.4,
        "coupling_hz": 0.1,
        "fit_error_rms": 0.001,
        "fit_error_max": 0.002,
        "natural_frequency_hz": np.array([3.2, 8.4]),
        "damping_ratio": np.array([0.04, 0.03]),
    }
    writer.group("identification", sets, scales={"frequency_hz": frequency})


def _time(samples: int) -> np.ndarray:
    return np.arange(samples) / RATE_HZ
