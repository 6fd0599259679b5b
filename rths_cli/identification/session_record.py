"""What changed in sensors and converters since the identification: its record at low level, played again before a test.

Both records have the same command, so that table and specimen move alike, friction and softening storeys included, and
what a linear model leaves unexplained is in both. A change that all channels share is one of the table. What the floors
do beyond it,

    y_j = D_j - T_j D_0,    D = S - R,    T_j = R_j / R_0,

with lines R of the first record and S of the second (R_0 without the alias of the held command), is a sum of what
changed: gains of the sensors, lags between them, the alias, stiffnesses and damping ratios of the specimen. Each has
its own course over frequency: a gain keeps its size, the lag of a channel grows with s, the alias falls with 1 / s
relative to the motion, a stiffness acts near the modes. The alias is in the samples of the table alone.

The estimate is the most probable one under independent normal priors, its covariance that of the posterior
(A. Tarantola, Inverse Problem Theory, 2005, chapter 3); the size of the noise is that of what is left unexplained. The
noise of the table's line is in all floors, so that they are whitened line by line; lines beside one another share noise
by their window. AC corners may have moved a little: they are estimated beside the rest and not taken up. Converters act
at the same instants in both sessions unless the records show another.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rths_cli.identification.identify_specimen import without_staircase
from rths_cli.identification.least_squares import covariance, linear, parts
from rths_cli.identification.record_parts import Record, padded
from rths_cli.identification.results import (
    NO_LINES,
    Calibration,
    Identification,
    LowLevelLines,
    SessionChange,
    SpecimenFit,
)
from rths_cli.identification.sensor_calibration import ripple_prior
from rths_cli.identification.specimen_fit import ABOVE_HIGHEST, modal
from rths_cli.numerics.lti import Array, ComplexArray, staircase
from rths_cli.rigs.description import RigInfo

LEAST_DRIFT = 5e-4  # relative: least standard uncertainty of a change of a gain, also on a rig that states none
CORNER_PRIOR = 0.01  # relative: of a change of an AC coupling's corner, by temperature and age of its parts
LAG_PRIOR = 0.25  # of a sample interval: standard uncertainty of a change of the lag between two channels
STIFFNESS_PRIOR, DAMPING_PRIOR = 0.1, 0.5  # relative: of the specimen's stiffnesses and damping ratios
STEP = 1e-4  # of the logarithms of stiffness and damping ratio, over which slopes are taken
ROUNDS = 12  # most solutions, each with specimen and size of the residual of the one before
FAR, SETTLED = 2e-3, 1e-6  # change of the specimen's parameters from which slopes are taken anew; at which they end
SAME_COMMAND = 0.05  # largest relative difference of the two commands' lines
SHARED = 35.0 / 18.0  # mean(w^4) / mean(w^2)^2 of a Hann window: by it neighbouring lines tell less than single ones
FALSE_ALARM = 1e-3  # probability with which instants, or gains stated as exact, are taken for changed ones by chance
SHOWN = 3.0  # standard uncertainties from which another delay is taken for one
LEAST_LINES = 40
LEAST_REST_LINES = 8  # of the rest before a record, up to which its noise is taken at least
LEAST_NOISE = 1e-4  # of a channel's motion
BELOW_NYQUIST = 0.4  # of the sample rate, up to which lines are used
LEAST_SIZE = 1e-3  # of what is left unexplained, in units of the noise at rest


def low_level_lines(record: Record, info: RigInfo, low_hz: float, highest_hz: float) -> LowLevelLines | None:
    """Return the lines of a record that begins and ends at rest, by a Hann window over all of it, from `low_hz` to
    `ABOVE_HIGHEST` times the specimen's highest natural frequency `highest_hz`; None if there is none."""
    samples = len(record.command_v)
    f: Array = np.asarray(np.fft.rfftfreq(samples, info.dt_s), dtype=float)
    f = f[(f >= low_hz) & (f <= min(ABOVE_HIGHEST * highest_hz, BELOW_NYQUIST / info.dt_s))]
    if not len(f):
        return None
    noise = _noise(record, info, f) * float(np.sqrt(np.sum(np.hanning(samples) ** 2)))
    return LowLevelLines(f, _lines(record.command_v, f, info.dt_s), _lines(record.accel_m_s2, f, info.dt_s), noise)


def _noise(record: Record, info: RigInfo, frequency_hz: Array) -> Array:
    """Return the standard deviation (c,) in m/s^2 of white noise as strong as the channels' at rest in this band, at
    least the quantisation noise; hum beyond the band is none in it. A rest too short to resolve the band has its lowest
    lines taken."""
    bits = np.array([info.converters.step_v / channel.sensitivity_v_per_unit for channel in info.channels])
    least = np.maximum(bits / np.sqrt(12.0), LEAST_NOISE * record.accel_m_s2.std(axis=1))
    silence = record.parts.silence
    if silence is None:
        return least
    still = record.accel_m_s2[:, silence]
    window, f = np.hanning(still.shape[1]), np.fft.rfftfreq(still.shape[1], info.dt_s)
    inside = (f >= max(frequency_hz[0], 2.0 * f[1])) & (f <= max(frequency_hz[-1], LEAST_REST_LINES * f[1]))
    power = np.abs(np.fft.rfft(window * (still - still.mean(axis=1, keepdims=True)), axis=-1)[:, inside]) ** 2
    return np.asarray(np.maximum(np.sqrt(power.mean(axis=1) / np.sum(window**2)), least))


def _lines(signal: Array, frequency_hz: Array, dt_s: float) -> ComplexArray:
    """Return the lines (..., m) of signals (..., n) by a Hann window over all of them."""
    samples = signal.shape[-1]
    first = round(float(frequency_hz[0]) * samples * dt_s)
    return np.asarray(np.fft.rfft(np.hanning(samples) * signal, axis=-1)[..., first : first + len(frequency_hz)])


def session_change(known: Identification, again: Record, info: RigInfo, drift: float) -> SessionChange | str:
    """Return what changed since an identification, from its record at low level played again; a reason where the two
    records cannot be compared.

    `drift`: standard uncertainty of a change of a sensitivity, relative. Where it is less than
    LEAST_DRIFT, gains that the record shows to have changed by more are found all the same.
    """
    before, fit = known.low_level_lines, known.specimen
    if before is None or fit is None:
        return NO_LINES
    if len(before.frequency_hz) < LEAST_LINES:
        return f"it has only {len(before.frequency_hz)} lines"
    now = low_level_lines(again, info, float(before.frequency_hz[0]), fit.natural_frequency_hz[-1])
    assert now is not None  # its band is that of the lines before
    apart = _incomparable(before, now)
    if apart:
        return apart
    model, c = known.best, len(before.accel_m_s2)
    s: ComplexArray = 2j * np.pi * before.frequency_hz.astype(complex)
    was = before.accel_m_s2 * (now.command_v / before.command_v)
    alias = now.command_v * staircase(before.frequency_hz, model.latency_samples, model.dt_s, model.coupling_hz)
    over = was[1:] / (was[0] - model.ripple_m_s2_per_v * alias)
    changed = now.accel_m_s2 - was
    by_gain = np.concatenate([-(over * was[0])[None], np.eye(c - 1)[:, :, None] * was[1:]])  # (c, c - 1, m)
    corners = 2.0 * np.pi * np.array([channel.high_pass_hz for channel in info.channels[:c]])[:, None, None]
    by_corner = -corners / (s + corners) * by_gain
    rows = np.concatenate([by_gain, -s * by_gain[1:], -(over * alias)[None], by_corner])
    table = without_staircase(again.accel_m_s2[0], again.command_v, model)
    white = _whitening(over, np.hypot(before.noise, now.noise))
    problem = _Problem(rows, changed[1:] - over * changed[0], white, fit, before.frequency_hz, table, info.dt_s)
    instants = np.append(np.full(c - 1, LAG_PRIOR * info.dt_s), ripple_prior(model, info.dt_s))
    gains, nuisance = np.full(c, max(drift, LEAST_DRIFT)), CORNER_PRIOR * (corners.ravel() > 0.0)
    priors = np.concatenate([gains, instants, nuisance])
    found, spread, size = problem.most_probable(priors)
    if not _shown(found, spread, slice(c, 2 * c), c):
        priors[c : 2 * c] = 0.0
        found, spread, size = problem.most_probable(priors)
    if drift < LEAST_DRIFT and not _shown(found, spread, slice(0, c), c - 1):  # the gain that all share is not seen
        priors[:c] = drift
        found, spread, size = problem.most_probable(priors)
    full, free = np.zeros((2 * c + 1, 2 * c + 1)), np.array([*range(c), *range(c + 1, 2 * c + 1)])
    full[np.ix_(free, free)] = spread[: 2 * c, : 2 * c]
    change = SessionChange(found[:c], np.append(0.0, found[c : 2 * c - 1]), float(found[2 * c - 1]), full, size)
    if not found[c : 2 * c].any():
        return change
    moved = changed[0] - change.gain[0] * was[0] - change.ripple_m_s2_per_v * alias
    late_s, error_s = _later(moved, was[0] - model.ripple_m_s2_per_v * alias, fit, s)
    return replace(change, delay_s=late_s, delay_error_s=error_s) if abs(late_s) > SHOWN * error_s else change


def _shown(found: Array, spread: Array, places: slice, count: int) -> bool:
    """Tell whether parameters, `count` of which the record can show, have changed: one chi-square test of all."""
    from scipy.stats import chi2

    errors = np.sqrt(np.diag(spread)[places])
    pulls = found[places] / errors
    squares = pulls @ np.linalg.solve(spread[places, places] / np.outer(errors, errors), pulls)
    return bool(squares > chi2.isf(FALSE_ALARM, count))


def _whitening(over: ComplexArray, noise: Array) -> ComplexArray:
    """Return the matrices (m, n, n) that make real and imaginary parts of the floors' lines independent, of variance 1.

    `over` (n, m): the floors' motion over the table's, `noise` (1 + n,): of a line of the channels. The table's noise
    is in all floors.
    """
    shared = np.einsum("jm,km->mjk", over, over.conj()) * noise[0] ** 2
    return np.asarray(np.sqrt(2.0) * np.linalg.inv(np.linalg.cholesky(shared + np.diag(noise[1:] ** 2))))


def _later(moved: ComplexArray, table: ComplexArray, fit: SpecimenFit, s: ComplexArray) -> tuple[float, float]:
    """Return by how much later the table moves in s, and its standard uncertainty, from what its lines (m,) changed by.

    Beside the delay the size of the motion may have changed, and, near the specimen's modes, its reaction.
    """
    omega = 2.0 * np.pi * fit.natural_frequency_hz[:, None]
    modes = s**2 / (s**2 + 2.0 * fit.damping_ratio[:, None] * omega * s + omega**2)
    rows = parts(table * np.concatenate([[-s, np.ones_like(s)], modes, s / omega * modes]))
    found = linear(rows, parts(moved))
    left = parts(moved) - found @ rows
    error_s = float(np.sqrt(SHARED * covariance(rows, float(left @ left) / (left.size - len(rows)))[0, 0]))
    return float(found[0]), error_s


def _incomparable(before: LowLevelLines, now: LowLevelLines) -> str:
    """Return why two records do not have the same command but for rounding and level, "" where they have it."""
    if before.frequency_hz.shape != now.frequency_hz.shape or not np.allclose(before.frequency_hz, now.frequency_hz):
        return "it has another length"
    if not np.isfinite(now.accel_m_s2).all():
        return "samples are lost"
    apart = np.linalg.norm(now.command_v - before.command_v)
    return "" if apart < SAME_COMMAND * np.linalg.norm(before.command_v) else "it has another command"


@dataclass(frozen=True)
class _Problem:
    """What the floors do beyond table and specimen as they were, and what may explain it.

    `rows` (k, n, m) per unit of gains, instants and corners, `beyond` (n, m) in m/s^2, `white` (m, n, n) whitens. The
    specimen adds its stiffnesses and damping ratios; `table` (samples,) in m/s^2 is the motion under it.
    """

    rows: ComplexArray
    beyond: ComplexArray
    white: ComplexArray
    fit: SpecimenFit
    frequency_hz: Array
    table: Array
    dt_s: float

    def most_probable(self, priors: Array) -> tuple[Array, Array, float]:
        """Return gains, instants and corners (k,), their covariance and the rms of what is left, in units of the noise.

        `priors` (k,) are their standard uncertainties, 0: not free.
        """
        n, k, size = len(self.fit.stiffness_n_per_m), len(priors), 1.0
        priors = np.concatenate([priors, np.full(n, STIFFNESS_PRIOR), np.full(n, DAMPING_PRIOR)])
        start, slopes = self._specimen
        there, found = np.zeros(2 * n), np.zeros(len(priors))
        for _ in range(ROUNDS):
            if np.abs(found[k:] - there).max() > FAR:
                there = found[k:]
                slopes = self._slopes(there)
            beside = self._moved(found[k:]) - start - np.tensordot(found[k:], slopes, 1)  # of second order
            wanted = self._weighted((self.beyond - beside)[None])[0]
            every = self._weighted(np.concatenate([self.rows, slopes])) * priors[:, None]
            products, before = every @ every.T, found
            scaled = np.linalg.solve(products + SHARED * size**2 * np.eye(len(priors)), every @ wanted)
            left = wanted - scaled @ every
            size = max(float(np.sqrt(left @ left / (left.size - len(priors)))), LEAST_SIZE)
            found = scaled * priors
            if np.abs(found - before)[k:].max() < SETTLED:
                break
        spread = np.linalg.inv(products / (SHARED * size**2) + np.eye(len(priors))) * np.outer(priors, priors)
        return found[:k], spread[:k, :k], size

    def _weighted(self, rows: ComplexArray) -> Array:
        """Return rows (k, n, m) whitened, real and imaginary parts side by side."""
        return parts(np.einsum("mij,kjm->kim", self.white, rows)).reshape(len(rows), -1)

    @cached_property
    def _specimen(self) -> tuple[ComplexArray, ComplexArray]:
        """Return the lines (n, m) of the floors on the specimen as it was, and their slopes (2 n, n, m)."""
        nothing = np.zeros(2 * len(self.fit.stiffness_n_per_m))
        return self._moved(nothing), self._slopes(nothing)

    @cached_property
    def _driven(self) -> tuple[ComplexArray, ComplexArray, int]:
        """Return s in rad/s and the lines of the table's motion, of the record padded with rest, and its samples."""
        count = padded(len(self.table), self.dt_s)
        s = np.asarray(2j * np.pi * np.fft.rfftfreq(count, self.dt_s), dtype=complex)
        return s, np.fft.rfft(self.table, count), count

    def _slopes(self, by: Array) -> ComplexArray:
        """Return the slopes (2 n, n, m) of the floors' lines by what `_moved` takes."""
        steps = STEP * np.eye(len(by))
        return np.array([(self._moved(by + step) - self._moved(by - step)) / (2.0 * STEP) for step in steps])

    def _moved(self, by: Array) -> ComplexArray:
        """Return the lines (n, m) of the floors' absolute accelerations; `by` (2 n,): by how much the logarithms of
        stiffnesses and damping ratios have changed."""
        masses, was = self.fit.specimen.masses_kg, np.append(self.fit.stiffness_n_per_m, self.fit.damping_ratio)
        stiffness, ratios = np.split(was * np.exp(by), 2)
        omega, shapes = modal(masses, stiffness)
        s, driven, count = self._driven
        carried = (2.0 * ratios * omega)[:, None] * s + (omega**2)[:, None]
        response = shapes @ ((masses @ shapes)[:, None] * carried / (s**2 + carried))
        floors = np.fft.irfft(response * driven, count)[:, : len(self.table)]
        return _lines(floors, self.frequency_hz, self.dt_s)


def in_session(known: Identification, change: SessionChange) -> Identification:
    """Return an identification as it stands in the session of a test: sensors and alias with what changed.

    The covariance of gains and lags grows by that of the change. The measured responses are those of the session; the
    table's model keeps its delay, so that the check sees what a later command costs.
    """
    c, floors = len(known.frfs), len(known.frfs) - 1
    exact = Calibration(np.ones(c), np.ones(c), np.zeros(c), np.ones(floors), np.zeros((3 * c + floors,) * 2))
    before = known.calibration or exact
    covariance, places = before.covariance.copy(), np.array([*range(c), *range(2 * c, 3 * c)])
    covariance[np.ix_(places, places)] += change.covariance[: 2 * c, : 2 * c]
    calibration = replace(
        before, gain=before.gain * np.exp(change.gain), late_s=before.late_s + change.late_s, covariance=covariance
    )
    ripple = known.best.ripple_m_s2_per_v + change.ripple_m_s2_per_v
    best = replace(known.best, ripple_m_s2_per_v=ripple)
    frfs = []
    for channel, frf in enumerate(known.frfs):
        f, of_table = frf.frequency_hz, float(channel == 0)
        motion = frf.response - of_table * known.best.alias(f)
        response = motion * np.exp(-2j * np.pi * f * change.delay_s) + of_table * best.alias(f)
        frfs.append(replace(frf, response=response))
    return replace(known, calibration=calibration, best=best, frfs=tuple(frfs), session=change)
