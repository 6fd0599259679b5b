"""All inputs of one identification in one record (`Evidence`): records, rig, masses, settings; checked to fit
together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.findings import Finding
from rths_cli.identification import channel_signals
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.frequency_response import Estimator
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import FitError
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

SHORTEST_S = 4.0  # shortest segment of a sweep; a shorter one has too few lines for a model
BAND_HZ, PAPER_BAND_HZ = (0.5, 60.0), (0.5, 12.0)  # of the usual compared band: where the models are fitted
SEGMENTS = 5  # a short record is cut into this many segments without overlap


@dataclass(frozen=True)
class IdentificationSettings:
    """How records are evaluated."""

    band_hz: tuple[float, float] = BAND_HZ  # of the fit of the best model
    paper_band_hz: tuple[float, float] = PAPER_BAND_HZ  # of the fit of the paper's model
    segment_s: float = 20.0  # length of the Hann segments; shorter in short records
    estimator: Estimator = "h1"
    latency_in_roots: bool = False  # whether roots represent the latency instead of an explicit delay
    sensors_removed: bool = True  # whether the records are corrected for the sensors' corners
    like_noise: bool = True  # whether the excitation acts on friction like noise, so that friction can be judged
    most: FitError = LIMITS  # largest errors of an accepted fit
    compared: ComparedBand = USUAL  # band in which the models are compared with the data
    heights_m: tuple[float, ...] | None = None  # of the specimen's storeys; None: all the same
    excited_hz: float = 0.5  # lowest excited frequency; only for a soft specimen the bands are lowered, down to here


@dataclass(frozen=True)
class Evidence:
    """The records of an identification, with the rig, the floor masses and the settings that belong to them."""

    records: tuple[Record, ...]  # at full level
    quiet: Record | None  # at low level
    info: RigInfo
    masses_kg: Array  # (c - 1,) weighed masses of the floors
    settings: IdentificationSettings
    longest_s: float  # longest segment that the records allow

    def up_to(self, high_hz: float) -> Evidence:
        """Return the same evidence with the band ending at `high_hz`."""
        return replace(self, settings=replace(self.settings, band_hz=(self.settings.band_hz[0], high_hz)))

    def down_to(self, low_hz: float) -> Evidence:
        """Return the same evidence with both bands lowered to begin at `low_hz`, as far as the records are excited."""
        low = max(low_hz, self.settings.excited_hz)
        (best, high), (paper, paper_high) = self.settings.band_hz, self.settings.paper_band_hz
        bands = (min(low, best), high), (min(low, paper), paper_high)
        return replace(self, settings=replace(self.settings, band_hz=bands[0], paper_band_hz=bands[1]))

    @property
    def level_ratio(self) -> float:
        """Return the table's rms at full level over that at low level; infinite without a record at low level."""
        if self.quiet is None:
            return float("inf")
        return level_ratio(self.records, self.quiet)


def level_ratio(records: Sequence[Record], quiet: Record) -> float:
    """Return the table's rms in the records at full level, their mean, over that in the record at low level."""
    loud = float(np.mean([record.accel_m_s2[0, record.parts.noise].std() for record in records]))
    return loud / float(quiet.accel_m_s2[0, quiet.parts.noise].std())


def evidence(
    records: Sequence[Record], quiet: Record | None, info: RigInfo, floor_masses_kg: Array,
    settings: IdentificationSettings,
) -> Evidence:  # fmt: skip
    """Return records and settings together, with the segment length adapted to the records.

    Raises InputError where records do not fit the rig, UnfitRecord where channels cannot be used.
    """
    masses = np.asarray(floor_masses_kg, dtype=float)
    check(records, info, masses, settings.compared)
    shortest = min(r.parts.noise.stop - r.parts.noise.start for r in records) * info.dt_s
    suited = [max(r.parts.segment_samples * info.dt_s, SHORTEST_S) for r in records if r.parts.segment_samples]
    longest = min(settings.segment_s, shortest / SEGMENTS)
    settings = replace(settings, segment_s=min([longest, *suited]))
    return Evidence(tuple(records), quiet, info, masses, settings, longest)


def check(records: Sequence[Record], info: RigInfo, masses: Array, compared: ComparedBand = USUAL) -> None:
    """Raise InputError where records do not fit the rig, UnfitRecord where channels cannot be used."""
    wanted = len(info.channels)
    faults = [
        f"record: {record.accel_m_s2.shape} samples do not fit {wanted} channels and {len(record.command_v)} commands; "
        "give one row per channel of the rig"
        for record in records
        if record.accel_m_s2.shape != (wanted, len(record.command_v))
    ]
    if len(masses) != wanted - 1 or not np.all(masses > 0.0):
        faults.append(f"masses_kg: {masses.tolist()} must be one positive mass for each of {wanted - 1} floors")
    if faults:
        raise InputError(*faults)
    found: list[Finding] = []
    for number, record in enumerate(records, 1):
        of_record = channel_signals.signal_faults(record, info)
        found += [one.at("at.record", record=number) for one in of_record] if len(records) > 1 else of_record
    if found:
        raise UnfitRecord(found, channel_signals.reports(records, None, info, compared))
