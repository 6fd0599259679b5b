"""A joint that sticks and slides, against its force at turning points by hand."""

import numpy as np
import pytest

from rths_cli.numerics.hysteresis import slid


def test_a_joint_sticks_over_its_reach_slides_and_sticks_again_at_each_reversal() -> None:
    way = np.array([0.0, 0.25, 0.5, 1.0, 0.75, 0.0, -0.5, 0.0])
    assert slid(way, 0.5) == pytest.approx([0.0, 0.5, 1.0, 1.0, 0.5, -1.0, -1.0, 0.0])


def test_a_closed_loop_takes_four_times_what_lies_outside_its_sticking() -> None:
    way, reach = 3.0 * np.sin(np.linspace(0.0, 6.0 * np.pi, 60_001)), 0.4
    loop = slice(20_000, None)  # two periods
    force = slid(way, reach)[loop]
    work = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(way[loop])))
    assert work / 2.0 == pytest.approx(4.0 * (3.0 - reach), rel=1e-3)
