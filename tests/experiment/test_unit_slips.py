"""Slips of units in case, structure, rig and record are refused or doubted by name; right files are not doubted."""

from __future__ import annotations

from pathlib import Path

import pytest
from campaigns.unit_slips import bases, factor_of, fates, must_be_noticed, right_doubts

from rths_cli.case.load import load_cases
from rths_cli.experiment.setup import make_setup
from rths_cli.experiment.unit_plausibility import doubts

RIGHT = 40  # benchmarks/unit_slips.py draws 200
CASE = "el_centro_low_ff_fb"


def test_slips_by_a_prefix_are_noticed_and_most_others(tmp_path: Path) -> None:
    found = list(fates({"right_1": bases(2)["right_1"]}, tmp_path))
    missed = [(fate.slip.key, fate.slip.factor) for fate in found if fate.found == "silent"]
    assert not [one.slip for one in found if one.found == "silent" and must_be_noticed(one.slip)]
    large = [one for one in found if factor_of(one.slip) in (1e3, 1e6)]
    assert sum(one.found != "silent" for one in large) >= 0.95 * len(large), missed
    others = [one for one in found if factor_of(one.slip) in (9.81, 25.4)]
    assert sum(one.found != "silent" for one in others) >= 0.75 * len(others), missed


def test_right_buildings_and_rigs_are_not_doubted() -> None:
    doubted = {seed: found for seed in range(RIGHT) if (found := right_doubts(seed))}
    assert len(doubted) <= 0.05 * RIGHT, doubted


@pytest.mark.parametrize(
    ("setting", "key", "figure", "fits"),
    [
        ("table.limits.force_n=400000", "table.limits.force_n", "7 kg", "400 N"),
        ("table.limits.stroke_m=2.0066", "table.limits.stroke_m", "0.079 m", "0.079 m"),  # 79 mm in inches of mm
        ("table.limits.velocity_m_s=9.81", "table.limits.velocity_m_s", "1.89 m/s", "1 m/s"),
        ("table.limits.acceleration_m_s2=441", "table.limits.acceleration_m_s2", "1.89", ""),
        ("table.sensors.range_g=5000", "table.sensors.range_g", "4.59 g", "5 g"),
        ("table.nominal.moving_mass_kg=0.007", "table.nominal.moving_mass_kg", "0.007 kg", ""),
        ("structure.numerical.masses_kg=[12000]", "structure.numerical.masses_kg", "6.93 kg", "12 kg"),
        ("structure.numerical.masses_kg=[68]", "structure.numerical.masses_kg", "6.93 kg", "6.934 kg"),
        ("scaling=0.003", "scaling", "9.81 m/s^2", ""),
        ("sample_rate_hz=19620", "sample_rate_hz", "2e+03 Hz", "2000 Hz"),
    ],
)
def test_a_doubt_names_both_figures_and_the_likely_slip(setting: str, key: str, figure: str, fits: str) -> None:
    found = doubts(make_setup(load_cases([CASE], (setting,))[0]))
    named = [one for one in found if key in (one.key, *one.others)]
    assert named, [one.sentence for one in found]
    said = named[0].sentence
    assert "likely a factor of" in said and (not fits or f"{fits} would fit" in said)
    assert figure in said or named[0].key == "table.limits.force_n" and "315 N" in said


def test_a_limit_that_the_case_itself_makes_stricter_is_not_doubted() -> None:
    """A cautious operator's 5 mm of 79 is no slip of units."""
    assert doubts(make_setup(load_cases([CASE], ("limits.stroke_m=0.005", "limits.velocity_m_s=0.05"))[0])) == ()


def test_a_number_that_the_case_calls_plausible_is_not_doubted() -> None:
    settings = ("structure.numerical.masses_kg=[1200]",)
    (doubt,) = doubts(make_setup(load_cases([CASE], settings)[0]))
    assert doubts(make_setup(load_cases([CASE], (*settings, f"plausible=[{doubt.key}]"))[0])) == ()
