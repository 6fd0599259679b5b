"""Parameters of a law that adapts, held by the step: bounds, rate, and a halt while a command is clipped or a sample is
lost."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.control.interface import Adapted
from rths_cli.loop import adapted_states
from rths_cli.loop.adapted_states import Held
from rths_cli.numerics.compiled import entry

START, LEAST, MOST = np.array([1.0, 0.0]), np.array([0.8, -0.1]), np.array([1.1, 0.1])
LAW = Adapted(("a", "b"), ("", "s"), START, LEAST, MOST, np.full(2, 0.03))


@entry
def hold(at: Held, frozen: bool) -> None:
    adapted_states.hold(at, frozen)


def held() -> Held:
    """Return the parameters of a law with three states at rest."""
    return adapted_states.held(LAW, np.zeros(3), np.zeros(2), 1)


def test_a_parameter_moves_no_faster_than_its_rate_up_to_its_bound() -> None:
    at = held()
    for k in range(1, 9):
        at.state[1:] = 5.0, -5.0  # what the law asks for
        hold(at, False)
        wanted = min(0.03 * k, 0.1)
        assert at.state[1:] == pytest.approx([wanted, -wanted])
        assert at.values == pytest.approx([1.0 + wanted, -wanted])
    assert at.state[0] == 0.0  # no parameter


def test_while_frozen_they_stay_and_go_on_from_there() -> None:
    at = held()
    at.state[1:] = 0.02, 0.01
    hold(at, False)
    for _ in range(5):
        at.state[1:] = -1.0, 1.0
        hold(at, True)
        assert at.state[1:] == pytest.approx([0.02, 0.01]) and at.values == pytest.approx([1.02, 0.01])
    at.state[1:] = -1.0, 1.0
    hold(at, False)
    assert at.state[1:] == pytest.approx([-0.01, 0.04])
