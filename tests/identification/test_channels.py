"""Faults put into channels of a linear table are named, with the right channel and no other; clean ones are not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from made_linear import DT, Linear, linear
from made_records import make_specimen
from portfolio import parametrize_first
from scipy import signal

from rths_cli.control import sensor_correction
from rths_cli.findings import sentences
from rths_cli.identification import channel_responses, channel_signals
from rths_cli.identification.channel_signals import as_sampled, cut_off_peaks, flat_tops
from rths_cli.identification.excitation import Kind
from rths_cli.identification.frequency_response import estimate
from rths_cli.identification.identify import identify
from rths_cli.identification.inputs import IdentificationSettings, evidence
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.numerics.lti import Frf

KINDS: tuple[Kind, ...] = ("noise", "multisine", "sweep", "step")
STIFFNESS = (7000.0, 7600.0, 7200.0)
SEGMENT_S = 12.0


@cache
def clean(floors: int, ratio: float = 0.04, kind: Kind = "noise") -> Linear:
    return linear(make_specimen(STIFFNESS[:floors], (ratio,) * floors), kind)


def with_accel(record: Record, accel: np.ndarray) -> Record:
    return replace(record, accel_m_s2=accel)


def faults(made: Linear, accel: np.ndarray | None = None) -> list[str]:
    record = made.record if accel is None else with_accel(made.record, accel)
    return list(sentences(channel_signals.signal_faults(record, made.info) or judged(made, record).faults))


def judged(made: Linear, record: Record) -> channel_responses.Judgement:
    data = evidence([record], None, made.info, made.specimen.masses_kg, IdentificationSettings())
    return channel_responses.judge(data, responses(record))


def responses(record: Record) -> tuple[Frf, ...]:
    return estimate([record], DT, (0.5, 60.0), SEGMENT_S)


def names(made: Linear) -> list[str]:
    return [channel.name for channel in made.info.channels]


@parametrize_first(1, "kind", KINDS)
@parametrize_first(1, ("floors", "ratio"), [(1, 0.005), (2, 0.005), (3, 0.005), (1, 0.05), (2, 0.05), (3, 0.05)])
def test_clean_records_have_no_fault(floors: int, ratio: float, kind: Kind) -> None:
    made = clean(floors, ratio, kind)
    assert faults(made) == []
    assert channel_signals.hum_warnings(channel_signals.reports([made.record], None, made.info)) == ()


@pytest.mark.parametrize(
    ("stiffness", "ratios"),
    [
        ((8100.0, 7000.0), (0.059, 0.005)),  # the second mode is the largest
        ((9500.0, 14000.0), (0.071, 0.008)),
        ((7000.0, 9000.0, 11000.0), (0.10, 0.07, 0.03)),  # modal damping that no dashpots of storeys describe
        ((14000.0, 4000.0, 9000.0), (0.09, 0.04, 0.02)),
    ],
)
def test_uneven_damping_is_no_fault(stiffness: tuple[float, ...], ratios: tuple[float, ...]) -> None:
    assert faults(linear(make_specimen(stiffness, ratios))) == []


@parametrize_first(1, "kind", KINDS)
@parametrize_first(1, "floors", [1, 2, 3])
def test_every_pair_of_swapped_channels_is_named(floors: int, kind: Kind) -> None:
    made = clean(floors, kind=kind)
    for one, other in combinations(range(floors + 1), 2):
        accel = made.record.accel_m_s2.copy()
        accel[[one, other]] = accel[[other, one]]
        found = faults(made, accel)
        assert len(found) == 1
        assert f"channels {names(made)[one]} and {names(made)[other]}: they look swapped" in str(found[0])


@pytest.mark.campaign
@parametrize_first(1, "kind", KINDS)
@parametrize_first(1, "floors", [1, 2, 3])
def test_only_the_reversed_channel_is_named(floors: int, kind: Kind) -> None:
    made = clean(floors, kind=kind)
    for index, name in enumerate(names(made)):
        accel = made.record.accel_m_s2.copy()
        accel[index] *= -1.0
        found = faults(made, accel)
        assert len(found) == 1
        # with one floor, either of two channels may be the reversed one: the command tells
        assert f"channel {name}: wrong sign" in found[0]
    assert ["command: every channel moves against it" in fault for fault in faults(made, -made.record.accel_m_s2)] == [
        True
    ]


def stated(fault: str, name: str) -> float:
    """Return what a sentence says that a channel reads."""
    return float(fault.split(f"channel {name}: reads ")[1].split()[0])


@parametrize_first(1, "factor", [0.9, 1.1])
@parametrize_first(1, "floors", [1, 2, 3])
def test_only_the_channel_of_wrong_sensitivity_is_named(floors: int, factor: float) -> None:
    made = clean(floors)
    for index, name in enumerate(names(made)[1:], 1):
        accel = made.record.accel_m_s2.copy()
        accel[index] *= factor
        found = faults(made, accel)
        assert len(found) == 1
        assert stated(found[0], name) == pytest.approx(factor, abs=0.01)
        assert "check the sensitivity" in found[0]
        # one floor and the table differ by a factor: nothing tells which of the two is wrong
        assert found[0].count("reads") == (2 if floors == 1 else 1)
        assert floors > 1 or stated(found[0], "table") == pytest.approx(1.0 / factor, abs=0.01)


@pytest.mark.campaign
@parametrize_first(1, "factor", [0.9, 1.1])
def test_table_of_wrong_sensitivity_is_named_where_all_floors_say_so(factor: float) -> None:
    made = clean(2)
    found = faults(made, made.record.accel_m_s2 * [[factor], [1.0], [1.0]])
    assert len(found) == 1
    assert stated(found[0], "table") == pytest.approx(factor, abs=0.01)


@pytest.mark.campaign
@parametrize_first(
    1,
    ("factor", "unit"),
    [(1.0 / 9.80665, "values were in g"), (9.80665, "were m/s^2 and not g"), (0.2, ""), (6.0, "")],
)
def test_a_channel_in_another_unit_is_named_with_it(factor: float, unit: str) -> None:
    made = clean(3)
    accel = 0.1 * made.record.accel_m_s2  # so that the channel stays within its sensor's range
    accel[2] *= factor
    record = replace(made.record, command_v=0.1 * made.record.command_v, accel_m_s2=accel)
    (said,) = sentences(judged(made, record).faults)
    assert stated(said, names(made)[2]) == pytest.approx(factor, rel=0.01)
    assert "check the sensitivity" in said and said.endswith(unit) and ("unit" in said) == bool(unit)


def test_lost_samples_are_counted_and_placed() -> None:
    made = clean(2)
    accel = made.record.accel_m_s2.copy()
    accel[2, 1234::20] = np.nan
    lost = len(range(1234, accel.shape[1], 20))
    (fault,) = faults(made, accel)
    assert f"channel floor_2: {lost} of {accel.shape[1]} samples (4.9" in fault
    assert "number 1234;" in fault
    command = made.record.command_v.copy()
    command[7] = np.inf
    (fault,) = sentences(channel_signals.signal_faults(replace(made.record, command_v=command), made.info))
    assert "channel command: 1 of" in fault


@pytest.mark.campaign
@pytest.mark.parametrize("kind", KINDS)
def test_dead_and_drowned_channels_are_named(kind: Kind) -> None:
    made = clean(2, kind=kind)
    noise = np.random.default_rng(1).standard_normal(made.record.accel_m_s2.shape[1])
    for index, name in enumerate(names(made)):
        for level, sentence in ((0.0, "dead"), (2e-3, "dead"), (0.5, "nothing but noise")):
            accel = made.record.accel_m_s2.copy()
            accel[index] = level * noise
            found = faults(made, accel)
            assert len(found) == 1
            assert f"channel {name}: {sentence}" in found[0]


@pytest.mark.campaign
@pytest.mark.parametrize("coherence", [0.6, 0.8])
def test_incoherent_channel_is_named_with_its_coherence(coherence: float) -> None:
    made = clean(2)
    other = linear(made.specimen, "noise", 99).record.accel_m_s2  # the same spectra, another excitation
    ratio = np.sqrt(1.0 / coherence - 1.0)
    for index, name in enumerate(names(made)):
        accel = made.record.accel_m_s2.copy()
        accel[index] += ratio * other[index]
        found = faults(made, accel)
        assert len(found) == 1
        assert f"channel {name}: median coherence" in found[0]
        seen = channel_signals.reports(
            [with_accel(made.record, accel)], responses(with_accel(made.record, accel)), made.info
        )
        assert seen[index].coherence == pytest.approx(coherence, abs=0.12)


@parametrize_first(1, "kind", KINDS)
@parametrize_first(1, "share", [0.97, 0.9, 0.7, 0.5])
def test_clipped_channel_is_named(share: float, kind: Kind) -> None:
    made = clean(2, kind=kind)
    random = np.random.default_rng(2)
    for index, name in enumerate(names(made)):
        accel = made.record.accel_m_s2.copy()
        top = share * np.abs(accel[index]).max()
        accel[index] = accel[index].clip(-top, top) + 3e-4 * random.standard_normal(accel.shape[1])
        found = faults(made, accel)
        assert len(found) == 1
        assert f"channel {name}: clipped" in found[0]


@parametrize_first(1, "kind", KINDS)
@parametrize_first(1, "share", [1.0, 0.97, 0.9, 0.7, 0.5])
def test_clipping_is_seen_through_the_correction_of_the_sensor(share: float, kind: Kind) -> None:
    """The sensor's AC coupling acts before the converter's limit, its correction after it."""
    made = clean(2, kind=kind)
    sensor = made.info.channels[1]
    coupling = signal.butter(1, sensor.high_pass_hz, "high", fs=1.0 / DT)
    block = sensor_correction.correction((sensor,), DT)
    inverse = signal.ss2tf(block.A, block.B, block.C, block.D)
    for accel in made.record.accel_m_s2:
        sensed = signal.lfilter(*coupling, accel)
        sensed = sensed.clip(-share * np.abs(sensed).max(), share * np.abs(sensed).max())
        bits = np.round(sensed / 3e-3) * 3e-3 + 1e-3  # and the converter has an offset
        corrected = signal.lfilter(inverse[0][0], inverse[1], bits / 9.80665)
        assert (cut_off_peaks(corrected, sensor, DT, 1e-3) > 0) == (share < 1.0)


def test_corners_put_back_are_the_inverse_of_their_correction() -> None:
    sensor = clean(2).info.channels[0]
    block = sensor_correction.correction((sensor,), DT)
    raw = np.random.default_rng(3).standard_normal(4000)
    raw[0] = 0.0
    corrected = signal.dlsim((block.A, block.B, block.C, block.D, DT), raw)[1][:, 0]
    assert as_sampled(corrected, sensor, DT) == pytest.approx(raw / sensor.sensitivity_v_per_unit, abs=1e-9)


def test_a_short_peak_may_have_one_sample_in_two_at_its_top() -> None:
    """Noise of 0.1 % lifts a sample of a peak of seven to it; one that is cut off has them all there."""
    peak = np.array([0.0, 0.5, 0.955, 0.975, 0.9943, 1.0, 0.997, 0.9945, 0.96, 0.5, 0.0])
    assert flat_tops(peak, rest_rms_m_s2=1e-3) == 0
    assert flat_tops(peak.clip(None, 0.965), rest_rms_m_s2=1e-3) == 1


def test_flat_tops_counts_the_peaks_of_a_sine() -> None:
    sine = np.sin(2.0 * np.pi * 3.0 * np.arange(0.0, 4.0, DT))
    assert flat_tops(sine) == 0
    assert flat_tops(sine.clip(-0.9, 0.9)) == 24
    assert flat_tops(sine.clip(-2.0, 0.9)) == 12


def test_channel_at_its_range_is_clipped() -> None:
    made = clean(1)
    accel = made.record.accel_m_s2.copy()
    accel[1, 40000] = 0.985 * made.info.channels[1].range
    (fault,) = faults(made, accel)
    assert "channel floor_1: clipped" in fault
    assert "sensor's range" in fault


def test_a_channel_far_beyond_its_range_has_a_wrong_unit() -> None:
    made = clean(1)
    accel = made.record.accel_m_s2.copy()
    accel[1] *= 1000.0
    (fault,) = faults(made, accel)
    assert "channel floor_1: reads " in fault and "check the channel's unit" in fault


@pytest.mark.campaign
@pytest.mark.parametrize("hz", [50.0, 60.0, 150.0])
@pytest.mark.parametrize("kind", KINDS)
def test_hum_is_found_in_silence_with_its_amplitude(kind: Kind, hz: float) -> None:
    made = clean(2, kind=kind)
    time = np.arange(made.record.accel_m_s2.shape[1]) * DT
    for index, size in ((0, 0.02), (1, 0.05), (2, 0.3)):
        accel = made.record.accel_m_s2.copy()
        accel[index] += size * np.sin(2.0 * np.pi * hz * time + 0.4)
        seen = channel_signals.reports([with_accel(made.record, accel)], None, made.info)
        assert [c.hum_hz for c in seen] == [hz if c is seen[index] else 0.0 for c in seen]
        assert seen[index].hum_m_s2 == pytest.approx(size, rel=0.2)
        (warning,) = sentences(channel_signals.hum_warnings(seen))
        assert f"channel {names(made)[index]}: {hz:g} Hz hum" in warning


@pytest.mark.parametrize("kind", ["noise", "sweep", "step"])
def test_hum_without_silence(kind: Kind) -> None:
    """The excitation ends at 60 Hz: one side of that line is loud, which is no hum."""
    made = clean(2, kind=kind)
    bare = replace(made.record, parts=replace(made.record.parts, silence=None))
    assert channel_signals.hum_warnings(channel_signals.reports([bare], None, made.info)) == ()
    time = np.arange(bare.accel_m_s2.shape[1]) * DT
    accel = bare.accel_m_s2 + np.array([[0.0], [0.1], [0.0]]) * np.sin(2.0 * np.pi * 50.0 * time)
    seen = channel_signals.reports([with_accel(bare, accel)], None, made.info)
    assert [c.hum_hz for c in seen] == [0.0, 50.0, 0.0]
    assert seen[1].hum_m_s2 == pytest.approx(0.1, rel=0.2)


def test_lines_of_a_multisine_at_the_mains_frequency_are_no_hum() -> None:
    made = clean(2, kind="multisine")
    bare = replace(made.record, parts=replace(made.record.parts, silence=None))
    assert channel_signals.hum_warnings(channel_signals.reports([bare], None, made.info)) == ()


def test_report_states_levels() -> None:
    n = 40000
    random = np.random.default_rng(4)
    accel = np.vstack([0.01 * random.standard_normal(n), 0.02 * random.standard_normal(n)])
    accel[:, 10000:] += np.array([[2.0], [3.0]]) * np.sin(2.0 * np.pi * 3.0 * np.arange(30000) * DT)
    record = Record(np.zeros(n), accel, Parts(slice(10000, n), slice(0, 10000)))
    seen = channel_signals.reports([record], None, clean(1).info)
    assert [c.rms_m_s2 for c in seen] == pytest.approx([2.0 / np.sqrt(2.0), 3.0 / np.sqrt(2.0)], rel=1e-3)
    assert [c.largest_m_s2 for c in seen] == pytest.approx([2.0, 3.0], rel=0.05)
    assert [c.rest_rms_m_s2 for c in seen] == pytest.approx([0.01, 0.02], rel=0.05)
    assert np.all(np.isnan([c.coherence for c in seen]))


@pytest.mark.parametrize(("factor", "warned"), [(1.5, True), (0.65, True), (1.08, False), (-1.5, True), (-1.0, False)])
def test_gain_far_from_the_data_sheet_is_a_warning(factor: float, warned: bool) -> None:
    info = clean(1).info
    found = channel_responses.gain_warnings(factor * info.gain_m_per_v, 1e-3, info)
    assert len(found) == warned
    if warned:
        assert f"moves {abs(factor) * 7.9:.3g} mm/V" in str(found[0])


def moving(factor: float) -> Frf:
    """Return the response of a table that moves so many times what the data sheet says."""
    f = np.arange(0.5, 20.0, 0.1)
    response = -((2.0 * np.pi * f) ** 2) * factor * clean(1).info.gain_m_per_v + 0j
    return Frf(f, response, np.ones(len(f)), np.full(len(f), 1e-3), 20)


@pytest.mark.parametrize(("factor", "refused"), [(9.81, True), (0.5, True), (2.0, True), (1.5, False), (0.7, False)])
def test_gain_nowhere_near_the_data_sheet_is_a_reason(factor: float, refused: bool) -> None:
    info = clean(1).info
    found = channel_responses.far_gain(factor * info.gain_m_per_v, info, moving(factor))
    assert len(found) == refused
    assert bool(channel_responses.gain_warnings(factor * info.gain_m_per_v, 1e-3, info)) != refused


@pytest.mark.parametrize(("moved", "refused"), [(1.0, False), (9.81, True)])
def test_gain_of_a_model_counts_only_where_the_table_shows_it(moved: float, refused: bool) -> None:
    info = clean(1).info
    assert len(channel_responses.far_gain(7e-4 * info.gain_m_per_v, info, moving(moved))) == refused


@pytest.mark.campaign
def test_command_and_table_exchanged_are_named() -> None:
    made = clean(2)
    record = replace(
        made.record, command_v=made.record.accel_m_s2[0],
        accel_m_s2=np.vstack([made.record.command_v, made.record.accel_m_s2[1:]]),
    )  # fmt: skip
    found = judged(made, record).faults
    assert len(found) == 1
    assert "command and table: they look swapped" in str(found[0])


def test_table_of_half_again_the_nominal_gain_is_identified_with_a_warning() -> None:
    made = clean(1)
    info = replace(made.info, gain_m_per_v=made.info.gain_m_per_v / 1.5)
    found = identify([made.record], info, made.specimen.masses_kg)
    assert found.accepted
    assert len(found.warnings) == 1
    assert "the data sheet says 5.27" in found.warnings[0]


@pytest.mark.campaign
def test_swapped_floors_that_nearly_fit_a_chain_are_named() -> None:
    """As they are, 18 % of the inertia is unexplained, less than some specimens of wrong masses leave."""
    made = linear(make_specimen((13000.0, 3600.0, 12900.0), (0.04, 0.02, 0.03)))
    assert faults(made) == []
    (fault,) = faults(made, made.record.accel_m_s2[[0, 1, 3, 2]])
    assert "channels floor_2 and floor_3: they look swapped" in fault


@parametrize_first(1, ("floors", "ratio"), [(2, 0.04), (3, 0.005)])
def test_sweep_in_short_segments_is_no_incoherent_channel(floors: int, ratio: float) -> None:
    made = clean(floors, ratio, "sweep")
    found = identify([made.record], made.info, made.specimen.masses_kg)
    assert found.accepted
    assert all(channel.coherence > 0.95 for channel in found.channels)
    assert found.specimen is not None
    assert found.specimen.damping_ratio == pytest.approx([ratio] * floors, rel=0.01)
