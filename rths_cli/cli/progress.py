"""How far a command is and how long it still takes, from the durations of its parts in earlier runs here.

A part is a stage that the command reports, or the compilation of a function. progress_parts.json states what each took
on the machine where they were measured (`python benchmarks/progress_parts.py`), in the order in which they come; the
parts that have ended tell how much slower this machine is, and what was measured here replaces what is shipped.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from rths_cli.user_cache import cache_or_temporary

SHIPPED = Path(__file__).with_name("progress_parts.json")
COMPILING = "compile "
LEAST_S = 0.3  # parts that take less say nothing of the speed of a machine
PRIOR_S = 3.0  # of parts as fast as usual, which the first ones to end are averaged with
KEPT = 0.5  # weight of the durations that were known before, beside those of the present run
LEAST_LEFT = 0.1  # of its usual duration is what a part takes at least that is longer than usual
Durations = dict[str, float]


def part_of(told: str) -> str:
    """Return the part that a sentence of progress is of: its words before any number, comma or colon."""
    return re.split(r"[\d,:]", told, maxsplit=1)[0].strip()


class Estimate:
    """The parts of one command in seconds: those of earlier runs, in their order, and those of this one."""

    def __init__(self, usual: Mapping[str, float]) -> None:
        self._usual = dict(usual)
        self._compiles = False
        self._spent: Durations = {}
        self._inner: list[str] = []  # the present part, and the compilation within it
        self._since = 0.0
        self._furthest = 0  # place of the present stage among the usual ones

    def begin(self, part: str, now: float) -> None:
        """Take note that a stage begins, which ends the one before."""
        self._note(now)
        self._inner = [part]
        if part in self._usual:
            self._furthest = max(self._furthest, [*self._usual].index(part))

    def compiling(self, function: str, begins: bool, all_of_them: bool, now: float) -> None:
        """Take note that the compilation of a function begins or ends; the stage around it stands still meanwhile.

        `all_of_them`: whether this machine has compiled nothing yet, so that the other functions will be, too.
        """
        self._note(now)
        self._compiles |= all_of_them
        self._inner = self._inner[:1] + ([COMPILING + function] if begins else [])

    def _note(self, now: float) -> None:
        if self._inner:
            part = self._inner[-1]
            self._spent[part] = self._spent.get(part, 0.0) + now - self._since
        self._since = now

    def left_s(self, now: float) -> float | None:
        """Return the seconds that the command still takes, None before anything is known."""
        if not self._inner or not self._usual:
            return None
        self._note(now)
        names = [name for name in [*self._usual][self._furthest :] if self._compiles or not name.startswith(COMPILING)]
        ahead = [name for name in names if name not in self._spent]
        present = sum(self._rest(part) for part in self._inner if part in self._usual)
        return self._slower() * (present + sum(self._usual[name] for name in ahead))

    def _rest(self, part: str) -> float:
        usual = self._usual[part]
        return max(usual - self._spent.get(part, 0.0) / self._slower(), LEAST_LEFT * usual)

    def _slower(self) -> float:
        """Return by how much longer than usual the parts take that have ended."""
        ended = [name for name in self._spent if name not in self._inner and self._usual.get(name, 0.0) >= LEAST_S]
        spent, usual = sum(self._spent[name] for name in ended), sum(self._usual[name] for name in ended)
        return (PRIOR_S + spent) / (PRIOR_S + usual)

    def spent_s(self) -> float:
        """Return the seconds that all parts have taken."""
        return sum(self._spent.values())

    def ended(self, now: float) -> Durations:
        """Return the durations of all parts of this run, for `learn`."""
        self._note(now)
        self._inner = []
        return self._spent


def usual(command: str) -> Durations:
    """Return the durations of the parts of a command in s, in their order; {} where nothing is known of it."""
    shipped = _read(SHIPPED).get(command, {})
    return _in_order(shipped, _read(_learned()).get(command, {}))


def learn(command: str, spent: Mapping[str, float]) -> None:
    """Keep the durations of a run for the next one; without a place for it nothing is kept."""
    path = _learned()
    known = _read(path)
    before = usual(command)
    new = {name: KEPT * before.get(name, seconds) + (1.0 - KEPT) * seconds for name, seconds in spent.items()}
    known[command] = {name: round(seconds, 3) for name, seconds in _in_order(before, new).items()}
    draft = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        draft.write_text(json.dumps(known, indent=1))
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)


def _learned() -> Path:
    return cache_or_temporary() / "progress.json"


def _read(path: Path) -> dict[str, Durations]:
    """Return the durations in a file; {} where there is none, or it is damaged."""
    try:
        found = json.loads(path.read_text())
        return {str(command): {str(k): float(v) for k, v in parts.items()} for command, parts in found.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def _in_order(known: Mapping[str, float], new: Mapping[str, float]) -> Durations:
    """Return durations in the order of those known; a part that is not among them follows the one before it."""
    order, after = [*known], 0
    for name in new:
        if name in known:
            after = order.index(name) + 1
        else:
            order.insert(after, name)
            after += 1
    return {name: new.get(name, known.get(name, 0.0)) for name in order}
