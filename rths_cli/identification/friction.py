"""Estimate the table's dry friction from what its linear model leaves of a record.

Dry friction F_c sign(v) acts on the table inside the loop that the command drives. It is equivalent to a command
-kappa sign(v), with kappa in V, that is early by the delay and by the actuator's lag. Near standstill sign(v) is
tanh(v / v_s). The identified model already contains the part of friction that is linear in the velocity (statistical
linearisation: c v with c = sqrt(2 / pi) / sigma_v, Roberts and Spanos, Random Vibration and Statistical Linearization,
section 5.3). The residual of the model is therefore -G kappa (sign(v) - c v).

Friction that holds like a spring before it slides (presliding: Dahl, LuGre) follows the displacement after a reversal
and not the sign of the velocity, of which a fit finds a small part only. The friction in slip is therefore fitted a
second time without a law: as a sum of sign(v) and of joints that stick over several displacements before they slide
(Maxwell slip; F. Al-Bender, V. Lampaert, J. Swevers, IEEE Trans. Automatic Control 50, 2005, 1883), which together
make any hysteresis that does not depend on the rate. In slip all of them push: it is the sum of their factors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rths_cli.identification.record_parts import Record, padded
from rths_cli.identification.results import Friction
from rths_cli.identification.table_fit import Timing, within
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.hysteresis import slid
from rths_cli.numerics.lti import Array, ComplexArray, Model
from rths_cli.rigs.description import RigInfo

BAND_SHARE = 2.0 / 3.0  # end of the band of the fit over that of the model's band; it starts with the compared band
# of the usual compared band: velocity from the model below this frequency, from the integrated acceleration above it
CORNER_HZ = 0.4
SIGN_RATE_HZ = 1000.0  # of that band: sample rate at which sign(v) is computed; it has lines far above the band
SCALES = (0.004, 0.008, 0.016, 0.032, 0.064)  # tried v_s over the rms velocity; the best one is taken
STRETCH_S = 2.5  # length of a stretch; terms linear in the velocity are fitted separately in each one
SLOW = 0.5  # stretches below this fraction of the rms velocity are left out: they do not separate sign(v) from v
LEAST_STRETCHES, GROUPS = 8, 12  # least number of stretches; groups of lines for the scatter over frequency
PASSES, SMOOTHED = 2, 5  # iterations of the weights by the residual's spectrum; lines over which it is averaged
LEAST_POWER = 1e-30  # least power of a line of that spectrum
SHAPE = 0.005  # relative uncertainty of kappa due to the assumed shape of sign(v)
STICKS = (0.01, 0.03, 0.1)  # displacements over which joints stick, over the rms displacement
SLIPPED = 0.1  # relative uncertainty of what the joints push in slip: a sum of three is not the law
SIGN = 3  # rows of sign(v): itself, its derivative and its slope by v_s


@dataclass(frozen=True)
class _Spectra:
    """Fourier lines of one record, with the velocity of the table."""

    s: ComplexArray  # (m,) rad/s
    residual: ComplexArray  # (m,) measured acceleration minus the model's
    velocity: ComplexArray  # (m,)
    through: ComplexArray  # (m,) the model's response to a command, without its delay
    velocity_m_s: Array  # time series, finely sampled
    duration_s: float  # of the record with its padding
    part_s: tuple[float, float]  # start and end of the excitation


def estimate(records: Sequence[Record], model: Model, info: RigInfo, compared: ComparedBand = USUAL) -> Friction | None:
    """Estimate friction from records and the model fitted to them; None if they are too short or hardly move.

    The method is least squares over stretches of the records, weighted by the residual's spectrum. The uncertainty
    follows from the scatter between stretches.
    """
    longest = max(len(record.command_v) for record in records)
    count = padded(longest, info.dt_s)
    spectra = [_spectra(record, model, info, count, compared) for record in records]
    speeds = np.concatenate([np.sqrt(np.mean(_cut(x.velocity[None], x)[:, 0] ** 2, axis=-1)) for x in spectra])
    rms = float(np.sqrt(np.mean(speeds**2))) if len(speeds) else 0.0
    fast = speeds > SLOW * rms
    band_hz = compared.low_hz, BAND_SHARE * model.band_hz[1]
    if fast.sum() < LEAST_STRETCHES or (band_hz[1] - band_hz[0]) * STRETCH_S < GROUPS:
        return None
    residual, *linear = _stretch_lines(spectra, [_fixed_rows(x) for x in spectra], band_hz)[fast].swapaxes(0, 1)
    tried = []
    for scale in (share * rms for share in SCALES):
        acting = _stretch_lines(spectra, [_acting_rows(x, scale) for x in spectra], band_hz)[fast].swapaxes(0, 1)
        tried.append((_fitted(np.stack([residual, *acting, *linear[:2]], axis=1), rms, scale), acting))
    best, acting = max(tried, key=lambda each: each[0].explained)
    joints = _stretch_lines(spectra, [_joint_rows(x) for x in spectra], band_hz)[fast].swapaxes(0, 1)
    sliding, error = _sliding(np.stack([residual, *acting, *joints, *linear], axis=1))
    return replace(best, sliding_v=sliding, sliding_error_v=error)


def tried_on(
    friction: Friction, quiet: Record, model: Model, lag_s: float, info: RigInfo, compared: ComparedBand = USUAL
) -> Friction:
    """Return friction with the fraction of a record's residual that it removes, a record that the fit did not use.

    Nothing is fitted: kappa, v_s and the linear part that the model contains are those found at full level, and
    friction is early by the actuator's `lag_s` as where it is countered. A table whose friction has another shape
    (presliding, Stribeck) shows it at the low level. Unchanged if the record is shorter than a stretch.
    """
    x = _spectra(quiet, model, info, padded(len(quiet.command_v), info.dt_s), compared)
    acting = np.fft.rfft(friction.disturbance_v(x.velocity_m_s))[: len(x.s)] / len(x.velocity_m_s)
    lines = _stretch_lines(
        [x], [np.array([x.residual, x.residual - x.through * np.exp(lag_s * x.s) * acting])], compared.hz
    )
    if not len(lines):
        return friction
    before, left = np.sum(np.abs(lines) ** 2, axis=(0, 2))
    return replace(friction, held_out=1.0 - float(left / max(before, LEAST_POWER)))


def _spectra(record: Record, model: Model, info: RigInfo, count: int, compared: ComparedBand) -> _Spectra:
    """Return the lines of a record, padded to `count` samples, up to the end of the model's band."""
    duration_s = count * info.dt_s
    f = np.arange(int(model.band_hz[1] * duration_s) + 1) / duration_s
    s = (2j * np.pi * f).astype(complex)
    lines = record.command_lines(count, info.dt_s).values, np.fft.rfft(record.accel_m_s2[0], count)
    command, table = (each[: len(f)] / count for each in lines)
    response: ComplexArray = model.response(f)
    table = table - model.alias(f) * command
    velocity = _velocity(f, table, response * command, compared.with_low(CORNER_HZ))
    declared = Timing(info.latency_samples, info.dt_s, info.transport_s)
    delay_s = max(model.delay_s, declared.delay_s)
    fine = max(2 * len(f), round(compared.with_high(SIGN_RATE_HZ) * duration_s))
    noise = record.parts.noise
    return _Spectra(
        s,
        table - response * command,
        velocity,
        response * np.exp(s * delay_s),
        np.fft.irfft(velocity, fine) * fine,
        duration_s,
        (noise.start * info.dt_s, noise.stop * info.dt_s),
    )


def _velocity(frequency_hz: Array, table: ComplexArray, answer: ComplexArray, corner_hz: float) -> ComplexArray:
    """Return the velocity's lines: the integrated measured acceleration, replaced by the model's at low frequency.

    The integral of the measured acceleration would drift there.
    """
    f = frequency_hz[1:]
    low = 1.0 / (1.0 + (f / corner_hz) ** 4)
    accel = low * answer[1:] + (1.0 - low) * table[1:]
    return np.concatenate([[0.0], accel / (2j * np.pi * f)])


def _stretch_lines(
    spectra: Sequence[_Spectra], rows: Sequence[ComplexArray], band_hz: tuple[float, float]
) -> ComplexArray:
    """Return the Fourier lines (stretches, rows, m) of all records' stretches in the band of the fit."""
    cut = np.concatenate([_cut(some, each) for some, each in zip(rows, spectra, strict=True)])
    n = cut.shape[-1]
    inside = within(np.arange(n // 2 + 1) / STRETCH_S, band_hz)
    return np.fft.rfft(np.hanning(n) * cut)[..., inside]


def _fixed_rows(x: _Spectra) -> ComplexArray:
    """Return the lines (4, m) that do not depend on v_s: the residual, and the response to velocity, acceleration and
    displacement."""
    return np.array([x.residual, -x.through * x.velocity, -x.through * x.s * x.velocity, -x.through * _displacement(x)])


def _displacement(x: _Spectra) -> ComplexArray:
    return np.asarray(np.divide(x.velocity, x.s, out=np.zeros_like(x.velocity), where=x.s != 0.0))


def _joint_rows(x: _Spectra) -> ComplexArray:
    """Return the lines (joints, m) of the response to joints of 1 V that stick before they slide."""
    fine = len(x.velocity_m_s)
    displacement = np.fft.irfft(_displacement(x), fine) * fine
    part = slice(*(round(time_s / x.duration_s * fine) for time_s in x.part_s))
    rms_m = float(displacement[part].std())
    pushes = [np.fft.rfft(slid(displacement, share * rms_m))[: len(x.s)] / fine for share in STICKS]
    return -x.through * np.array(pushes)


def _acting_rows(x: _Spectra, scale_m_s: float) -> ComplexArray:
    """Return the lines (3, m) of the response to friction of kappa = 1 V, its time derivative, and its slope by v_s."""
    ratio = x.velocity_m_s / scale_m_s
    sign = np.tanh(ratio)
    friction, change = (np.fft.rfft(y)[: len(x.s)] / len(y) for y in (sign, ratio * (1.0 - sign**2)))
    return -x.through * np.array([friction, x.s * friction, change])


def _cut(lines: ComplexArray, x: _Spectra) -> Array:
    """Return the time series of lines (rows, m) during the excitation, cut into stretches (k, rows, n)."""
    length = 2 * (lines.shape[-1] - 1)
    series = np.fft.irfft(lines, length) * length
    rate_hz = length / x.duration_s
    n, first = round(STRETCH_S * rate_hz), int(np.ceil(x.part_s[0] * rate_hz))
    k = int((x.part_s[1] * rate_hz - first) // n)
    return series[:, first : first + k * n].reshape(len(lines), k, n).swapaxes(0, 1)


def _fitted(lines: ComplexArray, rms_m_s: float, scale_m_s: float) -> Friction:
    """Return friction from the lines (stretches, 6, m) of the rows, weighted by the spectrum of the residual."""
    factors, spread, before, left = _weighted(lines, SIGN)
    kappa, error = float(factors[0]), float(np.sqrt(spread[0, 0]))
    explained = 1.0 - float(left.sum() / max(before.sum(), LEAST_POWER))
    return Friction(kappa, float(np.hypot(error, SHAPE * kappa)), rms_m_s, explained, scale_m_s)


def _sliding(lines: ComplexArray) -> tuple[float, float]:
    """Return friction in slip in V and its standard uncertainty from the lines (stretches, 10, m) of the rows."""
    factors, spread, *_ = _weighted(lines, SIGN + len(STICKS))
    pushing = np.ones(len(factors))
    pushing[1:SIGN] = 0.0
    total, joints, longest = float(pushing @ factors), float(factors[SIGN:].sum()), float(factors[-1])
    shape = np.array([SHAPE * total, SLIPPED * joints, longest])  # what sticks longer than all joints is not seen
    return total, float(np.sqrt(pushing @ spread @ pushing + shape @ shape))


def _weighted(lines: ComplexArray, acting: int) -> tuple[Array, Array, Array, Array]:
    """Return what `_solve` returns, weighted by the spectrum of the residual; powers are those without weights."""
    weight = np.ones(lines.shape[-1])
    for _ in range(PASSES):
        factors, spread, before, left = _solve(lines * weight, acting)
        before, left = before / weight**2, left / weight**2
        weight = 1.0 / np.sqrt(np.convolve(left, np.ones(SMOOTHED) / SMOOTHED, mode="same") + LEAST_POWER)
    return factors, spread, before, left


def _solve(lines: ComplexArray, acting: int) -> tuple[Array, Array, Array, Array]:
    """Return the factors of the `acting` rows behind the residual, their covariance, and the power of each line (m,)
    without and with them.

    In each stretch the linear rows, which stand last, are projected out of the others. The factors are common to all
    stretches. Of the scatter between stretches and that between groups of lines the larger one of the first factor
    makes the covariance. The residual may be correlated within one (Liang and Zeger, Biometrika 73, 1986).
    """
    both, first = np.concatenate([lines.real, lines.imag], axis=-1), 1 + acting
    basis = np.linalg.qr(both[:, first:].swapaxes(1, 2))[0]
    free = both[:, :first] - (both[:, :first] @ basis) @ basis.swapaxes(1, 2)
    residual, given = free[:, 0], free[:, 1:]
    inverse = np.linalg.inv(np.einsum("kin,kjn->ij", given, given))
    found = inverse @ np.einsum("kin,kn->i", given, residual)
    left = residual - np.einsum("i,kin->kn", found, given)
    scores = given * left[:, None]
    by_line = scores.sum(axis=0).reshape(len(found), 2, -1).sum(axis=1)
    groups = [group.sum(axis=1) for group in np.array_split(by_line, GROUPS, axis=1)]
    spreads = [_covariance(inverse, each) for each in (scores.sum(axis=2), np.array(groups))]
    return found, max(spreads, key=lambda each: float(each[0, 0])), _power(residual), _power(left)


def _covariance(inverse: Array, scores: Array) -> Array:
    """Return the covariance of the parameters from the scores (clusters, parameters) of independent clusters."""
    clusters, parameters = scores.shape
    return np.asarray(inverse @ scores.T @ scores @ inverse) * clusters / (clusters - parameters)


def _power(both: Array) -> Array:
    """Return the mean power of each line over stretches (k, 2 m), real parts first, then imaginary parts."""
    real, imaginary = np.split(np.mean(both**2, axis=0), 2)
    return real + imaginary
