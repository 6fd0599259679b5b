"""Judge the channels by their frequency responses, and name the fault that explains them: swapped, reversed,
scaled, wrong mass.

Channels are judged together: by the storeys' equations with free stiffness and damping (chain_residual.py), and by the
single faults that would explain a misfit (channel_fault_hypotheses.py). The command shows a reversal of all channels,
which floors and table alone cannot show.

Each fault that is tried is a change of the data (channels multiplied or exchanged) or of the masses. The storeys'
equations are solved again with that change (chain_residual.py). A fault is reported only if the declared channels
cannot be explained, the fault explains them, and it is large enough. Faults that explain the channels equally well are
reported together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise
from operator import itemgetter
from typing import Any

import numpy as np

from rths_cli.findings import Finding
from rths_cli.identification import channel_signals
from rths_cli.identification.chain_residual import Explained, Grouped, explained, grouped
from rths_cli.identification.inputs import Evidence
from rths_cli.identification.table_fit import within
from rths_cli.numerics.bands import USUAL, ComparedBand
from rths_cli.numerics.lti import Array, ComplexArray, Frf
from rths_cli.rigs.description import RigInfo

FITS = 2.0  # largest misfit of a storey, in standard deviations, at which the declared chain is accepted
CURED = 0.4  # a fault explains the channels if it leaves at most this fraction of the misfit
ALIKE = 1.3  # faults with up to this multiple of the least misfit explain the channels equally well
RANGE = (0.3, 3.0)  # tried factors of a mass
# tried factors of a sensitivity, range by range; a channel that is in g where m/s^2 are declared is among them
READINGS = (0.05, 0.3, 3.0, 20.0)
LEAST_REVERSED = 4  # channels; with up to three floors, exchanging two floors already reverses their order
LATEST = 3.0  # tried delays of one channel against the others, in samples, either way
SIGN, GAIN, SWAP, REVERSED, MASS, LATE = "sign", "gain", "swap", "reversed", "mass", "late"

LEAST_COHERENCE = 0.9  # median in the compared band
NOISE_MARGIN, SHARED = 3.0, 2.0  # allowed loss of coherence: multiples of the loss to noise, and of the table's loss
GAIN_SHARE, FAR_GAIN = 0.1, (0.6, 1.7)  # deviation from the data sheet's gain for a warning; range that is not refused
SURE = 3.0  # standard uncertainties
# of the usual compared band: highest frequency at which the table follows its command; cosine of a clear sign
FOLLOWS = 0.5  # least slope (power of frequency) of an acceleration in response to a displacement command
G_M_S2, NEAR = 9.80665, 0.1  # a factor of a sensitivity whose logarithm is as near to it is a wrong unit
REFUSED_GAIN, REFUSED_MASS = 0.03, 0.3  # errors of a sensitivity or mass beyond which channels are refused
BEYOND_DECLARED = 5.0  # standard uncertainties of a sensitivity beyond which channels are refused
SAID, UNEXPLAINED = 10.0, 30.0  # unexplained misfit, in standard deviations, for a warning and for a refusal
CALM = 0.2  # a chain explains the low level if it leaves at most this fraction of the misfit at full level
TRUE_MOTION = 10.0  # largest misfit of single lines, in standard deviations, at which channels show a chain's motion


@dataclass(frozen=True)
class Suspect:
    """A possible fault of channels or of floor masses."""

    kind: str
    channels: tuple[int, ...]  # indices of the channels concerned, 0 for the table; of a mass, the floor's channel
    size: float  # reading over true value, true over given mass, or delay of a channel in samples
    misfit: float  # rms of the storeys' residuals over their standard deviation if this fault is assumed


@dataclass(frozen=True)
class Diagnosis:
    """Whether the declared channels fit a chain, and the single faults that would explain them if they do not."""

    misfit: float  # of the channels as declared
    fits: bool  # whether the declared channels fit
    suspects: tuple[Suspect, ...]  # faults that explain the channels equally well, the best first; () if none does


def diagnose(chain: Grouped, dt_s: float) -> Diagnosis:
    """Return the single faults that explain grouped lines, if a chain with the given masses does not explain them."""
    declared = explained(chain)
    misfit = _misfit(declared)
    if float(declared.misfit.max(initial=0.0)) < FITS:
        return Diagnosis(misfit, True, ())
    tried = sorted((*_whole(chain), *_sized(chain, dt_s)), key=lambda suspect: suspect.misfit)
    best = tried[0].misfit
    if best > CURED * misfit:
        return Diagnosis(misfit, False, ())
    return Diagnosis(misfit, False, tuple(each for each in tried if each.misfit <= ALIKE * best))


def _misfit(found: Explained) -> float:
    """Return the rms, over all storeys, of the residuals over their standard deviation."""
    return float(np.sqrt(found.chi_square.sum() / found.count.sum()))


def _whole(chain: Grouped) -> Iterator[Suspect]:
    """Yield the faults without a size, each with its misfit: reversed signs, exchanged channels, reversed order."""
    count = len(chain.accel)
    for index in range(count):
        yield Suspect(
            SIGN, (index,), -1.0, _misfit(explained(chain.multiplied(_only(count, index, -1.0)), errors=False))
        )
    for pair in combinations(range(count), 2):
        order = list(range(count))
        order[pair[0]], order[pair[1]] = pair[1], pair[0]
        yield Suspect(SWAP, pair, 1.0, _misfit(explained(chain.permuted(order), errors=False)))
    if count > LEAST_REVERSED:
        order = [0, *range(count - 1, 0, -1)]
        yield Suspect(REVERSED, tuple(range(1, count)), 1.0, _misfit(explained(chain.permuted(order), errors=False)))


def _sized(chain: Grouped, dt_s: float) -> Iterator[Suspect]:
    """Yield the faults with a size (sensitivity, delay, mass), each with the size that leaves the least misfit.

    Masses are tried for two floors or more: with one floor its mass only scales the stiffness.
    """
    count = len(chain.accel)
    factors = float(np.log(RANGE[0])), float(np.log(RANGE[1]))
    readings = list(pairwise(np.log(READINGS).tolist()))
    for at in range(count):
        size, left = min((_least(partial(_reading, chain, at), bounds) for bounds in readings), key=itemgetter(1))
        yield Suspect(GAIN, (at,), float(np.exp(size)), left)
        yield Suspect(LATE, (at,), *_least(partial(_late, chain, at, dt_s), (-LATEST, LATEST)))
    for at in range(1, count) if count > 2 else ():
        size, left = _least(partial(_weighing, chain, at), factors)
        yield Suspect(MASS, (at,), float(np.exp(size)), left)


def _reading(chain: Grouped, index: int, size: float) -> Grouped:
    """Return the data corrected under the assumption that a channel reads exp(size) times the true value."""
    return chain.multiplied(_only(len(chain.accel), index, np.exp(-size)))


def _late(chain: Grouped, index: int, dt_s: float, samples: float) -> Grouped:
    """Return the data corrected under the assumption that a channel is `samples` samples late."""
    return chain.multiplied(_only(len(chain.accel), index, np.exp(1j * chain.omega * dt_s * samples)))


def _weighing(chain: Grouped, index: int, size: float) -> Grouped:
    """Return the data with the mass of a floor changed to exp(size) times the given one."""
    masses = chain.masses_kg.copy()
    masses[index - 1] *= np.exp(size)
    return replace(chain, masses_kg=masses)


def _only(count: int, index: int, factor: float | ComplexArray) -> ComplexArray:
    """Return factors (count, 1) or (count, g) of the channels: `factor` for one channel, 1 for the others."""
    factors = np.ones((count, np.size(factor)), dtype=complex)
    factors[index] = factor
    return factors


def _least(changed: Callable[[float], Grouped], bounds: tuple[float, float]) -> tuple[float, float]:
    """Return the size within bounds that leaves the least misfit, and that misfit."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda size: _misfit(explained(changed(float(size)), errors=False)),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-3},
    )
    return float(found.x), float(found.fun)


DIRECTION_HZ, DIRECTION = 3.0, 0.5


@dataclass(frozen=True)
class Judgement:
    """Faults for which the channels must not be used, and warnings on usable channels."""

    faults: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()


def _warning(found: Finding) -> Judgement:
    return Judgement((), (replace(found, severity="warns"),))


def judge(data: Evidence, frfs: Sequence[Frf]) -> Judgement:
    """Judge the channels by their responses: coherence, sign, order and sensitivity."""
    compared = data.settings.compared
    against = _direction(frfs[0], compared)
    if len(data.masses_kg) == 0:
        faults = _incoherent(data, frfs) or _does_not_follow(frfs[0], data.info, compared) or _polarity(against)
        return Judgement(tuple(faults))
    found = diagnose(grouped(data.records, data.info, data.masses_kg, data.settings.band_hz), data.info.dt_s)
    if found.fits or (found.suspects and found.suspects[0].kind == LATE and _all_late(found.suspects)):
        return Judgement(tuple(_incoherent(data, frfs) or _polarity(against)))
    yielding = _yielding(data, found)
    if yielding is not None:
        return yielding
    if found.suspects:
        return _named(found.suspects, data.info, against)
    faults = _incoherent(data, frfs) or _does_not_follow(frfs[0], data.info, compared)
    return Judgement(tuple(faults)) if faults else _rubbing(data, found) or _unexplained(found)


def far_gain(
    low_frequency_gain_m_per_v: float, info: RigInfo, measured: Frf, compared: ComparedBand = USUAL
) -> tuple[Finding, ...]:
    """Return the reason to reject a model whose gain is far from the data sheet's.

    The low-frequency gain of a model is an extrapolation below its band. Therefore the model is rejected only if the
    lines of the `measured` response up to DIRECTION_HZ are far from the data sheet's gain, too.
    """
    ratio = abs(low_frequency_gain_m_per_v) / info.gain_m_per_v
    ratios = (ratio, _measured_gain(measured, compared) / info.gain_m_per_v)
    if any(FAR_GAIN[0] <= each <= FAR_GAIN[1] for each in ratios):
        return ()
    return (Finding("table.far_gain", {"gain_m_per_v": abs(low_frequency_gain_m_per_v), "ratio": ratio}),)


def _measured_gain(table: Frf, compared: ComparedBand) -> float:
    """Return the median of the table's displacement per V over the lines up to DIRECTION_HZ, in m/V."""
    low = within(table.frequency_hz, (compared.low_hz, compared.with_high(DIRECTION_HZ)))
    return float(np.median(np.abs(table.response[low]) / (2.0 * np.pi * table.frequency_hz[low]) ** 2))


def gain_warnings(low_frequency_gain_m_per_v: float, relative_error: float, info: RigInfo) -> tuple[Finding, ...]:
    """Return a warning if the model's low-frequency gain differs from the data sheet's beyond its uncertainty.

    `relative_error` is the relative standard uncertainty of the gain.
    """
    ratio = abs(low_frequency_gain_m_per_v) / info.gain_m_per_v
    if abs(ratio - 1.0) <= GAIN_SHARE + SURE * ratio * relative_error or not FAR_GAIN[0] <= ratio <= FAR_GAIN[1]:
        return ()
    values = {"gain_m_per_v": abs(low_frequency_gain_m_per_v), "declared_m_per_v": info.gain_m_per_v}
    return (Finding("table.gain", values),)


def _incoherent(data: Evidence, frfs: Sequence[Frf]) -> list[Finding]:
    """Return a fault for each channel that loses more coherence than its own noise and the table explain.

    A disturbance of the table (friction, for instance) also moves the floors. Vibrations longer than a segment reduce
    the coherence, too, but they satisfy the storeys' equations line by line; a loose contact does not.
    """
    compared, most = data.settings.compared, 1.0 - LEAST_COHERENCE
    lost = [1.0 - channel_signals.coherence(frf, compared) for frf in frfs]
    if max(lost) <= most:
        return []
    lines = (data.records, data.info, data.masses_kg, data.settings.band_hz)
    if len(lost) > 1 and explained(grouped(*lines, raw=True)).misfit.max() < TRUE_MOTION and lost[0] <= most:
        return []
    noise = [_lost_to_noise(data, index, frfs[0].frequency_hz) for index in range(len(frfs))]
    seen = [
        {"coherence": 1.0 - each, "by_noise": 1.0 - own, "least": LEAST_COHERENCE, "band": str(compared)}
        for each, own in zip(lost, noise, strict=True)
    ]
    if lost[0] > most and all(each > most for each in lost[1:]) and len(lost) > 1:
        return [_disturbed(seen[0])]
    faults = []
    for index, channel in enumerate(data.info.channels):
        allowed = max(most, NOISE_MARGIN * noise[index] + (SHARED * lost[0] if index else 0.0))
        if lost[index] > allowed:
            there = {**seen[index], "channel": channel.name}
            faults.append(Finding("channel.loose", there) if len(lost) > 1 else _disturbed(there))
    return faults


def _disturbed(seen: Mapping[str, Any]) -> Finding:
    """Return the fault of channels that all lose coherence: their noise, or another disturbance of the table."""
    by_noise = 1.0 - seen["coherence"] <= NOISE_MARGIN * (1.0 - seen["by_noise"])
    return Finding("channels.small_motion" if by_noise else "channels.disturbed", seen)


def _lost_to_noise(data: Evidence, index: int, frequency_hz: Array) -> float:
    """Return the loss of coherence due to a channel's noise at rest and quantisation, median in the compared band."""
    from scipy import signal

    inside = frequency_hz[within(frequency_hz, data.settings.compared.hz)]
    shares = []
    for record in data.records:
        values = record.accel_m_s2[index, record.parts.noise]
        length = min(round(data.settings.segment_s / data.info.dt_s), len(values))
        f, power = signal.welch(values, 1.0 / data.info.dt_s, nperseg=length)
        noise = 2.0 * data.info.dt_s * channel_signals.channel_noise(record, data.info)[index] ** 2
        shares.append(noise / np.interp(inside, f, power))
    return float(np.clip(np.median(np.mean(shares, axis=0)), 0.0, 1.0))


def _direction(table: Frf, compared: ComparedBand) -> float:
    """Return the cosine of the phase between table and command at low frequency: 1 in phase, -1 reversed."""
    low = table.frequency_hz <= compared.with_high(DIRECTION_HZ)
    moved = table.response[low] / -((2.0 * np.pi * table.frequency_hz[low]) ** 2)
    return float(np.sum(moved.real) / np.sum(np.abs(moved)))


def _polarity(direction: float) -> list[Finding]:
    """Return a fault if channels that agree with each other all move against the command."""
    return [] if direction > -DIRECTION else [Finding("command.reversed")]


def _does_not_follow(table: Frf, info: RigInfo, compared: ComparedBand) -> list[Finding]:
    """Return a fault if the table's response does not rise with frequency, as that of an acceleration must."""
    low = within(table.frequency_hz, compared.hz)
    slope = float(np.polyfit(np.log(table.frequency_hz[low]), np.log(np.abs(table.response[low])), 1)[0])
    if slope > FOLLOWS:
        return []
    looks = "swapped" if slope < -FOLLOWS else "no_acceleration"
    values = {"channel": info.channels[0].name, "looks": looks, "slope": slope, "band": str(compared)}
    return [Finding("command.not_followed", values)]


def _all_late(found: Sequence[Suspect]) -> bool:
    """Return whether the table is out of step with all floors; that is judged later, with a model."""
    return any(each.channels == (0,) for each in found if each.kind == LATE)


def _yielding(data: Evidence, found: Diagnosis) -> Judgement | None:
    """Return a warning if the channels fit a chain at low level: then they are right and the specimen is nonlinear."""
    if data.quiet is None or found.misfit <= SAID:
        return None
    low = explained(grouped((data.quiet,), data.info, data.masses_kg, data.settings.band_hz))
    if float(low.misfit.max()) > CALM * found.misfit:
        return None
    return _warning(Finding("specimen.yields"))


def _rubbing(data: Evidence, found: Diagnosis) -> Judgement | None:
    """Return a warning if the channels fit a chain whose storeys rub: then they are right and the specimen is not
    linear at any level."""
    if found.misfit <= SAID:
        return None
    lines = grouped(data.records, data.info, data.masses_kg, data.settings.band_hz, joints=True)
    if float(explained(lines, errors=False).misfit.max()) > CALM * found.misfit:
        return None
    return _warning(Finding("specimen.rubs"))


def _unexplained(found: Diagnosis) -> Judgement:
    """Return the judgement on channels that neither a chain nor a single fault explains."""
    said = Finding("channels.unexplained", {"misfit": found.misfit})
    if found.misfit > UNEXPLAINED:
        return Judgement((said,))
    return _warning(said) if found.misfit > SAID else Judgement()


def _named(found: Sequence[Suspect], info: RigInfo, direction: float) -> Judgement:
    """Return the judgement that names the faults; several that cannot be distinguished share one finding."""
    found = _by_command(found, direction)
    suspects = tuple(_suspected(each, info) for each in found)
    said = suspects[0] if len(suspects) == 1 else Finding("channels.one_of", {"suspects": suspects})
    return Judgement((said,)) if _refused(found[0], info) else _warning(said)


def _by_command(found: Sequence[Suspect], direction: float) -> Sequence[Suspect]:
    """Return the suspects without those reversed signs that contradict the direction of the command."""
    signs = [each for each in found if each.kind == SIGN]
    if len(signs) < 2 or abs(direction) < DIRECTION:
        return found
    table = direction < 0.0
    return [each for each in found if each.kind != SIGN or (0 in each.channels) == table]


def _refused(found: Suspect, info: RigInfo) -> bool:
    """Tell whether a fault is too large for the channels to be used; of a sensitivity, larger than declared."""
    gain = max(REFUSED_GAIN, BEYOND_DECLARED * max(channel.uncertainty for channel in info.channels))
    least = {GAIN: gain, MASS: REFUSED_MASS}.get(found.kind)
    return least is None or abs(found.size - 1.0) > least


def _looks(size: float) -> str | None:
    """Return the unit that the values of a channel look to have which reads `size` times the true acceleration."""
    if abs(np.log(size * G_M_S2)) < NEAR:
        return "in_g"
    return "in_m_s2" if abs(np.log(size / G_M_S2)) < NEAR else None


def _suspected(found: Suspect, info: RigInfo) -> Finding:
    """Return the finding of a fault."""
    names = tuple(info.channels[index].name for index in found.channels)
    values: dict[str, Any] = {"channel": names[0]}
    if found.kind == GAIN:
        by = "every_floor" if found.channels == (0,) and len(info.channels) > 2 else "others"
        values |= {"factor": found.size, "by": by, "looks": _looks(found.size)}
    elif found.kind == LATE:
        values |= {"late_samples": abs(found.size), "way": "late" if found.size > 0.0 else "early"}
    elif found.kind in (SWAP, REVERSED):
        values = {"channels": names}
    elif found.kind == MASS:
        values |= {"factor": found.size}
    return Finding(f"suspect.{'order' if found.kind == REVERSED else found.kind}", values)
