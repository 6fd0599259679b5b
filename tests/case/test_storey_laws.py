"""Laws of storeys in a structure file: what may be stated, and one sentence for what may not."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from schema_validators import validator

from rths_cli.case.load import load_cases, load_structure, resolved_yaml
from rths_cli.errors import InputError

CASE = "el_centro_low_ff"
BILINEAR = {"kind": "bilinear", "yield_displacement_m": 0.004}
YIELDS = "{{kind: bilinear, yield_displacement_m: 0.004, hardening: {}}}"
MAXWELL = {"kind": "maxwell", "spring_n_per_m": 1000, "dashpot_n_s_per_m": 50}


def told(law: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as refused:
        load_cases([CASE], (f"structure.numerical.law={law}",))
    return refused.value.faults


@pytest.mark.parametrize(
    ("law", "field", "says"),
    [
        ("{kind: bilinear}", "law.yield_displacement_m", "is missing"),
        ("{kind: bilinear, yield_displacement_m: 0}", "yield_displacement_m", "must be > 0"),
        ("{kind: bilinear, yield_displacement_m: 0.004, hardening: 1.1}", "hardening", "<= 1"),
        ("{kind: bilinear, yield_displacement_m: 0.004, hardening: -0.1}", "hardening", ">= 0"),
        ("{kind: bilinear, yield_displacement_m: 4 mm}", "yield_displacement_m", "must be a number"),
        ("{kind: bilinear, yield_displacement_m: 0.004, gap_m: 1}", "gap_m", "yield_displacement_m"),
        ("{kind: clough, yield_displacement_m: 0.004, unloading_exponent: 0.6}", "unloading_exponent", "<= 0.5"),
        ("{kind: bouc_wen, yield_displacement_m: 0.004, exponent: 0.5}", "exponent", ">= 1"),
        ("{kind: bouc_wen, yield_displacement_m: 0.004, beta: 0.5, gamma: -0.5}", "gamma", "must be > -beta = -0.5"),
        ("{kind: bouc_wen, yield_displacement_m: 0.004, zeta_s: 1}", "zeta_s", "< 1"),
        ("{kind: bouc_wen, yield_displacement_m: 0.004, psi: 0}", "psi", "> 0"),
        ("{kind: elastic_gap, gap_m: -0.001, contact_n_per_m: 1}", "gap_m", ">= 0"),
        ("{kind: elastic_gap, gap_m: 0.001}", "contact_n_per_m", "is missing"),
        ("{kind: friction}", "law", "force_n"),
        ("{kind: friction, force_n: 2, coefficient: 0.1}", "law", "force_n"),
        ("{kind: friction, force_n: 2, radius_m: 0}", "radius_m", "> 0"),
        ("{kind: friction, force_n: 2, sticking_displacement_m: 0}", "sticking_displacement_m", "> 0"),
        ("{kind: viscous_power, coefficient: 1, exponent: 0}", "exponent", "> 0"),
        ("{kind: viscous_power, coefficient: -1, exponent: 0.5}", "coefficient", ">= 0"),
        ("{kind: maxwell, spring_n_per_m: 1000, dashpot_n_s_per_m: 0}", "dashpot_n_s_per_m", "> 0"),
        ("{kind: maxwell, spring_n_per_m: .inf, dashpot_n_s_per_m: 1}", "spring_n_per_m", "finite"),
        ("{kind: cubic, cubic_n_per_m3: 1e8}", "largest_drift_m", "is missing"),
        ("{kind: bilinaer, yield_displacement_m: 0.004}", "kind", "did you mean bilinear?"),
        ("{kind: bouc_wen, yield_displacement_m: 0.004, zeta_s: 0.5, lambda: 0}", "lambda", "> 0 with zeta_s > 0"),
        ("{yield_displacement_m: 0.004}", "law", "law: kind is missing; add it"),
        ("{kind: [bilinear]}", "kind", "no law is called"),
        ("bilinear", "law", "must be a law such as"),
        ("3", "law", "must be a law such as"),
        ("[bilinear]", "law", "must be a law such as {kind: cubic, ...}, a list of laws, or nothing"),
        ("[[3]]", "law", "must be a law"),
        ("[null, {kind: bilinear, yield_displacement_m: 0.004}]", "law", "storey"),
        ("[]", "law", "storey"),
        (f"[[{YIELDS.format(0.05)}, {YIELDS.format(0.05)}]]", "law", "take 1.9 times"),
        (f"[[{{kind: clough, yield_displacement_m: 0.004}}, {YIELDS.format(0.9)}]]", "law", "clough may lose all"),
        (
            f"[[{{kind: softening, share: 0.3}}, {{kind: friction, force_n: 1}}, {YIELDS.format(0)}]]",
            "law",
            "softening and bilinear",
        ),
    ],
)
def test_a_faulty_law_is_told_in_one_sentence(law: str, field: str, says: str) -> None:
    (fault,) = told(law)
    assert field in fault and says in fault and "\n" not in fault


def test_every_fault_of_several_laws_is_told() -> None:
    faults = told("[[{kind: bilinear, yield_displacement_m: 0}, {kind: maxwell, spring_n_per_m: 0}]]")
    assert len(faults) == 3


@pytest.mark.parametrize(
    ("law", "fits"),
    [
        (BILINEAR, True),
        ([BILINEAR], True),
        ([[BILINEAR, MAXWELL]], True),
        ([[{**BILINEAR, "hardening": 0.6}, {**BILINEAR, "yield_displacement_m": 0.008, "hardening": 0.4}]], True),
        ([None], True),
        (None, True),
        ([[None]], False),
        ([[[BILINEAR]]], False),
        ("bilinear", False),
        ({**BILINEAR, "gap_m": 1}, False),
        ({**BILINEAR, "hardening": 2}, False),
    ],
)
def test_the_json_schema_reads_laws_as_the_loader_does(law: Any, fits: bool) -> None:
    structure = {
        "numerical": {"masses_kg": [7], "stiffness_n_per_m": [7000], "law": law},
        "experimental": {"masses_kg": [7], "stiffness_n_per_m": [7000], "damping_ratios": [0.02]},
    }
    assert validator("structure").is_valid(structure) == fits
    if fits:
        assert len(load_cases([CASE], (f"structure.numerical.law={as_yaml(law)}",))) == 1
    else:
        assert told(as_yaml(law))


def as_yaml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {as_yaml(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_yaml, value)) + "]"
    return "null" if value is None else str(value)


OWN = "{kind: own, file: laws/mine.py, parameters: {k: 1}, largest_drift_m: 0.01}"


def test_the_file_of_an_own_law_is_looked_up_beside_the_file_that_names_it_and_pinned(lab: Path, write: Any) -> None:
    """Its code is not run by reading a case: it would fail."""
    for folder, text in (("configs/structures/laws", "1 / 0"), ("laws", "1 / 1")):
        Path(folder).mkdir(parents=True, exist_ok=True)
        Path(folder, "mine.py").write_text(text)
    named = "extends: three_storey\nnumerical: {law: LAW}\n"
    write(name="configs/structures/own.yaml", text=named.replace("LAW", OWN))
    (of_structure,) = load_cases([CASE], ("structure=own",))
    (of_settings,) = load_cases([CASE], (f"structure.numerical.law={OWN}",))
    laws = [case.structure.numerical.law[0][0] for case in (of_structure, of_settings)]
    assert [law.file for law in laws] == [
        Path("configs/structures/laws/mine.py").absolute(),
        Path("laws/mine.py").absolute(),
    ]
    assert [law.sha256 for law in laws] == [sha256(text).hexdigest() for text in (b"1 / 0", b"1 / 1")]
    assert load_structure("own")[0].numerical.law == of_structure.structure.numerical.law
    text = resolved_yaml(of_settings)
    assert load_cases([write(name="again.yaml", text=text)])[0].structure == of_settings.structure
    Path("laws/mine.py").write_text("1 / 2")
    with pytest.raises(InputError) as refused:
        load_cases(["again.yaml"])
    (fault,) = refused.value.faults
    assert "structure.numerical.law[1][1].sha256: is not that of mine.py, which is " in fault


@pytest.mark.parametrize(
    ("law", "says"),
    [
        (OWN, "law.file: no such file: "),
        ("{kind: own, file: 3, largest_drift_m: 0.01}", "law.file"),
        ("{kind: own, largest_drift_m: 0.01}", "law: give file or installed"),
        ("{kind: own, installed: one}", "largest_drift_m: is missing"),
        ("{kind: own, installed: one, largest_drift_m: 1, parameters: {k: one}}", "parameters.k: must be a number"),
        ("{kind: own, installed: one, largest_drift_m: 1, sha256: abc}", "sha256: is the checksum of file"),
    ],
)
def test_an_own_law_that_cannot_be_is_one_sentence(lab: Path, law: str, says: str) -> None:
    (fault,) = told(law)
    assert says in fault
