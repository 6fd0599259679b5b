"""The output of `rths plugin test`: the verdict first, then each clause of the contract."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rths_cli.report.document import Block, labelled
from rths_cli.report.to_text import text

if TYPE_CHECKING:
    from rths_cli.laboratory.plugin import Tested


def page(package: str, found: Sequence[Tested]) -> str:
    """Return what became of a package's rigs and laws as text."""
    sections: list[list[Block]] = [[labelled("verdict", verdict(package, found))]]
    for one in found:
        interface = f"interface {one.interface} of {one.group}" if one.interface else one.group
        clauses = (
            labelled("  broken" if kept.fault else "  kept", _clause(kept.clause, kept.fault)) for kept in one.clauses
        )
        sections.append([labelled(one.name, f"{one.value}, {interface}"), *clauses])
    return text(sections)


def verdict(package: str, found: Sequence[Tested]) -> str:
    """Return in one sentence whether a package keeps the contract."""
    broken = [one.name for one in found if not one.kept]
    if broken:
        return f"{package} breaks the contract: {', '.join(broken)}"
    return f"{package} keeps the contract: {', '.join(one.name for one in found)}"


def document(package: str, found: Sequence[Tested]) -> dict[str, Any]:
    """Return the same as a document for JSON."""
    return {
        "package": package,
        "kept": all(one.kept for one in found),
        "verdict": verdict(package, found),
        "plugins": [
            {
                "name": one.name,
                "group": one.group,
                "value": one.value,
                "interface": one.interface or None,
                "clauses": [
                    {"clause": kept.clause, "kept": not kept.fault, "fault": kept.fault} for kept in one.clauses
                ],
            }
            for one in found
        ],
    }


def _clause(clause: str, fault: str) -> str:
    return f"{clause}: {fault}" if fault else clause
