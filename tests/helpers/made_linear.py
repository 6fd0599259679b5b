"""Records that a linear table and its specimen give by their equations of motion: any excitation, any noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from made_records import make_info, true_response

from rths_cli.identification.excitation import ExcitationSettings, Kind, plan
from rths_cli.identification.record_parts import Record
from rths_cli.numerics.lti import Array, ComplexArray
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen

DT = 5e-4
REST_SAMPLES = 20000
NOISE_M_S2 = 1e-3


def transmissibility(specimen: Specimen, frequency_hz: Array) -> ComplexArray:
    """Return absolute floor over table acceleration (n, m), from the dynamic stiffness."""
    s = (2j * np.pi * frequency_hz)[:, None, None]
    dynamic = s**2 * np.diag(specimen.masses_kg) + s * specimen.C + specimen.K
    relative = np.linalg.solve(dynamic, -np.tile(specimen.masses_kg[:, None], (len(frequency_hz), 1, 1)))[..., 0]
    return (1.0 + s[:, :, 0] ** 2 * relative).T


def played(specimen: Specimen, command_v: Array, seed: int = 0, noise_m_s2: float = NOISE_M_S2) -> Array:
    """Return the accelerations (c, n) in m/s^2 of table and floors, below 100 Hz, with white noise on each."""
    n = len(command_v)
    spectrum = np.fft.rfft(command_v, n + REST_SAMPLES)
    frequency = np.fft.rfftfreq(n + REST_SAMPLES, DT)
    low = frequency < 100.0
    table = spectrum[low] * true_response(specimen, frequency[low])
    lines = np.zeros((1 + len(specimen.masses_kg), len(frequency)), dtype=complex)
    lines[:, low] = np.vstack([table, table * transmissibility(specimen, frequency[low])])
    accel = np.fft.irfft(lines, n + REST_SAMPLES)[:, :n]
    return np.asarray(accel + noise_m_s2 * np.random.default_rng(seed).standard_normal(accel.shape))


@dataclass(frozen=True)
class Linear:
    """A record of the linear table, and whose it is."""

    info: RigInfo
    specimen: Specimen
    record: Record


def linear(specimen: Specimen, kind: Kind = "noise", seed: int = 3, duration_s: float = 60.0) -> Linear:
    """Return what the linear table answers to a planned excitation."""
    info = make_info(specimen)
    planned = plan(info, ExcitationSettings(duration_s=duration_s, kind=kind), seed)
    accel = played(specimen, planned.command_v, seed)
    return Linear(info, specimen, Record(planned.command_v, accel, planned.parts))
