"""Several processes that want one name: no result is lost, and each says where its own is."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from portfolio import parametrize_first

from rths_cli.files import durable_files
from rths_cli.files.durable_files import claimed, publish, stamp
from rths_cli.files.result_reader import ResultWriter, read_result
from tests.helpers.made_result import ATTRIBUTES, TIME

CASE = "el_centro_low_ff_fb"
RTHS = (sys.executable, "-m", "rths_cli")
ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def short_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with a short record."""
    lines = (ROOT / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in lines if not line.startswith("#")][:300]
    (tmp_path / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    monkeypatch.chdir(tmp_path)


def begun(*words: str) -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen((*RTHS, *words), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def run_of(scaling: float, *more: str) -> tuple[str, ...]:
    settings = ("record.file=short.csv", "runs=[sim]", f"scaling={scaling}")
    return ("run", CASE, *(word for one in settings for word in ("--set", one)), "--json", *more)


def ended(processes: Sequence[subprocess.Popen[str]]) -> list[tuple[int, str, str]]:
    said = [process.communicate() for process in processes]
    return [(process.returncode, *one) for process, one in zip(processes, said, strict=True)]


def scaling_in(path: Path) -> float:
    text = read_result(path).resolved_yaml
    return float(next(line for line in text.splitlines() if line.startswith("scaling:")).split()[1])


@pytest.mark.campaign
@parametrize_first(1, "more", [(), ("--no-replace",)])
@parametrize_first(1, "count", [2, 5])
def test_no_result_of_several_processes_is_lost(count: int, more: tuple[str, ...]) -> None:
    """Whenever each begins: a result is there, or its process was refused, or another says that it replaced it."""
    scalings = [round(0.1 + 0.05 * number, 3) for number in range(count)]
    there, replaced, refused = {}, 0, 0
    for scaling, (code, out, err) in zip(scalings, ended([begun(*run_of(s, *more)) for s in scalings]), strict=True):
        assert code == 0 or (code == 2 and more), err
        if code == 2:
            refused += 1
            assert "is being written by another process" in err or "exists; remove it" in err
            continue
        (case,) = json.loads(out)["cases"]
        replaced += case["replaced"]
        there[scaling] = Path(case["path"])
    files = sorted(Path("results").iterdir())
    assert all(file.suffix == ".h5" and not file.name.startswith(".") for file in files)
    assert len(files) + replaced + refused == count
    assert not (more and replaced)
    held = {scaling_in(file) for file in files}
    assert len(held) == len(files)
    own = [scaling for scaling, path in there.items() if scaling_in(path) == scaling]
    assert len(own) == len(files)


@pytest.mark.campaign
def test_a_run_whose_name_another_process_writes_takes_the_next_one_and_says_so() -> None:
    path = Path(f"results/{CASE}.h5")
    with claimed(path) as ours, claimed(Path(f"results/{CASE}-2.h5")):
        assert ours
        code, out, err = ended([begun(*run_of(0.3))])[0]
        assert code == 0, err
        assert json.loads(out)["cases"][0]["path"] == f"results/{CASE}-3.h5"
        assert f"{path}: is being written by another process; this result goes to results/{CASE}-3.h5" in err
        code, out, err = ended([begun(*run_of(0.3, "--no-replace"))])[0]
        assert code == 2 and len(os.listdir("results")) == 3  # two claims and the result
        assert f"{path}: is being written by another process; choose another --output, or wait for its end" in err
    assert os.listdir("results") == [f"{CASE}-3.h5"]


@pytest.mark.campaign
def test_a_sweep_whose_file_another_process_writes_is_refused_before_it_plays() -> None:
    with claimed(Path("s.h5")):
        words = ("sweep", CASE, "--set", "record.file=short.csv", "--set", "identification.duration_s=40")
        code, _, err = ended([begun(*words, "--output", "s.h5")])[0]
    assert code == 2 and "s.h5: is being written by another process; choose another --output, or wait for it" in err
    assert sorted(os.listdir(".")) == ["short.csv"]


def test_the_claim_of_a_killed_process_is_free() -> None:
    script = (
        "import sys; from pathlib import Path; from rths_cli.files.durable_files import claimed\n"
        "with claimed(Path('r/a.h5')) as ours:\n    print(ours, flush=True)\n    sys.stdin.read()"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as it:
        assert it.stdout is not None and it.stdout.readline() == b"True\n"
        with claimed(Path("r/a.h5")) as ours:
            assert not ours
        it.kill()
        it.wait()
    with claimed(Path("r/a.h5")) as ours:
        assert ours
    assert os.listdir("r") == []


@pytest.mark.parametrize("lasting", [False, True])
@pytest.mark.parametrize("there", [False, True])
def test_two_writers_of_one_name_keep_both_results_without_any_lock(lasting: bool, there: bool) -> None:
    """As on a storage without locks, or of two machines."""
    if there and lasting:
        pytest.skip("a result of a real rig replaces nothing")
    path = Path("a.h5")
    if there:
        written(ResultWriter(path, ATTRIBUTES), "old")
    first, second = (ResultWriter(path, ATTRIBUTES, lasting=lasting) for _ in range(2))
    second.part = second.part.with_name(".a.h5.other-1.part")  # it is in another process
    with first:
        with second:
            fill(second, "second")
        fill(first, "first")
    assert (second.path, first.path) == (path, Path("a-2.h5"))
    assert [read_result(one).attributes["case_name"] for one in (path, first.path)] == ["second", "first"]
    assert sorted(name for name in os.listdir(".") if "a" in name and name.endswith("h5")) == ["a-2.h5", "a.h5"]


def fill(writer: ResultWriter, name: str) -> None:
    writer.about({"case_name": name})
    writer.group("record", {"ground_accel_m_s2": TIME}, TIME)
    writer.finish("complete")


def written(writer: ResultWriter, name: str) -> None:
    with writer:
        fill(writer, name)


@pytest.mark.parametrize("links", [True, False])
def test_a_file_takes_the_place_of_what_was_seen_alone(monkeypatch: pytest.MonkeyPatch, links: bool) -> None:
    def no_links(*_: object, **__: object) -> None:
        raise OSError(errno.EPERM, "no hard links here")

    if not links:
        monkeypatch.setattr(durable_files.os, "link", no_links)
    path, part = Path("a.txt"), Path("part")
    names = []
    for text, seen in (("1", None), ("2", None), ("3", None)):
        part.write_text(text)
        names.append(publish(part, path, seen))
    assert names == [path, Path("a-2.txt"), Path("a-3.txt")] and path.read_text() == "1"
    seen = stamp(path)
    part.write_text("4")
    assert publish(part, path, seen) == path and path.read_text() == "4"
    part.write_text("5")
    assert publish(part, path, seen) == Path("a-4.txt") and path.read_text() == "4"
    assert not part.exists()
