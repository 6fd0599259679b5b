"""Joints that stick and slide in the specimen are no fault of the channels, and faults of the channels no joints."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from rths_cli.case.load import load_cases
from rths_cli.errors import RigError
from rths_cli.experiment.identify_on_rig import Measured, evaluated, measure
from rths_cli.experiment.setup import Setup, make_setup

RUBBING = "table.imperfections.specimen.joint_friction_n={}"


@cache
def recorded(joint_n: float) -> tuple[Setup, Measured]:
    settings = ("identification.duration_s=60", "sample_rate_hz=1000", RUBBING.format(joint_n))
    setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])
    return setup, measure(setup, lambda _: None)


def with_gains(measured: Measured, *gains: float) -> Measured:
    """Return measurements of sensors that read so many times the truth."""

    def of(record):
        return replace(record, accel_m_s2=record.accel_m_s2 * [[gain] for gain in gains])

    assert measured.quiet is not None
    return replace(measured, records=tuple(of(record) for record in measured.records), quiet=of(measured.quiet))


@pytest.mark.campaign
def test_a_specimen_whose_joints_rub_is_identified_with_a_warning() -> None:
    found = evaluated(*recorded(0.5))
    assert found.accepted
    assert any("if joints stick and slide in it" in warning for warning in found.warnings)
    assert found.specimen is not None
    hz, error = found.specimen.natural_frequency_hz, found.specimen.frequency_error_hz
    assert abs(hz - [3.2, 8.4]) == pytest.approx([0.0, 0.0], abs=2.0 * float(error.max()))


@pytest.mark.campaign
@pytest.mark.parametrize("joint_n", [0.0, 0.5])
def test_wrong_sensors_are_not_taken_for_joints(joint_n: float) -> None:
    setup, measured = recorded(joint_n)
    with pytest.raises(RigError, match=r"floor|channel|table"):
        evaluated(setup, with_gains(measured, 1.0, 1.15, 0.85))
