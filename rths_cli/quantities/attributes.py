"""Declarations of the attributes of a result file, its blocks and its runs: name, kind, meaning.

In a name `RUN` stands for a run on the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product

from rths_cli.quantities.datasets import KEPT_SERIES, SINCE_0_2
from rths_cli.quantities.declaration import TABLE_RUNS, AttributeDeclaration

STATUSES = ("complete", "aborted", "interrupted", "failed", "refused")
"""How a run can have ended."""
REAL = "real rig only"
LINKED = "UDP rig only"
ECHOED = "plain link only"
RECOVERED = "recovered run only"
ELSEWHERE = "run made elsewhere only"
SCALED = "only where the case states a scale"
FACTOR = (1e-15, 1e15)
"""Limits of a scale factor."""

OF_FILE = (
    AttributeDeclaration("format", "text", "`rths-result`"),
    AttributeDeclaration("format_version", "number", "1; files of a later version are refused", (1, 1e6)),
    AttributeDeclaration("status", "text", f"how the run ended: {', '.join(STATUSES)}", STATUSES),
    AttributeDeclaration("status_reason", "text", "why it did not end as planned, a sentence; empty where it did"),
    AttributeDeclaration("case_name", "text", "name of the case"),
    AttributeDeclaration("created_utc", "text", "when the file was begun"),
    AttributeDeclaration("rths_version", "text", "version of rths"),
    AttributeDeclaration("git_commit", "text", "commit of rths, empty where it is installed as a package"),
    AttributeDeclaration("package_versions", "text", "versions of Python and of the packages that compute, as JSON"),
    AttributeDeclaration("platform", "text", "system and processor"),
    AttributeDeclaration("command_line", "text", "the command that was given"),
    AttributeDeclaration("seed", "number", "seed of the runs", (0, 2.0**64)),
    AttributeDeclaration("sample_rate_hz", "number", "sample rate in Hz", (1.0, 1e6)),
    AttributeDeclaration(
        "series",
        "text",
        f"which time series the file holds: {', '.join(KEPT_SERIES)} (`--series`)",
        KEPT_SERIES,
        present=SINCE_0_2,
    ),
    AttributeDeclaration("test_band_hz", "number", "upper end of the test band in Hz", (0.5, 1e3), present=SINCE_0_2),
    AttributeDeclaration(
        "compared_low_hz",
        "number",
        "lower end in Hz of the band in which the table's model was compared with its data",
        (1e-3, 1e4),
        present=SINCE_0_2,
    ),
    AttributeDeclaration("compared_high_hz", "number", "its upper end in Hz", (1e-3, 1e4), present=SINCE_0_2),
    AttributeDeclaration("method", "text", "best or paper"),
    AttributeDeclaration(
        "controller", "text", "FF, FF+FB, none, a kind of compensator, or own (recorded): of a run made elsewhere"
    ),
    AttributeDeclaration("scaling", "number", "factor on the record", (-1e9, 1e9)),
    AttributeDeclaration("scale_length", "number", "length of the prototype over that of the model", FACTOR, SCALED),
    AttributeDeclaration("scale_acceleration", "number", "the same of accelerations", FACTOR, SCALED),
    AttributeDeclaration("scale_mass", "number", "the same of masses", FACTOR, SCALED),
    AttributeDeclaration(
        "report_in",
        "text",
        "scale in which reports print the building's response; every value in the file is in model scale",
        ("model", "prototype"),
        SCALED,
    ),
    AttributeDeclaration("damping_name", "text", "damping level, inline where the case gives a mapping"),
    AttributeDeclaration(
        "damping_first_mode_ratio",
        "number",
        "damping ratio of the whole building's first mode",
        (-10.0, 1e3),
        present=SINCE_0_2,
    ),
    AttributeDeclaration("record_name", "text", "name of the record's file"),
    AttributeDeclaration("record_sha256", "text", "SHA-256 of the record's file"),
    AttributeDeclaration(
        "record_baseline",
        "text",
        "what was removed from the record: mean, linear, polynomial, step or none",
        present="only where the case states record.baseline",
    ),
    AttributeDeclaration(
        "record_component",
        "text",
        "the component of the record's file, as the case names it",
        present="only where the case states record.component",
    ),
    AttributeDeclaration(
        "record_treatment",
        "text",
        "what was done to the record before it was scaled, in its order and with its figures, separated by semicolons",
        present="only where something was done",
    ),
    AttributeDeclaration("rig", "text", "name of the rig"),
    AttributeDeclaration("rig_kind", "text", "virtual, udp, ni, the kind of a package, or recorded"),
    AttributeDeclaration(
        "calibration",
        "text",
        "day and person of the rig's calibration file",
        present="only of a rig with a calibration",
    ),
    AttributeDeclaration(
        "driver_verified",
        "text",
        "what was behind a real rig's driver: hardware, loopback or fake; empty for a virtual rig",
    ),
    AttributeDeclaration("model_source", "text", "where the model of the table comes from, and its age"),
    AttributeDeclaration("model_sha256", "text", "SHA-256 of the table model's numbers"),
    AttributeDeclaration(
        "check_verdict",
        "text",
        "of the check of EXP-RTHS (of the shake-table test without it): safe, unsafe, unstable",
    ),
    AttributeDeclaration(
        "error_causes", "text", "named causes of EXP-RTHS's error, one a line, and their parts of it", present=SINCE_0_2
    ),
    AttributeDeclaration(
        "main_error_cause", "text", "the cause with half of the error's square, empty without one", present=SINCE_0_2
    ),
    AttributeDeclaration(
        "no_true_error_bound", "text", "why a complete EXP-RTHS has no bound of its true error", present=SINCE_0_2
    ),
    AttributeDeclaration("overrides", "text", "what was overridden: check, model"),
    AttributeDeclaration(
        "units_in_doubt", "text", "keys whose values speak for another unit, empty if none does", present=SINCE_0_2
    ),
    AttributeDeclaration(
        "own_parts", "text", "places of the step whose parts the caller of the Python interface made", present=SINCE_0_2
    ),
    AttributeDeclaration(
        "own_building",
        "text",
        "declared: SIM is that of the building which the caller's numerical substructure declares; empty: the case's",
        present=SINCE_0_2,
    ),
    AttributeDeclaration("warnings", "text", "what a user should read before trusting the result, one a line"),
    AttributeDeclaration(
        "findings", "text", "reasons of a refusal, then the warnings, as JSON: code, values, text", present=SINCE_0_2
    ),
    AttributeDeclaration("reference_title", "text", "title of the published figures"),
    AttributeDeclaration("reference_json", "text", "the published figures of this case by path, as JSON"),
)
"""Of the root, in the order in which they tell a run."""
OF_RUN = (
    AttributeDeclaration("RUN_status", "text", "how this run ended; begun: its process was killed before it did"),
    AttributeDeclaration("RUN_status_reason", "text", "why it did not end as planned; not there where it did"),
    AttributeDeclaration(
        "RUN_zeros_v", "text", "mean of each channel at rest in V, taken off every sample", present=REAL
    ),
    AttributeDeclaration("RUN_overruns", "number", "intervals that were missed", present=REAL),
    AttributeDeclaration(
        "RUN_fifo_priority", "number", "real-time priority that the system granted, 0: none", present=REAL
    ),
    AttributeDeclaration("RUN_cpu", "number", "processor that the loop was bound to", present=REAL),
    AttributeDeclaration("RUN_memory_locked", "number", "1: memory was locked", present=REAL),
    AttributeDeclaration("RUN_not_granted", "text", "what the system refused, one a line", present=REAL),
    AttributeDeclaration("RUN_log_fault", "text", "why the raw log could not be written; empty: it was", present=REAL),
    AttributeDeclaration(
        "RUN_log_behind_s", "number", "how far the raw log was behind the loop at worst, in s", present=REAL
    ),
    AttributeDeclaration("RUN_link_peer", "text", "address of the target", present=LINKED),
    AttributeDeclaration("RUN_recording", "text", "file of the recording and its SHA-256", present=ELSEWHERE),
    AttributeDeclaration(
        "RUN_recorded_channels", "text", "role and channel of the recording, one a line", present=ELSEWHERE
    ),
    AttributeDeclaration(
        "RUN_link_latency_samples",
        "number",
        "intervals after which a command acted, the mean of what the target's frames echo",
        present=ECHOED,
    ),
    AttributeDeclaration("recovered_RUN", "text", "how much of this run its raw log held", present=RECOVERED),
)
"""Of the root, for each run on the table."""
OF_BLOCK = (
    AttributeDeclaration("name", "text", "name of the block"),
    AttributeDeclaration("dt_s", "number", "its step in s"),
    AttributeDeclaration("inputs", "texts", "names of its inputs, with units"),
    AttributeDeclaration("outputs", "texts", "names of its outputs, with units"),
)
"""Of each group of a block."""


def attribute_fault(
    given: Mapping[str, str | int | float], declared: Mapping[str, AttributeDeclaration] | None = None
) -> str:
    """Return what is wrong with the first attribute that is not as `declared` (those of a result), "" where all are."""
    for name, value in given.items():
        one = (declared or ATTRIBUTES).get(name)
        if one is None:
            return f"attribute {name} is declared nowhere"
        if isinstance(value, str) != (one.kind == "text"):
            return f"attribute {name} is {value!r}, declared is a {one.kind}"
    return ""


def _of_runs() -> Iterator[AttributeDeclaration]:
    """Yield the attributes of each run under their own names."""
    for run, one in product(TABLE_RUNS, OF_RUN):
        yield replace(one, name=one.name.replace("RUN", run))


ATTRIBUTES: dict[str, AttributeDeclaration] = {one.name: one for one in (*OF_FILE, *_of_runs())}
"""Every attribute of the root by its name."""
