"""`rths identify --json`: models, uncertainties, verdict; unknown values are null."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.identification.results import ChannelReport, FitError, Identification, LevelBand, SpecimenFit
from rths_cli.identification.verdict import agree
from rths_cli.numerics.lti import Array, ComplexArray, Model
from rths_cli.report.numbers import json_data

if TYPE_CHECKING:
    from rths_cli.experiment.identify_command import About


def as_document(found: Identification, about: About) -> dict[str, Any]:
    """Return an identification as a document for JSON; roots are [real, imaginary] in rad/s."""
    document = {
        **_about(about),
        "accepted": found.accepted,
        "reasons": list(found.reasons),
        "warnings": list(found.warnings),
        "verdict": asdict(found.verdict),
        "best": _model(found.best, found.best_error),
        "paper": _model(found.paper, found.paper_error),
        "specimen": _specimen(found.specimen),
        "free_vibration": _specimen(found.free_vibration),
        "agree": agreements(found),
        "channels": [asdict(channel) for channel in found.channels],
        "roots": [asdict(root) | {"determined": root.determined} for root in found.roots],
        "candidates": [asdict(candidate) for candidate in found.candidates],
        "residuals": [asdict(band) for band in found.residuals],
        "levels": [_level(band) for band in found.levels],
        "friction": _friction(found),
        "latency": asdict(found.latency) if found.latency else None,
        "pitch": asdict(found.pitch) | {"seen": found.pitch.seen} if found.pitch else None,
    }
    return {key: json_data(value) for key, value in document.items()}


def rejected_document(channels: Sequence[ChannelReport], faults: Sequence[str], about: About) -> dict[str, Any]:
    """Return the document for JSON of data from which no model can be made."""
    document = {
        **_about(about),
        "accepted": False,
        "reasons": list(faults),
        "warnings": [],
        "channels": [asdict(channel) for channel in channels],
    }
    return {key: json_data(value) for key, value in document.items()}


def agreements(found: Identification) -> list[bool] | None:
    """Return for each mode whether excitation and free vibration agree; None if one of the two is missing."""
    noise, free = found.specimen, found.free_vibration
    if noise is None or free is None:
        return None
    return [agree(noise, free, mode) for mode in range(len(noise.damping_ratio))]


def late_s(level: LevelBand) -> float:
    """Return the delay in s of the table at low level against full level, at the band's centre."""
    return -float(np.angle(level.ratio)) / centre_rad_s(level)


def centre_rad_s(level: LevelBand) -> float:
    """Return the geometric mean of the band's ends in rad/s."""
    return 2.0 * math.pi * math.sqrt(level.low_hz * level.high_hz)


def _about(about: About) -> dict[str, Any]:
    lines = [{"label": label, "text": text} for label, text in about.lines]
    return {"rig": about.rig, "rig_kind": about.rig_kind, "source": about.source, "about": lines}


def _model(model: Model, error: FitError) -> dict[str, Any]:
    return {
        "zeros": _roots(model.zeros),
        "poles": _roots(model.poles),
        "gain": model.gain,
        "delay_s": model.delay_s,
        "latency_samples": model.latency_samples,
        "low_frequency_gain_m_per_v": model.low_frequency_gain_m_per_v,
        "ripple_m_s2_per_v": model.ripple_m_s2_per_v,
        "coupling_hz": model.coupling_hz,
        "band_hz": model.band_hz,
        "fit_error_rms": error.rms,
        "fit_error_max": error.largest,
        "fit_error_mid": error.rms_mid,
    }


def _roots(roots: ComplexArray) -> Array:
    return np.column_stack([roots.real, roots.imag])


def _specimen(fit: SpecimenFit | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    return {
        "natural_frequency_hz": fit.natural_frequency_hz,
        "frequency_error_hz": fit.frequency_error_hz,
        "frequency_scatter_hz": fit.frequency_scatter_hz,
        "damping_ratio": fit.damping_ratio,
        "damping_error": fit.damping_error,
        "damping_scatter": fit.damping_scatter,
        "stiffness_n_per_m": fit.stiffness_n_per_m,
        "stiffness_error_n_per_m": fit.stiffness_error_n_per_m,
        "dashpots_n_s_per_m": fit.dashpots_n_s_per_m,
        "mode_shapes": fit.mode_shapes,
        "masses_kg": fit.specimen.masses_kg,
        "residual": fit.residual,
    }


def _level(level: LevelBand) -> dict[str, Any]:
    return {
        "low_hz": level.low_hz,
        "high_hz": level.high_hz,
        "ratio_real": level.ratio.real,
        "ratio_imag": level.ratio.imag,
        "error": level.error,
        "late_s": late_s(level),
    }


def _friction(found: Identification) -> dict[str, float] | None:
    if found.friction is None:
        return None
    moved = found.friction.command_v * found.best.low_frequency_gain_m_per_v
    return {**asdict(found.friction), "displacement_m": moved}
