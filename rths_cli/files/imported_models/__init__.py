"""A table model identified elsewhere: zeros, poles and gain, or a quotient of polynomials, with a delay.

What is read becomes command (V) to table acceleration (m/s^2),
G(s) = gain * prod(s - zeros) / prod(s - poles) * exp(-s delay_s), roots in rad/s, whatever form it was stated in:

- `output: velocity_m_s` or `displacement_m` adds one or two zeros at the origin;
- `frequency_unit: Hz` means that roots, gain and coefficients belong to a function of s' = jf instead of s = j 2 pi f
  (SEED manual, transfer function type B): roots grow by 2 pi, the gain by (2 pi)^(poles - zeros), so that the
  response at each frequency is the stated one;
- numerator and denominator are coefficients of descending powers.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rths_cli.case.yaml_tree import display
from rths_cli.errors import InputError
from rths_cli.files.durable_files import read_whole
from rths_cli.files.imported_models.checked_values import Reader
from rths_cli.files.imported_models.file_formats import KEYS, kind_of, read_mat, read_text
from rths_cli.files.imported_models.poles_and_zeros import count_at_origin, paired, shown
from rths_cli.numerics.lti import Array, ComplexArray

OUTPUTS = {"acceleration_m_s2": 0, "velocity_m_s": 1, "displacement_m": 2}
"""What a model's output may be, and how many zeros at the origin make it an acceleration."""
ORIGIN_ZEROS = 2  # the table follows displacement
MAX_BYTES = 100_000_000
MAX_ROOTS = 40
MAX_ROOT_RAD_S = 1e7
MAX_DELAY_S = 1.0
MAX_FREQUENCY_HZ = 1e6


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
        reader.say(key, f"{shown(right)} rad/s not in the left half plane, the model is unstable; fit a stable one")
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
        reader.say(key, f"{shown(right)} rad/s {why}; fit a minimum-phase one and give its lag as delay_s")
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
        reader.say(key, f"{shown(large)} rad/s is beyond {MAX_ROOT_RAD_S:g} in magnitude; check frequency_unit")
    ordered, lonely = paired(roots)
    if lonely.size:
        missing = f"add {shown(np.conj(lonely))}"
        reader.say(key, f"must come in conjugate pairs; {shown(lonely)} rad/s stands alone, {missing}")
    return ordered, roots[roots.real >= 0.0]
