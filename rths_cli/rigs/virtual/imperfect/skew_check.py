"""Whether the command of a virtual rig acts near enough to its clock, before and after the identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rths_cli.rigs.virtual.imperfect.plant import FARTHEST

if TYPE_CHECKING:
    from rths_cli.case.rig_schema import VirtualRigSpec
    from rths_cli.rigs.description import RigInfo


def skew_faults(spec: VirtualRigSpec, info: RigInfo, own_s: float) -> list[str]:
    """Return a sentence where the command of a rig with latency would act too far from its clock, by the key that
    states it: more than FARTHEST of a sample interval, before or after the identification.

    `own_s`: what the laboratory's command is late from the beginning.
    """
    if info.latency_samples == 0:
        return []
    limit_s, changed = FARTHEST * info.dt_s, spec.after_identification.command_skew_s
    of_interval = f"{FARTHEST:g} of the sample interval"
    if abs(own_s) > limit_s:
        return [
            f"table.imperfections.converters.command_skew_s: must be within +-{1e6 * limit_s:.4g} us, {of_interval}, "
            f"got {1e6 * own_s:.4g} us"
        ]
    if changed and abs(own_s + changed) > limit_s:
        beside = f" beside the {1e6 * own_s:.4g} us of table.imperfections.converters.command_skew_s" if own_s else ""
        return [
            f"table.after_identification.command_skew_s: must be within +-{1e6 * limit_s:.4g} us, {of_interval}"
            f"{beside}, got {1e6 * changed:.4g} us"
        ]
    return []
