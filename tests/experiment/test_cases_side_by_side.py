"""Jobs side by side: results in order, one voice at a time, and an end that leaves nothing running."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from threading import Event, get_ident

import h5py
import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.experiment import run_command
from rths_cli.experiment.run_case import Ended
from rths_cli.experiment.run_command import Stopped, Tell, in_order

WAIT_S = 20.0


class Watcher:
    """Note the lines a user would see."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def started(self, number: int, count: int, name: str) -> None:
        self.lines.append(f"{number}/{count} {name}")

    def doing(self, what: str) -> None:
        """Nothing to note."""

    def message(self, text: str) -> None:
        self.lines.append(text)

    def ended(self, ended: Ended, seconds: float) -> None:
        self.lines.append(f"{ended.name} {ended.status}")

    def moving(self, label: str, view: object) -> bool:
        raise AssertionError(f"{label}: no real table moves here, {view}")

    def confirm(self, lines: Sequence[str]) -> bool:
        raise AssertionError(f"nobody is asked here, {lines}")


def test_results_come_in_order_though_a_later_job_is_done_first() -> None:
    second_done = Event()

    def work(job: int, tell: Tell) -> int:
        assert job == 1 or second_done.wait(WAIT_S)  # the first needs the second to run beside it
        if job == 1:
            second_done.set()
        return 10 * job

    assert list(in_order(work, [0, 1, 2, 3], print, 2)) == [0, 10, 20, 30]


def test_only_the_job_that_is_waited_for_is_heard() -> None:
    heard: list[str] = []
    second_told = Event()

    def work(job: int, tell: Tell) -> None:
        assert job == 1 or second_told.wait(WAIT_S)
        tell(f"{job} works")
        second_told.set()

    assert list(in_order(work, [0, 1], heard.append, 2)) == [None, None]
    assert heard == ["0 works"]


def test_one_at_a_time_works_here_and_no_sooner_than_asked() -> None:
    begun: list[int] = []

    def work(job: int, tell: Tell) -> int:
        begun.append(job)
        return get_ident()

    results = in_order(work, [0, 1], print, 1)
    assert next(results) == get_ident() and begun == [0]


def test_what_a_job_raises_ends_the_others() -> None:
    ends: list[int] = []
    begun = Event()

    def work(job: int, tell: Tell) -> None:
        if job == 0:
            assert begun.wait(WAIT_S)
            raise ValueError("no luck")
        try:
            if job == 1:
                begun.set()
            while True:
                tell("still here")
        except Stopped:
            ends.append(job)
            raise

    with pytest.raises(ValueError, match="no luck"):
        list(in_order(work, [0, 1, 2, 3], lambda _: None, 2))
    assert sorted(ends) in ([1], [1, 2])  # the free thread may have begun job 2 meanwhile; 3 never begins


def test_whoever_goes_away_leaves_nothing_running() -> None:
    begun: list[int] = []

    def work(job: int, tell: Tell) -> int:
        begun.append(job)
        while job > 0:
            tell("working")
        return job

    results = in_order(work, list(range(50)), lambda _: None, 2)
    assert next(results) == 0
    results.close()  # returns when no thread works any more
    assert set(begun) <= {0, 1, 2}


def contents(folder: Path) -> dict[str, bytes]:
    """Return every dataset below a folder by file and path."""
    found: dict[str, bytes] = {}
    for path in sorted(folder.glob("*.h5")):
        with h5py.File(path) as file:
            names: list[str] = []
            file.visit(names.append)
            nodes = {name: file[name] for name in names if not name.startswith("case")}
            arrays = {name: node[()] for name, node in nodes.items() if isinstance(node, h5py.Dataset)}
            found |= {f"{path.name} {name}": np.asarray(value).tobytes() for name, value in arrays.items()}
    return found


@pytest.mark.campaign
def test_cases_side_by_side_have_the_bytes_and_lines_of_one_after_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = ("el_centro_low_ff", "hachinohe_low_ff", "el_centro_high_ff", "el_centro_low_ff_fb")
    lines = []
    for count in (1, 2):
        monkeypatch.setattr(run_command, "cases_at_once", lambda jobs, count=count: count)
        watcher = Watcher()
        request = run_command.Request(
            tuple(load_cases(cases, ("runs=[sim, sim_delay]",))), (), tmp_path / str(count), True, "test"
        )
        assert run_command.exit_code(run_command.run_batch(request, watcher)) == 0
        lines.append(watcher.lines)
    assert lines[0] == lines[1] and lines[0][:2] == ["1/4 el_centro_low_ff", "el_centro_low_ff complete"]
    assert contents(tmp_path / "1") == contents(tmp_path / "2") != {}
    assert not list(tmp_path.glob("*/.*"))
