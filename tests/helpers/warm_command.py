"""`rths` in a process of its own that has its imports behind it: forked from one that has made them.

`rths_words()` are the first words of a command, as `sys.executable, "-m", "rths_cli"` are, with arguments, folder,
environment, standard streams and exit code of its own. What depends on how Python starts (what is imported when,
signals, a closed stream, another place for compiled code) is tested with those.

This file is three programs: a test process imports it; one that it starts makes the imports and forks the commands;
a command is one that hands its streams to a fork and leaves with that one's exit code, or becomes `python -m rths_cli`
where a variable of its environment could have changed what was imported.
"""

from __future__ import annotations

import os
import sys

if __name__ != "__main__":  # a command starts in 12 ms without them
    import subprocess
    from functools import cache
    from pathlib import Path
    from tempfile import TemporaryDirectory

WITHOUT_EFFECT = {  # on what is imported: variables that a command reads when it runs, and those of tests and shells
    "COLUMNS", "LINES", "TERM", "NO_COLOR", "GITHUB_STEP_SUMMARY", "PATH", "PWD", "OLDPWD", "SHLVL", "_",
    "PYTEST_CURRENT_TEST", "PYTEST_XDIST_WORKER", "PYTEST_XDIST_WORKER_COUNT", "PYTEST_XDIST_TESTRUNUID",
}  # fmt: skip
PIECE = 1 << 16  # bytes of a request that are read at once
KEPT: dict[str, object] = {}  # what lives as long as a test process: a folder, and the process that forks


def decisive(environment: dict[str, str]) -> dict[str, str]:
    """Return the variables that may decide what an import does."""
    return {name: value for name, value in environment.items() if name not in WITHOUT_EFFECT}


def serve(place: str) -> None:
    """Import all that commands use, then fork one for each that asks, until standard input is closed."""
    import gc
    import json
    import pkgutil
    import selectors
    import signal
    import socket
    from importlib import import_module

    import numba

    import rths_cli

    for module in pkgutil.walk_packages(rths_cli.__path__, "rths_cli."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    numba.njit("float64(float64)")(lambda value: value)  # the first function costs as much as the import
    gc.collect()
    gc.freeze()
    own = decisive(dict(os.environ))
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(place)
    listener.listen(50)
    print("ready", flush=True)
    waiting = selectors.DefaultSelector()
    waiting.register(listener, selectors.EVENT_READ)
    waiting.register(0, selectors.EVENT_READ)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while all(key.fileobj is listener for key, _ in waiting.select()):
        asking, _ = listener.accept()
        if os.fork():
            asking.close()
            continue
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        text, streams, _, _ = socket.recv_fds(asking, PIECE, 3)
        while more := asking.recv(PIECE):
            text += more
        words, folder, environment, umask = json.loads(text)
        if decisive(environment) != own:
            asking.sendall(b"start it yourself")
            os._exit(0)
        if pid := os.fork():
            code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            asking.sendall(str(code).encode())
            os._exit(0)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        for one in (asking, listener, waiting):
            one.close()
        os.environ.clear()
        os.environ.update(environment)
        os.chdir(folder)
        os.umask(umask)
        sys.stdin = sys.__stdin__ = open(0)  # noqa: SIM115  # as Python opens them
        sys.stdout = sys.__stdout__ = open(1, "w")  # noqa: SIM115
        sys.stderr = sys.__stderr__ = open(2, "w", buffering=1, errors="backslashreplace")  # noqa: SIM115
        sys.argv, sys.path[0] = ["rths", *words], folder
        from rths_cli.__main__ import main

        main()


def ask(place: str, words: list[str]) -> None:
    """Have a command forked, and leave as it does."""
    import json
    import socket

    os.umask(umask := os.umask(0o077))
    request = json.dumps([words, os.getcwd(), dict(os.environ), umask]).encode()
    with socket.socket(socket.AF_UNIX) as asking:
        asking.connect(place)
        asking.sendall(request[socket.send_fds(asking, [request], [0, 1, 2]) :])
        asking.shutdown(socket.SHUT_WR)
        told = asking.recv(100)
    if told == b"start it yourself":
        os.execv(sys.executable, [sys.executable, "-m", "rths_cli", *words])
    code = int(told)
    if code < 0:
        os.kill(os.getpid(), -code)
    os._exit(code)


if __name__ != "__main__":

    @cache
    def rths_words() -> tuple[str, ...]:
        """Return the first words of a command; who asks first starts the process that makes the imports.

        It ends when this process does, and its input is closed with it.
        """
        if not hasattr(os, "fork"):
            return sys.executable, "-m", "rths_cli"
        KEPT["folder"] = folder = TemporaryDirectory(prefix="rths")
        place = str(Path(folder.name) / "commands")
        words = [sys.executable, __file__, "serve", place]
        KEPT["server"] = server = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert server.stdout is not None and server.stdout.readline() == b"ready\n"
        return sys.executable, "-S", __file__, "ask", place


if __name__ == "__main__":
    kind, place, *words = sys.argv[1:]
    serve(place) if kind == "serve" else ask(place, words)
