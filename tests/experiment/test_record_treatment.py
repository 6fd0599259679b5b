"""What a case removes from a record: the motion that is left is the one that was there.

Oracles: records made of known parts; a sine below and one within a band; closed forms of velocity.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lsim, sosfiltfilt
from test_record_baseline import DT_S, LENGTH_S, PEAK_M_S2, TIME_S, case_of, load_case, motion, refusal_of, setup_of

from rths_cli.analysis.intensity import integrate
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.case.record_schema import RecordSpec, ScaleToSpec
from rths_cli.case.shipped_files import shipped
from rths_cli.errors import InputError
from rths_cli.experiment.ground_motion import end_steps
from rths_cli.experiment.provenance import attributes
from rths_cli.experiment.record_scaling import scaled_to
from rths_cli.experiment.record_treatment import treated
from rths_cli.experiment.setup import Setup, make_setup, motion_key
from rths_cli.files.accelerograms import Accelerogram, read_accelerogram
from rths_cli.numerics.lti import Array

DEFECTS: dict[str, tuple[Array, str, str]] = {  # what is added, what is told of it, what mends it
    "mean": (np.full(TIME_S.size, 0.3), "first sample 0.3 m/s^2, mean 0.3", "mean"),
    "drift": (0.4 * TIME_S / LENGTH_S, "first sample 0 m/s^2, mean 0.1999, drift 0.3998 over", "linear"),
    "start": (np.where(TIME_S < 1.5, 0.2, 0.0), "steps by -0.2 m/s^2 at 1.5 s", "step"),
    "end": (np.where(TIME_S > 21.495, -0.25, 0.0), "steps by -0.25 m/s^2 at 21.5 s", "step"),
}  # fmt: skip


def record(accel: Array, dt_s: float = DT_S) -> Accelerogram:
    return Accelerogram(dt_s, accel, "", "", "m/s^2", "", "")


def asked(**keys: Any) -> RecordSpec:
    return RecordSpec.model_validate({"file": Path("own.csv"), **keys})


def in_test_band(setup: Setup) -> Array:
    sos = butter(2, [0.25, 11.0], "bandpass", fs=1.0 / setup.motion.dt_s, output="sos")
    return np.asarray(sosfiltfilt(sos, setup.motion.displacement_m))


@pytest.mark.campaign
@pytest.mark.parametrize("defect", DEFECTS)
def test_a_defect_is_named_with_its_figure_and_its_key_mends_it(tmp_path: Path, defect: str) -> None:
    added, told, key = DEFECTS[defect]
    record_of = motion() + added
    kept = setup_of(tmp_path, record_of, baseline="none")
    assert told in str(kept.baseline) and f"baseline: {key}}}" in str(kept.baseline)
    mended, clean = setup_of(tmp_path, record_of, baseline=key), setup_of(tmp_path, motion())
    assert mended.baseline is None
    worst = np.abs(in_test_band(mended) - in_test_band(clean)).max()
    assert worst <= 0.02 * np.abs(in_test_band(clean)).max()


@pytest.mark.parametrize("seed", range(20))
def test_no_step_is_found_at_the_ends_of_clean_records(seed: int) -> None:
    assert end_steps(motion(seed)) == []
    cut = motion(seed)[700:1500]  # begins and ends within its motion
    assert end_steps(cut) == []


def test_a_step_at_the_start_is_found_beside_stronger_jumps_of_the_motion() -> None:
    noise = np.random.default_rng(3).normal(size=TIME_S.size) * np.exp(-(((TIME_S - 4.0) / 1.0) ** 2))
    noise[TIME_S < 2.0] = 0.0
    assert np.sort(np.abs(np.diff(noise[: noise.size // 4])))[-16] > 0.25
    assert end_steps(noise + np.where(TIME_S < 1.5, 0.25, 0.0)) == [(pytest.approx(0.25), 0, 150)]
    assert end_steps(noise) == []


def test_a_word_is_short_for_what_it_removes(tmp_path: Path) -> None:
    short = load_case(case_of(tmp_path, motion(), baseline="linear")).record
    assert short == load_case(case_of(tmp_path, motion(), baseline={"remove": "linear"})).record
    assert load_case(case_of(tmp_path, motion()), ["record.baseline.remove=linear"]).record == short


def test_a_polynomial_of_its_order_is_removed_whole() -> None:
    place = TIME_S / LENGTH_S
    bent = motion() + 0.3 - 0.8 * place + 0.9 * place**3
    left, told = treated(record(bent), asked(baseline={"remove": "polynomial", "order": 3}))
    alone, _ = treated(record(motion()), asked(baseline={"remove": "polynomial", "order": 3}))
    assert left.accel_m_s2 == pytest.approx(alone.accel_m_s2, abs=1e-12)
    assert told == ("polynomial of order 3 removed",)


def test_a_taper_begins_and_ends_at_zero_and_leaves_the_middle() -> None:
    left, _ = treated(record(np.ones(1001)), asked(baseline={"remove": "none", "taper_s": 2.0}))
    accel = left.accel_m_s2
    assert (accel[0], accel[-1], accel[100], accel[50]) == pytest.approx((0.0, 0.0, 0.5, 0.5 * (1 - np.sqrt(0.5))))
    assert (accel[200:801] == 1.0).all()


def test_the_velocity_ends_at_zero_by_a_smooth_motion() -> None:
    pulse = np.where(TIME_S < 2.0, np.sin(np.pi * TIME_S / 2.0), 0.0)
    left, told = treated(record(pulse), asked(baseline={"remove": "none", "zero_velocity": True}))
    assert integrate(left.accel_m_s2, DT_S)[0][-1] == pytest.approx(0.0, abs=1e-12)
    assert told == ("final velocity of 1.273 m/s removed",)  # 4 / pi
    assert (left.accel_m_s2[0], left.accel_m_s2[-1]) == pytest.approx((0.0, 0.0), abs=1e-12)
    removed = pulse - left.accel_m_s2
    assert removed.max() == pytest.approx(2.0 * 4.0 / np.pi / (TIME_S[-1]), rel=1e-3)


def test_a_band_keeps_what_is_within_it_at_its_instant() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    within, below, above = np.sin(2 * np.pi * 2.0 * t), np.sin(2 * np.pi * 0.02 * t), np.sin(2 * np.pi * 45.0 * t)
    window = np.exp(-(((t - 30.0) / 8.0) ** 2))
    left, told = treated(record(window * (within + below + above)), asked(band_hz=(0.2, 20.0)))
    assert left.accel_m_s2 == pytest.approx(window * within, abs=0.02)
    assert told == ("filtered to 0.2 to 20 Hz",)


@pytest.mark.parametrize("edge_hz", [0.2, 20.0])
def test_a_band_halves_what_lies_at_its_ends(edge_hz: float) -> None:
    """A Butterworth filter passes 1 / sqrt(2) at its corner; forwards and backwards, a half."""
    t = np.arange(0.0, 200.0, 0.01)
    left, _ = treated(record(np.sin(2 * np.pi * edge_hz * t)), asked(band_hz=(0.2, 20.0)))
    assert np.sqrt(2.0) * left.accel_m_s2[8000:12000].std() == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("rate_hz", [40.0, 250.0])
def test_another_rate_keeps_the_motion(rate_hz: float) -> None:
    def at(t: Array) -> Array:
        return np.asarray(np.sin(2 * np.pi * 3.0 * t) * np.exp(-(((t - 10.0) / 2.0) ** 2)))

    left, told = treated(record(at(np.arange(0.0, 20.0, 0.01))), asked(resample_hz=rate_hz))
    assert left.dt_s == pytest.approx(1.0 / rate_hz)
    assert left.accel_m_s2 == pytest.approx(at(np.arange(left.accel_m_s2.size) / rate_hz), abs=2e-3)
    assert told == (f"resampled to {rate_hz:g} Hz",)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"baseline": {"remove": "none", "taper_s": 12.1}},
            "record.baseline.taper_s: 12.1 s must be at least a sample",
        ),
        ({"band_hz": [0.1, 50.0]}, "record.band_hz: 50 Hz is not below half of the record's rate, 50 Hz"),
        ({"resample_hz": 99.99937}, "record.resample_hz: 99.9994 Hz is no simple ratio to the record's 100 Hz"),
        (
            {"baseline": "step"},
            "record.baseline: step: neither the start nor the end of this record is quiet and steps",
        ),
    ],
)
def test_what_a_record_does_not_have_is_refused_at_its_key(tmp_path: Path, keys: dict[str, Any], words: str) -> None:
    assert refusal_of(tmp_path, motion(), **keys).startswith(words)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"band_hz": [25.0, 0.1]}, "must be the two ends of a band in Hz, the lower one first"),
        ({"band_hz": [0.1]}, "must be the two ends of a band in Hz, the lower one first"),
        ({"baseline": "quadratic"}, "record.baseline"),
        ({"baseline": {"order": 2}}, "record.baseline.remove"),
    ],
)
def test_keys_that_say_nothing_are_refused_when_the_case_is_read(
    tmp_path: Path, keys: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_case(case_of(tmp_path, motion(), **keys))
    assert any(words in fault for fault in caught.value.faults)


def test_what_was_done_stands_in_the_result(tmp_path: Path) -> None:
    keys = {"baseline": {"remove": "linear", "taper_s": 1.0, "zero_velocity": True}, "band_hz": [0.1, 25.0]}
    found = attributes(setup_of(tmp_path, motion() + 0.4 * TIME_S / LENGTH_S, **keys), None, "rths run")
    assert found["record_baseline"] == "linear"
    first, second, third, fourth = str(found["record_treatment"]).split("; ")
    assert (first, second, third) == ("linear removed", "tapered over 1 s at both ends", "filtered to 0.1 to 25 Hz")
    assert fourth.startswith("final velocity of ")
    assert "record_treatment" not in attributes(setup_of(tmp_path, motion()), None, "rths run")


def test_a_case_names_the_component_of_its_record(tmp_path: Path) -> None:
    parts = np.column_stack([TIME_S, motion(), 0.5 * motion(6)])
    np.savetxt(tmp_path / "own.csv", parts, "%.7f", ",", header="time_s,NS (m/s^2),EW (m/s^2)", comments="")
    path = tmp_path / "own.yaml"
    case = {"structure": "three_storey", "damping": "low", "scaling": 1.0, "controller": "FF+FB"}
    path.write_text(json.dumps({**case, "record": {"file": "own.csv", "component": "EW"}}))
    assert make_setup(load_case(path)).motion.accel_m_s2[::20][: TIME_S.size] == pytest.approx(
        setup_of(tmp_path, 0.5 * motion(6)).motion.accel_m_s2[::20], abs=1e-6
    )


def scaled(folder: Path, scale_to: dict[str, Any], **case: Any) -> Setup:
    path = case_of(folder, motion(), scale_to=scale_to)
    path.write_text(json.dumps({**json.loads(path.read_text()), "record_filter": {"corner_hz": 0}, **case}))
    return make_setup(load_case(path))


def test_a_record_is_scaled_to_its_peak_or_energy_before_the_factor(tmp_path: Path) -> None:
    setup = scaled(tmp_path, {"measure": "pga", "value": 4.0}, scaling=0.5)
    assert np.abs(setup.motion.accel_m_s2).max() == pytest.approx(2.0, rel=1e-6)
    assert setup.record_treatment == (f"scaled by {4.0 / PEAK_M_S2:.6g} to pga = 4 m/s^2",)
    accel = scaled(tmp_path, {"measure": "arias", "value": 0.3}).motion.accel_m_s2
    assert np.pi / (2.0 * 9.80665) * (accel**2).sum() * 5e-4 == pytest.approx(0.3, rel=2e-3)


@pytest.mark.campaign
@pytest.mark.parametrize("length", [1.0, 2.4])
def test_a_record_is_scaled_to_the_spectrum_at_the_first_period_of_the_prototype(tmp_path: Path, length: float) -> None:
    setup = scaled(tmp_path, {"measure": "sa_t1", "value": 3.0}, scale={"length": length})
    building = setup.building
    w = np.sqrt(np.linalg.eigvals(np.linalg.solve(building.M, building.K)).real.min())  # of the model
    t, accel = setup.motion.time_s, setup.motion.accel_m_s2
    system = ([[0.0, 1.0], [-(w**2), -0.1 * w]], [[0.0], [-1.0]], [[w**2, 0.0]], [[0.0]])
    assert np.abs(lsim(system, accel, t)[1]).max() == pytest.approx(3.0, rel=2e-3)


@pytest.mark.campaign
def test_a_record_is_scaled_to_the_spectrum_of_a_code(tmp_path: Path) -> None:
    ends = {"period_s": [0.15, 0.5]}
    one = scaled(tmp_path, {"spectrum": "ec8", "ground": "B", "ag_m_s2": 1.0, **ends})
    two = scaled(tmp_path, {"spectrum": "ec8", "ground": "B", "ag_m_s2": 2.0, **ends})
    assert two.motion.accel_m_s2 == pytest.approx(2.0 * one.motion.accel_m_s2, rel=1e-9)
    other = scaled(tmp_path, {"spectrum": "asce7", "sds_g": 3.0 / 9.80665, "sd1_g": 1.5 / 9.80665, **ends})
    assert other.motion.accel_m_s2 == pytest.approx(one.motion.accel_m_s2, rel=1e-9)  # the plateau of both: 3 m/s^2
    (told,) = one.record_treatment
    assert "to the spectrum of ec8 from 0.15 to 0.5 s (misfit " in told


def test_a_record_is_scaled_to_the_spectrum_in_a_file(tmp_path: Path) -> None:
    (tmp_path / "plateau.csv").write_text("# of the site\nPeriod (s);Sa (cm/s²)\n0;250,0\n0,1;300,0\n1;300,0\n")
    of_file = scaled(tmp_path, {"spectrum": "plateau.csv", "period_s": [0.15, 0.5]})
    of_code = scaled(tmp_path, {"spectrum": "ec8", "ground": "B", "ag_m_s2": 1.0, "period_s": [0.15, 0.5]})
    assert of_file.motion.accel_m_s2 == pytest.approx(of_code.motion.accel_m_s2, rel=1e-9)  # 3 m/s^2 in both
    assert "to the spectrum of plateau.csv from 0.15 to 0.5 s (misfit " in of_file.record_treatment[0]
    again = load_cases([written(tmp_path, resolved_yaml(of_file.case))])[0]
    assert motion_key(again) == motion_key(of_file.case)


def written(folder: Path, text: str) -> Path:
    (folder / "again.yaml").write_text(text)
    return folder / "again.yaml"


def test_a_matched_record_has_the_spectrum_asked_for_and_ends_at_rest(tmp_path: Path) -> None:
    keys = {"spectrum": "ec8", "ground": "B", "ag_m_s2": 1.0, "period_s": [0.2, 0.8], "method": "match"}
    found = scaled(tmp_path, {**keys, "damping": 0.03})
    motion_of = found.motion
    worst = 0.0
    for period_s in (0.211, 0.305, 0.4444, 0.52, 0.613, 0.77):  # with scipy's lsim, none of them a matched period
        w = 2.0 * np.pi / period_s
        system = ([[0.0, 1.0], [-(w**2), -0.06 * w]], [[0.0], [-1.0]], [[w**2, 0.0]], [[0.0]])
        wanted = 3.0 * np.sqrt(10.0 / 8.0) * min(1.0, 0.5 / period_s)
        worst = max(worst, abs(np.abs(lsim(system, motion_of.accel_m_s2, motion_of.time_s)[1]).max() / wanted - 1.0))
    assert worst <= 0.1
    (told,) = found.record_treatment
    mean, largest = (float(part.split("%")[0].split()[-1]) for part in told.split(" (misfit ")[1].split(", "))
    assert mean <= 5.0 and worst * 100.0 <= largest + 0.5 and largest <= 10.0
    assert abs(motion_of.velocity_m_s[-1]) <= 1e-6 * np.abs(motion_of.velocity_m_s).max()
    stated_m = float(told.split("final displacement ")[1].split()[0])
    assert motion_of.displacement_m[-1] == pytest.approx(stated_m, abs=1e-6)
    whole = scaled(tmp_path, {**keys, "method": "least_squares"}).motion
    assert np.abs(motion_of.accel_m_s2[: whole.time_s.size // 10]).max() < 0.05  # quiet where the record is


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("period_s,sa\n0.1,1\n1,1\n", "no column is an acceleration with a unit (period_s, sa)"),
        ("sa_g,sd_m\n0.1,1\n1,1\n", "no column is a period"),
        ("period_s,sa_g\n0.1,1\n0.1,1\n", "own_spectrum.csv:3: the period must be above the last"),
        ("period_s,sa_g\n0.1,1\n0.5,-1\n", "own_spectrum.csv:3: the acceleration must be > 0"),
        ("period_s,sa_g\n0.1,1\n0.5,500\n", "and <= 1000 m/s^2, got 0.5 s, 4903.32 m/s^2"),
        ("period_s,sa_g\n0.2,1\n2,1\n", "0.15 to 0.5 s is beyond the periods of own_spectrum.csv, 0.2 to 2 s"),
    ],
)
def test_a_spectrum_that_cannot_be_used_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "own_spectrum.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        scaled(tmp_path, {"spectrum": "own_spectrum.csv", "period_s": [0.15, 0.5]})
    assert words in str(caught.value)


def test_a_match_that_cannot_be_close_is_refused(tmp_path: Path) -> None:
    (tmp_path / "saw.csv").write_text("period_s,sa_g\n0.2,0.02\n0.21,0.6\n0.22,0.02\n0.23,0.6\n0.24,0.02\n")
    with pytest.raises(InputError, match=r"the match leaves a misfit of .* at most 10 % is allowed"):
        scaled(tmp_path, {"spectrum": "saw.csv", "period_s": [0.2, 0.24], "method": "match"})
    keys = {"spectrum": "ec8", "ground": "B", "ag_m_s2": 1.0, "period_s": (0.2, 0.8), "method": "match"}
    with pytest.raises(InputError, match=r"0.79 s is shorter than the longest of its periods"):
        scaled_to(record(motion()[800:880]), ScaleToSpec.model_validate(keys), None)


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["el_centro", "hachinohe", "1", "2", "3"])
def test_five_records_are_matched_to_eurocode_8(name: str) -> None:
    if name.isdecimal():
        draw, time_s = np.random.default_rng(int(name)), np.arange(0.0, 20.0 + 5.0 * int(name), 0.01)
        noise = draw.normal(size=time_s.size) * np.exp(-(((time_s - 8.0) / 4.0) ** 2))
        own = record(sosfiltfilt(butter(2, [0.2, 20.0], "bandpass", fs=100, output="sos"), noise), 0.01)
    else:
        own = read_accelerogram(shipped("records") / f"{name}.csv")
    keys = {"spectrum": "ec8", "ground": "B", "ag_m_s2": 2.0, "period_s": (0.05, 2.0), "method": "match"}
    found, told = scaled_to(own, ScaleToSpec.model_validate(keys), None)
    mean, largest = (float(part.split("%")[0].split()[-1]) for part in told.split(" (misfit ")[1].split(", "))
    velocity, _ = integrate(found.accel_m_s2, found.dt_s)
    assert mean <= 5.0 and largest <= 10.0 and abs(velocity[-1]) <= 1e-9


def test_cases_that_differ_in_the_building_alone_share_no_motion_scaled_by_it(tmp_path: Path) -> None:
    path = case_of(tmp_path, motion(), scale_to={"measure": "sa_t1", "value": 3.0})
    masses = "structure.experimental.masses_kg"
    keys = {motion_key(load_case(path, [f"{masses}=[{mass}, {mass}]"])) for mass in (5.0, 6.0)}
    assert len(keys) == 2


@pytest.mark.parametrize(
    ("scale_to", "words"),
    [
        ({"value": 2.0}, "needs one of measure (with value) and spectrum (with period_s)"),
        ({"measure": "pga", "spectrum": "ec8"}, "needs one of measure (with value) and spectrum (with period_s)"),
        ({"measure": "pga"}, "needs value with pga"),
        ({"measure": "pga", "value": 1.0, "method": "match"}, "belongs to a spectrum"),
        ({"spectrum": "none.csv", "period_s": [0.1, 1.0]}, "no such file"),
        ({"spectrum": 3, "period_s": [0.1, 1.0]}, "must be ec8 or asce7"),
        ({"spectrum": "ec8", "ground": "A", "period_s": [0.1, 1.0]}, "needs ag_m_s2 with ec8"),
        ({"spectrum": "asce7", "sds_g": 1.0, "sd1_g": 0.5}, "needs period_s with asce7"),
        ({"spectrum": "ec8", "ground": "A", "ag_m_s2": 1.0, "period_s": [1.0, 0.1]}, "the two ends of periods in s"),
    ],
)
def test_a_scaling_that_lacks_a_number_is_refused(tmp_path: Path, scale_to: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_case(case_of(tmp_path, motion(), scale_to=scale_to))
    assert any(words in fault for fault in caught.value.faults)
