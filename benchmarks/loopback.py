"""EXP-RTHS over UDP against `rths serve` on this machine, beside the same case offline at the same rate and latency.

python benchmarks/loopback.py [--rate 1000] [--case el_centro_low_ff_fb] [--runs 1] [--keep FOLDER]
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from options import arguments, parsed

PORT = 47911
RIG = """extends: udp_loopback
name: loopback
udp: {{host: 127.0.0.1, port: {port}, key_file: {key}}}
"""
WORDS = [sys.executable, "-m", "rths_cli"]


def rths(folder: Path, *words: str) -> dict[str, Any]:
    """Run a command with --json in a folder and return its document; ends the benchmark where it fails."""
    done = subprocess.run([*WORDS, *words, "--json"], capture_output=True, text=True, cwd=folder, check=False)
    if done.returncode not in (0, 1):
        sys.exit(f"rths {' '.join(words)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return dict(json.loads(done.stdout))


def served(folder: Path) -> subprocess.Popen[str]:
    """Start the server, wait until it listens, write the rig file with its key."""
    words = ["serve", "aps400_virtual", "--port", str(PORT)]
    server = subprocess.Popen([*WORDS, *words], stdout=subprocess.PIPE, text=True, cwd=folder)
    assert server.stdout is not None
    line = next(line for line in server.stdout if line.startswith("key file "))
    key = line.removeprefix("key file ").partition(";")[0]
    (folder / "rig.yaml").write_text(RIG.format(port=PORT, key=key))
    return server


def errors(path: Path) -> np.ndarray:
    """Return the RMS errors of a result, storey by storey, in m/s^2."""
    with h5py.File(path) as file:
        if file.attrs["status"] != "complete":
            sys.exit(f"{path.name}: {file.attrs['status']}, {file.attrs['status_reason']}")
        return np.asarray(file["metrics/exp_rths/rms_error_m_s2"][()])


def show_timing(path: Path) -> None:
    """Print how punctual a run was."""
    with h5py.File(path) as file:
        timing = {name: file[f"exp_rths/timing/{name}"][()] for name in ("late_s", "exchange_s", "compute_s", "lost")}
        overruns = file.attrs["exp_rths_overruns"]
    for name, label in (("late_s", "wake-up delay"), ("exchange_s", "exchange"), ("compute_s", "step, guard, log")):
        p50, p99, p99_9, most = 1e6 * np.nanpercentile(timing[name], [50, 99, 99.9, 100])
        print(f"  {label:<18}{p50:9.1f}{p99:9.1f}{p99_9:9.1f}{most:10.1f} us (p50, p99, p99.9, max)")
    print(f"  lost or late answers {int((timing['lost'] == 1).sum())}, intervals overrun {overruns}")


def compare(folder: Path, case: str, rate_hz: float, runs: int) -> None:
    """Identify over UDP, run the case there and offline, and print the ratios of their errors."""
    common = ("--set", f"sample_rate_hz={rate_hz:g}")
    over_udp = ("--set", "table=./rig.yaml", *common, "--yes")
    start = time.monotonic()
    rths(folder, "identify", case, *over_udp, "--no-figure", "--output", "model.h5")
    print(f"identified over UDP in {time.monotonic() - start:.0f} s", flush=True)
    rths(folder, "run", case, *common, "--set", "runs=[sim, exp_rths]", "--output", "offline")
    offline = errors(folder / "offline" / f"{case}.h5")
    for number in range(runs):
        output = f"udp{number}"
        words = (*over_udp, "--set", "runs=[sim, exp_rths]", "--set", "identification.model=./model.h5")
        rths(folder, "run", case, *words, "--output", output, "--override", "model", "--override", "check")
        path = next((folder / output).glob("*.h5"))
        found = errors(path)
        ratios = ", ".join(f"{ratio:.2f}" for ratio in found / offline)
        print(f"RMS error over UDP / offline, storey by storey: {ratios}")
        print(f"  {', '.join(f'{1e3 * value:.3f}' for value in found)} mm/s^2; offline "
              f"{', '.join(f'{1e3 * value:.3f}' for value in offline)}")  # fmt: skip
        show_timing(path)


def main() -> None:
    """Serve, compare, end the server."""
    parser = arguments(__doc__)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--case", default="el_centro_low_ff_fb")
    parser.add_argument("--runs", type=int, default=1)
    parser.add_argument("--keep", type=Path)
    asked = parsed(parser)
    os.environ["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    with tempfile.TemporaryDirectory() as made:
        folder = (asked.keep or Path(made)).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        server = served(folder)
        try:
            compare(folder, asked.case, asked.rate, asked.runs)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
