"""Records of chains on a shake table (own_plant.py), drawn at random or given, and faults put into their channels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from campaigns.own_plant import Array, Plant
from rths_cli.identification.record_parts import Parts, Record
from rths_cli.numerics.constants import STANDARD_GRAVITY_M_S2
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo, Uncertainty

MOST_RANGE = 0.7  # of a sensor
SILENCE_S, FADE_S, REST_S = 2.0, 2.0, 8.0
LOWEST_HZ, HIGHEST_HZ = 0.3, 60.0
DAMPING = (0.002, 0.2)
KINDS = ("sign", "gain", "swap", "reversed", "mass", "dead")


@dataclass(frozen=True)
class Chain:
    """A record of a plant, as a laboratory has it: what it knows of the rig, and the floors' masses (n,) in kg."""

    plant: Plant
    info: RigInfo
    record: Record
    masses_kg: Array


@dataclass(frozen=True)
class Fault:
    """A fault of channels (the table is 0): `sign`, `gain` (reads `factor` times what is true), `swap`, `reversed`,
    `dead`, `all` (signs); or `mass`, of which the true one is `factor` times the given one."""

    kind: str
    channels: tuple[int, ...]
    factor: float = 1.0


def made_chain(
    plant: Plant, rate_hz: float, bits: int, latency_samples: int, seed: int, noise_m_s2: float = 3e-4,
    level_m_s2: float = 2.0, duration_s: float = 90.0,
) -> Chain:  # fmt: skip
    """Return what shaped noise, of a nominal level in m/s^2 rms below 12 Hz, makes of a plant."""
    dt, random = 1.0 / rate_hz, np.random.default_rng(seed)
    names = ["table", *(f"floor_{floor + 2}" for floor in range(len(plant.masses_kg)))]
    g = STANDARD_GRAVITY_M_S2
    info = RigInfo(
        "own", "virtual", dt, tuple(Channel(name, 1.0 / g, 5.0 * g, 0.0, 0.0, uncertainty=0.0) for name in names),
        Converters(bits, 10.0), latency_samples, Limits(0.079, 1.0, 45.0, 445.0), 0.0079, 7.0,
        float(plant.masses_kg.sum()), uncertainty=Uncertainty(0.0, 0.0, 0.0),
    )  # fmt: skip
    command, parts = excitation(info, random, level_m_s2, duration_s)
    accel = plant.simulate(command, dt, latency_samples)
    share = float(np.abs(accel).max()) / info.channels[0].range
    if share > MOST_RANGE:  # quieter, as a probe would have it
        level_m_s2 *= MOST_RANGE / share
        command, parts = excitation(info, np.random.default_rng(seed), level_m_s2, duration_s)
        accel = plant.simulate(command, dt, latency_samples)
    accel += noise_m_s2 * random.standard_normal(accel.shape)
    bit = info.converters.step_v * g
    accel = bit * np.round(accel / bit) if bits else accel
    return Chain(plant, info, Record(command, accel, parts), plant.masses_kg)


def excitation(info: RigInfo, random: np.random.Generator, level_m_s2: float, duration_s: float) -> tuple[Array, Parts]:
    """Return a command (n,) in V between rests: flat to 0.7 Hz, falling as f^-1.5 to 12 Hz and as f^-3.5 above."""
    n = round(duration_s / info.dt_s)
    f = np.fft.rfftfreq(n, info.dt_s)
    shape = np.maximum(f / 0.7, 1.0) ** -1.5 * np.maximum(f / 12.0, 1.0) ** -2
    shape[(f < LOWEST_HZ) | (f > min(HIGHEST_HZ, 0.2 / info.dt_s))] = 0.0
    place = shape * (random.standard_normal(len(f)) + 1j * random.standard_normal(len(f)))
    accel = np.fft.irfft(np.where(f <= 12.0, place * (2.0 * np.pi * f) ** 2, 0.0), n)
    x = np.fft.irfft(place, n) * level_m_s2 / accel.std()
    x *= min(1.0, 0.6 * info.limits.stroke_m / np.abs(x).max()) / info.gain_m_per_v
    fade = round(FADE_S / info.dt_s)
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(fade) / fade)
    x[:fade] *= rise
    x[-fade:] *= rise[::-1]
    silence, rest = round(SILENCE_S / info.dt_s), round(REST_S / info.dt_s)
    bit = info.converters.step_v
    x = np.concatenate([np.zeros(silence), x, np.zeros(rest)])
    x = bit * np.round(x / bit) if bit else x
    return x, Parts(slice(silence + fade, silence + n - fade), slice(0, silence))


def injected(chain: Chain, fault: Fault) -> Chain:
    """Return the chain's record with a fault put in."""
    accel, masses, at = chain.record.accel_m_s2.copy(), chain.masses_kg.copy(), list(fault.channels)
    if fault.kind in ("sign", "all"):
        accel[at] *= -1.0
    elif fault.kind == "gain":
        accel[at] *= fault.factor
    elif fault.kind in ("swap", "reversed"):
        accel[at] = accel[at[::-1]]
    elif fault.kind == "dead":
        accel[at] = accel[at][:, :1] + 0.0 * accel[at]
    elif fault.kind == "mass":
        masses[at[0] - 1] /= fault.factor
    return replace(chain, record=replace(chain.record, accel_m_s2=accel), masses_kg=masses)


def drawn_plant(random: np.random.Generator) -> Plant:
    """Draw 1-8 floors with modes in 0.3-60 Hz and damping ratios of 0.2-20 %, a quarter with a far softer top storey,
    on a table of 10-40 Hz with dry friction of 0-6 N."""
    n = int(random.integers(1, 9))
    masses = random.uniform(1.0, 10.0, n)
    masses *= min(1.0, 40.0 / masses.sum())
    stiffness = 1e4 * random.uniform(0.3, 3.0, n)
    if n > 1 and random.random() < 0.25:
        stiffness[-1] *= 10.0 ** random.uniform(-3.0, 0.0)
    hz = Plant(masses, stiffness, np.full(n, 0.02)).natural_hz()
    first = np.exp(random.uniform(np.log(LOWEST_HZ), np.log(HIGHEST_HZ)))
    stiffness *= (np.clip(first, LOWEST_HZ, HIGHEST_HZ * hz[0] / hz[-1]) / hz[0]) ** 2
    ratios = np.exp(random.uniform(*np.log(DAMPING), n))
    return Plant(
        masses, stiffness, ratios, servo_hz=random.uniform(10.0, 40.0), servo_ratio=random.uniform(0.3, 1.0),
        lag_s=random.uniform(0.5e-3, 3e-3), suspension_n_per_m=790.0,
        coulomb_n=random.uniform(0.0, 6.0) if random.random() < 0.5 else 0.0,
    )  # fmt: skip


def drawn_fault(random: np.random.Generator, channels: int) -> Fault:
    """Draw a fault of a rig with so many channels: gains off by 5-50 %, masses by 10-50 %."""
    kinds = [kind for kind in KINDS if channels > 2 or kind not in ("reversed", "mass")]
    kind = str(random.choice(kinds))
    way = random.choice([-1.0, 1.0])
    if kind == "swap":
        one, other = sorted(random.choice(channels, 2, replace=False).tolist())
        return Fault(kind, (one, other))
    if kind == "reversed":
        return Fault(kind, tuple(range(1, channels)))
    if kind == "mass":
        return Fault(kind, (int(random.integers(1, channels)),), 1.0 + way * random.uniform(0.1, 0.5))
    factor = 1.0 + way * random.uniform(0.05, 0.5) if kind == "gain" else 1.0
    return Fault(kind, (int(random.integers(channels)),), factor)
