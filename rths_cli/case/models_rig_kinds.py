"""Which model reads which rig file: decided by its `kind` alone, so that faults are those of one model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import ValidationError, ValidatorFunctionWrapHandler, WrapValidator
from pydantic_core import InitErrorDetails

from rths_cli.case.fields import near, refusal, shown
from rths_cli.case.models_rig import RigSpec, VirtualRigSpec
from rths_cli.case.models_rig_real import NiRigSpec, PluginRigSpec, UdpRigSpec
from rths_cli.case.plugin_kinds import GROUP, plugin_kinds

KINDS: dict[str, type[RigSpec]] = {"virtual": VirtualRigSpec, "udp": UdpRigSpec, "ni": NiRigSpec}


def read_rig(data: Any, handler: ValidatorFunctionWrapHandler) -> RigSpec:
    """Return the rig of checked or unchecked data; raises the faults of its kind's model alone."""
    if isinstance(data, RigSpec):
        return data
    kind = data.get("kind", "virtual") if isinstance(data, Mapping) else "virtual"
    fault = kind_fault(kind)
    if fault:
        detail = InitErrorDetails(type=refusal(fault), loc=("kind",), input=kind)
        raise ValidationError.from_exception_data(RigSpec.__name__, [detail])
    return KINDS.get(kind, PluginRigSpec).model_validate(data)


def kind_fault(kind: object) -> str:
    """Return why no rig is of this kind, empty when one is; further keys need no fault each then."""
    if not isinstance(kind, str):
        return f"must be text, got {shown(kind)}"
    found = {} if kind in KINDS else plugin_kinds()
    if kind not in (*KINDS, *found):
        return (
            f"no kind of rig is called {kind[:40]!r}{near(kind, {*KINDS, *found})}; "
            f"a further kind comes with a package that has an entry point of that name in the group {GROUP}"
        )
    points = found.get(kind, ())
    if len(points) > 1:
        return f"{kind!r} is brought by several packages ({', '.join(p.value for p in points)}); remove all but one"
    return ""


AnyRig = Annotated[VirtualRigSpec | UdpRigSpec | NiRigSpec | PluginRigSpec, WrapValidator(read_rig)]
