"""Result files with known series: sums of sines and seeded noise, written as a run writes them."""

from pathlib import Path

import numpy as np
import yaml

from rths_cli.files.result_reader import ResultWriter

RATE = 200.0
CAUSES = ("declared", "coupling", "latency", "model", "friction", "specimen", "rounding", "rest")
PREDICTED = ("coupling", "latency", "model", "friction", "rounding")
PEAKS = {
    "command_v": (3.0, 10.0, "V"),
    "displacement_m": (0.02, 0.079, "m"),
    "velocity_m_s": (0.2, 1.0, "m/s"),
    "acceleration_m_s2": (2.5, 45.0, "m/s^2"),
    "sensor_m_s2": (2.5, 49.0, "m/s^2"),
    "force_n": (40.0, 445.0, "N"),
}
ZEROS = np.array([0.0, 0.0, -0.8 + 20.0j, -0.8 - 20.0j])
POLES = np.array([-30.0 + 80.0j, -30.0 - 80.0j, -1.0 + 19.0j, -1.0 - 19.0j, -600.0])
MASSES_KG = (7.0, 6.0, 5.0)  # of the floors, again and again
GAIN, DELAY_S, RIPPLE = 4.0e4, 0.0075, -0.9


def motion(n, seed):
    """Return a shaking that fades, with noise (n,)."""
    time = np.arange(n) / RATE
    noise = np.random.default_rng(seed).normal(size=n)
    swing = np.sin(2 * np.pi * (1.3 + 0.2 * seed) * time) + 0.4 * np.sin(2 * np.pi * 6.1 * time + seed)
    return (swing + 0.3 * np.cumsum(noise) / np.sqrt(np.arange(1, n + 1))) * np.exp(-((time - 4.0) ** 2) / 18.0)


def building(storeys, n, seed):
    """Return accelerations (storeys, n), each storey another."""
    return np.array([(1.0 + 0.3 * i) * motion(n, seed + i) for i in range(storeys)])


def displacements(storeys, n, seed):
    """Return displacements (storeys, n) in m relative to the ground, growing with the height."""
    return np.cumsum(1e-3 * building(storeys, n, seed), axis=0)


def masses_kg(storeys):
    """Return the masses (storeys,) of the floors."""
    return np.resize(MASSES_KG, storeys)


def resolved(storeys, floors, heights_m):
    """Return the case with its building, as the file of a result holds it."""
    masses = masses_kg(storeys).tolist()
    parts = {"numerical": {"masses_kg": masses[:-floors]}, "experimental": {"masses_kg": masses[-floors:]}}
    heights = {} if heights_m is None else {"heights_m": list(heights_m)}
    return yaml.safe_dump({"scaling": 1.0, "structure": parts | heights})


def noise(shape, seed, size=0.01):
    return size * np.random.default_rng(seed).normal(size=shape)


def write_result(
    path,
    runs=("sim", "sim_delay", "shake_table", "exp_rths"),
    storeys=3,
    floors=2,
    n=1600,
    stop=None,
    kind="virtual",
    live=False,
    heights_m=None,
    **attributes,
):
    """Write a result; `stop`: samples of EXP-RTHS before it was aborted; `heights_m`: of the storeys."""
    status = "aborted" if stop else "complete"
    about = {"case_name": "made_up", "method": "best", "rig": "bench", "rig_kind": kind, "sample_rate_hz": RATE}
    about |= {"status_reason": "EXP-RTHS: force beyond its limit at 3.000 s" if stop else ""} | attributes
    time = np.arange(n) / RATE
    with ResultWriter(Path(path), about) as writer:
        writer.case("record: made up\n", resolved(storeys, floors, heights_m))
        writer.group("record", {"ground_accel_m_s2": motion(n, 3)}, time_s=time)
        for run in runs:
            if run in ("sim", "sim_delay"):
                values = building(storeys, n, 1) + (0.05 * building(storeys, n, 4) if run == "sim_delay" else 0.0)
                found = {"abs_accel_m_s2": values, "rel_disp_m": displacements(storeys, n, 1 if run == "sim" else 4)}
                writer.group(run, found, time_s=time, storey=np.arange(1, storeys + 1))
            else:
                write_table_run(writer, run, storeys, floors, stop if stop and run == "exp_rths" else n, kind, live)
        if {"shake_table", "exp_rths"} & set(runs):
            write_identification(writer)
        writer.metrics(metrics(runs, storeys, stop))
        writer.finish(about.get("status", status), about["status_reason"])
    return Path(path)


def write_table_run(writer, run, storeys, floors, n, kind, live):
    seed = 10 if run == "exp_rths" else 20
    time, storey = np.arange(n) / RATE, np.arange(1, storeys + 1)
    floor = {"floor": np.arange(storeys - floors + 1, storeys + 1)}
    desired = motion(n, seed)
    seen = 2.0 * building(floors, n, seed + 1)
    late = np.concatenate([np.zeros(1), desired[:-1]])
    datasets = {
        "interface_accel_desired_m_s2": desired,
        "interface_accel_measured_m_s2": 1.01 * late + noise(n, seed),
        "command_v": 3.0 * desired,
        "floor_accel_measured_m_s2": seen + noise((floors, n), seed + 2),
        "floor_accel_estimated_m_s2": seen,
    }
    if run == "exp_rths":
        datasets["abs_accel_m_s2"] = building(storeys, n, 1) + 0.01 * building(storeys, n, 7)
        datasets["rel_disp_m"] = displacements(storeys, n, 1) + 0.01 * displacements(storeys, n, 7)
    writer.group(run, datasets, time_s=time, storey=storey, scales=floor)
    timing = {"compute_s": 1e-6 * np.exp(noise(n, seed, 1.0))}
    if live:
        timing["late_s"] = 2e-5 * np.exp(noise(n, seed + 3, 1.0))
        timing["exchange_s"] = 9e-5 * np.exp(noise(n, seed + 4, 1.0))
        timing["lost"] = (np.arange(n) % 500 == 499).astype(float)
    writer.group(f"{run}/timing", timing, time_s=time, storey=storey)
    if kind == "virtual":
        truth = {
            "table_accel_m_s2": 1.01 * late,
            "table_disp_m": 0.02 * desired,
            "floor_accel_m_s2": seen,
        }
        writer.group(f"{run}/truth", truth, time_s=time, storey=storey, scales=floor)


def write_identification(writer):
    """Write a response that is not quite the model's, and the block of the hold's staircase."""
    f = np.arange(0.5, 40.0, 0.1)
    frf = exact_response(f) * (1.0 + 0.02 * np.exp(2j * f))
    datasets = {
        "gain": GAIN,
        "delay_s": DELAY_S,
        "ripple_m_s2_per_v": RIPPLE,
        "coupling_hz": 0.0,
        "frf": frf,
        "coherence": 1.0 - 0.1 * np.cos(f) ** 2,
        "zeros": ZEROS,
        "poles": POLES,
        "natural_frequency_hz": [3.2, 8.4],
        "damping_ratio": [0.04, 0.04],
    }
    writer.group("identification", datasets, scales={"frequency_hz": f})
    A, B = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[1.0], [0.0]])
    writer.block(
        "staircase", A, B, RIPPLE * np.array([[1.0, -1.0]]), np.zeros((1, 1)), 1.0 / RATE, ["command_v"], ["a"]
    )


def exact_response(f):
    """Return the model's response (n,) by its definition: roots, delay, hold, and the alias of the staircase."""
    s = 2j * np.pi * f
    roots = np.prod(s[:, None] - ZEROS, axis=1) / np.prod(s[:, None] - POLES, axis=1)
    late = np.exp(-s / RATE)
    return GAIN * roots * np.exp(-s * DELAY_S) * np.sinc(f / RATE) + RIPPLE * late * (1.0 - late)


def metrics(runs, storeys, stop):
    """Return figures of merit; a run that was stopped has none of its own."""
    found = {}

    def put(path, value):
        found[path] = np.asarray(value, dtype=float)

    done = "exp_rths" in runs and not stop
    floor = np.arange(1, storeys + 1)
    if "sim_delay" in runs:
        put("sim_delay.rms_error_m_s2", 0.08 * floor)
    if "shake_table" in runs:
        put("shake_table.tracking_rms_m_s2", 0.0123)
    if not {"shake_table", "exp_rths"} & set(runs):
        return found
    for i, cause in enumerate(CAUSES):
        if cause in PREDICTED:
            put(f"check.rms_error_{cause}_m_s2", 1e-5 * (i + 1) * floor)
            put(f"check.tracking_rms_{cause}_m_s2", 0.0 if cause == "coupling" else 2e-5 * (i + 1))
        if done:
            put(f"budget.rms_error_{cause}_m_s2", 1.5e-5 * (i + 1) * floor)
            put(f"budget.tracking_rms_{cause}_m_s2", 3e-5 * (i + 1))
    put("check.rms_error_m_s2", 4e-4 * floor)
    put("check.tracking_rms_m_s2", 5e-4)
    if done:
        put("exp_rths.rms_error_m_s2", 6e-4 * floor)
        put("exp_rths.tracking_rms_m_s2", 7e-4)
    for name, (peak, limit, _) in PEAKS.items():
        put(f"check.peak_{name}", peak)
        put(f"check.limit_{name}", limit)
    for loop in ("check", "feedback"):
        put(f"{loop}.gain_margin", 5.0)
        put(f"{loop}.gain_reduction_margin", np.inf if loop == "feedback" else 1.6)
        put(f"{loop}.phase_margin_deg", 20.0)
        put(f"{loop}.delay_margin_s", 0.0068)
        put(f"{loop}.sensitivity_peak", 3.7)
    put("latency.frequency_hz", [1.0, 3.0, 5.0, 10.0])
    put("latency.total_s", [-0.0027, 0.0007, 0.0009, 0.0011])
    put("latency.compensated_s", [-0.0026, 0.0006, 0.0009, 0.0010])
    put("latency.left_s", [-0.0001, 0.0001, 0.0, 0.0001])
    return found
