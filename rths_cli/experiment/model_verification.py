"""Does a stored model still describe the rig? A 20 s record at low level, before the model drives anything."""

from __future__ import annotations

import math

import numpy as np

from rths_cli.control.sensor_correction import recorrected
from rths_cli.experiment.identify_on_rig import probed
from rths_cli.experiment.real_rig_readiness import VERIFICATION
from rths_cli.experiment.setup import Progress, Setup
from rths_cli.findings import Finding
from rths_cli.identification import channel_signals, verdict
from rths_cli.identification.frequency_response import over_model
from rths_cli.identification.identify_specimen import without_staircase
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import Identification, LevelBand, SpecimenFit
from rths_cli.identification.specimen_fit import Motion, Start, fit_stretches

SEGMENTS = 5
HIGHEST_HZ = 40.0  # of the usual compared band: upper end of the bands that are verified
SIGMA = 3.0  # standard uncertainties that are added to an accepted change
SHARE, SHARE_UNSEEN, SHARE_ABOVE = 0.01, 0.06, 0.10  # accepted change in the band; without low level; above it
# Accepted changes of a mode, (df / f) / ratio and (d ratio) / ratio; both have the same effect at the table's zero.
FREQUENCY_SHARE, DAMPING_SHARE = 0.05, 0.05


def low_level_record(setup: Setup, known: Identification, progress: Progress) -> Record:
    """Play the model's record at low level again, before the table runs of a case, and return it."""
    setup = setup.calibrated(known)
    return probed(setup, progress, (VERIFICATION,), most_m_s2=known.low_level_m_s2 or math.inf)[1]


def read_with(setup: Setup, known: Identification, there: Identification, record: Record) -> Record:
    """Return a record that was corrected for the sensors of the model `known` as those of `there` correct it."""
    before, after = (setup.calibrated(each).rig.channels for each in (known, there))
    accel = recorrected(record.accel_m_s2, before, after, setup.rig.dt_s)
    return Record(record.command_v, accel, record.parts, record.further)


def compared(setup: Setup, known: Identification, record: Record) -> tuple[tuple[Finding, ...], Finding]:
    """Compare a low-level record, corrected for the model's sensors, with the model.

    Returns the reasons why the model must not be used, and a finding on the comparison. Because of friction the
    response at low level differs from that at full level. If the identification had a record at low level, the two
    records at low level are compared, and the new one is played at the level of the first.
    """
    setup = setup.calibrated(known)
    faults = channel_signals.signal_faults(record, setup.rig)
    if faults:
        return tuple(faults), Finding("verification.unusable")
    changes = changed_bands(known, record)
    reasons = [_changed_band(band, change) for band, change, allowed in changes if not change <= allowed]
    reasons += specimen_changes(setup, known, record)
    worst = max((change for band, change, _ in changes if band.high_hz <= known.compared.high_hz), default=0.0)
    return tuple(reasons), Finding("verification.agrees", {"change": worst, "to_hz": known.compared.high_hz})


def changed_bands(known: Identification, record: Record) -> list[tuple[LevelBand, float, float]]:
    """Return for each band the ratio of the new record to the model, the change, and the accepted change.

    If the model has a record at low level, the ratio is relative to that record.
    """
    length_s = (record.parts.noise.stop - record.parts.noise.start) * known.best.dt_s
    now = over_model(known.best, [record], known.best.band_hz, length_s / SEGMENTS)
    then = {band.low_hz: band for band in known.levels}
    found = []
    for band in verdict.level_bands(now, None, known.compared):
        if band.high_hz > known.compared.with_high(HIGHEST_HZ):
            continue
        before = then.get(band.low_hz)
        ratio = band.ratio / (before.ratio if before else 1.0)
        error = float(np.hypot(band.error, before.error if before else 0.0))
        share = SHARE if before else SHARE_UNSEEN
        share = share if band.high_hz <= known.compared.high_hz else SHARE_ABOVE
        found.append((band, abs(ratio - 1.0), share + SIGMA * error))
    return found


def _changed_band(band: LevelBand, change: float) -> Finding:
    return Finding("verification.table", {"change": change, "low_hz": band.low_hz, "high_hz": band.high_hz})


def specimen_changes(setup: Setup, known: Identification, record: Record) -> list[Finding]:
    """Return a finding for each mode of the specimen that has changed, from the record at low level if the model has
    one: a specimen whose springs bend and joints rub has other modes at another level."""
    before = known.low_level or known.specimen
    if before is None:
        return []
    now, of_record = seen_specimen(setup, known, record), float(known.low_level is not None)
    found = []
    for mode in range(len(before.natural_frequency_hz)):
        hz, was = now.natural_frequency_hz[mode], before.natural_frequency_hz[mode]
        ratio, ratio_was = now.damping_ratio[mode], before.damping_ratio[mode]
        hz_error = np.hypot(now.frequency_error_hz[mode], of_record * before.frequency_error_hz[mode])
        ratio_error = np.hypot(now.damping_error[mode], of_record * before.damping_error[mode])
        off = abs(hz - was) > FREQUENCY_SHARE * ratio_was * was + SIGMA * hz_error
        damped = abs(ratio - ratio_was) > DAMPING_SHARE * ratio_was + SIGMA * ratio_error
        if off or damped:
            values = {"mode": mode + 1, "now_hz": hz, "now_damping_ratio": ratio, "before_hz": was}
            found.append(Finding("verification.specimen", {**values, "before_damping_ratio": ratio_was}))
    return found


def seen_specimen(setup: Setup, known: Identification, record: Record) -> SpecimenFit:
    """Return the specimen fitted to a record, starting from the known one."""
    assert known.specimen is not None
    table = without_staircase(record.accel_m_s2[0], record.command_v, known.best)
    motion = Motion(table, record.accel_m_s2[1:]).cut(record.parts.noise)
    first = Start(known.specimen.stiffness_n_per_m, known.specimen.damping_ratio)
    masses = known.specimen.specimen.masses_kg
    return fit_stretches([motion], setup.rig.dt_s, masses, known.best.band_hz[0], first, free=False)
