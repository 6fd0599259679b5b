"""Frequency responses from records: H1, H2 or Hv, coherence, scatter.

Noise is cut into Hann segments that overlap by half (Welch's method); an excitation that repeats is cut into its whole
periods, which leak nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from rths_cli.errors import InputError
from rths_cli.identification.record_parts import PaddedLines, Record, padded
from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model

Estimator = Literal["h1", "h2", "hv"]

LEAST_SEGMENTS = 4
LEAST_PERIODS = 3
OVERLAP_CORRELATION = 1.0 / 36.0  # squared correlation of Hann segments that overlap by half (Welch 1967)
HANN_BANDWIDTH = 1.5  # lines
ERROR_FLOOR = 1e-6
SMOOTHED = 15


@dataclass(frozen=True)
class _Lines:
    """Fourier lines of the segments of a signal."""

    frequency_hz: Array  # (m,)
    values: ComplexArray  # (segments, m)
    averages: float  # number of independent segments
    bandwidth: float  # noise bandwidth of the window, in lines


def estimate(
    records: Sequence[Record], dt_s: float, band_hz: tuple[float, float], segment_s: float, estimator: Estimator = "h1"
) -> tuple[Frf, ...]:
    """Estimate the response from the command in V to each channel in m/s^2 at the lines within a band.

    The response is computed to the second difference of the command, and then converted exactly to the response to the
    command. The second difference makes response and spectrum flat at low frequencies, where leakage would otherwise be
    visible. Each sample of each record has the same weight. Raises InputError if a record is too short.
    """
    given = [np.diff(record.command_v, 2, prepend=[0.0, 0.0]) for record in records]
    channels = range(len(records[0].accel_m_s2))
    frfs = responses(records, given, [[r.accel_m_s2[c] for r in records] for c in channels], dt_s, band_hz, segment_s,
                     estimator)  # fmt: skip
    difference = (1.0 - np.exp(-2j * np.pi * frfs[0].frequency_hz * dt_s)) ** 2
    return tuple(replace(frf, response=frf.response * difference) for frf in frfs)


def responses(
    records: Sequence[Record], given: Sequence[Array], outputs: Sequence[Sequence[Array]], dt_s: float,
    band_hz: tuple[float, float], segment_s: float, estimator: Estimator,
) -> tuple[Frf, ...]:  # fmt: skip
    """Return the responses from inputs to outputs, each a signal (n,) per record, over the records' excitation."""
    check_lengths(records, dt_s, segment_s)
    inputs = _pooled(records, given, dt_s, band_hz, segment_s)
    return tuple(_response(inputs, _pooled(records, output, dt_s, band_hz, segment_s), estimator) for output in outputs)


def check_lengths(records: Sequence[Record], dt_s: float, segment_s: float) -> None:
    """Raise InputError when a record has too few segments or periods."""
    for record in records:
        count = record.parts.noise.stop - record.parts.noise.start
        length, least, name = _cut(record, dt_s, segment_s)
        if count < least * length:
            raise InputError(
                f"identification.duration_s: {count * dt_s:.0f} s of excitation is shorter than {least} {name} of "
                f"{length * dt_s:g} s; excite for longer"
            )


def _cut(record: Record, dt_s: float, segment_s: float) -> tuple[int, int, str]:
    """Return the length of segments or periods in samples, their least number, and their name."""
    if record.parts.period_samples:
        return record.parts.period_samples, LEAST_PERIODS, "periods"
    return round(segment_s / dt_s), LEAST_SEGMENTS, "segments"


def _pooled(
    records: Sequence[Record], signals: Sequence[Array], dt_s: float, band_hz: tuple[float, float], segment_s: float
) -> _Lines:
    """Return the lines of all segments of all records."""
    parts = [
        _lines(signal[r.parts.noise], r, dt_s, band_hz, segment_s) for r, signal in zip(records, signals, strict=True)
    ]
    if len({len(part.frequency_hz) for part in parts}) > 1:
        raise InputError("records: their segments differ in length; evaluate records of one kind together")
    values = np.vstack([part.values for part in parts])
    return _Lines(parts[0].frequency_hz, values, sum(part.averages for part in parts), parts[0].bandwidth)


def _lines(signal: Array, record: Record, dt_s: float, band_hz: tuple[float, float], segment_s: float) -> _Lines:
    """Return the Fourier lines of each segment less its mean: Hann and half overlapping, or whole periods."""
    length, _, _ = _cut(record, dt_s, segment_s)
    periodic = record.parts.period_samples > 0
    window, overlap = ("boxcar", 0) if periodic else ("hann", length - length // 2)
    frequency, values = _segments(signal, dt_s, length, window, overlap)
    inside = (frequency >= band_hz[0] - 1e-9) & (frequency <= band_hz[1] + 1e-9)
    count = len(values)
    alike = 1.0 if periodic else 1.0 + 2.0 * OVERLAP_CORRELATION * (count - 1) / count
    return _Lines(frequency[inside], values[:, inside], count / alike, 1.0 if periodic else HANN_BANDWIDTH)


def _segments(signal: Array, dt_s: float, length: int, window: str, overlap: int) -> tuple[Array, ComplexArray]:
    """Return the frequencies (length // 2 + 1,) in Hz and the lines (segments, length // 2 + 1) of a signal's segments.

    Each segment is taken less its mean. The lines of white noise of variance v have the mean square b v / `length`, b
    being the noise bandwidth of the window in lines.
    """
    from scipy.signal import stft

    frequency, _, lines = stft(
        signal, 1.0 / dt_s, window, length, overlap, detrend="constant", boundary=None, padded=False
    )
    return frequency, lines.T


def _response(given: _Lines, output: _Lines, estimator: Estimator) -> Frf:
    """Return response, coherence and standard error from the segments' lines of input and output.

    H1 = Sxy / Sxx is free of bias under noise in the output, H2 = Syy / Syx under noise in the input, Hv, their
    geometric mean, lies between. Standard error: sqrt((1 - c) / (2 c n)) (Bendat and Piersol, Random Data, chapter 9).
    A line at which input or output is exactly zero says nothing: response and coherence 0, an infinite error.
    """
    power = np.sum(np.abs(given.values) ** 2, axis=0)
    out = np.sum(np.abs(output.values) ** 2, axis=0)
    cross = np.sum(np.conj(given.values) * output.values, axis=0)
    coherence = _quotient(np.abs(cross) ** 2, power * out)
    h1 = _quotient(cross, power)
    share = {"h1": np.ones_like(coherence), "h2": coherence, "hv": np.sqrt(coherence)}[estimator]
    response = _quotient(h1, share)
    spread = _quotient((1.0 - coherence).clip(min=0.0), 2.0 * coherence * given.averages, np.inf)
    error = np.sqrt(spread).clip(min=ERROR_FLOOR)
    return Frf(given.frequency_hz, response, coherence, error, round(given.averages), given.bandwidth)


def _quotient(over: Array | ComplexArray, under: Array, otherwise: float = 0.0) -> Any:
    """Return over / under, and `otherwise` where `under` is zero."""
    return np.divide(over, under, out=np.full_like(over, otherwise), where=under > 0.0)


def without_leakage(
    frf: Frf, model: Model, records: Sequence[Record], segment_s: float, estimator: Estimator = "h1"
) -> Frf:
    """Return the table's FRF without leakage, with the help of a model.

    Segments average a response over neighbouring lines and truncate vibrations at their ends. The error is 1-2 % in the
    valleys of a specimen of 4 % damping, and a quarter for 0.5 %. The response from the model's simulated output to the
    measured output is near 1 and has hardly any leakage. Multiplied by the model's exact response it is the table's.
    The remaining error is leakage times the model's own error.
    """
    f = frf.frequency_hz
    over = over_model(model, records, (float(f[0]), float(f[-1])), segment_s, estimator)
    return replace(over, response=over.response * model.sampled_response(f))


def over_model(
    model: Model, records: Sequence[Record], band_hz: tuple[float, float], segment_s: float, estimator: Estimator = "h1"
) -> Frf:
    """Return the table's response over the model's: 1 where the model is right.

    For an excitation in whole periods the standard errors include the scatter from line to line.
    """
    lines = [r.command_lines(padded(len(r.command_v), model.dt_s), model.dt_s) for r in records]
    simulated = [_answered(model, each, 1.2 * band_hz[1]) for each in lines]
    table = [record.accel_m_s2[0] for record in records]
    over = responses(records, simulated, [table], model.dt_s, band_hz, segment_s, estimator)[0]
    if not records[0].parts.period_samples:
        return over
    return replace(over, relative_error=np.maximum(over.relative_error, line_scatter(over.response)))


def line_scatter(over: ComplexArray) -> Array:
    """Return the standard error (m,) of the lines of a response over its model, from the scatter of neighbouring lines.

    With a periodic excitation the effect of friction is the same in every period, so that coherence does not show it.
    It varies from line to line, unlike any smooth response. The second difference of three lines has 6 times the
    variance of one line; it is averaged over SMOOTHED lines.
    """
    second = np.abs(np.diff(over, 2)) ** 2 / 12.0
    padded = np.pad(second, (SMOOTHED // 2 + 1, SMOOTHED // 2 + 1), mode="reflect")
    return np.sqrt(np.convolve(padded, np.ones(SMOOTHED) / SMOOTHED, mode="valid"))


def simulate(model: Model, command_v: Array, high_hz: float) -> Array:
    """Return the table's samples (n,) in m/s^2 that a model predicts from rest.

    The command (n,) in V must have no content above `high_hz`.
    """
    count = padded(len(command_v), model.dt_s)
    command = PaddedLines(np.fft.rfft(command_v, count), count, model.dt_s)
    return _answered(model, command, high_hz)[: len(command_v)]


def _answered(model: Model, command: PaddedLines, high_hz: float) -> Array:
    """Return the table's samples in m/s^2 that a model predicts for a command, including the rest at its end."""
    duration_s = command.count * command.dt_s
    frequency = np.arange(min(int(high_hz * duration_s) + 1, len(command.values))) / duration_s
    answer = np.zeros_like(command.values)
    answer[: len(frequency)] = command.values[: len(frequency)] * model.sampled_response(frequency)
    return np.fft.irfft(answer, command.count)


def noise_floor(records: Sequence[Record], frf: Frf, channel: int, dt_s: float) -> Array | None:
    """Return the |response| (m,) that a channel's noise at rest alone would cause, None without a silent part.

    It is the root of the silence's power (one-second Hann segments) over that of the excitation and over the averages.
    """
    quiet = [r.accel_m_s2[channel, r.parts.silence] for r in records if r.parts.silence is not None]
    length = round(1.0 / dt_s)
    pieces = [_segments(q, dt_s, length, "hann", 0) for q in quiet if len(q) >= length]
    if not pieces:
        return None
    density = np.mean(np.abs(np.vstack([values for _, values in pieces])) ** 2, axis=0) * length / HANN_BANDWIDTH
    at_rest = np.interp(frf.frequency_hz, pieces[0][0], density)
    driven = np.zeros(len(frf.frequency_hz))
    segment_s = 1.0 / (frf.frequency_hz[1] - frf.frequency_hz[0])
    for record in records:
        lines = _lines(record.command_v[record.parts.noise], record, dt_s, (frf.frequency_hz[0], frf.frequency_hz[-1]),
                       segment_s)  # fmt: skip
        power = np.mean(np.abs(lines.values) ** 2, axis=0) * round(segment_s / dt_s) / lines.bandwidth
        driven += power / len(records)
    return np.sqrt(at_rest / driven / frf.averages)
