"""From an excited record to what is known of table and specimen: responses, models, modal properties, verdict."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.fit_table import FitError, fit_best, fit_error, fit_paper, refit_best
from rths_cli.identification.frf import estimate, without_leakage
from rths_cli.identification.record import Parts
from rths_cli.identification.specimen import SpecimenFit, Start, fit_specimen, modal, storey_start
from rths_cli.lti import Array, Frf, Model
from rths_cli.rig_info import RigInfo

LIMITS = FitError(rms=0.01, largest=0.03, rms_mid=0.004)
LEAST_COHERENCE = 0.9  # median in COMPARED_HZ
COMPARED_HZ = (0.7, 11.0)
DEAD_BITS, DEAD_OVER_SILENCE = 3.0, 3.0
CLIPPED_SHARE = 0.98
START_HZ = 30.0
SEGMENTS = 5  # a short record is cut into so many segments that do not overlap
MOST_ROUNDS, CONVERGED = 8, 5e-4  # of taking out leakage; change of the model in 0.7-11 Hz that ends them
FREE_DIFFERENCE, FREE_DAMPING_DIFFERENCE = 0.01, 0.2


@dataclass(frozen=True)
class IdentificationSettings:
    """Bands in Hz of both models, length of the Hann segments (less in short records), and the errors that the best
    model's fit must keep."""

    band_hz: tuple[float, float] = (0.5, 60.0)
    paper_band_hz: tuple[float, float] = (0.5, 12.0)
    segment_s: float = 20.0
    most: FitError = LIMITS


@dataclass(frozen=True)
class Identification:
    """All that a record tells. `frfs`: H1 from command to table (without leakage) and to each floor.

    `specimen` is from noise, `free_vibration` the same from the stretch of held command (None: the record has none, or
    there are no floors). `noise_rms_m_s2` (c,) is that of the silence. `accepted` is False, with `reasons`, when the
    best model misses its limits; `warnings` are sentences.
    """

    frfs: tuple[Frf, ...]
    best: Model
    paper: Model
    best_error: FitError
    paper_error: FitError
    specimen: SpecimenFit | None
    free_vibration: SpecimenFit | None
    noise_rms_m_s2: Array | None
    accepted: bool
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]


def identify(
    command_v: Array, corrected: Array, info: RigInfo, floor_masses_kg: Array, parts: Parts,
    settings: IdentificationSettings | None = None,
) -> Identification:  # fmt: skip
    """Identify table and specimen from the command (n,) in V and corrected accelerations (c, n) in m/s^2.

    `floor_masses_kg` (c - 1,) are weighed. Raises InputError for records that do not fit together, dead or clipped
    channels and poor coherence.
    """
    settings = settings or IdentificationSettings()
    masses = np.asarray(floor_masses_kg, dtype=float)
    check(command_v, corrected, info, masses, parts)
    noise = command_v[parts.noise]
    segment_s = min(settings.segment_s, len(noise) * info.dt_s / SEGMENTS)
    frfs = estimate(noise, corrected[:, parts.noise], info.dt_s, settings.band_hz, segment_s)
    check_coherence(frfs, info)
    start = _start(frfs, masses)
    best, table_frf = _table(frfs[0], start, masses, info, settings, command_v, corrected[0], parts.noise)
    paper = fit_paper(table_frf, best, settings.paper_band_hz)
    moved = np.vstack([without_staircase(corrected[0], command_v, best), corrected[1:]])
    specimen = _specimen(moved, parts.noise, info, masses, settings, start)
    free = _specimen(moved, parts.free_vibration, info, masses, settings, specimen)
    best_error = fit_error(best, table_frf)
    reasons = _misses(best_error, settings.most)
    return Identification(
        frfs=(table_frf, *frfs[1:]),
        best=best,
        paper=paper,
        best_error=best_error,
        paper_error=fit_error(paper, table_frf),
        specimen=specimen,
        free_vibration=free,
        noise_rms_m_s2=None if parts.silence is None else corrected[:, parts.silence].std(axis=1),
        accepted=not reasons,
        reasons=reasons,
        warnings=_differences(specimen, free),
    )


def check(command_v: Array, corrected: Array, info: RigInfo, masses: Array, parts: Parts) -> None:
    """Raise one InputError with every fault of a record."""
    channels = len(info.channels)
    faults = []
    if corrected.shape != (channels, len(command_v)):
        faults.append(
            f"record: {corrected.shape} samples do not fit {channels} channels and {len(command_v)} commands; give "
            "one row per channel of the rig"
        )
    if len(masses) != channels - 1 or not np.all(masses > 0.0):
        faults.append(f"masses_kg: {masses.tolist()} must be one positive mass for each of {channels - 1} floors")
    if faults:
        raise InputError(*faults)
    if not (np.isfinite(command_v).all() and np.isfinite(corrected).all()):
        raise InputError("record: some samples are not numbers; the record ends early or a channel was lost")
    for channel in range(channels):
        faults.extend(_channel_faults(channel, corrected[channel], info, parts))
    if faults:
        raise InputError(*faults)


def _channel_faults(index: int, accel: Array, info: RigInfo, parts: Parts) -> list[str]:
    """Return sentences on a channel that is dead or clipped."""
    channel = info.channels[index]
    rms = float(accel[parts.noise].std())
    quiet = float(accel[parts.silence].std()) if parts.silence is not None else 0.0
    least = max(DEAD_BITS * info.converters.step_v / channel.sensitivity_v_per_m_s2, 1e-9)
    if rms < least:
        return [
            f"channel {channel.name}: dead, {rms:.2g} m/s^2 rms under excitation where at least {least:.2g} is "
            "expected; check sensor, cable and power"
        ]
    if rms < DEAD_OVER_SILENCE * quiet:
        return [
            f"channel {channel.name}: nothing but noise, {quiet:.2g} m/s^2 rms at rest and {rms:.2g} under excitation; "
            "check sensor and cable, or excite louder"
        ]
    largest = float(np.abs(accel).max())
    if largest > CLIPPED_SHARE * channel.range_m_s2:
        return [
            f"channel {channel.name}: clipped, {largest:.4g} m/s^2 reaches the sensor's range of "
            f"{channel.range_m_s2:.4g}; lower identification.accel_rms_m_s2"
        ]
    return []


def check_coherence(frfs: tuple[Frf, ...], info: RigInfo) -> None:
    """Raise InputError when the median coherence of a channel is below 0.9 in 0.7-11 Hz."""
    faults = []
    for channel, frf in zip(info.channels, frfs, strict=True):
        inside = (frf.frequency_hz >= COMPARED_HZ[0]) & (frf.frequency_hz <= COMPARED_HZ[1])
        median = float(np.median(frf.coherence[inside]))
        if median < LEAST_COHERENCE:
            faults.append(
                f"channel {channel.name}: median coherence {median:.2f} in {COMPARED_HZ[0]:g}-{COMPARED_HZ[1]:g} Hz is "
                f"below {LEAST_COHERENCE:g}; excite louder or longer, and check the sensor"
            )
    if faults:
        raise InputError(*faults)


def without_staircase(table_accel: Array, command_v: Array, model: Model) -> Array:
    """Return the table's samples (n,) in m/s^2 less the alias of the command's staircase, (n,) in V."""
    late = max(model.latency_samples, 1)
    change = np.diff(command_v, prepend=command_v[:1])
    return table_accel - model.ripple_m_s2_per_v * np.concatenate([np.zeros(late), change[:-late]])


def _start(frfs: tuple[Frf, ...], masses: Array) -> Start:
    """Return first values of the specimen from the responses up to 30 Hz."""
    if len(masses) == 0:
        return Start(np.zeros(0), np.zeros(0))
    low = frfs[0].frequency_hz <= START_HZ
    floors = np.array([frf.response[low] for frf in frfs[1:]])
    return storey_start(frfs[0].frequency_hz[low], frfs[0].response[low], floors, masses)


def _table(
    frf: Frf, start: Start, masses: Array, info: RigInfo, settings: IdentificationSettings,
    command_v: Array, table_accel: Array, noise: slice,
) -> tuple[Model, Frf]:  # fmt: skip
    """Return the best model and the FRF it was fitted to: each round takes out the leakage the last model shows."""
    omega = modal(masses, start.stiffness_n_per_m)[0] if len(masses) else np.zeros(0)
    modes = (omega / (2.0 * np.pi), start.damping_ratio)
    best, clean = fit_best(frf, modes, info.latency_samples, info.dt_s, settings.band_hz), frf
    for _ in range(MOST_ROUNDS):
        clean = without_leakage(frf, best, command_v, table_accel, noise)
        before, best = best, refit_best(clean, best)
        if fit_error(best, replace(clean, response=before.sampled_response(clean.frequency_hz))).largest < CONVERGED:
            break
    return best, clean


def _specimen(
    moved: Array, part: slice | None, info: RigInfo, masses: Array, settings: IdentificationSettings,
    start: Start | SpecimenFit | None,
) -> SpecimenFit | None:  # fmt: skip
    """Return the specimen of one part of the record, None without part or floors."""
    if part is None or start is None or len(masses) == 0:
        return None
    first = Start(start.stiffness_n_per_m, start.damping_ratio)
    return fit_specimen(moved[0, part], moved[1:, part], info.dt_s, masses, settings.band_hz[0], first)


def _misses(error: FitError, most: FitError) -> tuple[str, ...]:
    """Return a sentence for each limit that the fit misses."""
    rows = (
        ("rms in 0.7-11 Hz", error.rms, most.rms),
        ("largest in 0.7-11 Hz", error.largest, most.largest),
        ("rms in 2-10 Hz", error.rms_mid, most.rms_mid),
    )
    return tuple(
        f"table model: error |fit / FRF - 1|, {name}, is {value:.2%}, the limit is {limit:.2%}; excite longer or louder"
        for name, value, limit in rows
        if not value <= limit
    )


def _differences(noise: SpecimenFit | None, free: SpecimenFit | None) -> tuple[str, ...]:
    """Return a sentence for each mode that noise and free vibration see differently."""
    if noise is None or free is None:
        return ()
    return tuple(
        f"specimen mode {mode + 1}: noise gives {noise.natural_frequency_hz[mode]:.3f} Hz and "
        f"{noise.damping_ratio[mode]:.2%}, free vibration {free.natural_frequency_hz[mode]:.3f} Hz and "
        f"{free.damping_ratio[mode]:.2%}; it is nonlinear, or the free vibration is too weak"
        for mode in range(len(noise.damping_ratio))
        if abs(free.natural_frequency_hz[mode] / noise.natural_frequency_hz[mode] - 1.0) > FREE_DIFFERENCE
        or abs(free.damping_ratio[mode] / noise.damping_ratio[mode] - 1.0) > FREE_DAMPING_DIFFERENCE
    )
