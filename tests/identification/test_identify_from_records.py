"""Identification of the virtual rig from its channels alone, against a second record and the equations of motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_linear import linear
from made_records import PHYSICS, Excited, excite, make_info, make_specimen, true_response
from portfolio import parametrize_first

from rths_cli.errors import InputError
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.excitation import Kind
from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.identify import IdentificationSettings, identify
from rths_cli.identification.identify_specimen import first_look, without_staircase
from rths_cli.identification.identify_table import fit_table
from rths_cli.identification.inputs import evidence
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.identification.results import FitError, Identification
from rths_cli.identification.specimen_fit import Start
from rths_cli.identification.table_fit import fit_error
from rths_cli.numerics.lti import Frf
from rths_cli.rigs.virtual.plant import continuous


def identified(record: Excited, settings: IdentificationSettings | None = None) -> Identification:
    return identify([record.record], record.info, record.specimen.masses_kg, settings)


def spoilt(record: Excited, accel: np.ndarray) -> Record:
    return Record(record.command_v, accel, record.plan.parts)


@pytest.fixture(scope="module")
def first() -> Excited:
    return excite(make_specimen(), 1)


@pytest.mark.campaign
@pytest.mark.parametrize(("stiffer", "more_damped"), [(1.3, 30.0), (0.7, 5.0), (1.0, 0.1)])
def test_a_first_look_that_went_astray_is_corrected(first: Excited, stiffer: float, more_damped: float) -> None:
    """Model and specimen improve in turns: what the table's zeros are held at does not depend on where it began."""
    data = evidence([first.record], None, first.info, first.specimen.masses_kg, IdentificationSettings())
    frf = estimate([first.record], first.info.dt_s, data.settings.band_hz, data.settings.segment_s)[0]
    start = first_look(data)
    astray = Start(start.stiffness_n_per_m * stiffer, start.damping_ratio * [1.0, more_damped])
    expected, found = (fit_table(data, frf, each).chosen.model for each in (start, astray))
    f = np.linspace(0.7, 40.0, 200)
    assert np.abs(found.response(f) / expected.response(f) - 1.0).max() < 1e-4


@pytest.fixture(scope="module")
def second_frf() -> Frf:
    """Return the table's FRF of a longer record with another seed, as Welch's method gives it."""
    record = excite(make_specimen(), 11, 200.0)
    return estimate([record.record], record.info.dt_s, (0.5, 60.0), 40.0)[0]


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
    for channel in found.channels:
        assert channel.rest_rms_m_s2 is not None
        assert channel.rest_rms_m_s2 < bit


def test_staircase_is_taken_out_of_the_table_only(first: Excited) -> None:
    model = replace(identified(first).best, ripple_m_s2_per_v=2.0, coupling_hz=0.0)
    command = np.array([7.0, 8.0, 8.0, 11.0, 11.0, 11.0])
    left = without_staircase(np.zeros(6), command, model)
    assert left == pytest.approx([0.0, 0.0, -2.0, 0.0, -6.0, 0.0])
    coupled = replace(model, coupling_hz=40.0)
    integral = np.cumsum(left) - 0.5 * left  # by the trapezoidal rule, over dt
    wanted = left + 2.0 * np.pi * 40.0 * model.dt_s * integral
    assert without_staircase(np.zeros(6), command, coupled) == pytest.approx(wanted)


@pytest.mark.campaign
def test_a_table_without_friction_is_found_to_half_a_thousandth_at_1_khz() -> None:
    """Its smooth response, hold included, from samples with alias and AC coupling: 0.4 % off at 0.7 Hz where the
    alias's integral is left in them."""
    specimen, dt_s = make_specimen(), 1e-3
    record = excite(specimen, 5, info=make_info(specimen, bits=0, dt_s=dt_s), coulomb_n=0.0, noise_m_s2=0.0)
    found = identified(record)
    f = found.frfs[0].frequency_hz
    judged = (f >= 0.7) & (f <= 11.0)
    wanted = (true_response(specimen, f, 1.5 * dt_s) * np.sinc(f * dt_s))[judged]
    measured = (found.frfs[0].response - found.best.alias(f))[judged]
    assert np.abs(measured / wanted - 1.0).max() < 3e-4
    assert np.abs(found.best.response(f[judged]) / wanted - 1.0).max() < 6e-4
    assert found.best.coupling_hz == 0.024
    kept = identified(record, IdentificationSettings(sensors_removed=False))
    assert kept.best.coupling_hz == 0.0


@pytest.mark.campaign
@parametrize_first(
    1,
    "stiffness, ratios, seed",
    [
        ((900.0, 600.0, 500.0), (0.0023, 0.0024, 0.0048), 0),  # the raw response shows the first pole without damping
        ((900.0, 600.0, 500.0), (0.0023, 0.0024, 0.0048), 2),  # one line lies beyond 3 %, but not beyond its scatter
        ((1500.0, 900.0), (0.0023, 0.003), 1),
    ],
)
def test_resonances_narrower_than_the_lines_are_identified(
    stiffness: tuple[float, ...], ratios: tuple[float, ...], seed: int
) -> None:
    """Modes of 0.7-1.3 Hz ring for minutes in 20 s segments; the oracle is the plant's own equations of motion."""
    specimen = make_specimen(stiffness, ratios)
    found = identified(excite(specimen, seed, 120.0, make_info(specimen, dt_s=2e-3, latency_samples=7)))
    assert found.accepted, found.reasons
    pairs = [
        roots[roots.imag > 0.0] for roots in (np.linalg.eigvals(continuous(PHYSICS, specimen)[0]), found.best.poles)
    ]
    true, model = (roots[np.argsort(np.abs(roots))][: len(ratios)] for roots in pairs)
    assert np.abs(model) == pytest.approx(np.abs(true), rel=1e-3)
    assert -model.real / np.abs(model) == pytest.approx(-true.real / np.abs(true), rel=0.03)


def test_record_without_silence_and_hold(first: Excited) -> None:
    noise = first.plan.parts.noise
    record = Record(first.command_v[noise], first.corrected[:, noise], Parts(slice(0, noise.stop - noise.start)))
    found = identify([record], first.info, first.specimen.masses_kg)
    assert found.accepted
    assert found.free_vibration is None
    assert found.channels[0].rest_rms_m_s2 is None
    assert found.noise_floors == (None, None, None)


def test_fit_that_misses_its_limits_is_kept_but_not_accepted(first: Excited) -> None:
    settings = IdentificationSettings(most=FitError(rms=1e-6, largest=0.03, rms_mid=0.004))
    found = identified(first, settings)
    assert not found.accepted
    assert len(found.reasons) == 1
    assert "rms in 0.7-11 Hz" in found.reasons[0]


def with_fault(first: Excited, change: str) -> np.ndarray:
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
    elif change == "cut off":
        corrected[1] = corrected[1].clip(-6.0, 6.0)
    elif change == "reversed":
        corrected[1] *= -1.0
    elif change == "swapped":
        corrected[[1, 2]] = corrected[[2, 1]]
    elif change == "on the table":
        corrected[[0, 2]] = corrected[[2, 0]]
    elif change == "sensitive":
        corrected[1] *= 1.1
    else:
        corrected[1, random.random(corrected.shape[1]) < 0.05] = np.nan
    return corrected


@parametrize_first(
    3,
    ("change", "sentence"),
    [
        ("dead", "channel floor_1: dead"),
        ("noisy", "channel floor_1: nothing but noise"),
        ("clipped", "channel floor_1: clipped"),
        ("incoherent", "channel floor_1: median coherence"),
        ("cut off", "channel floor_1: clipped"),
        ("reversed", "channel floor_1: wrong sign"),
        ("swapped", "channels floor_1 and floor_2: they look swapped"),
        ("on the table", "channels table and floor_2: they look swapped"),
        ("sensitive", "channel floor_1: reads 1.1"),
        ("lost", "are missing"),
    ],
)
def test_faulty_channel_is_named(first: Excited, change: str, sentence: str) -> None:
    with pytest.raises(UnfitRecord) as caught:
        identify([spoilt(first, with_fault(first, change))], first.info, first.specimen.masses_kg)
    assert len(caught.value.channels) == 3
    assert len(caught.value.faults) == 1
    assert sentence in caught.value.faults[0]


def test_record_of_the_wrong_shape_is_refused(first: Excited) -> None:
    with pytest.raises(InputError) as caught:
        identify([Record(first.command_v[:-1], first.corrected, first.plan.parts)], first.info, np.array([6.9]))
    assert len(caught.value.faults) == 2


@pytest.mark.campaign
def test_several_records_lower_the_errors(first: Excited) -> None:
    records = [first.record, excite(make_specimen(), 2).record, excite(make_specimen(), 3).record]
    one, three = (identify(records[:k], first.info, first.specimen.masses_kg) for k in (1, 3))
    assert three.accepted
    assert abs(three.frfs[0].averages - 3 * one.frfs[0].averages) <= 1
    errors = [float(np.median(found.frfs[1].relative_error)) for found in (one, three)]
    assert errors[1] == pytest.approx(errors[0] / np.sqrt(3.0), rel=0.15)
    f = np.linspace(0.7, 11.0, 300)
    assert np.abs(three.best.response(f) / true_response(first.specimen, f) - 1.0).max() < 0.002
    assert three.specimen is not None
    assert three.specimen.natural_frequency_hz == pytest.approx([3.2, 8.4], rel=0.0005)


@pytest.mark.campaign
def test_linear_table_answers_alike_at_both_levels() -> None:
    loud, other = linear(make_specimen(), seed=3), linear(make_specimen(), seed=4)
    quiet = replace(other.record, command_v=0.25 * other.record.command_v, accel_m_s2=0.25 * other.record.accel_m_s2)
    found = identify([loud.record], loud.info, loud.specimen.masses_kg, quiet=quiet)
    assert found.accepted
    assert [band.low_hz for band in found.levels] == [0.7, 2.0, 5.0, 11.0, 20.0, 40.0]
    assert all(abs(band.ratio - 1.0) < 5.0 * band.error + 1e-4 for band in found.levels)


@pytest.mark.campaign
def test_weaker_answer_at_low_level_is_measured_and_rejected() -> None:
    loud, other = linear(make_specimen(), seed=3), linear(make_specimen(), seed=4)
    weak = 0.25 * np.array([[0.94], [1.0], [1.0]]) * other.record.accel_m_s2
    quiet = replace(other.record, command_v=0.25 * other.record.command_v, accel_m_s2=weak)
    found = identify([loud.record], loud.info, loud.specimen.masses_kg, quiet=quiet)
    assert [band.ratio.real for band in found.levels] == pytest.approx([0.94] * 6, abs=0.002)
    assert not found.accepted
    assert found.causes.table == ("dead band",)  # friction would change the phase as well
    assert any("level: at 1/4" in reason and "dead band" in reason for reason in found.reasons)


@pytest.mark.campaign
@parametrize_first(1, "kind", ["multisine", "sweep", "step"])
def test_linear_table_is_identified_under_every_excitation(kind: Kind) -> None:
    made = linear(make_specimen((7000.0, 7600.0, 7200.0), (0.03, 0.01, 0.05)), kind)
    found = identify([made.record], made.info, made.specimen.masses_kg)
    assert found.accepted
    assert found.warnings == ()
    f = np.linspace(0.7, 30.0, 500)
    assert np.abs(found.best.response(f) / true_response(made.specimen, f) - 1.0).max() < 0.002
    assert found.specimen is not None
    assert found.specimen.damping_ratio == pytest.approx([0.03, 0.01, 0.05], rel=0.005)


@parametrize_first(1, "factors", [(1.0, 1.0), (0.95, 1.0), (0.9, 1.0), (1.1, 0.9), (0.9, 1.1)])
def test_masses_wrong_by_a_tenth_do_the_table_s_model_no_harm(factors: tuple[float, float]) -> None:
    made = linear(make_specimen())
    found = identify([made.record], made.info, made.specimen.masses_kg * factors)
    assert found.accepted
    f = np.linspace(0.7, 30.0, 500)
    assert np.abs(found.best.response(f) / true_response(made.specimen, f) - 1.0).max() < 0.003
