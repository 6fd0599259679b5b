"""Identify an actuator that follows a displacement, and the specimen that it moves, from a multisine of five periods.

The response X / U of displacement to command has no zeros: X / U = exp(-s delay) hold / D(s), with the delay that
converter and hold are declared to have. Then D (X / U) exp(s delay) / hold - 1 is the relative error of the fit and
linear in the coefficients of D: weighted least squares, one solution for each order. The order is the smallest whose
error in periods that it was not fitted to is within a tenth of the least. The load cell gives the specimen:
F / X = k - m w^2 + j w c, linear in m, c and k, none of which is negative.

The first period settles and is not used; the scatter of the others is the standard error of their mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from rths_cli.errors import InputError
from rths_cli.identification.results import (
    Candidate,
    FitError,
    Identification,
    SpecimenFit,
)
from rths_cli.identification.verdict import LIMITS, judge
from rths_cli.numerics.bands import ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Integers, Model, hold_size
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Specimen

PERIODS = 5
SHARE = 0.25  # of each limit that the excitation takes, by the declared specimen
FALLS_HZ = 3.0  # of the usual band: above it, displacements fall with frequency
RAMP_S = 1.0
ORDERS = (2, 3, 4, 5, 6)
NEAR = 1.1  # of the least held-out error, within which the smaller order is taken


@dataclass(frozen=True)
class Multisine:
    """A multisine: command (n,) in V, at rest for `rest` samples first; `period` in samples; its lines."""

    command_v: Array
    rest: int
    period: int
    lines: Integers  # (m,) numbers of the excited lines of a period
    frequency_hz: Array  # (m,)


def multisine(
    info: RigInfo,
    specimen: Specimen,
    band_hz: tuple[float, float],
    duration_s: float,
    seed: int,
    compared: ComparedBand,
) -> Multisine:
    """Return a multisine of random phases whose displacement, velocity and force take a quarter of each limit.

    Raises InputError where the band has too few lines.
    """
    period = round(duration_s / PERIODS / info.dt_s)
    first, last = int(np.ceil(band_hz[0] * period * info.dt_s)), int(np.floor(band_hz[1] * period * info.dt_s))
    lines = np.arange(max(first, 1), last + 1)
    if len(lines) < 20:
        raise InputError(
            f"identification.duration_s: a period of {period * info.dt_s:g} s has {len(lines)} lines in the excited "
            "band, 20 are needed; raise it, or widen low_hz to high_hz"
        )
    hz = lines / (period * info.dt_s)
    phases = np.random.default_rng((seed, 1)).uniform(0.0, 2.0 * np.pi, len(lines))
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * phases) / (1.0 + hz / compared.with_high(FALLS_HZ))
    angle = 2j * np.pi * np.arange(len(spectrum)) / (period * info.dt_s)
    stiffness = specimen.K[0, 0] + specimen.C[0, 0] * angle + specimen.masses_kg[0] * angle**2
    place, velocity, force = (np.abs(np.fft.irfft(by * spectrum, period)).max() for by in (1.0, angle, stiffness))
    limits, gain = info.limits, info.gain_m_per_v
    most = min(
        limits.stroke_m / place, limits.fastest_m_s(gain) / velocity, limits.force_n / force,
        gain * info.converters.range_v / place,
    )  # fmt: skip
    one = np.fft.irfft(SHARE * most * spectrum, period) / gain
    command = np.tile(one, PERIODS)
    ramp = min(int(RAMP_S / info.dt_s), period // 2)
    command[:ramp] *= 0.5 - 0.5 * np.cos(np.pi * np.arange(ramp) / ramp)
    command[-ramp:] *= 0.5 + 0.5 * np.cos(np.pi * np.arange(ramp) / ramp)
    return Multisine(np.concatenate([np.zeros(ramp), command]), ramp, period, lines, hz)


def identify_actuator(
    info: RigInfo, played: Multisine, measured: Array, band_hz: tuple[float, float], compared: ComparedBand
) -> Identification:
    """Return the identification from the channels (2, n), displacement in m and force in N, of a multisine.

    `band_hz`: where the model is fitted. Raises InputError for channels that do not move.
    """
    lines = (played.lines >= np.ceil(band_hz[0] * played.period * info.dt_s)) & (played.frequency_hz <= band_hz[1])
    hz = played.frequency_hz[lines]
    rows = np.vstack([played.command_v[None], measured])
    periods = rows[:, played.rest + played.period :].reshape(3, PERIODS - 1, played.period)
    spectra = np.fft.rfft(periods[:, :-1], axis=2)[:, :, played.lines[lines]]  # the last one ramps down
    command, place, force = spectra
    for name, one in (("displacement", place), ("force", force)):
        if not np.abs(one).max() > 0.0:
            raise InputError(f"channel {name}: shows nothing under excitation; check sensor, cable and power")
    mean = spectra.mean(axis=1)
    response, s = mean[1] / mean[0], 2j * np.pi * hz
    each = place / command
    error = np.maximum(np.std(each, axis=0, ddof=1) / np.sqrt(each.shape[0]) / np.abs(response), 1e-7)
    delay_s = (info.latency_samples + 0.5) * info.dt_s + info.transport_s
    lag = np.exp(-s * delay_s) * hold_size(hz, info.dt_s)
    halves = each[0] / lag, each[1:].mean(axis=0) / lag
    candidates, fits = [], {}
    for order in ORDERS:
        held = _denominator(halves[0], s, error, order)
        missed = np.abs(_poly(held, s) * halves[1] - 1.0) / (error * np.sqrt(each.shape[0]))
        fits[order] = _denominator(response / lag, s, error, order)
        stable = bool(np.all(np.roots(fits[order][::-1]).real < 0.0))
        score = float(np.sqrt(np.mean(missed**2))) if stable else np.inf
        candidates.append(Candidate(f"{order} poles, no zeros", order, 0, score))
    least = min(one.held_out for one in candidates)
    if not np.isfinite(least):
        raise InputError("identification: no stable model fits displacement over command; excite longer or louder")
    chosen = next(one for one in candidates if one.held_out <= NEAR * least)
    candidates = [Candidate(c.name, c.poles, c.zeros, c.held_out, c is chosen) for c in candidates]
    denominator = fits[chosen.poles]
    poles = np.roots(denominator[::-1]).astype(complex)
    model = Model(
        np.zeros(2, complex), poles, float(1.0 / denominator[-1]), delay_s, (float(hz[0]), float(hz[-1])),
        0.0, info.latency_samples, info.dt_s,
    )  # fmt: skip
    coherence = 1.0 / (1.0 + each.shape[0] * error**2)
    frf = Frf(hz, response * s**2, coherence, error, each.shape[0])
    fit_error = _fit_error(model, frf, compared)
    cell = Frf(hz, mean[2] / mean[0], coherence, error, each.shape[0])
    noise = np.var(spectra[1:], axis=1, ddof=1).mean(axis=1) / each.shape[0]  # white
    scatter = np.sqrt((noise[:, None] / np.abs(mean[1:]) ** 2).sum(axis=0))
    fit = _specimen(mean[2] / mean[1], s, np.maximum(scatter, 1e-7))
    verdict = judge(model, fit_error, frf, LIMITS, (), compared=compared)
    return Identification(
        (frf, cell), (None, None), model, model, fit_error, fit_error, fit, None, (), tuple(candidates), (), (), (),
        verdict, compared=compared,
        at_rest=measured[:, : played.rest].std(axis=1),
    )  # fmt: skip


def _denominator(response: ComplexArray, s: ComplexArray, error: Array, order: int) -> Array:
    """Return the real coefficients (order + 1,), lowest first, of D with D response nearest to 1 within `error`."""
    size = float(np.abs(s).max())
    columns = np.stack([(s / size) ** i * response / error for i in range(order + 1)], axis=1)
    both, wanted = np.vstack([columns.real, columns.imag]), np.concatenate([1.0 / error, 0.0 * error])
    return np.asarray(np.linalg.lstsq(both, wanted, rcond=None)[0] / size ** np.arange(order + 1))


def _poly(coefficients: Array, s: ComplexArray) -> ComplexArray:
    return np.asarray(np.polyval(coefficients[::-1], s), dtype=complex)


def _fit_error(model: Model, frf: Frf, compared: ComparedBand) -> FitError:
    """Return the relative error of a model beyond the scatter of the data."""
    ratio = np.abs(model.response(frf.frequency_hz) / frf.response - 1.0)
    beyond = np.sqrt(np.maximum(ratio**2 - frf.relative_error**2, 0.0))

    def inside(ends: tuple[float, float]) -> Array:
        return beyond[(frf.frequency_hz >= ends[0]) & (frf.frequency_hz <= ends[1])]

    whole, middle = inside(compared.hz), inside(compared.mid_hz)
    return FitError(float(np.sqrt(np.mean(whole**2))), float(whole.max()), float(np.sqrt(np.mean(middle**2))))


def _specimen(ratio: ComplexArray, s: ComplexArray, error: Array) -> SpecimenFit:
    """Return the specimen whose force over displacement is a ratio (m,) of this relative error (m,) at s = j w (m,)."""
    weight = 1.0 / (error * np.abs(ratio))  # without the error, noise of small displacements biases all three alike
    size = float(np.abs(s).max())
    columns = np.stack([np.ones_like(s), s / size, (s / size) ** 2], axis=1) * weight[:, None]
    both = np.vstack([columns.real, columns.imag])
    wanted = np.concatenate([(ratio * weight).real, (ratio * weight).imag])
    scale = float(np.abs(ratio).max())
    found, left = nnls(both, wanted / scale)
    k, c, m = scale * found / size ** np.arange(3)
    used = both[:, found > 0.0]
    spread = np.zeros(3)
    variance = left**2 / max(len(wanted) - used.shape[1], 1)
    spread[found > 0.0] = scale * np.sqrt(variance * np.diag(np.linalg.inv(used.T @ used)))
    spread /= size ** np.arange(3)
    hz = float(np.sqrt(k / m) / (2.0 * np.pi)) if m > 0.0 else np.nan
    ratio_ = float(c / (2.0 * np.sqrt(k * m))) if m > 0.0 and k > 0.0 else np.nan
    relative = float(np.hypot(spread[0] / k, spread[2] / m)) if m > 0.0 and k > 0.0 else np.nan
    return SpecimenFit(
        Specimen(np.array([m]), np.array([[k]]), np.array([[c]]), attached=True),
        np.array([k]), np.array([c]), np.array([hz]), np.array([ratio_]), np.ones((1, 1)), np.array([spread[0]]),
        np.array([0.5 * hz * relative]), np.array([ratio_ * spread[1] / c if c > 0.0 else np.nan]),
        np.array([np.nan]), np.array([np.nan]),
        float(np.sqrt(np.mean(np.abs((k + c * s + m * s**2) / ratio - 1.0) ** 2))),
    )  # fmt: skip
