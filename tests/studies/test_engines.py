"""The same bytes from every engine, from parts joined in any order, and after workers were killed."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from campaigns.study_interruptions import CASE, datasets, write_case

from rths_cli.case.load import PlacedSettings, written_case
from rths_cli.errors import InputError
from rths_cli.files.sweep_file import read_columns, read_part, read_sweep, rows_path
from rths_cli.studies import engines, merge
from rths_cli.studies import sweep as sweep_workflow
from rths_cli.studies.engines import (
    Chunk,
    Engine,
    OtherSoftwareError,
    PointRows,
    Work,
    Workers,
    WorkersLostError,
    check_software,
    play_all,
)
from rths_cli.studies.merge import merge_parts
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep import SweepRequest, Swept, run_sweep
from rths_cli.studies.sweep_output import several_processors
from rths_cli.studies.sweep_table import Row

VARIED = ("table.after_identification.coulomb_factor=1,3",)
SEEDS = 10
ROWS = 2 * SEEDS


class Watcher:
    """Take note of what is said; kill, or raise, when the first rows are there."""

    def __init__(self, killed: int = 0, raises_at: int = 0) -> None:
        self.said: list[str] = []
        self.steps: list[str] = []
        self.killed, self.raises_at = killed, raises_at

    def doing(self, what: str) -> None:
        if " runs, about " not in what:
            return
        self.steps.append(what.partition(",")[0])
        if self.killed:
            os.kill(self.killed, signal.SIGKILL)
            self.killed = 0
        if self.raises_at == len(self.steps):
            raise KeyboardInterrupt

    def message(self, text: str) -> None:
        self.said.append(text)

    warning = message

    def started(self, number: int, count: int, name: str) -> None: ...

    def ended(self, ended: object, seconds: float) -> None: ...


class ChildKiller(Watcher):
    """Kill every worker process of this one when the first row is there."""

    def doing(self, what: str) -> None:
        super().doing(what)
        if len(self.steps) == 1:
            for child in multiprocessing.active_children():
                os.kill(int(child.pid or 0), signal.SIGKILL)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a case on a record of 4.5 s."""
    place = tmp_path_factory.mktemp("engines")
    write_case(place, "a.yaml")
    return place


@pytest.fixture(scope="module")
def request_of(folder: Path) -> SweepRequest:
    asked = Asked(str(folder / "a.yaml"), (), VARIED, str(SEEDS))
    return SweepRequest(asked, folder / "inline.h5", None, Engine("inline"), True, False, "test")


@pytest.fixture(scope="module")
def inline(request_of: SweepRequest) -> Swept:
    return run_sweep(request_of, Watcher())  # type: ignore[arg-type]


def swept(request: SweepRequest, path: Path, engine: Engine, watcher: Watcher | None = None) -> Swept:
    return run_sweep(replace(request, output=path, engine=engine), watcher or Watcher())  # type: ignore[arg-type]


@pytest.mark.campaign
@pytest.mark.parametrize("jobs", [1, 3])
def test_processes_give_the_bytes_of_one_process(
    inline: Swept, request_of: SweepRequest, tmp_path: Path, jobs: int
) -> None:
    done = swept(request_of, tmp_path / "s.h5", Engine("processes", jobs))
    assert datasets(done.path) == datasets(inline.path)
    assert len({*done.sweep.texts["processor"]}) == 1 and done.sweep.texts["processor"][0]


@pytest.mark.campaign
@pytest.mark.skipif(sys.platform != "linux", reason="SIGKILL")
def test_rows_of_killed_processes_are_played_again_once(
    inline: Swept, request_of: SweepRequest, tmp_path: Path
) -> None:
    watcher = ChildKiller()
    done = swept(request_of, tmp_path / "s.h5", Engine("processes", 2), watcher)
    assert any("a worker was lost" in text for text in watcher.said)
    assert watcher.steps == [f"{k} of {ROWS} runs" for k in range(1, ROWS + 1)]
    assert datasets(done.path) == datasets(inline.path)
    assert multiprocessing.active_children() == []


@pytest.mark.campaign
def test_parts_in_any_order_give_the_bytes_of_the_whole(
    inline: Swept, request_of: SweepRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    parts = []
    for number in (1, 2, 3):
        asked = replace(request_of, output=None, part=(number, 3))
        parts.append(run_sweep(asked, Watcher()).path)  # type: ignore[arg-type]
    assert [path.name for path in parts] == [f"a-part{k}of3.h5" for k in (1, 2, 3)]
    rows = [np.asarray(read_part(path).numbers) for path in parts]
    assert sorted(np.concatenate(rows)) == list(range(1, ROWS + 1)) and {len(one) for one in rows} == {6, 7}
    for order in itertools.permutations(parts):
        sweep, *_ = merge_parts(order, tmp_path / "m.h5", True, "test")
        assert datasets(tmp_path / "m.h5") == datasets(inline.path)
        for name in ("status_reason", "exit_code", "plan_sha256", "seeds", "grid_points"):
            assert sweep.attributes[name] == inline.sweep.attributes[name], name
    assert "part" not in read_sweep(tmp_path / "m.h5").attributes
    with monkeypatch.context() as patch:

        def while_written(path: Path, keep: Callable[[str, np.ndarray], None]) -> None:
            """The part is written anew, with as many other rows, after its head was read."""
            shutil.copyfile(parts[1], tmp_path / "new.h5")
            os.replace(tmp_path / "new.h5", path)
            read_columns(path, keep)

        patch.setattr(merge, "read_columns", while_written)
        shutil.copyfile(parts[0], tmp_path / "live.h5")
        with pytest.raises(InputError, match=r"live\.h5: was written anew or removed while it was read"):
            merge_parts([tmp_path / "live.h5", *parts[1:]], tmp_path / "none.h5", True, "test")
    assert not (tmp_path / "none.h5").exists()

    def refused(*paths: Path) -> str:
        with pytest.raises(InputError) as caught:
            merge_parts(paths, tmp_path / "none.h5", True, "test")
        assert not (tmp_path / "none.h5").exists()
        return "\n".join(caught.value.faults)

    assert f"{len(rows[1])} of {ROWS} rows are in no part" in (told := refused(parts[0], parts[2]))
    assert told.endswith("play part 2 of 3")
    again = tmp_path / "again.h5"
    again.write_bytes(parts[0].read_bytes())
    assert f"{again}: has rows" in (told := refused(*parts, again)) and f"which {parts[0]} has too" in told
    other = tmp_path / "other.h5"
    other.write_bytes(parts[2].read_bytes())
    with h5py.File(other, "r+") as file:
        file["processor"][0] = "another"
    merged, *_ = merge_parts([*parts[:2], other], tmp_path / "m.h5", True, "test")
    assert "on processors of 2 kinds" in several_processors(merged) and not several_processors(inline.sweep)
    assert "is a whole sweep and no part of one" in refused(parts[0], inline.path)
    for name, words in (("plan_sha256", "a sweep of another case"), ("software_sha256", "another version of rths")):
        with h5py.File(again, "r+") as file:
            before, file.attrs[name] = file.attrs[name], "0" * 64
        assert words in refused(*parts[1:], again), name
        with h5py.File(again, "r+") as file:
            file.attrs[name] = before
    with h5py.File(again, "r+") as file:
        file.attrs["grid_points"] = 10**12
    assert "is a part of 1000000000000 grid points" in refused(*parts[1:], again)
    with pytest.raises(InputError, match="holds part 1/3 of a sweep; rths merge joins"):
        read_sweep(parts[0])
    with pytest.raises(InputError, match="holds another sweep"):
        run_sweep(replace(request_of, output=parts[0], part=(2, 3), resume=True), Watcher())  # type: ignore[arg-type]
    with pytest.raises(InputError, match=f"has {ROWS} runs; ask for at most as many parts"):
        run_sweep(replace(request_of, part=(1, ROWS + 1)), Watcher())  # type: ignore[arg-type]


class Lossy:
    """Workers that lose the chunk that is handed out as one of `at`."""

    lost: tuple[type[BaseException], ...] = (BrokenExecutor,)

    def __init__(self, at: set[int]) -> None:
        self.at, self.asked, self.closed = at, 0, ""

    def count(self) -> int:
        return 2

    def submit(self, work: Work, chunk: Chunk) -> Future[list[Row]]:
        self.asked += 1
        future: Future[list[Row]] = Future()
        if self.asked in self.at:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result([Row(k, "", "", 0, "", "", "", np.zeros(0)) for one in chunk for k, _ in one.rows])
        return future

    def why_idle(self) -> str:
        return ""

    def replace_lost(self, error: BaseException) -> None: ...

    def close(self, at_once: bool) -> None:
        self.closed = "at once" if at_once else "when done"


@pytest.fixture
def work() -> Work:
    return Work("", written_case(CASE, Path("a.yaml")), PlacedSettings(()), (), (), 0, "", "")


def chunks() -> Iterator[Chunk]:
    return ((PointRows(PlacedSettings(()), ((2 * k, 0), (2 * k + 1, 1))),) for k in range(20))


@pytest.mark.parametrize("at", [set(), {1}, {8}, {3, 4, 5}, {20}, {2, 9, 16, 23}])
def test_no_row_is_lost_or_repeated_wherever_workers_are_lost(work: Work, at: set[int]) -> None:
    workers: Workers = Lossy(at)
    assert [row.variant for row in play_all(workers, work, chunks(), lambda _: None)] == list(range(40))
    assert isinstance(workers, Lossy) and workers.closed == "when done"


def test_a_row_that_ends_every_worker_is_named(work: Work) -> None:
    workers = Lossy({*range(8, 100)})
    with pytest.raises(WorkersLostError, match=r"lost 3 times in a row .* rows 15 to 16"):
        list(play_all(workers, work, chunks(), lambda _: None))
    assert workers.closed == "at once"


class Idle(Lossy):
    """Workers that are not there for the first chunk until somebody asks why for the third time."""

    looks = 0

    def submit(self, work: Work, chunk: Chunk) -> Future[list[Row]]:
        found = super().submit(work, chunk)
        if self.asked == 1:
            self.first, found = found, Future()
            self.pending = found
        return found

    def why_idle(self) -> str:
        self.looks += 1
        if self.looks == 3:
            self.pending.set_result(self.first.result())
        return "no worker is there"


def test_a_sweep_without_workers_says_so_once_and_goes_on(work: Work, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "LOOK_S", 0.001)
    workers, said = Idle(set()), list[str]()
    assert [row.variant for row in play_all(workers, work, chunks(), said.append)] == list(range(40))
    assert said == ["no worker is there"] and workers.looks == 3


def test_a_chunk_that_times_out_by_itself_is_no_waiting(work: Work) -> None:
    workers = Lossy(set())
    broken: Future[list[Row]] = Future()
    broken.set_exception(TimeoutError("of the chunk"))
    workers.submit = lambda *_: broken  # type: ignore[method-assign]
    with pytest.raises(TimeoutError, match="of the chunk"):
        list(play_all(workers, work, chunks(), lambda _: None))


def test_another_version_of_a_worker_is_a_sentence() -> None:
    with pytest.raises(OtherSoftwareError, match=r"a worker runs rths .*, this process rths 9\.9; install the same"):
        check_software("0" * 64, "9.9")


@pytest.mark.parametrize(
    ("engine", "words"),
    [
        (Engine("dask"), "needs --scheduler"),
        (Engine("processes", 2, "tcp://127.0.0.1:1"), "is for --engine dask"),
    ],
)
def test_what_does_not_fit_an_engine_is_refused(request_of: SweepRequest, engine: Engine, words: str) -> None:
    with pytest.raises(InputError, match=words):
        run_sweep(replace(request_of, engine=engine), Watcher())  # type: ignore[arg-type]


def test_a_missing_dask_is_a_sentence(request_of: SweepRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"distributed is missing; install it: pip install 'rths-cli\[dask\]'"):
        run_sweep(replace(request_of, engine=Engine("dask", 1, "tcp://127.0.0.1:1")), Watcher())  # type: ignore[arg-type]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[int]]]:
    """Return the file of a Dask scheduler, and the process numbers of its two workers."""
    pytest.importorskip("distributed")
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "dask"]
    options = ["--scheduler-file", str(file), "--no-dashboard"]
    calls = [["scheduler", "--host", "127.0.0.1", "--port", "0"]]
    calls += [["worker", "--nthreads", "1", "--no-nanny", "--host", "127.0.0.1"]] * 2
    root = str(Path(__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
    processes = [
        subprocess.Popen([*dask, *call, *options], cwd=tmp_path, env=environment, stderr=subprocess.DEVNULL)
        for call in calls
    ]
    try:
        yield str(file), [process.pid for process in processes[1:]]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.campaign
def test_dask_gives_the_same_when_a_worker_is_killed_and_the_sweep_resumed(
    cluster: tuple[str, list[int]],
    inline: Swept,
    request_of: SweepRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import distributed

    file, (first, _) = cluster
    engine, path = Engine("dask", 1, file), tmp_path / "s.h5"
    with distributed.Client(scheduler_file=file, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
    with monkeypatch.context() as patch:
        for module in (sweep_workflow, engines):
            patch.setattr(module, "software", lambda: "0" * 64)
        with pytest.raises(InputError, match=r"Dask worker tcp://.*: a worker runs rths .* with other sources"):
            swept(request_of, path, engine)
    rows_path(path).unlink(missing_ok=True)
    with pytest.raises(KeyboardInterrupt):
        swept(request_of, path, engine, Watcher(raises_at=3))
    assert rows_path(path).read_text().count("\n") == 4
    watcher = Watcher(killed=first)
    done = swept(replace(request_of, resume=True), path, engine, watcher)
    assert done.played == ROWS - 3 and watcher.steps == [f"{k} of {ROWS} runs" for k in range(4, ROWS + 1)]
    assert datasets(path) == datasets(inline.path)
