"""`rths doctor --watchdog`: does a target without a key bring its table to rest when the runner falls silent?

The table is moved slowly, then nothing is sent any more; what happened is read from the target's own frames
(docs/reference/plain_link.md).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.errors import InputError
from rths_cli.experiment.real_rig_readiness import PROBE, open_rig, opened, rig_content
from rths_cli.files.watchdog_proofs import WatchdogProof, content_sha256, keep_proof
from rths_cli.rigs.interface import name_session
from rths_cli.rigs.udp.link import SENT_NS
from rths_cli.rigs.udp.packets import WATCHDOG
from rths_cli.rigs.udp.plain_frames import AT_REST, RUNNING, Frame
from rths_cli.rigs.udp.plain_rig import PlainRig

if TYPE_CHECKING:
    from rths_cli.experiment.setup import Setup
    from rths_cli.numerics.lti import Array
    from rths_cli.rigs.description import RigInfo

SHARE = 0.05  # of the stroke and of the converter's range that the table is moved
FASTEST = 0.1  # of the limits of velocity and acceleration that the motion takes
MOVING_S, HELD_S = 1.0, 0.2  # least time of the motion, time for which the command is held
FOLLOWS, AT_ZERO = 0.01, 0.02  # of the motion, within which the output shows the command, and is at zero again
RESTS_S, SETTLES_S = 2.0, 3.0  # time in which a target leads its output to zero; further time until it states rest
LATE_INTERVALS = 3  # after the watchdog's time, until the target's frames must show that it acted
LATER = 0.1  # of the watchdog's time, likewise
LOOK_S = 0.02  # interval of questions to a target that answers only


@dataclass(frozen=True)
class WatchdogTrial:
    """The result of `rths doctor --watchdog`; without `faults` it is the `proof` that was kept."""

    rig: str
    watchdog_s: float
    moved_v: float
    left_s: float | None  # from the last command to the first frame that no longer obeys; None: none came
    rested_s: float | None  # likewise to the output at zero and the table at rest
    latency_samples: float
    faults: tuple[str, ...]
    proof: WatchdogProof | None

    @property
    def exit_code(self) -> int:
        """Return 1 where the watchdog is not proven."""
        return 1 if self.faults else 0


def prove_watchdog(setup: Setup, say: Callable[[str], object]) -> WatchdogTrial:
    """Move a rig's table, fall silent, and see from its frames what its watchdog does; keep the proof if it acts.

    Raises InputError for a rig whose link proves it by its protocol or that has none, RigError for one that fails.
    """
    rig = open_rig(setup, (PROBE,), 0)
    if not isinstance(rig, PlainRig):
        raise InputError(
            f"--watchdog: rig {setup.rig.name} is of kind {setup.rig.kind}; only a udp_plain link needs it"
        )
    name_session(rig, "probe")
    command_v = motion_v(setup.rig)
    with opened(rig):
        rig.arm()
        say(f"moving the table to {1e3 * setup.rig.gain_m_per_v * command_v[-1]:.3g} mm")
        for volts in command_v:
            rig.exchange(float(volts))
        moved_v, latency = float(rig.link.acted_v[0]), rig.latency_samples
        say("silent: the target's watchdog has to act")
        frames = silence(rig)
        after = disobeyed(rig)
    left_s, rested_s = _times(frames, float(command_v[-1]))
    faults = tuple(_faults(setup.rig, float(command_v[-1]), moved_v, frames, after))
    proof = None
    if not faults:
        now = datetime.now(UTC).isoformat(timespec="seconds")
        content = content_sha256(rig_content(setup.case))
        assert left_s is not None and rested_s is not None  # a fault otherwise
        proof = WatchdogProof(setup.rig.name, content, now, moved_v, left_s, rested_s)
        keep_proof(proof)
    return WatchdogTrial(
        setup.rig.name, setup.rig.watchdog_s, moved_v, left_s, rested_s, latency, faults, proof
    )  # fmt: skip


def motion_v(info: RigInfo) -> Array:
    """Return commands (n,) in V from zero to a small displacement, smooth to the third derivative, and held there."""
    limits = info.limits
    end_m = SHARE * min(limits.stroke_m, info.gain_m_per_v * info.converters.range_v)
    fastest = FASTEST * limits.fastest_m_s(info.gain_m_per_v)
    # of x^3 (10 - 15 x + 6 x^2): the largest slope is 1.875, the largest curvature 5.774
    takes_s = max(MOVING_S, 1.875 * end_m / fastest, (5.774 * end_m / (FASTEST * limits.acceleration_m_s2)) ** 0.5)
    x = np.clip(np.arange(1, round((takes_s + HELD_S) / info.dt_s) + 1) * info.dt_s / takes_s, 0.0, 1.0)
    return np.asarray(end_m / info.gain_m_per_v * x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


Shown = list[tuple[float, Frame]]
"""The frames of a silence, each with the time since the last command in s."""


def silence(rig: PlainRig) -> Shown:
    """Send no command until the watchdog and the way to rest must be over; return the frames that came.

    A target that answers only is asked, first when the losses borne are over: a question is no command.
    """
    last_ns = int(rig.link.status[SENT_NS])
    borne_s = (rig.info.limits.lost_samples + 1) * rig.info.dt_s
    until_s = longest_s(rig.info) + RESTS_S + SETTLES_S
    frames: Shown = []
    if not rig.cable.of_target:
        time.sleep(max(borne_s - _since_s(last_ns), 0.0))
    while (since_s := _since_s(last_ns)) < until_s and not (frames and frames[-1][1].order == AT_REST):
        frame = rig.asked(min(LOOK_S, until_s - since_s))
        if frame is not None:
            frames.append((_since_s(last_ns), frame))
        if not rig.cable.of_target:
            time.sleep(LOOK_S)
    return frames


def longest_s(info: RigInfo) -> float:
    """Return until when after the last command the target's frames must show that its watchdog acted, in s."""
    return info.watchdog_s * (1.0 + LATER) + LATE_INTERVALS * info.dt_s + LOOK_S


def _since_s(time_ns: int) -> float:
    return 1e-9 * (time.monotonic_ns() - time_ns)


def disobeyed(rig: PlainRig) -> Frame | None:
    """Send a command of the session that is over; return what the target shows after it, None if it is silent."""
    shown = None
    for _ in range(3):
        rig.post_command(float(rig.link.acted_v[0]))
        time.sleep(max(LATE_INTERVALS * rig.info.dt_s, LOOK_S))
        rig.discard()
        shown = rig.asked(0.2) or shown
    return shown


def _times(frames: Shown, end_v: float) -> tuple[float | None, float | None]:
    """Return after which times the target obeyed no longer, and was at rest; None: it never did, or was."""
    left = [since_s for since_s, frame in frames if frame.order != RUNNING]
    rested = [s for s, frame in frames if frame.order == AT_REST and abs(frame.command_v) <= AT_ZERO * abs(end_v)]
    return (left[0] if left else None), (rested[0] if rested else None)


def _faults(info: RigInfo, end_v: float, moved_v: float, frames: Shown, after: Frame | None) -> list[str]:
    """Return a sentence for each thing that the target's watchdog did wrong, or that nothing shows."""
    if not frames:
        return ["the target sent no frame after the last command, so nothing shows what it did"]
    if abs(moved_v - end_v) > FOLLOWS * abs(end_v):
        told = f"an output of {moved_v:.4g} V for a command of {end_v:.4g} V (byte 32)"
        return [f"its frames state {told}; nothing is shown"]
    return [*_faults_of_time(info, end_v, frames), *_faults_of_rest(info, end_v, frames, after)]


def _faults_of_time(info: RigInfo, end_v: float, frames: Shown) -> Iterator[str]:
    """Yield what is wrong with the time at which the watchdog acted, and with what it states."""
    left_s, _ = _times(frames, end_v)
    borne_s = (info.limits.lost_samples + 1) * info.dt_s
    if left_s is None:
        yield f"the target still obeyed {frames[-1][0]:.2f} s after the last command: its watchdog does not act"
        return
    acted = f"it acted {left_s:.3g} s after the last command"
    if left_s > longest_s(info):
        yield f"{acted}, watchdog_s is {info.watchdog_s:g}; correct one"
    elif left_s < borne_s and frames[0][0] < left_s:
        yield f"{acted}, limits.lost_samples bears {borne_s:.3g} s; let the watchdog wait longer"
    if not any(frame.faults & WATCHDOG for _, frame in frames):
        yield "it does not state fault 1 (watchdog), so a run could not tell why it ended"


def _faults_of_rest(info: RigInfo, end_v: float, frames: Shown, after: Frame | None) -> Iterator[str]:
    """Yield what is wrong with the way to rest, and with what follows it."""
    zero_v, most_s = AT_ZERO * abs(end_v), longest_s(info) + RESTS_S
    small = [since_s for since_s, frame in frames if abs(frame.command_v) <= zero_v]
    if small and small[0] > most_s:
        yield f"its output came to 0 only {small[0]:.3g} s after the last command, at most {most_s:.3g}"
    if _times(frames, end_v)[1] is None:
        worst = max(abs(frame.command_v) for _, frame in frames[-3:])
        yield f"its output was {worst:.4g} V at the end, and it did not state that it is at rest: it is not led to 0"
    elif after is None or after.order != AT_REST or abs(after.command_v) > zero_v:
        yield "it obeyed a command of the session that its watchdog had ended, or stated nothing after it"
    if max(abs(frame.command_v) for _, frame in frames) > (1.0 + FOLLOWS) * abs(end_v):
        yield "its output went beyond the last command on the way to rest"
