"""Parts found in a command alone are those that its plan says it has."""

from __future__ import annotations

import numpy as np
import pytest
from made_linear import DT
from made_records import make_info, make_specimen
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.identification.excitation import (
    Excitation,
    ExcitationSettings,
    Kind,
    multisine,
    plan,
    shaped_noise,
    sweep,
)
from rths_cli.identification.record_parts import find_parts, find_period, sweeps

CLOSE = round(0.2 / DT)
BIT_V = 20.0 / 65536


def planned(kind: Kind, bits: int, seed: int, duration_s: float = 90.0) -> Excitation:
    return plan(make_info(make_specimen(), bits), ExcitationSettings(duration_s=duration_s, kind=kind), seed)


@parametrize_first(4, "bits_of_noise", [0.0, 1.0])
@parametrize_first(4, "bits", [0, 16])
@parametrize_first(4, "kind", ["noise", "step", "multisine", "sweep"])
def test_parts_are_those_of_the_plan(kind: Kind, bits: int, bits_of_noise: float) -> None:
    made = planned(kind, bits, 3)
    noise = bits_of_noise * BIT_V * np.random.default_rng(1).uniform(-1.0, 1.0, len(made.command_v))
    found = find_parts(made.command_v + noise, DT)
    told = made.parts
    assert found.silence is not None
    assert found.free_vibration is not None
    assert told.silence is not None
    assert told.free_vibration is not None
    for one, other in ((found.silence, told.silence), (found.free_vibration, told.free_vibration)):
        assert abs(one.start - other.start) <= CLOSE
        assert abs(one.stop - other.stop) <= CLOSE
    assert (found.period_samples, found.segment_samples) == (told.period_samples, told.segment_samples)
    if kind in ("noise", "step"):
        assert abs(found.noise.start - told.noise.start) <= CLOSE
        assert abs(found.noise.stop - told.noise.stop) <= CLOSE
    else:  # whole periods, after the one in which transients die
        assert (found.noise.stop - found.noise.start) % round(20.0 / DT) == 0
        assert found.noise.stop - found.noise.start >= told.noise.stop - told.noise.start
        assert found.noise.start >= told.noise.start - CLOSE
        assert found.noise.stop <= told.noise.stop + round(2.0 / DT)


def test_period_is_found_to_the_sample() -> None:
    random = np.random.default_rng(2)
    period = multisine(7.0005, DT, 0.6, 60.0, random)
    assert find_period(np.tile(period, 4), DT) == len(period)
    assert find_period(np.tile(period, 2), DT) == 0
    assert find_period(shaped_noise(30.0, DT, 0.3, 60.0, random), DT) == 0


@pytest.mark.parametrize("seed", range(5))
def test_only_sweeps_sweep(seed: int) -> None:
    random = np.random.default_rng(seed)
    assert not sweeps(multisine(20.0, DT, 0.3, 60.0, random))
    assert not sweeps(shaped_noise(20.0, DT, 0.3, 60.0, random))
    shifted = np.roll(sweep(20.0, DT, 0.3, 60.0), int(random.integers(40000)))
    assert sweeps(shifted)


@pytest.mark.parametrize("command_v", [np.zeros(60000), np.concatenate([np.zeros(40000), np.sin(np.arange(18000.0))])])
def test_commands_that_move_too_little_are_refused(command_v: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"my record: the command does not move for 10 s on end"):
        find_parts(command_v, DT, "my record")


def test_no_rest_is_no_silence() -> None:
    found = find_parts(shaped_noise(30.0, DT, 0.3, 60.0, np.random.default_rng(3)), DT)
    assert (found.silence, found.free_vibration) == (None, None)
    assert found.noise == slice(0, 60000)
