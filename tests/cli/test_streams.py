"""What is printed: nothing commands a terminal, and a stream that takes nothing is a sentence and an exit code."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from portfolio import parametrize_first

from rths_cli.safe_text import OutputError, PrintedStream, shortened, visible

RTHS = (sys.executable, "-m", "rths_cli")


def rths(command: str, folder: Path) -> subprocess.CompletedProcess[bytes]:
    """Run a line of a shell in which `rths` is this one."""
    line = command.replace("rths", " ".join(RTHS), 1)
    environment = {**os.environ, "PYTHONPATH": os.getcwd()}
    return subprocess.run(["bash", "-c", line], cwd=folder, capture_output=True, env=environment, timeout=60)


@pytest.mark.campaign
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no /dev/full")
@parametrize_first(
    3,
    ("command", "said"),
    [
        ("rths records --json > /dev/full", b"No space left"),
        ("rths records > /dev/full", b"No space left"),
        ("rths report nope.h5 --json > /dev/full", b"No space left"),
        ("rths report nope.h5 2> /dev/full", b""),
        ("rths report nope.h5 --json > /dev/full 2> /dev/full", b""),
        ("rths records --json >&-", b"Bad file descriptor"),
        ("rths records --json | true; exit ${PIPESTATUS[0]}", b"Broken pipe"),
        ("rths new deep.yaml > /dev/full", b"No space left"),
    ],
)
def test_a_stream_that_takes_nothing_is_code_2(tmp_path: Path, command: str, said: bytes) -> None:
    done = rths(command, tmp_path)
    assert (done.returncode, b"Traceback" in done.stderr) == (2, False)
    assert said in done.stderr and done.stdout == b""


@pytest.mark.campaign
def test_who_has_read_enough_ends_nothing(tmp_path: Path) -> None:
    done = rths("rths records | true; exit ${PIPESTATUS[0]}", tmp_path)
    assert (done.returncode, done.stderr) == (0, b"")


def test_no_control_character_of_a_name_reaches_the_screen(tmp_path: Path) -> None:
    done = rths("rths report $'\\x1b]0;title\\x07\\x9b2J\\xff\\u202e.h5'", tmp_path)
    assert done.returncode == 2
    assert not set(done.stderr) & {*range(10), *range(11, 32), 127} and "\u202e" not in done.stderr.decode()
    assert done.stderr.startswith(rb"\x1b]0;title\x07")


def test_what_can_be_shown_is_shown_as_it_is() -> None:
    text = "σ = 3 µm/s², ü\tβ\nnaïve"
    assert visible(text) == text
    assert visible("a\x00\x1b[2J\r\x7f\x85\ud800b\u2028") == r"a\x00\x1b[2J\x0d\x7f\x85\ud800b\u2028"


def test_a_long_text_keeps_its_ends() -> None:
    assert shortened("x" * 200) == "x" * 200
    short = shortened("a" + "1" * 5000 + "z")
    assert len(short) <= 200 and short[0] == "a" and short[-1] == "z" and " ... " in short


class Full(io.StringIO):
    def write(self, text: str) -> int:
        raise OSError(28, "No space left on device")


def test_stderr_that_takes_nothing_ends_no_run() -> None:
    PrintedStream(Full(), "stderr", needed=False).write("progress")
    with pytest.raises(OutputError, match="stdout: No space left on device"):
        PrintedStream(Full(), "stdout", needed=True).write("figures")
