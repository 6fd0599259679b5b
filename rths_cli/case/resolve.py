"""Fill a case with what follows from it: named files, rig, bands.

`--set` applied, names looked up, `extends` merged.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from pydantic import ValidationError

from rths_cli.case.case_schema import TEST_BAND_RANGE, CaseKeys, IdentificationSpec, KalmanSpec
from rths_cli.case.field_types import near
from rths_cli.case.named_files import find, kind_of_tree, no_case
from rths_cli.case.program_schema import ProgramSpec
from rths_cli.case.real_rig_overrides import is_real, made_real, over_real_rig, set_inside
from rths_cli.case.record_schema import OF_CODE
from rths_cli.case.recorded_run_schema import RECORDED_RUNS
from rths_cli.case.structure_schema import OF_MATRICES
from rths_cli.case.yaml_reader import Fault, Mark, Node, Source, display, parse, plain, printable, read_file
from rths_cli.errors import InputError
from rths_cli.numerics.bands import with_test_band

FOLLOWING = (
    ("identification", "compared_hz", IdentificationSpec),
    ("identification", "low_hz", IdentificationSpec),
    ("identification", "high_hz", IdentificationSpec),
    ("kalman", "residual_hz", KalmanSpec),
)
"""Keys whose defaults belong to the default test band and keep their ratio to another one."""
EXCITED = 5.0  # default of identification.high_hz over the test band
EXCITED_SHARE = 0.2  # of the sample rate: highest frequency to which a table can be excited

VARIED = "_varied"  # ends the name of what extends something and gives itself no name
DEFAULT_RIG = "aps400_virtual"
MOST_KEYS = 20  # of a dotted path; no key of a case lies half as deep
REAL_RUNS = ("sim", "sim_delay", "exp_rths")
ACTUATOR_RUNS = ("sim", "exp_rths")
FILES = {"structure": "structures", "table": "rigs", "reference": "references"}
SHORT_FORMS = {"structure": "extends", "table": "extends", "controller": "kind", "record": "file"}
RIVALS = {
    "natural_frequencies_hz": ("stiffness_n_per_m",),
    "stiffness_n_per_m": ("natural_frequencies_hz",),
    "damping_ratios": ("dashpots_n_s_per_m",),
    "first_mode_ratio": ("dashpots_n_s_per_m", *OF_MATRICES),
    "dashpots_n_s_per_m": ("damping_ratios", "first_mode_ratio", *OF_MATRICES),
    "matrices": ("masses_kg", "stiffness_n_per_m", "law"),
    **{key: ("first_mode_ratio", "dashpots_n_s_per_m", *(set(OF_MATRICES) - {key})) for key in OF_MATRICES},
    "rate_hz": ("stiffness_n_per_m", "law", "masses_kg"),  # of a program in the place of computed storeys
}
Setting = tuple[tuple[str, ...], Node]
NOTHING_TYPED: Mapping[str, str] = {}


def expand_test_band(children: dict[str, Node], faults: list[Fault], lost: set[str]) -> None:
    """Fill in what follows a stated test band; one that the sample rate cannot carry is a fault.

    A value that is no number, or out of range, is left to the model to refuse.
    """
    node = children.get("test_band_hz")
    band_hz, rate_hz = _number(node), _number(children.get("sample_rate_hz"))
    if node is None or band_hz is None or not TEST_BAND_RANGE.holds(band_hz):
        return
    rate_hz = CaseKeys.model_fields["sample_rate_hz"].default if rate_hz is None else rate_hz
    options = children.get("identification")
    stated = options is not None and isinstance(options.value, dict) and "high_hz" in options.value
    if not stated and EXCITED * band_hz > EXCITED_SHARE * rate_hz:
        why = (
            f"a table is identified up to {EXCITED:g} times the test band, at most {EXCITED_SHARE:g} of the sample rate"
        )
        most, advice = EXCITED_SHARE / EXCITED * rate_hz, "raise sample_rate_hz, or state identification.high_hz"
        faults.append(
            Fault(node.mark, "test_band_hz", f"must be <= {most:g}, because {why}, got {band_hz:g}; {advice}")
        )
        lost.add("test_band_hz")
    elif 2.0 * band_hz < rate_hz:
        for key, name, spec in FOLLOWING:
            _fill(children, key, name, spec.model_fields[name].default, node, band_hz)


def expand_filter_choice(children: dict[str, Node]) -> None:
    """Let a case that states weights of the floor filter have these; call it before the bands are filled in."""
    options = children.get("kalman")
    if options is not None and isinstance(options.value, dict):
        stated = {"q", "residual_hz"} & set(options.value)
        if stated and "choice" not in options.value:
            choice = Node("stated", options.mark, options.key_mark)
            children["kalman"] = replace(options, value={**options.value, "choice": choice})


def _fill(
    children: dict[str, Node], key: str, name: str, usual: float | tuple[float, ...], beside: Node, band_hz: float
) -> None:
    """Give the mapping at `key` the value of `name` that belongs to a test band, unless the case states one."""
    parent = children.get(key, Node({}, beside.mark, beside.key_mark))
    if not isinstance(parent.value, dict) or name in parent.value:
        return
    ends = usual if isinstance(usual, tuple) else (usual,)
    nodes = tuple(Node(with_test_band(hz, band_hz), beside.mark, beside.key_mark) for hz in ends)
    value = Node(nodes, beside.mark, beside.key_mark) if isinstance(usual, tuple) else nodes[0]
    children[key] = replace(parent, value={**parent.value, name: value})


def _number(node: Node | None) -> float | None:
    """Return the value of a node that holds a number, None for any other."""
    if node is None or isinstance(node.value, bool) or not isinstance(node.value, int | float):
        return None
    return float(node.value)


def read_settings(
    settings: Sequence[str], typed: Mapping[str, str] = NOTHING_TYPED, folder: Path | None = None
) -> tuple[list[Setting], list[Fault]]:
    """Return keys and value of each `key.sub=value`, and the faults of those that are none.

    `typed`: the option by which the user gave a setting that is no --set; `folder`: where relative paths in the values
    start, None: the present one.
    """
    found: list[Setting] = []
    faults: list[Fault] = []
    for text in settings:
        key, sign, value = text.partition("=")
        source = Source(typed.get(text, f"--set {printable(key.strip())}")[:120], folder or Path.cwd())
        keys = _setting_keys(key.strip())
        if len(keys) > MOST_KEYS:
            faults.append(Fault(Mark(source), "", f"names {len(keys)} keys inside each other, at most {MOST_KEYS}"))
            continue
        if not key.isprintable():
            faults.append(Fault(Mark(source), "", "names a key with a character that is no text; type the key again"))
            continue
        if not sign or not all(keys):
            faults.append(Fault(Mark(source), "", "must be key=value, for example --set table.physics.coulomb_n=0.9"))
            continue
        if keys[0] != "accept" and any("[" in part and part.endswith("]") for part in keys):
            whole = key.strip().partition("[")[0]
            faults.append(
                Fault(Mark(source), "", f"entries of a list cannot be set; set the whole list: {whole}=[...]")
            )
            continue
        node, more = parse(value, source)
        faults += [replace(fault, mark=Mark(source)) for fault in more]
        if node is not None and not more:
            found.append((keys, unplaced(node, Mark(source))))
    return found, faults


def apply_settings(tree: Node, settings: Iterable[Setting]) -> Node:
    """Return the case's document with settings put in; setting below a name varies what is named."""
    for keys, value in settings:
        tree = _put(tree, keys, value)
    return tree


def extended_case(tree: Node, path: Path) -> tuple[Node, list[Fault]]:
    """Return the document of a case with the case merged into it that it extends (`extends: NAME`), and the faults.

    It keeps its own name, or that of its file. A key below `structure`, `table`, `record` or `controller` varies what
    the other case names there; one that names something itself takes its place.
    """
    faults: list[Fault] = []
    return _extended(tree, faults, (path.resolve(),)), faults


def _extended(tree: Node, faults: list[Fault], trail: tuple[Path, ...]) -> Node:
    node = tree.children.get("extends")
    if node is None:
        return tree
    own = replace(tree, value={key: child for key, child in tree.children.items() if key != "extends"})
    base = _case_named(node, faults, trail)
    if base is None:
        return own
    below = {key: child for key, child in base.children.items() if key != "name"}
    for key, short in SHORT_FORMS.items():
        over = own.children.get(key)
        if over is None:
            continue
        if isinstance(over.value, dict) and not {short, "kind"} & set(over.children):
            varied = below.get(key) or (Node(DEFAULT_RIG, base.mark) if key == "table" else None)
            below |= {key: _long_form(varied, short)} if varied else {}
        else:  # it names another one
            below.pop(key, None)
    return merge(replace(base, value=below), own)


def _case_named(node: Node, faults: list[Fault], trail: tuple[Path, ...]) -> Node | None:
    """Return the document of the case that a node names, whole; None when there is none."""
    if not isinstance(node.value, str):
        faults.append(Fault(node.mark, "extends", "must be the name or the path of a case"))
        return None
    try:
        path = find(node.value, "cases", node.mark.source.folder, node.mark.source.path).resolve()
    except InputError as error:
        faults.append(Fault(node.mark, "extends", str(error)))
        return None
    if path in trail:
        names = " -> ".join(step.stem for step in (*trail, path))
        faults.append(Fault(node.mark, "extends", f"goes round in a circle: {names}; remove one extends"))
        return None
    _, tree, found = read_file(path)
    faults += found
    kind = "" if tree is None else kind_of_tree(tree)
    if tree is None or not isinstance(tree.value, dict) or kind not in ("", "cases"):
        what = no_case(kind, node.value) if kind else "holds no keys of a case"
        faults.append(Fault(node.mark, "extends", f"{display(path)} {'cannot be read' if found else what}"))
        return None
    return _extended(tree, faults, (*trail, path))


def expand_case(tree: Node, stem: str) -> tuple[Node, list[Fault], set[str]]:
    """Return the document with every name replaced by what it names, the faults, and the keys that are lost.

    `stem` is the case's name when the file gives none.
    """
    faults: list[Fault] = []
    children = {"name": Node(stem, tree.mark), "table": Node(DEFAULT_RIG, tree.mark)} | tree.children
    lost: set[str] = set()
    for key, kind in FILES.items():
        if key in children:
            node = _expand(children[key], kind, key, faults, ())
            lost |= {key} if node is None else set()
            children[key] = node or children[key]
    if "structure" in children:
        children["structure"] = _with_law_files(children["structure"], "structure.", faults)
        children["structure"] = _with_matrix_files(children["structure"], "structure.", faults)
    for key in ("record", "controller"):
        if key in children:
            children[key] = _long_form(children[key], SHORT_FORMS[key])
    if "controller" in children:
        children["controller"] = _with_law_file(children["controller"], "controller", faults)
    _expand_damping(children, faults, lost)
    if "damping" in children and isinstance(children["damping"].value, dict):
        children["damping"] = _with_file_at(children["damping"], ("matrix",), "damping", faults)
    expand_filter_choice(children)
    expand_test_band(children, faults, lost)
    if "table" not in lost:
        children["table"] = _with_calibration(children["table"], "table.", faults)
    _expand_recorded(children, faults)
    _expand_real_rig(children, faults)
    _expand_file(children, ("record", "file"), "records", faults)
    _expand_spectrum(children, faults)
    _expand_file(children, ("identification", "model"), None, faults)
    return replace(tree, value=children), faults, lost


def expand_file(path: Path, kind: str) -> tuple[Node | None, list[Fault]]:
    """Return the document of a structure, rig or reference file with what it extends merged, and the faults."""
    source = Source(display(path), path.absolute().parent)
    faults: list[Fault] = []
    node = _from_file(Node(str(path.absolute()), Mark(source)), kind, "", faults, ())
    if node is not None and kind == "rigs":
        node = _with_calibration(node, "", faults)
        node = _with_whole_paths(node) if is_real(node) else node
    elif node is not None and kind == "structures":
        node = _with_matrix_files(_with_law_files(node, "", faults), "", faults)
    return node, faults


def merge(base: Node, over: Node) -> Node:
    """Return `base` with what `over` states in its place, key by key; a key drops its rivals in `base`."""
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    merged = dict(base.value)
    for key, child in over.value.items():
        for rival in RIVALS.get(key, ()):
            if rival not in over.value:
                merged.pop(rival, None)
        merged[key] = merge(merged[key], child) if key in merged else child
    return replace(over, value=merged)


def unplaced(node: Node, mark: Mark) -> Node:
    """Return a node all of whose places are one mark."""
    value = node.value
    if isinstance(value, dict):
        value = {key: unplaced(child, mark) for key, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple(unplaced(child, mark) for child in value)
    return Node(value, mark, mark)


def _setting_keys(key: str) -> tuple[str, ...]:
    """Return the keys of a dotted path; behind `accept.` stands one key, itself dotted."""
    head, _, rest = key.partition(".")
    return (head, rest) if head == "accept" and rest else tuple(key.split("."))


def _put(tree: Node, keys: tuple[str, ...], value: Node, short_form: str | None = None) -> Node:
    """Return a document with a value at dotted keys; a scalar on the way becomes the mapping it abbreviates."""
    if not keys:
        return value
    children = dict(_long_form(tree, short_form).children if short_form else tree.children)
    below = children.get(keys[0])
    at_top = tree.key_mark is None
    short = SHORT_FORMS.get(keys[0]) if at_top else None
    if at_top and below is None and keys[0] == "table":
        below = Node(DEFAULT_RIG, value.mark)
    empty = Node({}, value.mark, value.mark)
    children[keys[0]] = replace(_put(below or empty, keys[1:], value, short), key_mark=value.mark)
    return replace(tree, value=children)


def _long_form(node: Node, key: str) -> Node:
    """Return a scalar as the mapping it abbreviates."""
    if isinstance(node.value, dict | tuple) or node.value is None:
        return node
    return replace(node, value={key: Node(node.value, node.mark, node.key_mark)})


def _expand(node: Node, kind: str, key: str, faults: list[Fault], trail: tuple[Path, ...]) -> Node | None:
    """Return a mapping complete with what it is named after or extends; None when that cannot be read."""
    if isinstance(node.value, str):
        return _from_file(node, kind, key, faults, trail)
    own = dict(node.children)
    base_name = own.pop("extends", None) if kind != "references" else None
    if base_name is None:
        faults += set_inside(node, key) if kind == "rigs" and not trail and is_real(node) else []
        return node if "name" in own or not own else replace(node, value={"name": _text("inline", node), **own})
    base = _from_file(base_name, kind, f"{key.removesuffix('.extends')}.extends", faults, trail)
    if base is None:
        return None
    if kind == "rigs" and not trail and is_real(base):  # it stays that rig, by name too
        own, loosened = over_real_rig(base, own, key)
        faults += loosened
    else:
        faults += made_real(own, key) if kind == "rigs" and not trail else []
        own.setdefault("name", _text(f"{plain(base).get('name')}{VARIED}", node))
    return merge(base, replace(node, value=own))


def _from_file(node: Node, kind: str, key: str, faults: list[Fault], trail: tuple[Path, ...]) -> Node | None:
    """Return the mapping in the file that a node names, marks of faults kept; None when there is none."""
    if not isinstance(node.value, str):
        faults.append(Fault(node.mark, key, "must be a name or a path"))
        return None
    source = node.mark.source
    try:
        path = find(node.value, kind, source.folder, source.path).resolve()
    except InputError as error:
        faults.append(Fault(node.mark, key, str(error)))
        return None
    if path in trail:
        names = " -> ".join(step.stem for step in (*trail, path))
        faults.append(Fault(node.mark, key, f"goes round in a circle: {names}; remove one extends"))
        return None
    _, tree, found = read_file(path)
    faults += found
    if tree is None:
        return None
    if not isinstance(tree.value, dict):
        faults.append(Fault(tree.mark, "", f"must hold a mapping of the keys of a {kind.removesuffix('s')}"))
        return None
    named = {"name": _text(path.stem, tree), **tree.value}
    return _expand(replace(tree, value=named, key_mark=node.key_mark), kind, key, faults, (*trail, path))


def _text(value: str, beside: Node) -> Node:
    return Node(value, beside.mark, beside.key_mark)


def _expand_damping(children: dict[str, Node], faults: list[Fault], lost: set[str]) -> None:
    """Replace the name of a damping level by the level of the structure."""
    node, structure = children.get("damping"), children.get("structure")
    if node is None or not isinstance(node.value, str):
        return
    levels = structure.children.get("damping_levels") if structure and "structure" not in lost else None
    if structure is None or "structure" in lost or (levels and not isinstance(levels.value, dict)):
        lost.add("damping")
        return
    named = levels.children if levels else {}
    if node.value not in named:
        none = "; add damping_levels to it, or write damping: {first_mode_ratio: 0.02}"
        ends = near(node.value, named) if named else none
        faults.append(Fault(node.mark, "damping", f"the structure has no damping level {node.value[:40]!r}{ends}"))
        lost.add("damping")
        return
    level = named[node.value]
    if isinstance(level.value, dict):
        children["damping"] = replace(level, value={**level.value, "name": _text(node.value, node)})
    else:
        lost.add("damping")


def _expand_file(
    children: dict[str, Node], keys: tuple[str, str], kind: str | None, faults: list[Fault], above: str = ""
) -> None:
    """Replace the file that stands at two keys by its absolute path; `above`: the keys above them, for messages."""
    parent = children.get(keys[0])
    node = parent.children.get(keys[1]) if parent else None
    if parent is None or node is None or not isinstance(node.value, str):
        return
    source = node.mark.source
    try:
        path = find(node.value, kind, source.folder, source.path) if kind else _plain_file(node.value, source.folder)
    except InputError as error:
        faults.append(Fault(node.mark, above + (keys[0] if node.mark == parent.mark else ".".join(keys)), str(error)))
        path = source.folder / "missing"
    children[keys[0]] = replace(
        parent, value={**parent.children, keys[1]: replace(node, value=Path(os.path.abspath(path)))}
    )


def _expand_spectrum(children: dict[str, Node], faults: list[Fault]) -> None:
    """Replace the file of a spectrum that a record is scaled to by its absolute path."""
    record = children.get("record")
    scale_to = record.children.get("scale_to") if record else None
    named = scale_to.children.get("spectrum") if scale_to else None
    if record is None or scale_to is None or named is None or str(named.value) in OF_CODE:
        return
    below = dict(record.children)
    _expand_file(below, ("scale_to", "spectrum"), None, faults, "record.")
    children["record"] = replace(record, value=below)


def _expand_recorded(children: dict[str, Node], faults: list[Fault]) -> None:
    """Fill in the runs of a case that names recordings, and their paths."""
    recorded = [run for run in RECORDED_RUNS if run in children and children[run].value is not None]
    if recorded:
        beside = children[recorded[0]]
        runs = tuple(Node(run, beside.mark) for run in ("sim", "sim_delay", *recorded))
        children.setdefault("runs", Node(runs, beside.mark, beside.key_mark))
    for run in recorded:
        if isinstance(children[run].value, dict):
            _expand_file(children, (run, "recording"), None, faults)


def _expand_real_rig(children: dict[str, Node], faults: list[Fault]) -> None:
    """Fill in what a rig that is not virtual changes in a case: its runs, its model file; make its files' paths whole.

    A file of such a rig need not be there before it is used: only the model file is looked for, where a case needs it.
    """
    table = children["table"]
    if "interface" in table.children:
        runs = tuple(Node(run, table.mark) for run in ACTUATOR_RUNS)
        children.setdefault("runs", Node(runs, table.mark, table.key_mark))
    if not is_real(table):
        return
    runs = tuple(Node(run, table.mark) for run in REAL_RUNS)
    children.setdefault("runs", Node(runs, table.mark, table.key_mark))
    children["table"] = table = _with_whole_paths(table)
    model = table.children.get("model")
    if model is not None and isinstance(model.value, Path):
        _use_model(children, model, faults)


def _with_whole_paths(table: Node) -> Node:
    """Return a real rig with the absolute paths of the files that it names."""
    parts = {key: _whole_path(part) for key, part in table.children.items() if key == "model"}
    udp = table.children.get("udp")
    if udp is not None and "key_file" in udp.children:
        parts["udp"] = replace(udp, value={**udp.children, "key_file": _whole_path(udp.children["key_file"])})
    return replace(table, value={**table.children, **parts})


def _use_model(children: dict[str, Node], model: Node, faults: list[Fault]) -> None:
    """Give a case that says nothing of a model the one of its rig."""
    options = children.get("identification", Node({}, model.mark, model.key_mark))
    if not isinstance(options.value, dict) or "model" in options.value:
        return
    if not os.path.isfile(str(model.value)):
        advice = "identify the rig (rths identify) and name its model file here, or under identification.model"
        faults.append(Fault(model.mark, "table.model", f"no such file: {printable(str(model.value))[:300]}; {advice}"))
    children["identification"] = replace(options, value={**options.value, "model": model})


def _with_calibration(rig: Node, above: str, faults: list[Fault]) -> Node:
    """Return a rig with the content of the calibration file that it names."""
    node = rig.children.get("calibration")
    if node is None or not isinstance(node.value, str):
        return rig
    try:
        path = Path(os.path.abspath(_plain_file(node.value, node.mark.source.folder)))
    except InputError as error:
        advice = "rths calibrate writes one; remove the key until there is one"
        faults.append(Fault(node.mark, f"{above}calibration", f"{error}, or {advice}"))
        return replace(rig, value={key: one for key, one in rig.children.items() if key != "calibration"})
    _, tree, found = read_file(path)
    faults += found
    if tree is None or not isinstance(tree.value, dict):
        if not found:
            told = f"{display(path)} holds no keys of a calibration; rths calibrate writes one"
            faults.append(Fault(node.mark, f"{above}calibration", told))
        return replace(rig, value={key: one for key, one in rig.children.items() if key != "calibration"})
    return replace(rig, value={**rig.children, "calibration": replace(tree, key_mark=node.key_mark)})


def _with_law_files(structure: Node, above: str, faults: list[Fault]) -> Node:
    """Return a structure with the absolute path and the checksum of every file that a law of a storey names."""
    numerical = structure.children.get("numerical")
    if numerical is not None and "kind" in numerical.children:
        program = _with_masses(_with_law_file(numerical, f"{above}numerical", faults), f"{above}numerical", faults)
        return replace(structure, value={**structure.children, "numerical": program})
    law = numerical.children.get("law") if numerical is not None else None
    if numerical is None or law is None:
        return structure
    law = _with_law_file(law, f"{above}numerical.law", faults)
    return replace(
        structure,
        value={**structure.children, "numerical": replace(numerical, value={**numerical.children, "law": law})},
    )


def _with_masses(program: Node, key: str, faults: list[Fault]) -> Node:
    """Return a program with the masses of its OpenSees model, where the file leaves them to the model."""
    kind = program.children["kind"]
    if kind.value != "opensees" or "masses_kg" in program.children:
        return program
    try:
        asked = ProgramSpec.model_validate(plain(program)).description
    except ValidationError:
        return program  # the model of the whole file tells the faults
    from rths_cli.programs import described  # numpy, which no case without a program needs

    try:
        masses = described(asked).masses_kg.tolist()
    except InputError as error:
        faults.append(Fault(kind.mark, key, str(error)))
        masses = [1.0]
    named = Node(tuple(Node(mass, kind.mark) for mass in masses), kind.mark, kind.key_mark)
    return replace(program, value={**program.children, "masses_kg": named})


def _with_law_file(law: Node, key: str, faults: list[Fault]) -> Node:
    if isinstance(law.value, tuple):
        return replace(
            law, value=tuple(_with_law_file(one, f"{key}[{i + 1}]", faults) for i, one in enumerate(law.value))
        )
    node = law.children.get("file")
    if node is None or not isinstance(node.value, str):
        return law
    try:
        path = Path(os.path.abspath(_plain_file(node.value, node.mark.source.folder)))
        found = hashlib.sha256(path.read_bytes()).hexdigest()
    except (InputError, OSError) as error:
        faults.append(Fault(node.mark, f"{key}.file", str(error)))
        return replace(law, value={**law.children, "file": replace(node, value=node.mark.source.folder / "missing")})
    stated = law.children.get("sha256")
    if stated is not None and stated.value != found:
        told = f"is not that of {printable(path.name)}, which is {found}; read the file, then state its checksum"
        faults.append(Fault(stated.mark, f"{key}.sha256", told))
    checksum = stated or Node(found, node.mark, node.key_mark)
    return replace(law, value={**law.children, "file": replace(node, value=path), "sha256": checksum})


def _with_matrix_files(structure: Node, above: str, faults: list[Fault]) -> Node:
    """Return a structure with the absolute path and the checksum of every file of a matrix that it names."""
    for name in ("mass", "stiffness", "influence"):
        structure = _with_file_at(structure, ("numerical", "matrices", name), above.rstrip("."), faults)
    for level in structure.children["damping_levels"].children if "damping_levels" in structure.children else ():
        structure = _with_file_at(structure, ("damping_levels", level, "matrix"), above.rstrip("."), faults)
    return structure


def _with_file_at(node: Node, keys: tuple[str, ...], above: str, faults: list[Fault]) -> Node:
    """Return a mapping in which the name of a file at nested keys is a mapping with its path and checksum."""
    below = node.children.get(keys[0])
    if below is None:
        return node
    where = f"{above}.{keys[0]}".lstrip(".")
    if len(keys) > 1:
        found = _with_file_at(below, keys[1:], where, faults) if isinstance(below.value, dict) else below
    elif below.value == "ones" or not isinstance(below.value, str | dict):
        found = below
    else:
        found = _with_law_file(_long_form(below, "file"), where, faults)
    return replace(node, value={**node.children, keys[0]: found})


def _whole_path(node: Node) -> Node:
    """Return the node of a file's name with its absolute path; anything else as it is."""
    if not isinstance(node.value, str) or not node.value.strip() or "\0" in node.value:
        return node  # the model refuses what names no file
    return replace(node, value=Path(os.path.abspath(node.mark.source.folder / os.path.expanduser(node.value))))


def _plain_file(name: str, folder: Path) -> Path:
    """Return an existing file given by its path relative to `folder`."""
    path = folder / os.path.expanduser(name)
    if not os.path.isfile(path):
        raise InputError(f"no such file: {printable(str(path))[:300]}; check the path")
    return path
