"""The exported step in C beside the compiled one: written, compiled and played over the same samples."""

from __future__ import annotations

import ctypes
import os
import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from campaigns import step_run
from rths_cli.control.designed_blocks import Blocks
from rths_cli.experiment.designed_step import DesignedStep, Rehearsal
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, guard_limits, open_rig
from rths_cli.loop.guard import GuardLimits
from rths_cli.loop.realtime_run import perform, prepare
from rths_cli.loop.recorded_steps import Conducted, Recorded, conduct_over
from rths_cli.loop.run_log import signals, sizes_of
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array
from rths_cli.report.c_step.library import WRITTEN_ONCE
from rths_cli.report.c_step.numbers import data_text, sizes_text
from rths_cli.rigs.description import RigInfo

PLAY = Path(__file__).parent / "play_step.c"
SOURCES = Path(__file__).parents[3] / "rths_cli" / "report" / "c_step" / "source"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wconversion")
EQUAL = ("-O2", "-ffp-contract=off")
FAST = ("-O3", "-march=native")
SANITIZED = ("-O1", "-g", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
ZEROS, STILL, RAMP = 10, 20, 40  # instants, shorter than in a test
STOPPED = 5


def compiler() -> str | None:
    """Return the path of the C compiler, None when there is none."""
    return shutil.which(os.environ.get("CC", "cc"))


def bench_step(info: RigInfo, blocks: Blocks, limits: GuardLimits, drive: Array) -> DesignedStep:
    """Return a step of the bench with short times of its states."""
    still = Rehearsal(np.zeros((0, 3)), np.zeros((0, len(info.all_channels))))
    return DesignedStep("bench", info, blocks, limits, drive, (still, still), ZEROS, STILL, RAMP)


def recorded(step: DesignedStep, samples_v: Array, lost: Sequence[int] = (), stop_at: int | None = None) -> Recorded:
    """Return samples (n, c + f) without zeros as what reaches a step, with zeros added."""
    count, rest_v = len(samples_v), 1e-3 * (1.0 + np.arange(samples_v.shape[1]))
    came, stop = np.ones(count, dtype=bool), np.zeros(count, dtype=bool)
    came[list(lost)] = False
    stop[count if stop_at is None else stop_at :] = True
    return Recorded(samples_v + rest_v, came, stop, step.drive, step.still_steps, step.ramp_steps, rest_v)


def shipped(memory: Memory, case: str, settings: tuple[str, ...] = ()) -> tuple[DesignedStep, Recorded]:
    """Return the step of a case with the limits of its rig file, and the samples of its run on the virtual rig."""
    setup, blocks = step_run.prepared(memory, case, settings)
    drive, limits = step_run.inputs(setup, blocks).drive, guard_limits(setup)
    step, dt_s = bench_step(setup.rig, blocks, limits, drive), setup.rig.dt_s
    run = prepare(setup.rig, blocks, NUMERICAL, drive, limits, ramp_s=RAMP * dt_s, still_s=(STILL * dt_s, 0.0))
    rig = open_rig(setup, (EXP_RTHS,), setup.case.seed)
    rig.open()
    try:
        assert perform(rig, run) == ""
    finally:
        rig.close()
    log, count = signals(run.log, sizes_of(run.step)), int(run.log.done[0])
    samples_v = np.vstack([log.samples_v, log.further_v])[:, :count].T
    came, zeros_v = np.ones(count, dtype=bool), np.zeros(samples_v.shape[1])
    return step, Recorded(samples_v, came, ~came, drive, STILL, RAMP, zeros_v)


@dataclass(frozen=True)
class Played:
    """What the step in C made: signals by the names of rths_cli.loop.run_log.Signals, and how the test ended."""

    command_v: Array
    base_shear_n: Array
    desired: Array
    corrected: Array
    estimated: Array
    state: Array
    lost: Array
    law_force_n: Array
    reason: int
    channel: int
    seconds: float


def write(step: DesignedStep, folder: Path, source: str | None = None) -> None:
    """Write the sources and the numbers of a step; `source`: instead of rths_step.c."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in WRITTEN_ONCE:
        shutil.copy(SOURCES / name, folder / name)
    if source is not None:
        (folder / "rths_step.c").write_text(source, encoding="utf-8")
    (folder / "rths_sizes.h").write_text(sizes_text(step), encoding="utf-8")
    (folder / "rths_data.c").write_text(data_text(step), encoding="utf-8")


def compiled(
    step: DesignedStep, folder: Path, options: Sequence[str] = EQUAL, source: str | None = None
) -> ctypes.CDLL:
    """Write, compile and load a step, in a new folder below one: a library is loaded once by its path."""
    folder = Path(tempfile.mkdtemp(dir=folder))
    write(step, folder, source)
    objects = []
    for name in ("rths_step.c", "rths_data.c"):
        objects.append(str(folder / f"{name}.o"))
        build(folder, (*STRICT, *options, "-fPIC", "-c", name, "-o", objects[-1]))
    build(folder, (*options, "-fPIC", "-shared", f"-I{folder}", str(PLAY), *objects, "-lm", "-o", "step.so"))
    return ctypes.CDLL(str(folder / "step.so"))


def build(folder: Path, words: Sequence[str]) -> None:
    """Call the compiler in a folder; it has to accept the sources."""
    done = subprocess.run([str(compiler()), *words], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def played(library: ctypes.CDLL, given: Recorded) -> Played:
    """Play samples by the step in C."""
    count, channels = given.samples_v.shape
    width = ctypes.c_int64.in_dll(library, "width").value
    made = np.zeros((count, width))
    arrays = (given.zeros_v, given.samples_v, given.ground)
    doubles = [np.ascontiguousarray(one, dtype=float) for one in arrays]
    flags = [np.ascontiguousarray(one, dtype=np.int32) for one in (given.came, given.stop)]
    pointers = [ctypes.c_void_p(one.ctypes.data) for one in (*doubles, *flags, made)]
    library.play.restype = ctypes.c_double
    rows = ctypes.c_int64(len(given.ground))
    seconds = library.play(ctypes.c_int64(count), *pointers[:3], rows, *pointers[3:])
    columns = made.T
    return Played(
        columns[0], columns[1], columns[2:5], columns[12 : 12 + channels], columns[12 + channels :], columns[5],
        columns[9], columns[11], int(columns[6, -1]), int(columns[7, -1]), float(seconds),
    )  # fmt: skip


class Session:
    """A test on the step in C, call by call."""

    def __init__(self, library: ctypes.CDLL, channels: int) -> None:
        self._library, self._state, self._out = library, ctypes.create_string_buffer(1 << 20), bytearray(1 << 12)
        self._format = f"={channels + 3}d3i4x"
        library.rths_reset(self._state)

    def step(
        self, samples_v: Sequence[float], start: bool = False, stop: bool = False, came: bool = True
    ) -> tuple[float, int, int, int, int]:
        """Return command in V, state, reason, channel and the row that comes next."""
        given = struct.pack(self._format, *samples_v, 0.0, 0.0, 0.0, came, start, stop)
        out = (ctypes.c_char * len(self._out)).from_buffer(self._out)
        self._library.rths_step(self._state, given, out)
        return struct.unpack_from("=d4i", self._out)


def differences(ours: Conducted, theirs: Played, share: float) -> Iterator[str]:
    """Yield what differs: signals by more than a share of their peaks until the table rests, states, the end."""
    state = ours.log.state
    until = int(np.argmax(state == STOPPED)) if (state == STOPPED).any() else state.size
    if not np.array_equal(state[: until + 1], theirs.state[: until + 1]):
        yield f"states differ from step {int(np.argmax(state != theirs.state))} on"
    if (ours.reason, ours.channel) != (theirs.reason, theirs.channel):
        yield f"reason and channel {ours.reason}, {ours.channel}, in C {theirs.reason}, {theirs.channel}"
    if not np.array_equal(ours.log.lost[:until], theirs.lost[:until]):
        yield "lost samples"
    channels = len(ours.log.corrected)
    pairs = {
        "command_v": (ours.log.command_v, theirs.command_v),
        "base_shear_n": (ours.log.base_shear_n, theirs.base_shear_n),
        **{f"desired {q}": (ours.log.desired[q], theirs.desired[q]) for q in range(3)},
        **{f"corrected {c}": (ours.log.corrected[c], theirs.corrected[c]) for c in range(channels)},
        **{f"further {j}": (row, theirs.corrected[channels + j]) for j, row in enumerate(ours.log.further)},
        **{f"estimated {e}": (row, theirs.estimated[e]) for e, row in enumerate(ours.log.estimated)},
    }
    if len(ours.log.logged):
        pairs["law's force"] = (ours.log.logged[0], theirs.law_force_n)
    for name, (one, two) in pairs.items():
        peak = np.nanmax(np.abs(one[:until]), initial=0.0)
        if not np.allclose(two[:until], one[:until], rtol=0.0, atol=share * peak, equal_nan=True):
            yield f"{name}: {np.nanmax(np.abs(two[:until] - one[:until])) / peak:.1e} of its peak"


def both(
    step: DesignedStep, given: Recorded, folder: Path, options: Sequence[str] = EQUAL, source: str | None = None
) -> tuple[Conducted, Played]:
    """Play samples by the compiled step and by the one in C."""
    library = compiled(step, folder, options, source)
    return conduct_over(step.info, step.blocks, step.limits, given), played(library, given)
