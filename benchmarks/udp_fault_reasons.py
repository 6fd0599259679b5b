"""Whether a test on an independent target over UDP names the true reason first when something of the rig fails.

    python benchmarks/udp_fault_reasons.py [RUNS] [--first N] [--kind WORD] [--workers N]

`benchmarks/faults/own_target.c`, compiled here, is a target written from docs/udp.md with a table and a specimen of its
own; `rths identify --data` identifies it from its own records, then `rths run` plays a short record on it at 500 Hz.
Of each kind RUNS runs (20 by default) are played, from number `--first` on, the fault at a random instant at which the
table moves, every other run without a limit on the tracking error. What is named first in the file's reason is the part
that failed (true), a group that contains it, or another part (false). A run that was stopped before its fault, or whose
reason is false after this computer itself lost samples, is played again, twice at most, and then not judged. Exit code
1 where one reason is false.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "faults"), str(HERE.parent / "tests" / "loop"), str(HERE.parent / "tests" / "rigs")]

import h5py  # noqa: E402
from fault_bench import environment, start_runner  # noqa: E402
from told_causes import ALL, FIRST, LINK, MOTION, SPECIMEN, TABLE, TABLE_SENSOR, TOP, verdict  # noqa: E402

from rths_cli.rigs.udp.secret import make_secret  # noqa: E402

Array = NDArray[np.float64]
STOP_BUTTON = "emergency stop"
RATE_HZ, RECORD_S, BEFORE_S = 500, 4.5, 2.0  # the record begins after a second at rest and the ramp
MOVES_S = (0.8, 3.3)  # of the record: when the faults come
PATIENCE_S, TRIES = 240.0, 3
WITHIN_S = 0.01  # of the fault: a stop before it has another cause
STALLED_S = 0.3  # before the end of the series: samples lost there may be the cause
TABLE_ALONE, FLOOR_2, FLOOR_3, EVERY, TABLE_AND_FLOOR, FLOORS = 1, 2, 4, 7, 3, 6  # masks of channels
STOPPED_AT = r" at (-?[0-9.]+) s of "
LOST = ("answers of target", "watchdog missed", "samples were lost", "steps overran")
ROLES = ((r"channel(s?) table", r"channel\1 channel_0"), ("floor_2", "channel_1"), ("floor_3", "channel_2"))
NOT_STOPPED, NOT_JUDGED = "not stopped", "not judged"

CASE = """structure:
  numerical: {masses_kg: [6.0], stiffness_n_per_m: [9000.0]}
  experimental: {masses_kg: [6.2, 5.4], stiffness_n_per_m: [9500.0, 7800.0], dashpots_n_s_per_m: [16.0, 11.0]}
damping: {first_mode_ratio: 0.03}
record: ./short.csv
scaling: 0.3
controller: FF+FB
"""
RIG = """kind: udp
udp: {host: 127.0.0.1, port: 1}
sensors: {sensitivity_v_per_m_s2: 0.1, range_g: 10, high_pass_hz: 0.03, low_pass_hz: 0}
converters: {bits: 16, range_v: 10}
limits: {stroke_m: 0.075, velocity_m_s: 0.9, acceleration_m_s2: 40, force_n: 800, lost_samples: 70TRACKING}
nominal: {gain_m_per_v: 0.0085, moving_mass_kg: 9.0, payload_kg: 20}
watchdog_s: 0.3
unattended: true
"""
TRACKED = ", tracking_error_m_s2: 1"


@dataclass(frozen=True)
class Kind:
    """What own_target.c is told (a word, a value, a mask of channels, intervals), and which parts failed."""

    what: str
    value: float
    channels: int
    last: int
    failed: frozenset[str]


def sensor(what: str, value: float, channels: int, failed: set[str], last: int = 0) -> Kind:
    return Kind(what, value, channels, last, frozenset(failed))


def beside(what: str, value: float, failed: str, last: int = 0) -> Kind:
    return Kind(what, value, 0, last, frozenset({failed}))


KINDS = {
    "nothing": beside("nothing", 0, "nothing"),
    "table sensor stuck": sensor("stuck", 0, TABLE_ALONE, {TABLE_SENSOR}),
    "floor sensor stuck": sensor("stuck", 0, FLOOR_3, {TOP}),
    "all sensors stuck": sensor("stuck", 0, EVERY, ALL),
    "table sensor dead": sensor("gain", 0, TABLE_ALONE, {TABLE_SENSOR}),
    "floor sensor dead": sensor("gain", 0, FLOOR_2, {FIRST}),
    "all sensors dead": sensor("gain", 0, EVERY, ALL),
    "table sensor reversed": sensor("gain", -1, TABLE_ALONE, {TABLE_SENSOR}),
    "first floor reversed": sensor("gain", -1, FLOOR_2, {FIRST}),
    "top floor reversed": sensor("gain", -1, FLOOR_3, {TOP}),
    "all sensors reversed": sensor("gain", -1, EVERY, ALL),
    "table sensor doubled": sensor("gain", 2, TABLE_ALONE, {TABLE_SENSOR}),
    "table sensor halved": sensor("gain", 0.5, TABLE_ALONE, {TABLE_SENSOR}),
    "floor sensor tripled": sensor("gain", 3, FLOOR_2, {FIRST}),
    "table sensor jumps": sensor("offset", 1, TABLE_ALONE, {TABLE_SENSOR}),
    "floor sensor jumps": sensor("offset", 2, FLOOR_3, {TOP}),
    "table sensor spike": sensor("spike", 4.8, TABLE_ALONE, {TABLE_SENSOR}, 1),
    "floor sensor spike": sensor("spike", -4.8, FLOOR_2, {FIRST}, 1),
    "one sample not a number": sensor("nan", 0, FLOOR_3, {TOP}, 1),
    "table sensor saturated": sensor("saturated", 0, TABLE_ALONE, {TABLE_SENSOR}),
    "floor sensor saturated": sensor("saturated", 0, FLOOR_3, {TOP}),
    "noise on all sensors": sensor("noise", 0.3, EVERY, ALL),
    "noise on one floor": sensor("noise", 0.5, FLOOR_2, {FIRST}),
    "table sensor drifts": sensor("drift", 2, TABLE_ALONE, {TABLE_SENSOR}),
    "floor sensor drifts": sensor("drift", 4, FLOOR_2, {FIRST}),
    "mains hum on all": sensor("hum", 0.6, EVERY, ALL),
    "loose contact of all": sensor("loose", 0, EVERY, ALL),
    "loose contact of the table": sensor("loose", 0, TABLE_ALONE, {TABLE_SENSOR}),
    "table and floor swapped": sensor("swapped", 0, TABLE_AND_FLOOR, {TABLE_SENSOR, FIRST}),
    "floors swapped": sensor("swapped", 0, FLOORS, {FIRST, TOP}),
    "amplifier dead": beside("wire-gain", 0, TABLE),
    "polarity reversed": beside("wire-gain", -1, TABLE),
    "amplifier gain 1.5": beside("wire-gain", 1.5, TABLE),
    "amplifier gain 0.5": beside("wire-gain", 0.5, TABLE),
    "amplifier offset": beside("wire-offset", 0.6, TABLE),
    "table stops": beside("wire-holds", 0, TABLE),
    "command 15 intervals late": beside("wire-delay", 15, TABLE),
    "delay of the command grows": beside("wire-delay-grows", 0.02, TABLE),
    "friction jumps to 40 N": beside("friction", 40, TABLE),
    "servo goes soft": beside("servo-soft", 0.35, TABLE),
    "actuator weak": beside("weak", 15, TABLE),
    "storey loses 60 % stiffness": beside("storey-soft", 0.4, SPECIMEN),
    "all answers lost": beside("answers-lost", 0, LINK),
    "all commands lost": beside("commands-lost", 0, LINK),
    "40 answers lost": beside("answers-lost", 0, LINK, 40),
    "40 commands lost": beside("commands-lost", 0, LINK, 40),
    "answers late": beside("answers-late", 3, LINK),
    "answers reordered": beside("reordered", 2, LINK),
    "target freezes for 30 ms": beside("freezes", 30, LINK),
    "target freezes for 100 ms": beside("freezes", 100, LINK),
    "target freezes for 250 ms": beside("freezes", 250, LINK),
    "target dies": beside("dies", 0, LINK),
    "target restarts": beside("restarts", 0, LINK),
    "end stop": beside("fault-bits", 2, TABLE),
    "emergency stop": beside("fault-bits", 4, STOP_BUTTON),
    "target reports a sensor": sensor("fault-bits", 16, 0, ALL),
    "target reports the actuator": beside("fault-bits", 32, TABLE),
    "target misses its pace": beside("fault-bits", 64, LINK),
}
OF_THE_RIG = (  # what a rig's own fault says, and the parts that it blames
    ("answers of target", {LINK}), ("watchdog missed", {LINK}), ("end stop", {TABLE}),
    ("emergency stop", {STOP_BUTTON}), ("a sensor failed", ALL), ("actuator or its amplifier", {TABLE}),
    ("its own pace", {LINK}),
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """What one run came to: its verdict, what was said, how long after the fault it was stopped, in s."""

    kind: str
    number: int
    verdict: str
    said: str
    after_s: float


# --- the laboratory


def noise(samples: int, seed: int) -> Array:
    """Return an excitation (samples,) of standard deviation 1: flat in displacement to 0.7 Hz, falling above."""
    f = np.fft.rfftfreq(samples, 1.0 / RATE_HZ)
    shape = np.maximum(f / 0.7, 1.0) ** -1.5 * np.maximum(f / 12.0, 1.0) ** -2.0 * ((f > 0.25) & (f < 60.0))
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, f.size)
    x = np.fft.irfft(shape * np.exp(1j * phase), samples)
    fade = np.clip(np.minimum(np.arange(samples), np.arange(samples)[::-1]) / RATE_HZ, 0.0, 1.0)
    return np.asarray(x / x.std() * fade**2 * (3.0 - 2.0 * fade))


def measure(target: Path, file: Path, level_v: float, seed: int) -> None:
    """Write what the table and its specimen answer to noise, a burst and a hold."""
    time_s = np.arange(2 * RATE_HZ) / RATE_HZ
    burst = 2.0 * level_v * np.sin(6.0 * np.pi * time_s) * np.sin(0.5 * np.pi * time_s) ** 2
    quiet = np.zeros(2 * RATE_HZ)
    command = np.concatenate([quiet, level_v * noise(120 * RATE_HZ, seed), quiet, burst, np.zeros(25 * RATE_HZ)])
    given = "\n".join(f"{volts:.9g}" for volts in command)
    words = [str(target), "-", str(RATE_HZ)]
    rows = subprocess.run(words, input=given, text=True, capture_output=True, check=True).stdout.splitlines()
    head = "time_s,command (V),table (V),floor_2 (V),floor_3 (V)"
    file.write_text("\n".join([head, *(f"{k / RATE_HZ:.6f},{row}" for k, row in enumerate(rows)), ""]))


class Laboratory:
    """A folder with a rig of its own name, its case, key and model, in which one run after the other is played."""

    def __init__(self, number: int) -> None:
        self.folder, self.rig = Path(tempfile.mkdtemp(prefix="rths-udp-faults-")), f"own_{number}"
        self.target = self.folder / "own_target"
        words = ["cc", "-std=c99", "-O2", "-o", str(self.target), str(HERE / "faults" / "own_target.c"), "-lm"]
        subprocess.run(words, check=True)
        make_secret(self.folder / "key")
        time_s = np.arange(0.0, RECORD_S, 0.01)
        accel = 4.0 * np.sin(4 * np.pi * time_s) * np.sin(np.pi * time_s / RECORD_S) ** 2
        rows = "\n".join(f"{value:.6g}" for value in accel)
        (self.folder / "short.csv").write_text(f"# dt: 0.01 s\n# units: m/s^2\n{rows}\n")
        (self.folder / "a.yaml").write_text(CASE)
        self.set_limit("")
        measure(self.target, self.folder / "loud.csv", 0.9, 1)
        measure(self.target, self.folder / "quiet.csv", 0.18, 2)
        words = [sys.executable, "-m", "rths_cli", "identify", "a.yaml", "--data", "loud.csv", "--data", "quiet.csv"]
        words += ["--set", f"table={self.rig}.yaml", "--set", f"sample_rate_hz={RATE_HZ}", "--quiet", "--no-figure"]
        words += ["--output", "model.h5"]
        env = environment(RTHS_KEY_FILE=str(self.folder / "key"))
        done = subprocess.run(words, cwd=self.folder, env=env, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"not identified: {done.stdout[-600:]} {done.stderr[-600:]}")

    def set_limit(self, tracking: str) -> None:
        """Write the rig's file with a limit on the tracking error, or without."""
        (self.folder / f"{self.rig}.yaml").write_text(RIG.replace("TRACKING", tracking))

    def close(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)

    def played(self, name: str, number: int) -> Row:
        """Play a kind at the instant of a number, again where this computer was the cause."""
        kind, random = KINDS[name], np.random.default_rng((number, *name.encode()))
        at_s = float(random.uniform(*MOVES_S))
        for _ in range(TRIES):
            code, reason, lost = self.once(kind, round((BEFORE_S + at_s) * RATE_HZ), number % 2 == 0)
            stopped = re.search(STOPPED_AT, reason)
            stopped_s = float(stopped[1]) if stopped else np.nan
            found = _judged(kind, code, reason)
            if not stopped_s < at_s - WITHIN_S and (found != "false" or not _own_fault(kind, reason, lost, stopped_s)):
                return Row(name, number, found, reason, stopped_s - at_s)
        return Row(name, number, NOT_JUDGED, reason, np.nan)

    def once(self, kind: Kind, at: int, tracked: bool) -> tuple[int, str, Array]:
        """Play one run; return its exit code, the reason in its file, and which samples of the record were lost (n,):
        1 an answer, 2 a step of ours."""
        self.set_limit(TRACKED if tracked else "")
        words = [str(self.target), str(self.folder / "key"), kind.what, f"{kind.value}"]
        words += [f"{number}" for number in (kind.channels, kind.last, at)]
        output = self.folder / "out"
        shutil.rmtree(output, ignore_errors=True)
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as target:
            assert target.stdout is not None
            port = int(target.stdout.readline())
            runner = start_runner(self.folder, output, self.rig, port, None, {})
            try:
                said = runner.communicate(timeout=PATIENCE_S)[1]
            finally:
                runner.kill()
                target.kill()
        files = [path for path in output.glob("*.h5") if not path.name.startswith(".")]
        if not files:
            return runner.returncode, f"no file: {said[-300:]}", np.zeros(0)
        with h5py.File(files[0]) as file:
            lost = file["exp_rths/timing/lost"][:] if "exp_rths/timing/lost" in file else np.zeros(0)
            reason = str(file.attrs["status_reason"]).removeprefix("EXP-RTHS: ")
            return runner.returncode, reason, np.nan_to_num(np.asarray(lost, dtype=float))


def _own_fault(kind: Kind, reason: str, lost: Array, stopped_s: float) -> bool:
    """Tell whether samples were lost to this computer shortly before the end, or the run never came to its record."""
    end = round(stopped_s * RATE_HZ) if np.isfinite(stopped_s) else lost.size
    recent = lost[max(end - round(STALLED_S * RATE_HZ), 0) : end]
    ours = recent == 2 if LINK in kind.failed else recent > 0
    stalled = bool((ours[1:] & ours[:-1]).any())
    return stalled or lost.size == 0 or (LINK not in kind.failed and any(words in reason for words in LOST))


def _judged(kind: Kind, code: int, reason: str) -> str:
    if code in (0, 1):
        return NOT_STOPPED
    if code == 4:
        named = next((parts for words, parts in OF_THE_RIG if words in reason), {MOTION})
        return "true" if named <= kind.failed else "group" if named & kind.failed else "false"
    for role, name in ROLES:
        reason = re.sub(role, name, reason)
    return verdict(set(kind.failed), reason) if code == 3 else "false"


# --- all of them


def played(names: list[str], numbers: range, workers: int) -> list[Row]:
    """Play all kinds, some runs at a time; each is told on stderr."""
    free: SimpleQueue[Laboratory] = SimpleQueue()
    hands = [Laboratory(number) for number in range(workers)]
    for laboratory in hands:
        free.put(laboratory)
    lock, rows = threading.Lock(), []

    def once(job: tuple[str, int]) -> None:
        laboratory = free.get()
        try:
            row = laboratory.played(*job)
        finally:
            free.put(laboratory)
        with lock:
            rows.append(row)
            told = f"{row.kind} {row.number}: {row.verdict}, after {row.after_s:.2f} s: {row.said}"
            print(told, file=sys.stderr, flush=True)

    try:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(once, [(name, number) for number in numbers for name in names]))
    finally:
        for laboratory in hands:
            laboratory.close()
    return rows


def show(names: list[str], rows: list[Row]) -> bool:
    """Print a line per kind; return whether no reason was false."""
    columns = ("true", "group", "false", NOT_STOPPED, NOT_JUDGED)
    print(f"{'kind':32}" + "".join(f"{column:>13}" for column in columns))
    for name in [*names, "all"]:
        counts = Counter(row.verdict for row in rows if name in (row.kind, "all"))
        print(f"{name:32}" + "".join(f"{counts[column]:13}" for column in columns))
        for row in rows:
            if row.kind == name and row.verdict == "false":
                print(f"    {row.number}: {row.said}")
    return all(row.verdict != "false" for row in rows)


def main() -> int:
    """Play what is asked for; return 1 when one reason is false."""
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    asked.add_argument("runs", nargs="?", type=int, default=20)
    asked.add_argument("--first", type=int, default=0, help="number of the first run of each kind")
    asked.add_argument("--kind", default="", help="only kinds whose name holds this")
    asked.add_argument("--workers", type=int, default=1)
    words = asked.parse_args()
    os.environ.pop("RTHS_KEY_FILE", None)
    names = [name for name in KINDS if words.kind in name]
    return 0 if show(names, played(names, range(words.first, words.first + words.runs), words.workers)) else 1


if __name__ == "__main__":
    sys.exit(main())
