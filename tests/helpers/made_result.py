"""A small result file with every kind of content: what is exported of it is compared with h5py's view of it."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np

from rths_cli.files.result_reader import ResultWriter

ATTRIBUTES = {
    "case_name": "demo",
    "created_utc": "2026-11-21T12:00:00Z",
    "command_line": "rths run demo",
    "rths_version": "0.1.0",
    "method": "best",
    "rig": "aps400_virtual",
    "rig_kind": "virtual",
    "seed": 3,
    "sample_rate_hz": 2000.0,
    "overrides": "",
}
YAML = "record: el_centro  # Prüfstand, 5 µm\nscaling: 0.3\n"
N, STOPPED = 40, 25
TIME = np.arange(N) / 2000.0
NOISE = np.random.default_rng(1).standard_normal((3, N)) * 1e-3


def fill(writer: ResultWriter, status: str) -> None:
    n = N if status == "complete" else STOPPED
    writer.case(YAML, "scaling: 0.3\n")
    writer.group("record", {"ground_accel_m_s2": NOISE[0]}, TIME)
    writer.group("sim", {"base_shear_n": NOISE[1]}, TIME)
    diverged = np.where(TIME > 0.01, np.nan, NOISE)
    writer.group("sim_delay", {"abs_accel_m_s2": diverged, "base_shear_n": NOISE[1]}, TIME, [1, 2, 3])
    measured = {
        "abs_accel_m_s2": NOISE[:, :n],
        "command_v": NOISE[2, :n],
        "floor_accel_measured_m_s2": NOISE[1:, :n],
    }
    floors = {"floor": [2, 3]}
    writer.group("exp_rths", measured, TIME[:n], [1, 2, 3], floors)
    writer.group("exp_rths/truth", {"table_disp_m": NOISE[0, :n]}, TIME[:n])
    lost = (NOISE[0, :n] > 0).astype(int)
    writer.group("exp_rths/timing", {"compute_s": NOISE[0, :n], "lost": lost}, TIME[:n])
    writer.group(
        "identification",
        {
            "frf": np.exp(1j * NOISE[0]),
            "poles": np.array([-1 + 2j, -1 - 2j]),
            "gain": 2.5,
        },
        scales={"frequency_hz": np.linspace(0.5, 50, N)},
    )
    writer.block("feedforward", *block(2, 3), 0.0005, ["accel_m_s2", "vel_m_s", "disp_m"], ["feedforward_v"])
    writer.block("base_shear", *block(0, 2), 0.0005, ["a", "b"], ["c"])
    writer.metrics(
        {
            "exp_rths.rms_error_m_s2": [0.1, 0.2, np.nan],
            "check.phase_margin_deg": 51.5,
        }
    )
    writer.finish(status, "" if status == "complete" else "EXP-RTHS: stroke limit at 0.0125 s")  # type: ignore[arg-type]


def block(states: int, inputs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return A, B, C, D of a block with one output."""
    numbers = np.random.default_rng(states).standard_normal
    return numbers((states, states)), numbers((states, inputs)), numbers((1, states)), numbers((1, inputs))


def make(path: Path, status: str = "complete") -> Path:
    """Write a result file; one that is not complete has a shorter EXP-RTHS."""
    with ResultWriter(path, ATTRIBUTES) as writer:
        fill(writer, status)
    return path


def contents(path: Path) -> dict[str, np.ndarray]:
    """Return every dataset and scale of an HDF5 file as h5py reads it, by path."""
    found: dict[str, np.ndarray] = {}

    def collect(name: str, node: object) -> None:
        if isinstance(node, h5py.Dataset):
            found[name] = node[()]

    with h5py.File(path) as file:
        file.visititems(collect)
    return found
