"""What every rig has to keep, whatever it is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench import rig_info, specimen

from rths_cli.case.virtual_physics import VirtualPhysics
from rths_cli.errors import RigError
from rths_cli.lti import Array
from rths_cli.rigs.interface import Rig
from rths_cli.rigs.virtual.rig import VirtualRig, build_plant

Maker = Callable[..., Rig]


def virtual(latency_samples: int = 1, seed: tuple[int, ...] = (0, 1), bits: int = 16) -> Rig:
    info = rig_info(latency_samples=latency_samples, bits=bits)
    return VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), seed)


@pytest.fixture(params=[virtual])
def make(request: pytest.FixtureRequest) -> Maker:
    """Return the maker of one kind of rig; each further kind of rig adds one line here."""
    return request.param


def bit_v(make: Maker) -> float:
    """Return one bit of the samples in V."""
    return make().info.converters.step_v


def play(rig: Rig, command_v: Array) -> Array:
    """Return the samples (n + 1, c) of a whole session: open, arm, exchange, rest, close, close again."""
    rig.open()
    samples = [rig.arm().copy()]
    samples += [rig.exchange(float(command)).copy() for command in command_v]
    rig.rest()
    rig.close()
    rig.close()
    return np.array(samples)


def test_a_session_gives_one_row_of_samples_per_command(make: Maker) -> None:
    rig = make()
    samples = play(rig, 0.5 * np.sin(0.02 * np.arange(300)))
    assert samples.shape == (301, len(rig.info.channels))
    assert np.isfinite(samples).all()
    assert np.ptp(samples, axis=0).min() > 0.05


@pytest.mark.parametrize("latency", [0, 1, 2, 4])
def test_the_declared_latency_is_true(make: Maker, latency: int) -> None:
    """A command of step k acts from t_(k + latency) on, so the first sample it changes is the next one."""
    pulse = np.zeros(30)
    pulse[10] = 5.0
    rig = make(latency_samples=latency)
    assert rig.info.latency_samples == latency
    moved = np.abs(play(rig, pulse) - play(make(latency_samples=latency), np.zeros(30)))[:, 0]
    assert np.flatnonzero(moved > 0.1)[0] == 10 + latency + 1
    assert moved[: 10 + latency + 1].max() == 0.0


def test_arming_puts_the_table_at_rest_and_repeats_the_run(make: Maker) -> None:
    rig, command = make(), 3.0 * np.sin(0.05 * np.arange(200))
    first = play(rig, command)
    assert np.array_equal(play(rig, command), first)
    assert np.abs(first[0]).max() < 1e-3
    assert np.abs(first).max() > 0.1


def test_the_seed_decides_the_bytes(make: Maker) -> None:
    command = 3.0 * np.sin(0.05 * np.arange(400))
    same, again, other = (play(make(seed=seed), command) for seed in ((7, 1), (7, 1), (7, 2)))
    assert same.tobytes() == again.tobytes()
    different = same != other  # noise is a tenth of a bit
    assert 0.02 < different.mean() < 0.5
    assert np.abs(same - other).max() < 1.5 * bit_v(make)


def test_samples_are_codes_of_the_converter_inside_its_range(make: Maker) -> None:
    """A command of full range jerks the table beyond 5 g: the samples stay codes, and inside +-range."""
    rig = make()
    samples = play(rig, np.where(np.arange(400) % 40 < 20, 10.0, -10.0) * (np.arange(400) < 200))
    converters = rig.info.converters
    codes = samples / (2.0 * converters.range_v / 2**converters.bits)  # 0.305 mV
    assert np.abs(codes - np.round(codes)).max() < 1e-9
    assert codes.min() >= -(2 ** (converters.bits - 1))
    assert codes.max() <= 2 ** (converters.bits - 1) - 1
    assert np.unique(codes[:, 0]).size > 100


def test_a_rig_at_its_end_stop_says_so_in_one_sentence() -> None:
    info = replace(rig_info(), limits=replace(rig_info().limits, stroke_m=0.01))
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 0.0), (0,))
    rig.arm()
    with pytest.raises(RigError, match=r"bench: the table ran into its end stop \(0\.01 m\)"):
        for _ in range(2000):
            rig.exchange(2.0)
    assert abs(rig.state.state[0]) == pytest.approx(0.01, abs=1e-3)
