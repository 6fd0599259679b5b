"""What many tests share: the default case, identified once per test process, and turns of those in real time."""

from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from rths_cli.cli.entry_point import BLAS_THREADS, NEW_OBJECTS

if TYPE_CHECKING:
    from rths_cli.experiment.model_choice import Memory
    from rths_cli.experiment.setup import Setup
    from rths_cli.identification.results import Identification

DEFAULT = "el_centro_low_ff_fb"
FIRST = ("loop", "rigs", "experiment")  # folders whose tests compile, the one that compiles most first
settings.register_profile("same_every_time", derandomize=True, database=None)
settings.load_profile("same_every_time")
os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))  # as the command does, before numpy is imported
gc.set_threshold(NEW_OBJECTS)  # as the command does: a twentieth of the time was spent on searches
os.environ["COLUMNS"] = "100"  # as in a pipe, wherever the tests are started
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell starts what runs in its background
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a test that is interrupted would wait for ever


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests that compile functions of their own first, so that one of several test processes gets most of them:
    each process that compiles has to work out the types of the same functions."""
    tests = Path(__file__).parent
    places = {folder: place for place, folder in enumerate(FIRST)}
    items.sort(key=lambda item: places.get(Path(os.path.relpath(item.path, tests)).parts[0], len(FIRST)))


def pytest_collection_finish() -> None:
    """Leave what all tests share out of later garbage collections, which would look at it again every time."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Let one test that is marked `real_time` run at a time, of all test processes: each keeps processors busy
    to be punctual, and what they do to one another is not what they test."""
    if sys.platform != "linux" or item.get_closest_marker("real_time") is None:
        return (yield)
    import fcntl

    with (Path(tempfile.gettempdir()) / f"rths_real_time_{os.getuid()}").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        try:
            return (yield)
        finally:
            fcntl.flock(turn, fcntl.LOCK_UN)  # also where a process that the test has started lives on


@pytest.fixture(scope="session")
def memory() -> Memory:
    """Return the identifications already made by this test process."""
    from rths_cli.experiment.model_choice import Memory

    return Memory()


@pytest.fixture(scope="session")
def default_setup() -> Setup:
    """Return the default case's setup."""
    from rths_cli.case.load import load_cases
    from rths_cli.experiment.setup import make_setup

    return make_setup(load_cases([DEFAULT])[0])


@pytest.fixture(scope="session")
def default_identification(memory: Memory, default_setup: Setup) -> Identification:
    """Return what the default identification of the default rig finds."""
    return memory.identify(default_setup, lambda _: None)
