"""Freed memory is used again: the system counts the pages that a process had to be given."""

import os
import subprocess
import sys

import pytest

COUNT = """
import resource
import numpy as np
from rths_cli.experiment.run_command import keep_freed_memory
{keep}
def given():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.full(250_000, 1.0)  # 2 MB, 488 pages of 4 kB
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
given()
print(given())
"""


def pages_given(keep: str) -> int:
    """Return how many pages a process is given for arrays that it makes and frees again and again."""
    code = COUNT.format(keep=keep)
    environment = {**os.environ, "MALLOC_MMAP_THRESHOLD_": "131072"}  # as glibc starts, but for good
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    return int(told.stdout)


@pytest.mark.campaign
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc alone has the setting")
def test_arrays_that_are_made_and_freed_again_and_again_cost_no_pages() -> None:
    assert pages_given("") > 1000
    assert pages_given("keep_freed_memory()") < 100
