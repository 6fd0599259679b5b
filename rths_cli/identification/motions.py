"""The specimen from an identification's records: their motions, its fits to them, and whether channels are in step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.identification.doubts import AGREE_SIGMA
from rths_cli.identification.evidence import Evidence
from rths_cli.identification.found import SpecimenFit
from rths_cli.identification.record import Record
from rths_cli.identification.skew import skew
from rths_cli.identification.specimen import Motion, Start, fit_specimen, fit_stretches, storey_start
from rths_cli.lti import Array, Frf, Model

START_HZ = 30.0
MOST_SKEW, SEEN_SKEW = 0.25, 0.05  # samples between floors and table: refused, said
ENOUGH = 120_000  # samples for a first look


def without_staircase(table_accel: Array, command_v: Array, model: Model) -> Array:
    """Return the table's samples (n,) in m/s^2 less the alias of the command's staircase, (n,) in V.

    Before the record the command is taken as held.
    """
    late, count = max(model.latency_samples, 1), len(command_v)
    moved = np.concatenate([np.zeros(late + 1), command_v - command_v[0]])
    now, before = moved[1 : count + 1], moved[:count]
    return table_accel - model.ripple_m_s2_per_v * (now - before) - model.ripple_sum_m_s2_per_v * (now + before)


def motions(data: Evidence, model: Model | None, free: bool) -> list[Motion]:
    """Return table and floors during each record's excitation, or its free vibration, where it has one."""
    found = [_motion(record, model, free) for record in data.records]
    return [motion for motion in found if motion is not None]


def _motion(record: Record, model: Model | None, free: bool) -> Motion | None:
    """Return table and floors of one record, less the staircase alias a model knows."""
    part = record.parts.free_vibration if free else record.parts.noise
    if part is None:
        return None
    table = record.accel_m_s2[0]
    if model is not None:
        table = without_staircase(table, record.command_v, model)
    return Motion(table, record.accel_m_s2[1:]).cut(part)


def first_look(data: Evidence, frfs: Sequence[Frf]) -> Start:
    """Return first values of the specimen, from the responses up to 30 Hz and a minute of motion."""
    masses = data.masses_kg
    if len(masses) == 0:
        return Start(np.zeros(0), np.zeros(0))
    low = frfs[0].frequency_hz <= START_HZ
    floors = np.array([frf.response[low] for frf in frfs[1:]])
    start = storey_start(frfs[0].frequency_hz[low], frfs[0].response[low], floors, masses)
    return fit_motions(data, start, [motion.cut(slice(0, ENOUGH)) for motion in motions(data, None, free=False)])[0]


def fit_motions(data: Evidence, start: Start, seen: Sequence[Motion]) -> tuple[Start, float]:
    """Return the specimen fitted to the motions themselves, where no leakage does harm however light the damping, and
    what that leaves of the floors' motion, relative."""
    if len(data.masses_kg) == 0:
        return start, 0.0
    found = fit_specimen(seen, data.info.dt_s, data.masses_kg, data.settings.band_hz[0], start)
    return Start(found.stiffness_n_per_m, found.damping_ratio), found.residual


def specimen(data: Evidence, model: Model, start: Start | SpecimenFit | None, free: bool) -> SpecimenFit | None:
    """Return the specimen from the excitation or from the free vibration, None without either or without floors."""
    if start is None or len(data.masses_kg) == 0:
        return None
    seen = motions(data, model, free)
    if not seen:
        return None
    first = Start(start.stiffness_n_per_m, start.damping_ratio)
    return fit_stretches(seen, data.info.dt_s, data.masses_kg, data.settings.band_hz[0], first, free)


def out_of_step(data: Evidence, model: Model, found: SpecimenFit | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return reasons and warnings when the floors are out of step with the table."""
    if found is None:
        return (), ()
    dt_s, start = data.info.dt_s, Start(found.stiffness_n_per_m, found.damping_ratio)
    seen = [motion.cut(slice(0, ENOUGH)) for motion in motions(data, model, free=False)]
    late, error = skew(seen, dt_s, data.masses_kg, data.settings.band_hz[0], start)
    sentence = (
        f"channels: the floors are {abs(late):.2f} samples ({1e3 * abs(late) * dt_s:.3g} ms) "
        f"{'late' if late > 0.0 else 'early'} against the table; all must be sampled at one instant, and their sensors "
        "have the stated corners"
    )
    if abs(late) > MOST_SKEW + AGREE_SIGMA * error:
        return (sentence,), ()
    return (), ((sentence,) if abs(late) > SEEN_SKEW + AGREE_SIGMA * error else ())
