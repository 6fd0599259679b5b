"""The work of `rths bridge opensees`: a pseudo-dynamic test whose equations another program solves.

The rig goes from rest to rest: a ramp to the displacement that the client asks for, a hold, the mean of displacement
and force over the hold's second half. A displacement that is missed is corrected by the miss, as the command of a
laboratory's outer loop is, until it is within the tolerance. Every sample passes the guard.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.case.program_schema import FORCES_N, LENGTHS_M
from rths_cli.errors import InputError, LimitError, RigError
from rths_cli.experiment.identify_on_rig import listening_blocks
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, guard_limits, open_rig, opened
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.durable_files import further_names
from rths_cli.loop.guard import RUNNING, STOPPED, GuardLimits, GuardState, fresh_guard, without_zeros
from rths_cli.loop.run_log import empty_log, signals, sizes_of
from rths_cli.loop.simulated_time_run import think_once
from rths_cli.loop.step_arrays import EXCITATION, assemble
from rths_cli.loop.stop_reasons import stop_of
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import BRAKE_SHARE
from rths_cli.rigs.interface import Rig, as_commands
from rths_cli.rigs.openfresco import Client, Command, listening
from rths_cli.version import __version__

CHUNK = 1024  # samples that are played before signals are handled
ZEROS_S = 1.0  # at rest before the test, over which zeros and noise are measured
STANDARD_ERRORS = 4.0  # of the mean displacement, that the default tolerance allows for
CORRECTIONS = 10  # of a displacement, after which the actuator does not follow
CORRECTED = 0.2  # of the displacement, beyond which a correction means a sensor that is not to be believed
KEPT = 0.5  # of a miss within the tolerance, that goes into the next correction
RAMP_SHARE = 0.5  # of the acceleration with which the guard brakes, that a ramp takes
ITERATES = 1.5  # moves in a step, from which the client iterates
COLUMNS = ("step", "model_time_s", "rig_time_s", "target_m", "command_m", "measured_m", "force_n", "corrections")
Say = Callable[[str], object]


@dataclass(frozen=True)
class BridgeRequest:
    """Arguments of `rths bridge opensees`."""

    case: str
    settings: tuple[str, ...]
    length: str  # the client's units
    force: str
    host: str
    port: int
    rate_m_s: float
    hold_s: float
    tolerance_m: float | None
    silent_after_s: float
    output: Path | None


@dataclass(frozen=True)
class Bridged:
    """A test that was carried out to its end."""

    file: Path
    steps: int  # that the client committed
    moves: int
    rig_time_s: float
    tolerance_m: float
    largest_miss_m: float
    force_error_n: float  # largest standard error of a force, from the scatter within its hold
    largest_displacement_m: float
    largest_force_n: float

    @property
    def notes(self) -> list[str]:
        """Return what must be known of it."""
        if self.moves <= ITERATES * max(self.steps, 1):
            return []
        return [
            f"the specimen was moved {self.moves} times in {self.steps} steps: the client iterates, and a specimen "
            "that yields remembers each trial; use an integrator without iterations (NewmarkExplicit, AlphaOS)"
        ]


class Held(NamedTuple):
    """Means over a hold."""

    target_m: float
    measured_m: float
    force_n: float
    force_error_n: float  # standard error
    corrections: int


def bridge_opensees(request: BridgeRequest, say: Say, progress: Say = lambda _: None) -> Bridged:
    """Carry out the pseudo-dynamic test of one client; however it ends, the actuator is then at rest at zero.

    Raises InputError for bad input and a client that wants another rig, LimitError for a displacement beyond the limits
    or no number, and where the guard stopped; RigError where rig or client fails.
    """
    setup = make_setup(load_cases([request.case], request.settings)[0])
    rig = open_rig(setup, (EXP_RTHS,), setup.case.seed)
    _check(request, setup)
    path = _free(request, setup.case.name)
    with listening(request.host, request.port) as door, opened(rig):
        host, port = door.getsockname()
        actuator = Actuator(setup, rig, request)
        say(f"rig {setup.rig.name} at {host}:{port}; end with Ctrl-C")
        say(f"in OpenSees: element genericClient TAG -node NODE -dof DOF -server {port} {host}")
        link, peer = door.accept()
        door.close()
        with link:
            client = Client(link, request.silent_after_s)
            say(f"client {peer[0]}:{peer[1]}; {path} gets a line for each move")
            with _opened(path) as file:
                return PseudoDynamic(client, actuator, request, path, file, progress).whole()


def _check(request: BridgeRequest, setup: Setup) -> None:
    """Raise InputError where rig or options allow no such test."""
    rig, fastest = setup.rig, setup.rig.limits.fastest_m_s(setup.rig.gain_m_per_v)
    if rig.interface != "displacement":
        raise InputError(
            f"rig {rig.name} follows an acceleration; a pseudo-dynamic test needs one with "
            "interface: {command: displacement, feedback: force}, such as servo_hydraulic"
        )
    if rig.can.moves_hardware:
        raise InputError(f"rig {rig.name} moves hardware; rths bridge has virtual rigs only so far")
    if request.rate_m_s > fastest:
        key = rig.limits.of_fastest(rig.gain_m_per_v)
        raise InputError(f"--rate: {request.rate_m_s:g} m/s is above {key} of rig {rig.name}, {fastest:g} m/s")


def _free(request: BridgeRequest, name: str) -> Path:
    """Return the file that the test writes; raises InputError for one that exists."""
    if request.output is not None:
        if request.output.exists():
            raise InputError(f"--output: {request.output} exists and is not replaced; give another name")
        if not request.output.absolute().parent.is_dir():
            raise InputError(f"--output: there is no folder {request.output.absolute().parent}; make it")
        return request.output
    usual = Path(f"{name}-bridge.csv")
    return next(one for one in chain([usual], further_names(usual)) if not one.exists())


def _opened(path: Path) -> IO[str]:
    """Return a new file; raises InputError where it cannot be made."""
    try:
        return path.open("x", encoding="utf-8", newline="", buffering=1)
    except OSError as error:
        raise InputError(f"--output: {path} cannot be written: {error.strerror}; choose another name") from None


class Actuator:
    """A rig of one actuator that is moved from rest to rest, each sample through the guard."""

    def __init__(self, setup: Setup, rig: Rig, request: BridgeRequest) -> None:
        """Measure zeros and noise at rest; the rig is open."""
        self._info, self._rig, self._rate = setup.rig, rig, request.rate_m_s
        self.stiffness_n_per_m = float(setup.building.specimen.K[0, 0])
        self._blocks = listening_blocks(setup)
        self._state = assemble(self._blocks, EXCITATION)
        self._sizes, dt_s = sizes_of(self._state), self._info.dt_s
        self._guard: GuardState = fresh_guard(self._sizes.channels)
        self._log, self._drive = empty_log(CHUNK + 1, self._sizes), np.zeros((CHUNK + 1, 3))
        self.samples = 0
        self._hold = max(round(request.hold_s / dt_s), 2)
        self._shown = rig.arm()
        self._zeros_v = np.zeros(self._state.samples.size)
        still = np.array([self._exchanged(0.0) for _ in range(round(ZEROS_S / dt_s))])
        self._zeros_v = still.mean(axis=0)
        self._limits: GuardLimits = without_zeros(guard_limits(setup), self._zeros_v)
        self._scratch = np.zeros(2, dtype=np.int64)
        self._think = think_once.bind(
            self._state, self._limits, self._guard, self._drive, CHUNK, self._log, self._scratch
        )
        sensor, bit_v = self._info.channels[0], self._info.converters.step_v
        per_m = sensor.sensitivity_v_per_unit
        noise = STANDARD_ERRORS * float(still[:, 0].std()) / per_m / math.sqrt(self._hold - self._hold // 2)
        least = noise + bit_v * (self._info.gain_m_per_v + 1.0 / per_m)
        self.tolerance_m = request.tolerance_m or max(least, 1e-9)
        self._place, self._correction = 0.0, 0.0  # m, commanded
        self.held = Held(0.0, 0.0, 0.0, 0.0, 0)

    @property
    def command_m(self) -> float:
        """Return where the actuator was sent."""
        return self._place

    @property
    def time_s(self) -> float:
        """Return the rig's time since it was armed."""
        return self.samples * self._info.dt_s

    def judge(self, target_m: float) -> None:
        """Raise LimitError for a displacement that the rig cannot reach, or at which it would exceed its force."""
        limits, info = self._info.limits, self._info
        reach = min(limits.stroke_m, info.gain_m_per_v * info.converters.range_v, info.channels[0].range)
        if abs(target_m) > reach:
            raise LimitError(
                f"a displacement of {1e3 * target_m:.6g} mm is asked for, the limit of rig {info.name} is "
                f"{1e3 * reach:g} mm; check the units (--length) and whether the integration is stable"
            )
        force = self.held.force_n + self.stiffness_n_per_m * (target_m - self.held.measured_m)
        most = min(limits.force_n, info.channels[1].range)
        if abs(force) > most:
            raise LimitError(
                f"a displacement of {1e3 * target_m:.6g} mm is asked for, which takes about {force:.4g} N by the "
                f"declared specimen; the limit of rig {info.name} is {most:g} N; lower the excitation"
            )

    def move_to(self, target_m: float) -> Held:
        """Bring the measured displacement to a target and return the means over the hold.

        Raises LimitError where the guard stops it, RigError where the sensor shows something else.
        """
        self.judge(target_m)
        goal = target_m + self._correction
        for corrections in range(CORRECTIONS + 1):
            self._ramp(goal)
            shown = self._play(np.full(self._hold, goal))[:, self._hold // 2 :]
            measured, force = (float(one) for one in shown.mean(axis=1))
            miss = target_m - measured
            if abs(miss) <= self.tolerance_m:
                error = float(shown[1].std()) / math.sqrt(shown.shape[1])
                self._correction = goal - target_m + KEPT * miss
                self.held = Held(target_m, measured, force, error, corrections)
                return self.held
            goal += miss
            if abs(goal - target_m) > CORRECTED * abs(target_m) + 20.0 * self.tolerance_m:
                break
        raise RigError(
            f"rig {self._info.name}: channel {self._info.channels[0].name} shows {1e3 * measured:.4g} mm where "
            f"{1e3 * target_m:.4g} mm were commanded, and corrections do not mend it; check its cable, sign and "
            "sensitivity, and nominal.gain_m_per_v"
        )

    def go_home(self) -> None:
        """Return to zero as slowly as the test moves; the guard's own way where that fails."""
        try:
            if self._guard.flags[0] == RUNNING:
                self._ramp(0.0)
                self._play(np.zeros(self._hold))
        finally:
            self._to_rest()

    def _ramp(self, goal_m: float) -> None:
        """Go to a commanded displacement along half a cosine of the stated largest rate."""
        way = goal_m - self._place
        most = RAMP_SHARE * BRAKE_SHARE * self._info.limits.acceleration_m_s2
        lasts_s = max(0.5 * math.pi * abs(way) / self._rate, math.pi * math.sqrt(0.5 * abs(way) / most))
        count = max(math.ceil(lasts_s / self._info.dt_s), 1)
        share = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / count)
        self._play(self._place + way * share)
        self._place = goal_m

    def _play(self, place_m: Array) -> Array:
        """Command displacements (n,) in m and return displacement and force (2, n) at their samples."""
        found = np.zeros((2, len(place_m)))
        for first in range(0, len(place_m), CHUNK):
            rows = place_m[first : first + CHUNK]
            self._drive[: len(rows), 0] = rows / self._info.gain_m_per_v
            self._log.done[0] = 0
            for _ in rows:
                self._sample()
                if self._guard.flags[0] != RUNNING:
                    self._to_rest()
                    why = stop_of(self._info, self._limits, self._guard, EXCITATION)
                    raise LimitError(f"rig {self._info.name}: {why}")
            found[:, first : first + len(rows)] = signals(self._log, self._sizes).corrected[:, : len(rows)]
        return found

    def _sample(self) -> None:
        self._state.samples[:] = self._shown - self._zeros_v
        self._think()
        self._exchanged(self._state.command)

    def _exchanged(self, command_v: Array | float) -> Array:
        self._shown = self._rig.exchange(as_commands(np.atleast_1d(command_v)))
        self.samples += 1
        return self._shown.copy()

    def _to_rest(self) -> None:
        """Let the guard lead the actuator to zero: it takes over after the last row of what may be played."""
        while self._guard.flags[0] != STOPPED:
            self._log.done[0] = CHUNK
            self._sample()


class PseudoDynamic:
    """A client's test."""

    def __init__(
        self, client: Client, actuator: Actuator, request: BridgeRequest, path: Path, file: IO[str], progress: Say
    ) -> None:
        self._client, self._actuator, self._path, self._file, self._progress = client, actuator, path, file, progress
        self._length, self._force = LENGTHS_M[request.length], FORCES_N[request.force]
        self._steps, self._moves = 0, 0
        self._held: Held | None = None
        self._target, self._time_s = 0.0, 0.0
        self._largest = np.zeros(4)  # miss, force's error, displacement, force
        self._csv: Any = csv.writer(file, lineterminator="\n")
        file.write(
            f"# rths {__version__}, rths bridge opensees: case {request.case}, length {request.length}, force "
            f"{request.force}, rate {request.rate_m_s:g} m/s, hold {request.hold_s:g} s, tolerance "
            f"{actuator.tolerance_m:.3g} m\n"
        )
        self._csv.writerow(COLUMNS)

    def whole(self) -> Bridged:
        """Serve the client to its end; then the actuator is at zero, and the file's last line says how it ended."""
        try:
            for asked in self._client.messages():
                if asked.command is Command.TRIAL:
                    self._target, self._time_s = asked.displacement * self._length, asked.time_s
                    self._judged()
                elif asked.command is Command.COMMIT:
                    self._there()
                    self._steps += 1
                    self._progress(f"step {self._steps}, t = {self._time_s:g} s, {1e3 * self._target:.3f} mm")
                else:
                    self._client.answer(self._answer(asked.command))
            ended = "complete"
        except OSError as error:
            ended = f"{self._path} cannot be written: {error.strerror}"
            raise RigError(ended) from None
        except BaseException as error:
            ended = str(error) or f"by a signal ({type(error).__name__})"
            raise
        finally:
            try:
                self._actuator.go_home()
            finally:
                with suppress(OSError):
                    self._file.write(f"# ended after {self._steps} steps: {' '.join(ended.split())}\n")
        figures = (float(one) for one in self._largest)
        return Bridged(
            self._path, self._steps, self._moves, self._actuator.time_s, self._actuator.tolerance_m, *figures
        )

    def _judged(self) -> None:
        """Raise LimitError with the instant, for a displacement beyond the limits."""
        try:
            self._actuator.judge(self._target)
        except LimitError as error:
            raise LimitError(f"at t = {self._time_s:g} s {error}") from None

    def _answer(self, command: Command) -> float:
        """Return what a client wants to know, in its units."""
        stiffness = self._actuator.stiffness_n_per_m * self._length / self._force
        if command is Command.FORCE:
            return self._there().force_n / self._force
        if command is Command.DISPLACEMENT:
            return self._there().measured_m / self._length
        if command is Command.TIME:
            return self._time_s
        # a specimen at rest: no velocity, no damping and no inertia
        return stiffness if command in (Command.INITIAL_STIFFNESS, Command.TANGENT) else 0.0

    def _there(self) -> Held:
        """Return the means at the displacement asked for, after a move where the actuator stands elsewhere."""
        if self._held is None or self._held.target_m != self._target:
            self._held = held = self._actuator.move_to(self._target)
            self._moves += 1
            miss = abs(held.measured_m - held.target_m)
            now = np.array([miss, held.force_error_n, abs(held.measured_m), abs(held.force_n)])
            self._largest = np.maximum(self._largest, now)
            place, at = self._actuator.command_m, self._actuator.time_s
            numbers = (self._time_s, at, held.target_m, place, held.measured_m, held.force_n)
            self._csv.writerow([self._steps, *(f"{one:.9g}" for one in numbers), held.corrections])
        return self._held
