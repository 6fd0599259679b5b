"""What an identification found, as a page for the terminal and as a document."""

from __future__ import annotations

from typing import Any

import numpy as np

from rths_cli.identification.evaluate import Identification
from rths_cli.identification.fit_table import FitError
from rths_cli.identification.specimen import SpecimenFit
from rths_cli.lti import Array, Model

WIDTH = 28


def page(found: Identification, rig_kind: str) -> str:
    """Return the page: models, specimen by noise and by free vibration, verdict."""
    lines = [f"Identification of the {rig_kind} table, from its channels only", ""]
    lines += [*_model("best", found.best, found.best_error), *_model("paper", found.paper, found.paper_error)]
    lines += _specimen("specimen, from noise", found.specimen)
    lines += _specimen("specimen, free vibration", found.free_vibration)
    if found.noise_rms_m_s2 is not None:
        lines.append(_line("noise at rest", _noise(found.noise_rms_m_s2)))
    lines += [_line("note", warning) for warning in found.warnings]
    verdict = "accepted" if found.accepted else "rejected: " + "; ".join(found.reasons)
    return "\n".join([*lines, _line("verdict", verdict)]) + "\n"


def _model(name: str, model: Model, error: FitError) -> list[str]:
    band = f"{model.band_hz[0]:g}-{model.band_hz[1]:g} Hz"
    size = f"{len(model.poles)} poles, {len(model.zeros)} zeros (two at the origin), delay {1e3 * model.delay_s:.3g} ms"
    fit = f"{error.rms:.2%} RMS, {error.largest:.2%} largest in 0.7-11 Hz; {error.rms_mid:.2%} RMS in 2-10 Hz"
    return [
        _line(f"table model, {name}", f"{size}, fitted over {band}"),
        _line("  error |fit / FRF - 1|", fit),
        _line("  poles", f"{_hertz(model.poles)} Hz"),
        _line("  zeros off the origin", f"{_hertz(model.zeros[np.abs(model.zeros) > 1e-9])} Hz"),
        _line("  low-frequency gain", f"{1e3 * model.low_frequency_gain_m_per_v:.4g} mm/V"),
    ]


def _specimen(name: str, fit: SpecimenFit | None) -> list[str]:
    if fit is None:
        return []
    return [
        _line(name, "  ".join(f"{value:.4f}" for value in fit.natural_frequency_hz) + " Hz"),
        _line("  damping", "  ".join(f"{100 * value:.3f}" for value in fit.damping_ratio) + " %"),
        _line("  storey stiffness", f"{_numbers(fit.stiffness_n_per_m)} N/m"),
    ]


def _line(name: str, text: str) -> str:
    return f"{name:<{WIDTH}}{text}"


def _noise(rms: Array) -> str:
    """Return the channels' noise in mm/s^2; a channel that showed one code throughout is below a bit."""
    return "  ".join(f"{1e3 * value:.3g} mm/s^2 rms" if value > 0.0 else "below one bit" for value in rms)


def _numbers(values: Array) -> str:
    return "  ".join(f"{value:.4g}" for value in values)


def _hertz(roots: np.ndarray) -> str:
    """Return roots as frequency and, for pairs, damping ratio: |s| / 2 pi (zeta)."""
    shown = []
    for root in sorted(roots, key=abs):
        if root.imag == 0.0:
            shown.append(f"{abs(root) / (2 * np.pi):.4g} (real)")
        elif root.imag > 0.0:
            shown.append(f"{abs(root) / (2 * np.pi):.4g} ({-root.real / abs(root):.3f})")
    return "  ".join(shown)


def as_document(found: Identification) -> dict[str, Any]:
    """Return what was found as plain numbers and lists for JSON."""
    return {
        "accepted": found.accepted,
        "reasons": list(found.reasons),
        "warnings": list(found.warnings),
        "best": _model_document(found.best, found.best_error),
        "paper": _model_document(found.paper, found.paper_error),
        "specimen": _specimen_document(found.specimen),
        "free_vibration": _specimen_document(found.free_vibration),
    }


def _model_document(model: Model, error: FitError) -> dict[str, Any]:
    return {
        "zeros": [[root.real, root.imag] for root in model.zeros],
        "poles": [[root.real, root.imag] for root in model.poles],
        "gain": model.gain,
        "delay_s": model.delay_s,
        "ripple_m_s2_per_v": model.ripple_m_s2_per_v,
        "band_hz": list(model.band_hz),
        "fit_error_rms": error.rms,
        "fit_error_max": error.largest,
        "fit_error_mid": error.rms_mid,
    }


def _specimen_document(fit: SpecimenFit | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    return {
        "natural_frequency_hz": fit.natural_frequency_hz.tolist(),
        "frequency_error_hz": fit.frequency_error_hz.tolist(),
        "damping_ratio": fit.damping_ratio.tolist(),
        "damping_error": fit.damping_error.tolist(),
        "stiffness_n_per_m": fit.stiffness_n_per_m.tolist(),
        "mode_shapes": fit.mode_shapes.tolist(),
    }
