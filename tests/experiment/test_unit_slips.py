"""Slips of units in case, structure, rig and record are refused or doubted by name; right files are not doubted."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from campaigns.unit_slips import bases, factor_of, fates, must_be_noticed, right_doubts

from rths_cli.case.load import load_cases
from rths_cli.experiment.setup import make_setup
from rths_cli.experiment.unit_plausibility import doubts

RIGHT = 40  # benchmarks/unit_slips.py draws 200
CASE = "el_centro_low_ff_fb"


@pytest.mark.campaign
def test_slips_by_a_prefix_are_noticed_and_most_others(tmp_path: Path) -> None:
    found = list(fates({"right_1": bases(2)["right_1"]}, tmp_path))
    missed = [(fate.slip.key, fate.slip.factor) for fate in found if fate.found == "silent"]
    assert not [one.slip for one in found if one.found == "silent" and must_be_noticed(one.slip)]
    large = [one for one in found if factor_of(one.slip) in (1e3, 1e6)]
    assert sum(one.found != "silent" for one in large) >= 0.95 * len(large), missed
    others = [one for one in found if factor_of(one.slip) in (9.81, 25.4)]
    assert sum(one.found != "silent" for one in others) >= 0.7 * len(others), missed


@pytest.mark.campaign
def test_right_buildings_and_rigs_are_not_doubted() -> None:
    doubted = {seed: found for seed in range(RIGHT) if (found := right_doubts(seed))}
    assert len(doubted) <= 0.05 * RIGHT, doubted


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("setting", "key", "said"),
    [
        ("table.limits.force_n=400000", "table.limits.force_n", r"400000 N is .*, 315 N; .* 1000 .* 400 N would fit"),
        ("table.limits.stroke_m=0.75", "table.limits.stroke_m", r"0\.75 m is 9\.49 times .*, 0\.079 m; .* of 9\.81"),
        ("table.limits.velocity_m_s=9.81", "table.limits.velocity_m_s", r"9\.81 m/s .*, 1\.89 m/s; .* 1 m/s would fit"),
        (
            "table.limits.acceleration_m_s2=441",
            "table.limits.velocity_m_s",
            r"5\.9 m/s; .*; table\.limits\.acceleration_m_s2 disagrees with others, too: is it in m/s\?",
        ),
        ("table.sensors.range_g=5000", "table.sensors.range_g", r"5000 g is .*, 4\.59 g; .* 5 g would fit"),
        ("table.nominal.moving_mass_kg=0.007", "table.nominal.payload_kg", r"0\.007 kg; .*moving_mass_kg dis"),
        ("structure.numerical.masses_kg=[12000]", "structure.numerical.masses_kg", r"12000 kg .* 6\.93 kg; .* 1000"),
        ("structure.numerical.masses_kg=[68]", "structure.numerical.masses_kg", r"68 kg .* 6\.934 kg would fit"),
        ("scaling=0.003", "scaling", r"0\.0\d* m/s\^2 is .* times 1 g"),
        ("sample_rate_hz=19620", "sample_rate_hz", r"19620 Hz is 9\.81 times its default"),
    ],
)  # fmt: skip
def test_a_doubt_names_both_figures_and_the_likely_slip(setting: str, key: str, said: str) -> None:
    first = doubts(make_setup(load_cases([CASE], (setting,))[0]))[0]
    assert first.key == key and re.search(said, first.sentence), first.sentence


def test_a_limit_that_the_case_itself_makes_stricter_is_not_doubted() -> None:
    """A cautious operator's 5 mm of 79 is no slip of units."""
    assert doubts(make_setup(load_cases([CASE], ("limits.stroke_m=0.005", "limits.velocity_m_s=0.05"))[0])) == ()


def test_a_number_that_the_case_calls_plausible_is_not_doubted() -> None:
    settings = ("structure.numerical.masses_kg=[1200]",)
    (doubt,) = doubts(make_setup(load_cases([CASE], settings)[0]))
    assert doubts(make_setup(load_cases([CASE], (*settings, f"plausible=[{doubt.key}]"))[0])) == ()
