"""Work on the next case of a batch while one waits for the disk or for compiled code; everything is told in order."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import TypeVar

from rths_cli.interruptible import ended_by

Job = TypeVar("Job")
Result = TypeVar("Result")
Tell = Callable[[str], None]

AT_ONCE = 2  # more would only wait for each other: much of a run is Python's own


class Stopped(BaseException):
    """The batch ends: nobody waits for this job any more."""


def cores() -> int:
    """Return the number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_order(
    work: Callable[[Job, Tell], Result], jobs: Sequence[Job], tell: Tell, at_once: int
) -> Generator[Result, None, None]:
    """Yield the results of `work(job, tell)` in the order of the jobs, `at_once` of them worked on at a time.

    `tell` is called for the job whose result is waited for, of the others it is not heard. What a job raises is raised
    here; then, or when the iterator is closed, jobs under way end by Stopped where they tell or compute next, others
    never start.
    """
    if at_once == 1:
        yield from (work(job, tell) for job in jobs)
        return
    stop, awaited = Event(), [0]

    def look() -> None:
        if stop.is_set():
            raise Stopped

    def begin(number: int, job: Job) -> Result:
        def told(what: str) -> None:
            look()
            if awaited[0] == number:
                tell(what)

        look()
        with ended_by(look):
            return work(job, told)

    with ThreadPoolExecutor(at_once) as pool:
        try:
            futures = [pool.submit(begin, number, job) for number, job in enumerate(jobs)]
            for awaited[0], future in enumerate(futures):
                yield future.result()
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)
