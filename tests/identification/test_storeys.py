"""Chains of any stiffness and damping obey the storeys' equations; faults of channels and masses do not, and are named.

The records come from a plant of its own (tests/helpers/campaigns/own_plant.py), which shares no code with the project.
Many more chains: benchmarks/diagnosis.py.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from campaigns.own_chains import Chain, Fault, injected, made_chain
from campaigns.own_plant import Plant
from portfolio import parametrize_first

from rths_cli.findings import sentences
from rths_cli.identification import channel_responses
from rths_cli.identification.chain_residual import explained, first_values, grouped
from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.inputs import IdentificationSettings, evidence

SOFT_TOP = Plant(
    np.array([6.27, 2.11, 5.92, 3.90]), np.array([8487.7, 8917.6, 7574.9, 47.2]),
    np.array([0.024, 0.019, 0.025, 0.033]), servo_hz=24.0, coulomb_n=0.13,
)  # fmt: skip
STIFF = Plant(np.array([8.7, 4.0]), np.array([150_000.0, 230_000.0]), np.array([0.058, 0.023]), coulomb_n=1.0)
ONE = Plant(np.array([7.0]), np.array([110_540.0]), np.array([0.03]))
LIGHT = Plant(
    np.array([1.8, 5.5, 6.5, 6.6, 2.0]), np.array([3892.0, 4287.0, 1771.0, 2753.0, 1502.0]),
    np.array([0.0023, 0.0024, 0.0048, 0.007, 0.0052]), servo_hz=17.0,
)  # fmt: skip


class Between(Plant):
    """A plant to which a command comes 3/8 of a sample after the sample's instant."""

    def simulate(self, command_v: np.ndarray, dt_s: float, latency_samples: int) -> np.ndarray:
        return super().simulate(np.repeat(command_v, 8), dt_s / 8, 8 * latency_samples + 3)[:, ::8]


def quick(plant: type[Plant], mass_kg: float, first_hz: float, ratio: float, servo_hz: float, lag_s: float) -> Plant:
    """Return a table under one floor, whose amplifier is quick within a sample of 2 ms."""
    stiffness = mass_kg * (2.0 * np.pi * first_hz) ** 2
    return plant(np.array([mass_kg]), np.array([stiffness]), np.array([ratio]), servo_hz=servo_hz, lag_s=lag_s)


QUICK = {
    "at the sample": quick(Plant, 42.0, 3.88, 0.16, 15.6, 0.5e-3),
    "between samples": quick(Between, 6.0, 4.3, 0.096, 38.0, 0.4e-3),
    "stiffer": quick(Between, 12.0, 4.6, 0.127, 39.0, 0.34e-3),
}
SOFT = {  # so soft that its table's displacement is nearly the command's: alias and wrong sensitivity look alike
    500.0: Plant(np.array([5.0]), np.array([5.0 * (2.0 * np.pi * 1.2) ** 2]), np.array([0.006]), servo_hz=37.0),
    2000.0: Plant(np.array([5.0]), np.array([5.0 * (2.0 * np.pi * 1.5) ** 2]), np.array([0.028]), servo_hz=28.0),
}
PLANTS = {"soft top": SOFT_TOP, "stiff": STIFF, "one": ONE, "light": LIGHT}


@cache
def chain(name: str) -> Chain:
    return made_chain(PLANTS[name], rate_hz=500.0 if name == "light" else 1000.0, bits=16, latency_samples=3, seed=4)


def said(made: Chain) -> channel_responses.Judgement:
    data = evidence([made.record], None, made.info, made.masses_kg, IdentificationSettings())
    return channel_responses.judge(data, estimate([made.record], made.info.dt_s, (0.5, 60.0), 15.0))


def assert_healthy(made: Chain, plant: Plant, misfit: float, within: float) -> None:
    """Assert that a chain is explained, with its stiffnesses `within` (relative) of the plant's, and accused of
    nothing."""
    lines = grouped([made.record], made.info, made.masses_kg, (0.5, 60.0))
    assert explained(lines).misfit.max() < misfit
    assert first_values(lines)[0] == pytest.approx(plant.stiffness_n_per_m, rel=within)
    assert said(made) == channel_responses.Judgement()


@pytest.mark.campaign
@parametrize_first(1, "name", PLANTS)
def test_a_chain_as_declared_is_explained_and_not_accused(name: str) -> None:
    assert_healthy(chain(name), PLANTS[name], misfit=2.0, within=0.01)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("name", "fault", "words"),
    [
        ("soft top", Fault("sign", (4,)), "channel floor_5: wrong sign"),
        ("soft top", Fault("sign", (2,)), "channel floor_3: wrong sign"),
        ("soft top", Fault("gain", (0,), 1.06), "channel table: reads 1.0"),
        ("soft top", Fault("swap", (1, 3)), "channels floor_2 and floor_4: they look swapped"),
        ("stiff", Fault("swap", (1, 2)), "channels floor_2 and floor_3: they look swapped"),
        ("stiff", Fault("gain", (2,), 0.9), "channel floor_3: reads 0.900"),
        ("one", Fault("sign", (1,)), "channel floor_2: wrong sign"),
        ("one", Fault("sign", (0,)), "channel table: wrong sign"),
        ("one", Fault("gain", (1,), 1.1), "channel floor_2: reads 1.100"),
        ("light", Fault("reversed", (1, 2, 3, 4, 5)), "reverse order"),
        ("light", Fault("gain", (3,), 1.2), "channel floor_4: reads 1.200"),
    ],
)
def test_the_fault_put_in_is_the_one_named(name: str, fault: Fault, words: str) -> None:
    (sentence,) = sentences(said(injected(chain(name), fault)).faults)
    assert words in sentence
    assert ("between which the channels do not tell" in sentence) == (name == "one" and fault.kind == "gain")


@pytest.mark.campaign
def test_a_wrong_mass_is_said_and_refuses_no_channel() -> None:
    judged = said(injected(chain("light"), Fault("mass", (4,), 1.2)))
    assert judged.faults == ()
    assert "mass of floor_5: 1.2" in str(judged.warnings[0])


def test_every_channel_against_the_command_is_the_commands_polarity() -> None:
    made = chain("soft top")
    (sentence,) = sentences(said(injected(made, Fault("all", tuple(range(5))))).faults)
    assert "command: every channel moves against it" in sentence


@cache
def quick_chain(name: str) -> Chain:
    return made_chain(QUICK[name], rate_hz=500.0, bits=18, latency_samples=2, seed=7, noise_m_s2=1e-4)


@parametrize_first(1, "name", QUICK)
def test_a_healthy_table_that_is_quick_within_a_sample_is_not_accused(name: str) -> None:
    """Where spring and dashpot pass the alias's terms of higher order, a sample of the table is not its motion."""
    assert_healthy(quick_chain(name), QUICK[name], misfit=1.5, within=0.005)


@parametrize_first(1, "name", QUICK)
@parametrize_first(1, "factor", [0.5, 0.9, 2.0])
def test_a_wrong_sensitivity_of_a_quick_table_is_named(name: str, factor: float) -> None:
    (sentence,) = sentences(said(injected(quick_chain(name), Fault("gain", (0,), factor))).faults)
    told = sentence.split("channel table: reads ")[1]
    assert float(told.split()[0]) == pytest.approx(factor, rel=0.03)


@parametrize_first(1, ("rate_hz", "factors"), [(500.0, (0.5, 2.0)), (2000.0, (0.95, 1.05))])
def test_an_alias_hides_no_wrong_sensitivity_of_the_table(rate_hz: float, factors: tuple[float, ...]) -> None:
    made = made_chain(SOFT[rate_hz], rate_hz, bits=16, latency_samples=3, seed=4)
    for factor in factors:
        wrong = injected(made, Fault("gain", (0,), factor))
        lines = grouped([wrong.record], wrong.info, wrong.masses_kg, (0.5, 60.0))
        assert explained(lines).misfit.max() > 4.0
