"""The error a hybrid test will have, by cause, from what was identified: before anything moves.

Reference is SIM of the numerical part with the identified specimen. Causes that are series add up instant by instant,
noise and rounding by their power; all in the test band.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from rths_cli.analysis.closed_loop_response import LoopResponse, Motion, hybrid, on_perfect_table
from rths_cli.analysis.fourier_lines import Lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.quantisation import rounding_power
from rths_cli.identification.results import Friction
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, Model, hold_size
from rths_cli.rigs.description import RigInfo

CAUSES = ("coupling", "latency", "model", "friction", "rounding", "noise", "quantisation")
SMOOTHED_HZ = 0.5  # over which the ratio of measured response to model is averaged


@dataclass(frozen=True)
class Errors:
    """RMS errors in m/s^2, test band: `storeys` (n_storeys,) against SIM, `tracking` of the table."""

    storeys: Array
    tracking: float


@dataclass(frozen=True)
class Prediction:
    """Errors by cause, all of them together, and the undisturbed motion on lines."""

    causes: Mapping[str, Errors]
    total: Errors
    nominal: Motion


@dataclass(frozen=True)
class Known:
    """What a prediction starts from: `floors` (c, m) accelerations of table (one) and floors per table acceleration,
    `sim` (n_storeys, m) and `ground` (3, m) on lines, `velocity_m_s` (n,) of the interface, noise of each channel at
    rest (c,) in m/s^2; `excess` as in IdentifiedRig; `peaks_m_s2` (c,) of SIM's interface and floors, all frequencies
    (None: not known); `slow_roots` (k,) in rad/s of those motions of the loop that outlast the lines' room after the
    record."""

    loop: LoopResponse
    lines: Lines
    model: Model
    measured: Frf
    friction: Friction | None
    floors: ComplexArray
    ground: ComplexArray
    sim: ComplexArray
    velocity_m_s: Array
    noise_m_s2: Array
    rig: RigInfo
    correction: Block
    shaped: bool
    excess: float = 0.0
    peaks_m_s2: Array | None = None
    slow_roots: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))


def predict(known: Known) -> Prediction:
    """Return the predicted errors of the hybrid test."""
    nothing = np.zeros_like(known.floors)
    nominal = hybrid(known.loop, known.ground, nothing)
    perfect = on_perfect_table(known.loop, known.floors, known.ground)
    still = np.zeros_like(known.ground)
    disturbed = {"model": _model_error(known, nominal), "friction": friction_samples(known)}
    made = {name: hybrid(known.loop, still, samples) for name, samples in disturbed.items()}
    series = {
        "coupling": known.sim - perfect.storeys,
        "latency": perfect.storeys - nominal.storeys,
    } | {name: -motion.storeys for name, motion in made.items()}
    tracking = {
        "coupling": np.zeros_like(nominal.tracking),
        "latency": nominal.tracking,
    } | {name: motion.tracking for name, motion in made.items()}
    powers = _stochastic(known, nominal)
    causes = {name: Errors(_rms(known, series[name]), float(_rms(known, tracking[name]))) for name in series}
    causes |= {name: Errors(np.sqrt(power[:-1]), float(np.sqrt(power[-1]))) for name, power in powers.items()}
    random = np.sum(list(powers.values()), axis=0)
    together = Errors(
        np.sqrt(_rms(known, np.sum(list(series.values()), axis=0)) ** 2 + random[:-1]),
        float(np.sqrt(_rms(known, np.sum(list(tracking.values()), axis=0)) ** 2 + random[-1])),
    )
    return Prediction(causes, together, nominal)


def _rms(known: Known, lines: ComplexArray) -> Array:
    return rms(known.lines.evaluated(lines))


def _model_error(known: Known, nominal: Motion) -> ComplexArray:
    """Return what the samples (c, m) would have more if the table answered as measured, less what of that is alias
    (`excess`), not as modelled."""
    ratio = data_ratio(known.model, known.measured, known.lines.frequency_hz) / (1.0 + known.excess)
    return known.loop.rig * (ratio - 1.0) * nominal.command_v


def data_ratio(model: Model, measured: Frf, frequency_hz: Array) -> ComplexArray:
    """Return measured response over model, less the staircase alias, averaged over SMOOTHED_HZ; one outside the band
    of the data, (m,)."""
    f = measured.frequency_hz
    ratio = (measured.response - model.alias(f)) / model.response(f)
    inside = _in_band(model, f)
    f, ratio = f[inside], ratio[inside]
    kernel = _kernel(f)
    mean = np.convolve(ratio, kernel, "same") / np.convolve(np.ones(len(f)), kernel, "same")
    found = np.interp(frequency_hz, f, mean.real) + 1j * np.interp(frequency_hz, f, mean.imag)
    return np.where((frequency_hz >= f[0]) & (frequency_hz <= f[-1]), found, 1.0)


def ratio_error(model: Model, measured: Frf, frequency_hz: Array) -> Array:
    """Return the standard uncertainty of `data_ratio`, (m,), from the scatter of the lines that it averages; zero
    outside the band of the data."""
    inside = _in_band(model, measured.frequency_hz)
    f, variance = measured.frequency_hz[inside], measured.relative_error[inside] ** 2
    kernel = _kernel(f)
    lines = np.convolve(np.ones(len(f)), kernel, "same")
    independent = np.maximum(lines / measured.bandwidth_lines, 1.0)
    error = np.sqrt(np.convolve(variance, kernel, "same") / lines / independent)
    return np.interp(frequency_hz, f, error, left=0.0, right=0.0)


def _in_band(model: Model, frequency_hz: Array) -> np.ndarray:
    return (frequency_hz >= model.band_hz[0]) & (frequency_hz <= model.band_hz[1])


def _kernel(frequency_hz: Array) -> Array:
    """Return the ones that sum up lines over SMOOTHED_HZ: an odd number, about each line alike."""
    return np.ones(2 * round(0.5 * SMOOTHED_HZ / (frequency_hz[1] - frequency_hz[0])) + 1)


def friction_samples(known: Known) -> ComplexArray:
    """Return what dry friction adds to the corrected samples (c, m): it acts at once, without the command's delay."""
    if known.friction is None:
        return np.zeros_like(known.floors)
    return samples_of_push(known) * known.lines.of(known.friction.disturbance_v(known.velocity_m_s))


def samples_of_push(known: Known) -> ComplexArray:
    """Return the corrected samples (c, m) per V of a command that acts at once."""
    return known.floors * at_once(known.model, known.lines.frequency_hz) / known.loop.ahead


def at_once(model: Model, frequency_hz: Array) -> ComplexArray:
    """Return the table's response (m,) without delay and hold."""
    late = np.exp(2j * np.pi * frequency_hz * model.delay_s)
    return model.response(frequency_hz) * late / hold_size(frequency_hz, model.dt_s)


def _stochastic(known: Known, nominal: Motion) -> dict[str, Array]:
    """Return the power in the test band, storeys then tracking, (n_storeys + 1,), of what is random by cause."""
    lines, dt = known.lines, known.rig.dt_s
    bit = known.rig.converters.step_v
    sizes = np.array([c.sensitivity_v_per_m_s2 for c in known.rig.channels])
    corrected = np.einsum("ccm->cm", known.correction.response(lines.frequency_hz[1:])) * sizes[:, None]
    corrected = np.concatenate([np.zeros((len(sizes), 1)), corrected], axis=1)
    noise, bits = _apart(known.noise_m_s2, bit / sizes), bit / sizes
    series = lines.series(nominal.corrected)
    powers = {cause: np.zeros(len(nominal.storeys) + 1) for cause in ("noise", "quantisation", "rounding")}
    for channel in range(len(sizes)):
        unit = np.zeros_like(known.floors)
        unit[channel] = corrected[channel]
        density = _density(known, hybrid(known.loop, np.zeros_like(known.ground), unit))
        rounded = rounding_power(
            lines.frequency_hz, series[channel], lines.reduced_dt_s, bits[channel], noise[channel], dt
        )
        powers["noise"] += noise[channel] ** 2 * density.sum(axis=1)
        powers["quantisation"] += density @ rounded[1:]
    shape = 1.0 - 1.0 / lines.z if known.shaped else np.ones_like(lines.z)
    moved = hybrid(known.loop, np.zeros_like(known.ground), np.zeros_like(known.floors), shape)
    command = lines.series(nominal.command_v)
    # shaping adds the errors of before to the command, which makes it fast enough for white noise
    rounded = (
        np.full(lines.count, bit**2 / 12.0)
        if known.shaped
        else rounding_power(lines.frequency_hz, command, lines.reduced_dt_s, bit, 0.0, dt)
    )
    powers["rounding"] += _density(known, moved) @ rounded[1:]
    return powers


def _apart(noise_m_s2: Array, bits_m_s2: Array) -> Array:
    """Return the noise (c,) of channels at rest without that of rounding, which is counted by itself; noise of less
    than half a bit hides in one bit or jumps between two, and is taken as it was seen."""
    rounding = bits_m_s2**2 / 12.0
    return np.sqrt(np.where(noise_m_s2**2 > 4.0 * rounding, noise_m_s2**2 - rounding, noise_m_s2**2))


def _density(known: Known, unit: Motion) -> Array:
    """Return what each line but the first, (m - 1), of white noise of one per sample through this adds to the mean
    square in the test band, storeys then tracking."""
    band = known.lines.test_band() * known.lines.above_slow()
    size = np.abs(np.vstack([unit.storeys, unit.tracking]) * band) ** 2
    return np.asarray(2.0 * size[:, 1:] / known.lines.padded)
