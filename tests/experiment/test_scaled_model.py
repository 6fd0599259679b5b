"""A model in the laboratory against its prototype: the same response after conversion, by three ways.

The exponents of length, acceleration and mass stand here once more, written by hand.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.signal import lsim

from rths_cli.analysis.references import reference_of
from rths_cli.analysis.sim import Response
from rths_cli.case.load import load_cases
from rths_cli.case.structure_schema import ScaleSpec, read_scale
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import of_case
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.provenance import attributes
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.findings import sentences
from rths_cli.laboratory.listing import show

RECORD = Path(__file__).parents[2] / "records" / "el_centro.csv"
LENGTH, ACCELERATION, STRESS = 2.4, 1.25, 1.5
TIME = (LENGTH / ACCELERATION) ** 0.5
FORCE = STRESS * LENGTH**2
MASS, STIFFNESS, DASHPOT = FORCE / ACCELERATION, FORCE / LENGTH, FORCE * TIME / LENGTH
RATE_HZ = 2000.0


def keys(mass: float, stiffness: float, dashpot: float, length: float, time: float) -> dict[str, Any]:
    """Return a case of four storeys, its structure's values and the laboratory's times multiplied by factors."""
    return {
        "structure": {
            "numerical": {
                "masses_kg": [2.0 * mass, 1.8 * mass],
                "stiffness_n_per_m": [3000.0 * stiffness, 2500.0 * stiffness],
            },
            "experimental": {
                "masses_kg": [0.9 * mass, 0.8 * mass],
                "stiffness_n_per_m": [2000.0 * stiffness, 1500.0 * stiffness],
                "dashpots_n_s_per_m": [1.1 * dashpot, 0.9 * dashpot],
            },
            "interface_experimental_mass_kg": 0.2 * mass,
            "heights_m": [0.3 * length] * 4,
        },
        "damping": {"dashpots_n_s_per_m": [8.0 * dashpot, 6.0 * dashpot]},
        "record": str(RECORD),
        "scaling": 0.3,
        "controller": "FF",
        "runs": ["sim", "sim_delay"],
        "sample_rate_hz": RATE_HZ / time,
        "record_filter": {"corner_hz": 0.4 / time},
        "delay_s": 0.001 * time,
    }


def setup_of(values: dict[str, Any], *settings: str) -> Setup:
    return make_setup(load_cases([values], settings)[0])


def scaled() -> dict[str, Any]:
    model = keys(1.0, 1.0, 1.0, 1.0, 1.0)
    return model | {"scale": {"length": LENGTH, "acceleration": ACCELERATION, "stress": STRESS}}


def prototype() -> dict[str, Any]:
    return keys(MASS, STIFFNESS, DASHPOT, LENGTH, TIME) | {"test_band_hz": 8.0, "identification": {"high_hz": 40.0}}


def sim(setup: Setup) -> Response:
    return reference_of(setup.building).sim(setup.building, setup.rig.dt_s, setup.motion.accel_m_s2)


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    """Assert that two series agree within 1e-10 of the peak."""
    assert found.shape == expected.shape
    assert np.max(np.abs(found - expected)) <= 1e-10 * np.max(np.abs(expected))


def test_the_model_responds_as_its_prototype() -> None:
    model, whole = setup_of(scaled()), setup_of(prototype())
    assert_same(TIME * model.motion.time_s, whole.motion.time_s)
    small, large = sim(model), sim(whole)
    assert_same(LENGTH * small.rel_disp_m, large.rel_disp_m)
    assert_same(LENGTH / TIME * small.rel_vel_m_s, large.rel_vel_m_s)
    assert_same(ACCELERATION * small.abs_accel_m_s2, large.abs_accel_m_s2)
    assert_same(FORCE * small.base_shear_n, large.base_shear_n)


def test_the_factors_of_the_case_are_those_written_by_hand() -> None:
    scale = setup_of(scaled()).similitude
    assert scale is not None
    found = [scale.factors[name] for name in ("time", "mass", "force", "stiffness", "dashpot")]
    assert found == pytest.approx([TIME, MASS, FORCE, STIFFNESS, DASHPOT], rel=1e-14)


def test_the_delayed_model_responds_as_its_delayed_prototype() -> None:
    model, whole = setup_of(scaled()), setup_of(prototype())

    def delayed(setup: Setup) -> np.ndarray:
        reference, dt, ground = reference_of(setup.building), setup.rig.dt_s, setup.motion.accel_m_s2
        found = reference.sim_delay(setup.building, dt, ground, setup.case.delay_s, sim(setup))
        return np.asarray(found.abs_accel_m_s2)

    assert_same(ACCELERATION * delayed(model), delayed(whole))


def test_the_model_responds_as_the_prototype_that_scipy_computes() -> None:
    """The prototype is a chain written out here, on its own time, driven by the record as it is read."""
    model = setup_of(scaled(), "record_filter.corner_hz=0")
    record = read_accelerogram(RECORD)
    time = TIME * np.arange(len(model.motion.time_s)) / RATE_HZ
    ground = 0.3 * np.interp(time, record.dt_s * np.arange(len(record.accel_m_s2)), record.accel_m_s2)
    masses = MASS * np.array([2.0, 1.8, 0.9, 0.8])

    def chain(values: list[float]) -> np.ndarray:
        difference = np.eye(4) - np.eye(4, k=-1)
        return difference.T @ np.diag(values) @ difference

    k, c = STIFFNESS * chain([3000.0, 2500.0, 2000.0, 1500.0]), DASHPOT * chain([8.0, 6.0, 1.1, 0.9])
    a = np.block([[np.zeros((4, 4)), np.eye(4)], [-k / masses[:, None], -c / masses[:, None]]])
    b = np.concatenate([np.zeros(4), -np.ones(4)])[:, None]
    absolute = np.hstack([-k / masses[:, None], -c / masses[:, None]])  # the ground's acceleration cancels
    outputs, feed = np.vstack([np.eye(4, 8), absolute]), np.zeros((8, 1))
    _, found, _ = lsim((a, b, outputs, feed), ground, time, interp=True)
    small = sim(model)
    assert_same(LENGTH * small.rel_disp_m, found[:, :4].T)
    assert_same(ACCELERATION * small.abs_accel_m_s2, found[:, 4:].T)


def test_a_record_that_is_compressed_by_hand_gives_the_same_run(tmp_path: Path) -> None:
    record = read_accelerogram(RECORD)
    by_hand = tmp_path / "compressed.csv"
    lines = [f"# units: m/s^2\n# dt: {record.dt_s / TIME!r} s\n"]
    by_hand.write_text("".join([*lines, *(f"{float(one / ACCELERATION)!r}\n" for one in record.accel_m_s2)]))
    ours, other = setup_of(scaled()), setup_of(scaled(), f"record={by_hand}", "scale=null")
    assert np.array_equal(ours.motion.accel_m_s2, other.motion.accel_m_s2)
    assert np.array_equal(ours.motion.displacement_m, other.motion.displacement_m)
    for name in ("rel_disp_m", "abs_accel_m_s2", "base_shear_n"):
        assert np.array_equal(getattr(sim(ours), name), getattr(sim(other), name))


@pytest.mark.campaign
def test_a_hybrid_test_of_a_scaled_case_is_that_with_the_compressed_record(tmp_path: Path, memory: Memory) -> None:
    """Every dataset of both files has the same bytes, those of the loop and the check included."""
    record = read_accelerogram(RECORD)
    short, by_hand = tmp_path / "short.csv", tmp_path / "compressed.csv"
    accel = record.accel_m_s2[:300]
    short.write_text(f"# units: m/s^2\n# dt: {record.dt_s!r} s\n" + "".join(f"{float(one)!r}\n" for one in accel))
    by_hand.write_text(
        f"# units: m/s^2\n# dt: {record.dt_s / TIME!r} s\n"
        + "".join(f"{float(one / ACCELERATION)!r}\n" for one in accel)
    )
    scale = f"scale={{length: {LENGTH}, acceleration: {ACCELERATION}}}"
    found = []
    for name, settings in {"ours": (f"record={short}", scale), "theirs": (f"record={by_hand}",)}.items():
        setup = make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])
        assert run_case(setup, tmp_path / f"{name}.h5", memory, "test", lambda _: None).exit_code == 0
        found.append(datasets(tmp_path / f"{name}.h5"))
    ours, theirs = found
    assert len(ours) > 200 and ours.keys() == theirs.keys()
    assert [name for name in ours if ours[name] != theirs[name]] == []


def datasets(path: Path) -> dict[str, bytes]:
    """Return every dataset of a result but the case and the clock's as bytes."""
    found: dict[str, bytes] = {}

    def collect(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and "timing" not in name and not name.startswith("case"):
            found[name] = np.asarray(node[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(collect)
    return found


def test_the_scale_is_stored_with_the_result() -> None:
    found = attributes(setup_of(scaled() | {"report_in": "prototype"}), None, "rths run")
    assert found["scale_length"] == LENGTH and found["scale_acceleration"] == ACCELERATION
    assert found["scale_mass"] == pytest.approx(MASS) and found["report_in"] == "prototype"
    assert not [name for name in attributes(setup_of(keys(1, 1, 1, 1, 1)), None, "") if name.startswith("scale_")]


def test_a_record_that_left_the_test_band_is_named() -> None:
    def told(*settings: str) -> list[str]:
        return [one for one in sentences(of_case(setup_of(scaled(), *settings), None, None)) if one.startswith("scale")]

    assert told() == []
    (warning,) = told("scale.length=40", "scale.acceleration=1")
    assert "compressed in time by 6.325" in warning and "above the test band, 12 Hz" in warning
    assert told("scale.length=40", "scale.acceleration=1", "test_band_hz=60") == []


def test_the_share_above_the_band_is_that_of_the_series() -> None:
    """A beat of 5 Hz and, with a third of its power, 20 Hz: a quarter is above 12 Hz."""
    setup = setup_of(scaled())
    time = setup.motion.time_s
    two = np.sin(2 * np.pi * 5.0 * time) + 3**-0.5 * np.sin(2 * np.pi * 20.0 * time)
    changed = replace(setup, motion=replace(setup.motion, accel_m_s2=two))
    assert any("has 25 % of its power above" in one for one in sentences(of_case(changed, None, None)))


def test_a_record_too_short_or_too_fast_for_the_laboratory_is_said_to_be_compressed() -> None:
    for setting in ("sample_rate_hz=100", "record_filter.corner_hz=0.01"):
        with pytest.raises(InputError, match=r"\(scale compresses the record in time by 6.325\)"):
            setup_of(scaled() | {"scale": {"length": 40.0}, "identification": {"high_hz": 20.0}}, setting)


def test_a_model_larger_than_its_prototype_is_doubted() -> None:
    doubts = sentences(of_case(setup_of(scaled(), "scale.length=0.4"), None, None))
    assert any("write 2.5 for a model that is smaller" in one for one in doubts)


def test_report_in_has_no_effect_without_a_scale() -> None:
    told = sentences(of_case(setup_of(keys(1, 1, 1, 1, 1) | {"report_in": "prototype"}), None, None))
    assert any("report_in (only a case with a scale reads it)" in one for one in told)
    told = sentences(of_case(setup_of(scaled() | {"report_in": "prototype"}), None, None))
    assert not any("report_in" in one for one in told)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("scale.length=0", "scale.length: must be >= 0.01 and <= 1000, got 0"),
        ("scale={acceleration: 1}", "scale.length: is missing; add length"),
        ("scale.mass=9", "scale.mass: give mass or stress, not both"),
        ("scale=2.4", "scale: must be a mapping, got 2.4"),
        ("scale.time=2", "scale.time: unknown key"),
        ("report_in=both", "report_in: must be model or prototype, got 'both'"),
    ],
)
def test_faults_of_a_scale_are_sentences(setting: str, words: str) -> None:
    with pytest.raises(InputError) as fault:
        load_cases([scaled()], [setting])
    assert words in str(fault.value)


@pytest.mark.parametrize(("length", "acceleration"), [(4.0, 1.0), (1.0, 0.25)])
def test_a_compressed_record_has_the_spectrum_of_the_prototype_at_half_the_periods(
    length: float, acceleration: float
) -> None:
    of_model = ScaleSpec(length=length, acceleration=acceleration)
    found, text = show("el_centro", None, None, scale=of_model)
    whole = show("el_centro", None, None)[0]
    at = dict(zip(whole["periods_s"], whole["pseudo_accel_m_s2"], strict=True))
    shown = dict(zip(found["periods_s"], found["pseudo_accel_m_s2"], strict=True))
    for period_s in (0.05, 0.1, 0.5, 1.0):
        assert shown[period_s] == pytest.approx(at[2.0 * period_s] / acceleration, rel=1e-9)
    assert found["duration_s"] == pytest.approx(0.5 * whole["duration_s"])
    assert f"length {length:g}, time 2" in " ".join(text.split()) and "scale" not in whole


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["length"], "--scale length: must be KEY=NUMBER, for example --scale length=2.4"),
        (["lenght=2", "length=3"], "--scale lenght: unknown key; did you mean length?"),
        (["acceleration=1"], "--scale length: is missing; add length"),
        (["length=-1"], "--scale length: must be >= 0.01 and <= 1000, got -1"),
        (["length=2", "length=3"], "--scale length: is given twice; give it once"),
    ],
)
def test_a_wrong_scale_of_a_record_is_told_with_its_key(texts: list[str], said: str) -> None:
    with pytest.raises(InputError) as raised:
        read_scale(texts)
    assert raised.value.faults == (said,)
