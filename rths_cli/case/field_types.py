"""What all schemas share: ranges, strictness, and the sentence for every kind of wrong value or unknown key."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import CoreSchema, ErrorDetails, InitErrorDetails, PydanticCustomError, core_schema

LEAST_PART = 4  # characters of a name that another one contains
MISSING = {
    "kind": "is missing; add extends: NAME of the rig that it varies, or the kind of a rig of its own",
    "experimental": "is missing; add experimental: masses_kg, stiffness_n_per_m and damping_ratios of the storeys on "
    "the table",
    "numerical": "is missing; add numerical: masses_kg and stiffness_n_per_m of the computed storeys",
}
"""What to say of a key that is missing, where adding the key alone would not help."""

Problem = tuple[tuple[str | int, ...], str]
"""A fault found by comparing keys: location below the model, sentence."""


@dataclass(frozen=True)
class Range:
    """Annotation of a number: its physical range, for the check, its sentence and the JSON Schema."""

    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    or_zero: bool = False

    def holds(self, value: float) -> bool:
        """Return whether the value lies in the range (NaN never does)."""
        if self.or_zero and value == 0:
            return True
        return (
            (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.lt is None or value < self.lt)
            and (self.le is None or value <= self.le)
        )

    def __str__(self) -> str:
        signs = (("> ", self.gt), (">= ", self.ge), ("< ", self.lt), ("<= ", self.le))
        text = " and ".join(f"{sign}{limit:g}" for sign, limit in signs if limit is not None)
        return f"0 (off) or {text}" if self.or_zero else text

    def check(self, value: float) -> float:
        """Return the value; raise the sentence when it lies outside."""
        if not self.holds(value):
            raise refusal(f"must be {self}, got {value:.10g}")
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.check, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        limits = {
            "exclusiveMinimum": self.gt,
            "minimum": self.ge,
            "exclusiveMaximum": self.lt,
            "maximum": self.le,
        }
        number = dict(handler(schema)) | {key: limit for key, limit in limits.items() if limit is not None}
        return {"anyOf": [{"const": 0}, number]} if self.or_zero else number


class Strict(BaseModel):
    """Frozen data that refuses unknown keys and wrong types, and reports all of its faults at once."""

    model_config = ConfigDict(
        strict=True,
        defer_build=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        validate_default=True,
        protected_namespaces=(),
    )
    wanted: ClassVar[str] = "a mapping"
    elsewhere: ClassVar[Mapping[str, str]] = {}
    """Keys that belong to other models, each with the end of its sentence."""

    @classmethod
    def problems(cls, data: Mapping[str, Any]) -> Iterator[Problem]:
        """Yield faults between keys; `data` is unchecked: what is missing or of a wrong type is left out."""
        yield from ()

    @model_validator(mode="wrap")
    @classmethod
    def _all_faults(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        faults: list[InitErrorDetails] = []
        model: Self | None = None
        try:
            model = handler(data)
        except ValidationError as error:
            entries = error.errors(include_url=False)
            faults += [_in_words(cls, entry) for entry in entries if not _counts_faulty_entries(entry)]
        if isinstance(data, Mapping):
            faults += [_detail("fault", loc, message) for loc, message in cls.problems(data)]
        if faults or model is None:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        return model


def shown(value: object) -> str:
    """Return a value as a fault names it, short and on one line."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping | BaseModel):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def refusal(sentence: str, kind: str = "fault", meant: Sequence[str] = ()) -> PydanticCustomError:
    """Return the error a validator raises; the sentence is no template, braces in it stay as they are. `meant`: the
    keys that an unknown one may have meant."""
    return PydanticCustomError(kind, "{text}", {"text": sentence, "meant": tuple(meant)})  # type: ignore[arg-type]


def near(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean ...?` or the list of what exists, as the end of a sentence."""
    names = sorted(known)
    return _suggested(_like(name, names), names)


def _like(name: str, names: Sequence[str]) -> list[str]:
    """Return up to three of the names that are like one."""
    matches = difflib.get_close_matches(name[:80], names, n=3, cutoff=0.6)
    return matches or [one for one in names if len(name) >= LEAST_PART and name.casefold() in one][:3]


def _suggested(matches: Sequence[str], names: Sequence[str]) -> str:
    if matches:
        return f"; did you mean {' or '.join(matches)}?"
    return f"; known: {', '.join(names)}" if names else "; there is none"


def listed(data: Mapping[str, Any], *keys: str) -> Sequence[Any] | None:
    """Return the list found along the keys of nested data, None when there is none."""
    value = entry(data, *keys)
    return value if isinstance(value, list | tuple) else None


def count(data: Mapping[str, Any], *keys: str) -> int | None:
    """Return the length of the list found along the keys of nested data, None when there is none."""
    values = listed(data, *keys)
    return None if values is None else len(values)


def number(data: Mapping[str, Any], *keys: str) -> float | None:
    """Return the number found along the keys of nested data, None when there is none."""
    value = entry(data, *keys)
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def entry(data: object, *keys: str) -> Any:
    """Return what stands along the keys of nested data, mappings or models, None when there is nothing."""
    for key in keys:
        data = data.get(key) if isinstance(data, Mapping) else getattr(data, key, None)
    return data


def exactly_one(data: Mapping[str, Any], first: str, second: str) -> Iterator[Problem]:
    """Yield a fault unless exactly one of two keys is given."""
    given = [key for key in (first, second) if data.get(key) is not None]
    if len(given) == 2:
        yield (second,), f"give {first} or {second}, not both"
    if not given:
        yield (), f"give {first} or {second}"


def same_length(data: Mapping[str, Any], key: str, count: int | None, of: str) -> Iterator[Problem]:
    """Yield a fault when a list has another length than there are `of`."""
    values = listed(data, key)
    if values is not None and count and len(values) != count:
        yield (key,), f"must have one entry per {of}, {count} in all, got {len(values)}"


def _detail(kind: str, loc: tuple[int | str, ...], message: str, meant: Sequence[str] = ()) -> InitErrorDetails:
    return InitErrorDetails(type=refusal(message, kind, meant), loc=loc, input=None)


def _in_words(cls: type[Strict], error: ErrorDetails) -> InitErrorDetails:
    """Return pydantic's error as a sentence; errors of models below were put into words there."""
    kind, loc = error["type"], error["loc"]
    if kind in ("fault", "unknown_key"):
        return _detail(kind, loc, error["msg"], error.get("ctx", {}).get("meant", ()))
    if kind == "extra_forbidden":
        key = str(loc[-1])
        if key in cls.elsewhere:
            return _detail("unknown_key", loc, cls.elsewhere[key])
        meant = _meant_keys(key, cls)
        return _detail("unknown_key", loc, f"unknown key{_suggested(meant, sorted(cls.model_fields))}", meant)
    if kind == "missing":
        return _detail("fault", loc, MISSING.get(str(loc[-1])) or f"is missing; add {loc[-1]}")
    if kind == "too_short" and error.get("ctx", {}).get("min_length") == 1:
        what = "storey" if loc[-1] == "masses_kg" else "entry"
        return _detail("fault", loc, f"is empty; put at least one {what} into the list")
    wanted = _wanted(cls, error)
    message = f"must be {wanted}, got {shown(error['input'])}" if wanted else error["msg"]
    if wanted == "a list" and isinstance(error["input"], str | int | float):
        message += f"; write [{error['input']}]"
    return _detail("fault", loc, message)


def _counts_faulty_entries(error: ErrorDetails) -> bool:
    """Return whether a list is called too short only because entries of it are faulty, which is told of each."""
    given = error["input"]
    return error["type"] == "too_short" and isinstance(given, list | tuple) and len(given) >= error["ctx"]["min_length"]


def _meant_keys(key: str, cls: type[Strict]) -> list[str]:
    """Return what an unknown key may have meant: keys like it, or that key inside another one."""
    inside = dict.fromkeys(path for path in dotted_keys(cls) if path.split(".")[-1] == key)
    return _like(key, sorted(cls.model_fields)) or list(inside)[:3]


def dotted_keys(cls: type[Strict], above: str = "", depth: int = 2) -> Iterator[str]:
    """Yield the dotted paths of the keys of a model and of the models inside it; some come more than once."""
    for name, info in cls.model_fields.items():
        yield above + name
        if depth:
            for model in _models(info.annotation):
                yield from dotted_keys(model, f"{above}{name}.", depth - 1)


def _models(annotation: Any) -> Iterator[type[Strict]]:
    """Yield the models in a field's type."""
    if isinstance(annotation, type) and issubclass(annotation, Strict):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _wanted(cls: type[Strict], error: ErrorDetails) -> str:
    """Return what a value had to be, empty when pydantic's own message says it best."""
    words = {
        "float_type": "a number",
        "int_type": "a whole number",
        "int_from_float": "a whole number",
        "string_type": "text",
        "bool_type": "true or false",
        "tuple_type": "a list",
        "dict_type": "a mapping",
        "is_instance_of": "the name of a file",
        "finite_number": "a finite number",
    }
    kind, context = error["type"], error.get("ctx", {})
    if kind == "literal_error":
        return str(context["expected"]).replace("'", "").replace("True", "true").replace("False", "false")
    if kind == "too_short" and context["min_length"] > 1:
        return f"a list of at least {context['min_length']} entries"
    if kind == "too_long":
        return f"a list of at most {context['max_length']} entries"
    if kind == "model_type":
        return cls.wanted
    return words.get(kind, "")
