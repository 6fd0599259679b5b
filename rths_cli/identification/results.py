"""What an identification returns, as frozen data (`Identification`): models, uncertainties, verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from rths_cli.findings import Finding, sentences
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model
from rths_cli.structure import Specimen, storey_matrix
from rths_cli.structure.storey_laws import ElasticGap, Law, Laws, arranged
from rths_cli.structure.storey_laws import Friction as Joint

MOST_UNEXPLAINED = 2.0  # rms of what a session's change of sensors leaves, in units of the noise at rest
PITCH_SIGMA = 3.0  # standard uncertainties from which pitch is seen
LEAST_HELD_OUT = 0.5  # of the low-level record's power: what friction must remove to be countered
NO_LINES = "the model holds no lines of it, or no specimen"  # of the record at low level


@dataclass(frozen=True)
class ChannelReport:
    """Signal quality of a channel during the excitation."""

    name: str
    rms_m_s2: float
    largest_m_s2: float
    rest_rms_m_s2: float | None  # rms at rest; None without a silence
    coherence: float  # median in the compared band
    hum_m_s2: float = 0.0  # amplitude of the mains hum
    hum_hz: float = 0.0  # its frequency; 0: no hum
    # its zero in motion, which spreads the samples over the bits, beside its mean at rest; None: no silence
    zero_m_s2: float | None = None


@dataclass(frozen=True)
class FitError:
    """Relative error |fit / FRF - 1| of a model."""

    rms: float  # in the compared band
    largest: float  # in the compared band
    rms_mid: float  # in its middle


@dataclass(frozen=True)
class Friction:
    """Dry friction as an equivalent change of the command, -kappa sign(v)."""

    command_v: float  # kappa
    error_v: float  # its standard uncertainty
    velocity_rms_m_s: float  # of the table in the record
    explained: float  # fraction of the residual's power that friction explains, apart from terms linear in the velocity
    scale_m_s: float  # v_s, below which sign(v) is smooth; known to a factor of two
    # fraction of the residual's power at low level, of which the fit knew nothing, that it removes; None: not known
    held_out: float | None = None
    # friction in slip without an assumed law at reversals, and its standard uncertainty; None: not known
    sliding_v: float | None = None
    sliding_error_v: float | None = None

    @property
    def linear_s_per_m(self) -> float:
        """Return c in s/m; the model identified from this record already contains the linear part kappa c v."""
        return float(np.sqrt(2.0 / np.pi)) / self.velocity_rms_m_s

    @property
    def shown(self) -> bool:
        """Return whether a low-level record, of which the fit knew nothing, shows that countering it helps."""
        return self.held_out is not None and self.held_out >= LEAST_HELD_OUT

    @property
    def left(self) -> float:
        """Return the share of its disturbance that is expected to remain where it is countered."""
        return float(np.sqrt(max(1.0 - (self.held_out or 0.0), 0.0)))

    def disturbance_v(self, velocity_m_s: Array) -> Array:
        """Return the command (n,) in V that is equivalent to friction, for a table velocity (n,) in m/s.

        It is -kappa (sign(v) - c v): the linear part is already in the identified model. Friction acts without delay, a
        command acts after the model's delay. In a prediction over time this command must be advanced by that delay.
        """
        sign = np.tanh(velocity_m_s / self.scale_m_s)
        return -self.command_v * (sign - self.linear_s_per_m * velocity_m_s)


@dataclass(frozen=True)
class Candidate:
    """A structure of the table model that was tried."""

    name: str
    poles: int
    zeros: int  # finite ones
    # rms of (model / FRF - 1) over the FRF's standard error, fitted to one half of the data and evaluated on the other;
    # 1 equals the scatter of the data, no structure can do better
    held_out: float
    chosen: bool = False


@dataclass(frozen=True)
class SpecimenFit:
    """Identified specimen of n floors relative to the table: a chain of storeys with modal damping.

    Fields that end in `_error...` are standard uncertainties.
    """

    specimen: Specimen
    stiffness_n_per_m: Array  # (n,) of the storeys
    dashpots_n_s_per_m: Array  # (n,) of the storeys; together they give the same modal damping ratios
    natural_frequency_hz: Array  # (n,) on a fixed base
    damping_ratio: Array  # (n,) modal
    mode_shapes: Array  # (n, n) a mode per column, the largest floor of each is 1
    stiffness_error_n_per_m: Array  # (n,)
    frequency_error_hz: Array  # (n,)
    damping_error: Array  # (n,)
    frequency_scatter_hz: Array  # (n,) standard deviation over stretches of the record; NaN if it was not divided
    damping_scatter: Array  # (n,) the same of the damping ratios
    residual: float  # rms of the unexplained motion over the rms of the floors' accelerations


@dataclass(frozen=True)
class Band:
    """Residual |model / FRF - 1| of a model in a band."""

    low_hz: float
    high_hz: float
    rms: float
    largest: float
    scatter: float  # rms of the FRF's own standard error
    coherence: float  # median


@dataclass(frozen=True)
class LevelBand:
    """The table's response at low level over that at full level: mean in a band, with its standard error."""

    low_hz: float
    high_hz: float
    ratio: complex
    error: float


@dataclass(frozen=True)
class LevelCauses:
    """Causes of a difference between low and full level (see level_dependence.py); () if the data show none."""

    table: tuple[str, ...] = ()  # causes in the table, the likeliest first
    storeys: tuple[int, ...] = ()  # storeys of the specimen, from 1, whose stiffness depends on the level


NO_INFORMATION = 0.5  # standard uncertainty over the value from which two of them reach zero


@dataclass(frozen=True)
class Root:
    """A pair of roots (or a single real one: damping ratio NaN) with standard uncertainties (NaN: not known)."""

    kind: str
    frequency_hz: float
    damping_ratio: float
    frequency_error_hz: float
    damping_error: float

    @property
    def frequency_known(self) -> bool:
        """Return whether the data determine the frequency; True where its uncertainty is not known."""
        return not self.frequency_error_hz > NO_INFORMATION * self.frequency_hz

    @property
    def damping_known(self) -> bool:
        """Return whether the data determine the damping ratio; True where there is none."""
        return not self.damping_error > NO_INFORMATION * abs(self.damping_ratio)

    @property
    def determined(self) -> bool:
        """Return whether the data determine this root."""
        return self.frequency_known and self.damping_known


@dataclass(frozen=True)
class Verdict:
    """Whether a model may drive a table."""

    accepted: bool
    feedforward_hz: tuple[float, float]  # band in which the model may be used; (0, 0): nowhere
    delay_s: float  # transport delay in the model
    lag_s: float  # phase lag from command to displacement at low frequency, as a time, delay included
    refusals: tuple[Finding, ...]  # why the model is rejected
    notes: tuple[Finding, ...]  # what else to know
    known_hz: float = math.inf  # above, the model says nothing; infinite: the data determine all its roots

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why the model is rejected, one sentence each."""
        return sentences(self.refusals)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what else to know, one sentence each."""
        return sentences(self.notes)


@dataclass(frozen=True)
class DelayEstimate:
    """Delay from command to table, identified and declared."""

    identified_s: float
    error_s: float  # standard uncertainty of the identified delay
    declared_s: float  # by the rig: latency, half a sample of hold, transport


@dataclass(frozen=True)
class Calibration:
    """Sensors (c,) and weighed masses (n,) relative to what is declared, as an identification found them.

    A sensor reads `gain` times what its declared sensitivity lets expect, its AC corner is `coupling` times the
    declared one, and it lags by `late_s` beyond its declared dynamics; `mass` is the true mass over the weighed one.
    `further_gain` (f,) is the gain of each channel beside the accelerometers, 1 where nothing shows it. `covariance`
    (3 c + n, 3 c + n) is that of log gain, log coupling, late_s and log mass, one after the other, given the record and
    what is declared. `gain_widening` (c,) and `mass_widening` (n,) are the factors, at least 1, by which sensors and
    masses that differ more than declared widened their declared uncertainties; () in models of earlier versions.
    """

    gain: Array
    coupling: Array
    late_s: Array
    mass: Array
    covariance: Array
    further_gain: Array = field(default_factory=lambda: np.ones(0))
    gain_widening: Array = field(default_factory=lambda: np.zeros(0))
    mass_widening: Array = field(default_factory=lambda: np.zeros(0))

    def error_of(self, combination: Array) -> float:
        """Return the standard uncertainty of a linear combination (3 c + n,) of the covariance's parameters."""
        return float(np.sqrt(combination @ self.covariance @ combination))


@dataclass(frozen=True)
class Pitch:
    """Pitch of the specimen's base (pitch.py): the motion of the top floor by it per N on that floor.

    `stiffness_ratio` (n,): stiffnesses of the storeys on a rigid base over those of the specimen as identified.
    """

    flexibility_m_per_n: float
    error_m_per_n: float
    stiffness_ratio: Array

    @property
    def seen(self) -> bool:
        """Return whether there is more pitch than its uncertainty explains."""
        return self.flexibility_m_per_n > PITCH_SIGMA * self.error_m_per_n


@dataclass(frozen=True)
class NonlinearSpecimen:
    """The specimen as a chain of n storeys whose springs bend and whose joints rub, which holds at every level that the
    records contain (nonlinear_specimen.py).

    Beside a spring (n,) each storey has joints that slide at forces `joint_n` (n, j), over drifts `joint_m` (n, j) of
    sticking, and springs `bend_n_per_m` (n, b) of either sign beyond drifts `bend_m` (n, b). `stiffness_n_per_m` is
    without what the joints add at rest; `dashpots_n_s_per_m` (n, n), symmetric, by the rates of the storeys' drifts.
    """

    stiffness_n_per_m: Array
    dashpots_n_s_per_m: Array
    joint_n: Array
    joint_m: Array
    bend_n_per_m: Array
    bend_m: Array

    @property
    def possible(self) -> bool:
        """Return whether every storey has a stiffness at every drift, and no dashpot adds energy."""
        softest = self.stiffness_n_per_m + np.cumsum(self.bend_n_per_m, axis=1).min(axis=1, initial=0.0)
        return bool((softest > 0.0).all() and np.linalg.eigvalsh(self.dashpots_n_s_per_m)[0] >= 0.0)

    @property
    def laws(self) -> Laws:
        """Return the laws of its storeys, counted from 0 at the table."""
        return arranged(self._laws)

    def specimen(self, masses_kg: Array) -> Specimen:
        """Return the specimen with floors of masses (n,), with what its laws add at rest."""
        at_rest = np.array([sum(law.at_rest[0] for law in of_storey) for of_storey in self._laws])
        drifts = np.eye(len(masses_kg)) - np.eye(len(masses_kg), k=-1)
        dashpots = drifts.T @ self.dashpots_n_s_per_m @ drifts
        return Specimen(masses_kg, storey_matrix(self.stiffness_n_per_m + at_rest), dashpots)

    @property
    def _laws(self) -> tuple[tuple[Law, ...], ...]:
        joints, bends = (
            [[(size, drift) for size, drift in zip(*of_storey, strict=True) if size != 0.0] for of_storey in pairs]
            for pairs in (
                zip(self.joint_n.tolist(), self.joint_m.tolist(), strict=True),
                zip(self.bend_n_per_m.tolist(), self.bend_m.tolist(), strict=True),
            )
        )
        return tuple(
            (*(Joint(*joint) for joint in rubbing), *(ElasticGap(*bend) for bend in touched))
            for rubbing, touched in zip(joints, bends, strict=True)
        )


@dataclass(frozen=True)
class LowLevelLines:
    """Lines of the record at low level, Hann window over all of it, with which the same record in a later session is
    compared (session_record.py): command in V (m,), channels in m/s^2 (c, m), standard deviation of the channels'
    noise in a line (c,)."""

    frequency_hz: Array
    command_v: ComplexArray
    accel_m_s2: ComplexArray
    noise: Array


@dataclass(frozen=True)
class SessionChange:
    """What changed in sensors and converters from the identification to the session of a test (session_record.py).

    `gain` (c,) relative, `late_s` (c,) beyond the table's channel, the alias's coefficient `ripple_m_s2_per_v`.
    `covariance` (2 c + 1, 2 c + 1) is that of these, one after the other. `unexplained`: rms of what is left, in units
    of the channels' noise at rest. `delay_s`: by how much later the table moves after its command, with its standard
    uncertainty; it is judged only where another instant has changed, else both are 0.
    """

    gain: Array
    late_s: Array
    ripple_m_s2_per_v: float
    covariance: Array
    unexplained: float
    delay_s: float = 0.0
    delay_error_s: float = 0.0

    @property
    def believed(self) -> bool:
        """Return whether what changed is explained so well that it may be taken up."""
        return self.unexplained <= MOST_UNEXPLAINED

    @property
    def ratio(self) -> Array:
        """Return the changes (c - 1,) of the floors' gains over the table's."""
        return np.asarray(self.gain[1:] - self.gain[0])

    @property
    def ratio_error(self) -> Array:
        """Return the standard uncertainties (c - 1,) of `ratio`."""
        c = len(self.gain)
        over = np.hstack([-np.ones((c - 1, 1)), np.eye(c - 1), np.zeros((c - 1, c + 1))])
        return np.asarray(np.sqrt(np.einsum("ij,jk,ik->i", over, self.covariance, over)))

    @property
    def late_error_s(self) -> Array:
        """Return the standard uncertainties (c - 1,) of the floors' `late_s`."""
        c = len(self.gain)
        return np.asarray(np.sqrt(np.diag(self.covariance)[c + 1 : 2 * c]))

    @property
    def ripple_error_m_s2_per_v(self) -> float:
        """Return the standard uncertainty of `ripple_m_s2_per_v`."""
        return float(np.sqrt(self.covariance[-1, -1]))


@dataclass(frozen=True)
class Identification:
    """The complete result of an identification: the nominal model and, with `samples`, its uncertainty.

    The samples are the one form in which later steps take the uncertainty as a whole: a covariance becomes samples.
    Each is a complete identification of the same table and specimen, as it might have been with the same probability
    as any other. Blocks are designed from the nominal model; the check judges them on the nominal model and on every
    sample, and states the range of each figure. Raises ValueError for samples that cannot be judged alike.
    """

    frfs: tuple[Frf, ...]  # responses from the command to the table (without leakage) and to each floor
    noise_floors: tuple[Array | None, ...]  # |response| that noise at rest alone would cause in them; None: not known
    best: Model
    paper: Model
    best_error: FitError
    paper_error: FitError
    specimen: SpecimenFit | None  # from the excitation; None without floors
    free_vibration: SpecimenFit | None  # the specimen from the free vibration; None if that cannot be used
    channels: tuple[ChannelReport, ...]
    candidates: tuple[Candidate, ...]
    roots: tuple[Root, ...]  # of `best`
    residuals: tuple[Band, ...]  # of `best`, by band
    levels: tuple[LevelBand, ...]  # low against full level; () if they are not comparable
    verdict: Verdict
    friction: Friction | None = None  # of the table; None if the records do not determine it
    latency: DelayEstimate | None = None
    causes: LevelCauses = LevelCauses()  # of a difference between the levels
    compared: ComparedBand = USUAL  # band in which the models were compared with the data
    calibration: Calibration | None = None  # of sensors and masses; None: they are exactly as declared
    low_level_m_s2: float | None = None  # nominal RMS of the record at low level; None: there is none
    low_level_lines: LowLevelLines | None = None  # of that record; None: there is none, or no specimen
    low_level: SpecimenFit | None = None  # the specimen from that record alone; None: not known
    nonlinear: NonlinearSpecimen | None = None  # the specimen at every level; None: linear, or not known
    pitch: Pitch | None = None  # of the specimen's base; None: not known
    session: SessionChange | None = None  # what `calibration` and `best` hold of a later session; None: nothing
    at_rest: Array | None = None  # (2,) noise of an actuator's channels at rest, rms in m and N; None: of a table
    # equally likely identifications, without samples themselves; (): the model's uncertainty is not known as a whole
    samples: tuple[Identification, ...] = ()

    def __post_init__(self) -> None:
        """Refuse samples that cannot be judged alike."""
        floors = _floors(self)
        for number, sample in enumerate(self.samples, 1):
            if not isinstance(sample, Identification):
                raise ValueError(f"sample {number} is {type(sample).__name__}, it must be an Identification")
            if sample.samples:
                raise ValueError(f"sample {number} has samples itself")
            if _floors(sample) != floors or len(sample.frfs) != len(self.frfs):
                raise ValueError(f"sample {number} has {_floors(sample)} floors, the nominal model has {floors}")
            if sample.compared != self.compared:
                raise ValueError(
                    f"sample {number} was compared in {sample.compared}, the nominal model in {self.compared}"
                )

    @property
    def accepted(self) -> bool:
        """Return whether the model may drive the table."""
        return self.verdict.accepted

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return why the model is rejected, one sentence each."""
        return self.verdict.reasons

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings, one sentence each."""
        return self.verdict.warnings


def _floors(found: Identification) -> int:
    return len(found.specimen.natural_frequency_hz) if found.specimen else 0
