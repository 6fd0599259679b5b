"""The error of a hybrid test whose motion is a few bits of its converters: rounding simulated on the expected motion.

Rounding errors are noise (analysis/quantisation.py) as long as they do not depend on each other and on the motion. In
a motion of a few bits they do: the converter is then a gain, which is 0 below half a bit and up to 1.27 above it, and
the force that is fed back is wrong in phase with the motion (describing function of a quantiser: Gelb and Vander Velde,
Multiple-Input Describing Functions, 1968, section 2.3). In a loop with little damping this changes the decay of the
motion itself. So the samples of the expected motion are rounded, their errors are carried through the closed loop, the
motion with these errors is rounded again, and so on. The loop is causal: each round is right for a longer part of the
record (waveform relaxation), and rounding errors are bounded, so that no round is far off.

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
ZERO_CHANGES = 0.1  # bits by which a zero that was seen changes until the test


def few_bits(known: Known, prediction: Prediction) -> FewBits | None:
    """Return the simulated rounding errors of a stable loop; None where rounding is noise.

    `prediction` is that with rounding as noise.
    """
    bits = known.bits_m_s2
    rounded = np.hypot(*(prediction.causes[name].storeys for name in ("quantisation", "rounding")))
    size = np.maximum(rms(known.lines.evaluated(known.sim)), np.finfo(float).tiny)
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
    lines, corrected, bit_v = known.lines, of_correction(known)[plain], known.rig.converters.step_v
    bits, channels = known.bits_m_s2[plain, None], len(dither)
    place = random.uniform(-0.5, 0.5, channels)[plain]
    if known.zero_m_s2 is not None:
        place = known.zero_m_s2[plain] / bits[:, 0] + 2.0 * ZERO_CHANGES * place
    noise = random.standard_normal((len(bits), lines.samples)) * dither[plain, None] + place[:, None] * bits
    reading = np.where(corrected == 0.0, 0.0, 1.0 / np.where(corrected == 0.0, 1.0, corrected))
    still, added = np.zeros_like(known.ground), np.zeros_like(known.floors)
    sent = np.zeros_like(nominal.command_v)
    moved = nominal
    motion, command = nominal.corrected, nominal.command_v
    for _ in range(ROUNDS):
        added[plain] = corrected * lines.of(_error(_full_rate(known, reading * motion[plain]) + noise, bits))
        if not known.shaped:
            sent = lines.of(_error(_full_rate(known, command), bit_v))
        moved = hybrid(known.loop, still, added, sent)
        motion = nominal.corrected + moved.corrected - added
        command = nominal.command_v + moved.command_v - sent
    by_samples = _powers(known, hybrid(known.loop, still, added))
    by_command = _powers(known, hybrid(known.loop, still, np.zeros_like(added), sent))
    both = _powers(known, moved) / np.maximum(by_samples + by_command, np.finfo(float).tiny)
    true = moved.storeys.copy()
    true[len(true) - channels :] -= added * known.loop.ahead
    return both * by_samples, both * by_command, rms(lines.evaluated(true)) ** 2


def _full_rate(known: Known, rows: ComplexArray) -> Array:
    """Return the series (..., n) of lines (..., m) at the sample rate."""
    return np.fft.irfft(rows, known.lines.padded)[..., : known.lines.samples]


def _error(series: Array, step: Array | float) -> Array:
    """Return what rounding to steps adds to a series."""
    return np.asarray(np.floor(series / step + 0.5) * step - series)


def _powers(known: Known, moved: Motion) -> Array:
    """Return the mean squares (n_storeys + 1,) of the storeys, then of tracking."""
    return rms(known.lines.evaluated(np.vstack([moved.storeys, moved.tracking]))) ** 2
