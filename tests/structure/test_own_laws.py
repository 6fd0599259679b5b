"""A user's own law: what it may do, and one sentence for each property that it lacks."""

from __future__ import annotations

import math
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import faulty_law
import pytest
import several_laws

from rths_cli.errors import InputError
from rths_cli.files import user_code
from rths_cli.structure import own_laws
from rths_cli.structure.own_laws import Own, own_law
from rths_cli.structure.storey_laws import Tangents

FAULTY, SEVERAL = Path(faulty_law.__file__), Path(several_laws.__file__)
GOOD = (Path(__file__).parents[2] / "examples" / "own_law" / "yields.py").read_text(encoding="utf-8")
NUMBERS = {"stiffness_n_per_m": 7000.0, "yield_displacement_m": 0.002, "hardening": 0.1}


def of_file(file: Path, parameters: dict[str, float], sha256: str | None = None) -> Own:
    return own_law(
        SimpleNamespace(file=file, sha256=sha256, installed=None, parameters=parameters, largest_drift_m=0.02)
    )


def faults_of(file: Path, parameters: dict[str, float], sha256: str | None = None) -> tuple[str, ...]:
    with pytest.raises(InputError) as refused:
        of_file(file, parameters, sha256)
    return refused.value.faults


def with_fault(fault: int, rounds: float = 0.0, declared: float = 0.0) -> dict[str, float]:
    return {"fault": float(fault), "rounds": rounds, "declared": declared}


def test_a_law_of_a_file_has_its_numbers_and_tangents_in_the_order_of_its_parameters(tmp_path: Path) -> None:
    (tmp_path / "yields.py").write_text(GOOD)
    law = of_file(tmp_path / "yields.py", dict(reversed(NUMBERS.items())))
    assert law.numbers[:3] == (7000.0, 0.002, 0.1) and law.numbers[-1] == 0.0
    assert law.yield_drift_m == 0.002
    assert law.tangents == Tangents((-6300.0, 0.0)) and law.address != 0 and not law.linear
    missing, unknown = faults_of(tmp_path / "yields.py", {"k": 1.0, **dict(list(NUMBERS.items())[1:])})
    assert "yields.py: parameters.stiffness_n_per_m is missing" in missing
    assert "parameters.k: unknown; the law has stiffness_n_per_m, yield_displacement_m, hardening" in unknown
    (changed,) = faults_of(tmp_path / "yields.py", NUMBERS, "0" * 64)
    assert "has changed since the case was read" in changed


def test_a_law_of_a_package_is_found_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    def installed(group: str, name: str | None = None) -> list[EntryPoint]:
        points = [EntryPoint("several", "several_laws", group), EntryPoint("lost", "no_such_module", group)]
        return [point for point in points if group == "rths.laws" and name in (None, point.name)]

    monkeypatch.setattr(user_code, "entry_points", installed)
    stated = {"which": 1.0, "a": 1e6, "b": 0.02, "c": 0.0}

    def law(name: str) -> Own:
        return own_law(SimpleNamespace(file=None, sha256=None, installed=name, parameters=stated, largest_drift_m=0.02))

    assert law("several").tangents.stiffness == (0.0, pytest.approx(1200.0))
    assert math.isnan(law("several").yield_drift_m)
    with pytest.raises(InputError, match=r"0 installed packages bring a law 'other'.*installed: lost, several"):
        law("other")
    with pytest.raises(InputError, match=r"law lost \(no_such_module\) cannot be loaded: ModuleNotFoundError"):
        law("lost")


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("fault", "says"),
    [
        (faulty_law.CHANGES, "changes parameters or state"),
        (faulty_law.READS, "gives another result when it is called again"),
        (faulty_law.LEAVES, "must write all 1 numbers of next_state"),
        (faulty_law.INFINITE, "is not finite, at a drift of 0.01"),
        (faulty_law.STEEP, "stiffness outside of what tangents declares, 0 to 120 N/m"),
        (faulty_law.JUMPS, "stiffness outside of what tangents declares"),
        (faulty_law.DASHPOT, "dashpot outside of what tangents declares, 0 to 0 N s/m"),
        (faulty_law.AT_REST, "must be 0; shift it"),
        (faulty_law.TANGENT, "tangent 5 N/m at rest, which must be 0"),
        (faulty_law.BEYOND, "beyond its arrays: it has 3 PARAMETERS and 1 STATES"),
    ],
)
def test_each_property_that_a_law_lacks_is_one_sentence(fault: int, says: str) -> None:
    (told,) = faults_of(FAULTY, with_fault(fault))
    assert told.startswith("structure.numerical.law: faulty_law.py: force ") and says in told


@pytest.mark.campaign
@pytest.mark.parametrize("at_m", [-0.0123, 0.0077])
def test_a_small_jump_beside_a_steep_slope_is_found(tmp_path: Path, at_m: float) -> None:
    """0.5 N where the law yields, with -6,300 N/m: over the drifts of a sample it is no stiffness beyond that."""
    old = "return -(1.0 - hardening) * stiffness * slider"
    assert old in GOOD
    (tmp_path / "jumps.py").write_text(
        GOOD.replace(old, f"{old} + (0.5 if drift_m {'>' if at_m > 0 else '<'} {at_m} else 0.0)")
    )
    (told,) = faults_of(tmp_path / "jumps.py", NUMBERS | {"yield_displacement_m": 0.0005})
    assert "let the force have no jumps" in told


def test_without_a_fault_it_is_a_law() -> None:
    assert of_file(FAULTY, with_fault(faulty_law.NONE)).parameters == (0.0, 0.0, 0.0)


def test_a_law_that_takes_long_is_refused_and_one_that_does_not_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """30,000 sines take some hundred us, and the trial a second."""
    (slow,) = faults_of(FAULTY, with_fault(0, rounds=3e4))
    assert "us per call, at most 20 us; shorten its loops" in slow
    monkeypatch.setattr(own_laws, "LONGEST_TRIAL_S", 0.01)
    (lost,) = faults_of(FAULTY, with_fault(0, rounds=3e4 + 1))
    assert "has not come back within 0.01 s; bound its loops" in lost


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("    next_state[0] = slider\n", "    while slider > 1.0:\n        slider -= 1.0\n", "while has no bound"),
        ("    next_state[0] = slider\n", "    assert slider < 1.0\n", "nothing may be raised while a table moves"),
        ("return -(1.0", "return force(parameters, state, next_state, 0.0, 0.0) - (1.0", "force calls itself"),
        ("STATES = 1", "STATES = 9", "STATES must be a whole number from 0 to 8"),
        ("PARAMETERS = (", "PARAMETERS = *range(20), (", "PARAMETERS must be a tuple of at most 15 names"),
        ("def force(", "def forces(", "has no function force(parameters, state"),
        ("drift_m, velocity_m_s)", "drift_m)", "has no function force(parameters, state"),
        ("def tangents(", "def tangent(", "has no function tangents(parameters)"),
        ("def force(", "def force(:", "cannot be loaded: SyntaxError"),
        ("STATES = 1", "import no_such_module", "cannot be loaded: ModuleNotFoundError"),
        ("STATES = 1", "raise SystemExit(0)", "cannot be loaded: SystemExit"),
    ],
)
def test_what_the_text_of_a_law_shows_is_told_before_it_is_compiled(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    assert old in GOOD
    (tmp_path / "bad.py").write_text(GOOD.replace(old, new))
    (told,) = faults_of(tmp_path / "bad.py", NUMBERS)
    assert told.startswith("structure.numerical.law: bad.py") and says in told


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "    next_state[0] = slider\n",
            "    next_state[0] = [slider, slider].copy()[1]\n",
            "makes arrays, draws random",
        ),
        *(
            ("    next_state[0] = slider\n", f"    next_state[0] = {new}\n", "numba cannot compile force: ")
            for new in (
                "str(slider)",
                "slider\n    import math",
                "slider\n    class Other: pass",
                "slider\n    global OTHER\n    OTHER = 1.0",
                "dict(**{'a': slider})['a']",
                "float(f'{slider}')",
                "parameters[...][0]",
            )
        ),
    ],
)
def test_code_that_cannot_run_while_a_table_moves_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    (tmp_path / "bad.py").write_text(GOOD.replace(old, new))
    (told,) = faults_of(tmp_path / "bad.py", NUMBERS)
    assert says in told


@pytest.mark.parametrize(
    ("declared", "says"),
    [
        (1, "must return softest <= 0 <= stiffest"),
        (2, "must return two finite numbers"),
        (3, "least <= greatest"),
        (4, "must return two finite numbers"),
        (5, "tangents failed: TypeError"),
    ],
)
def test_tangents_that_are_none_are_refused(declared: int, says: str) -> None:
    (told,) = faults_of(FAULTY, with_fault(0, declared=float(declared)))
    assert says in told
