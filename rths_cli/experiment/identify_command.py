"""What `rths identify` does: measure (identify_on_rig.py) or read (identify_from_files.py), evaluate, write the model
file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from rths_cli.case.load import load_cases
from rths_cli.experiment.case_warnings import differences
from rths_cli.experiment.identify_from_files import CORRECTED, DataRequest, read_measured
from rths_cli.experiment.identify_on_rig import Measured, UnfitRig, evaluated, evaluation_settings, measure, noted, plan
from rths_cli.experiment.identify_output import Outputs, check_outputs, make_folders
from rths_cli.experiment.model_choice import as_model, notes_on
from rths_cli.experiment.model_files import channel_names, load, save
from rths_cli.experiment.setup import Progress, Setup, make_setup, shown
from rths_cli.files.imported_models import is_foreign, read_foreign
from rths_cli.files.measured_data import Recording, write_recording
from rths_cli.identification.channel_signals import UnfitRecord
from rths_cli.identification.identify import identify as evaluate
from rths_cli.identification.results import Identification
from rths_cli.interrupts import interruptible
from rths_cli.numerics.lti import Model


@dataclass(frozen=True)
class Asked:
    """What `rths identify` was asked: a case and settings KEY=VALUE, measured data (None: excite the rig), where to.

    `output` None: models/RIG_STRUCTURE.h5; `figure` None: beside it, no figure at all without `draw`; `save_data`:
    where to write what was measured.
    """

    case: str
    settings: tuple[str, ...]
    data: DataRequest | None = None
    output: Path | None = None
    save_data: Path | None = None
    figure: Path | None = None
    draw: bool = True


@dataclass(frozen=True)
class About:
    """Where an identification comes from: name and kind of the rig, a sentence on the data, and further lines.

    `lines`: pairs (label, text) such as excitation, level, reach, estimator, latency, data hash, model file, age.
    """

    rig: str
    rig_kind: str
    source: str
    lines: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Made:
    """What came of it: the identification and where its figure goes, or (found None) why no model could be made.

    `model`: the model file, where it is accepted.
    """

    about: About
    found: Identification | None
    figure: Path | None
    unfit: UnfitRecord | None = None
    exit_code: int = 0
    model: Path | None = None


def make_model(asked: Asked, progress: Progress, permit: Callable[[Setup], None] = lambda _: None) -> Made:
    """Identify as asked and write the model file, a rejected model too: it says so itself.

    `permit` is called before a rig is excited; it may refuse by an InputError.

    Raises InputError before anything moves when the case, the data or the output cannot be used.
    """
    setup = make_setup(load_cases([asked.case], asked.settings)[0])
    outputs = _outputs(asked, setup)
    given, notes = _given(setup)
    planned = None if asked.data else plan(setup)
    check_outputs(outputs, _inputs(asked, setup))
    if not asked.data:
        permit(setup)
    about = About(setup.rig.name, "" if asked.data else setup.rig.kind, "")
    try:
        measured = read_measured(asked.data, setup) if asked.data else measure(setup, progress, planned)
        about = replace(about, source=measured.source, lines=measured.lines)
        make_folders(outputs)
        if asked.save_data:
            _save_data(asked.save_data, setup, measured)
        found = noted(_evaluate(setup, measured, given, asked.data is not None), notes)
        found = noted(found, differences(setup, found))
    except (UnfitRig, UnfitRecord) as unfit:
        why, code = (unfit.unfit, unfit.exit_code) if isinstance(unfit, UnfitRig) else (unfit, 1)
        none = (("model file", "none is written: no model can be made from these channels"),)
        return Made(replace(about, lines=(*about.lines, *none)), None, None, why, code)
    replaced = outputs.model.exists()
    sha256 = save(
        outputs.model, setup, found, measured.source, measured.sha256, replace=not setup.rig.can.moves_hardware
    )
    judged = (("judged model", shown(asked_model)),) if (asked_model := setup.case.identification.model) else ()
    drawn = (("figure", shown(outputs.figure)),) if outputs.figure else ()
    lines = (
        ("structure", f"{setup.case.structure.name}, case {setup.case.name}"),
        *measured.lines,
        *judged,
        ("data SHA-256", measured.sha256[:16]),
        ("model file", f"{shown(outputs.model)}{' (replaced)' if replaced else ''}, SHA-256 {sha256[:16]}"),
        *drawn,
    )
    code, accepted = (0, outputs.model) if found.accepted else (1, None)
    return Made(replace(about, lines=lines), found, outputs.figure, None, code, accepted)


def _evaluate(setup: Setup, measured: Measured, given: Model | None, from_file: bool) -> Identification:
    """Evaluate records of the rig, or of files: faults of the latter are the user's, not the rig's."""
    if not from_file:
        return evaluated(setup, measured, given)
    settings = evaluation_settings(setup.case.identification)
    found = interruptible(
        lambda: evaluate(measured.records, setup.rig, setup.floor_masses_kg, settings, measured.quiet, given)
    )
    return noted(found, measured.notes)


def _given(setup: Setup) -> tuple[Model | None, tuple[str, ...]]:
    """Return the model that the case names, to be judged in place of one fitted here, and what to know of it."""
    path = setup.case.identification.model
    if path is None:
        return None, ()
    if not is_foreign(path):
        return load(path, setup).found.best, ()
    given = read_foreign(path)
    return as_model(given, setup), notes_on(given)


def _outputs(asked: Asked, setup: Setup) -> Outputs:
    """Return where everything goes; the model file of a real rig carries the time, so that none is ever replaced."""
    stamp = datetime.now(UTC).strftime("_%Y%m%dT%H%M%SZ") if setup.rig.can.moves_hardware else ""
    model = asked.output or Path("models") / f"{setup.rig.name}_{setup.case.structure.name}{stamp}.h5"
    figure = (asked.figure or model.with_suffix(".png")) if asked.draw else None
    return Outputs(model, figure, asked.save_data)


def _inputs(asked: Asked, setup: Setup) -> list[tuple[str, Path]]:
    """Return the files that are read, each with what names it."""
    case = setup.case
    named = [("the case", case.path), ("the record", case.record.path), ("--model", case.identification.model)]
    data = asked.data.paths if asked.data else ()
    return [(what, path) for what, path in named if path is not None] + [("--data", path) for path in data]


def _save_data(path: Path, setup: Setup, measured: Measured) -> None:
    """Write every record: command in V, accelerations in m/s^2 as the evaluation took them.

    The first goes to the path, further ones to NAME_2, ..., the one at low level to NAME_probe.
    """
    names = ("command_v", *(f"{name}_accel_m_s2" for name in channel_names(setup)))
    notes = (CORRECTED,) if setup.removes_sensors else ()
    saved = {f"_{number}" if number > 1 else "": record for number, record in enumerate(measured.records, 1)}
    saved |= {"_probe": measured.quiet} if measured.quiet is not None else {}
    for end, record in saved.items():
        samples = np.vstack([record.command_v, record.accel_m_s2])
        units = ("V", *["m/s^2"] * len(record.accel_m_s2))
        to = path.with_name(f"{path.stem}{end}{path.suffix}")
        write_recording(to, Recording(to, "", setup.rig.dt_s, names, units, samples, notes))
