"""The sentences of a run that the guard stopped: what it saw, in the order of the guard's numbers (`loop.guard`)."""

from __future__ import annotations

from rths_cli.findings.sentence import Sentence, refuses

TEXTS = {
    "displacement": "displacement (estimated from the command, with room to brake) beyond the stroke limit",
    "velocity": "velocity (estimated from the command) beyond its limit",
    "acceleration": "measured acceleration beyond its limit",
    "force": "actuator force (estimated from accelerations and masses) beyond its limit",
    "command_range": "command beyond the converter's range",
    "tracking": "tracking error beyond its limit",
    "not_a_number": "a sample or the command is not a number",
    "saturated": "a sensor is saturated",
    "stuck": "a sensor is stuck",
    "command_rate": "command changes faster than its limit",
    "energy": "the table's errors add energy to the structure beyond their limit",
    "lost": "samples were lost or late, one after another, beyond their limit",
    "overrun": "steps overran their interval, one after another, beyond their limit",
    "rig_fault": "the rig reports a fault",
    "operator": "stopped by the operator",
    "interrupted": "interrupted",
    "terminated": "terminated",
    "log_failed": "the log cannot be written",
    "live_view_failed": "the live view failed",
    "end": "the end of the record",
    "measured_displacement": "measured displacement (with room to brake) beyond the stroke limit",
    "level": "a channel is beyond its abort level",
    "disagrees": "a channel does not show what command and accelerations demand",
    "planned_displacement": "displacement (estimated from the command, with room to brake) beyond what this test needs",
    "deviation": "displacement (estimated from the command) too far from the desired one",
}
"""Name and words of each reason but the first, which is none."""
TOLD = "[{cause}: ]"
FACTS = "[ ({details})][{channel:-}][{seen:-}][{limit:-}][{units:-}][{key:-}]"  # in `details` already, as words

SENTENCES: dict[str, Sentence] = {f"stop.{name}": refuses(f"{TOLD}{text}{FACTS}") for name, text in TEXTS.items()}
