"""A signal ends the wait for a computation although the computation itself hears of nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from rths_cli.interrupts import any_abandoned, ended_by, interruptible


def test_what_is_computed_comes_back_and_so_does_what_is_raised() -> None:
    assert interruptible(lambda: 6 * 7) == 42
    with pytest.raises(ZeroDivisionError):
        interruptible(lambda: 1 // 0)
    assert not any_abandoned()


def test_an_interrupt_ends_the_wait_and_leaves_the_computation_alone() -> None:
    started, release = threading.Event(), threading.Event()

    def interrupt() -> None:
        started.wait()
        os.kill(os.getpid(), signal.SIGINT)

    def work() -> None:
        started.set()
        release.wait()

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        interruptible(work)
    assert any_abandoned()
    release.set()
    end = time.monotonic() + 10.0  # a bound for a broken program, not a measure
    while any_abandoned() and time.monotonic() < end:
        time.sleep(0.005)
    assert not any_abandoned()


def test_a_thread_that_is_to_end_stops_waiting() -> None:
    """Threads hear of no signal: what they look at tells them."""
    release = threading.Event()

    class Ended(BaseException):
        pass

    def look() -> None:
        raise Ended

    with pytest.raises(Ended), ended_by(look):
        interruptible(release.wait)
    release.set()
    assert interruptible(lambda: True)


def test_a_process_leaves_with_its_code_while_a_computation_goes_on() -> None:
    """In linear algebra, which holds no lock of Python's and would go on for minutes."""
    code = (
        "import os, signal, sys, threading\n"
        "import numpy as np\n"
        "from rths_cli.cli import entry_point\n"
        "from rths_cli.interrupts import interruptible\n"
        "def command(**_):\n"
        "    started = threading.Event()\n"
        "    def work():\n"
        "        started.set()\n"
        "        np.linalg.eig(np.random.default_rng(0).normal(size=(6000, 6000)))\n"
        "    threading.Thread(target=lambda: (started.wait(), os.kill(os.getpid(), signal.SIGTERM))).start()\n"
        "    interruptible(work)\n"
        "entry_point.cli.main = command\n"
        "entry_point.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (143, "rths: terminated\n")
