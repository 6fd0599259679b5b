"""What every channel must show, by which the guard knows a stuck sensor: the specimen alone, no measured floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from bench import rig_info, specimen
from hybrid import best_like, ground
from scipy.signal import lsim

from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.loop.step import step
from rths_cli.loop.step_arrays import RECORD, Step, assemble
from rths_cli.numerics.compiled import borrowed, entry
from rths_cli.numerics.lti import Array

STEPS = 3000


@entry
def stepped(s: Step, drive: Array, samples: Array, measured: Array, expected: Array) -> None:
    """Run steps on samples (n, c) in V; note the measured table acceleration (n,) and what is expected (n, 2, c)."""
    s, drive, samples, measured, expected = borrowed((s, drive, samples, measured, expected))
    for k in range(measured.size):
        for c in range(s.samples.size):
            s.samples[c] = samples[k, c]
        step(s, drive[k])
        measured[k] = s.corrected[0]
        for i in range(2):
            for c in range(s.samples.size):
                expected[k, i, c] = s.expected[i, c]


def expectations(known: bool = True, floors: float = 1.0) -> tuple[Array, Array, Array]:
    """Return the desired motion (n,), the measured (n,) and what is expected (n, 2, 3), on samples of noise.

    Those of the floors are larger by a factor.
    """
    info = rig_info()
    blocks = best_like(info) if known else replace(best_like(info), open_loop=None)
    samples = 0.1 * np.random.default_rng(3).standard_normal((STEPS, 3)) * [1.0, floors, floors]
    samples[0] = 0.0
    drive, measured, expected = ground(STEPS), np.zeros(STEPS), np.zeros((STEPS, 2, 3))
    stepped(assemble(blocks, RECORD), drive, samples, measured, expected)
    return drive[:, 0], measured, expected


def test_a_floor_must_show_what_the_specimen_alone_makes_of_the_motion_of_the_table() -> None:
    """The oracle is scipy's lsim, straight lines between samples; the desired motion is that of two steps ago."""
    desired, measured, expected = expectations()
    system, time = specimen_state_space(specimen()), rig_info().dt_s * np.arange(STEPS)
    late = np.concatenate([np.zeros(2), desired[:-2]])
    for i, table in enumerate((late, measured)):
        oracle = lsim((system.A, system.B, system.C, system.D), table, time)[1]
        np.testing.assert_allclose(expected[:, i, 1:], oracle, atol=1e-9 * np.abs(oracle).max())
    np.testing.assert_array_equal(expected[:, :, 0], np.column_stack([desired, desired]))


def test_without_a_specimen_a_floor_must_show_the_desired_motion() -> None:
    desired, _, expected = expectations(known=False)
    np.testing.assert_array_equal(expected, np.broadcast_to(desired[:, None, None], expected.shape))


def test_no_measured_floor_enters() -> None:
    np.testing.assert_array_equal(expectations(floors=7.0)[2], expectations()[2])
