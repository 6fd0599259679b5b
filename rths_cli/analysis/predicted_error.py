"""The predicted error of a hybrid test, also with another specimen or with motion of a few bits.

The reference is SIM of the numerical substructure with the identified specimen. Deterministic causes are added as
series, noise and rounding by their power; all are evaluated in the test band.

Rounding errors are noise (analysis/quantisation.py) as long as they do not depend on each other and on the motion. In
a motion of a few bits they do: the converter is then a gain in phase with the motion (describing function of a
quantiser: Gelb and Vander Velde, Multiple-Input Describing Functions, 1968, section 2.3), 0 where the motion stays
within a bit and large where it crosses an edge by little, so that a loop may vibrate by it. Such tests are played on
the identified rig with its converters (experiment/simulated_test.py); here it is told which these are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from rths_cli.analysis.closed_loop import LoopResponse, Motion, hybrid, on_perfect_table
from rths_cli.analysis.fourier_lines import Lines, sim_lines
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.quantisation import rounding_power
from rths_cli.control.friction_compensation import FrictionFeedforward
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.identification.results import Friction
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Block, ComplexArray, Frf, Model, hold_size
from rths_cli.rigs.description import RigInfo
from rths_cli.structure import Building, Specimen

CAUSES = ("coupling", "latency", "model", "friction", "rounding", "noise", "quantisation")
SHAKEN_POINTS = 400  # up to half the sample rate
SMOOTHED_HZ = 0.5  # width, with the usual band, over which the ratio of measured response to model is averaged

SHARES = 0.002, 0.005  # of SIM's RMS, rounding as noise: below the first it stays noise, above the second it is not
DITHERED = 0.5  # bits of noise, rms, with which rounding is noise: a describing function within 1 % of one
TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class Errors:
    """RMS errors in m/s^2 in the test band: of the storeys (n_storeys,) against SIM, and the table's tracking error."""

    storeys: Array
    tracking: float


@dataclass(frozen=True)
class Prediction:
    """Predicted errors by cause and in total, and the undisturbed motion on lines.

    `true` (n_storeys,): RMS errors in m/s^2 of the true accelerations, which do not contain what sensors add to the
    motions that they report.
    """

    causes: Mapping[str, Errors]
    total: Errors
    true: Array
    nominal: Motion


@dataclass(frozen=True)
class FewBits:
    """Simulated rounding errors of a motion of a few bits: mean squares in (m/s^2)^2 in the test band."""

    weight: float  # 0 to 1: with what is left to one, rounding counts as noise
    samples: Array  # (n_storeys + 1,) by the rounding of samples: of the storeys, then of tracking
    command: Array  # (n_storeys + 1,) by that of commands, unless it is shaped
    true: Array  # (n_storeys,) by both, in the true motions


@dataclass(frozen=True)
class PredictionInputs:
    """The inputs of a prediction; all of them are identified or declared."""

    loop: LoopResponse
    lines: Lines
    model: Model  # of the table
    measured: Frf  # response of the table
    friction: Friction | None
    floors: ComplexArray  # (c, m) accelerations of table (one) and floors per table acceleration
    ground: ComplexArray  # (3, m) acceleration, velocity and displacement
    sim: ComplexArray  # (n_storeys, m) accelerations of SIM with the identified specimen
    velocity_m_s: Array  # (n,) of the interface
    noise_m_s2: Array  # (c,) rms of the channels' noise at rest
    rig: RigInfo
    correction: Block  # the sensor correction of the step
    shaped: bool  # whether commands are rounded with noise shaping
    compensation: FrictionFeedforward | None = None  # that counters friction; None: nothing does
    excess: float = 0.0  # as in IdentifiedRig
    compared: ComparedBand = USUAL  # band in which the model was compared with its data
    specimen: Specimen | None = None  # as identified
    peaks_m_s2: Array | None = None  # (c,) peaks of SIM's interface and floors at all frequencies; None: not known
    # (c,) in m/s^2: what the zeros at rest are off by, as a record in motion showed; None: not known
    zero_m_s2: Array | None = None
    # (k,) rad/s: roots of motions of the loop that do not decay within the padding after the record
    slow_roots: ComplexArray = field(default_factory=lambda: np.zeros(0, dtype=complex))
    few_bits: FewBits | None = None  # None: rounding of samples and commands is noise
    law: bool = False  # whether the feedforward is a law whose commands may leave those of its block

    @property
    def bits_m_s2(self) -> Array:
        """Return the size (c,) of a bit of the channels."""
        return self.rig.converters.step_v / np.array([c.sensitivity_v_per_unit for c in self.rig.channels])


def predict(known: PredictionInputs) -> Prediction:
    """Return the predicted errors of the hybrid test."""
    nothing = np.zeros_like(known.floors)
    nominal = hybrid(known.loop, known.ground, nothing)
    perfect = on_perfect_table(known.loop, known.floors, known.ground)
    still = np.zeros_like(known.ground)
    disturbed = {"model": model_error_samples(known, nominal.command_v), "friction": friction_samples(known)}
    made = {name: hybrid(known.loop, still, samples) for name, samples in disturbed.items()}
    series = {
        "coupling": known.sim - perfect.storeys,
        "latency": perfect.storeys - nominal.storeys,
    } | {name: -motion.storeys for name, motion in made.items()}
    tracking = {
        "coupling": np.zeros_like(nominal.tracking),
        "latency": nominal.tracking,
    } | {name: motion.tracking for name, motion in made.items()}
    powers, of_true = _stochastic(known, nominal)
    causes = {name: Errors(_rms(known, series[name]), float(_rms(known, tracking[name]))) for name in series}
    causes |= {name: Errors(np.sqrt(power[:-1]), float(np.sqrt(power[-1]))) for name, power in powers.items()}
    random = np.sum(list(powers.values()), axis=0)
    certain = _rms(known, np.sum(list(series.values()), axis=0)) ** 2
    together = Errors(
        np.sqrt(certain + random[:-1]),
        float(np.sqrt(_rms(known, np.sum(list(tracking.values()), axis=0)) ** 2 + random[-1])),
    )
    return Prediction(causes, together, np.sqrt(certain + of_true), nominal)


def _rms(known: PredictionInputs, lines: ComplexArray) -> Array:
    return rms(known.lines.evaluated(lines))


def model_error_samples(known: PredictionInputs, command_v: ComplexArray) -> ComplexArray:
    """Return the change of the samples (c, m) if the table responds as measured instead of as modelled to commands
    (m,).

    The part of the difference that is alias (`excess`) is removed.
    """
    ratio = data_ratio(known.model, known.measured, known.lines.frequency_hz, known.compared) / (1.0 + known.excess)
    return known.loop.rig * (ratio - 1.0) * command_v


def data_ratio(model: Model, measured: Frf, frequency_hz: Array, compared: ComparedBand = USUAL) -> ComplexArray:
    """Return the measured response, minus the staircase's alias, over the model (m,), averaged over SMOOTHED_HZ.

    It is one outside the band of the data.
    """
    f = measured.frequency_hz
    ratio = (measured.response - model.alias(f)) / model.response(f)
    inside = _in_band(model, f)
    f, ratio = f[inside], ratio[inside]
    kernel = _kernel(f, compared)
    mean = np.convolve(ratio, kernel, "same") / np.convolve(np.ones(len(f)), kernel, "same")
    found = np.interp(frequency_hz, f, mean.real) + 1j * np.interp(frequency_hz, f, mean.imag)
    return np.where((frequency_hz >= f[0]) & (frequency_hz <= f[-1]), found, 1.0)


def ratio_error(model: Model, measured: Frf, frequency_hz: Array, compared: ComparedBand = USUAL) -> Array:
    """Return the standard uncertainty (m,) of `data_ratio` from the scatter of the averaged lines.

    It is zero outside the band of the data.
    """
    inside = _in_band(model, measured.frequency_hz)
    f, variance = measured.frequency_hz[inside], measured.relative_error[inside] ** 2
    kernel = _kernel(f, compared)
    lines = np.convolve(np.ones(len(f)), kernel, "same")
    independent = np.maximum(lines / measured.bandwidth_lines, 1.0)
    error = np.sqrt(np.convolve(variance, kernel, "same") / lines / independent)
    return np.interp(frequency_hz, f, error, left=0.0, right=0.0)


def _in_band(model: Model, frequency_hz: Array) -> np.ndarray:
    return (frequency_hz >= model.band_hz[0]) & (frequency_hz <= model.band_hz[1])


def _kernel(frequency_hz: Array, compared: ComparedBand) -> Array:
    """Return the kernel of ones that sums lines over SMOOTHED_HZ; it has odd length, so that it is centred."""
    return np.ones(2 * round(0.5 * compared.with_high(SMOOTHED_HZ) / (frequency_hz[1] - frequency_hz[0])) + 1)


def friction_samples(known: PredictionInputs) -> ComplexArray:
    """Return the disturbance of the corrected samples (c, m) by dry friction, which acts without a command's delay.

    Where it is countered, the share is left that the identification's low-level record showed.
    """
    if known.friction is None:
        return np.zeros_like(known.floors)
    left = known.compensation.left if known.compensation else 1.0
    return left * samples_of_push(known) * known.lines.of(known.friction.disturbance_v(known.velocity_m_s))


def samples_of_push(known: PredictionInputs) -> ComplexArray:
    """Return the response (c, m) of the corrected samples to a command that acts without delay, per V."""
    return known.floors * at_once(known.model, known.lines.frequency_hz) / known.loop.ahead


def at_once(model: Model, frequency_hz: Array) -> ComplexArray:
    """Return the table's response (m,) without delay and hold."""
    late = np.exp(2j * np.pi * frequency_hz * model.delay_s)
    return model.response(frequency_hz) * late / hold_size(frequency_hz, model.dt_s)


def of_correction(known: PredictionInputs) -> ComplexArray:
    """Return what the sensor correction makes (c, m) of each channel, of one without corners 1; 0 at 0 Hz."""
    sizes = np.array([c.sensitivity_v_per_unit for c in known.rig.channels])
    corrected = np.einsum("ccm->cm", known.correction.response(known.lines.frequency_hz[1:])) * sizes[:, None]
    return np.concatenate([np.zeros((len(sizes), 1)), corrected], axis=1)


def _stochastic(known: PredictionInputs, nominal: Motion) -> tuple[dict[str, Array], Array]:
    """Return the power (n_storeys + 1,) in the test band of each random cause, for the storeys, then for tracking, and
    that of all together (n_storeys,) in the true motions."""
    lines, dt = known.lines, known.rig.dt_s
    bit, few, noise = known.rig.converters.step_v, known.few_bits, white_noise_m_s2(known)
    moved = _by_command(known)
    powers = {cause: np.zeros(len(nominal.storeys) + 1) for cause in ("noise", "quantisation", "rounding")}
    of_true = np.zeros(len(nominal.storeys))
    for channel, of_noise in enumerate(_of_channels(known, nominal, moved)):
        density, rounded = _density(known, of_noise.made), of_noise.rounded
        if few is not None:
            rounded = (1.0 - few.weight) * rounded
        powers["noise"] += noise[channel] ** 2 * density.sum(axis=1)
        powers["quantisation"] += density @ rounded[1:]
        of_true += _density(known, of_noise.moved)[:-1] @ (noise[channel] ** 2 + rounded[1:])
    command = lines.series(nominal.command_v)
    # noise shaping adds earlier rounding errors to the command, which then varies fast enough for white noise
    rounded = (
        np.full(lines.count, bit**2 / 12.0)
        if known.shaped
        else rounding_power(lines.frequency_hz, command, lines.reduced_dt_s, bit, 0.0, dt)
    )
    if few is not None and not known.shaped:
        rounded = (1.0 - few.weight) * rounded
    powers["rounding"] += _density(known, moved) @ rounded[1:]
    of_true = of_true + powers["rounding"][:-1]
    if few is not None:
        powers["quantisation"] += few.weight * few.samples
        powers["rounding"] += few.weight * few.command
        of_true = of_true + few.weight * few.true
    return powers, of_true


class _NoiseOfChannel(NamedTuple):
    """The loop's answer to white noise of variance one per sample in a channel."""

    made: Motion  # as reported
    moved: Motion  # the same without what the sensor adds to the motion that it reports
    rounded: Array  # (m,) power of the channel's rounding errors by line, per sample


def _of_channels(known: PredictionInputs, nominal: Motion, moved: Motion) -> Iterator[_NoiseOfChannel]:
    """Yield the answer to the noise of each channel; `moved` by rounded commands."""
    lines, dt, bits, noise = known.lines, known.rig.dt_s, known.bits_m_s2, white_noise_m_s2(known)
    corrected = of_correction(known)
    shaken = _shaken(known, moved)  # spreads the samples' rounding errors
    series = lines.series(nominal.corrected)
    for channel in range(len(bits)):
        unit = np.zeros_like(known.floors)
        unit[channel] = corrected[channel]
        made = hybrid(known.loop, np.zeros_like(known.ground), unit)
        rounded = rounding_power(
            lines.frequency_hz, series[channel], lines.reduced_dt_s, bits[channel], noise[channel], dt, shaken[channel]
        )
        storeys = made.storeys.copy()
        storeys[len(storeys) - len(bits) + channel] -= unit[channel] * known.loop.ahead
        yield _NoiseOfChannel(made, replace(made, storeys=storeys), rounded)


def noise_shown_and_true(
    known: PredictionInputs, nominal: Motion, shown: Callable[[ComplexArray], ComplexArray]
) -> tuple[Array, Array]:
    """Return the RMS (n_storeys,) in m/s^2 in the test band that noise and rounding of samples are expected to have in
    a figure of the reported motion, and in the true motion.

    `shown`: what the figure makes (n_storeys, m) of the reported motion of the storeys (n_storeys, m). Rounding that is
    no noise (`few_bits`) is in the true motion alone, with that of commands: in the figure, it cannot be told.
    """
    few, noise = known.few_bits, white_noise_m_s2(known)
    read, true = np.zeros(len(nominal.storeys)), np.zeros(len(nominal.storeys))
    left = 1.0 - few.weight if few is not None else 1.0
    for channel, of_noise in enumerate(_of_channels(known, nominal, _by_command(known))):
        power = noise[channel] ** 2 + left * of_noise.rounded[1:]
        seen = replace(of_noise.made, storeys=shown(of_noise.made.storeys))
        read = read + _density(known, seen)[:-1] @ power
        true = true + _density(known, of_noise.moved)[:-1] @ power
    return np.sqrt(read), np.sqrt(true if few is None else true + few.weight * few.true)


def _by_command(known: PredictionInputs) -> Motion:
    """Return the loop's response to white rounding errors of commands, of variance one per sample, as shaped."""
    shape = 1.0 - 1.0 / known.lines.z if known.shaped else np.ones_like(known.lines.z)
    return hybrid(known.loop, np.zeros_like(known.ground), np.zeros_like(known.floors), shape)


def dither_m_s2(known: PredictionInputs) -> Array:
    """Return the rms (c,) of what moves the samples at random before they are rounded: the channels' noise, and the
    motion that a noise-shaped command makes."""
    shaken = np.array([size for size, _ in _shaken(known, _by_command(known))])
    return np.hypot(white_noise_m_s2(known), shaken)


def _shaken(known: PredictionInputs, moved: Motion) -> list[tuple[float, float]]:
    """Return the rms in m/s^2 of each channel's acceleration by the rounding of a noise-shaped command, and of its rate
    in m/s^3; zeros where commands are rounded as they are.

    `moved`: the loop's response to white noise of variance one per sample. Above the lines the table is its model, also
    beyond the model's band, and the loop is open.
    """
    if not known.shaped:
        return [(0.0, 0.0)] * len(known.floors)
    lines, dt, variance = known.lines, known.rig.dt_s, known.rig.converters.step_v**2 / 12.0
    f = np.linspace(lines.highest_hz, 0.5 / dt, SHAKEN_POINTS)
    table = known.model.response(f) * 2.0 * np.sin(np.pi * f * dt)
    floors = np.ones((1, len(f)))
    if known.specimen is not None:
        floors = np.vstack([floors, specimen_state_space(known.specimen).response(f)[:, 0]])
    above = 2.0 * dt * np.abs(table * floors) ** 2
    below = 2.0 * np.abs(moved.corrected[: len(floors)]) ** 2 / lines.padded
    found = []
    for low, high in zip(below, above, strict=True):
        each = (
            variance * (np.sum(low * by(lines.frequency_hz)) + np.trapezoid(high * by(f), f))
            for by in (np.ones_like, lambda at: (2.0 * np.pi * at) ** 2)
        )
        size, rate = (float(np.sqrt(power)) for power in each)
        found.append((size, rate))
    return found + [(0.0, 0.0)] * (len(known.floors) - len(found))


def white_noise_m_s2(known: PredictionInputs) -> Array:
    """Return the standard deviation (c,) of the channels' noise before the sensor correction and before rounding."""
    return _apart(known.noise_m_s2, known.bits_m_s2)


def _apart(noise_m_s2: Array, bits_m_s2: Array) -> Array:
    """Return the noise (c,) of channels at rest without the quantisation noise, which is a separate cause.

    Noise below about half a bit stays within one bit or jumps between two; it is not reduced.
    """
    rounding = bits_m_s2**2 / 12.0
    return np.sqrt(np.where(noise_m_s2**2 > 4.0 * rounding, noise_m_s2**2 - rounding, noise_m_s2**2))


def _density(known: PredictionInputs, unit: Motion) -> Array:
    """Return the contribution (n_storeys + 1, m - 1) of each line but the first to the mean square in the test band.

    `unit` is the response to white noise of variance one per sample. The rows are the storeys, then tracking.
    """
    band = known.lines.test_band() * known.lines.above_slow()
    size = np.abs(np.vstack([unit.storeys, unit.tracking]) * band) ** 2
    return np.asarray(2.0 * size[:, 1:] / known.lines.padded)


def error_if_changed(known: PredictionInputs, nominal: Motion, changed: Building, loop: LoopResponse) -> Array:
    """Return the RMS error (n_storeys,) in m/s^2 that another specimen than the identified one causes.

    `nominal`: the undisturbed test with the identified specimen. `changed` and `loop`: building and loop with the other
    one, the control as designed. The reference is SIM of the building with the other specimen, as the true error's is.
    """
    of_test = hybrid(loop, known.ground, np.zeros_like(nominal.corrected)).storeys - nominal.storeys
    of_sim = sim_lines(changed, known.lines, known.ground[0]) - known.sim
    return rms(known.lines.evaluated(of_test - of_sim))


def weight_of_few_bits(known: PredictionInputs, prediction: Prediction) -> float:
    """Return by how much rounding is no noise in a test: from 0 (it is) to 1 (the test is to be played).

    `prediction` is that with rounding as noise.
    """
    rounded = np.hypot(*(prediction.causes[name].storeys for name in ("quantisation", "rounding")))
    size = np.maximum(rms(known.lines.evaluated(known.sim)), TINY)
    weight = float(np.clip((np.max(rounded / size) - SHARES[0]) / (SHARES[1] - SHARES[0]), 0.0, 1.0))
    return weight if np.any(dither_m_s2(known) < DITHERED * known.bits_m_s2) else 0.0
