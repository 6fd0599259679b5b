"""Friction of the table, from what its model leaves of a record: equivalent to a change of the command.

A dry friction F_c sign(v) pushes on the table inside the loop that the command drives, so it acts like a command
-kappa sign(v), kappa in V, that is early by the delay and the actuator's lag; near standstill sign(v) is tanh(v / v_s).
The identified model holds the part of it that is linear in the velocity (statistical linearisation: c v with
c = sqrt(2 / pi) / sigma_v, Roberts and Spanos, Random Vibration and Statistical Linearization, section 5.3); what is
left of the record is -G kappa (sign(v) - c v).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rths_cli.identification.records import Record, padded
from rths_cli.identification.results import Friction
from rths_cli.identification.table_fit import Timing, within
from rths_cli.numerics.lti import Array, ComplexArray, Model
from rths_cli.rigs.description import RigInfo

LOW_HZ, BAND_SHARE = 0.7, 2.0 / 3.0  # band of the fit: from, and to this share of the model's
CORNER_HZ = 0.4  # below it the model's velocity, above it the integral of the measured acceleration
SIGN_RATE_HZ = 1000.0  # at which sign(v) is made: it has lines far above the band
SCALES = (0.004, 0.008, 0.016, 0.032, 0.064)  # v_s over the rms velocity, of which the best is taken
STRETCH_S = 2.5  # what is linear in the velocity is fitted anew in each stretch
SLOW = 0.5  # of the rms velocity: slower stretches do not tell sign(v) from v
LEAST_STRETCHES, GROUPS = 8, 12  # of stretches; of lines, whose scatter shows what every stretch repeats
PASSES, SMOOTHED = 2, 5  # of weighting by the residual's spectrum, averaged over so many lines
LEAST_POWER = 1e-30  # of a line of that spectrum
SHAPE = 0.005  # of kappa: what sign(v) and the model's share of it may differ from what is assumed here
LINEAR = 4  # the first of the rows that are linear in the velocity


@dataclass(frozen=True)
class _Spectra:
    """Fourier lines (m,) of a record: what the model leaves, velocity, and the response to friction of kappa = 1 V.

    `velocity_m_s`: the velocity in time, finely sampled; `duration_s`: of the record with its padding; `part_s`: from
    when to when it is excited.
    """

    s: ComplexArray
    residual: ComplexArray
    velocity: ComplexArray
    through: ComplexArray
    velocity_m_s: Array
    duration_s: float
    part_s: tuple[float, float]


def estimate(records: Sequence[Record], model: Model, info: RigInfo) -> Friction | None:
    """Estimate friction from records and the model fitted to them; None where they are too short or hardly move.

    Least squares over stretches of the records, weighted by the residual's spectrum; the uncertainty is from the
    scatter between stretches.
    """
    longest = max(len(record.command_v) for record in records)
    count = padded(longest, info.dt_s)
    spectra = [_spectra(record, model, info, count) for record in records]
    speeds = np.concatenate([np.sqrt(np.mean(_cut(x.velocity[None], x)[:, 0] ** 2, axis=-1)) for x in spectra])
    rms = float(np.sqrt(np.mean(speeds**2))) if len(speeds) else 0.0
    fast = speeds > SLOW * rms
    high_hz = BAND_SHARE * model.band_hz[1]
    if fast.sum() < LEAST_STRETCHES or (high_hz - LOW_HZ) * STRETCH_S < GROUPS:
        return None
    residual, *linear = _stretch_lines(spectra, [_fixed_rows(x) for x in spectra], high_hz)[fast].swapaxes(0, 1)
    tried = []
    for scale in (share * rms for share in SCALES):
        acting = _stretch_lines(spectra, [_acting_rows(x, scale) for x in spectra], high_hz)[fast].swapaxes(0, 1)
        tried.append(_fitted(np.stack([residual, *acting, *linear], axis=1), rms, scale))
    return max(tried, key=lambda friction: friction.explained)


def _spectra(record: Record, model: Model, info: RigInfo, count: int) -> _Spectra:
    """Return the lines of a record of so many samples, padding included, up to the end of the model's band."""
    duration_s = count * info.dt_s
    f = np.arange(int(model.band_hz[1] * duration_s) + 1) / duration_s
    s = (2j * np.pi * f).astype(complex)
    lines = record.command_lines(count, info.dt_s).values, np.fft.rfft(record.accel_m_s2[0], count)
    command, table = (each[: len(f)] / count for each in lines)
    response: ComplexArray = model.response(f)
    table = table - model.alias(f) * command
    velocity = _velocity(f, table, response * command)
    declared = Timing(info.latency_samples, info.dt_s, info.transport_s)
    delay_s = max(model.delay_s, declared.delay_s)
    fine = max(2 * len(f), round(SIGN_RATE_HZ * duration_s))
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


def _velocity(frequency_hz: Array, table: ComplexArray, answer: ComplexArray) -> ComplexArray:
    """Return the velocity's lines: integral of the measured acceleration, and of the model's where that would drift."""
    f = frequency_hz[1:]
    low = 1.0 / (1.0 + (f / CORNER_HZ) ** 4)
    accel = low * answer[1:] + (1.0 - low) * table[1:]
    return np.concatenate([[0.0], accel / (2j * np.pi * f)])


def _stretch_lines(spectra: Sequence[_Spectra], rows: Sequence[ComplexArray], high_hz: float) -> ComplexArray:
    """Return the lines (stretches, rows, m) of each record's rows, from the lowest to the highest of the fit."""
    cut = np.concatenate([_cut(some, each) for some, each in zip(rows, spectra, strict=True)])
    n = cut.shape[-1]
    inside = within(np.arange(n // 2 + 1) / STRETCH_S, (LOW_HZ, high_hz))
    return np.fft.rfft(np.hanning(n) * cut)[..., inside]


def _fixed_rows(x: _Spectra) -> ComplexArray:
    """Return the lines (3, m) that no v_s changes: residual, and two linear in v."""
    return np.array([x.residual, -x.through * x.velocity, -x.through * x.s * x.velocity])


def _acting_rows(x: _Spectra, scale_m_s: float) -> ComplexArray:
    """Return the lines (3, m) of friction of kappa = 1 V, its rate, and its change with v_s."""
    ratio = x.velocity_m_s / scale_m_s
    sign = np.tanh(ratio)
    friction, change = (np.fft.rfft(y)[: len(x.s)] / len(y) for y in (sign, ratio * (1.0 - sign**2)))
    return -x.through * np.array([friction, x.s * friction, change])


def _cut(lines: ComplexArray, x: _Spectra) -> Array:
    """Return the series of lines (rows, m) during the excitation, cut into stretches (k, rows, n)."""
    length = 2 * (lines.shape[-1] - 1)
    series = np.fft.irfft(lines, length) * length
    rate_hz = length / x.duration_s
    n, first = round(STRETCH_S * rate_hz), int(np.ceil(x.part_s[0] * rate_hz))
    k = int((x.part_s[1] * rate_hz - first) // n)
    return series[:, first : first + k * n].reshape(len(lines), k, n).swapaxes(0, 1)


def _fitted(lines: ComplexArray, rms_m_s: float, scale_m_s: float) -> Friction:
    """Return friction from the lines (stretches, 6, m) of the rows, weighted by the spectrum of what is left."""
    weight = np.ones(lines.shape[-1])
    for _ in range(PASSES):
        kappa, error, before, left = _solve(lines * weight)
        before, left = before / weight**2, left / weight**2
        weight = 1.0 / np.sqrt(np.convolve(left, np.ones(SMOOTHED) / SMOOTHED, mode="same") + LEAST_POWER)
    explained = 1.0 - float(left.sum() / max(before.sum(), LEAST_POWER))
    return Friction(kappa, float(np.hypot(error, SHAPE * kappa)), rms_m_s, explained, scale_m_s)


def _solve(lines: ComplexArray) -> tuple[float, float, Array, Array]:
    """Return kappa in V, its standard uncertainty, and the power of each line (m,) without and with friction.

    In each stretch the parts linear in the velocity are taken out of all others; kappa, the actuator's lag and v_s hold
    for all stretches. The uncertainty is from the scatter between stretches or between groups of lines, the larger,
    whatever the residual's correlation within one (Liang and Zeger, Biometrika 73, 1986).
    """
    both = np.concatenate([lines.real, lines.imag], axis=-1)
    basis = np.linalg.qr(both[:, LINEAR:].swapaxes(1, 2))[0]
    free = both[:, :LINEAR] - (both[:, :LINEAR] @ basis) @ basis.swapaxes(1, 2)
    residual, given = free[:, 0], free[:, 1:]
    inverse = np.linalg.inv(np.einsum("kin,kjn->ij", given, given))
    found = inverse @ np.einsum("kin,kn->i", given, residual)
    left = residual - np.einsum("i,kin->kn", found, given)
    scores = given * left[:, None]
    by_line = scores.sum(axis=0).reshape(len(found), 2, -1).sum(axis=1)
    groups = [group.sum(axis=1) for group in np.array_split(by_line, GROUPS, axis=1)]
    variance = max(_variance(inverse, scores.sum(axis=2)), _variance(inverse, np.array(groups)))
    return float(found[0]), float(np.sqrt(variance)), _power(residual), _power(left)


def _variance(inverse: Array, scores: Array) -> float:
    """Return the variance of the first parameter from the scores (clusters, parameters) of independent clusters."""
    clusters, parameters = scores.shape
    return float((inverse @ scores.T @ scores @ inverse)[0, 0]) * clusters / (clusters - parameters)


def _power(both: Array) -> Array:
    """Return the mean power over stretches of lines whose real and imaginary parts stand one behind the other."""
    real, imaginary = np.split(np.mean(both**2, axis=0), 2)
    return real + imaginary
