"""The imperfect table: each imperfection alone against the same physics in another form by an adaptive solver."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from bench import DT_S, ideal_info, play_plant, run_plant, specimen
from imperfect_table import Imperfect, Table, solved
from portfolio import parametrize_first
from pydantic import ValidationError

from rths_cli.case.rig_schema import VirtualRigSpec
from rths_cli.case.virtual_imperfections_schema import Values, VirtualImperfections
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import InputError
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.imperfect.from_laboratory import Output, imperfect_plant
from rths_cli.rigs.virtual.imperfect.plant import DISPLACEMENT, DRIFT, FORCE, ImperfectPlant
from rths_cli.rigs.virtual.laboratory import laboratory_of, of_run
from rths_cli.rigs.virtual.plant_kernel import Plant, specimen_with_laws
from rths_cli.rigs.virtual.virtual_rig import virtual_rig

PHYSICS = VirtualPhysics()
SOFT = {"kind": "softening", "share": 0.05, "half_drift_m": 0.001}
JOINT = {"kind": "friction", "force_n": 0.5, "sticking_displacement_m": 5e-5}
BOTH = [[JOINT, SOFT], [JOINT, SOFT]]


def peak(values: Array) -> float:
    return float(np.abs(values).max())


def command_of(samples: int, size_v: float = 1.0) -> Array:
    time = np.arange(samples) * DT_S
    return size_v * (np.sin(2.0 * np.pi * 2.0 * time) + 0.4 * np.sin(2.0 * np.pi * 7.3 * time)) * np.tanh(5.0 * time)


def plant_of(
    stated: dict[str, Any],
    info: RigInfo,
    physics: VirtualPhysics = PHYSICS,
    precision: float = 1.0,
    run: int = 0,
    outputs: tuple[Output, ...] | None = None,
) -> ImperfectPlant:
    laboratory = laboratory_of(VirtualImperfections.model_validate(stated), 1, 3, 2)
    whole, laws = specimen_with_laws(specimen(), physics.specimen_laws, STANDARD_GRAVITY_M_S2)
    drawn = of_run(laboratory, (run,), 3)
    return imperfect_plant(info, physics, whole, laws, 0.0, 0.0, laboratory, drawn, outputs, precision)


SENSITIVITY = ideal_info().channels[0].sensitivity_v_per_unit
ALONE: dict[str, tuple[dict[str, Any], Imperfect]] = {
    "gains": ({"channels": {"gain_error": [0.01, -0.02, 0.03]}}, Imperfect(gain=(1.01, 0.98, 1.03))),
    "offsets": (
        {"channels": {"offset_v": [0.01, -0.02, 0.0]}},
        Imperfect(offset_m_s2=(0.01 / SENSITIVITY, -0.02 / SENSITIVITY, 0.0)),
    ),
    "masses": ({"masses": {"weighing_error": [0.02, -0.05]}}, Imperfect(heavier=(0.02, -0.05))),
    "deck": ({"deck": {"frequency_hz": 60.0}}, Imperfect(coil_kg=1.5, deck_hz=60.0)),
    "another deck": (
        {"deck": {"frequency_hz": 40.0, "coil_mass_kg": 2.5, "damping_ratio": 0.1}},
        Imperfect(coil_kg=2.5, deck_hz=40.0, deck_ratio=0.1),
    ),
    "crossover": ({"amplifier": {"crossover_n": 0.5}}, Imperfect(crossover_n=0.5)),
    "distortion": (
        {"amplifier": {"distortion": 0.02, "distortion_at_v": 2.0}},
        Imperfect(distortion=0.02, distortion_at_v=2.0),
    ),
    "gain drift": ({"amplifier": {"gain_drift_per_s": 0.1}}, Imperfect(gain_drift_per_s=0.1)),
    "Dahl": ({"friction": {"presliding_m": 3e-4}}, Imperfect(presliding_m=3e-4)),
    "LuGre": (
        {"friction": {"presliding_m": 1e-4, "bristle_damping_n_s_per_m": 3.0, "stribeck_excess": 1.0}},
        Imperfect(presliding_m=1e-4, bristle_n_s_per_m=3.0, excess=1.0),
    ),
    "Stribeck": (
        {"friction": {"stribeck_excess": 1.0, "stribeck_velocity_m_s": 0.01}},
        Imperfect(excess=1.0, stribeck_m_s=0.01),
    ),
    "suspension": ({"suspension": {"stiffness_n_per_m": 790.0}}, Imperfect(suspension=(790.0, 0.0))),
    "hardening": ({"suspension": {"cubic_n_per_m3": 9.5e4}}, Imperfect(suspension=(0.0, 9.5e4))),
    "force factor": ({"force_factor": {"drop": 0.3, "at_m": 0.05}}, Imperfect(drop=0.3, drop_at_m=0.05)),
    "pitch": ({"pitch": {"frequency_hz": 30.0}}, Imperfect(pitch_hz=30.0)),
    "another pitch": (
        {
            "pitch": {
                "frequency_hz": 40.0, "damping_ratio": 0.1, "inertia_kg_m2": 5.0, "storey_height_m": [0.3, 0.15],
                "sensor_arm_m": -0.2,
            },
            "channels": {"transverse_sensitivity": 0.03},
        },
        Imperfect(
            pitch_hz=40.0, pitch_ratio=0.1, inertia_kg_m2=5.0, storey_m=(0.3, 0.15), arm_m=-0.2,
            transverse=(0.03, 0.03, 0.03),
        ),
    ),
    "guides": (
        {"guides": {"lateral_share": 0.05}, "channels": {"transverse_sensitivity": [0.03, -0.02, 0.05]}},
        Imperfect(lateral=0.05, transverse=(0.03, -0.02, 0.05)),
    ),
    "transverse": (
        {
            "pitch": {"frequency_hz": 30.0},
            "guides": {"lateral_share": 0.05},
            "channels": {"transverse_sensitivity": [0.03, -0.02, 0.05]},
        },
        Imperfect(pitch_hz=30.0, lateral=0.05, transverse=(0.03, -0.02, 0.05)),
    ),
    "AC coupling": (
        {"channels": {"high_pass_error": [0.2, -0.2, 0.1]}},
        Imperfect(high_pass_hz=(0.024 * 1.2, 0.024 * 0.8, 0.024 * 1.1)),
    ),
    "low passes": (
        {"channels": {"low_pass_error": [-0.2, 0.1, 0.2]}},
        Imperfect(low_pass_hz=(1549.0 * 0.8, 1549.0 * 1.1, 1549.0 * 1.2)),
    ),
    "skew": ({"channels": {"skew_s": [2e-5, -5e-5, 1e-4]}}, Imperfect(skew_s=(2e-5, -5e-5, 1e-4))),
    "command skew": ({"converters": {"command_skew_s": -6e-5}}, Imperfect(command_skew_s=-6e-5)),
    "softening": (
        {"specimen": {"softening": [0.05, 0.1], "softening_drift_m": 0.002}},
        Imperfect(laws=[(0, {**SOFT, "half_drift_m": 0.002}), (1, {**SOFT, "share": 0.1, "half_drift_m": 0.002})]),
    ),
    "joints": (
        {"specimen": {"joint_friction_n": [0.5, 0.2], "joint_sticking_m": 1e-4}},
        Imperfect(
            laws=[
                (0, {**JOINT, "sticking_displacement_m": 1e-4}),
                (1, {**JOINT, "force_n": 0.2, "sticking_displacement_m": 1e-4}),
            ]
        ),
    ),
    "softening and joints": (
        {"specimen": {"softening": 0.05, "joint_friction_n": 0.5}},
        Imperfect(laws=[(i, one) for i in range(2) for one in (SOFT, JOINT)]),
    ),
    "deck, pitch and LuGre": (
        {"deck": {"frequency_hz": 60.0}, "pitch": {"frequency_hz": 30.0}, "friction": {"presliding_m": 3e-4}},
        Imperfect(coil_kg=1.5, deck_hz=60.0, pitch_hz=30.0, presliding_m=3e-4),
    ),
}  # fmt: skip


def plant_of_file(stated: dict[str, Any], info: RigInfo) -> ImperfectPlant:
    """Return the plant of a rig file with these imperfections."""
    spec = VirtualRigSpec.model_validate({"kind": "virtual", "imperfections": stated})
    plant = virtual_rig(spec, info, specimen(), 0.0, (0, 1), True).plant
    assert isinstance(plant, ImperfectPlant)
    return plant


def compare(plant: ImperfectPlant, info: RigInfo, how: Imperfect) -> None:
    """Samples, displacement and velocities agree with those of the independent table within 1e-6 of their peaks."""
    command = command_of(200)
    wanted, place, velocity = solved(Table(PHYSICS, specimen(), how), command, DT_S, 1)
    samples, states, middle = run_plant(plant, info, command)
    accel = samples / SENSITIVITY
    for c in range(3):
        assert peak(accel[c] - wanted[c]) < 1e-6 * peak(wanted[c]), c
        assert peak(middle[c] - velocity[c]) < 1e-6 * peak(velocity[c]), c
    assert peak(states[0] - place) < 1e-6 * peak(place)


@parametrize_first(1, "name", ALONE)
def test_each_imperfection_agrees_with_an_adaptive_solver(name: str) -> None:
    stated, how = ALONE[name]
    info = ideal_info(latency_samples=1, high_pass_hz=0.024)
    compare(plant_of_file(stated, info), info, how)


@pytest.mark.campaign
def test_without_imperfections_it_agrees_with_the_adaptive_solver() -> None:
    info = ideal_info(latency_samples=1, high_pass_hz=0.024)
    compare(plant_of({}, info), info, Imperfect())


RANDOM = {
    "channels.hum_v", "channels.hum_hz", "channels.offset_walk_v_per_sqrt_s", "channels.gain_change_between_runs",
    "converters.command_jitter_s", "converters.sample_jitter_s",
}  # fmt: skip


def test_every_deterministic_imperfection_is_compared() -> None:
    """Each key is among those compared with the adaptive solver, or among those whose statistics are tested below."""
    keys = {f"{part}.{name}" for part, one in VirtualImperfections().parts() for name in type(one).model_fields}
    compared = {f"{part}.{name}" for stated, _ in ALONE.values() for part, names in stated.items() for name in names}
    assert compared | RANDOM == keys


@pytest.mark.parametrize("latency_samples", [0, 1])
def test_with_everything_off_it_is_the_exact_plant(latency_samples: int) -> None:
    """The plant by matrix exponentials, and this one by Runge and Kutta's method: within 1e-7 of the peak."""
    info, command = ideal_info(latency_samples=latency_samples, high_pass_hz=0.024), command_of(600)
    exact = play_plant(info, PHYSICS, command, refine=2)
    found = run_plant(plant_of({}, info), info, command)
    for c in range(3):
        assert peak(found[0][c] - exact[0][c]) < 1e-7 * peak(exact[0][c]), c
        assert peak(found[2][c] - exact[2][c]) < 1e-7 * peak(exact[2][c]), c
    assert peak(found[1][0] - exact[1][0]) < 1e-7 * peak(exact[1][0])


ORDINARY: dict[str, Any] = {
    "channels": {"gain_error": {"std": 0.01}, "high_pass_error": {"std": 0.1}, "skew_s": {"std": 25e-6}},
    "converters": {"command_skew_s": 3e-5, "command_jitter_s": 1e-5, "sample_jitter_s": 1e-5},
    "deck": {"frequency_hz": 60.0},
    "amplifier": {"crossover_n": 0.2, "distortion": 0.002},
    "friction": {"presliding_m": 3e-4, "stribeck_excess": 0.5},
    "suspension": {"stiffness_n_per_m": 790.0, "cubic_n_per_m3": 9.5e4},
    "force_factor": {"drop": 0.05},
    "pitch": {"frequency_hz": 80.0},
}


def test_smaller_errors_of_a_step_change_nothing() -> None:
    """All at once, with laws and jitter: a hundredth of the tolerated errors changes 1e-6 of the peak at most."""
    info, command = ideal_info(latency_samples=1, high_pass_hz=0.024), command_of(2000, 0.5)
    physics = VirtualPhysics.model_validate({"specimen_laws": BOTH})
    noise = np.random.default_rng(3).standard_normal((len(command), 8))
    plain, fine = (run_plant(plant_of(ORDINARY, info, physics, size), info, command, noise) for size in (1.0, 1e-2))
    for c in range(3):
        assert peak(plain[0][c] - fine[0][c]) < 1e-6 * peak(fine[0][c]), c
        assert peak(plain[2][c] - fine[2][c]) < 1e-6 * peak(fine[2][c]), c


def with_noise(columns: dict[int, float], samples: int) -> Array:
    noise = np.zeros((samples, 8))
    for column, value in columns.items():
        noise[:, column] = value
    return noise


@pytest.mark.parametrize("late", [1.0, -1.0])
@pytest.mark.parametrize(
    ("jitter", "column", "skew"),
    [
        ({"converters": {"command_jitter_s": 2e-5}}, 6, lambda late: {"converters": {"command_skew_s": 2e-5 * late}}),
        ({"converters": {"sample_jitter_s": 2e-5}}, 7, lambda late: {"channels": {"skew_s": 2e-5 * late}}),
    ],
    ids=["command", "samples"],
)
def test_jitter_is_a_skew_that_is_drawn(jitter: Any, column: int, skew: Any, late: float) -> None:
    info, command = ideal_info(latency_samples=1), command_of(300)
    found = run_plant(plant_of(jitter, info), info, command, with_noise({column: late}, len(command)))[0]
    wanted = run_plant(plant_of(skew(late), info), info, command)[0]
    without = run_plant(plant_of({}, info), info, command)[0]
    assert peak(found - wanted) < 1e-9 * peak(wanted)
    assert peak(without - wanted) > 1e-4 * peak(wanted)


def at_rest(stated: dict[str, Any], samples: int, run: int = 0) -> Array:
    """Return samples in V of a table at rest."""
    info = ideal_info(latency_samples=1)
    noise = np.random.default_rng(run).standard_normal((samples, 8))
    return run_plant(plant_of(stated, info, run=run), info, np.zeros(samples), noise)[0]


def test_offset_and_hum_of_each_channel() -> None:
    stated = {"channels": {"offset_v": [0.01, -0.02, 0.0], "hum_v": [0.003, 0.0, 0.001], "skew_s": [2e-5, 0.0, 0.0]}}
    samples = at_rest(stated, 2000)
    for c, (offset, hum, late) in enumerate(((0.01, 0.003, 2e-5), (-0.02, 0.0, 0.0), (0.0, 0.001, 0.0))):
        turn = 2.0 * np.pi * 50.0 * (DT_S * np.arange(2000) + late)
        fitted, left, *_ = np.linalg.lstsq(
            np.column_stack([np.ones(2000), np.cos(turn), np.sin(turn)])[1:], samples[c, 1:], rcond=None
        )
        assert fitted[0] == pytest.approx(offset, abs=1e-12)
        assert np.hypot(*fitted[1:]) == pytest.approx(hum, abs=1e-12)
        assert float(left[0]) < 1e-20


def test_the_zero_walks_as_far_as_stated() -> None:
    """Steps of standard deviation walk sqrt(dt), independent: within four standard errors."""
    count = 4000
    steps = np.diff(at_rest({"channels": {"offset_walk_v_per_sqrt_s": [0.01, 0.02, 0.0]}}, count))
    for c, walk in enumerate((0.01, 0.02, 0.0)):
        wanted = walk * np.sqrt(DT_S)
        assert steps[c].std() == pytest.approx(wanted, abs=4.0 * wanted / np.sqrt(2 * count))
    assert abs(np.corrcoef(steps[:2])[0, 1]) < 4.0 / np.sqrt(count)
    assert abs(np.corrcoef(steps[0, 1:], steps[0, :-1])[0, 1]) < 4.0 / np.sqrt(count)


def laboratories(stated: dict[str, Any], key: str, count: int) -> Array:
    made = VirtualImperfections.model_validate(stated)
    return np.array([laboratory_of(made, number, 3, 2).values[key] for number in range(count)])


@pytest.mark.campaign
def test_values_are_drawn_as_their_file_states() -> None:
    """Mean, spread and independence of 4000 laboratories within four standard errors; a number is exact."""
    count, stated = 4000, {"channels": {"gain_error": {"mean": 0.002, "std": 0.01}, "skew_s": 2e-5}}
    drawn = laboratories(stated, "channels.gain_error", count)
    assert drawn.shape == (count, 3)
    assert np.abs(drawn.mean(axis=0) - 0.002).max() < 4.0 * 0.01 / np.sqrt(count)
    assert np.abs(drawn.std(axis=0) - 0.01).max() < 4.0 * 0.01 / np.sqrt(2 * count)
    assert np.abs(np.corrcoef(drawn.T) - np.eye(3)).max() < 4.0 / np.sqrt(count)
    assert np.abs(np.corrcoef(drawn[1:, 0], drawn[:-1, 0])[0, 1]) < 4.0 / np.sqrt(count)
    assert np.all(laboratories(stated, "channels.skew_s", 3) == 2e-5)


def test_a_key_draws_the_same_whatever_others_state() -> None:
    alone = laboratories({"deck": {"frequency_hz": {"mean": 60, "std": 5}}}, "deck.frequency_hz", 5)
    more = {"deck": {"frequency_hz": {"mean": 60, "std": 5}}, "channels": {"gain_error": {"std": 0.01}}}
    assert np.array_equal(alone, laboratories(more, "deck.frequency_hz", 5))
    assert len(np.unique(alone)) == 5


def test_between_runs_gains_and_phases_of_the_hum_are_drawn_anew() -> None:
    stated = {"channels": {"gain_change_between_runs": {"std": 0.003}, "hum_v": 0.001}}
    laboratory = laboratory_of(VirtualImperfections.model_validate(stated), 4, 3, 2)
    runs = [of_run(laboratory, (4, stream), 3) for stream in range(2000)]
    change = np.array([run["channels.gain_change_between_runs"] for run in runs])
    assert change.std() == pytest.approx(0.003, abs=4.0 * 0.003 / np.sqrt(2 * change.size))
    phase = np.array([run["channels.hum_phase_rad"] for run in runs])
    assert np.histogram(phase, 4, (0.0, 2.0 * np.pi))[0].min() > 0.25 * phase.size - 4.0 * np.sqrt(phase.size)
    assert np.array_equal(of_run(laboratory, (4, 7), 3)["channels.hum_phase_rad"], phase[7])


def test_further_channels_show_the_motion_they_are_of() -> None:
    """A load cell is the base shear of Eq. 2.6 by true masses, pitch and plate included; drift and displacement of the
    state (1e-9 of the peak)."""
    info, command = ideal_info(latency_samples=1, low_pass_hz=0.0), command_of(400)
    outputs = (Output(FORCE, 0.0, 2.0), Output(DRIFT, 1.0), Output(DISPLACEMENT, 0.0))
    stated = {"pitch": {"frequency_hz": 30.0}, "deck": {"frequency_hz": 60.0}}
    accel = run_plant(plant_of(stated, info), info, command)[0] * STANDARD_GRAVITY_M_S2
    shown, states, _ = run_plant(plant_of(stated, info, outputs=outputs), info, command)
    shown = shown * STANDARD_GRAVITY_M_S2
    parts = specimen()
    shear = np.array([2.0, *parts.masses_kg]) @ accel
    assert peak(shown[0] - shear) < 1e-9 * peak(shear)
    assert peak(shown[2] - states[0]) < 1e-9 * peak(states[0])
    assert peak(parts.K[0, 0] * shown[1]) > 0.3 * peak(shear)


def test_a_laboratory_that_is_as_declared_has_the_exact_plant() -> None:
    assert VirtualImperfections(laboratory=3).off
    assert not VirtualImperfections.model_validate({"channels": {"gain_error": [0, 0, 0.01]}}).off
    written = VirtualRigSpec(kind="virtual").model_dump()
    assert "imperfections" not in written
    stated = {
        "kind": "virtual",
        "imperfections": {"channels": {"gain_error": {"std": 0.01}, "skew_s": [1e-5, 0.0, 0.0]}},
    }
    once = VirtualRigSpec.model_validate(stated)
    assert VirtualRigSpec.model_validate_json(once.model_dump_json(), strict=False) == once


def test_a_file_that_states_every_imperfection_as_zero_has_the_exact_plant_to_the_bit() -> None:
    zeros: dict[str, Any] = {
        part: {name: 0 for name, given in one if isinstance(given, Values)}
        for part, one in VirtualImperfections().parts()
    }
    assert sum(len(names) for names in zeros.values()) > 25
    info, made = ideal_info(), []
    for stated in ({}, zeros, {"laboratory": 3}):
        spec = VirtualRigSpec.model_validate({"kind": "virtual", "imperfections": stated})
        made.append(virtual_rig(spec, info, specimen(), 0.0, (0, 1), True).plant)
    assert all(isinstance(plant, Plant) for plant in made)
    found = [run_plant(plant, info, command_of(200))[0] for plant in made]
    assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])


@pytest.mark.parametrize(
    ("stated", "told"),
    [
        ({"channels": {"gain_error": {"std": 0.3}}}, "must be > -0.5 and < 1, got -1.2 (mean 0, std 0.3, drawn within"),
        ({"deck": {"frequency_hz": 2}}, "must be 0 (off) or >= 5 and <= 2000, got 2"),
        ({"channels": {"gain": 0.1}}, "unknown key; did you mean"),
        ({"channels": {"skew_s": "late"}}, "must be a number, a list of numbers, or a mapping of mean and std"),
        ({"channels": {"skew_s": {"std": -1e-6}}}, "must be >= 0"),
    ],
)  # fmt: skip
def test_wrong_values_are_told(stated: dict[str, Any], told: str) -> None:
    with pytest.raises(ValidationError, match=re.escape(told)):
        VirtualImperfections.model_validate(stated)


def test_lists_and_instants_that_do_not_fit_the_rig_are_told() -> None:
    with pytest.raises(InputError, match=r"imperfections.channels.gain_error: 2 entries for 3 channels"):
        plant_of({"channels": {"gain_error": [0.01, 0.02]}}, ideal_info())
    with pytest.raises(InputError, match=r"channels.skew_s: must be within \+-225 us, 0.45 of the sample interval"):
        plant_of({"channels": {"skew_s": 3e-4}}, ideal_info())
    with pytest.raises(InputError, match="coil_mass_kg: must be < 7"):
        plant_of({"deck": {"frequency_hz": 60.0, "coil_mass_kg": 7.0}}, ideal_info())
