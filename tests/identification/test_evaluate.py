"""Identification of the virtual rig from its channels alone, against a second record and the equations of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_records import Excited, excite, make_specimen, true_response

from rths_cli.errors import InputError
from rths_cli.identification.evaluate import (
    Identification,
    IdentificationSettings,
    identify,
    without_staircase,
)
from rths_cli.identification.fit_table import FitError, fit_error
from rths_cli.identification.frf import estimate
from rths_cli.identification.record import Parts
from rths_cli.lti import Frf


def identified(record: Excited) -> Identification:
    return identify(record.command_v, record.corrected, record.info, record.specimen.masses_kg, record.plan.parts)


@pytest.fixture(scope="module")
def first() -> Excited:
    return excite(make_specimen(), 1)


@pytest.fixture(scope="module")
def second_frf() -> Frf:
    """Return the table's FRF of a longer record with another seed, as Welch's method gives it."""
    record = excite(make_specimen(), 11, 200.0)
    noise = record.plan.parts.noise
    return estimate(record.command_v[noise], record.corrected[:, noise], record.info.dt_s, (0.5, 60.0), 40.0)[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_default_rig_meets_its_demands(seed: int, first: Excited, second_frf: Frf) -> None:
    found = identified(first if seed == 1 else excite(make_specimen(), seed))
    assert found.accepted
    assert found.warnings == ()
    for model, mid in ((found.best, 0.004), (found.paper, 0.004)):
        error = fit_error(model, second_frf)
        assert error.rms < 0.01
        assert error.largest < 0.03
        assert error.rms_mid < mid
        assert model.poles.real.max() < 0.0
        assert model.zeros[2:].real.max() < 0.0
        assert np.all(model.zeros[:2] == 0.0)
    for specimen in (found.specimen, found.free_vibration):
        assert specimen is not None
        assert specimen.natural_frequency_hz == pytest.approx([3.2, 8.4], rel=0.001)
        assert specimen.damping_ratio == pytest.approx([0.043, 0.039], rel=0.03)


def test_smooth_motion_is_the_linear_table(first: Excited) -> None:
    found = identified(first)
    f = np.linspace(0.5, 60.0, 1000)
    error = found.best.response(f) / true_response(first.specimen, f) - 1.0
    inside = (f >= 1.0) & (f <= 12.0)
    assert np.abs(error[inside]).max() < 0.002
    assert np.abs(error[f <= 40.0]).max() < 0.01


def test_light_specimen() -> None:
    record = excite(make_specimen(ratios=(0.005, 0.005)), 4)
    found = identified(record)
    assert found.accepted
    assert found.specimen is not None
    assert found.free_vibration is not None
    assert found.specimen.natural_frequency_hz == pytest.approx([3.2, 8.4], rel=0.0005)
    assert found.specimen.damping_ratio == pytest.approx([0.005, 0.005], rel=0.01)
    assert found.free_vibration.damping_ratio == pytest.approx([0.005, 0.005], rel=0.03)


def test_noise_floor_is_that_of_the_silence(first: Excited) -> None:
    found = identified(first)
    bit = 20.0 / 65536 * 9.80665
    assert found.noise_rms_m_s2 is not None
    assert np.all(found.noise_rms_m_s2 < bit)


def test_staircase_is_taken_out_of_the_table_only(first: Excited) -> None:
    model = replace(identified(first).best, ripple_m_s2_per_v=2.0)
    left = without_staircase(np.zeros(6), np.array([0.0, 1.0, 1.0, 4.0, 4.0, 4.0]), model)
    assert left == pytest.approx([0.0, 0.0, -2.0, 0.0, -6.0, 0.0])


def test_record_without_silence_and_hold(first: Excited) -> None:
    noise = first.plan.parts.noise
    parts = Parts(slice(0, noise.stop - noise.start))
    found = identify(first.command_v[noise], first.corrected[:, noise], first.info, first.specimen.masses_kg, parts)
    assert found.accepted
    assert found.free_vibration is None
    assert found.noise_rms_m_s2 is None


def test_fit_that_misses_its_limits_is_kept_but_not_accepted(first: Excited) -> None:
    settings = IdentificationSettings(most=FitError(rms=1e-6, largest=0.03, rms_mid=0.004))
    found = identify(first.command_v, first.corrected, first.info, first.specimen.masses_kg, first.plan.parts, settings)
    assert not found.accepted
    assert len(found.reasons) == 1
    assert "rms in 0.7-11 Hz" in found.reasons[0]


def spoilt(first: Excited, change: str) -> np.ndarray:
    """Return the channels with one fault in the second."""
    corrected = first.corrected.copy()
    random = np.random.default_rng(0)
    if change == "dead":
        corrected[1] = 1e-3 * random.standard_normal(corrected.shape[1])
    elif change == "noisy":
        corrected[1] = 2.0 * random.standard_normal(corrected.shape[1])
    elif change == "clipped":
        corrected[1, 50000] = 49.0
    elif change == "incoherent":
        corrected[1] = 3.0 * random.standard_normal(corrected.shape[1])
        corrected[1, first.plan.parts.silence] = 0.0
    else:
        corrected[1, 50000] = np.nan
    return corrected


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("dead", "channel floor_1: dead"),
        ("noisy", "channel floor_1: nothing but noise"),
        ("clipped", "channel floor_1: clipped"),
        ("incoherent", "channel floor_1: median coherence"),
        ("lost", "not numbers"),
    ],
)
def test_faulty_channel_is_named(first: Excited, change: str, sentence: str) -> None:
    with pytest.raises(InputError) as caught:
        identify(first.command_v, spoilt(first, change), first.info, first.specimen.masses_kg, first.plan.parts)
    assert len(caught.value.faults) == 1
    assert sentence in caught.value.faults[0]


def test_record_of_the_wrong_shape_is_refused(first: Excited) -> None:
    with pytest.raises(InputError) as caught:
        identify(first.command_v[:-1], first.corrected, first.info, np.array([6.9]), first.plan.parts)
    assert len(caught.value.faults) == 2
