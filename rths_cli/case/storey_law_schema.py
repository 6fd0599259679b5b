"""Every key of a storey's law (`numerical.law` of a structure file)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails

from rths_cli.case.field_types import Problem, Range, Strict, exactly_one, near, number, refusal, shown
from rths_cli.errors import InputError

Drift = Annotated[float, Range(gt=0, le=100)]
Hardening = Annotated[float, Range(ge=0, le=1)]
Share = Annotated[float, Range(ge=0, le=100)]
KIND = "which law it is"
YIELD = "drift at which it yields"
ROUNDING = 1e-9
HARDENING = "stiffness beyond yielding over that of the storey; 1: it never yields"


class StoreyLaw(Strict):
    """Hold a law of a storey; `kind` decides which keys there are."""

    wanted: ClassVar[str] = "a law such as {kind: cubic, ...}, a list of laws, or nothing"

    kind: str = Field(description="what the law is; decides which keys there are")


class BilinearLaw(StoreyLaw):
    """Hold a spring that yields, with kinematic hardening."""

    kind: Literal["bilinear"] = Field(description=KIND)
    yield_displacement_m: Drift = Field(description=YIELD)
    hardening: Hardening = Field(default=0.0, description=HARDENING)


class CloughLaw(StoreyLaw):
    """Hold a spring that yields and reloads towards its largest drift so far."""

    kind: Literal["clough"] = Field(description=KIND)
    yield_displacement_m: Drift = Field(description=YIELD)
    hardening: Hardening = Field(default=0.0, description=HARDENING)
    unloading_exponent: Annotated[float, Range(ge=0, le=0.5)] = Field(
        default=0.0, description="the stiffness of unloading falls with (yield drift / largest drift)^exponent"
    )


class BoucWenLaw(StoreyLaw):
    """Hold a smooth hysteresis of Bouc and Wen, with degradation and pinching (Baber, Wen and Noori)."""

    kind: Literal["bouc_wen"] = Field(description=KIND)
    yield_displacement_m: Drift = Field(description=f"{YIELD}: the largest z for beta + gamma = 1")
    hardening: Hardening = Field(default=0.0, description=HARDENING)
    exponent: Annotated[float, Range(ge=1, le=20)] = Field(default=1.0, description="n, sharpness of yielding")
    beta: Annotated[float, Range(ge=0, le=10)] = Field(default=0.5, description="shape: of abs(du) z in the rate of z")
    gamma: Annotated[float, Range(ge=-10, le=10)] = Field(
        default=0.5, description="shape: weight of du abs(z) in the rate of z; > -beta"
    )
    delta_a: Annotated[float, Range(ge=0, le=1)] = Field(default=0.0, description="fall of A with dissipated energy")
    delta_nu: Share = Field(default=0.0, description="fall of the strength with dissipated energy")
    delta_eta: Share = Field(default=0.0, description="fall of the stiffness with dissipated energy")
    zeta_s: Annotated[float, Range(ge=0, lt=1)] = Field(default=0.0, description="greatest pinching; 0: none")
    p: Share = Field(default=1.0, description="how fast pinching comes with dissipated energy")
    q: Annotated[float, Range(ge=0, le=1)] = Field(default=0.0, description="where it pinches, of the strength")
    psi: Annotated[float, Range(gt=0, le=10)] = Field(default=0.1, description="width of pinching")
    delta_psi: Share = Field(default=0.0, description="growth of the width with dissipated energy")
    lambda_: Annotated[float, Range(ge=0, le=10)] = Field(
        default=0.5, alias="lambda", description="how width and depth of pinching go together"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        beta, gamma = number(data, "beta"), number(data, "gamma")
        beta, gamma = 0.5 if beta is None else beta, 0.5 if gamma is None else gamma
        if not beta + gamma > 0.0:
            yield ("gamma",), f"must be > -beta = {-beta:g}, otherwise the force has no bound; got {gamma:g}"
        if (number(data, "zeta_s") or 0.0) > 0.0 and number(data, "lambda") == 0.0:
            yield ("lambda",), "must be > 0 with zeta_s > 0, otherwise the pinching has no width at first; got 0"


class ElasticGapLaw(StoreyLaw):
    """Hold a spring that is touched beyond a gap, to both sides."""

    kind: Literal["elastic_gap"] = Field(description=KIND)
    gap_m: Annotated[float, Range(ge=0, le=100)] = Field(description="drift at which the spring is touched")
    contact_n_per_m: Annotated[float, Range(ge=0, le=1e12)] = Field(description="stiffness of the spring")


class FrictionLaw(StoreyLaw):
    """Hold Coulomb friction, or a friction pendulum."""

    kind: Literal["friction"] = Field(description=KIND)
    force_n: Annotated[float, Range(ge=0, le=1e9)] | None = Field(default=None, description="limit of the friction")
    coefficient: Annotated[float, Range(ge=0, le=10)] | None = Field(
        default=None, description="instead of force_n: limit over the weight of all floors above the storey"
    )
    sticking_displacement_m: Drift = Field(
        default=5e-5, description="drift of the spring by which it sticks until it slides"
    )
    radius_m: Annotated[float, Range(gt=0, le=1e4)] | None = Field(
        default=None, description="of a pendulum: a spring of the weight above over the radius stands beside"
    )

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from exactly_one(data, "force_n", "coefficient")


class ViscousPowerLaw(StoreyLaw):
    """Hold a damper whose force is a power of the velocity."""

    kind: Literal["viscous_power"] = Field(description=KIND)
    coefficient: Annotated[float, Range(ge=0, le=1e12)] = Field(description="force at 1 m/s, in N (s/m)^exponent")
    exponent: Annotated[float, Range(gt=0, le=3)] = Field(description="power of the velocity; 1: a dashpot")
    linear_below_m_per_s: Annotated[float, Range(gt=0, le=1)] = Field(
        default=1e-5, description="below it the force is a straight line to zero"
    )


class MaxwellLaw(StoreyLaw):
    """Hold a spring and a dashpot in series."""

    kind: Literal["maxwell"] = Field(description=KIND)
    spring_n_per_m: Annotated[float, Range(gt=0, le=1e12)] = Field(description="stiffness of the spring")
    dashpot_n_s_per_m: Annotated[float, Range(gt=0, le=1e12)] = Field(description="of the dashpot behind it")


class CubicLaw(StoreyLaw):
    """Hold a force that grows with the third power of the drift; negative: it softens."""

    kind: Literal["cubic"] = Field(description=KIND)
    cubic_n_per_m3: Annotated[float, Range(ge=-1e18, le=1e18)] = Field(description="force over drift^3")
    largest_drift_m: Drift = Field(description="up to which it holds; stability is judged up to there")


class SofteningLaw(StoreyLaw):
    """Hold a spring that loses a share of its stiffness as the drift grows."""

    kind: Literal["softening"] = Field(description=KIND)
    share: Annotated[float, Range(ge=0, lt=1)] = Field(
        description="of the storey's stiffness that is lost at large drifts"
    )
    half_drift_m: Drift = Field(default=0.001, description="drift at which half of it is lost")


class OwnLaw(StoreyLaw):
    """Hold a law of the user's own: a function in a Python file, or of an installed package. It is run."""

    kind: Literal["own"] = Field(description=KIND)
    file: Path | None = Field(
        default=None, description="the Python file of the law, relative to the file that names it; its code is run"
    )
    sha256: str | None = Field(
        default=None,
        description="checksum of that file; default: as it is found. A file with another one is not run",
        json_schema_extra={"pattern": "^[0-9a-f]{64}$"},
    )
    installed: Annotated[str, Field(min_length=1, max_length=100)] | None = Field(
        default=None, description="instead of file: the name of an entry point of the group rths.laws"
    )
    parameters: dict[str, float] = Field(default={}, description="its numbers, by the names in its PARAMETERS")
    largest_drift_m: Drift = Field(description="up to which it holds; it is tried up to there")

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        yield from exactly_one(data, "file", "installed")
        if data.get("sha256") is not None and data.get("file") is None:
            yield ("sha256",), "is the checksum of file, which is not given; remove it"


KINDS: dict[str, type[StoreyLaw]] = {
    "bilinear": BilinearLaw,
    "bouc_wen": BoucWenLaw,
    "clough": CloughLaw,
    "elastic_gap": ElasticGapLaw,
    "friction": FrictionLaw,
    "viscous_power": ViscousPowerLaw,
    "maxwell": MaxwellLaw,
    "cubic": CubicLaw,
    "softening": SofteningLaw,
    "own": OwnLaw,
}


def _of_kind(data: Any, handler: ValidatorFunctionWrapHandler) -> StoreyLaw:
    """Return the law of checked or unchecked data; raises the faults of its kind's model alone."""
    if isinstance(data, StoreyLaw):
        return data
    if not isinstance(data, Mapping):
        raise refusal(f"must be {StoreyLaw.wanted}, got {shown(data)}")
    kind = data.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        told = "kind is missing; add it" if kind is None else f"no law is called {shown(kind)}{near(str(kind), KINDS)}"
        detail = InitErrorDetails(type=refusal(told), loc=("kind",) if kind is not None else (), input=kind)
        raise ValidationError.from_exception_data(StoreyLaw.__name__, [detail])
    return KINDS[kind].model_validate(data)


def _by_storey(data: Any) -> Any:
    """Return laws as a list with an entry per storey, each a list of laws: one law alone is that of the only storey."""
    if isinstance(data, Mapping | StoreyLaw):
        data = (data,)
    if not isinstance(data, list | tuple):
        raise refusal(
            f"must be a law such as {{kind: cubic, ...}}, or a list with an entry per storey, got {shown(data)}"
        )
    return tuple(() if one is None else tuple(one) if isinstance(one, list | tuple) else (one,) for one in data)


def _share_taken(law: StoreyLaw) -> float:
    """Return the share of the storey's own stiffness that a law takes away when it yields."""
    if isinstance(law, BilinearLaw | BoucWenLaw):
        return 1.0 - law.hardening
    if isinstance(law, CloughLaw):
        return 1.0 if law.hardening < 1.0 else 0.0
    return law.share if isinstance(law, SofteningLaw) else 0.0


def _one_spring(laws: tuple[StoreyLaw, ...]) -> tuple[StoreyLaw, ...]:
    """Refuse laws of one storey that together take more stiffness away than its spring has."""
    taking = [law for law in laws if _share_taken(law) > 0.0]
    taken = sum(map(_share_taken, taking))
    if taken > 1.0 + ROUNDING:
        kinds = " and ".join(law.kind for law in taking)
        remedy = "keep one of them, or lower their shares, 1 - hardening or share, until they add up to 1 at most"
        if any(isinstance(law, CloughLaw) for law in taking):
            remedy = "keep one of them; clough may lose all of the stiffness by itself, whatever its hardening"
        raise refusal(
            f"{kinds} take {taken:.4g} times the storey's stiffness away when they yield, as each describes the "
            f"storey's own spring: {remedy}"
        )
    return laws


class _AsWritten:
    """Describes laws in JSON Schema as a file may state them: a law, or per storey a law, a list of laws or null."""

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        law = handler(core)["items"]["items"]
        per_storey = [*law["anyOf"], {"type": "array", "items": law}, {"type": "null"}]
        return {"anyOf": [*law["anyOf"], {"type": "array", "items": {"anyOf": per_storey}}]}


AnyLaw = Annotated[
    BilinearLaw
    | BoucWenLaw
    | CloughLaw
    | ElasticGapLaw
    | FrictionLaw
    | ViscousPowerLaw
    | MaxwellLaw
    | CubicLaw
    | SofteningLaw
    | OwnLaw,
    WrapValidator(_of_kind),
]
LawsOfStorey = Annotated[tuple[AnyLaw, ...], AfterValidator(_one_spring)]
StoreyLaws = Annotated[tuple[LawsOfStorey, ...], BeforeValidator(_by_storey), _AsWritten]
"""Laws storey by storey from the ground, several of a storey in parallel."""


def checked_laws(data: object) -> StoreyLaws:
    """Return laws as a structure file may state them, checked; raises InputError with the first fault."""
    try:
        return TypeAdapter(StoreyLaws).validate_python(data)
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from error
