"""The imperfect table: each imperfection alone against the same physics in another form by an adaptive solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bench import DT_S, ideal_info, run_plant, specimen
from imperfect_table import Imperfect, Table, solved

from rths_cli.case.virtual_imperfections_schema import VirtualImperfections
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.numerics.lti import Array
from rths_cli.rigs.virtual.imperfect.from_laboratory import imperfect_plant
from rths_cli.rigs.virtual.imperfect.plant import ImperfectPlant
from rths_cli.rigs.virtual.laboratory import laboratory_of, of_run
from rths_cli.rigs.virtual.specimen_laws import specimen_with_laws

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
    stated: dict[str, Any], info: Any, physics: VirtualPhysics = PHYSICS, precision: float = 1.0, run: int = 0
) -> ImperfectPlant:
    laboratory = laboratory_of(VirtualImperfections.model_validate(stated), 1, 3, 2)
    whole, laws = specimen_with_laws(specimen(), physics.specimen_laws, 9.80665)
    drawn = of_run(laboratory, (run,), 3)
    return imperfect_plant(info, physics, whole, laws, 0.0, 0.0, laboratory, drawn, precision=precision)


ALONE: dict[str, tuple[dict[str, Any], Imperfect]] = {
    "nothing": ({}, Imperfect()),
    "deck": ({"deck": {"frequency_hz": 60.0}}, Imperfect(coil_kg=1.5, deck_hz=60.0)),
    "crossover": ({"amplifier": {"crossover_n": 0.5}}, Imperfect(crossover_n=0.5)),
    "distortion": ({"amplifier": {"distortion": 0.02}}, Imperfect(distortion=0.02)),
    "gain drift": ({"amplifier": {"gain_drift_per_s": 0.1}}, Imperfect(gain_drift_per_s=0.1)),
    "Dahl": ({"friction": {"presliding_m": 3e-4}}, Imperfect(presliding_m=3e-4)),
    "LuGre": (
        {"friction": {"presliding_m": 1e-4, "bristle_damping_n_s_per_m": 3.0, "stribeck_excess": 1.0}},
        Imperfect(presliding_m=1e-4, bristle_n_s_per_m=3.0, excess=1.0),
    ),
    "Stribeck": ({"friction": {"stribeck_excess": 1.0}}, Imperfect(excess=1.0)),
    "suspension": (
        {"suspension": {"stiffness_n_per_m": 790.0, "cubic_n_per_m3": 9.5e4}},
        Imperfect(suspension=(790.0, 9.5e4)),
    ),
    "force factor": ({"force_factor": {"drop": 0.3}}, Imperfect(drop=0.3)),
    "pitch": ({"pitch": {"frequency_hz": 30.0}}, Imperfect(pitch_hz=30.0)),
    "transverse": (
        {
            "pitch": {"frequency_hz": 30.0},
            "guides": {"lateral_share": 0.05},
            "channels": {"transverse_sensitivity": [0.03, -0.02, 0.05]},
        },
        Imperfect(pitch_hz=30.0, lateral=0.05, transverse=(0.03, -0.02, 0.05)),
    ),
    "corners": (
        {"channels": {"high_pass_error": [0.2, -0.2, 0.1], "low_pass_error": [-0.2, 0.1, 0.2]}},
        Imperfect(
            high_pass_hz=(0.024 * 1.2, 0.024 * 0.8, 0.024 * 1.1),
            low_pass_hz=(1549.0 * 0.8, 1549.0 * 1.1, 1549.0 * 1.2),
        ),
    ),
    "skew": ({"channels": {"skew_s": [2e-5, -5e-5, 1e-4]}}, Imperfect(skew_s=(2e-5, -5e-5, 1e-4))),
    "command skew": ({"converters": {"command_skew_s": -6e-5}}, Imperfect(command_skew_s=-6e-5)),
    "specimen": ({}, Imperfect(laws=[(i, one) for i in range(2) for one in BOTH[i]])),
    "deck, pitch and LuGre": (
        {"deck": {"frequency_hz": 60.0}, "pitch": {"frequency_hz": 30.0}, "friction": {"presliding_m": 3e-4}},
        Imperfect(coil_kg=1.5, deck_hz=60.0, pitch_hz=30.0, presliding_m=3e-4),
    ),
}


@pytest.mark.parametrize("name", ALONE)
def test_each_imperfection_agrees_with_an_adaptive_solver(name: str) -> None:
    """Samples, displacement and velocities within 1e-6 of their peaks."""
    stated, how = ALONE[name]
    physics = VirtualPhysics.model_validate({"specimen_laws": BOTH}) if name == "specimen" else PHYSICS
    info, command = ideal_info(latency_samples=1, high_pass_hz=0.024), command_of(400)
    wanted, place, velocity = solved(Table(PHYSICS, specimen(), how), command, DT_S, 1)
    samples, states, middle = run_plant(plant_of(stated, info, physics), info, command)
    accel = samples / info.channels[0].sensitivity_v_per_m_s2
    for c in range(3):
        assert peak(accel[c] - wanted[c]) < 1e-6 * peak(wanted[c]), c
        assert peak(middle[c] - velocity[c]) < 1e-6 * peak(velocity[c]), c
    assert peak(states[0] - place) < 1e-6 * peak(place)
