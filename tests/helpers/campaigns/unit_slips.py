"""Slips of units: every number of case, structure, rig and record, off by a factor against the rest of its file; and
right buildings and rigs drawn at random, which must not be doubted.

The factors are written here anew, so that a wrong one in the program does not hide."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rths_cli.case.load import PlacedSettings, WrittenCase, load_cases, load_written, read_case
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import modes_above_the_bands, record_above_the_band
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.experiment.unit_plausibility import doubts
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.numerics.shared_values import SharedValues

FACTORS = (9.81, 1e3, 1e6, 0.4536, 25.4)
NO_QUANTITY = (
    "seed", "records", "order", "bits", "latency_samples", "lost_samples", "laboratory", "port", "sign",
    "damping_levels",
)  # fmt: skip
"""Seeds, counts and signs, which have no unit: another one is another test, not the same in another unit. A case with a
damping of its own reads no level of its structure."""
SHIPPED = ("el_centro_low_ff_fb", "el_centro_base_isolated", "el_centro_viscous_damper", "el_centro_tuned_mass_damper")
REAL = ("udp_example", "ni_example")
GUARDED = ("table.limits.", "table.nominal.", "table.sensors.sensitivity", "table.sensors.range", "masses_kg")
"""Keys whose slip by a prefix switches a protection off, or makes another building."""
Place = tuple[str | int, ...]
G = 9.81


@dataclass(frozen=True)
class Slip:
    """A number or list of a base case that is off by a factor."""

    base: str
    key: str  # as in a case file, without the places in lists
    place: Place
    factor: float
    setting: str  # KEY=VALUE that puts the slip into the base case


@dataclass(frozen=True)
class Fate:
    """What became of a slip before anything moved: refused, doubted, doubted elsewhere (the doubt does not name the
    key), warned (another sentence names it), or silent."""

    slip: Slip
    found: str
    told: tuple[str, ...] = ()


def mapping_of(given: str | Mapping[str, Any], *settings: str) -> dict[str, Any]:
    """Return a case with everything that it names and all its defaults, as a mapping."""
    case = load_cases([given], settings)[0]
    about = {"path", "yaml_text", "reference", "rig_file", "stated", "places"}
    data = case.model_dump(mode="json", exclude=about, exclude_none=True)
    return {key: value for key, value in data.items() if value not in ({}, ())}


def bases(drawn: int) -> dict[str, dict[str, Any]]:
    """Return the base cases: shipped ones, one for each kind of real rig, and some drawn at random, by name."""
    found = {name: mapping_of(name) for name in SHIPPED}
    for rig in REAL:
        found[rig] = mapping_of("el_centro_low_ff_fb", f"table={rig}")
    return found | {f"right_{seed}": right_case(seed) for seed in range(drawn)}


def slips(base: str, data: Mapping[str, Any], folder: Path) -> Iterator[Slip]:
    """Yield every slip of a case: each number, each list as a whole, and the record's accelerations and times."""
    for place in _numbers(data, ()):
        if any(one in NO_QUANTITY for one in place):
            continue
        named = [one for one in place if isinstance(one, str)]
        above = list(place[: next((i for i, one in enumerate(place) if isinstance(one, int)), len(place))])
        for factor in _both_ways():
            whole: Any = copy.deepcopy(_at(data, above))
            below = place[len(above) :]
            if below:
                holder = _at(whole, below[:-1])
                holder[below[-1]] = _times(holder[below[-1]], factor)
            else:
                whole = _times(whole, factor)
            yield Slip(base, ".".join(named), place, factor, f"{'.'.join(map(str, above))}={json.dumps(whole)}")
    record = read_accelerogram(data["record"]["file"], data["record"].get("unit"), data["record"].get("dt_s"))
    for what in ("accelerations", "times"):
        for factor in _both_ways():
            accel = record.accel_m_s2 * (factor if what == "accelerations" else 1.0)
            dt_s = record.dt_s * (factor if what == "times" else 1.0)
            path = folder / f"{base}_{what}_{factor:.4g}.csv"
            columns = np.column_stack([dt_s * np.arange(len(accel)), accel])
            np.savetxt(path, columns, "%.9g", ",", header="time_s,accel_m_s2", comments="")
            yield Slip(base, "record", ("record", what), factor, f"record={json.dumps({'file': str(path)})}")


def _at(data: Any, place: Sequence[str | int]) -> Any:
    for one in place:
        data = data[one]
    return data


def _times(value: Any, factor: float) -> Any:
    return [factor * one for one in value] if isinstance(value, list) else factor * value


def _both_ways() -> tuple[float, ...]:
    return (*FACTORS, *(1.0 / factor for factor in FACTORS))


def _numbers(data: Any, place: Place) -> Iterator[Place]:
    """Yield the place of each number that is not 0, and of each list of such numbers as a whole."""
    if isinstance(data, bool) or data == 0:
        return
    if isinstance(data, int | float):
        yield place
    elif isinstance(data, Mapping):
        for key, value in data.items():
            yield from _numbers(value, (*place, key))
    elif isinstance(data, list):
        if len(data) > 1 and all(isinstance(one, int | float) and not isinstance(one, bool) for one in data):
            yield place
        for i, value in enumerate(data):
            yield from _numbers(value, (*place, i))


def fate_of(slip: Slip, written: WrittenCase, shared: SharedValues) -> Fate:
    """Return what the program says of a slip of a base case before anything is identified or moves; `shared`: motions
    and buildings of slips that leave them as they are."""
    try:
        setup = make_setup(load_written(written, PlacedSettings([slip.setting])), shared=shared)
    except InputError as error:
        return Fate(slip, "refused", error.faults)
    found = doubts(setup)
    told = tuple(one.sentence for one in found)
    if any(_names(key, slip) for one in found for key in (one.key, *one.others)):
        return Fate(slip, "doubted", told)
    warned = tuple(text for note in _warnings(setup) if slip.key in (text := str(note)))
    if warned:
        return Fate(slip, "warned", warned)
    return Fate(slip, "doubted elsewhere" if found else "silent", told)


def fates(data: Mapping[str, dict[str, Any]], folder: Path) -> Iterator[Fate]:
    """Yield what becomes of every slip of some base cases."""
    for name, case in data.items():
        written, shared = read_case(case), SharedValues()
        for slip in slips(name, case, folder):
            yield fate_of(slip, written, shared)


def factor_of(slip: Slip) -> float:
    """Return which of FACTORS a slip multiplies or divides by."""
    return next(one for one in FACTORS if np.isclose(slip.factor, one) or np.isclose(slip.factor, 1.0 / one))


def must_be_noticed(slip: Slip) -> bool:
    """Return whether a slip is one by a prefix, of a number on which a protection or the building depends."""
    return factor_of(slip) in (1e3, 1e6) and any(part in slip.key for part in GUARDED)


def right_doubts(seed: int) -> tuple[str, ...]:
    """Return the doubts on a right building on a right rig."""
    return tuple(one.sentence for one in doubts(make_setup(load_cases([right_case(seed)])[0])))


def _warnings(setup: Setup) -> list[str]:
    return [*modes_above_the_bands(setup), *record_above_the_band(setup)]


def _names(key: str, slip: Slip) -> bool:
    """Return whether a key of a doubt is that of the slip: the same, or the law that holds it."""
    plain = ".".join(part for part in re.split(r"[.\[\]]+", key) if part and not part.isdigit())
    return slip.key == plain or (plain.endswith(".law") and slip.key.startswith(plain))


def right_case(seed: int) -> dict[str, Any]:
    """Draw a right building on a right rig: tables of 1 kg to 2 t payload, 1 to 10 storeys, 0.5 to 30 Hz.

    Limits follow from the table: its force moves table and specimen, its stroke is what its command reaches.
    """
    random = np.random.default_rng((seed, 44))
    payload = _log_uniform(random, 1.0, 2000.0)
    rig = _right_rig(random, payload)
    floors, storeys = int(random.integers(1, 6)), int(random.integers(1, 6))
    masses = random.uniform(0.7, 1.0, floors)
    masses *= payload * random.uniform(0.15, 0.9) / masses.sum()
    own = np.full(storeys, masses.mean()) * random.uniform(0.5, 4.0) * random.uniform(0.8, 1.2, storeys)
    if random.random() < 0.4:  # a regular building: all floors alike
        masses, own = np.full(floors, masses.mean()), np.full(storeys, masses.mean())
    hz = _log_uniform(random, 0.5, 30.0)
    springs = np.linspace(1.0, random.uniform(0.4, 1.0), storeys + floors) * random.uniform(0.8, 1.25, storeys + floors)
    springs *= (2.0 * np.pi * hz / _first_rad_s(np.concatenate([own, masses]), springs)) ** 2
    critical = 2.0 * np.sqrt(own * springs[:storeys])
    peak_g = _log_uniform(random, 0.03, 0.5)
    record = str(random.choice(["el_centro", "hachinohe"]))
    case = {
        "name": f"right_{seed}",
        "structure": {
            "numerical": {"masses_kg": own.tolist(), "stiffness_n_per_m": springs[:storeys].tolist()},
            "experimental": {
                "masses_kg": masses.tolist(),
                "stiffness_n_per_m": springs[storeys:].tolist(),
                "damping_ratios": [_log_uniform(random, 0.003, 0.08)] * floors,
            },
        },
        "damping": {"dashpots_n_s_per_m": (critical * _log_uniform(random, 0.003, 0.1)).tolist()},
        "record": {"file": record},
        "scaling": peak_g / {"el_centro": 0.34, "hachinohe": 0.23}[record],
        "controller": str(random.choice(["FF+FB", "FF"])),
        "test_band_hz": float(min(max(12.0, 1.5 * hz), 40.0)),
        "sample_rate_hz": float(random.choice([1000.0, 2000.0, 4000.0])),
        "table": rig,
    }
    return mapping_of(case)


def _right_rig(random: np.random.Generator, payload: float) -> dict[str, Any]:
    moving = payload * _log_uniform(random, 0.25, 1.5)
    accel = G * float(random.choice([1.0, 1.5, 2.5, 4.0, 5.0])) * random.uniform(0.8, 1.0)
    stroke = _log_uniform(random, 0.015, 0.25)
    velocity = float(np.sqrt(stroke * accel)) * random.uniform(0.3, 0.85)
    range_v = float(random.choice([5.0, 10.0]))
    gain = stroke * random.uniform(1.0, 1.4) / range_v
    rated = random.uniform(0.0, 1.0)  # 0: the bare table reaches its acceleration, 1: with the whole payload
    force = accel * (moving + rated * payload) * random.uniform(1.0, 1.2)
    range_g = float(min(one for one in (2.0, 5.0, 10.0, 50.0) if one * G >= accel))
    full_scale = float(random.choice([0.4, 0.5, 0.8, 1.0])) * range_v
    loop_hz = random.uniform(5.0, 30.0)
    near = lambda: random.uniform(0.95, 1.05)  # noqa: E731
    return {
        "kind": "virtual",
        "name": "right",
        "sensors": {
            "sensitivity_mv_per_g": 1e3 * full_scale / range_g,
            "range_g": range_g,
            "high_pass_hz": float(random.choice([0.0, 0.024, 0.1])),
            "low_pass_hz": float(random.choice([0.0, 400.0, 1000.0, 3000.0])),
            "noise_rms_m_s2": range_g * G * _log_uniform(random, 3e-6, 1e-4),
        },
        "converters": {"bits": int(random.choice([16, 18, 24])), "range_v": range_v},
        "limits": {"stroke_m": stroke, "velocity_m_s": velocity, "acceleration_m_s2": accel, "force_n": force},
        "nominal": {"gain_m_per_v": gain, "moving_mass_kg": moving, "payload_kg": payload},
        "physics": {
            "moving_mass_kg": moving * near(),
            "viscous_n_s_per_m": force / velocity * _log_uniform(random, 2e-3, 5e-2),
            "coulomb_n": force * _log_uniform(random, 3e-4, 1e-2),
            "coulomb_velocity_m_s": velocity * 1e-3,
            "loop_frequency_hz": loop_hz,
            "loop_damping_ratio": random.uniform(0.4, 0.9),
            "actuator_time_constant_s": random.uniform(0.02, 0.2) / (2.0 * np.pi * loop_hz),
            "gain_m_per_v": gain * near(),
            "loop_specimen_mass_kg": payload * random.uniform(0.2, 0.9),
            "force_limit_n": force,
        },
    }  # fmt: skip


def _first_rad_s(masses: np.ndarray, springs: np.ndarray) -> float:
    upper = np.append(springs[1:], 0.0)
    K = np.diag(springs + upper) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    root = np.sqrt(masses)
    return float(np.sqrt(np.linalg.eigvalsh(K / np.outer(root, root))[0]))


def _log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))
