"""A table whose excitation had to be lowered still gets a record at low level, and its verification that level."""

from __future__ import annotations

import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.experiment.identify_on_rig import Measured, evaluated, measure, probed
from rths_cli.experiment.model_files import from_groups, to_groups
from rths_cli.experiment.model_verification import compared, low_level_record
from rths_cli.experiment.real_rig_readiness import VERIFICATION
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.identification.inputs import level_ratio
from rths_cli.identification.results import Identification

QUICK = ("identification.duration_s=60", "sample_rate_hz=1000")
LIGHTLY_DAMPED = ("structure.experimental.damping_ratios=[0.0005,0.0005]", "table.limits.acceleration_m_s2=12")


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], [*QUICK, *settings])[0])


@pytest.fixture(scope="module")
def lowered() -> tuple[Setup, Measured, list[str]]:
    """Return setup, records and progress of a table whose floors' resonance lowers the excitation to about the probe's
    level."""
    setup, said = setup_of(*LIGHTLY_DAMPED), list[str]()
    return setup, measure(setup, said.append), said


@pytest.fixture(scope="module")
def found(lowered: tuple[Setup, Measured, list[str]]) -> Identification:
    setup, measured, _ = lowered
    return evaluated(setup, measured)


def played(said: list[str]) -> list[str]:
    return [text.split(" ")[0].rstrip(",") for text in said]


def test_a_lowered_excitation_is_followed_by_a_quieter_record(lowered: tuple[Setup, Measured, list[str]]) -> None:
    setup, measured, said = lowered
    assert played(said) == ["probe", "identification", "probe"]
    _, first = probed(setup, lambda _: None)
    assert level_ratio(measured.records, first) < 1.5  # with the probe alone nothing could be compared
    assert measured.quiet is not None
    assert level_ratio(measured.records, measured.quiet) == pytest.approx(5.0, rel=0.2)
    assert dict(measured.lines)["low level"].endswith("the probe was less than 1.5 times quieter")


def test_the_usual_probe_is_not_repeated() -> None:
    said = list[str]()
    measured = measure(setup_of(), said.append)
    assert played(said) == ["probe", "identification"]
    assert "low level" not in dict(measured.lines)


def dashpot(command_v: float, scale_m_s: float, rms_m_s: float) -> float:
    """Return c in V s/m of kappa tanh(v / v_s) for Gaussian v: E[force v] / E[v^2] (statistical linearisation)."""
    v = rms_m_s * np.linspace(-8.0, 8.0, 4001)
    weight = np.exp(-0.5 * (v / rms_m_s) ** 2)
    return float(command_v * np.sum(weight * np.tanh(v / scale_m_s) * v) / np.sum(weight * v**2))


@pytest.mark.campaign
def test_the_levels_of_a_lowered_excitation_show_friction(
    lowered: tuple[Setup, Measured, list[str]], found: Identification
) -> None:
    """What the smaller motion adds to friction's equivalent dashpot changes the response by c |G / s| (J. B. Roberts
    and P. D. Spanos, Random Vibration and Statistical Linearization, section 5.3)."""
    setup, measured, _ = lowered
    friction, quiet = found.friction, measured.quiet
    assert friction is not None and quiet is not None
    full = friction.velocity_rms_m_s
    low = full / level_ratio(measured.records, quiet)
    scale = setup.case.table.physics.coulomb_velocity_m_s
    added = dashpot(friction.command_v, scale, low) - dashpot(friction.command_v, scale, full)
    for band in found.levels[1:3]:
        middle = np.sqrt(band.low_hz * band.high_hz)
        expected = added * abs(found.best.response(np.array([middle]))[0]) / (2.0 * np.pi * middle)
        assert abs(band.ratio - 1.0) == pytest.approx(expected, rel=0.5)
        assert abs(band.ratio - 1.0) > 5.0 * band.error


@pytest.mark.campaign
def test_a_verification_is_played_at_the_level_with_which_it_is_compared(
    lowered: tuple[Setup, Measured, list[str]], found: Identification
) -> None:
    setup, measured, _ = lowered
    assert measured.quiet is not None and found.low_level_m_s2 is not None
    _, again = probed(setup, lambda _: None, (VERIFICATION,), most_m_s2=found.low_level_m_s2)
    noise = measured.quiet.parts.noise
    assert again.command_v[noise].std() == pytest.approx(measured.quiet.command_v[noise].std(), rel=0.01)
    said = list[str]()
    reasons, sentence = compared(setup, found, low_level_record(setup, found, said.append))
    assert reasons == ()
    assert str(sentence).startswith("verified by a low-level record")
    assert f"at {found.low_level_m_s2:.2g} m/s^2 rms" in said[0]


@pytest.mark.campaign
def test_a_model_file_keeps_the_low_level(found: Identification) -> None:
    names = ("table", "floor_2", "floor_3")
    stored = {
        group: {key: one.data for key, one in values.items()} for group, values in to_groups(found, names).items()
    }
    assert from_groups(stored, names).low_level_m_s2 == found.low_level_m_s2
