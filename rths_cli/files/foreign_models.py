"""Models of a table that other programs wrote: poles and zeros, transfer functions and state spaces in YAML, JSON,
.npz and .mat.

What is read becomes command (V) to table acceleration (m/s^2),
G(s) = gain * prod(s - zeros) / prod(s - poles) * exp(-s delay_s), roots in rad/s, whatever form it was stated in:

- `output: velocity_m_s` or `displacement_m` adds one or two zeros at the origin;
- `frequency_unit: Hz` means that roots, gain and coefficients belong to a function of s' = jf instead of s = j 2 pi f
  (SEED manual, transfer function type B): roots grow by 2 pi, the gain by (2 pi)^(poles - zeros), so that the
  response at each frequency is the stated one;
- numerator and denominator are coefficients of descending powers.

Nothing is judged here but form: a value is a number, a list of numbers, or text. What is not goes to the faults,
and its key stays with the value None, so that nobody calls it missing as well.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from rths_cli.case.field_types import near, shown
from rths_cli.case.yaml_reader import Fault, Mark, Node, Source, display, parse, plain, printable, read_file
from rths_cli.errors import InputError
from rths_cli.files.durable_files import open_regular, read_whole
from rths_cli.files.matlab_files import MatlabObject, Value, matlab_variables
from rths_cli.numerics.lti import Array, ComplexArray

AT_ORIGIN = 1e-6  # of the smallest other root
PAIRED = 1e-6  # relative distance of a root from the conjugate of its partner
REAL = 1e-9  # imaginary part over magnitude of a real root

KEYS: dict[str, tuple[str, ...]] = {
    "zeros": ("z",),
    "poles": ("p",),
    "gain": ("k",),
    "numerator": ("num",),
    "denominator": ("den",),
    "delay_s": ("delay", "Td", "InputDelay", "iodelay", "IODelay"),
    "output": (),
    "frequency_unit": (),
    "band_hz": (),
    "ripple_m_s2_per_v": (),
    "notes": (),
    "sample_time_s": ("Ts",),
}
"""What a file may state, with the other names it may have in a MATLAB file."""
TEXTS = ("output", "frequency_unit", "notes")
PAIRS = ("zeros", "poles")
HEAD = 4096
MAX_NUMBERS = 1000  # of a vector in a MATLAB file
DEPTH = 3  # of cells in each other
Kind = Literal["text", "mat", "other"]
OUTPUTS = {"acceleration_m_s2": 0, "velocity_m_s": 1, "displacement_m": 2}
"""What a model's output may be, and how many zeros at the origin make it an acceleration."""
ORIGIN_ZEROS = 2  # the table follows displacement
MAX_BYTES = 100_000_000
MAX_ROOTS = 40
MAX_ROOT_RAD_S = 1e7
MAX_DELAY_S = 1.0
MAX_FREQUENCY_HZ = 1e6


def count_at_origin(zeros: ComplexArray, poles: ComplexArray) -> int:
    """Return how many zeros are at the origin: below 1e-6 of the smallest of all other roots."""
    size = np.sort(np.abs(zeros))
    other = np.abs(poles)[np.abs(poles) > 0.0]
    for count in range(len(size), 0, -1):
        smallest = min([*size[count:], *other], default=0.0)
        if size[count - 1] == 0.0 or size[count - 1] < AT_ORIGIN * smallest:
            return count
    return 0


def paired(roots: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return conjugate pairs, then real roots, each by rising magnitude; and the roots without a partner."""
    rising = roots[np.argsort(np.abs(roots), kind="stable")]
    real = np.abs(rising.imag) <= REAL * np.abs(rising)
    lower = list(rising[~real & (rising.imag < 0.0)])
    ordered, lonely = [], []
    for root in rising[~real & (rising.imag > 0.0)]:
        distance = [abs(other - np.conj(root)) for other in lower]
        if not lower or min(distance) > PAIRED * abs(root):
            lonely.append(root)
            continue
        middle = 0.5 * (root + np.conj(lower.pop(int(np.argmin(distance)))))
        ordered += [middle, np.conj(middle)]
    return np.array([*ordered, *rising[real].real], dtype=complex), np.array(lonely + lower, dtype=complex)


def shown_roots(roots: ComplexArray) -> str:
    """Return up to three roots as text."""
    texts = [f"{root.real:.6g}{root.imag:+.6g}j" if root.imag else f"{root.real:.6g}" for root in roots[:3]]
    return ", ".join(texts) + (", ..." if len(roots) > 3 else "")


@dataclass(frozen=True)
class Entry:
    """One value of a file: text, one number (), or numbers (n,); `name` is its name in the file."""

    name: str
    value: ComplexArray | str | None
    mark: Mark


@dataclass
class Document:
    """What a file states, by the keys of KEYS, its faults so far, and notes for the user."""

    mark: Mark
    entries: dict[str, Entry] = field(default_factory=dict)
    faults: list[Fault] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def kind_of(path: Path) -> Kind:
    """Tell by its first bytes whether a file is text or of MATLAB; `other` is a file of rths, or none of these."""
    try:
        with open_regular(path) as file:
            head = file.read(HEAD)
    except OSError:
        return "other"
    if head.startswith(b"MATLAB"):
        return "mat"
    if not head or head.startswith(b"rths-"):
        return "other"
    if path.suffix.lower() == ".mat":
        return "mat"
    return "other" if b"\0" in head else "text"


def read_text(path: Path) -> Document:
    """Read a YAML or JSON file; unknown keys are faults."""
    text, tree, faults = read_file(path)
    source = Source(display(path), path.absolute().parent, path.absolute())
    if "\t" in text and text.lstrip().startswith("{"):  # YAML forbids the tabs that JSON may be indented with
        tree, faults = parse(text.replace("\t", " "), source)
    document = Document(tree.mark if tree else Mark(source), faults=list(faults))
    if tree is not None and not isinstance(tree.value, dict):
        document.faults.append(Fault(tree.mark, "", "must hold the keys of a model: zeros, poles and gain"))
    for name, node in tree.children.items() if tree else ():
        if name in KEYS:
            document.entries[name] = _entry(document, name, node)
        else:
            document.faults.append(Fault(node.place, printable(name)[:80], f"unknown key{near(name, KEYS)}"))
    return document


def _entry(document: Document, name: str, node: Node) -> Entry:
    """Return the value of a YAML key; what is of a wrong form becomes a fault at its own place."""
    if name in TEXTS:
        if isinstance(node.value, str):
            return Entry(name, node.value, node.mark)
        document.faults.append(Fault(node.mark, name, f"must be text, got {shown(plain(node))}"))
        return Entry(name, None, node.mark)
    items = node.value if isinstance(node.value, tuple) else (node,)
    pairs = name in PAIRS and isinstance(node.value, tuple)
    numbers = [_number(item, pairs) for item in items]
    wanted = "a number or a pair [real, imaginary]" if pairs else "a number"
    wrong = [item for item, number in zip(items, numbers, strict=True) if number is None]
    told = {fault.mark for fault in document.faults}
    for item in wrong:
        if item.mark not in told:
            document.faults.append(Fault(item.mark, name, f"must be {wanted}, got {shown(plain(item))}"))
    if wrong:
        return Entry(name, None, node.mark)
    values: ComplexArray = np.array(numbers if isinstance(node.value, tuple) else numbers[0], dtype=complex)
    return Entry(name, values, node.mark)


def _number(node: Node, pairs: bool) -> complex | None:
    """Return a real number, or a pair as a complex one; None for anything else."""
    if pairs and isinstance(node.value, tuple) and len(node.value) == 2:
        real, imag = (_number(part, False) for part in node.value)
        return None if real is None or imag is None else complex(real.real, imag.real)
    if isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return complex(node.value)
    return None


def read_mat(path: Path) -> Document:
    """Read the variables of a MATLAB file (v5 or v7.3) that have a name of KEYS; others are noted."""
    document = Document(Mark(Source(display(path), path.absolute().parent, path.absolute())))
    wanted = [name for key, others in KEYS.items() for name in (key, *others)]
    try:
        variables = matlab_variables(path, wanted)
    except ValueError:
        message = "cannot be read as a MATLAB file, it is damaged or none at all; save z, p and k again"
        document.faults.append(Fault(document.mark, "", message))
        return document
    for key, others in KEYS.items():
        given = [name for name in (key, *others) if name in variables]
        if len(given) > 1:
            message = f"give {' or '.join(given)}, not both" if key != "delay_s" else _one_delay(given)
            document.faults.append(Fault(document.mark, given[1], message))
        if given:
            document.entries[key] = _variable(document, given[0], variables[given[0]])
    _tell_unused(document, variables, wanted, path)
    return document


def _one_delay(given: list[str]) -> str:
    return f"stands beside {given[0]}; save the sum of all delays as delay_s"


def _variable(document: Document, name: str, value: Value) -> Entry:
    """Return a variable's number, numbers (n,) or text; what is of a wrong form becomes a fault."""
    for _ in range(DEPTH):  # cells of one entry are opened
        if isinstance(value, tuple) and len(value) == 1:
            value = value[0]
    if isinstance(value, list) and len(value) == 1:
        return Entry(name, value[0], document.mark)
    numbers = np.zeros(0) if isinstance(value, list | tuple) and not value else value
    if (
        isinstance(numbers, np.ndarray)
        and numbers.size <= MAX_NUMBERS
        and numbers.size in (0, max((1, *numbers.shape)))
    ):
        return Entry(name, numbers.reshape(-1).astype(complex), document.mark)
    document.faults.append(Fault(document.mark, name, _why_not(value)))
    return Entry(name, None, document.mark)


def _why_not(value: Value) -> str:
    """Return the sentence on a value that is neither numbers nor a text."""
    if isinstance(value, tuple):
        return f"is a cell array of {len(value)} entries; save one input and one output of the model"
    if isinstance(value, MatlabObject):
        return f"must be numbers, got a MATLAB {value.class_name} object"
    if isinstance(value, np.ndarray):
        shape = " x ".join(map(str, value.shape))
        return f"must be a vector of at most {MAX_NUMBERS}, got {shape} numbers"
    return "must be numbers, got a structure or something else"


def _tell_unused(document: Document, variables: Mapping[str, Value], used: list[str], path: Path) -> None:
    """Add a fault when an object of MATLAB stands where roots are looked for, else a note on what was not used."""
    unused = [printable(name)[:60] for name in variables if name not in used]
    objects = {name: value.class_name for name, value in variables.items() if isinstance(value, MatlabObject)}
    if not {"poles", "denominator"} & set(document.entries) and objects:
        name = next(iter(objects))
        message = (
            f"is a MATLAB {printable(objects[name])} object, which only MATLAB can read; "
            f"save its roots instead: [z,p,k] = zpkdata({name},'v'); save('{path.stem}_zpk.mat','z','p','k')"
        )
        document.faults.append(Fault(document.mark, printable(name)[:60], message))
    elif unused:
        document.notes.append(f"variables not used: {', '.join(unused[:10])}{', ...' if len(unused) > 10 else ''}")


@dataclass(frozen=True)
class Reader:
    """Take values out of a document and collect what is wrong with them."""

    document: Document

    @property
    def faults(self) -> list[Fault]:
        """Return the faults found so far, those of the document's form included."""
        return self.document.faults

    def say(self, key: str, sentence: str) -> None:
        """Add a fault at the place of a key, or of the document where it is not stated."""
        entry = self.document.entries.get(key)
        name, mark = (entry.name, entry.mark) if entry else (key, self.document.mark)
        self.faults.append(Fault(mark, name, sentence))

    def numbers(self, key: str) -> ComplexArray | None:
        """Return finite numbers (n,); None when the key is missing or unusable."""
        value = self._value(key)
        if isinstance(value, str):
            self.say(key, f"must be numbers, got {value[:40]!r}")
        if value is None or isinstance(value, str):
            return None
        numbers = np.atleast_1d(value)
        wrong = numbers[~np.isfinite(numbers)]
        if wrong.size:
            self.say(key, f"must be finite, got {wrong[0]:g}")
            return None
        return numbers

    def reals(self, key: str) -> Array | None:
        """Return finite real numbers (n,); None when the key is missing or unusable."""
        values = self.numbers(key)
        if values is not None and np.any(values.imag != 0.0):
            self.say(key, "must be real, got a complex number")
            return None
        return None if values is None else values.real

    def number(self, key: str) -> float | None:
        """Return one finite real number; None when the key is missing or unusable."""
        values = self.reals(key)
        if values is not None and values.size != 1:
            self.say(key, f"must be one number, got {values.size}")
            return None
        return None if values is None else float(values[0])

    def word(self, key: str, choices: tuple[str, ...]) -> str:
        """Return one of the choices, the first when the key is missing or unusable."""
        value = self._value(key)
        if value is None or (isinstance(value, str) and value in choices):
            return choices[0] if value is None else str(value)
        got = repr(value[:40]) if isinstance(value, str) else "numbers"
        self.say(key, f"must be {', '.join(choices[:-1])} or {choices[-1]}, got {got}")
        return choices[0]

    def text(self, key: str) -> str:
        """Return text, empty when the key is missing or unusable."""
        value = self._value(key)
        return printable(" ".join(value.split())) if isinstance(value, str) else ""

    def stated(self, *keys: str) -> list[str]:
        """Return those of the keys that the document states, usable or not."""
        return [key for key in keys if key in self.document.entries]

    def _value(self, key: str) -> ComplexArray | str | None:
        entry = self.document.entries.get(key)
        return entry.value if entry else None


@dataclass(frozen=True)
class ForeignModel:
    """Hold a table model from elsewhere: command (V) to table acceleration (m/s^2), roots in rad/s.

    `zeros` (m,): two at the origin, then conjugate pairs and real ones, each by rising magnitude; `poles` (n,)
    likewise. `ripple_m_s2_per_v` and `band_hz` are None where the file does not state them. `sha256` is that of the
    file's bytes; `notes` are sentences for the user.
    """

    path: Path
    sha256: str
    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    delay_s: float
    ripple_m_s2_per_v: float | None
    band_hz: tuple[float, float] | None
    notes: tuple[str, ...]


def is_foreign(path: Path) -> bool:
    """Tell by its content whether a file is text or of MATLAB, so that `read_foreign` is to read it or to refuse it."""
    return kind_of(Path(path)) != "other"


def read_foreign(path: Path) -> ForeignModel:
    """Read a table model from YAML, JSON or .mat (v5, v7.3); raise InputError with all of its faults at once."""
    path = Path(path)
    data = read_whole(path, MAX_BYTES, "a table model", "give zeros, poles and gain in YAML, JSON or .mat")
    sha256 = hashlib.sha256(data).hexdigest()
    kind = kind_of(path)
    if kind == "other":
        raise InputError(
            f"{display(path)}: is neither YAML or JSON text nor a MATLAB file; give zeros, poles and gain."
        )
    reader = Reader(read_text(path) if kind == "text" else read_mat(path))
    model = _model(reader, path, sha256)
    if model is None:
        faults = sorted(reader.faults, key=lambda fault: (fault.mark.line, fault.mark.column))
        raise InputError(*dict.fromkeys(str(fault) for fault in faults))
    return model


@dataclass(frozen=True)
class _Factors:
    """Roots in rad/s and gain, with the keys that faults about zeros, poles and gain are to name."""

    zeros: ComplexArray
    poles: ComplexArray
    gain: float
    keys: tuple[str, str, str]


def _model(reader: Reader, path: Path, sha256: str) -> ForeignModel | None:
    """Return the model of a document; None when faults were found."""
    output = reader.word("output", tuple(OUTPUTS))
    in_hz = reader.word("frequency_unit", ("rad/s", "Hz")) == "Hz"
    _refuse_discrete(reader)
    delay_s, band_hz = _delay(reader), _band(reader)
    ripple = reader.number("ripple_m_s2_per_v")
    stated = _factors(reader)
    if stated is None:
        return None
    factors = _in_rad_s(stated) if in_hz else stated
    zeros, poles = _checked_zeros(reader, factors, output), _checked_poles(reader, factors)
    if reader.faults:
        return None
    notes = [*_notes(output, in_hz), *reader.document.notes, reader.text("notes")]
    said = tuple(note for note in notes if note)
    return ForeignModel(path, sha256, zeros, poles, factors.gain, delay_s, ripple, band_hz, said)


def _notes(output: str, in_hz: bool) -> list[str]:
    """Return what was done to bring the model into the form of this project."""
    added = OUTPUTS[output]
    notes = [f"output {output} was made an acceleration by {added} zero{'s' * (added > 1)} at the origin"] * (added > 0)
    return notes + ["roots and gain were taken as those of a function of jf (Hz) and converted to rad/s"] * in_hz


def _refuse_discrete(reader: Reader) -> None:
    """Add a fault for a model with a sample time; MATLAB's continuous ones state 0."""
    interval = reader.reals("sample_time_s")
    if interval is not None and np.any(interval != 0.0):
        reader.say(
            "sample_time_s",
            f"is {interval[0]:g}, which is a discrete-time model; convert it with d2c and save the continuous one",
        )


def _delay(reader: Reader) -> float:
    """Return the delay in s, 0 where none is stated."""
    delay_s = reader.number("delay_s")
    if delay_s is not None and not 0.0 <= delay_s <= MAX_DELAY_S:
        reader.say("delay_s", f"must be >= 0 and <= {MAX_DELAY_S:g} s, got {delay_s:g}")
    return delay_s or 0.0


def _band(reader: Reader) -> tuple[float, float] | None:
    """Return the band in Hz in which the model is said to hold, None where none is stated."""
    band = reader.reals("band_hz")
    if band is None:
        return None
    if band.size != 2 or not 0.0 < band[0] < band[1] <= MAX_FREQUENCY_HZ:
        got = ", ".join(f"{value:g}" for value in band[:3])
        reader.say("band_hz", f"must be two frequencies, 0 < low < high <= {MAX_FREQUENCY_HZ:g}, got [{got}]")
        return None
    return float(band[0]), float(band[1])


def _factors(reader: Reader) -> _Factors | None:
    """Return the model as it was stated, roots not yet judged; None when that is not known."""
    roots = reader.stated("zeros", "poles", "gain")
    polynomials = reader.stated("numerator", "denominator")
    if roots and polynomials:
        reader.say(
            polynomials[0], f"stands beside {roots[0]}; give zeros, poles and gain, or numerator and denominator"
        )
        return None
    if not (roots or polynomials or reader.stated("delay_s", "output")) and reader.faults:
        return None  # nothing could be read, which has been said
    needed = ("numerator", "denominator") if polynomials else ("poles", "gain")
    for key in needed:
        if not reader.stated(key):
            reader.say(key, f"is missing; add it, in a MATLAB file as {key} or {KEYS[key][0]}")
    return _from_polynomials(reader) if polynomials else _from_roots(reader)


def _from_roots(reader: Reader) -> _Factors | None:
    """Return the stated zeros (none: an empty list), poles and gain."""
    zeros = reader.numbers("zeros") if reader.stated("zeros") else np.zeros(0, dtype=complex)
    poles, gain = reader.numbers("poles"), reader.number("gain")
    if gain == 0.0:
        reader.say("gain", "must be other than 0, got 0")
    if zeros is None or poles is None or gain is None:
        return None
    return _Factors(zeros, poles, gain, ("zeros", "poles", "gain"))


def _from_polynomials(reader: Reader) -> _Factors | None:
    """Return the roots of the stated coefficients of descending powers, and the quotient of the leading ones."""
    numerator, denominator = (_coefficients(reader, key) for key in ("numerator", "denominator"))
    if numerator is None or denominator is None:
        return None
    try:
        with np.errstate(all="ignore"):
            zeros, poles = (np.roots(c).astype(complex) for c in (numerator, denominator))
            gain = float(numerator[0] / denominator[0])
    except np.linalg.LinAlgError:
        gain = np.inf
    if not np.isfinite(gain) or gain == 0.0:
        reader.say("denominator", "has coefficients too far apart to find its roots; give zeros, poles and gain")
        return None
    return _Factors(zeros, poles, gain, ("numerator", "denominator", "numerator"))


def _coefficients(reader: Reader, key: str) -> Array | None:
    """Return coefficients that begin with one other than 0; None when there is none."""
    values = reader.reals(key)
    if values is None:
        return None
    significant = np.trim_zeros(values, "f")
    if not significant.size:
        reader.say(key, "must have a coefficient other than 0")
    elif significant.size > MAX_ROOTS + 1:
        reader.say(key, f"must have at most {MAX_ROOTS + 1} coefficients, got {significant.size}")
    else:
        return significant
    return None


def _in_rad_s(stated: _Factors) -> _Factors:
    """Return a function of s' = jf as the same function of s = j 2 pi f."""
    turn = 2.0 * np.pi
    gain = stated.gain * turn ** (len(stated.poles) - len(stated.zeros))
    return _Factors(stated.zeros * turn, stated.poles * turn, gain, stated.keys)


def _checked_poles(reader: Reader, factors: _Factors) -> ComplexArray:
    """Return poles in order; add faults where they are none, too many, unpaired, or not stable."""
    key = factors.keys[1]
    if not factors.poles.size:
        reader.say(key, "must give at least one pole")
    poles, right = _checked_roots(reader, key, factors.poles)
    if right.size:
        reader.say(
            key, f"{shown_roots(right)} rad/s not in the left half plane, the model is unstable; fit a stable one"
        )
    return poles


def _checked_zeros(reader: Reader, factors: _Factors, output: str) -> ComplexArray:
    """Return zeros of the acceleration in order, the origin's first; add faults for those a table cannot have."""
    key, added = factors.keys[0], OUTPUTS[output]
    stated = factors.zeros
    origin = count_at_origin(stated, factors.poles)
    others, right = _checked_roots(reader, key, stated[np.argsort(np.abs(stated), kind="stable")][origin:])
    if len(stated) + added > len(factors.poles) > 0:
        extra = f", {added} of them for output {output}" if added else ""
        many = f"got {len(stated) + added}{extra}, and {len(factors.poles)} poles"
        reader.say(key, f"must give at most as many zeros as there are poles; {many}; fit a proper model")
    if origin + added != ORIGIN_ZEROS:
        reader.say(key, _origin_sentence(output, origin))
    if right.size:
        why = "not in the left half plane, the model has no stable inverse"
        reader.say(key, f"{shown_roots(right)} rad/s {why}; fit a minimum-phase one and give its lag as delay_s")
    return np.concatenate([np.zeros(ORIGIN_ZEROS, dtype=complex), others])


def _origin_sentence(output: str, found: int) -> str:
    """Return why the zeros at the origin are too few or too many, and what to do."""
    wanted = ORIGIN_ZEROS - OUTPUTS[output]
    likely = [name for name, added in OUTPUTS.items() if added == ORIGIN_ZEROS - found]
    advice = "".join(f"state output: {name} if that is what the model gives, or " for name in likely)
    zeros, why = f"{wanted} zero{'s' * (wanted != 1)} at the origin", "the table follows displacement"
    return f"must have {zeros} for output {output}, because {why}; got {found}; {advice}fit with these zeros given"


def _checked_roots(reader: Reader, key: str, roots: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Return roots in order, and those not in the left half plane; add faults: too many, too large, unpaired."""
    if roots.size > MAX_ROOTS:
        reader.say(key, f"must be at most {MAX_ROOTS}, got {roots.size}")
    large = roots[np.abs(roots) > MAX_ROOT_RAD_S]
    if large.size:
        reader.say(key, f"{shown_roots(large)} rad/s is beyond {MAX_ROOT_RAD_S:g} in magnitude; check frequency_unit")
    ordered, lonely = paired(roots)
    if lonely.size:
        missing = f"add {shown_roots(np.conj(lonely))}"
        reader.say(key, f"must come in conjugate pairs; {shown_roots(lonely)} rad/s stands alone, {missing}")
    return ordered, roots[roots.real >= 0.0]
