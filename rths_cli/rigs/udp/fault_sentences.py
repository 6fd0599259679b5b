"""Sentences for the user about a target's refusals, fault flags and silence."""

from __future__ import annotations

from rths_cli.rigs.udp import packets


def fault_names(faults: int) -> str:
    """Return the faults of a target in words, empty for none."""
    names = {
        packets.WATCHDOG: "its watchdog missed commands",
        packets.END_STOP: "the table is at its end stop",
        packets.EMERGENCY_STOP: "the emergency stop is pressed",
        packets.BAD_COMMAND: "it was sent a command that is not a number or out of range",
        packets.SENSOR: "a sensor failed",
        packets.ACTUATOR: "the actuator or its amplifier failed",
        packets.OVERRUN: "it could not keep its own pace",
    }
    named = [text for bit, text in names.items() if faults & bit]
    own = faults & ~sum(names)
    return ", ".join([*named, f"its own fault code {own:#x}"] if own else named)


def refused(peer: str, reason: int, detail: int) -> str:
    """Return why a target refused a session, as a sentence."""
    why = {
        packets.NO_VERSION: f"it speaks version {detail} of the protocol, this rths version {packets.PROTOCOL}; "
        "bring both to the same version",
        packets.BUSY: "another session has its table, or the table is not yet at rest; wait, or end the other run",
        packets.OTHER_CHANNELS: f"it has {detail} channels; name as many in the rig file, the table first",
        packets.TOO_FAST: f"its shortest sample interval is {detail * 1e-3:g} us; lower sample_rate_hz",
        packets.FAULTY: f"{fault_names(detail)}; put that right at the rig",
    }.get(reason, f"it gives reason {reason}, which this rths does not know")
    return f"target {peer} refuses the session: {why}"


def silence(peer: str, timeout_s: float, strangers: int) -> str:
    """Return the sentence for a target that sent no WELCOME; `strangers`: received packets made with another key."""
    if strangers:
        return (
            f"target {peer} sent {strangers} answers made with another key; give both sides the same key file "
            "(a target that was started anew may have made another)"
        )
    return (
        f"target {peer} did not answer within {timeout_s:g} s: check that it runs, that host and port are its own, "
        "cable and firewall, and that both sides have the same key file (a target with another key is silent)"
    )
