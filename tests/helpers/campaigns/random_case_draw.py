"""Draw legitimate hybrid tests at random: building, record, rig, sampling and controller, within what a rig carries."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.numerics.lti import Array
from rths_cli.structure import storey_matrix

RECORDS = ("el_centro", "hachinohe", "near_fault", "long_duration", "broadband")
RATES_HZ = (500.0, 640.0, 800.0, 1000.0, 1024.0, 2000.0, 4000.0)
MODES_HZ = (0.3, 60.0)
DAMPING_RATIOS = (0.002, 0.2)
SHARES = (0.08, 0.85)  # of the scaling at which SIM's interface and floors reach a limit of the table
DRAWS = 10_000  # of a chain until its modes lie in the band
RECORD_DT_S = 0.005


@dataclass(frozen=True)
class Drawn:
    """A random test: the case as a mapping with scaling 1, and the share of the limits that its motion is to take."""

    seed: int
    case: dict[str, object]
    share: float


def draw(seed: int, records: Path) -> Drawn:
    """Draw one test; `records` is the folder of the made ground motions."""
    random = np.random.default_rng((seed, 15))
    plain = random.random() < 0.4  # the default rig, but for its converters
    payload = 23.0 if plain else float(random.uniform(15.0, 60.0))
    floors = int(random.integers(1, 9))
    masses = _masses(random, floors, payload)
    stiffness = _chain(random, masses)
    ratios = log_uniform(random, *DAMPING_RATIOS) * 2.0 ** random.uniform(-1.0, 1.0, floors)
    storeys = int(random.integers(1, 7))
    own = masses.mean() * 2.0 ** random.uniform(0.0, 2.0, storeys)
    shape = random.uniform(0.5, 1.5, storeys)
    first = frequencies(own, shape)[0]
    hz = log_uniform(random, 1.0, 10.0)
    springs = shape * (2.0 * np.pi * hz / first) ** 2
    dashpots = springs * 2.0 * log_uniform(random, 0.005, 0.1) / (2.0 * np.pi * hz)
    room = payload - float(masses.sum())
    share = float(random.uniform(0.05, 0.6)) if random.random() < 0.3 else 0.0
    record = str(random.choice(RECORDS))
    case = {
        "name": f"random_{seed}",
        "structure": {
            "numerical": {"masses_kg": own.tolist(), "stiffness_n_per_m": springs.tolist()},
            "experimental": {
                "masses_kg": masses.tolist(),
                "stiffness_n_per_m": stiffness.tolist(),
                "damping_ratios": ratios.clip(*DAMPING_RATIOS).tolist(),
            },
            "interface_experimental_mass_kg": max(min(share * float(own[-1]), 0.999 * room), 0.0),
        },
        "damping": {"dashpots_n_s_per_m": dashpots.tolist()},
        "record": record if record in RECORDS[:2] else str(records / f"{record}.csv"),
        "scaling": 1.0,
        "controller": str(random.choice(["FF+FB", "FF", "none"], p=[0.5, 0.3, 0.2])),
        "method": "paper" if random.random() < 0.2 else "best",
        "integration": str(random.choice(["exact", "cr", "newmark"], p=[0.6, 0.2, 0.2])),
        "sample_rate_hz": float(random.choice(RATES_HZ)),
        "seed": seed,
        "runs": ["sim", "exp_rths"],
        "table": _default(random) if plain else varied_rig(random, float(masses.sum()), payload),
    }
    return Drawn(seed, case, float(log_uniform(random, *SHARES)))


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """Draw a number between two others, evenly in its logarithm."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _masses(random: np.random.Generator, floors: int, payload_kg: float) -> Array:
    """Return floor masses that weigh between a fifth and nearly all of the payload together."""
    parts = random.uniform(0.3, 1.0, floors)
    return parts / parts.sum() * payload_kg * random.uniform(0.2, 0.97)


def _chain(random: np.random.Generator, masses: Array) -> Array:
    """Return storey stiffnesses whose modes lie in MODES_HZ; one in ten has a storey 100 times softer than its others,
    where that leaves the lowest mode in the band."""
    for _ in range(DRAWS):
        shape = 2.0 ** random.uniform(-1.0, 1.0, len(masses))
        if random.random() < 0.1:
            shape[random.integers(len(masses))] *= 0.01
        relative = frequencies(masses, shape) / (2.0 * np.pi)
        lowest, highest = MODES_HZ[0] / relative[0], MODES_HZ[1] / relative[-1]
        if highest > lowest:
            return np.asarray(shape * log_uniform(random, lowest, highest) ** 2)
    raise AssertionError("no chain in the band")


def frequencies(masses: Array, stiffness: Array) -> Array:
    """Return natural frequencies in rad/s, ascending."""
    root = np.sqrt(masses)
    return np.sqrt(np.linalg.eigvalsh(storey_matrix(stiffness) / np.outer(root, root)))


def _converters(random: np.random.Generator) -> dict[str, object]:
    return {"bits": int(random.integers(12, 19)), "latency_samples": int(random.integers(0, 9))}


def _default(random: np.random.Generator) -> dict[str, object]:
    """Return the default rig with other converters and up to 6 N of friction."""
    friction = {} if random.random() < 0.5 else {"physics": {"coulomb_n": float(random.uniform(0.0, 6.0))}}
    return {"extends": "aps400_virtual", "converters": _converters(random), **friction}


def varied_rig(random: np.random.Generator, specimen_kg: float, payload_kg: float) -> dict[str, object]:
    """Return a rig with other physics, sensors and noise; its data sheet is right to a few per cent."""
    moving, gain, force = random.uniform(4.0, 12.0), random.uniform(0.006, 0.01), random.uniform(200.0, 450.0)
    return {
        "extends": "aps400_virtual",
        "physics": {
            "moving_mass_kg": moving,
            "viscous_n_s_per_m": random.uniform(4.0, 60.0),
            "coulomb_n": random.uniform(0.0, 6.0) if random.random() < 0.5 else random.uniform(0.0, 1.0),
            "coulomb_velocity_m_s": random.uniform(0.0005, 0.002),
            "loop_frequency_hz": random.uniform(9.0, 25.0),
            "loop_damping_ratio": random.uniform(0.35, 0.9),
            "actuator_time_constant_s": random.uniform(0.0005, 0.002),
            "gain_m_per_v": gain,
            "loop_specimen_mass_kg": specimen_kg * random.uniform(0.7, 1.3),
            "force_limit_n": force,
        },
        "sensors": {
            "noise_rms_m_s2": log_uniform(random, 5e-5, 1e-3),
            "high_pass_hz": float(random.choice([0.0, 0.024, 0.05, 0.1, 0.3])),
            "low_pass_hz": float(random.choice([0.0, 300.0, 800.0, 1549.0])),
        },
        "converters": _converters(random),
        "limits": {"force_n": force},
        "nominal": {
            "gain_m_per_v": gain * random.uniform(0.95, 1.05),
            "moving_mass_kg": moving * random.uniform(0.97, 1.03),
            "payload_kg": payload_kg,
        },
    }  # fmt: skip


def make_records(folder: Path) -> None:
    """Write the three ground motions that are made here, in m/s^2."""
    random = np.random.default_rng(1500)
    for name, (duration_s, signal) in {
        "near_fault": (20.0, _near_fault), "long_duration": (90.0, _long), "broadband": (30.0, _broadband)
    }.items():  # fmt: skip
        time_s = np.arange(0.0, duration_s, RECORD_DT_S)
        columns = np.column_stack([time_s, signal(time_s, random)])
        np.savetxt(folder / f"{name}.csv", columns, "%.8g", ",", header="time_s,accel_m_s2", comments="")


def _near_fault(time_s: Array, random: np.random.Generator) -> Array:
    """Return a velocity pulse of 1.6 s (Mavroeidis and Papageorgiou 2003, in shape), a little noise, a quiet tail."""
    late = time_s - 5.0
    pulse = np.cos(2.0 * np.pi * 0.6 * late) * np.where(np.abs(late) < 1.7, 1.0 + np.cos(np.pi * late / 1.7), 0.0)
    rise = np.minimum(time_s / 0.5, 1.0)
    return np.gradient(0.3 * pulse, time_s) + 0.1 * rise * _noise(time_s, random, 0.5, 12.0) * np.exp(-time_s / 3.0)


def _long(time_s: Array, random: np.random.Generator) -> Array:
    rise = np.minimum(time_s / 15.0, 1.0) * np.minimum((time_s[-1] - time_s) / 30.0, 1.0)
    return 0.6 * rise * _noise(time_s, random, 0.3, 6.0)


def _broadband(time_s: Array, random: np.random.Generator) -> Array:
    return 0.8 * np.minimum(time_s / 2.0, 1.0) * np.exp(-time_s / 15.0) * _noise(time_s, random, 0.4, 15.0)


def _noise(time_s: Array, random: np.random.Generator, low_hz: float, high_hz: float) -> Array:
    """Return Gaussian noise (n,) of rms 1 in a band."""
    f = np.fft.rfftfreq(len(time_s), RECORD_DT_S)
    lines = np.fft.rfft(random.standard_normal(len(time_s))) * ((f >= low_hz) & (f <= high_hz))
    noise = np.fft.irfft(lines, len(time_s))
    return np.asarray(noise / noise.std())
