"""Declarations of the datasets and attributes of a sweep file beside its metrics and varied keys."""

from __future__ import annotations

from rths_cli.quantities.attributes import OF_FILE
from rths_cli.quantities.declaration import AttributeDeclaration, DatasetDeclaration

RUNS = ("variant",)
TEXTS = {
    "status": "how the run ended: complete, aborted, failed or refused",
    "reason": "why it ended so",
    "verdict": "what the check says of the hybrid test: safe, unsafe or unstable",
    "model_sha256": "hash of the table model that drove the run",
    "processor": "processor that computed the run, with a hash of its instruction set",
}
"""What a sweep says of each run in words, by the names of the datasets."""
SWEEP_DATASETS: dict[str, DatasetDeclaration] = {
    one.path: one
    for one in (
        DatasetDeclaration("seed", "1", RUNS, "computed", "seed of the run's noise"),
        *(DatasetDeclaration(name, "1", RUNS, "computed", text, "text") for name, text in TEXTS.items()),
        DatasetDeclaration("case_yaml", "1", (), "computed", "case file as written", "text"),
        DatasetDeclaration(
            "case_resolved", "1", (), "computed", "the case without what is varied, all defaults", "text"
        ),
        DatasetDeclaration(
            "study_yaml", "1", (), "computed", "study file as written", "text", present="where a study file was given"
        ),
    )
}
"""Every dataset by its name."""
OF_SWEEP = (
    AttributeDeclaration("coordinates", "text", "names of the coordinates: seed and the varied keys"),
    AttributeDeclaration("figures", "text", "paths of the metrics, in their order"),
    AttributeDeclaration("seeds", "text", "seeds of each grid point"),
    AttributeDeclaration("seeds_per_point", "number", "how many those are"),
    AttributeDeclaration("grid_points", "number", "grid points of the varied keys"),
    AttributeDeclaration("exit_code", "number", "exit code of the sweep"),
    AttributeDeclaration("case_file", "text", "file of the case; names in the case are looked up from its folder"),
    AttributeDeclaration("study_file", "text", "file of the study, empty without one"),
    AttributeDeclaration("settings", "text", "settings KEY=VALUE of every run, as JSON"),
    AttributeDeclaration("settings_folder", "text", "folder at which relative paths in the settings start"),
    AttributeDeclaration("values_folder", "text", "folder at which relative paths in the varied values start"),
    AttributeDeclaration("plan_sha256", "text", "SHA-256 of what was to be run"),
    AttributeDeclaration("software_sha256", "text", "SHA-256 of the software that ran it"),
    AttributeDeclaration(
        "ida",
        "text",
        "measure, limits and runs of an incremental dynamic analysis, as JSON",
        present="of rths ida alone",
    ),
    AttributeDeclaration("part", "text", "which part of the sweep, K/N", present="in a part of a sweep alone"),
)
"""Attributes that a sweep has beside those of a result."""
SWEEP_ATTRIBUTES: dict[str, AttributeDeclaration] = {one.name: one for one in (*OF_FILE, *OF_SWEEP)}
"""Every attribute of a sweep's file by its name."""
