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
PLANTS = {"soft top": SOFT_TOP, "stiff": STIFF, "one": ONE, "light": LIGHT}


@cache
def chain(name: str) -> Chain:
    return made_chain(PLANTS[name], rate_hz=500.0 if name == "light" else 1000.0, bits=16, latency_samples=3, seed=4)


def said(made: Chain) -> channel_responses.Judgement:
    data = evidence([made.record], None, made.info, made.masses_kg, IdentificationSettings())
    return channel_responses.judge(data, estimate([made.record], made.info.dt_s, (0.5, 60.0), 15.0))


@pytest.mark.parametrize("name", PLANTS)
def test_a_chain_as_declared_is_explained_and_not_accused(name: str) -> None:
    made = chain(name)
    lines = grouped([made.record], made.info, made.masses_kg, (0.5, 60.0))
    assert explained(lines).misfit.max() < 2.0
    assert first_values(lines)[0] == pytest.approx(PLANTS[name].stiffness_n_per_m, rel=0.01)
    assert said(made) == channel_responses.Judgement()


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
    (sentence,) = said(injected(chain(name), fault)).faults
    assert words in sentence
    assert ("between which the channels do not tell" in sentence) == (name == "one" and fault.kind == "gain")


def test_a_wrong_mass_is_said_and_refuses_no_channel() -> None:
    judged = said(injected(chain("light"), Fault("mass", (4,), 1.2)))
    assert judged.faults == ()
    assert "mass of floor_5: 1.2" in judged.warnings[0]


def test_every_channel_against_the_command_is_the_commands_polarity() -> None:
    made = chain("soft top")
    (sentence,) = said(injected(made, Fault("all", tuple(range(5))))).faults
    assert "command: every channel moves against it" in sentence
