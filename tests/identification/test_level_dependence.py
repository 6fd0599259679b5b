"""What depends on the level is told by its shape: friction, a suspension, a storey; records of a plant of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from campaigns.own_chains import made_chain
from campaigns.own_plant import Plant

from rths_cli.identification.identify import identify
from rths_cli.identification.results import Identification

SOFT_SERVO = Plant(
    np.array([7.0]), np.array([9000.0]), np.array([0.03]), servo_hz=6.0, servo_ratio=0.6, suspension_n_per_m=800.0
)
STIFF_SERVO = replace(SOFT_SERVO, servo_hz=20.0)
TOLERATED = replace(STIFF_SERVO, coulomb_n=6.0)  # leaves 1.8 %, less than the 3 % of friction of known size
CUBIC = 0.2 * 20.0 * (2.0 * np.pi * 6.0) ** 2 / 0.04**2  # +20 % of the whole stiffness at 40 mm


def found(plant: Plant) -> Identification:
    loud = made_chain(plant, 1000.0, 16, 2, seed=5, level_m_s2=1.5)
    quiet = made_chain(plant, 1000.0, 16, 2, seed=6, level_m_s2=0.3)
    return identify([loud.record], loud.info, plant.masses_kg, quiet=quiet.record)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("plant", "table", "storeys"),
    [
        (STIFF_SERVO, (), ()),
        (TOLERATED, ("friction",), ()),
        (replace(SOFT_SERVO, coulomb_n=2.0), ("friction",), ()),
        (replace(SOFT_SERVO, cubic_n_per_m3=CUBIC), ("hardening",), ()),
        (replace(SOFT_SERVO, cubic_n_per_m3=-0.5 * CUBIC), ("softening",), ()),
        (replace(STIFF_SERVO, softening_m=0.1), None, (1,)),
    ],
    ids=["linear", "friction 6 N", "friction 2 N", "hardening", "softening", "storey"],
)
def test_the_cause_is_told(plant: Plant, table: tuple[str, ...] | None, storeys: tuple[int, ...]) -> None:
    told = found(plant)
    assert told.causes.storeys == storeys
    assert table is None or told.causes.table == table
    reasons = " ".join(told.reasons)
    assert ("friction" in reasons) == (plant.coulomb_n > 0.0 and plant is not TOLERATED)
    assert told.accepted or plant is not TOLERATED
    assert "lost samples" not in reasons
    assert "hum" not in reasons


@pytest.mark.campaign
@pytest.mark.parametrize("softening_m", [0.1, 0.05, np.inf])
def test_the_frequency_of_a_storey_at_small_drift_lies_within_what_is_stated_at_full_level(softening_m: float) -> None:
    specimen = found(replace(STIFF_SERVO, softening_m=softening_m)).specimen
    assert specimen is not None
    at_rest_hz = float(np.sqrt(9000.0 / 7.0) / (2.0 * np.pi))
    off = abs(float(specimen.natural_frequency_hz[0]) - at_rest_hz)
    stated, linear = float(specimen.frequency_error_hz[0]), 1e-4 * at_rest_hz
    assert off < 2.0 * stated
    assert (stated < linear) == (softening_m == np.inf)
    assert (off > 10.0 * linear) == (softening_m < np.inf)
