"""The error of a hybrid test whose motion is a few bits of its converters: rounding simulated on the expected motion.

Rounding errors are noise (analysis/quantisation.py) as long as they do not depend on each other and on the motion. In
a motion of a few bits they do: the converter is then a gain, which is 0 below half a bit and up to 1.27 above it, and
the force that is fed back is wrong in phase with the motion (describing function of a quantiser: Gelb and Vander Velde,
Multiple-Input Describing Functions, 1968, section 2.3). In a loop with little damping this changes the decay of the
motion itself. So the samples of the expected motion are rounded, their errors are carried through the closed loop, the
motion with these errors is rounded again, and so on. The loop is causal: each round is right for a longer part of the
record (waveform relaxation), and rounding errors are bounded, so that no round is far off. The part of the errors that
is in proportion to the signal over the whole record is no error in a round but a gain with which the loop is closed.

Where within a bit a channel's zero lies is known from a record in motion, or not at all. Several places are drawn.
"""

from __future__ import annotations

import numpy as np

from rths_cli.analysis.closed_loop_response import Motion, hybrid
from rths_cli.analysis.metrics import rms
from rths_cli.analysis.predicted_error import Booleans, FewBits, Known, Prediction, dither_m_s2, of_correction
from rths_cli.numerics.lti import Array, ComplexArray

SHARES = 0.002, 0.005  # of SIM's RMS, rounding as noise: below the first it stays noise, above the second it is not
DITHERED = 0.5  # bits of noise, rms, with which rounding is noise: a describing function within 1 % of one
DRAWS = 3  # of zeros and noise
SEED = 23
ROUNDS = 8  # the errors of further ones are as large
GAINS = (-1.0, 0.1)  # of a converter, less one: those with which the loop is closed
TINY = np.finfo(float).tiny
ZERO_CHANGES = 0.1  # bits by which a zero that was seen changes until the test


def few_bits(known: Known, prediction: Prediction) -> FewBits | None:
    """Return the simulated rounding errors of a stable loop; None where rounding is noise.

    `prediction` is that with rounding as noise.
    """
    bits = known.bits_m_s2
    rounded = np.hypot(*(prediction.causes[name].storeys for name in ("quantisation", "rounding")))
    size = np.maximum(rms(known.lines.evaluated(known.sim)), TINY)
    weight = float(np.clip((np.max(rounded / size) - SHARES[0]) / (SHARES[1] - SHARES[0]), 0.0, 1.0))
    dither = dither_m_s2(known)
    plain = dither < DITHERED * bits
    if weight == 0.0 or not plain.any():
        return None
    random = np.random.default_rng(SEED)
    found = [_played(known, prediction.nominal, dither, plain, random) for _ in range(DRAWS)]
    samples, command, true = (np.mean(each, axis=0) for each in zip(*found, strict=True))
    return FewBits(weight, plain, samples, command, true)


def _played(
    known: Known, nominal: Motion, dither: Array, plain: Booleans, random: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return mean squares in (m/s^2)^2 in the test band, for one draw of zeros and noise: by the rounding of `plain`
    channels (n_storeys + 1,), by that of commands (n_storeys + 1,), of the true motions (n_storeys,)."""
    lines, corrected, still = known.lines, of_correction(known)[plain], np.zeros_like(known.ground)
    step, channels, count = known.bits_m_s2[plain], len(dither), np.count_nonzero(plain)
    place = random.uniform(-0.5, 0.5, channels)[plain]
    if known.zero_m_s2 is not None:
        place = known.zero_m_s2[plain] / step + 2.0 * ZERO_CHANGES * place
    noise = random.standard_normal((count, lines.samples)) * dither[plain, None]
    scale = corrected  # what a reading is corrected to, over the reading; one for the command
    expected = nominal.corrected[plain]
    if not known.shaped:
        step, place = np.append(step, known.rig.converters.step_v), np.append(place, 0.0)
        noise = np.vstack([noise, np.zeros_like(noise[:1])])
        scale = np.vstack([scale, np.ones_like(scale[:1])])
        expected = np.vstack([expected, nominal.command_v])

    def moved(errors: ComplexArray) -> Motion:
        added = np.zeros_like(known.floors)
        added[plain] = errors[:count]
        return hybrid(known.loop, still, added, None if known.shaped else errors[count])

    def before_rounding(errors: ComplexArray) -> ComplexArray:
        motion = moved(errors)
        both = motion.corrected[plain] if known.shaped else np.vstack([motion.corrected[plain], motion.command_v])
        return np.asarray(both - errors)

    ones = np.eye(len(expected), dtype=complex)[:, :, None] * np.ones(lines.count)
    loop = np.array([before_rounding(one) for one in ones]).transpose(2, 1, 0)
    reading = np.where(scale == 0.0, 0.0, 1.0 / np.where(scale == 0.0, 1.0, scale))
    signals, errors = expected.copy(), np.zeros_like(expected)
    for _ in range(ROUNDS):
        shown = _full_rate(known, reading * signals)
        off = _error(shown + noise, step[:, None], place[:, None])
        gain = np.clip(np.mean(off * shown, axis=1) / np.maximum(np.mean(shown**2, axis=1), TINY), *GAINS)[:, None]
        rest = scale * lines.of(off - gain * shown)
        closed = np.eye(len(gain)) - loop * gain[:, 0]
        signals = np.asarray(np.linalg.solve(closed, expected.T[:, :, None] + loop @ rest.T[:, :, None])[:, :, 0].T)
        errors = gain * signals + rest
    by_samples, by_command = errors.copy(), errors.copy()
    by_samples[count:], by_command[:count] = 0.0, 0.0
    powers = [_powers(known, moved(each)) for each in (errors, by_samples, by_command)]
    share = powers[0] / np.maximum(powers[1] + powers[2], TINY)
    true = moved(errors).storeys
    true[len(true) - channels :][plain] -= errors[:count] * known.loop.ahead
    return share * powers[1], share * powers[2], rms(lines.evaluated(true)) ** 2


def _full_rate(known: Known, rows: ComplexArray) -> Array:
    """Return the series (..., n) of lines (..., m) at the sample rate."""
    return np.fft.irfft(rows, known.lines.padded)[..., : known.lines.samples]


def _error(series: Array, step: Array, place: Array) -> Array:
    """Return what rounding to steps adds to a series (k, n) whose zero lies at `place` within a bit (k, 1)."""
    return np.asarray(np.floor(series / step + place + 0.5) * step - series)


def _powers(known: Known, moved: Motion) -> Array:
    """Return the mean squares (n_storeys + 1,) of the storeys, then of tracking."""
    return rms(known.lines.evaluated(np.vstack([moved.storeys, moved.tracking]))) ** 2
