"""Inject faults of every kind at random instants, and judge what the table was given and what is left.

python benchmarks/faults.py [RUNS] [--seed N] [--kind WORD] [--only runs|processes] [--workers N]

Two levels. In one process, step, guard and loop play on a virtual table whose sensors, cables, amplifier, source and
operator fail (tests/helpers/loop_faults.py: RUNS runs each, 20 by default). As processes, `rths serve`, a relay and
`rths run` are killed, frozen, cut off, cheated and starved of disk space (benchmarks/faults/fault_kinds.py: RUNS / 10).
Exit code 1 when one run broke a limit, left its table moving, or told another reason, status or exit code.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

import numpy as np
from options import arguments, parsed

SHORT = ("1", "--only", "runs", "--kind", "stuck")
PRINTS = r"\d+ s$"  # the short form at its end

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "faults"), str(HERE.parent / "tests" / "helpers")]

REST_S, OUR_BUG = 2.0, 5
TOLD_S = 0.25  # from the table at rest until its server's line is read here
LOST_S = 1.0  # of samples, after a kill
RAMP_S, ENDING_S = 1.0, 0.3
TRIES, TOO_SOON = 3, "ended before the fault came"  # on a machine that others use, a run may fail by itself
STOLEN_S = 0.05  # of a processor within 0.1 s, by the host of a virtual machine: enough to end any run


@dataclass(frozen=True)
class Row:
    """What one run showed: seconds to rest (None: nobody was left to tell), shares of limits, and what was wrong.

    `beside`: it says nothing of its fault, as something else ended it.
    """

    kind: str
    rest_s: float | None
    used: dict[str, float]
    ending: str
    faults: tuple[str, ...]
    beside: bool = False


# --- in one process


def in_process(name: str, seed: int) -> Row:
    """Play one run with a fault of sensors, cables, amplifier, source or operator."""
    import faulty

    from rths_cli.loop.guard import END, NONE, REASONS

    ended, info = faulty.performed(name, seed), faulty.bench_info()
    place = info.gain_m_per_v * np.concatenate([[0.0], ended.commands_v])
    share = {
        "stroke": np.abs(place).max() / info.limits.stroke_m,
        "velocity": np.abs(np.diff(place)).max() / info.dt_s / info.limits.velocity_m_s,
        "range": np.abs(ended.commands_v).max() / info.converters.range_v,
    }
    rest = (len(ended.commands_v) - ended.taken_over) * info.dt_s
    told = "the rig's own fault" if ended.reason == NONE else REASONS[ended.reason].partition(" (")[0]
    ending = "to the end" if ended.reason == END else told
    return Row(name, rest, {k: float(v) for k, v in share.items()}, ending, tuple(faulty.judged(name, ended)))


# --- processes


class Worker:
    """A folder with a rig of its own, and two servers of it, the second one for when the first is killed."""

    def __init__(self, number: int) -> None:
        from campaigns.fault_bench import Host, Served, make_files

        self.folder = Path(tempfile.mkdtemp(prefix="rths-faults-"))
        self.rig = f"faults_{number}"
        make_files(self.folder, self.rig)
        self.secret = bytes.fromhex((self.folder / "key").read_text().strip())
        self.served, self.spare = Served(self.folder), Served(self.folder)
        self.host = Host()

    def close(self) -> None:
        self.host.end()
        self.served.end()
        self.spare.end()
        shutil.rmtree(self.folder, ignore_errors=True)

    def played(self, name: str, seed: int) -> Row:
        """Run once with a fault of a kind."""
        from campaigns.fault_bench import Bench, Network, Served, start_runner
        from fault_kinds import KINDS

        kind = KINDS[name]
        if self.served.process.poll() is not None:
            self.served = Served(self.folder)
        time.sleep(0.1)  # the server still has to tell of the run before
        self.served.lines.clear()
        random = np.random.default_rng((seed, *name.encode()))
        network, output = Network(self.served.port), self.folder / f"out{seed}"
        shutil.rmtree(output, ignore_errors=True)
        more = {key: self._library(value) if key == "LD_PRELOAD" else value for key, value in kind.more.items()}
        runner = start_runner(self.folder, output, self.rig, network.relay.port, kind.before, more)
        bench = Bench(self.folder, self.served, self.spare, network, random, runner)
        try:
            told = self._mistreated(bench, kind.when, kind.act)
            if told == TOO_SOON:
                return Row(name, None, dict.fromkeys(("stroke", "velocity", "range"), 0.0), TOO_SOON, (TOO_SOON,), True)
            return self._row(name, bench, output, told)
        finally:
            runner.kill()
            network.relay.close()

    def _mistreated(self, bench: object, when: str, act: object) -> str:
        """Let a fault happen at its instant, wait for the end; return what the runner said on stderr."""
        from campaigns.fault_bench import PATIENCE_S, RECORD_S, SESSIONS

        network, runner = bench.network, bench.runner  # type: ignore[attr-defined]
        ready = {"run": network.began.is_set, "listening": lambda: len(network.forth) > 40, "rehearsal": lambda: False}
        end = time.monotonic() + (PATIENCE_S if when != "rehearsal" else 12.0)
        while when in ready and not ready[when]() and runner.poll() is None and time.monotonic() < end:
            time.sleep(0.005)
        self.host.begin()
        if when == "run":
            time.sleep(float(bench.random.uniform(0.1, RAMP_S + RECORD_S - ENDING_S)))  # type: ignore[attr-defined]
        bench.at_s = time.monotonic()  # type: ignore[attr-defined]
        if when == "run" and (runner.poll() is not None or self._sessions() >= SESSIONS):
            runner.communicate()
            return TOO_SOON
        act(bench)  # type: ignore[operator]
        try:
            return str(runner.communicate(timeout=PATIENCE_S)[1])
        except subprocess.TimeoutExpired:
            return "the runner did not end"

    def _sessions(self) -> int:
        """Return how many sessions have ended in this run: the first is that of the listening."""
        return sum(line.startswith("session") for _, line in self.served.lines)

    def _row(self, name: str, bench: object, output: Path, said: str) -> Row:
        from campaigns.fault_bench import used
        from fault_kinds import KINDS

        kind, code = KINDS[name], bench.runner.returncode  # type: ignore[attr-defined]
        stopped = kind.serves_on and code != 0
        rest_s = self._rest_s(bench, stopped)
        status, reason = _left(output, code)
        shares = used(bench.network.commands(self.secret))  # type: ignore[attr-defined]
        faults = [f"{limit} {share:.3f} of its limit" for limit, share in shares.items() if not share <= 1.0 + 1e-9]
        stolen_s = self.host.longest_s
        at_once = 0 not in kind.codes  # else it may have gone on for long before a limit stopped it
        if stopped and (rest_s is None or (at_once and rest_s > REST_S + TOLD_S)):
            faults.append("the table did not come to rest" if rest_s is None else f"at rest after {rest_s:.2f} s")
        if "Traceback" in said or code == OUR_BUG:
            faults.append(f"a bug of ours: {said[-600:]}")
        excusable = not faults  # by the host: another ending, as long as it is a safe one and told
        if code not in kind.codes:
            faults.append(f"exit code {code}: {said.strip()[-300:]}")
        if status not in kind.status.split("|") or kind.reason not in reason:
            faults.append(f"the file says {status!r}: {reason!r}; stderr {said.strip()[-200:]!r}")
        beside = excusable and bool(faults) and stolen_s >= STOLEN_S
        faults += [f"the host took {1e3 * stolen_s:.0f} ms of a processor"] if beside else []
        return Row(name, rest_s if stopped else None, shares, f"{code} {status}: {reason}", tuple(faults), beside)

    def _rest_s(self, bench: object, expected: bool) -> float | None:
        """Return how long after the fault the server told that its table is at rest."""
        end = time.monotonic() + (3.0 if expected else 0.2)
        while time.monotonic() < end:
            lines = [at for at, line in self.served.lines if line.startswith("session") and at > bench.at_s]  # type: ignore[attr-defined]
            if lines:
                return lines[-1] - bench.at_s  # type: ignore[attr-defined, no-any-return]
            time.sleep(0.01)
        return None

    def _library(self, name: str) -> str:
        """Return a shared library made of a C file of ours."""
        made = self.folder / f"{name}.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-o", made, HERE / "faults" / f"{name}.c", "-ldl"], check=True)
        return str(made)


def _left(output: Path, code: int) -> tuple[str, str]:
    """Return status and reason of the result that a run left, after `rths recover` where it was killed."""
    from rths_cli.errors import InputError
    from rths_cli.files.result_reader import read_result
    from rths_cli.laboratory.recover import recover

    results = [path for path in output.glob("*.h5") if not path.name.startswith(".")]
    parts = list(output.glob(".*.part"))
    if not list(output.glob("*")) and not list(output.glob(".*")):
        return "no file", ""
    try:
        if code == -9:
            logs = list(output.glob("*.rthslog"))
            for one in recover(logs):
                if one.samples == 0:
                    return "nothing recovered", one.reason
        found = read_result((results or parts)[0]).attributes
        return str(found["status"]), str(found["status_reason"])
    except (InputError, IndexError) as error:
        return "unreadable", f"{error}, {[path.name for path in output.glob('*')]}"


# --- all of them


def show(rows: Iterable[Row]) -> bool:
    """Print a line per kind; return whether every run was as it must be."""
    kinds: dict[str, list[Row]] = {}
    for row in rows:
        kinds.setdefault(row.kind, []).append(row)
    print(f"{'kind':34} {'runs':>4} {'to rest':>8} {'stroke':>7} {'veloc.':>7} {'range':>7}  verdict, endings")
    for name, ran in kinds.items():
        rest = max((row.rest_s for row in ran if row.rest_s is not None), default=None)
        shares = [max(row.used[limit] for row in ran) for limit in ("stroke", "velocity", "range")]
        endings = sorted({_short(row.ending) for row in ran})
        bad = [row for row in ran if row.faults]
        numbers = " ".join(f"{share:7.3f}" for share in shares)
        seconds = f"{rest:6.2f} s" if rest is not None else "       -"
        verdict = "ok" if not bad else f"{len(bad)} BAD"
        print(f"{name:34} {len(ran):4d} {seconds} {numbers}  {verdict}, {'; '.join(endings)}")
        for fault in dict.fromkeys(fault for row in bad for fault in row.faults):
            print(f"    {fault}")
    wrong = sum(bool(row.faults) for ran in kinds.values() for row in ran)
    print(f"{len(kinds)} kinds, {sum(map(len, kinds.values()))} runs, {wrong} not as they must be")
    return not wrong


def _short(ending: str) -> str:
    """Return an ending without its numbers, so that like ones count once."""
    return re.sub(r"\d+\.\d+ s|\d{4,}T?\w*|:\d+", "..", ending)[:110]


def played(kinds: list[str], runs: int, seed: int, workers: int) -> list[Row]:
    """Run every kind of fault of processes so often, some at a time."""
    free: SimpleQueue[Worker] = SimpleQueue()
    hands = [Worker(number) for number in range(workers)]
    for worker in hands:
        free.put(worker)
    lock, rows = threading.Lock(), []

    def once(job: tuple[str, int]) -> None:
        worker = free.get()
        try:
            for attempt in range(TRIES):
                row = worker.played(job[0], job[1] + 1000 * attempt)
                if not row.beside or attempt == TRIES - 1:
                    break
                print(f"again: {row.kind}: {'; '.join(row.faults)}", file=sys.stderr)
        finally:
            free.put(worker)
        with lock:
            rows.append(row)
            print(f"[{len(rows)}/{len(kinds) * runs}] {row.kind}: {row.ending} {' '.join(row.faults)}", file=sys.stderr)

    try:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(once, [(kind, seed + i) for kind in kinds for i in range(runs)]))
    finally:
        for worker in hands:
            worker.close()
    return sorted(rows, key=lambda row: kinds.index(row.kind))


def main() -> int:
    """Inject what is asked for; return 1 when one run was not as it must be."""
    asked = arguments(__doc__)
    asked.add_argument("runs", nargs="?", type=int, default=20)
    asked.add_argument("--seed", type=int, default=0)
    asked.add_argument("--kind", default="", help="only kinds whose name holds this")
    asked.add_argument("--only", choices=("runs", "processes"))
    asked.add_argument("--workers", type=int, default=1, help="runs of processes at a time")
    words = parsed(asked, SHORT)
    good, started = True, time.monotonic()
    if words.only != "processes":
        import faulty

        kinds = [name for name in faulty.KINDS if words.kind in name]
        good &= show(in_process(name, words.seed + i) for name in kinds for i in range(words.runs))
    if words.only != "runs":
        import fault_kinds

        os.environ.pop("RTHS_KEY_FILE", None)
        kinds = [name for name in fault_kinds.KINDS if words.kind in name]
        good &= show(played(kinds, max(1, words.runs // 10), words.seed, words.workers))
    print(f"{time.monotonic() - started:.0f} s")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
