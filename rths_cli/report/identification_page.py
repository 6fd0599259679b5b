"""`rths identify` as text and JSON: channels, table model, specimen, friction, delay, verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from rths_cli.findings import Finding, as_data, sentences
from rths_cli.identification.level_dependence import causes_of
from rths_cli.identification.results import (
    Band,
    ChannelReport,
    DelayEstimate,
    FitError,
    Friction,
    Identification,
    LevelBand,
    LevelCauses,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.identification.verdict import LIMITS, agree
from rths_cli.numerics.bands import ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray, Model
from rths_cli.report.document import Block, Document, Line, Table, grid, labelled
from rths_cli.report.numbers import DASH, json_data, percent, rounded, significant, with_uncertainty
from rths_cli.report.to_text import text

if TYPE_CHECKING:
    from rths_cli.experiment.identify_command import About

UNKNOWN = (DASH, DASH)
UNDETERMINED = "not determined"
SIGNIFICANT = 3.0  # standard errors


def as_document(found: Identification, about: About) -> dict[str, Any]:
    """Return an identification as a document for JSON; roots are [real, imaginary] in rad/s."""
    document = {
        **_about(about),
        "accepted": found.accepted,
        "reasons": list(found.reasons),
        "warnings": list(found.warnings),
        "findings": [as_data(each) for each in (*found.verdict.refusals, *found.verdict.notes)],
        "verdict": _verdict_values(found.verdict),
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
        "friction": _friction_values(found),
        "latency": asdict(found.latency) if found.latency else None,
        "pitch": asdict(found.pitch) | {"seen": found.pitch.seen} if found.pitch else None,
    }
    return {key: json_data(value) for key, value in document.items()}


def _verdict_values(verdict: Verdict) -> dict[str, Any]:
    values = {**vars(verdict), "reasons": verdict.reasons, "warnings": verdict.warnings}
    return {name: value for name, value in values.items() if name not in ("refusals", "notes")}


def rejected_document(channels: Sequence[ChannelReport], faults: Sequence[Finding], about: About) -> dict[str, Any]:
    """Return the document for JSON of data from which no model can be made."""
    document = {
        **_about(about),
        "accepted": False,
        "reasons": list(sentences(faults)),
        "warnings": [],
        "findings": [as_data(fault) for fault in faults],
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


def _friction_values(found: Identification) -> dict[str, float] | None:
    if found.friction is None:
        return None
    moved = found.friction.command_v * found.best.low_frequency_gain_m_per_v
    return {**asdict(found.friction), "displacement_m": moved}


def band(low_hz: float, high_hz: float) -> str:
    """Return a frequency band as text, without its unit."""
    return f"{rounded(low_hz)}-{rounded(high_hz)}"


def specimen_lines(found: Identification) -> list[Block]:
    """Return the lines on modes, storeys and mode shapes, from excitation and free vibration."""
    known = found.specimen or found.free_vibration
    if known is None:
        return [labelled("specimen", "none: there is no floor channel, or no stretch of motion to use")]
    if known.specimen.attached:
        return []  # the line of the specimen has it
    floors = [channel.name for channel in found.channels[1:]]
    about = "+- 2 standard uncertainties; scatter: standard deviation over stretches of the record"
    storeys = (
        "k, c: stiffness and equivalent dashpot of the storey below a floor; the dashpots together give the same "
        "damping ratios, a single one may be negative"
    )
    return [
        labelled("specimen", about),
        grid(_rows(found, known, floors)),
        labelled("", storeys),
        *_pitch(found),
        Line(""),
        labelled("mode shapes", "largest floor 1" + _difference(found.specimen, found.free_vibration)),
        _shapes(known, floors),
    ]


def _pitch(found: Identification) -> list[Block]:
    """Return the line on the pitch of the base, none where that is not seen."""
    pitch, fit = found.pitch, found.specimen
    if pitch is None or fit is None or not pitch.seen:
        return []
    moved = with_uncertainty(pitch.flexibility_m_per_n, pitch.error_m_per_n, 1e6)
    energy = fit.stiffness_n_per_m * np.diff(fit.mode_shapes[:, 0], prepend=0.0) ** 2  # of the storeys in mode 1
    higher = percent(float(np.sqrt(pitch.stiffness_ratio @ energy / energy.sum())) - 1.0)
    return [
        labelled(
            "pitch",
            f"1 N on the top floor moves it by {moved} um through the base; on a rigid base mode 1 would be {higher} % "
            "higher",
        )
    ]


def _rows(found: Identification, known: SpecimenFit, floors: Sequence[str]) -> list[list[str]]:
    """Return a row for each quantity: value and scatter of both fits, and for modes whether they agree."""
    labels = _labels(len(known.damping_ratio), floors)
    noise, free = (_column(fit) if fit else [UNKNOWN] * len(labels) for fit in (found.specimen, found.free_vibration))
    verdicts = [text for same in _agree(found, len(known.damping_ratio)) for text in (same, "")]
    verdicts += [""] * (len(labels) - len(verdicts))
    rows = zip(labels, noise, free, verdicts, strict=True)
    heads = ["", "excitation", "scatter", "free vibration", "scatter", "agree"]
    return [heads, *([label, *one, *other, verdict] for label, one, other, verdict in rows)]


def _agree(found: Identification, modes: int) -> list[str]:
    """Return yes or no for each mode, a dash if only one of the fits exists."""
    agree = agreements(found)
    return [DASH] * modes if agree is None else ["yes" if same else "no" for same in agree]


def _labels(modes: int, floors: Sequence[str]) -> list[str]:
    """Return the names of the rows, in the order of `_column`."""
    names = [text for mode in range(modes) for text in (f"mode {mode + 1} (Hz)", "  damping ratio (%)")]
    names += [f"k {floor} (N/m)" for floor in floors]
    names += [f"c {floor} (N s/m)" for floor in floors]
    return [*names, "unexplained motion (%)"]


def _column(fit: SpecimenFit) -> list[tuple[str, str]]:
    """Return value and scatter of every quantity, in the order of `_labels`."""
    cells = []
    for mode in range(len(fit.damping_ratio)):
        frequency = with_uncertainty(fit.natural_frequency_hz[mode], fit.frequency_error_hz[mode])
        damping = with_uncertainty(fit.damping_ratio[mode], fit.damping_error[mode], 100.0)
        cells.append((frequency, significant(fit.frequency_scatter_hz[mode], 2)))
        cells.append((damping, significant(100.0 * fit.damping_scatter[mode], 2)))
    for stiffness, error in zip(fit.stiffness_n_per_m, fit.stiffness_error_n_per_m, strict=True):
        cells.append((with_uncertainty(stiffness, error), ""))
    cells += [(significant(dashpot, 4), "") for dashpot in fit.dashpots_n_s_per_m]
    return [*cells, (percent(fit.residual), "")]


def _difference(noise: SpecimenFit | None, free: SpecimenFit | None) -> str:
    """Return in words how much the mode shapes of the free vibration differ."""
    if noise is None or free is None:
        return ""
    largest = float(np.max(np.abs(noise.mode_shapes - free.mode_shapes)))
    return f"; excitation, from which free vibration differs by {significant(largest, 2)} at most"


def _shapes(fit: SpecimenFit, floors: Sequence[str]) -> Table:
    """Return the mode shapes, a row for each floor and a column for each mode."""
    heads = ["", *(f"mode {mode + 1}" for mode in range(len(fit.damping_ratio)))]
    return grid([heads, *([floor, *(f"{one:.4f}" for one in fit.mode_shapes[i])] for i, floor in enumerate(floors))])


__all__ = ["as_document", "page", "rejected_document", "rejected_page", "title", "verdict_sentence"]


def page(found: Identification, about: About) -> str:
    """Return the page: verdict, data, channels, table model, residuals, level dependence, specimen, warnings."""
    sections: Document = [
        _data(about, _verdict(found.verdict)),
        _channels(found.channels, found.compared),
        _table(found),
        root_lines(found.roots),
        _residuals(found.residuals),
        [*_levels(found.levels, found.causes, found.compared), *_friction(found)],
        specimen_lines(found),
        [labelled("warning", warning) for warning in found.verdict.warnings],
    ]
    return text(sections)


def rejected_page(channels: Sequence[ChannelReport], faults: Sequence[str], about: About) -> str:
    """Return the page of data from which no model can be made: a line for each reason, and the channels."""
    return text([_data(about, _rejected(faults)), _channels(channels, about.compared)])


def title(about: About) -> str:
    """Return the first line of the page: the table, and that only its channels were used."""
    if not about.rig_kind:
        return f"Identification of the table {about.rig}, from measured files"
    return f"Identification of the {about.rig_kind} table {about.rig}, from its channels only"


def verdict_sentence(verdict: Verdict) -> str:
    """Return the permitted use of an accepted model in words, or "rejected" and the reasons."""
    if not verdict.accepted:
        return rejected_sentence(verdict.reasons)
    low, high = verdict.feedforward_hz
    return (
        f"accepted: fit for feedforward from {rounded(low)} to {rounded(high)} Hz, transport delay "
        f"{rounded(1e3 * verdict.delay_s)} ms, lag {rounded(1e3 * verdict.lag_s)} ms at low frequency"
        + (f"; above {rounded(verdict.known_hz)} Hz the model says nothing" if math.isfinite(verdict.known_hz) else "")
    )


def rejected_sentence(reasons: Sequence[str]) -> str:
    """Return the verdict on data from which no model can be made."""
    return "rejected: " + "; ".join(reasons)


def _data(about: About, verdict: list[Block]) -> list[Block]:
    lines = (labelled(label, text) for label, text in about.lines)
    return [*verdict, Line(title(about)), labelled("data", about.source), *lines]


def _channels(channels: Sequence[ChannelReport], compared: ComparedBand) -> list[Block]:
    """Return a line for each channel."""
    if not channels:
        return []
    about = f"m/s^2: rms and largest excited, rms at rest; coherence: median in {band(*compared.hz)} Hz"
    rows = [["channel", "rms", "largest", "at rest", "coherence", "hum"]]
    rows += [
        [
            c.name,
            significant(c.rms_m_s2),
            significant(c.largest_m_s2),
            _rest(c.rest_rms_m_s2),
            _coherence(c.coherence),
            _hum(c),
        ]
        for c in channels
    ]
    return [labelled("channels", about), grid(rows)]


def _rest(rms_m_s2: float | None) -> str:
    """Return the rms at rest in words; for a channel that showed a single code, it is below one bit."""
    if rms_m_s2 is None:
        return DASH
    return "below a bit" if rms_m_s2 == 0.0 else significant(rms_m_s2)


def _hum(channel: ChannelReport) -> str:
    return f"{significant(channel.hum_m_s2)} at {channel.hum_hz:g} Hz" if channel.hum_hz > 0.0 else "none"


def _coherence(value: float) -> str:
    return f"{value:.5f}" if np.isfinite(value) else DASH


def _table(found: Identification) -> list[Block]:
    """Return the lines on structure, delay, gain and fit errors of the table's models."""
    low, high = found.verdict.feedforward_hz
    reach = f"{rounded(low)} to {rounded(high)} Hz" if high > low else "nowhere"
    delay, lag = rounded(1e3 * found.verdict.delay_s), rounded(1e3 * found.verdict.lag_s)
    gain = significant(1e3 * found.best.low_frequency_gain_m_per_v, 4)
    return [
        labelled("table model", "command to acceleration, two zeros at the origin given"),
        *_structure(found),
        labelled("  transport delay", f"{delay} ms"),
        *_identified_delay(found.latency),
        labelled("  lag, low frequency", f"{lag} ms (command to displacement, delay included)"),
        labelled("  gain, low frequency", f"{gain} mm/V"),
        labelled(
            "  keeps its limits",
            f"{reach} ({100.0 * LIMITS.rms:.0f} % rms, {100.0 * LIMITS.largest:.0f} % largest, beyond the data's "
            "scatter)",
        ),
        Line(""),
        labelled("fit error", f"|model / FRF - 1| in %, rms and largest in {band(*found.compared.hz)} Hz"),
        grid(
            [
                ["model", "poles", "zeros", "fitted (Hz)", "rms", "largest", f"rms {band(*found.compared.mid_hz)} Hz"],
                _fit("best", found.best, found.best_error),
                _fit("paper", found.paper, found.paper_error),
            ]
        ),
    ]


def _identified_delay(latency: DelayEstimate | None) -> list[Block]:
    """Return the line on the delay that was identified together with free roots."""
    if latency is None:
        return []
    seen = with_uncertainty(latency.identified_s, latency.error_s, 1e3)
    declared = rounded(1e3 * latency.declared_s)
    return [labelled("  delay as identified", f"{seen} ms, {declared} ms declared (latency, hold, transport)")]


def _structure(found: Identification) -> list[Block]:
    """Return the lines on the model structures that were tried, with their held-out errors."""
    if not found.candidates:
        return [labelled("  structure", "as given; no others were tried")]
    rows = [["structure", "poles", "zeros", "held-out error", ""]]
    rows += [
        [c.name, str(c.poles), str(c.zeros), significant(c.held_out), "chosen" if c.chosen else ""]
        for c in found.candidates
    ]
    meaning = "zeros off the origin; held-out error over the data's own scatter: 1 is all that the data can tell"
    return [grid(rows), labelled("", meaning)]


def _fit(name: str, model: Model, error: FitError) -> list[str]:
    size = [str(len(model.poles)), str(len(model.zeros)), band(*model.band_hz)]
    return [name, *size, percent(error.rms), percent(error.largest), percent(error.rms_mid)]


def root_lines(roots: Sequence[Root]) -> list[Block]:
    """Return a line for each root or pair of roots of the best model."""
    if not roots:  # of an actuator
        return []
    rows = [["", "frequency (Hz)", "damping ratio (%)"]]
    for root in roots:
        frequency = with_uncertainty(root.frequency_hz, root.frequency_error_hz)
        damping = with_uncertainty(root.damping_ratio, root.damping_error, 100.0)
        damping = damping if root.damping_known else UNDETERMINED
        rows.append(
            [
                root.kind,
                frequency if root.frequency_known else UNDETERMINED,
                damping if np.isfinite(root.damping_ratio) else "real",
            ]
        )
    return [labelled("roots, best", "zeros off the origin; +- 2 standard uncertainties"), grid(rows)]


def _residuals(bands: Sequence[Band]) -> list[Block]:
    if not bands:
        return []
    rows = [["band (Hz)", "rms", "largest", "data's scatter", "coherence"]]
    rows += [
        [band(b.low_hz, b.high_hz), percent(b.rms), percent(b.largest), percent(b.scatter), _coherence(b.coherence)]
        for b in bands
    ]
    return [labelled("residual, best", "|model / FRF - 1| in %, and the FRF's own standard error"), grid(rows)]


def _levels(levels: Sequence[LevelBand], causes: LevelCauses, compared: ComparedBand) -> list[Block]:
    """Return the lines on the change of the table's response at low level, and its meaning."""
    if not levels:
        return []
    rows = [["band (Hz)", "magnitude (%)", "phase (deg)", "later by (ms)"]]
    for level in levels:
        spread = level.error / abs(level.ratio)
        phase = float(np.angle(level.ratio))
        rows.append(
            [
                band(level.low_hz, level.high_hz),
                with_uncertainty(abs(level.ratio) - 1.0, level.error, 100.0),
                with_uncertainty(phase, spread, 180.0 / np.pi),
                with_uncertainty(-phase, spread, 1e3 / centre_rad_s(level)),
            ]
        )
    heading = labelled("amplitude dependence", "low level over full level, +- 2 standard errors")
    return [heading, grid(rows), labelled("", _meaning(levels, causes, compared))]


def _meaning(levels: Sequence[LevelBand], causes: LevelCauses, compared: ComparedBand) -> str:
    """Return in words the meaning of a difference between levels, in the compared band if there are such."""
    low = [level for level in levels if level.high_hz <= compared.high_hz] or levels
    clear = [level for level in low if abs(level.ratio - 1.0) > SIGNIFICANT * level.error]
    if not clear:
        return "no difference beyond the scatter: friction does not show at these levels"
    most = max(clear, key=lambda level: abs(level.ratio - 1.0))
    size = f"differs by up to {percent(abs(most.ratio - 1.0))} % ({band(most.low_hz, most.high_hz)} Hz)"
    cause = (
        "; or ".join(sentences(causes_of(causes)))
        or "no single cause (friction, suspension, gain, specimen) explains how"
    )
    return f"{size}: {cause}; the model holds best near full level"


def _friction(found: Identification) -> list[Block]:
    """Return the line on friction, as a command and the equivalent displacement; the force is not known."""
    friction = found.friction
    if friction is None:
        return []
    size = with_uncertainty(friction.command_v, friction.error_v, 1e3)
    moved = rounded(1e6 * abs(friction.command_v * found.best.low_frequency_gain_m_per_v))
    if friction.command_v < SIGNIFICANT * friction.error_v:
        return [labelled("friction", f"none beyond the scatter: {size} mV of command against the velocity")]
    text = (
        f"like {size} mV of command ({moved} um of the table) against the velocity, {percent(friction.explained)} % of "
        "the power that the model leaves of the record"
    )
    return [labelled("friction", text + _in_slip(friction))]


def _in_slip(friction: Friction) -> str:
    """Return what friction is in slip, "" where it is not more than against the velocity."""
    sliding, error = friction.sliding_v, friction.sliding_error_v
    if sliding is None or error is None or sliding - friction.command_v < SIGNIFICANT * error:
        return ""
    return f"; in slip {with_uncertainty(sliding, error, 1e3)} mV, it holds like a spring after each reversal"


def _verdict(verdict: Verdict) -> list[Block]:
    """Return the lines on the verdict."""
    if not verdict.accepted:
        return _rejected(verdict.reasons)
    return [labelled("verdict", verdict_sentence(verdict), "accepted")]


def _rejected(reasons: Sequence[str]) -> list[Block]:
    return [labelled("" if i else "verdict", f"rejected: {one}", "rejected") for i, one in enumerate(reasons)]
