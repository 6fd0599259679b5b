"""Whether a test on an independent target over UDP names the true reason first when something of the rig fails.

    python benchmarks/udp_fault_reasons.py [RUNS] [--first N] [--kind WORD] [--workers N] [--counted]

`tests/helpers/campaigns/own_target.c`, compiled here, is a target written from docs/reference/udp.md with its own table
and specimen; `rths identify --data` identifies it from its own records, then `rths run` plays a short record, 500 Hz.
Of each kind RUNS runs (20 by default) are played, from number `--first` on, the fault at a random instant at which the
table moves, every other run without a limit on the tracking error. What is named first in the file's reason is the part
that failed (true), a group that contains it, or another part (false). A run that was stopped before its fault, or whose
reason is false after this computer itself lost samples, is played again, twice at most, and then not judged. Exit code
1 where one reason is false.

`--counted`: faults of sensors, command and table in counted time, where the target answers when it is asked and no
packets are sent: a hundred times as fast, the same bytes again on every machine.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from options import arguments, parsed

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "tests" / "helpers"))

import h5py  # noqa: E402
from campaigns.fault_bench import start_runner  # noqa: E402
from campaigns.own_laboratory import BEFORE_S, KINDS, RATE_HZ, STOP_BUTTON, TRACKED, Array, Kind, Laboratory, instant  # noqa: E402
from told_causes import ALL, LINK, MOTION, TABLE, verdict  # noqa: E402

from rths_cli.loop.guard import END, NONE  # noqa: E402

PATIENCE_S, TRIES, NO_END = 240.0, 3, -1
WITHIN_S = 0.01  # of the fault: a stop before it has another cause
STALLED_S = 0.3  # before the end of the series: samples lost there may be the cause
STOPPED_AT = r" at (-?[0-9.]+) s of "
LOST = ("answers of target", "watchdog missed", "samples were lost", "steps overran")
ROLES = ((r"channel(s?) table", r"channel\1 channel_0"), ("floor_2", "channel_1"), ("floor_3", "channel_2"))
NOT_STOPPED, NOT_JUDGED = "not stopped", "not judged"
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


# --- one run


def counted(laboratory: Laboratory, name: str, number: int) -> Row:
    """Play a kind at the instant of a number in counted time."""
    at = instant(name, number)
    reason, told, stopped_s = laboratory.counted(KINDS[name], at, number % 2 == 0)
    found = NOT_STOPPED if reason in (NONE, END) else _judged(KINDS[name], 3, told)
    after_s = stopped_s + BEFORE_S - at / RATE_HZ
    return Row(name, number, NOT_JUDGED if after_s < -WITHIN_S else found, told, after_s)


def in_real_time(laboratory: Laboratory, name: str, number: int) -> Row:
    """Play a kind at the instant of a number over UDP, again where this computer was the cause."""
    kind, at = KINDS[name], instant(name, number)
    at_s, reason = at / RATE_HZ - BEFORE_S, ""
    for _ in range(TRIES):
        code, reason, lost = once(laboratory, kind, at, number % 2 == 0)
        stopped = re.search(STOPPED_AT, reason)
        stopped_s = float(stopped[1]) if stopped else np.nan
        found = _judged(kind, code, reason)
        if not stopped_s < at_s - WITHIN_S and (found != "false" or not _own_fault(kind, reason, lost, stopped_s)):
            return Row(name, number, found, reason, stopped_s - at_s)
    return Row(name, number, NOT_JUDGED, reason, np.nan)


def once(laboratory: Laboratory, kind: Kind, at: int, tracked: bool) -> tuple[int, str, Array]:
    """Play one run; return its exit code, the reason in its file, and which samples of the record were lost (n,):
    1 an answer, 2 a step of ours."""
    laboratory.set_limit(TRACKED if tracked else "")
    words = [str(laboratory.target), str(laboratory.folder / "key"), *laboratory.words(kind, at)]
    output = laboratory.folder / "out"
    shutil.rmtree(output, ignore_errors=True)
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as target:
        assert target.stdout is not None
        port = int(target.stdout.readline())
        runner = start_runner(laboratory.folder, output, laboratory.rig, port, None, {})
        try:
            said = runner.communicate(timeout=PATIENCE_S)[1]
        except subprocess.TimeoutExpired:
            return NO_END, f"it did not end within {PATIENCE_S:g} s", np.zeros(0)
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

Play = Callable[[Laboratory, str, int], Row]


def played(names: list[str], numbers: range, workers: int, play: Play) -> list[Row]:
    """Play all kinds, some runs at a time; each is told on stderr."""
    free: SimpleQueue[Laboratory] = SimpleQueue()
    folder = Path(tempfile.mkdtemp(prefix="rths-udp-faults-"))
    for number in range(workers):
        (folder / f"{number}").mkdir()
        free.put(Laboratory(folder / f"{number}", number))
    lock, rows = threading.Lock(), []

    def once(job: tuple[str, int]) -> None:
        laboratory = free.get()
        try:
            row = play(laboratory, *job)
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
        shutil.rmtree(folder, ignore_errors=True)
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
    asked = arguments(__doc__)
    asked.add_argument("runs", nargs="?", type=int, default=20)
    asked.add_argument("--seed", "--first", dest="first", type=int, default=0, help="of the first run of a kind")
    asked.add_argument("--kind", default="", help="only kinds whose name holds this")
    asked.add_argument("--workers", type=int, default=1)
    asked.add_argument("--counted", action="store_true", help="in counted time, without faults of target and link")
    words = parsed(asked)
    os.environ.pop("RTHS_KEY_FILE", None)
    names = [name for name, kind in KINDS.items() if words.kind in name and not (words.counted and kind.of_the_link)]
    play = counted if words.counted else in_real_time
    rows = played(names, range(words.first, words.first + words.runs), words.workers, play)
    return 0 if show(names, rows) else 1


if __name__ == "__main__":
    sys.exit(main())
