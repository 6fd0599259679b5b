"""What an identification finds: frozen data that a model file holds, a page shows and a controller is designed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.numerics.lti import Array, Frf, Model
from rths_cli.structure import Specimen


@dataclass(frozen=True)
class ChannelReport:
    """What a channel showed under excitation: rms and largest in m/s^2, rms at rest (None: no silence), median
    coherence in 0.7-11 Hz, amplitude of mains hum in m/s^2 at its frequency in Hz (0: none)."""

    name: str
    rms_m_s2: float
    largest_m_s2: float
    rest_rms_m_s2: float | None
    coherence: float
    hum_m_s2: float = 0.0
    hum_hz: float = 0.0


@dataclass(frozen=True)
class FitError:
    """Relative error |fit / FRF - 1| of a model: rms and largest in 0.7-11 Hz, rms in 2-10 Hz."""

    rms: float
    largest: float
    rms_mid: float


@dataclass(frozen=True)
class Friction:
    """Dry friction as a change of the command: size and its standard uncertainty in V.

    `velocity_rms_m_s`: of the table in the record; `explained`: share of the power of what the model leaves of the
    record, beside parts linear in the velocity; `scale_m_s`: v_s, below which sign(v) is smooth, to a factor of two.
    """

    command_v: float
    error_v: float
    velocity_rms_m_s: float
    explained: float
    scale_m_s: float

    @property
    def linear_s_per_m(self) -> float:
        """Return c: the model identified from this record already holds kappa c v."""
        return float(np.sqrt(2.0 / np.pi)) / self.velocity_rms_m_s

    def disturbance_v(self, velocity_m_s: Array) -> Array:
        """Return the command (n,) in V that friction adds to a table moving at a velocity (n,) in m/s.

        -kappa (sign(v) - c v): without the part kappa c v that the linear model holds since its identification.
        Friction acts at once, a command late by the delay: for a prediction instant by instant it is that much earlier.
        """
        sign = np.tanh(velocity_m_s / self.scale_m_s)
        return -self.command_v * (sign - self.linear_s_per_m * velocity_m_s)


@dataclass(frozen=True)
class Candidate:
    """A structure that was tried: its name, number of poles and finite zeros, and held-out error.

    `held_out`: rms of (model / FRF - 1) over the FRF's own standard error, fitted to one half of the data and taken
    on the other; 1 is all that the data can tell.
    """

    name: str
    poles: int
    zeros: int
    held_out: float
    chosen: bool = False


@dataclass(frozen=True)
class SpecimenFit:
    """Identified specimen of n floors relative to the table: a chain of storeys with modal damping.

    `stiffness_n_per_m`, `dashpots_n_s_per_m` (those of the storeys that give the same modal ratios),
    `natural_frequency_hz`, `damping_ratio` (n,) with their standard uncertainties `..._error`, and `mode_shapes`
    (n, n), a mode per column with its largest floor 1. `residual`: rms of what the fit does not explain over rms of the
    floors' accelerations. `frequency_scatter_hz`, `damping_scatter` (n,): standard deviation over stretches of the
    record (NaN before it was split).
    """

    specimen: Specimen
    stiffness_n_per_m: Array
    dashpots_n_s_per_m: Array
    natural_frequency_hz: Array
    damping_ratio: Array
    mode_shapes: Array
    stiffness_error_n_per_m: Array
    frequency_error_hz: Array
    damping_error: Array
    frequency_scatter_hz: Array
    damping_scatter: Array
    residual: float


@dataclass(frozen=True)
class Band:
    """Residual |model / FRF - 1| between two frequencies, rms and largest, the FRF's own standard error (rms) and
    the median coherence there."""

    low_hz: float
    high_hz: float
    rms: float
    largest: float
    scatter: float
    coherence: float


@dataclass(frozen=True)
class LevelBand:
    """Table's response at low level over that at full level, mean in a band, and its standard error."""

    low_hz: float
    high_hz: float
    ratio: complex
    error: float


@dataclass(frozen=True)
class LevelCauses:
    """What makes low and full level differ (see level_dependence.py): causes in the table, the likeliest first, and the
    storeys of the specimen, from 1, whose stiffness depends on the level; () where the data tell none."""

    table: tuple[str, ...] = ()
    storeys: tuple[int, ...] = ()


@dataclass(frozen=True)
class Root:
    """A pair of roots (or a single real one: ratio NaN) with standard uncertainties, NaN where they are not known."""

    kind: str
    frequency_hz: float
    damping_ratio: float
    frequency_error_hz: float
    damping_error: float


@dataclass(frozen=True)
class Verdict:
    """Whether a model may drive a table: fit for feedforward between two frequencies in Hz, (0, 0) if nowhere.

    `delay_s`: transport delay in the model; `lag_s`: phase lag of command to displacement at low frequency, as a time,
    delay included. `reasons` say why not; `warnings` what else to know.
    """

    accepted: bool
    feedforward_hz: tuple[float, float]
    delay_s: float
    lag_s: float
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class DelayEstimate:
    """Delay from command to table in s, as identified, with its standard uncertainty, and as the rig declares it
    (latency, half a sample of hold, transport)."""

    identified_s: float
    error_s: float
    declared_s: float


@dataclass(frozen=True)
class Identification:
    """All that records tell. `frfs`: responses from command to table (without leakage) and to each floor;
    `noise_floors`: what noise at rest alone would show in them (None: not known).

    `specimen` is from the excitation, `free_vibration` the same from the stretch of held command (None: there is
    none). `levels`: low against full level. `roots` are those of `best`, with uncertainties. `friction` is the table's
    (None: the records do not tell), `latency` the transport delay as the data see it.
    """

    frfs: tuple[Frf, ...]
    noise_floors: tuple[Array | None, ...]
    best: Model
    paper: Model
    best_error: FitError
    paper_error: FitError
    specimen: SpecimenFit | None
    free_vibration: SpecimenFit | None
    channels: tuple[ChannelReport, ...]
    candidates: tuple[Candidate, ...]
    roots: tuple[Root, ...]
    residuals: tuple[Band, ...]
    levels: tuple[LevelBand, ...]
    verdict: Verdict
    friction: Friction | None = None
    latency: DelayEstimate | None = None
    causes: LevelCauses = LevelCauses()

    @property
    def accepted(self) -> bool:
        """Tell whether the model may drive the table."""
        return self.verdict.accepted

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why it may not."""
        return self.verdict.reasons

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what else to know."""
        return self.verdict.warnings
