"""The compiled step and the one in C on the same inputs: what differs."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import numpy as np

from campaigns import step_in_c, step_run
from rths_cli.numerics.lti import Array

SHIPPED = ("el_centro_low_ff", "el_centro_low_ff_fb", "hachinohe_low_ff", "hachinohe_low_ff_fb")
SAME = 1e-12  # of a signal's peak: rounding, in another order, that a hundred thousand steps pass on
SAME_MEMORY = 1e-9  # of the largest one: some are small differences of large numbers, as what rounding carries over


def both(library: ctypes.CDLL, inputs: step_run.Inputs) -> tuple[step_run.State, step_run.State, int, int]:
    """Play the inputs by our step and in C; return both states and the steps that each has done."""
    ours, theirs = step_run.fresh(inputs), step_run.fresh(inputs)
    return ours, theirs, step_run.bound(inputs, ours)(), step_in_c.bound(library, inputs, theirs)()


def differences(ours: step_run.State, theirs: step_run.State, done: int, done_in_c: int) -> Iterator[str]:
    """Yield what differs: steps, signals, the guard's flags, and what table, storeys and controllers remember."""
    if done != done_in_c:
        yield f"{done} steps, {done_in_c} in C"
    if not np.array_equal(ours.guard.flags, theirs.guard.flags):
        yield f"flags of the guard {ours.guard.flags}, {theirs.guard.flags} in C"
    for name in step_run.SIGNALS:
        one, two = (getattr(state.signals, name)[..., :done] for state in (ours, theirs))
        if not one.any() or not _close(one, two, SAME):
            yield name
    pairs = zip(_remembered(ours).items(), _remembered(theirs).values(), strict=True)
    yield from (f"{name} at the end" for (name, one), two in pairs if not _close(one, two, SAME_MEMORY))


def _close(one: Array, two: Array, share: float) -> bool:
    """Tell whether two series are the same to a share of the peak of the first."""
    return np.allclose(two, one, rtol=0.0, atol=share * float(np.nanmax(np.abs(one), initial=0.0)), equal_nan=True)


def _remembered(state: step_run.State) -> dict[str, Array]:
    names = ("motion", "codes", "expected_at", "moved", "same", "slip", "energy", "seen")
    of_guard = {f"{name} of the guard": getattr(state.guard, name) for name in names}
    return {**of_guard, "expected": state.step.expected, "table": state.table.state, "step": state.step.state}
