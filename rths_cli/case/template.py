"""The files that `rths new` writes to start from, each valid as it is: case, rig, structure, record, compensator."""

from __future__ import annotations

import math
from pathlib import Path

from rths_cli.case.shipped_files import shipped
from rths_cli.errors import InputError

KINDS = ("case", "rig", "structure", "record", "compensator")
TRIED_BY = {
    "case": "rths run {}",
    "rig": "rths run el_centro_low_ff_fb --set table={}",
    "structure": "rths structure {}",
    "record": "rths records {}",
    "compensator": "rths plugin test {}",
}

CASE_TEMPLATE = """\
# A hybrid simulation: five keys name the experiment, everything below them has a default.
# A value is a name that is looked up (beside this file, in configs/ or records/, among the shipped files),
# a path relative to this file, or a mapping. Units stand in the names of the keys.

structure: three_storey        # shear building, cut into numerical and experimental storeys
damping: low                   # a level the structure defines, or {first_mode_ratio: 0.026}
record: el_centro              # or {file: my_record.csv, unit: g, dt_s: 0.01}
scaling: 0.30                  # factor on the record
controller: FF+FB              # FF, FF+FB, none (the table as delivered) or a compensator

# Remove the "# " in front of a line to change a default.

# table: aps400_virtual          # a rig; {extends: aps400_virtual, physics: {coulomb_n: 0.9}} varies one
# method: best                   # or paper: the control of the paper, as printed
# integration: exact             # of the numerical storeys: exact, cr (Chen-Ricles) or newmark (explicit)
# runs: [sim, sim-delay, shake-table, exp-rths]
# scale: {length: 2.4, acceleration: 1}   # prototype over model: the record is the prototype's and is compressed
# report_in: model               # or prototype: how reports print the building's response, where there is a scale
# sample_rate_hz: 2000
# delay_s: 0.005                 # the delay of sim-delay
# test_band_hz: 12               # errors are judged below it; the identified and checked bands follow
# record_filter: {corner_hz: 0.25, order: 2}   # causal Butterworth high pass; corner_hz: 0 switches it off
# identification: {seed: 0, duration_s: 120, accel_rms_m_s2: 2.0}
# kalman: {q: 1e3, r: 1.0}
# limits: {stroke_m: 0.07}       # may only be stricter than the rig's
# seed: 0                        # of the noise in the runs
# accept: {"exp_rths.rms_error_m_s2[3]": 0.06}   # the command returns 1 when a figure is above its limit
# check: {specimen_range: [0.7, 1.0]}   # stiffness of the specimen over the identified one, judged at both ends
# session_record: automatic      # always or never: the identification's quiet record once more before the table runs
# shear_from: accelerations      # or load_cell, or both, where the rig has one under the specimen
# base_shear_uncertainty: 0.01   # of accelerometers and weighed masses, for the residual drift of storeys with laws
# grade_limits: {good_percent: 2, good_ratio: 0.1, usable_percent: 5}   # bound in % of SIM; over SIM-DELAY
# plausible: [scaling]            # keys whose doubted numbers are right
# reference: zhang2015           # published figures to print beside ours
# notes: what this case is for
"""


RIG_TEMPLATE = """\
# A rig that differs from a shipped one (rths list rigs) in what stands here; rths schema rig lists every key.
# A table of your own behind a real-time target or a card: rths new rig FILE --like udp_example, or ni_example.
extends: aps400_virtual
limits: {stroke_m: 0.07}       # m from the centre; the guard keeps it in every step
physics: {coulomb_n: 0.9}      # N of friction that the virtual table hides from controllers
"""

STRUCTURE_TEMPLATE = """\
# A shear building cut into computed storeys and those that stand on the table, listed from the ground up.
numerical: {masses_kg: [8.0], stiffness_n_per_m: [8000]}
experimental: {masses_kg: [7.0, 6.0], stiffness_n_per_m: [7000, 6000], damping_ratios: [0.03, 0.03]}
interface_experimental_mass_kg: 0.0   # part of the highest computed floor that stands on the table
damping_levels: {design: {first_mode_ratio: 0.03}}   # of the computed storeys; a case names one: damping: design
"""

RECORD_HEAD = """\
# dt: 0.01 s
# units: m/s^2
# A pulse of 2 Hz; put your own values here, one a line, or name a file of an agency in the case instead.
"""


def new_files(kind: str, path: Path, like: str | None = None) -> dict[Path, str]:
    """Return the texts of a file of a kind (one of KINDS) by their paths; `like`: a shipped file to begin with.

    Raises InputError for a path that such a file cannot have, or a name that is not shipped.
    """
    if like is not None:
        text = _shipped_text(kind, like)
        return {_with_suffix(path, kind, (".yaml", ".yml")): text}
    if kind == "compensator":
        return compensator_files(path)
    if kind == "record":
        return {_with_suffix(path, kind, (".csv", ".txt")): _record()}
    texts = {"case": CASE_TEMPLATE, "rig": RIG_TEMPLATE, "structure": STRUCTURE_TEMPLATE}
    return {path if kind == "case" else _with_suffix(path, kind, (".yaml", ".yml")): texts[kind]}


def _with_suffix(path: Path, kind: str, suffixes: tuple[str, ...]) -> Path:
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: a {kind} is a {suffixes[0]} file; name it {path.with_suffix(suffixes[0])}")
    return path


def _shipped_text(kind: str, name: str) -> str:
    """Return the text of a shipped file without the line that names its schema beside it."""
    if kind not in ("case", "rig", "structure"):
        raise InputError(f"--like {name}: is for a case, a rig or a structure; leave it out")
    folder = shipped(f"{kind}s")
    known = sorted(path.stem for path in folder.glob("*.yaml"))
    if name not in known:
        raise InputError(f"--like {name}: no {kind} of this name is shipped; known: {', '.join(known)}")
    lines = (folder / f"{name}.yaml").read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith("# yaml-language-server"))


def _record() -> str:
    rows = (math.sin(4.0 * math.pi * k / 100) * math.sin(math.pi * k / 200) ** 2 for k in range(201))
    return RECORD_HEAD + "".join(f"{value:.6f}\n" for value in rows)


COMPENSATOR_TEMPLATE = """\
\"\"\"A compensator of your own. In a case: controller: {{kind: own, file: {name}.py, delay_s: 0.01}}

This one takes the table for a first-order lag of delay_s and inverts it:

    command = (d[k] + delay_s / dt (d[k] - d[k-1])) / gain,  d: desired displacement.

rths plugin test {name}.py tries it; docs/howto/own_controller.md tells what holds for every compensator.
\"\"\"

SOURCE = "paper or equation that it is from"

# Numbers that a case may state beside kind and file: default, least, most, what it is.
# A default of None leaves the number to design.
OPTIONS = {{"delay_s": (None, 0.0, 0.1, "delay of the table in s; default: its lag as identified")}}

STATES = 1  # how many numbers it remembers; they are zero at rest


def design(plant, options):
    \"\"\"Return the numbers of the law. Runs once per test, and may use numpy, scipy and files.

    plant: dt_s, gain_m_per_v (of the table, slow), lag_s (of the table, in the compared band), model (zeros, poles,
    gain, delay_s, response(frequency_hz) in m/s^2 per V), specimen (masses_kg, K, C), lead_samples.
    \"\"\"
    delay_s = plant.lag_s if options["delay_s"] is None else options["delay_s"]
    return [1.0 / plant.gain_m_per_v, delay_s / plant.dt_s]


def command(parameters, state, next_state, desired, measured, sent):
    \"\"\"Return the command in V of this sample, and write all of next_state. Runs in every sample.

    desired: acceleration (m/s^2), velocity (m/s), displacement (m) of the interface. measured: accelerations of table
    and floors in m/s^2. sent: the command of the last sample in V, behind all limits.
    \"\"\"
    per_metre, samples = parameters
    displacement = desired[2]
    next_state[0] = displacement
    return per_metre * (displacement + samples * (displacement - state[0]))
"""

COMPENSATOR_TEST = """\
\"\"\"The compensator {name} against what it must do; run it with: python -m pytest test_{name}.py\"\"\"

import {name}


def test_a_ramp_is_led_by_the_delay():
    per_metre, samples, slope = 125.0, 20.0, 1e-4  # 20 samples of delay
    state, following = [0.0], [0.0]
    for k in range(10):
        command = {name}.command((per_metre, samples), state, following, (0.0, 0.2, slope * k), (0.0,), 0.0)
        state = list(following)
    assert abs(command - per_metre * slope * (9 + samples)) < 1e-9
"""


def compensator_files(path: Path) -> dict[Path, str]:
    """Return the texts of a commented compensator that is valid as it is, and of its test beside it, by their files.

    Raises InputError for a name that is no module's.
    """
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise InputError(f"{path}: must be the name of a Python module, such as my_compensator.py")
    test = path.with_name(f"test_{path.name}")
    if path.exists() or test.exists():
        raise InputError(f"{path if path.exists() else test}: exists already; name another file")
    return {path: COMPENSATOR_TEMPLATE.format(name=path.stem), test: COMPENSATOR_TEST.format(name=path.stem)}
