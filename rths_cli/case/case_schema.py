"""Every key of a case file with its type, default, range and description; `Case`, the checked case."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WithJsonSchema,
    WrapValidator,
    field_validator,
)
from pydantic_core import InitErrorDetails

from rths_cli.case.compensator_schema import CompensatorSpec, compensator_kinds
from rths_cli.case.field_types import Problem, Range, Strict, count, entry, listed, number, refusal, same_length, shown
from rths_cli.case.real_rig_overrides import REAL_DEFAULTS, STRICTER
from rths_cli.case.record_schema import RecordSpec
from rths_cli.case.recorded_run_schema import RECORDED_RUNS, RecordedRunSpec, recorded_problems
from rths_cli.case.reference_schema import ReferenceSpec
from rths_cli.case.rig_capabilities import DEFAULT_KIND, Capabilities, capabilities_of
from rths_cli.case.rig_schema import DEFAULT_LOST_SAMPLES, AnyRig, LimitOverrides, LimitsSpec, UdpRigSpec
from rths_cli.case.structure_schema import DampingSpec, ScaleSpec, StructureSpec
from rths_cli.numerics.bands import COMPARED_HZ, TEST_BAND_HZ

Run = Literal["sim", "sim_delay", "shake_table", "exp_rths"]
RUNS: tuple[Run, ...] = ("sim", "sim_delay", "shake_table", "exp_rths")
ACCEPT_PATH = r"^([a-z][a-z0-9_]*)(?:\.[a-z][a-z0-9_]*)+(?:\[([1-9][0-9]{0,3})\])?$"
SEED_MAX = 2**53 - 1
TEST_BAND_RANGE = Range(ge=2, le=1000)  # below, one excitation has too few lines for a model
LEAST_COMPARED = 8.0  # ends of the compared band, upper over lower: its parts need that
ANSWER_SHARE = 0.7  # of a sample interval, how long an answer may take


def check_file_name(name: str) -> str:
    """Return a name that is usable as a file's name on any system; raise the sentence when it is not."""
    if not re.fullmatch(r"(?![.\s])[^/\\\x00-\x1f\x7f:*?\"<>|]+(?<![.\s])", name) or len(name.encode()) > 150:
        raise refusal(
            f"must be usable as a file name, got {name[:40]!r}; "
            "use letters, digits, _ and -, at most 150 bytes, no / and no dot or space at its ends"
        )
    return name


def _underscored(name: object) -> object:
    return name.replace("-", "_") if isinstance(name, str) else name


FileName = Annotated[str, AfterValidator(check_file_name)]
Seed = Annotated[int, Range(ge=0, le=SEED_MAX)]
Band = Annotated[
    tuple[Annotated[float, Range(ge=0.05, le=500)], ...],
    Field(json_schema_extra={"minItems": 2, "maxItems": 2}),
]
ComparedEnds = Annotated[
    tuple[Annotated[float, Range(ge=0.01, le=2000)], ...],
    Field(json_schema_extra={"minItems": 2, "maxItems": 2}),
]
RunName = Annotated[
    Run,
    BeforeValidator(_underscored),
    WithJsonSchema({"enum": [*RUNS, "sim-delay", "shake-table", "exp-rths"]}),
]


class ControllerSpec(Strict):
    """Hold the table's controller: feedforward, with feedback, or the table as delivered."""

    wanted: ClassVar[str] = "a name or a mapping"

    kind: Literal["FF", "FF+FB", "none"] = Field(
        description="feedforward, feedforward and feedback, the table as delivered, or the kind of a compensator"
    )
    feedback_bandwidth_hz: Annotated[float, Range(gt=0, le=1000)] | None = Field(
        default=None, description="default, and most: two thirds of the identified band"
    )
    max_sensitivity: Annotated[float, Range(gt=1, le=10)] = Field(
        default=1.5, description="limit on the peak of |1 / (1 + loop)| of the feedback"
    )
    disturbance_hz: Band | None = Field(
        default=None,
        description="band of the error that the feedback removes; default: 1/12 of test_band_hz to all of it, lower "
        "where the loop needs it",
    )
    command_weight: Annotated[float, Range(ge=1e-3, le=10)] | None = Field(
        default=None,
        description="cost of a command, over what it moves at the disturbance's upper corner; default: 0.01, less where"
        " the loop needs it",
    )
    feedback_limit_v: Annotated[float, Range(gt=0, le=1000)] | None = Field(
        default=None, description="largest share of the feedback in the command; default: what the range leaves"
    )

    reaction_feedforward: Literal["automatic", True, False] = Field(
        default="automatic",
        description="method best: the command also counters what a specimen that yields or is damaged does to the "
        "table; judged at both ends of check.specimen_range (default: 0.5 to 1); automatic: where the check finds the "
        "test safe with it",
    )
    friction_compensation: Literal["automatic", True, False] = Field(
        default="automatic",
        description="method best: the command also counters the table's dry friction, where the identification's "
        "low-level record shows that this removes most of what the model leaves; automatic: not on rigs that need the "
        "command preview",
    )

    @property
    def inverts(self) -> bool:
        """Return whether the feedforward is the inverse of the identified table."""
        return self.kind != "none"

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        band = listed(data, "disturbance_hz")
        if band is not None and len(band) != 2:
            yield ("disturbance_hz",), f"must be the two ends of a band in Hz, such as [1, 12], got {len(band)} entries"
        elif band and all(isinstance(f, int | float) for f in band) and band[1] < 2 * band[0]:
            ends = f"{band[0]:g} to {band[1]:g} Hz"
            yield ("disturbance_hz",), f"must be a band of an octave or more, its lower end first, got {ends}"


CONTROLLERS: tuple[str, ...] = ("FF", "FF+FB", "none")


def _of_kind(data: Any, handler: ValidatorFunctionWrapHandler) -> ControllerSpec | CompensatorSpec:
    """Return the controller of checked or unchecked data; raises the faults of its kind's model alone."""
    if isinstance(data, ControllerSpec | CompensatorSpec):
        return data
    kind = entry(data, "kind")
    if isinstance(kind, str) and kind not in CONTROLLERS:
        others = compensator_kinds()
        if kind in others:
            return CompensatorSpec.model_validate(data)
        *words, last = (*CONTROLLERS, *others)
        meant = get_close_matches(kind[:80], others, n=1)
        advice = f"; did you mean {meant[0]}?" if meant else ""
        told = refusal(f"must be {', '.join(words)} or {last}, got {shown(kind)}{advice}")
        detail = InitErrorDetails(type=told, loc=("kind",), input=kind)
        raise ValidationError.from_exception_data(ControllerSpec.__name__, [detail])
    return ControllerSpec.model_validate(data)


AnyController = Annotated[ControllerSpec | CompensatorSpec, WrapValidator(_of_kind)]


class IdentificationSpec(Strict):
    """Hold the model file to use, or how to excite the rig for one."""

    model: Path | None = Field(default=None, description="a model file; without one a virtual rig is identified first")
    seed: Seed = Field(default=0, description="seed of the excitation and of the noise in its records")
    duration_s: Annotated[float, Range(ge=40, le=7200)] = Field(default=120.0, description="length of one excitation")
    accel_rms_m_s2: Annotated[float, Range(gt=0, le=100)] = Field(
        default=2.0, description="RMS acceleration of the table that is aimed at; lowered near a limit"
    )
    compared_hz: ComparedEnds = Field(
        default=COMPARED_HZ,
        description="band in which a model is compared with its data and must keep its limits, three octaves or more; "
        "default: 7/120 to 11/12 of test_band_hz. The fits, the excitation's spectrum and the check follow it",
    )
    low_hz: Annotated[float, Range(ge=0.001, le=1000)] = Field(
        default=0.3, description="lower end of the excited band; default: 1/40 of test_band_hz"
    )
    high_hz: Annotated[float, Range(gt=0, le=5000)] = Field(
        default=60.0, description="upper end of the excited band; default: 5 times test_band_hz"
    )
    excitation: Literal["noise", "multisine", "sweep", "step"] = Field(
        default="noise", description="kind of the excitation"
    )
    period_s: Annotated[float, Range(gt=0, le=1000)] | None = Field(
        default=None, description="default: 20 for a multisine, 40 for a sweep"
    )
    records: Annotated[int, Range(ge=1, le=20)] = Field(default=1, description="how many are measured and averaged")
    estimator: Literal["h1", "h2", "hv"] = Field(
        default="h1",
        description="estimator of the frequency response: noise in the samples (h1), the command (h2) or both (hv)",
    )
    sensor_dynamics: Literal["removed", "kept"] = Field(
        default="removed", description="kept: the model describes the channels as they are, and the step leaves them so"
    )
    latency: Literal["removed", "kept"] = Field(
        default="removed", description="removed: an explicit, declared delay; kept: the model's roots carry it"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        low = data.get("low_hz", cls.model_fields["low_hz"].default)
        high = data.get("high_hz", cls.model_fields["high_hz"].default)
        if isinstance(low, int | float) and isinstance(high, int | float) and high <= low:
            yield (
                ("high_hz" if "high_hz" in data else "low_hz",),
                f"low_hz = {low:g} must be < high_hz = {high:g}",
            )
        yield from _compared_problems(listed(data, "compared_hz"))


def _compared_problems(band: Sequence[Any] | None) -> Iterator[Problem]:
    """Yield a fault of a compared band that is none, is reversed, or is too narrow for its parts."""
    if band is None:
        return
    if len(band) != 2:
        entries = f"got {len(band)} entries"
        yield ("compared_hz",), f"must be the two ends of a band in Hz, such as [0.7, 11], {entries}"
    elif all(isinstance(f, int | float) for f in band) and band[1] < LEAST_COMPARED * band[0]:
        ends = f"{band[0]:g} to {band[1]:g} Hz"
        yield ("compared_hz",), f"must be a band of three octaves or more, its lower end first, got {ends}"


class RecordFilterSpec(Strict):
    """Hold the causal Butterworth high pass of the record; corner 0 switches it off."""

    corner_hz: Annotated[float, Range(ge=0, le=100)] = Field(default=0.25, description="corner; 0: no filter")
    order: Annotated[int, Range(ge=1, le=8)] = Field(default=2, description="number of poles")


class KalmanSpec(Strict):
    """Hold the intensities of process noise (base acceleration) and measurement noise of the floor filter, and up to
    which frequency method best takes what the filter leaves unexplained from the measured base shear."""

    q: Annotated[float, Range(gt=0, le=1e12)] = Field(
        default=1e3, description="intensity of process noise, which enters like the table's acceleration"
    )
    r: Annotated[float, Range(gt=0, le=1e12)] = Field(
        default=1.0, description="intensity of measurement noise on each floor; only q / r matters"
    )
    residual_hz: Annotated[float, Range(gt=0, le=1000)] = Field(
        default=40.0,
        description="corner up to which method best takes what the filter leaves unexplained from the measured base "
        "shear; default: 10/3 of test_band_hz",
    )
    choice: Literal["automatic", "stated"] = Field(
        default="automatic",
        description="automatic: where noise and rounding of the samples would be most of the error, the check chooses "
        "a smaller q and residual_hz; stated: these values; default: stated where q or residual_hz is stated",
    )


class GradeLimitsSpec(Strict):
    """Hold the largest 95 % bounds of the true error of a good and of a usable hybrid test, of its worst storey."""

    good_percent: Annotated[float, Range(gt=0, le=100)] = Field(
        default=2.0, description="95 % bound of the true error in percent of SIM's RMS, of a good test"
    )
    good_ratio: Annotated[float, Range(gt=0, le=1)] = Field(
        default=0.1,
        description="true error over SIM-DELAY's, of a compensation that is worth it; no part of the grade",
    )
    usable_percent: Annotated[float, Range(gt=0, le=100)] = Field(
        default=5.0, description="95 % bound of the true error in percent of SIM's RMS, of a usable test"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        good, usable = (data.get(key, cls.model_fields[key].default) for key in ("good_percent", "usable_percent"))
        if isinstance(good, int | float) and isinstance(usable, int | float) and usable < good:
            yield (
                ("usable_percent" if "usable_percent" in data else "good_percent",),
                (f"good_percent = {good:g} must be <= usable_percent = {usable:g}"),
            )


class CheckSpec(Strict):
    """Hold what the check is to consider beside what was identified."""

    specimen_range: (
        Annotated[
            tuple[Annotated[float, Range(ge=0.01, le=10)], ...],
            Field(json_schema_extra={"minItems": 2, "maxItems": 2}),
        ]
        | None
    ) = Field(
        default=None,
        description="least and greatest stiffness of the specimen over the identified one, such as [0.7, 1.0]: the "
        "linear loop is judged at both; default: the identified one",
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        ends = listed(data, "specimen_range")
        if ends is None:
            return
        if len(ends) != 2:
            told = f"must be the least and the greatest stiffness, such as [0.7, 1.0], got {len(ends)} entries"
            yield ("specimen_range",), told
        elif all(isinstance(one, int | float) for one in ends) and not ends[0] <= 1.0 <= ends[1]:
            told = f"must contain 1, the identified stiffness, its lower end first, got {ends[0]:g} to {ends[1]:g}"
            yield ("specimen_range",), told


class CaseKeys(Strict):
    """Hold the keys of a case file; names are replaced by what they name before this is checked."""

    name: FileName = Field(description="default: the file's name")
    structure: StructureSpec = Field(description="the building: masses, stiffness, damping, and where it is cut")
    damping: DampingSpec = Field(
        description="damping of the numerical storeys: a level that the structure defines, or as below"
    )
    record: RecordSpec = Field(description="the ground motion")
    scaling: Annotated[float, Range(gt=0, le=100)] = Field(description="factor on the record")
    scale: ScaleSpec | None = Field(
        default=None,
        description="scale of the model, prototype over model. The structure is the model as it stands in the "
        "laboratory, the record is the prototype's and is compressed; default: the record is the model's",
    )
    report_in: Literal["model", "prototype"] = Field(
        default="model",
        description="in which scale reports print the building's response; result files hold the model's",
    )
    controller: AnyController = Field(description="controller of the table")
    table: AnyRig = Field(description="the rig; default: aps400_virtual")
    method: Literal["best", "paper"] = Field(
        default="best", description="the control: best is ours, paper that of the paper as printed"
    )
    shear_from: Literal["accelerations", "load_cell", "both"] | None = Field(
        default=None,
        description="what the measured base shear is taken from; default: both where the rig has a load cell with "
        "use: shear, weighted by their uncertainties, else accelerations",
    )
    session_record: Literal["automatic", "always", "never"] = Field(
        default="automatic",
        description="whether the table runs begin with the identification's record at low level, which shows what "
        "sensors and converters have changed by since; automatic: on a rig whose sensitivities, AC corners, instants "
        "or masses are uncertain, which is every one that does not state that they are not",
    )
    integration: Literal["exact", "cr", "newmark"] = Field(
        default="exact",
        description="integration of the numerical storeys: first-order hold, Chen-Ricles, or explicit Newmark",
    )
    runs: tuple[RunName, ...] = Field(
        default=RUNS,
        min_length=1,
        description="default: all; on a rig that is not virtual all but shake_table; with a recording those that it is "
        "of, and SIM and SIM-DELAY",
    )
    exp_rths: RecordedRunSpec | None = Field(
        default=None, description="the EXP-RTHS was made elsewhere: its recording is judged, and nothing moves"
    )
    shake_table: RecordedRunSpec | None = Field(default=None, description="the same of the shake-table test")
    sample_rate_hz: Annotated[float, Range(ge=100, le=50_000)] = Field(
        default=2000.0, description="sample rate of the step, and of every series in the result"
    )
    test_band_hz: Annotated[float, TEST_BAND_RANGE] = Field(
        default=TEST_BAND_HZ,
        description="corner of the low pass with which errors are judged; the other bands follow it where they are not "
        "stated: compared_hz, low_hz, high_hz, disturbance_hz, residual_hz",
    )
    delay_s: Annotated[float, Range(ge=0, le=0.1)] = Field(default=0.005, description="the delay of SIM-DELAY")
    record_filter: RecordFilterSpec = Field(
        default=RecordFilterSpec(), description="Butterworth high pass of the scaled record, causal"
    )
    identification: IdentificationSpec = Field(
        default=IdentificationSpec(), description="the model file to use, or how to excite the rig for one"
    )
    kalman: KalmanSpec = Field(default=KalmanSpec(), description="the filter that estimates the floors")
    limits: LimitOverrides = Field(default=LimitOverrides(), description="limits stricter than the rig's")
    accept: dict[str, Annotated[float, Range(ge=0, le=1e9)]] = Field(
        default={},
        description="limits on reported figures, by path: exp_rths.rms_error_m_s2[3]",
        json_schema_extra={"propertyNames": {"pattern": ACCEPT_PATH}},
    )
    check: CheckSpec | None = Field(
        default=None, description="what the check is to consider beside what was identified"
    )
    base_shear_uncertainty: Annotated[float, Range(ge=0, le=0.5)] = Field(
        default=0.01,
        description="relative standard uncertainty of the base shear, from the calibration of the accelerometers and "
        "the weighing of the floors: the residual drift of storeys with laws is stated with what it makes of it",
    )
    grade_limits: GradeLimitsSpec = Field(
        default=GradeLimitsSpec(),
        description="from which bounds of the true error on a test is no longer called good, or usable",
    )
    plausible: tuple[Annotated[str, Field(min_length=1, max_length=100)], ...] | None = Field(
        default=None,
        max_length=100,
        description="keys whose doubted numbers are right, by path (table.limits.force_n): the doubt is no longer "
        "told, and a real rig moves",
    )
    seed: Seed = Field(default=0, description="seed of the noise in the runs")
    notes: str = Field(default="", description="any text; it goes into the result")
    reference: ReferenceSpec | None = Field(default=None, description="published figures to print beside ours")

    @field_validator("runs")
    @classmethod
    def _in_order(cls, runs: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(runs)) < len(runs):
            raise refusal("names a run twice; keep one of each")
        return tuple(run for run in RUNS if run in runs)

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        damping, levels = data.get("damping"), entry(data, "structure", "damping_levels")
        is_level = isinstance(levels, Mapping) and entry(damping, "name") in list(levels)
        if isinstance(damping, Mapping) and not is_level:
            storeys = count(data, "structure", "numerical", "masses_kg")
            for loc, message in same_length(damping, "dashpots_n_s_per_m", storeys, "numerical storey"):
                yield ("damping", *loc), message
        yield from _limit_problems(data)
        yield from _compensator_problems(data)
        yield from _rig_problems(data)
        yield from _nyquist_problems(data)
        yield from _accept_problems(data)
        yield from recorded_problems(data)


REPR_COLUMNS = 100


class Case(CaseKeys):
    """Hold a checked case, defaults filled in; `limits` are already merged into `table.limits`.

    `rig_file`: the file that states the kind of rig, None where the case itself or --set does. `rig_limits`: the limits
    as the rig states them, before those of the case. `stated`: the keys that
    the case file or --set state, as paths (`controller.command_weight`). `places`: where each key of the case stands,
    by its path: in which file, or in which --set.
    """

    path: Path
    yaml_text: str
    rig_file: Path | None = Field(default=None, exclude=True)
    rig_limits: LimitsSpec | None = Field(default=None, exclude=True)
    stated: tuple[str, ...] = Field(default=(), exclude=True)
    places: Mapping[str, Any] = Field(default_factory=dict, exclude=True, repr=False)

    def __repr__(self) -> str:
        """Return the case on one screen: what is tested, on which table, and which keys it states; a line each."""
        own = len(self.structure.numerical.masses_kg)
        lines = {
            "structure": f"{self.structure.name}: {self.n_storeys} storeys, the lowest {own} computed",
            "damping": self.damping.name or "inline",
            "record": f"{self.record.name} times {self.scaling:g}",
            "controller": f"{self.controller.kind}, method {self.method}",
            "table": f"{self.table.name} ({self.table.kind})",
            "step": f"{self.sample_rate_hz:g} Hz, errors judged up to {self.test_band_hz:g} Hz",
            "runs": ", ".join(self.runs),
            "accept": ", ".join(f"{path} {limit:g}" for path, limit in self.accept.items()),
            "states": ", ".join(dict.fromkeys(key.partition(".")[0] for key in self.stated)),
        }
        told = (f"  {name:<10}  {text}"[:REPR_COLUMNS] for name, text in lines.items() if text)
        return "\n".join([f"case {self.name}", *told])

    __str__ = __repr__

    @property
    def n_storeys(self) -> int:
        """Return the number of storeys of the total structure; of a frame whose matrices are not read, of the table."""
        above = 0 if self.structure.experimental.attached else len(self.structure.experimental.masses_kg)
        return len(self.structure.numerical.masses_kg) + above

    @property
    def recorded(self) -> dict[str, RecordedRunSpec]:
        """Return the recordings of the runs that were made elsewhere, by run; then nothing moves."""
        found = ((run, getattr(self, run)) for run in RECORDED_RUNS)
        return {run: spec for run, spec in found if spec is not None}

    def published(self) -> dict[str, float | tuple[float, ...]]:
        """Return the reference's figures for this case by metric path, empty when there are none."""
        if self.reference is None:
            return {}
        return self.reference.figures_for(self.record.name, self.damping.name, self.controller.kind, self.scaling)


def _capabilities(data: Mapping[str, Any]) -> Capabilities:
    """Return what the rig of a case can do."""
    kind = entry(data, "table", "kind")
    return capabilities_of(DEFAULT_KIND if kind is None else kind)


def _limit_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault for each limit that is looser than the rig's."""
    unstated = {key: field.default for key, field in LimitsSpec.model_fields.items()}
    unstated |= {"lost_samples": DEFAULT_LOST_SAMPLES}
    unstated |= REAL_DEFAULTS if _capabilities(data).moves_hardware else {}
    for key, default in unstated.items():
        own, rig = number(data, "limits", key), number(data, "table", "limits", key)
        limit = default if rig is None else rig
        if own is not None and limit is not None and own > limit:
            yield ("limits", key), f"must be <= the rig's {limit:g}, got {own:g}; {STRICTER}"


def _compensator_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault for a compensator with the control of the paper, which has its own two controllers."""
    kind = entry(data, "controller", "kind")
    if data.get("method") == "paper" and isinstance(kind, str) and kind in compensator_kinds():
        yield ("method",), f"paper takes the controllers FF, FF+FB and none, got {kind}; remove method: paper"


def _rig_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield faults of a real rig with this structure and sample rate: channels, answers that are late or lost."""
    floors, channels = count(data, "structure", "experimental", "masses_kg"), listed(data, "table", "channels") or ()
    attached = entry(data, "structure", "experimental", "kind") == "attached"
    if attached != (entry(data, "table", "interface") is not None):
        told = (
            "shakes a table, and the structure's specimen is attached to its interface floor; name a rig whose file "
            "has interface: {command: displacement, feedback: force}, such as servo_hydraulic"
            if attached
            else "moves an attached specimen, and storeys of the structure stand on a table; state "
            "experimental: {kind: attached, ...}, or name a rig that shakes a table"
        )
        yield ("table",), told
    own = sum(entry(one, "kind") is None for one in channels)
    if floors is not None and own not in (0, 1 + floors):
        wanted = f"the table's and one per experimental storey, {1 + floors} in all"
        yield ("table", "channels"), f"must be {wanted}, got {own}; list the channels of this structure"
    yield from _further_channel_problems(data, channels)
    laws = entry(data, "table", "physics", "specimen_laws")
    stated = 1 if isinstance(laws, Mapping) else len(laws) if isinstance(laws, list | tuple) else 0
    if floors is not None and stated not in (0, floors):
        loc, wanted = (
            ("table", "physics", "specimen_laws"),
            f"must have an entry for each of {floors} storeys on the table",
        )
        yield loc, f"{wanted}, got {stated}; state null for a storey without a law"
    rate, timeout_s = number(data, "sample_rate_hz"), number(data, "table", "udp", "timeout_s")
    interval_s = 1.0 / (rate or CaseKeys.model_fields["sample_rate_hz"].default)
    if timeout_s is not None and timeout_s > ANSWER_SHARE * interval_s:
        longest = f"{ANSWER_SHARE * interval_s:g}, {ANSWER_SHARE:g} of the sample interval"
        yield ("table", "udp", "timeout_s"), f"must be <= {longest}, got {timeout_s:g}; the step needs the rest"
    yield from _watchdog_problems(data, interval_s)


def _further_channel_problems(data: Mapping[str, Any], channels: Sequence[Any]) -> Iterator[Problem]:
    """Yield a fault for each further channel at a place that this structure has not on the table, and for a second
    load cell of the base shear, or none."""
    numerical = count(data, "structure", "numerical", "masses_kg")
    experimental = count(data, "structure", "experimental", "masses_kg")
    cells = 0
    for i, channel in enumerate(channels):
        place, uses = entry(channel, "position"), entry(channel, "use")
        cells += "shear" in ([uses] if isinstance(uses, str) else uses or ())
        found = re.fullmatch(r"(floor|storey)_([1-9][0-9]{0,3})", place) if isinstance(place, str) else None
        if found is None or numerical is None or experimental is None:
            continue
        if not numerical < int(found[2]) <= numerical + experimental:
            what, first, last = found[1], numerical + 1, numerical + experimental
            known = f"{what}_{first}" if first == last else f"{what}_{first} to {what}_{last}"
            yield ("table", "channels", i, "position"), f"must be on the table, which carries {known}, got {place}"
    if cells > 1:
        yield ("table", "channels"), f"{cells} load cells with use: shear; the base shear takes one"
    shear = data.get("shear_from")
    if cells == 0 and shear in ("load_cell", "both"):
        told = "the rig has no channel with use: shear; add one to its file, or state accelerations"
        yield ("shear_from",), f"{shear} needs a load cell, but {told}"


def _watchdog_problems(data: Mapping[str, Any], interval_s: float) -> Iterator[Problem]:
    """Yield a fault where a rig would rest its table over a loss that the runner bears."""
    if not _capabilities(data).has_watchdog:
        return
    stated = number(data, "limits", "lost_samples") or number(data, "table", "limits", "lost_samples")
    lost = round(stated or DEFAULT_LOST_SAMPLES)
    watchdog_s = number(data, "table", "watchdog_s") or UdpRigSpec.model_fields["watchdog_s"].default
    if 0.0 < watchdog_s <= (lost + 1) * interval_s:
        told = f"what the {lost} samples last that may be lost in a row (limits.lost_samples), and one more"
        advice = "the rig would rest its table first; lower lost_samples, or raise watchdog_s in the rig's file"
        yield ("table", "watchdog_s"), f"must be > {(lost + 1) * interval_s:g}, {told}, got {watchdog_s:g}; {advice}"


def _nyquist_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault for each stated frequency that the sample rate cannot carry."""
    rate = number(data, "sample_rate_hz") or CaseKeys.model_fields["sample_rate_hz"].default
    places = (
        ("test_band_hz",),
        ("record_filter", "corner_hz"),
        ("identification", "high_hz"),
        ("controller", "feedback_bandwidth_hz"),
        ("kalman", "residual_hz"),
    )
    for loc in places:
        value = number(data, *loc)
        refused = loc == ("test_band_hz",) and value is not None and not TEST_BAND_RANGE.holds(value)
        if value is not None and value >= rate / 2 and not refused:
            yield loc, f"must be < {rate / 2:g}, half the sample rate, got {value:g}"
    for place in (("controller", "disturbance_hz"), ("identification", "compared_hz")):
        band = listed(data, *place) or ()
        highest = max((f for f in band if isinstance(f, int | float)), default=0.0)
        if highest >= rate / 2:
            yield place, f"must be < {rate / 2:g}, half the sample rate, got {highest:g}"
    default = IdentificationSpec.model_fields["high_hz"].default
    if number(data, "identification", "high_hz") is None and rate / 2 <= default:
        yield ("sample_rate_hz",), f"must be > {2 * default:g}, twice identification.high_hz, got {rate:g}"


def _accept_problems(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield a fault for each accepted figure that cannot be reported."""
    paths, runs = data.get("accept"), data.get("runs")
    numerical = count(data, "structure", "numerical", "masses_kg")
    experimental = count(data, "structure", "experimental", "masses_kg")
    storeys = None if numerical is None or experimental is None else numerical + experimental
    for path in paths if isinstance(paths, Mapping) else ():
        match = re.match(ACCEPT_PATH, path)
        if match is None:
            yield ("accept", path), "must be a figure's path such as exp_rths.rms_error_m_s2[3]"
            continue
        group, storey = match[1], match[2]
        if group in RUNS and storey is not None and storeys is not None and int(storey) > storeys:
            yield ("accept", path), f"storey must be <= {storeys}, the structure's storeys, got {storey}"
        if isinstance(runs, tuple) and group in RUNS and group not in [_underscored(run) for run in runs]:
            yield ("accept", path), f"needs the run {group}; add it to runs"
