"""A run that was made elsewhere, from its recording: channels by their roles, aligned to the case's record, as the
signals of a run on the table that `one_table_run.run_of` takes.

The ground motion of the recording is laid on that of the case (`analysis/recording_alignment.py`). Without it the
motion of the computed storeys tells the time: what the desired motion is beside the base shear's part of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rths_cli.analysis.intensity import integrate
from rths_cli.analysis.metrics import frequency_evaluation
from rths_cli.analysis.recording_alignment import Alignment, LostBlock, align, moved_to_record
from rths_cli.control import sensor_correction
from rths_cli.control.kalman_filter import kalman_block
from rths_cli.errors import InputError
from rths_cli.experiment.one_table_run import HYBRID_TEST, TABLE_RUNS, RunKind
from rths_cli.experiment.recording_faults import channel_faults
from rths_cli.experiment.run_signals import base_shear_of, computed_interface
from rths_cli.experiment.setup import RecordedRun, Setup, placed, shown
from rths_cli.files.measured_data import Recording, RunChannels, choose_of_run, mend, read_recording
from rths_cli.findings import Finding, stated
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.run_log import Signals
from rths_cli.loop.simulated_time_run import Outcome, part_of
from rths_cli.numerics.lti import Array

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rths_cli.case.recorded_run_schema import RecordedRunSpec

OWN = "own (recorded)"  # the controller of a run that was made elsewhere
RATES = (0.8, 1.25)  # of the case's rate, that a recording may have
NEAR = 0.1  # samples, within which a recording must lie on the record everywhere
RECOGNISED = 0.9  # correlation, below which the ground motion is another record
SAME_SIZE = 0.01  # of the gain of the recorded ground motion
SAME_MOTION = 0.02  # of its RMS, that may differ from the case's
LIKE_MOTION = 0.1  # the same of one that is the record otherwise interpolated: SIM then takes the recorded one
SAME_CLOCK = 5e-5  # relative difference from the stated rate that such a motion may not show
WITHOUT_GROUND = 5.0  # times as much where the computed storeys tell the time
NOTED_OFFSET = 1e-3  # of the record's peak: a mean of the recorded ground motion that is told
QUIET = 1e-3  # of the record's peak, up to which the ground is at rest before a recording begins
LEAST_REST_S = 0.2  # before the record, over which the zeros of sensors in V are taken
LEAST_SAMPLES = 100
COSTS = {
    "ground": "the time is told by the computed storeys: desired motion less the base shear's part of it",
    "desired": "taken as what the case's computed storeys do under ground and base shear, so that the tracking error "
    "holds what the controller computed otherwise",
    "command": "nothing is told of what was sent to the table",
    "base_shear": "taken as masses times measured accelerations, so that what the controller's own filter made of it "
    "is part of the loop's error",
    "displacement": "those of the floors are estimated by the case's Kalman filter with the declared specimen",
}
"""What a missing channel costs."""


def with_recordings(setup: Setup) -> Setup:
    """Return a setup with the recorded runs of its case, its ground motion cut to what they cover; as it is without.

    Raises InputError with all faults of the recordings, each with the place of its key in the case.
    """
    runs: dict[str, RecordedRun] = {}
    faults: list[str] = []
    for kind in TABLE_RUNS if setup.case.recorded else ():
        spec = setup.case.recorded.get(kind.name)
        if spec is None:
            continue
        try:
            runs[kind.name] = _recorded_run(setup, kind, spec)
            faults += channel_faults(setup, runs[kind.name])
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(*(placed(setup.case, fault) for fault in faults))
    if not runs:
        return setup
    samples = min(run.samples for run in runs.values())
    grounds = [run.ground for run in runs.values() if run.ground is not None]
    if grounds:
        motion, ground = setup.motion, np.zeros(len(setup.motion.time_s))
        ground[: grounds[-1].size] = grounds[-1]
        velocity, displacement = integrate(ground, motion.dt_s)
        motion = replace(motion, accel_m_s2=ground, velocity_m_s=velocity, displacement_m=displacement)
        setup = replace(setup, motion=motion)
    return replace(_cut(setup, samples), recorded={name: _shortened(run, samples) for name, run in runs.items()})


def _cut(setup: Setup, samples: int) -> Setup:
    motion = setup.motion
    if samples == len(motion.time_s):
        return setup
    names = ("time_s", "accel_m_s2", "velocity_m_s", "displacement_m")
    return replace(setup, motion=replace(motion, **{name: getattr(motion, name)[:samples] for name in names}))


def _shortened(run: RecordedRun, samples: int) -> RecordedRun:
    outcome = replace(run.outcome, log=part_of(run.outcome.log, slice(0, samples)), steps=samples)
    return replace(run, outcome=outcome, samples=samples)


def roles_of(setup: Setup, kind: RunKind) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Return the roles of a run's channels with the SI units in which they may come, and those that it needs."""
    floors = [channel.name for channel in setup.rig.channels[1:]]
    roles: dict[str, tuple[str, ...]] = {"ground": ("m/s^2",), "desired": ("m/s^2",), "command": ("V",)}
    sensed: tuple[str, ...] = ("m/s^2", "V")
    roles |= dict.fromkeys(("table", *floors), sensed)
    if kind is HYBRID_TEST:
        roles |= {"base_shear": ("N",)} | {f"{floor}_displacement": ("m",) for floor in floors}
    return roles, ("table", *floors) if kind is HYBRID_TEST else ("table",)


def _recorded_run(setup: Setup, kind: RunKind, spec: RecordedRunSpec) -> RecordedRun:
    """Return the run of one recording on the record's clock; raises InputError with the reasons where it is none."""
    recording = read_recording(spec.recording, 1.0 / spec.rate_hz if spec.rate_hz else None)
    name, dt_s = shown(spec.recording), setup.rig.dt_s
    stated_step = recording.dt_s / dt_s
    if not RATES[0] <= 1.0 / stated_step <= RATES[1]:
        rate = 1.0 / recording.dt_s
        raise InputError(
            f"{name}: sampled at {rate:g} Hz, the case runs at {setup.case.sample_rate_hz:g} Hz; judge it at its own "
            f"rate, --set sample_rate_hz={rate:g}"
        )
    wanted, needed = roles_of(setup, kind)
    channels = choose_of_run(recording, wanted, needed, spec.choices)
    series, notes = _mended(channels)
    if "ground" not in series and "desired" not in series:
        raise InputError(
            f"{name}: has neither the ground motion nor the desired motion of the table (ground, desired), so that "
            "nothing tells where the record begins; give one of them"
        )
    if kind is HYBRID_TEST and "desired" not in series and not setup.building.linear:
        raise InputError(
            f"{name}: has no desired motion (desired), and what storeys with laws ask for is not known without it; "
            "give the channel"
        )
    series = _as_accelerations(setup, channels, series, recording.dt_s)
    aligned, series = _aligned(setup, kind, spec, series, stated_step, name)
    moved, told, samples = _on_record(setup, kind, spec, series, aligned, name)
    told = [*_said(aligned, recording, stated_step, dt_s, len(series["table"])), *told]
    sentences = (*notes, *_missing(setup, kind, moved), *rounding_told(recording, channels, moved, dt_s))
    told += [stated(f"{name}: {sentence}", "notes") for sentence in sentences]
    signals = _signals(setup, kind, moved, samples)
    outcome = Outcome(signals, samples, None, "", 0.0, played=True)
    about = {
        f"{kind.name}_recording": f"{spec.recording.name}, SHA-256 {recording.sha256}",
        f"{kind.name}_recorded_channels": "\n".join(f"{role}: {one}" for role, one in channels.names.items()),
    }
    figures = _figures(kind.name, aligned, stated_step, dt_s, len(series["table"]))
    own_ground = moved["ground"] if aligned.residual > SAME_MOTION and "ground" in moved else None
    return RecordedRun(kind.name, outcome, samples, channels.names, own_ground, tuple(told), figures, about)


def _mended(channels: RunChannels) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return the series with short gaps bridged, and a sentence for each channel that had any."""
    mended, notes = mend(np.array(list(channels.series.values())), list(channels.series))
    return dict(zip(channels.series, mended, strict=True)), notes


def _as_accelerations(setup: Setup, channels: RunChannels, series: dict[str, Array], dt_s: float) -> dict[str, Array]:
    """Return the series with those of sensors in V as accelerations, corrected for the sensors' corners; those that are
    accelerations in the file stay as they are. The zero of a sensor is its mean before the first motion, else its
    mean."""
    in_volts = [one for one in setup.rig.channels if channels.units.get(one.name) == "V"]
    if not in_volts:
        return series
    rest = slice(0, max(_first_motion(series), round(LEAST_REST_S / dt_s)))
    found = dict(series)
    for channel in in_volts:
        volts = channel.sign * series[channel.name]
        still = volts[rest] if np.ptp(np.nan_to_num(volts[rest])) < 0.1 * np.nanmax(np.abs(volts)) else volts
        block = sensor_correction.correction((channel,), dt_s, setup.removes_sensors)
        known = np.isfinite(volts)
        accel = run_block(block, np.where(known, volts - np.nanmean(still), 0.0)[None])[0]
        found[channel.name] = np.where(known, accel, np.nan)
    return found


def _first_motion(series: Mapping[str, Array]) -> int:
    """Return the first sample at which the ground, or the desired motion, is not as at the beginning."""
    motion = series.get("ground", series.get("desired"))
    assert motion is not None  # checked above
    moves = np.abs(motion - motion[0]) > QUIET * np.nanmax(np.abs(motion - motion[0]))
    return int(np.argmax(moves)) if moves.any() else 0


def _aligned(
    setup: Setup, kind: RunKind, spec: RecordedRunSpec, series: dict[str, Array], step: float, name: str
) -> tuple[Alignment, dict[str, Array]]:
    """Return where a recording lies on the record, and the part of it that is judged; raises InputError."""
    recorded, record, what = _motions(setup, kind, series, name)
    found = align(recorded, record, step, setup.rig.dt_s)
    if found is not None and found.lost and spec.until_s is not None:
        first = found.lost[0]
        if first.at * setup.rig.dt_s >= spec.until_s:
            series = {role: values[: first.before + 1] for role, values in series.items()}
            found = align(recorded[: first.before + 1], record, step, setup.rig.dt_s)
    loosely = 1.0 if "ground" in series or kind is not HYBRID_TEST else WITHOUT_GROUND
    if found is not None and "ground" in series and _is_like(found, step):
        found = replace(found, offset=float(round(found.offset)), step=1.0, as_stated=True)
    faults = list(_alignment_faults(setup, found, what, name, loosely, len(series["table"])))
    if faults or found is None:
        raise InputError(*faults)
    return found, series


def _is_like(found: Alignment, stated: float) -> bool:
    """Return whether a recorded ground motion is the record as another program interpolated it: SIM takes it as it was
    recorded, and where it begins need not be known better than by a sample."""
    alike = SAME_MOTION < found.residual <= LIKE_MOTION and abs(found.gain - 1.0) <= SAME_SIZE * WITHOUT_GROUND
    return alike and stated == 1.0 and abs(found.step - 1.0) <= SAME_CLOCK + 3.0 * found.step_error


def _motions(setup: Setup, kind: RunKind, series: Mapping[str, Array], name: str) -> tuple[Array, Array, str]:
    """Return the recorded motion that tells the time, the same of the record, and what it is."""
    ground = setup.motion.accel_m_s2
    if "ground" in series:
        return series["ground"], ground, "the ground motion of the recording"
    if kind is not HYBRID_TEST:
        return series["desired"], ground, "the desired motion of the recording"
    if not setup.building.linear:
        raise InputError(
            f"{name}: has no ground motion (ground), and storeys with laws tell no time without it; give the channel"
        )
    shear = _shear(setup, series)
    if not np.isfinite(shear).all():
        raise InputError(f"{name}: has no ground motion (ground), and samples of the base shear are missing")
    own = series["desired"] - computed_interface(setup, np.zeros_like(shear), shear)
    of_record = computed_interface(setup, ground, np.zeros_like(ground))
    return own, of_record, "the desired motion of the recording without the base shear's part"


def _shear(setup: Setup, series: Mapping[str, Array]) -> Array:
    if "base_shear" in series:
        return series["base_shear"]
    floors = np.array([series[channel.name] for channel in setup.rig.channels[1:]])
    return base_shear_of(setup, series["table"], floors)


def _alignment_faults(
    setup: Setup, found: Alignment | None, what: str, name: str, loosely: float, samples: int
) -> Iterator[str]:
    """Yield why a recording does not belong to the record of the case, or does not lie on it."""
    case, dt_s = setup.case, setup.rig.dt_s
    if found is not None and found.lost:
        yield from (_lost_sentence(name, one, dt_s) for one in found.lost)
        return
    if found is None or not np.isfinite(found.gain) or abs(found.correlation) < RECOGNISED:
        best = "" if found is None else f" (largest correlation {abs(found.correlation):.2f})"
        yield (
            f"{name}: {what} is not the record {case.record.name} of the case, at no offset and no rate within 10 % of "
            f"the stated one{best}; name the record of the test, with its component, filter and scale"
        )
        return
    if found.gain < 0.0:
        yield (
            f"{name}: {what} has the opposite sign of the record's (gain {found.gain:.4g}); turn it by a minus before "
            "its unit, as in ground: [NAME, -m/s^2], if it is the channel, or correct the record"
        )
    if found.as_stated and found.residual > SAME_MOTION:  # SIM takes the recorded motion
        return
    if found.residual > SAME_MOTION * loosely:  # then gain and clock say nothing
        yield (
            f"{name}: {what} differs from the record {case.record.name} of the case by {100.0 * found.residual:.2g} % "
            "of its RMS: another component, baseline, record_filter or scale was played; state that of the test"
        )
        return
    gain = abs(found.gain)
    if abs(gain - 1.0) > SAME_SIZE * loosely:
        yield (
            f"{name}: {what} is {gain:.4g} times that of the case{_of_size(gain)}; the test was scaled by "
            f"{gain * case.scaling:.4g}, the case says {case.scaling:g}: --set scaling={gain * case.scaling:.4g}, or "
            "correct the channel's unit"
        )
    yield from _clock_faults(found, name, samples)


def _of_size(gain: float) -> str:
    """Return a remark on a gain that is that between two units, "" for any other."""
    units = {9.80665: "g taken for m/s^2", 1000.0: "mm for m", 100.0: "cm for m"}
    for size, words in units.items():
        if abs(gain * size - 1.0) < SAME_SIZE or abs(gain / size - 1.0) < SAME_SIZE:
            return f" (looks like {words}, or the reverse)"
    return ""


def _clock_faults(found: Alignment, name: str, samples: int) -> Iterator[str]:
    if found.worst > NEAR:
        yield (
            f"{name}: its samples lie up to {found.worst:.2g} of a sample beside an even clock, at most {NEAR:g} is "
            "allowed: samples were lost or repeated, or its clock is not even; export the recording with the time of "
            "each sample"
        )
    elif (unsure := found.error_at_ends(samples)) > NEAR:
        yield (
            f"{name}: where it lies on the record is known within {unsure:.2g} of a sample only (noise in the channel "
            f"that tells the time), at most {NEAR:g} is allowed; give the ground motion as the controller had it"
        )


def _lost_sentence(name: str, one: LostBlock, dt_s: float) -> str:
    at_s = one.at * dt_s
    if one.samples > 0:
        return (
            f"{name}: {one.samples} samples ({one.samples * dt_s:.4g} s) are lost after sample {one.before + 1} of the "
            f"recording, {at_s:.3f} s into the record: what comes later is too early by them, and the file does not "
            f"say so; export the whole run, or judge it up to there{_until(at_s - dt_s)}"
        )
    return (
        f"{name}: {-one.samples} samples ({-one.samples * dt_s:.4g} s) are there twice after sample {one.before + 1} "
        f"of the recording, {at_s:.3f} s into the record; export the run again, or judge it up to there"
        f"{_until(at_s - dt_s)}"
    )


def _until(at_s: float) -> str:
    return f" (--until {max(at_s, 0.0):.6g}, or until_s in the case)"


def _on_record(
    setup: Setup, kind: RunKind, spec: RecordedRunSpec, series: Mapping[str, Array], aligned: Alignment, name: str
) -> tuple[dict[str, Array], list[Finding], int]:
    """Return the series (n,) on the record's clock, what is to be said of their span, and n; raises InputError where a
    part of the record is missing that counts."""
    record, dt_s = setup.motion.accel_m_s2, setup.rig.dt_s
    roles = list(series)
    moved = moved_to_record(np.array([series[role] for role in roles]), aligned, record.size)
    count = len(series["table"])
    places = aligned.places(record.size)
    inside = np.flatnonzero((places > -1.0) & (places < count))
    if inside.size < LEAST_SAMPLES:
        raise InputError(f"{name}: {inside.size} samples lie within the record; give the recording of the run")
    first, end = int(inside[0]), int(inside[-1]) + 1
    told: list[Finding] = []
    peak = float(np.abs(record).max())
    if first and float(np.abs(record[:first]).max()) > QUIET * peak:
        before = float(np.abs(record[:first]).max())
        raise InputError(
            f"{name}: begins {first * dt_s:.4g} s after the record, when the ground has moved by up to "
            f"{100.0 * before / peak:.2g} % of its peak; give a recording that begins before the motion does"
        )
    if first:
        moved[:, :first] = 0.0
        told.append(stated(f"{name}: begins {first * dt_s:.4g} s after the record, whose ground is still at rest"))
    if spec.until_s is not None:
        end = min(end, int(spec.until_s / dt_s + 1e-9) + 1)
    if end < record.size:
        why = "as until_s says" if spec.until_s is not None else "where the recording ends"
        told.append(
            stated(
                f"{name}: the run is judged up to {(end - 1) * dt_s:.4f} s of {(record.size - 1) * dt_s:.4f} s, {why}"
            )
        )
    _refuse_gaps(roles, moved[:, :end], dt_s, name)
    return dict(zip(roles, moved[:, :end], strict=True)), told, end


def _refuse_gaps(roles: list[str], moved: Array, dt_s: float, name: str) -> None:
    """Raise InputError for channels with missing samples within the record."""
    gaps = np.isnan(moved)
    if not gaps.any():
        return
    at = int(np.argmax(gaps.any(axis=0)))
    which = ", ".join(role for role, row in zip(roles, gaps, strict=True) if row.any())
    count = int(gaps.sum(axis=1).max())
    raise InputError(
        f"{name}: {count} samples ({count * dt_s:.4g} s) are missing in {which}, the first {at * dt_s:.4f} s into the "
        f"record; what moved there is not known; judge the run up to there{_until((at - 1) * dt_s)}"
    )


def _missing(setup: Setup, kind: RunKind, series: Mapping[str, Array]) -> Iterator[str]:
    """Yield a sentence for each channel that is not there, with what it costs."""
    there = {*series, *(() if kind is HYBRID_TEST else ("base_shear", "displacement"))}
    floors = [f"{channel.name}_displacement" for channel in setup.rig.channels[1:]]
    if set(floors) <= there:
        there.add("displacement")
    for role, cost in COSTS.items():
        if role not in there and not (kind is not HYBRID_TEST and role in ("ground", "desired")):
            yield f"no {'displacements' if role == 'displacement' else role}: {cost}"


def rounding(values: Array) -> tuple[str, float]:
    """Return to how many decimals or digits samples (n,) are rounded, "" for more than 8, and that rounding's RMS."""
    known = values[np.isfinite(values) & (values != 0.0)]
    powers = np.floor(np.log10(np.abs(known)))
    for figures in range(9):
        for kind, unit in (("decimals", np.full(known.size, -float(figures))), ("digits", powers - figures + 1)):
            count = known / 10.0**unit
            if known.size and (figures or kind == "decimals") and np.abs(count - np.rint(count)).max() < 1e-6:
                return f"{figures} {kind}", float(np.sqrt(np.mean(10.0 ** (2.0 * unit)) / 12.0))
    return "", 0.0


def rounding_told(
    recording: Recording, channels: RunChannels, series: Mapping[str, Array], dt_s: float
) -> Iterator[str]:
    """Yield what the rounding of desired and measured motion in the file alone makes of their difference.

    Rounding errors of RMS e, white, move the delay of n samples of RMS a by e / (a sqrt(n)) over its equivalent
    circular frequency (the frequency evaluation index of signal plus white noise); stated thrice.
    """
    told, square = [], 0.0
    for role in ("desired", "table") if {"desired", "table"} <= series.keys() else ():
        raw = recording.samples[recording.names.index(channels.names[role])]
        figures, error = rounding(raw)
        told += [f"{role} to {figures}"] if figures else []
        square += (error * float(np.sqrt(np.mean(series[role] ** 2) / np.nanmean(raw**2)))) ** 2 if figures else 0.0
    if not told:
        return
    found = frequency_evaluation(series["desired"], series["table"], dt_s)
    size = float(np.sqrt(np.mean(series["desired"] ** 2) * series["desired"].size))
    late_s = 3.0 * square**0.5 / size / (2.0 * np.pi * found.frequency_hz)
    yield (
        f"the file rounds {' and '.join(told)}: that alone is {square**0.5:.2g} m/s^2 RMS of the tracking error, "
        f"and +- {1e6 * late_s:.2g} us of its delay"
    )


def _signals(setup: Setup, kind: RunKind, series: dict[str, Array], samples: int) -> Signals:
    """Return the signals of a run of `samples` steps whose command acts at once."""
    ground, dt_s, unknown = setup.motion.accel_m_s2[:samples], setup.rig.dt_s, np.full(samples, np.nan)
    names = [channel.name for channel in setup.rig.channels]
    measured = np.array([series.get(name, unknown) for name in names])
    shear, desired = unknown, series.get("desired", ground)
    if kind is HYBRID_TEST:
        shear = series.get("base_shear", base_shear_of(setup, measured[0], measured[1:]))
        if "desired" not in series:
            desired = computed_interface(setup, ground, shear) if setup.building.linear else unknown
    nothing = np.zeros((0, samples))
    return Signals(
        true_velocity_m_s=nothing,
        corrected=measured,
        further=nothing,
        desired=np.vstack([desired, *integrate(desired, dt_s)]),
        command_v=series.get("command", unknown),
        base_shear_n=shear,
        estimated=_estimated(setup, measured, [series.get(f"{name}_displacement") for name in names[1:]]),
        logged=nothing,
        true_displacement_m=np.zeros(0),
        compute_ns=unknown,
        samples_v=nothing,
        further_v=nothing,
        late_ns=np.zeros(0),
        exchange_ns=np.zeros(0),
        lost=np.zeros(0),
        state=np.zeros(0),
    )


def _estimated(setup: Setup, measured: Array, displacements: list[Array | None]) -> Array:
    """Return the floors' displacements and velocities relative to the table, and accelerations (3 n_exp, n): those of
    the Kalman filter of the declared specimen, where they are not recorded."""
    floors, dt_s, kalman = len(measured) - 1, setup.rig.dt_s, setup.case.kalman
    if not np.isfinite(measured).all():
        return np.full((3 * floors, measured.shape[1]), np.nan)
    found = run_block(kalman_block(setup.building.specimen, kalman.q, kalman.r, dt_s, knows_table=True), measured)
    for floor, moved in enumerate(displacements):
        if moved is not None:
            found[floor], found[floors + floor] = moved, np.gradient(moved, dt_s)
    return np.asarray(found)


def _said(found: Alignment, recording: Recording, stated_step: float, dt_s: float, count: int) -> list[Finding]:
    """Return the sentence on how a recording was aligned, and one on what is unusual of its ground motion."""
    begins_s, fast = -found.offset / found.step * recording.dt_s, stated_step / found.step - 1.0
    start = (
        f"the record begins {abs(begins_s):.6f} s into it" if begins_s > -1e-7 else f"it begins {-begins_s:.6f} s late"
    )
    start += f" +- {max(1e6 * found.offset_error * dt_s, 0.01):.2g} us"
    clock = "its clock is the record's"
    if abs(fast) > 1e-3:
        rate = 1.0 / (found.step * dt_s)
        stated_hz, wrong = 1.0 / recording.dt_s, 100.0 * abs(fast)
        clock = f"its stated rate of {stated_hz:.6g} Hz is {wrong:.3g} % wrong, {rate:.6g} Hz is true"
    elif abs(fast) * count > 0.02 and not found.as_stated:
        which, error = "fast" if fast > 0.0 else "slow", 1e6 * found.step_error
        clock = f"its clock is {1e6 * abs(fast):.3g} +- {max(error, 0.001):.2g} ppm {which}"
    how = "moved by whole samples" if found.whole(count) is not None else "interpolated between samples"
    if found.whole(count) == 0:
        how = "neither moved nor interpolated"
    told = [stated(f"{shown(recording.path)} ({recording.format}): {start}, {clock}; {how}", "notes")]
    if abs(found.mean) > NOTED_OFFSET * np.sqrt(max(found.gain**2, 1e-30)):
        told.append(stated(f"{shown(recording.path)}: its ground motion has an offset of {found.mean:.3g} m/s^2"))
    if found.residual > SAME_MOTION and found.as_stated:
        told.append(
            stated(
                f"{shown(recording.path)}: its ground motion differs by {100.0 * found.residual:.2g} % of its RMS from "
                "the case's, as another interpolation of the record does: SIM and SIM-DELAY take the recorded one"
            )
        )
    told += [stated(f"{shown(recording.path)}: {note}", "notes") for note in recording.notes]
    return told


def _figures(run: str, found: Alignment, stated_step: float, dt_s: float, count: int) -> dict[str, ArrayLike]:
    """Return the metrics of an alignment by path."""
    return {
        f"{run}.recording_start_s": -found.offset / found.step * stated_step * dt_s,
        f"{run}.recording_start_error_s": (0.0 if found.as_stated else found.offset_error) * dt_s,
        f"{run}.recording_clock_fast": stated_step / found.step - 1.0,
        f"{run}.recording_clock_error": 0.0 if found.as_stated else found.step_error,
        f"{run}.recording_ground_gain": found.gain,
        f"{run}.recording_ground_left": found.residual,
        f"{run}.recording_interpolated": float(found.whole(count) is None),
    }
