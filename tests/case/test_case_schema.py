"""The models alone: ranges, and faults between keys that stand beside faults of single keys."""

from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import ValidationError

from rths_cli.case.case_schema import Case, CaseKeys, LimitOverrides, LimitsSpec
from rths_cli.case.field_types import Range, Strict
from rths_cli.case.reference_schema import ReferenceSpec
from rths_cli.case.rig_schema import ConvertersSpec, SensorsSpec
from rths_cli.case.structure_schema import DampingSpec, ExperimentalSpec, StructureSpec


class Sample(Strict):
    positive: Annotated[float, Range(gt=0, le=100)] = 1.0
    count: Annotated[int, Range(ge=2, lt=5, or_zero=True)] = 2


def faults(model: type[Strict], data: dict[str, Any]) -> dict[str, str]:
    """Return the faults of data by dotted location."""
    with pytest.raises(ValidationError) as caught:
        model.model_validate(data)
    return {".".join(map(str, entry["loc"])): entry["msg"] for entry in caught.value.errors()}


@pytest.mark.parametrize("value", [0.0, -1, 100.0001, float("nan"), float("inf"), True, "1", None, (1,), {}])
def test_a_number_outside_its_range_or_of_another_type_is_refused(value: object) -> None:
    assert set(faults(Sample, {"positive": value})) == {"positive"}


def test_the_ends_of_a_range() -> None:
    assert Sample(positive=100).positive == 100.0
    assert [Sample(count=n).count for n in (0, 2, 4)] == [0, 2, 4]
    assert faults(Sample, {"count": 5}) == {"count": "must be 0 (off) or >= 2 and < 5, got 5"}
    assert faults(Sample, {"count": 1, "positive": -1}) == {
        "count": "must be 0 (off) or >= 2 and < 5, got 1",
        "positive": "must be > 0 and <= 100, got -1",
    }
    assert "whole number" in faults(Sample, {"count": 2.0})["count"]


def test_a_model_cannot_be_changed() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Sample().positive = 2.0  # type: ignore[misc]


def test_faults_between_keys_do_not_hide_faults_of_keys() -> None:
    data = {"masses_kg": (1.0, -2.0), "natural_frequencies_hz": (3.0, 2.0, 4.0), "stiffness_n_per_m": (1.0, 2.0)}
    found = faults(ExperimentalSpec, data)
    assert found["masses_kg.1"] == "must be > 0 and <= 1e+07, got -2"
    assert found["stiffness_n_per_m"] == "give natural_frequencies_hz or stiffness_n_per_m, not both"
    assert found[""] == "give damping_ratios or dashpots_n_s_per_m"
    with pytest.raises(ValidationError) as caught:
        ExperimentalSpec.model_validate(data)
    messages = [entry["msg"] for entry in caught.value.errors() if entry["loc"] == ("natural_frequencies_hz",)]
    assert messages == [
        "must have one entry per storey, 2 in all, got 3",
        "must increase from mode to mode; sort them, mode 1 first",
    ]


def test_damping_is_one_of_two() -> None:
    assert faults(DampingSpec, {}) == {"": "give first_mode_ratio or dashpots_n_s_per_m"}
    both = faults(DampingSpec, {"first_mode_ratio": 0.02, "dashpots_n_s_per_m": (1.0,)})
    assert both == {"dashpots_n_s_per_m": "give first_mode_ratio or dashpots_n_s_per_m, not both"}
    assert DampingSpec(first_mode_ratio=0.02).name == "inline"


def structure(**changes: Any) -> dict[str, Any]:
    experimental = {"masses_kg": (6.91, 6.95), "stiffness_n_per_m": (7331.0, 7376.0), "damping_ratios": (0.04, 0.04)}
    numerical = {"masses_kg": (8.0, 6.93), "stiffness_n_per_m": "mean_of_experimental"}
    return {"numerical": numerical, "experimental": experimental, **changes}


def test_the_interface_mass_on_the_table_is_part_of_the_highest_numerical_floor() -> None:
    assert StructureSpec.model_validate(structure(interface_experimental_mass_kg=6.92)).name == "inline"
    found = faults(StructureSpec, structure(interface_experimental_mass_kg=6.93))
    assert found == {"interface_experimental_mass_kg": "must be < the interface floor's mass 6.93 kg, got 6.93"}


def test_levels_are_named_by_their_keys_and_fit_the_storeys() -> None:
    levels = {
        "low": {"first_mode_ratio": 0.02},
        "odd": {"dashpots_n_s_per_m": (1.0,)},
        "inline": {"first_mode_ratio": 2},
    }
    found = faults(StructureSpec, structure(damping_levels=levels))
    assert set(found) == {
        "damping_levels.odd.dashpots_n_s_per_m",
        "damping_levels.inline",
        "damping_levels.inline.first_mode_ratio",
    }
    spec = StructureSpec.model_validate(structure(damping_levels={"low": {"first_mode_ratio": 0.02}}))
    assert spec.damping_levels["low"].name == "low"


def test_stiffness_is_the_word_or_a_list_per_storey() -> None:
    def stiffness(value: object) -> dict[str, Any]:
        return structure(numerical={"masses_kg": (8.0, 6.93), "stiffness_n_per_m": value})

    assert StructureSpec.model_validate(stiffness((5.0, 6))).numerical.stiffness_n_per_m == (5.0, 6.0)
    for value in ("mean", (5.0,), (5.0, 0.0), 7.0, ()):
        assert faults(StructureSpec, stiffness(value)), value


def test_zero_switches_a_sensor_fault_off() -> None:
    ideal = SensorsSpec(high_pass_hz=0, low_pass_hz=0, noise_rms_m_s2=0)
    assert (ideal.high_pass_hz, ideal.low_pass_hz, ideal.noise_rms_m_s2) == (0, 0, 0)
    assert ConvertersSpec(bits=0).bits == 0
    assert set(faults(SensorsSpec, {"high_pass_hz": 5.0, "low_pass_hz": 4.0})) == {"low_pass_hz"}


def test_limits_are_tightened_one_by_one() -> None:
    limits = LimitsSpec().tightened(LimitOverrides(velocity_m_s=0.5))
    assert limits == LimitsSpec(stroke_m=0.079, velocity_m_s=0.5, acceleration_m_s2=45.0, force_n=445.0)


def test_a_reference_finds_what_fits_record_damping_and_controller() -> None:
    entries = (
        {"record": "a", "damping": "low", "controller": "FF", "figures": {"exp_rths.x": 1.0}},
        {"record": "a", "scaling": 0.3, "figures": {"sim_delay.y": (1.0, 2.0)}},
        {"record": "b", "figures": {"exp_rths.x": 3.0}},
    )
    spec = ReferenceSpec.model_validate({"title": "t", "source": "s", "entries": entries})
    assert spec.figures_for("a", "low", "FF") == {"exp_rths.x": 1.0, "sim_delay.y": (1.0, 2.0)}
    assert spec.figures_for("a", "low", "FF+FB", 0.3) == {"sim_delay.y": (1.0, 2.0)}
    assert spec.figures_for("a", "low", "FF", 0.4) == {"exp_rths.x": 1.0}
    assert spec.figures_for("c", "low", "FF") == {}


def test_a_case_has_the_keys_of_the_file_and_six_more() -> None:
    more = {"path", "yaml_text", "rig_file", "rig_limits", "stated", "places"}
    assert set(Case.model_fields) - set(CaseKeys.model_fields) == more
