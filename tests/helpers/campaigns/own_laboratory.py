"""A laboratory with a target, a table and a specimen of its own (own_target.c), in which one thing fails.

It is identified from its own records by `rths identify --data`. `Laboratory.counted` plays a run in counted time, the
target answering each command of the compiled loop when it comes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from told_causes import ALL, FIRST, LINK, SPECIMEN, TABLE, TABLE_SENSOR, TOP

from rths_cli.case.load import load_cases
from rths_cli.experiment.design import design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.real_rig_readiness import guard_limits
from rths_cli.experiment.setup import make_setup
from rths_cli.loop import realtime_run
from rths_cli.loop.diagnosis import cause_of
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.loop.stop_reasons import reason_of
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.udp.session import make_secret

HERE = Path(__file__).parent
TREE = HERE.parents[2]
Array = NDArray[np.float64]
STOP_BUTTON = "emergency stop"
RATE_HZ, RECORD_S, BEFORE_S = 500, 4.5, 2.0  # a second at rest and the ramp come before the record
MOVES_S = (0.8, 3.3)  # of the record: when the faults come
TABLE_ALONE, FLOOR_2, FLOOR_3, EVERY, TABLE_AND_FLOOR, FLOORS = 1, 2, 4, 7, 3, 6  # masks of channels

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

    @property
    def of_the_link(self) -> bool:
        """Tell whether it is a fault of packets or of the target's own state, which only UDP can show."""
        return LINK in self.failed or self.what == "fault-bits"


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
    shown = subprocess.run(words, input=given, text=True, capture_output=True, check=True).stdout.splitlines()
    rows = (f"{k / RATE_HZ:.6f},{volts:.9g},{row}" for k, (volts, row) in enumerate(zip(command, shown, strict=False)))
    file.write_text("\n".join(["time_s,command (V),table (V),floor_2 (V),floor_3 (V)", *rows, ""]))


class Laboratory:
    """A folder with a rig of its own name, its case, key and model, in which one run after the other is played."""

    def __init__(self, folder: Path, number: int = 0) -> None:
        self.folder, self.rig = folder, f"own_{number}"
        self.target = self.folder / "own_target"
        words = ["cc", "-std=c99", "-O2", "-o", str(self.target), str(HERE / "own_target.c"), "-lm"]
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
        env = {**os.environ, "PYTHONPATH": str(TREE), "RTHS_KEY_FILE": str(self.folder / "key")}
        done = subprocess.run(words, cwd=self.folder, env=env, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"not identified: {done.stdout[-600:]} {done.stderr[-600:]}")

    def set_limit(self, tracking: str) -> None:
        """Write the rig's file with a limit on the tracking error, or without."""
        (self.folder / f"{self.rig}.yaml").write_text(RIG.replace("TRACKING", tracking))

    def words(self, kind: Kind, at: int) -> list[str]:
        """Return what own_target.c is told of a fault."""
        return [kind.what, f"{kind.value}", *(f"{number}" for number in (kind.channels, kind.last, at))]

    def counted(self, kind: Kind, at: int, tracked: bool) -> tuple[int, str, float]:
        """Play one run in counted time, the fault in interval `at` of it; return the guard's reason, what is told of
        it, and when it stopped, in s of the record."""
        self.set_limit(TRACKED if tracked else "")
        settings = (f"table={self.folder / self.rig}.yaml", f"sample_rate_hz={RATE_HZ}")
        more = (f"identification.model={self.folder / 'model.h5'}", "runs=[exp_rths]")
        setup = make_setup(load_cases([str(self.folder / "a.yaml")], (*settings, *more))[0])
        design = design_blocks(setup, Memory().at_rest(setup, lambda _: None).found)
        drive = drive_of(setup, design)
        run = realtime_run.prepare(setup.rig, design.blocks, NUMERICAL, drive, guard_limits(setup), still_s=(1.0, 0.0))
        words = [str(self.target), "-", str(RATE_HZ), *self.words(kind, at)]
        with CountedRig(setup.rig, words) as rig:
            realtime_run.perform(rig, run)
        reason = int(run.guard.flags[1])
        log = signals(run.log, sizes_of(run.step))
        cause = cause_of(run.info, run.blocks, run.limits, run.guard, log)
        told = reason_of(run.info, run.limits, run.guard, NUMERICAL, cause)
        return reason, told, float(run.guard.flags[3]) / RATE_HZ - BEFORE_S


class CountedRig:
    """The target without a clock: it answers each command by the samples of the next interval."""

    def __init__(self, info: RigInfo, words: list[str]) -> None:
        self.info, self._words = info, words

    def __enter__(self) -> CountedRig:
        self._target = subprocess.Popen(self._words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        return self

    def __exit__(self, *_: object) -> None:
        self._target.kill()
        self._target.communicate()

    def open(self) -> None: ...

    def arm(self) -> Array:
        """Return the first samples in V, (c,)."""
        assert self._target.stdout is not None
        return np.array([float(volts) for volts in self._target.stdout.readline().split(",")])

    def exchange(self, command_v: float) -> Array:
        """Give the command of an interval, return the next samples in V, (c,)."""
        assert self._target.stdin is not None
        self._target.stdin.write(f"{command_v:.17g}\n")
        self._target.stdin.flush()
        return self.arm()

    def rest(self) -> None: ...

    def close(self) -> None: ...


def instant(name: str, number: int) -> int:
    """Return the interval, counted from the first at rest, in which a kind's fault of a number comes."""
    at_s = np.random.default_rng((number, *name.encode())).uniform(*MOVES_S)
    return round((BEFORE_S + float(at_s)) * RATE_HZ)
