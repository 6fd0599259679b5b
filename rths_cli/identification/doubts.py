"""Sentences on what is accepted and yet should be read with care: delay, structure, specimen, free vibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rths_cli.identification.fit_table import Timing
from rths_cli.identification.found import Candidate, ChannelReport, SpecimenFit
from rths_cli.lti import Model
from rths_cli.rig_info import RigInfo

AGREE_SIGMA, AGREE_HZ, AGREE_DAMPING = 3.0, 0.003, 0.05  # noise and free vibration: standard errors or shares
MORE_THAN_HELD = 2.0
MISFIT = 0.003  # share of the floors' motion; clean fits leave 0.0002
USABLE = 0.2  # relative uncertainty, unexplained share, of a free vibration


def misfit(specimen: SpecimenFit | None, seen: Sequence[ChannelReport]) -> tuple[str, ...]:
    """Return a sentence when the specimen is not quite a chain with the given masses and modal damping."""
    if specimen is None:
        return ()
    noise = max((c.rest_rms_m_s2 or 0.0) / c.rms_m_s2 for c in seen)
    if specimen.residual <= max(MISFIT, 3.0 * noise):
        return ()
    return (
        f"specimen: {specimen.residual:.2%} of the floors' motion is not that of a linear chain of storeys with the "
        "given masses and modal damping; read stiffness and damping with care",
    )


def not_held(candidates: Sequence[Candidate]) -> tuple[str, ...]:
    """Return a sentence when the data show more than the chosen structure holds."""
    worst = max((tried.held_out for tried in candidates if tried.chosen), default=0.0)
    if not worst > MORE_THAN_HELD:
        return ()
    return (
        f"table model: its held-out error is {worst:.3g} times the data's own scatter; the table has more to it than "
        "any structure that was tried (one of: more modes, a delay shorter than declared, a loose part, lost samples, "
        "nonlinearity)",
    )


def late(model: Model, info: RigInfo) -> tuple[str, ...]:
    """Return a sentence when the data asked for more delay than the rig declares."""
    declared = Timing(info.latency_samples, info.dt_s, info.transport_s).delay_s
    if model.delay_s <= declared * (1.0 + 1e-9):
        return ()
    return (
        f"table model: the data ask for a delay of {1e3 * model.delay_s:.3g} ms, {1e3 * declared:.3g} ms are declared "
        "(latency and half a sample of hold); check converters.latency_samples and the channels' timing",
    )


def usable(free: SpecimenFit | None) -> tuple[SpecimenFit | None, tuple[str, ...]]:
    """Return a free vibration that can be used, or None and a sentence that it is too weak."""
    if free is None:
        return None, ()
    known = np.concatenate(
        [free.frequency_error_hz / free.natural_frequency_hz, free.damping_error / free.damping_ratio]
    )
    if np.isfinite(known).all() and known.max() < USABLE and free.residual < USABLE:
        return free, ()
    sentence = f"free vibration: too weak to be used, {free.residual:.1%} of the floors' motion is not explained"
    return None, (sentence,)


def differences(noise: SpecimenFit | None, free: SpecimenFit | None) -> tuple[str, ...]:
    """Return a sentence for each mode that noise and free vibration see differently."""
    if noise is None or free is None:
        return ()
    return tuple(
        f"specimen mode {mode + 1}: excitation gives {noise.natural_frequency_hz[mode]:.3f} Hz and "
        f"{noise.damping_ratio[mode]:.2%}, free vibration {free.natural_frequency_hz[mode]:.3f} Hz and "
        f"{free.damping_ratio[mode]:.2%}; it is nonlinear, or the free vibration is too weak"
        for mode in range(len(noise.damping_ratio))
        if not agree(noise, free, mode)
    )


def agree(one: SpecimenFit, other: SpecimenFit, mode: int) -> bool:
    """Tell whether two fits agree in a mode: within three standard uncertainties, or 0.3 % of the frequency and 5 %
    of the damping ratio."""
    hz = abs(one.natural_frequency_hz[mode] - other.natural_frequency_hz[mode])
    ratio = abs(one.damping_ratio[mode] - other.damping_ratio[mode])
    hz_spread = float(np.hypot(one.frequency_error_hz[mode], other.frequency_error_hz[mode]))
    ratio_spread = float(np.hypot(one.damping_error[mode], other.damping_error[mode]))
    return bool(
        hz <= max(AGREE_SIGMA * hz_spread, AGREE_HZ * one.natural_frequency_hz[mode])
        and ratio <= max(AGREE_SIGMA * ratio_spread, AGREE_DAMPING * one.damping_ratio[mode])
    )
