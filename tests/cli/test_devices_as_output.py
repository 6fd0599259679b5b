"""A device, a pipe or /dev/stdout as output is written to or refused, and stays what it is."""

from __future__ import annotations

import os
import socket
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from portfolio import parametrize_first

from rths_cli.files.durable_files import is_stream, written_whole
from tests.helpers.page_results import write as write_result

CASE = "el_centro_low_ff_fb"
ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in a folder with a result."""
    write_result(tmp_path / "demo.h5")
    monkeypatch.chdir(tmp_path)


def rths(*words: str, shell: str = "") -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "rths_cli", *words]
    if shell:
        return subprocess.run(
            ["bash", "-c", f'"$@" {shell}', "bash", *command], capture_output=True, text=True, env=environment
        )
    return subprocess.run(command, capture_output=True, text=True, env=environment)


@pytest.fixture
def device() -> Iterator[Path]:
    """Return a device that takes everything, as /dev/null; made here, so that no fault costs that of the system."""
    path = Path("null")
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
        path.write_bytes(b"")
    except PermissionError:
        pytest.skip("this user makes no devices")
    yield path
    assert stat.S_ISCHR(path.stat().st_mode)


def read_from(pipe: Path) -> tuple[threading.Thread, list[bytes]]:
    found: list[bytes] = []
    reader = threading.Thread(target=lambda: found.append(pipe.read_bytes()), daemon=True)
    reader.start()
    return reader, found


TEXTS = {
    "report --output": ("report", "demo.h5", "--output"),
    "report --format html": ("report", "demo.h5", "--format", "html", "--output"),
    "report --junit": ("report", "demo.h5", "--junit"),
}


@pytest.mark.campaign
@pytest.mark.parametrize("command", TEXTS)
def test_a_text_goes_into_a_device(device: Path, command: str) -> None:
    done = rths(*TEXTS[command], str(device))
    assert done.returncode == 0, done.stderr
    assert stat.S_ISCHR(device.stat().st_mode) and "replaced" not in done.stderr


@pytest.mark.campaign
@parametrize_first(1, "command", TEXTS)
def test_a_text_goes_into_a_pipe_as_into_a_file(command: str) -> None:
    os.mkfifo("pipe")
    holder = os.open("pipe", os.O_RDONLY | os.O_NONBLOCK)  # a reader is there before the command begins
    reader, found = read_from(Path("pipe"))
    done = rths(*TEXTS[command], "pipe")
    reader.join(60)
    os.close(holder)
    assert done.returncode == 0, done.stderr
    assert stat.S_ISFIFO(os.stat("pipe").st_mode)
    assert rths(*TEXTS[command], "file.txt").returncode == 0
    whole = Path("file.txt").read_bytes()
    assert found[0].replace(b"pipe", b"file.txt") == whole and len(whole) > 100


@pytest.mark.campaign
def test_a_pipe_that_nobody_reads_is_refused_and_not_waited_for() -> None:
    os.mkfifo("pipe")
    done = rths("report", "demo.h5", "--output", "pipe")
    assert done.returncode == 2 and "nobody reads this pipe" in done.stderr


@pytest.mark.campaign
def test_standard_output_by_its_name_is_written_to() -> None:
    done = rths("report", "demo.h5", "--output", "/dev/stdout", "--format", "csv", shell="> out.csv")
    assert done.returncode == 0, done.stderr
    assert rths("report", "demo.h5", "--output", "whole.csv", "--format", "csv").returncode == 0
    assert Path("whole.csv").read_text() in Path("out.csv").read_text()
    assert os.path.islink("/dev/stdout")


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (("identify", CASE, "--no-figure", "--output"), "model file"),
        (("sweep", CASE, "--output"), "result of a sweep"),
        (("identify", CASE, "--no-figure", "--output", "m.h5", "--save-data"), "recording"),
    ],
)
def test_hdf5_into_a_pipe_is_refused_before_anything_is_done(words: tuple[str, ...], kind: str) -> None:
    os.mkfifo("out.h5")
    done = rths(*words, "out.h5")
    assert done.returncode == 2
    assert f"out.h5: is no file, but a device or pipe; a {kind} needs a file, give the name of one" in done.stderr
    assert stat.S_ISFIFO(os.stat("out.h5").st_mode)


@pytest.mark.campaign
def test_the_result_of_a_run_and_an_export_are_no_pipe() -> None:
    Path("results").mkdir()
    os.mkfifo(f"results/{CASE}.h5")
    done = rths("run", CASE, "--set", "runs=[sim]")
    assert done.returncode == 2 and "a result of rths run needs a file" in done.stderr
    Path("exported").mkdir()
    os.mkfifo("exported/demo.mat")
    done = rths("export", "demo.h5", "--to", "mat")
    assert done.returncode == 2 and "exported/demo.mat: is no file, but a device or pipe" in done.stderr
    assert stat.S_ISFIFO(os.stat("exported/demo.mat").st_mode)


@pytest.mark.campaign
def test_sockets_and_pipes_for_a_log_are_refused() -> None:
    with socket.socket(socket.AF_UNIX) as there:
        there.bind("socket")
        done = rths("report", "demo.h5", "--output", "socket")
        assert done.returncode == 2 and "socket: is a socket" in done.stderr
    os.mkfifo("pipe")
    done = rths("records", "--log", "pipe")
    assert done.returncode == 2 and "--log pipe: is no file" in done.stderr


def test_a_folder_a_file_and_a_link_to_one_are_no_streams() -> None:
    Path("file").write_text("a")
    os.symlink("file", "link")
    assert not any(is_stream(Path(name)) for name in (".", "file", "link", "absent"))
    with written_whole(Path("file")) as part:
        part.write_text("b")
    assert Path("link").read_text() == "b"
