"""The verdict on an identified model: limits of its fit error, accepted or rejected and why, warnings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from rths_cli.findings import Finding, without_repeats
from rths_cli.identification.level_dependence import FRICTION, causes_of
from rths_cli.identification.results import (
    Band,
    Candidate,
    ChannelReport,
    FitError,
    Friction,
    LevelBand,
    LevelCauses,
    Root,
    SpecimenFit,
    Verdict,
)
from rths_cli.identification.table_fit import SCATTER, Fit, Timing, response_and_slopes, rms, within
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, Frf, Model
from rths_cli.rigs.description import RigInfo

LIMITS = FitError(rms=0.01, largest=0.03, rms_mid=0.004)
GROUP = 5  # lines whose errors are averaged above the compared band
SHORTFALL = 1.25  # factor on the linearised law of friction, see without_friction
NOISY = 0.5  # scatter of the data over the limit of the fit, above which noise may be the cause of a misfit
MOST_LAG_S = 0.5
CERTAIN = 3.0  # standard errors
ROOM = 1.2  # least factor by which an excitation could be louder, for the advice to do so
OVERDAMPED = 1.5  # damping ratio of a pair from which it is told as two real roots
LINES_OF_ERROR = 400  # frequencies at which the uncertainty of a response is computed
ONE_LEVEL = LevelCauses()


def judge(
    model: Model, error: FitError, frf: Frf, most: FitError, warnings: Sequence[Finding],
    levels: Sequence[LevelBand] = (), level_ratio: float = math.inf, further: Sequence[Finding] = (),
    given: bool = False, causes: LevelCauses = ONE_LEVEL, louder: float = 1.0, noisy: bool = True,
    friction: Friction | None = None, compared: ComparedBand = USUAL, known_hz: float = math.inf,
) -> Verdict:  # fmt: skip
    """Return the verdict on a model with a given fit error, that is the error beyond the scatter of the data.

    `most`: limits of that error; `frf`: the response to which the model is compared.
    `levels`: response at low level over that at full level, to which the model was fitted and which is `level_ratio`
    times louder; `causes`: why the levels differ.
    `further`: additional reasons to reject the model; `given`: the model was supplied and not fitted here.
    `louder`: factor by which the excitation could be louder within the limits; `noisy`: whether the channels' noise
    explains the scatter of the data; `friction`: as identified (None: not determined);
    `compared`: band in which the model must keep its limits; `known_hz`: frequency above which it says nothing.
    """
    scatter = rms(frf.relative_error[within(frf.frequency_hz, compared.hz)])
    inside = [band for band in levels if band.high_hz <= compared.high_hz]
    material = bool(inside) and rms_difference(inside) > NOISY * most.rms
    if FRICTION in causes.table and error.rms > without_friction(inside, level_ratio):
        material = False  # the fit error is larger than the effect of friction at full level
    shown = causes if material else ONE_LEVEL
    cause = Finding("cause.given_model") if given else _cause(scatter, most, shown, louder, noisy)
    unsafe = _unsafe_roots(model) or _absurd_lag(model)
    missed = _misses(error, most, cause, compared)
    # both levels are divided by the model: with a poor model their comparison is valid only if a cause's shape is found
    valid = levels if not missed or causes_of(causes) else ()
    reasons = (
        *missed,
        *unsafe,
        *further,
        *_at_other_levels(valid, level_ratio, most, causes, louder, friction, compared),
    )
    reach = reach_hz(model, frf, most, compared)
    usable = (compared.low_hz, reach) if reach > compared.low_hz else (0.0, 0.0)
    if not reasons and reach < compared.high_hz:
        reasons = (Finding("model.reach", {"reach_hz": reach, "needed_hz": compared.high_hz, "cause": cause}),)
    return Verdict(not reasons, usable, model.delay_s, low_frequency_lag(model), reasons, tuple(warnings), known_hz)


def _cause(scatter: float, most: FitError, causes: LevelCauses, louder: float, noisy: bool) -> Finding:
    """Return the cause of a fit error beyond its limits, as far as the data show it, with its remedy."""
    if found := causes_of(causes):
        return Finding("cause.level", {"causes": found, "remedy": _remedy(causes, louder)})
    if scatter > NOISY * most.rms and noisy:
        return Finding("cause.noise", {"scatter": scatter, "louder": louder if louder > ROOM else None})
    return Finding("cause.unknown")


def _remedy(causes: LevelCauses, louder: float) -> Finding:
    """Return the remedy for a table or specimen that depends on the level."""
    if causes.table[:1] != (FRICTION,):
        return Finding("remedy.level")
    return Finding("remedy.friction", {"louder": louder if louder > ROOM else None})


def _absurd_lag(model: Model) -> tuple[Finding, ...]:
    """Return a reason if the table would respond before its command, or more than half a second late."""
    lag = low_frequency_lag(model)
    return () if 0.0 <= lag <= MOST_LAG_S else (Finding("model.lag", {"lag_s": lag}),)


def _misses(error: FitError, most: FitError, cause: Finding, compared: ComparedBand) -> tuple[Finding, ...]:
    """Return a reason for each limit that the fit error exceeds."""
    rows = (
        ("rms", compared.hz, error.rms, most.rms),
        ("largest", compared.hz, error.largest, most.largest),
        ("rms", compared.mid_hz, error.rms_mid, most.rms_mid),
    )
    return tuple(
        Finding(
            "model.misfit",
            {"quantity": name, "low_hz": low, "high_hz": high, "error": value, "limit": limit, "cause": cause},
        )
        for name, (low, high), value, limit in rows
        if not value <= limit
    )


def _at_other_levels(
    levels: Sequence[LevelBand], level_ratio: float, most: FitError, causes: LevelCauses, louder: float,
    friction: Friction | None, compared: ComparedBand,
) -> tuple[Finding, ...]:  # fmt: skip
    """Return a reason if the level dependence makes the model's error exceed its limits at other levels.

    Friction is judged by its remaining effect at full level. If its size is identified, the limit is that of the
    largest error, because the check then predicts its effect at every level. Otherwise it is the limit of the rms
    error, as for all errors that the prediction does not include. Other causes, and unknown ones, are judged by the
    change at low level against the limit of the largest error.
    """
    inside = [band for band in levels if band.high_hz <= compared.high_hz]
    clear = any(abs(band.ratio - 1.0) > CERTAIN * band.error for band in inside)
    if not inside or not clear or not level_ratio > 1.0:
        return ()
    values = {"level_ratio": level_ratio, "band": str(compared), "remedy": _remedy(causes, louder)}
    if FRICTION in causes.table:
        without, change = without_friction(inside, level_ratio), max(abs(band.ratio - 1.0) for band in inside)
        limit = most.largest if _identified(friction) else most.rms
        found = Finding("friction.share", {**values, "change": change, "without": without, "limit": limit})
        return () if without <= limit else (found,)
    change, limit = rms_difference(inside), most.largest
    found = Finding("level.change", {**values, "change": change, "limit": limit, "causes": causes_of(causes)})
    return () if change <= limit else (found,)


def _identified(friction: Friction | None) -> bool:
    """Return whether the size of friction is significant, so that predictions may include it."""
    return friction is not None and friction.command_v > CERTAIN * friction.error_v


def rms_difference(levels: Sequence[LevelBand]) -> float:
    """Return the rms difference between low and full level, weighted by the bands' widths."""
    squares = [(band.high_hz - band.low_hz) * abs(band.ratio - 1.0) ** 2 for band in levels]
    return math.sqrt(sum(squares) / sum(band.high_hz - band.low_hz for band in levels))


def without_friction(levels: Sequence[LevelBand], level_ratio: float) -> float:
    """Return the rms difference, over the bands, between a table without friction and a model made at full level.

    Coulomb friction acts like a dashpot that weakens as one over the velocity (statistical linearisation, Roberts and
    Spanos, Random Vibration and Statistical Linearization). If two levels of ratio r differ by d, the difference to a
    table without friction at the louder level is d / (r - 1). A quarter is added, because on virtual tables with noise
    and 0.3-3 N this law is a tenth to a fifth too small. It holds for noise and multisine, not for a sine or steps.
    """
    if not levels or not level_ratio > 1.0:
        return 0.0
    return SHORTFALL * rms_difference(levels) / (level_ratio - 1.0)


def _unsafe_roots(model: Model) -> tuple[Finding, ...]:
    """Return a reason for each kind of root with which a model must not drive a table."""
    origin = np.abs(model.zeros) <= 1e-9
    unsafe = {
        "model.unstable_poles": np.any(model.poles.real >= 0.0),
        "model.unstable_zeros": np.any(model.zeros[~origin].real >= 0.0),
        "model.no_displacement": np.sum(origin) != 2,
    }
    return tuple(Finding(code) for code, there in unsafe.items() if there)


def reach_hz(model: Model, frf: Frf, most: FitError, compared: ComparedBand = USUAL) -> float:
    """Return the frequency up to which the model keeps its limits, from the start of the compared band on.

    Two standard errors of the response are subtracted from the error. The error is averaged over five lines, because a
    mean shows an error common to neighbouring lines that the scatter of single lines would hide. In the compared
    band each line is judged as well. The rms is taken from its start up to each frequency.
    """
    f, (low_hz, few_hz, *_) = frf.frequency_hz, compared.edges_hz
    error = model.sampled_response(f) / frf.response - 1.0
    kernel = np.ones(GROUP) / GROUP
    together, single = np.convolve(error, kernel, mode="same"), np.where(f > compared.high_hz, 0.0, np.abs(error))
    scatter = np.sqrt(np.convolve(frf.relative_error**2, kernel, mode="same") / GROUP)
    beyond = np.maximum(np.abs(together) - SCATTER * scatter, single - SCATTER * frf.relative_error)
    excess = np.maximum(beyond, 0.0)[f >= low_hz - 1e-9]
    lines = f[f >= low_hz - 1e-9]
    mean = np.sqrt(np.cumsum(excess**2) / np.arange(1, len(excess) + 1))
    # the rms of the first few lines is not meaningful: in the lowest band the rms of all its lines is used
    mean[lines < few_hz] = mean[np.searchsorted(lines, few_hz) - 1]
    bad = np.flatnonzero((excess > most.largest) | (mean > most.rms))
    if not bad.size:
        return float(model.band_hz[1])
    return float(lines[bad[0] - 1]) if bad[0] > 0 else 0.0


def low_frequency_lag(model: Model) -> float:
    """Return the lag in s of the displacement behind a slow command: minus the slope of the phase at zero frequency.

    Roots below the model's band are left out: the data hardly determine their damping, which would dominate the result.
    NaN is returned for a pole at the origin, because the table then does not follow the command.
    """
    if np.any(np.abs(model.poles) <= 1e-9):
        return math.nan
    zeros, poles = (roots[np.abs(roots) > 2.0 * np.pi * model.band_hz[0]] for roots in (model.zeros, model.poles))
    return float(np.real(np.sum(1.0 / zeros) - np.sum(1.0 / poles))) + model.delay_s


def residuals(model: Model, frf: Frf, compared: ComparedBand = USUAL) -> tuple[Band, ...]:
    """Return the model's residual in each band, up to the end of the response."""
    f = frf.frequency_hz
    error = np.abs(model.sampled_response(f) / frf.response - 1.0)
    edges = [edge for edge in compared.edges_hz if edge < f[-1]] + [float(f[-1])]
    found = []
    for low, high in pairwise(edges):
        inside = within(f, (low, high))
        if inside.any():
            scatter = rms(frf.relative_error[inside]) * np.sqrt(2.0)
            found.append(
                Band(low, high, rms(error[inside]), float(error[inside].max()), float(scatter),
                     float(np.median(frf.coherence[inside])))
            )  # fmt: skip
    return tuple(found)


def level_bands(quiet: Frf, loud: Frf | None, compared: ComparedBand = USUAL) -> tuple[LevelBand, ...]:
    """Compare the responses at low and at full level, both divided by the same model, in each band.

    `loud` None: the low level is compared with the model itself.
    """
    found = []
    for low, high in pairwise(compared.edges_hz):
        one, one_error = _mean(quiet, (low, high))
        other, other_error = (1.0 + 0j, 0.0) if loud is None else _mean(loud, (low, high))
        if np.isfinite(one_error + other_error) and np.isfinite(one / other):
            found.append(LevelBand(low, high, one / other, float(np.hypot(one_error, other_error))))
    return tuple(found)


def _mean(frf: Frf, band_hz: tuple[float, float]) -> tuple[complex, float]:
    """Return the weighted mean of a response near 1 in a band and its standard error (NaN without lines there)."""
    inside = within(frf.frequency_hz, band_hz)
    if not inside.any():
        return complex("nan"), float("nan")
    weight = 1.0 / frf.relative_error[inside] ** 2
    mean = np.sum(weight * frf.response[inside]) / np.sum(weight)
    return complex(mean), float(np.sqrt(frf.bandwidth_lines / np.sum(weight)))


def roots_of(found: Fit, specimen: SpecimenFit | None, shifts: Array | None = None) -> tuple[Root, ...]:
    """Return poles and finite zeros of a fit with their standard uncertainties.

    The random part follows from the fit's covariance; `shifts` (n_parameters,) is the systematic part. Zeros that are
    fixed at the specimen's modes have the specimen's uncertainties. An overdamped pair is two real roots, of which the
    data may determine one alone: what moves the other one, moves frequency and damping ratio of the pair alike.
    """
    poles, single, zeros = found.layout.pairs(found.parameters)
    spread = found.covariance if shifts is None else found.covariance + np.outer(shifts, shifts)
    error = np.sqrt(np.diag(spread))
    first_zero = 1 + 2 * len(poles) + len(single)
    rows = []
    for number, pair in enumerate(poles):
        columns = slice(1 + 2 * number, 3 + 2 * number)
        rows += _rows_of_pair("pole", pair, spread[columns, columns])
    for number, corner in enumerate(single):
        hz = corner / (2.0 * np.pi)
        rows.append(Root("pole", hz, float("nan"), hz * error[1 + 2 * len(poles) + number], float("nan")))
    for number, pair in enumerate(zeros):
        columns = slice(first_zero + 2 * number, first_zero + 2 * number + 2)
        if specimen is not None and number < found.held_zeros:
            known = (float(specimen.frequency_error_hz[number]), float(specimen.damping_error[number]))
            rows.append(Root("zero", pair[0] / (2.0 * np.pi), pair[1], *known))
        else:
            rows += _rows_of_pair("zero", pair, spread[columns, columns])
    return tuple(rows)


def _rows_of_pair(kind: str, pair: Array, spread: Array) -> list[Root]:
    """Return a pair (w, zeta) as one root, or as two real ones; `spread` (2, 2) is the covariance of its logarithms."""
    hz, ratio, nan = pair[0] / (2.0 * np.pi), float(pair[1]), float("nan")
    if ratio <= OVERDAMPED:
        return [Root(kind, hz, ratio, hz * math.sqrt(spread[0, 0]), ratio * math.sqrt(spread[1, 1]))]
    root = math.sqrt(ratio**2 - 1.0)
    found = []
    for sign in (-1.0, 1.0):  # corners w (zeta -+ sqrt(zeta^2 - 1)) and the slopes of their logarithms
        corner = hz * (ratio + root) ** sign
        slopes = np.array([1.0, sign * ratio / root])
        found.append(Root(kind, corner, nan, corner * math.sqrt(max(slopes @ spread @ slopes, 0.0)), nan))
    return found


def response_error(found: Fit, frequency_hz: Array) -> Array:
    """Return the relative standard uncertainty (m,) of a fit's response, to first order in its parameters."""
    s = (2j * np.pi * frequency_hz).astype(complex)
    _, slopes = response_and_slopes(found.layout, found.parameters, s)
    spread = found.covariance[: found.layout.size, : found.layout.size]
    square = sum(np.einsum("im,ij,jm->m", part, spread, part) for part in (slopes.real, slopes.imag))
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def without_information(
    found: Fit, roots: Sequence[Root], most: FitError, compared: ComparedBand
) -> tuple[float, tuple[Finding, ...], tuple[Finding, ...]]:
    """Return what roots that the data do not determine cost a model.

    That is the frequency above which the model says nothing (its response is uncertain, by two standard uncertainties,
    beyond the limit `most.largest` of the fit's error; infinite where every root is determined), a warning that says
    so, and a reason to reject the model where this lies within the compared band.
    """
    unknown = [root for root in roots if not root.determined]
    if not unknown:
        return math.inf, (), ()
    frequency = np.geomspace(compared.low_hz, 0.5 / found.model.dt_s, LINES_OF_ERROR)
    error = SCATTER * response_error(found, frequency)
    bad = np.flatnonzero(error > most.largest)
    known_hz = float(frequency[bad[0]]) if bad.size else float(frequency[-1])
    inside = float(error[frequency <= compared.high_hz].max())
    names = without_repeats(_named(root, found.model.band_hz) for root in unknown)
    values = {"roots": names, "count": len(unknown), "error": inside, "band": str(compared)}
    if inside > most.largest:
        return known_hz, (), (Finding("model.unknown_roots", {**values, "limit": most.largest}),)
    told = Finding("model.idle_roots", {**values, "known_hz": known_hz if bad.size else None})
    return known_hz if bad.size else math.inf, (told,), ()


def _named(root: Root, band_hz: tuple[float, float]) -> Finding:
    """Return what a root is and where; the number of an undetermined frequency says nothing."""
    what = root.kind if math.isnan(root.damping_ratio) else f"{root.kind}_pair"
    if root.frequency_known:
        return Finding("root.damping", {"root": what, "at_hz": root.frequency_hz})
    low, high = band_hz
    place = "beyond" if root.frequency_hz > high else "below" if root.frequency_hz < low else "within"
    return Finding("root.place", {"root": what, "place": place, "low_hz": low, "high_hz": high})


def roots_given(model: Model) -> tuple[Root, ...]:
    """Return poles and finite zeros of a supplied model, which has no uncertainties (NaN)."""
    nan = float("nan")
    rows = []
    for kind, roots in (("pole", model.poles), ("zero", model.zeros[np.abs(model.zeros) > 1e-9])):
        for root in sorted(roots, key=abs):
            if root.imag >= 0.0:
                ratio = -root.real / abs(root) if root.imag > 0.0 else nan
                rows.append(Root(kind, abs(root) / (2.0 * np.pi), float(ratio), nan, nan))
    return tuple(rows)


AGREE_SIGMA, AGREE_HZ, AGREE_DAMPING = 3.0, 0.003, 0.05  # agreement: standard errors, or relative differences
MORE_THAN_HELD = 2.0  # held-out error of the chosen structure from which a warning is given
MISFIT = 0.003  # unexplained fraction of the floors' motion for a warning; good fits leave 0.0002
USABLE = 0.2  # largest relative uncertainty, and unexplained fraction, of a usable free vibration


def misfit(specimen: SpecimenFit | None, seen: Sequence[ChannelReport]) -> tuple[Finding, ...]:
    """Return a warning if the specimen deviates from a linear chain with the given masses and modal damping."""
    if specimen is None:
        return ()
    noise = max((c.rest_rms_m_s2 or 0.0) / c.rms_m_s2 for c in seen)
    if specimen.residual <= max(MISFIT, 3.0 * noise):
        return ()
    return (Finding("specimen.no_chain", {"residual": specimen.residual}),)


def not_held(candidates: Sequence[Candidate]) -> tuple[Finding, ...]:
    """Return a warning if the data show more dynamics than the chosen structure contains."""
    worst = max((tried.held_out for tried in candidates if tried.chosen), default=0.0)
    return (Finding("model.held_out", {"ratio": worst}),) if worst > MORE_THAN_HELD else ()


def late(model: Model, info: RigInfo) -> tuple[Finding, ...]:
    """Return a warning if the fitted delay is longer than the rig declares."""
    declared = Timing(info.latency_samples, info.dt_s, info.transport_s).delay_s
    if model.delay_s <= declared * (1.0 + 1e-9):
        return ()
    return (Finding("model.late", {"delay_s": model.delay_s, "declared_s": declared}),)


def usable(free: SpecimenFit | None) -> tuple[SpecimenFit | None, tuple[Finding, ...]]:
    """Return the fit to the free vibration if it is usable, else None and a warning that it is too weak."""
    if free is None:
        return None, ()
    known = np.concatenate(
        [free.frequency_error_hz / free.natural_frequency_hz, free.damping_error / free.damping_ratio]
    )
    if np.isfinite(known).all() and known.max() < USABLE and free.residual < USABLE:
        return free, ()
    return None, (Finding("free_vibration.weak", {"residual": free.residual}),)


def differences(noise: SpecimenFit | None, free: SpecimenFit | None) -> tuple[Finding, ...]:
    """Return a warning for each mode in which excitation and free vibration disagree."""
    if noise is None or free is None:
        return ()
    return tuple(
        Finding(
            "free_vibration.differs",
            {
                "mode": mode + 1,
                "excited_hz": noise.natural_frequency_hz[mode], "excited_damping_ratio": noise.damping_ratio[mode],
                "free_hz": free.natural_frequency_hz[mode], "free_damping_ratio": free.damping_ratio[mode],
            },
        )
        for mode in range(len(noise.damping_ratio))
        if not agree(noise, free, mode)
    )  # fmt: skip


def agree(one: SpecimenFit, other: SpecimenFit, mode: int) -> bool:
    """Return whether two fits agree in a mode.

    They agree within three standard uncertainties, or within 0.3 % of the frequency and 5 % of the damping ratio.
    """
    hz = abs(one.natural_frequency_hz[mode] - other.natural_frequency_hz[mode])
    ratio = abs(one.damping_ratio[mode] - other.damping_ratio[mode])
    hz_spread = float(np.hypot(one.frequency_error_hz[mode], other.frequency_error_hz[mode]))
    ratio_spread = float(np.hypot(one.damping_error[mode], other.damping_error[mode]))
    return bool(
        hz <= max(AGREE_SIGMA * hz_spread, AGREE_HZ * one.natural_frequency_hz[mode])
        and ratio <= max(AGREE_SIGMA * ratio_spread, AGREE_DAMPING * one.damping_ratio[mode])
    )
