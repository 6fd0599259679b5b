"""Slips that are common enough for a sentence of their own: each says how to write it."""

from __future__ import annotations

from pathlib import Path

import pytest

from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.files.accelerograms import read_accelerogram
from rths_cli.studies.study_plan import Asked, read_plan

CASE = "el_centro_low_ff_fb"
OWN = "structure: three_storey\ndamping: low\nrecord: el_centro\nscaling: 0.3\ncontroller: FF\n"


def told(*settings: str) -> tuple[str, ...]:
    with pytest.raises(InputError) as refused:
        load_cases([CASE], settings)
    return refused.value.faults


@pytest.mark.parametrize(
    ("setting", "ends"),
    [
        ("scaling=30%", "must be a number, got '30%'; write 0.3"),
        ("scaling='12,5 %'", "must be a number, got '12,5 %'; write 0.125"),
        ("scaling=0,3", "must be a number, got '0,3'; write 0.3"),
        ("scaling=0.1,0.2", "got '0.1,0.2'; for several values: rths sweep CASE --vary scaling=0.1,0.2"),
        ("controller=FF,FF+FB", "got 'FF,FF+FB'; for several values: rths sweep CASE --vary controller=FF,FF+FB"),
        ("scaling=lots", "must be a number, got 'lots'"),
        ("delay_s=5", "must be >= 0 and <= 0.1 s, got 5; 5 ms are 0.005 s"),
        ("delay_s=500", "must be >= 0 and <= 0.1 s, got 500"),
        ("sample_rate_hz=2", "must be >= 100 and <= 50000 Hz, got 2; 2 kHz are 2000 Hz"),
        ("scaling=0", "got 0; a factor on the record, 1 plays it as it is"),
        ("physics.coulomb_n=0", "unknown key; did you mean table.physics.coulomb_n?"),
        ("damping.ratio=0.02", "--set damping.ratio: unknown key; did you mean damping.first_mode_ratio?"),
        ("structure.experimental.masses_kg=[]", "is empty; put at least one storey into the list"),
        ("structure.numerical.masses_kg[1]=12", "set the whole list: structure.numerical.masses_kg=[...]"),
    ],
)
def test_a_slip_in_a_setting(setting: str, ends: str) -> None:
    assert told(setting)[0].endswith(ends)


def test_a_misspelt_key_is_one_fault() -> None:
    assert told("damping.ratio=0.02") == ("--set damping.ratio: unknown key; did you mean damping.first_mode_ratio?",)


def test_accept_names_storeys_by_their_number() -> None:
    assert load_cases([CASE], ("accept.exp_rths.rms_error_m_s2[3]=0.5",))[0].accept == {
        "exp_rths.rms_error_m_s2[3]": 0.5
    }


def test_faulty_entries_do_not_make_a_list_too_short() -> None:
    faults = told("structure.experimental.damping_ratios=[2, 3]")
    assert len(faults) == 2 and all("must be >= 0 and < 1" in fault for fault in faults)


def test_a_structure_without_damping_levels_says_what_to_write(tmp_path: Path) -> None:
    parts = "numerical: {masses_kg: [7], stiffness_n_per_m: [7000]}\n"
    parts += "experimental: {masses_kg: [7], stiffness_n_per_m: [7000], damping_ratios: [0.02]}\n"
    (tmp_path / "b.yaml").write_text(parts)
    (tmp_path / "a.yaml").write_text(OWN.replace("three_storey", "b"))
    with pytest.raises(
        InputError, match=r"no damping level 'low'; add damping_levels to it, or write damping: \{first"
    ):
        load_cases([tmp_path / "a.yaml"])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (OWN.replace("scaling: 0.3", "scaling 0.3"), "a.yaml:4:1: not valid YAML: a colon is missing in 'scaling 0.3'"),
        (OWN.replace("controller", "\tcontroller"), "a.yaml:5:1: not valid YAML: a tab; indent with spaces"),
    ],
)
def test_yaml_that_is_none(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InputError) as refused:
        load_cases([tmp_path / "a.yaml"])
    assert sentence in refused.value.faults[0]


def test_commas_of_numbers_in_a_record(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("0,00;0,10\n0,01;0,20\n0,02;0,30\n")
    assert read_accelerogram(tmp_path / "r.csv", "mg", None).accel_m_s2[1] == pytest.approx(0.2e-3 * 9.80665)
    (tmp_path / "four.csv").write_text("0.00,1,2,3\n0.01,1,2,3\n0.02,1,2,3\n")
    with pytest.raises(InputError) as refused:
        read_accelerogram(tmp_path / "four.csv", "g", None)
    assert "decimal" not in str(refused.value)


def test_a_range_without_a_count() -> None:
    with pytest.raises(InputError, match=r"a range is LOW:HIGH:COUNT, for example 0\.1:0\.5:5"):
        read_plan(Asked(CASE, (), ("scaling=0.1:0.5",), None))
