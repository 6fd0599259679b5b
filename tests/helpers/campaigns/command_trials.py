"""Run a command in a copy of this process within limits of time and memory, and judge its end and what it said."""

from __future__ import annotations

import contextlib
import os
import re
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rths_cli.cli import main as rths_main
from rths_cli.report import check_page, figures, page, report_options  # noqa: F401
from rths_cli.report import export_files as _export  # noqa: F401 imported before processes are copied, to save their time
from rths_cli.studies import sweep  # noqa: F401

LIMIT_S = 5.0  # of the processor, which a busy machine does not change
STOPPED_S = 30.0  # of the processor, by the kernel
HANGS_S = 300.0  # of the clock: for a process that waits
ENDS_S = 10.0  # of the clock, after SIGTERM
TOLD_TO_END = 143
LIMIT_BYTES = 1 << 30
IMPORTED_BYTES = 1 << 28  # what a command's own imports may hold; memory of this process beyond that is not counted
CONTROL = re.compile(rb"[\x00-\x08\x0b-\x1f\x7f]|\xc2[\x80-\x9f]")


def judged(code: int, seconds: float, memory: int, said: bytes) -> str:
    """Return which demand was not met, "" when all were."""
    faults = [f"exit code {code}"] if code not in (0, 1, 2) else []
    faults += [f"{seconds:.1f} s"] if seconds > LIMIT_S else []
    faults += [f"{memory / 1e6:.0f} MB"] if memory > LIMIT_BYTES else []
    faults += ["a traceback"] if b"Traceback" in said else []
    faults += ["a warning"] if re.search(rb"Warning:|WARNING", said) else []
    faults += ["a control character"] if CONTROL.search(said) else []
    return ", ".join(faults)


def in_a_process(work: Path, command: Sequence[str], hangs_s: float | None = None) -> tuple[int, float, int, bytes]:
    """Run a command in a copy of this process, told to end after some time of the clock and then killed; return code
    (negative: a signal), CPU time, memory, output.

    The memory is the child's, less what this process held beyond IMPORTED_BYTES when it was copied.
    """
    output, start = work / ".output", time.monotonic()
    resident, of_files = (int(pages) for pages in Path("/proc/self/statm").read_text().split()[1:3])
    held = (resident - of_files) * os.sysconf("SC_PAGE_SIZE")  # a copy has no pages of files at first
    child = os.fork()
    if child == 0:
        _become(work, command, output)
    status, usage = _waited(child, start + (HANGS_S if hangs_s is None else hangs_s))
    code = os.waitstatus_to_exitcode(status)
    said = output.read_bytes() if output.exists() else b""
    memory = 1024 * usage.ru_maxrss - max(held - IMPORTED_BYTES, 0)
    return code, usage.ru_utime + usage.ru_stime, memory, said


def _waited(child: int, deadline: float) -> tuple[int, Any]:
    """Wait for a process, which is told to end at the deadline, and killed where it does not."""
    for end, number in ((deadline, signal.SIGTERM), (deadline + ENDS_S, signal.SIGKILL)):
        while time.monotonic() < end:
            done, status, usage = os.wait4(child, os.WNOHANG)
            if done:
                return status, usage
            time.sleep(0.002)
        os.killpg(child, number)
    _, status, usage = os.wait4(child, 0)
    return status, usage


def _become(work: Path, command: Sequence[str], output: Path) -> None:
    """Be `rths COMMAND` in a folder, with everything it prints in a file; never return."""
    try:
        os.setpgid(0, 0)
        os.chdir(work)
        os.environ["TMPDIR"] = str(work)
        tempfile.tempdir = None
        handle = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        for number in (1, 2):
            os.dup2(handle, number)
        for name, number in (("stdout", 1), ("stderr", 2)):
            setattr(sys, name, open(number, "w", closefd=False))  # noqa: SIM115
        sys.argv = ["rths", *command]
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(STOPPED_S), int(STOPPED_S)))
        resource.setrlimit(resource.RLIMIT_DATA, (2 * LIMIT_BYTES, 2 * LIMIT_BYTES))
        rths_main()
    except SystemExit as ended:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
        os._exit(ended.code if isinstance(ended.code, int) else 1)
    except BaseException as error:
        os.write(2, f"Traceback: {type(error).__name__}: {error}".encode())
    os._exit(99)


def in_a_process_slow(folder: Path, line: Sequence[str]) -> tuple[int, float, int, bytes]:
    """Run a command that makes a valid file, with as much time as it takes."""
    global STOPPED_S, HANGS_S
    before, STOPPED_S, HANGS_S = (STOPPED_S, HANGS_S), 600.0, 600.0
    try:
        return in_a_process(folder, line)
    finally:
        STOPPED_S, HANGS_S = before
        (folder / ".output").unlink(missing_ok=True)
