"""What an identification is made from, in one hand: records, rig, weighed masses and settings that fit together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification import channel_signals
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.frequency_response import Estimator
from rths_cli.identification.records import Record
from rths_cli.identification.results import FitError
from rths_cli.identification.verdict import LIMITS
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo

SHORTEST_S = 4.0  # segment of a sweep, or its lines are too few for a model
SEGMENTS = 5  # a short record is cut into so many segments that do not overlap


@dataclass(frozen=True)
class IdentificationSettings:
    """Bands in Hz of both models, length of the Hann segments (less in short records), the estimator, whether the
    best model's roots carry the latency or an explicit delay does, whether the sensors' corners are out of the records,
    whether the excitation acts on friction like noise, and the errors that its fit must keep. `excited_hz`: from where
    on the records are excited; the bands begin no lower, and there only for a specimen that is as soft."""

    band_hz: tuple[float, float] = (0.5, 60.0)
    paper_band_hz: tuple[float, float] = (0.5, 12.0)
    segment_s: float = 20.0
    estimator: Estimator = "h1"
    latency_in_roots: bool = False
    sensors_removed: bool = True
    like_noise: bool = True
    most: FitError = LIMITS
    excited_hz: float = 0.5


@dataclass(frozen=True)
class Evidence:
    """Records at full level, one at low level (None: there is none) and the rig; its floors weigh `masses_kg` (c - 1,).

    `settings` say how they are evaluated; `longest_s` is the longest segment that they allow.
    """

    records: tuple[Record, ...]
    quiet: Record | None
    info: RigInfo
    masses_kg: Array
    settings: IdentificationSettings
    longest_s: float

    def up_to(self, high_hz: float) -> Evidence:
        """Return the same with a band that ends there."""
        return replace(self, settings=replace(self.settings, band_hz=(self.settings.band_hz[0], high_hz)))

    def down_to(self, low_hz: float) -> Evidence:
        """Return the same with bands that begin there, where they began higher and the records are excited there."""
        low = max(low_hz, self.settings.excited_hz)
        (best, high), (paper, paper_high) = self.settings.band_hz, self.settings.paper_band_hz
        bands = (min(low, best), high), (min(low, paper), paper_high)
        return replace(self, settings=replace(self.settings, band_hz=bands[0], paper_band_hz=bands[1]))

    @property
    def level_ratio(self) -> float:
        """Return how much louder the records are than the quiet one, by the table's rms."""
        if self.quiet is None:
            return float("inf")
        loud = float(np.mean([record.accel_m_s2[0, record.parts.noise].std() for record in self.records]))
        return loud / float(self.quiet.accel_m_s2[0, self.quiet.parts.noise].std())


def evidence(
    records: Sequence[Record], quiet: Record | None, info: RigInfo, floor_masses_kg: Array,
    settings: IdentificationSettings,
) -> Evidence:  # fmt: skip
    """Return records and settings with a segment length that suits them.

    Raises InputError where records do not fit the rig, UnfitRecord where channels cannot be used.
    """
    masses = np.asarray(floor_masses_kg, dtype=float)
    check(records, info, masses)
    shortest = min(r.parts.noise.stop - r.parts.noise.start for r in records) * info.dt_s
    suited = [max(r.parts.segment_samples * info.dt_s, SHORTEST_S) for r in records if r.parts.segment_samples]
    longest = min(settings.segment_s, shortest / SEGMENTS)
    settings = replace(settings, segment_s=min([longest, *suited]))
    return Evidence(tuple(records), quiet, info, masses, settings, longest)


def check(records: Sequence[Record], info: RigInfo, masses: Array) -> None:
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
    for number, record in enumerate(records, 1):
        where = f"record {number}: " if len(records) > 1 else ""
        faults += [where + fault for fault in channel_signals.signal_faults(record, info)]
    if faults:
        raise UnfitRecord(faults, channel_signals.reports(records, None, info))
