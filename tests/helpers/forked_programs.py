"""Programs in processes of their own without the start-up of Python and numba: forked from one that has it behind it.

The process that they are forked from has compiled a function of its own and has imported nothing of rths.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

SERVER = """
import json, os, signal, sys, traceback
import numba

numba.njit("float64(float64)")(lambda value: value)  # the first function costs as much as the import
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
print("ready", flush=True)

def run(code, folder, environment, working, umask):
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(os.path.join(folder, name), os.O_WRONLY), number)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(working)
    os.umask(umask)
    sys.argv, failed = ["-c"], 0
    try:
        exec(compile(code, "<string>", "exec"), {"__name__": "__main__"})
    except BaseException:
        traceback.print_exc()
        failed = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(failed)

for line in sys.stdin:
    asked = json.loads(line)
    if os.fork():
        continue
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    pid = os.fork()
    if pid == 0:
        run(*asked)
    print(pid, flush=True)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with open(os.path.join(asked[1], "ending"), "w") as file:
        file.write(str(code))
    os.rename(os.path.join(asked[1], "ending"), os.path.join(asked[1], "ended"))
    os._exit(0)
"""


@cache
def _server() -> subprocess.Popen[str]:
    """Return the process that forks; it ends when this one does and its input is closed."""
    made = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    )
    assert made.stdout is not None and made.stdout.readline() == "ready\n"
    return made


class Program:
    """A running program, as subprocess.Popen has it, in this process's folder and with its mask of modes."""

    def __init__(self, code: str, environment: dict[str, str]) -> None:
        server = _server()
        assert server.stdin is not None and server.stdout is not None
        self._holder = TemporaryDirectory()
        self._folder = Path(self._holder.name)
        self.returncode: int | None = None
        for name in ("out", "err"):
            (self._folder / name).touch()
        os.umask(umask := os.umask(0o077))
        server.stdin.write(json.dumps([code, str(self._folder), environment, os.getcwd(), umask]) + "\n")
        self.pid = int(server.stdout.readline())

    def poll(self) -> int | None:
        """Return the exit code, None while the program runs."""
        with suppress(FileNotFoundError):
            self.returncode = int((self._folder / "ended").read_text())
        return self.returncode

    def kill(self) -> None:
        """Kill the program if it runs."""
        if self.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)

    def communicate(self, timeout: float = 60.0) -> tuple[str, str]:
        """Wait for the end; return what was written to stdout and stderr."""
        end = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > end:
                raise TimeoutError(f"process {self.pid} has not ended after {timeout:g} s")
            time.sleep(0.002)
        return (self._folder / "out").read_text(), (self._folder / "err").read_text()
