"""One table defines every figure: whatever a run can write stands in it, with the unit it is written in."""

from __future__ import annotations

from pathlib import Path

import pytest

from rths_cli.analysis import error_budget as causes_of_budget
from rths_cli.analysis import predicted_error
from rths_cli.files.result_reader import ResultWriter
from rths_cli.quantities import AXES, KINDS, METRICS, datasets, declared, kinds_of, metric, model_datasets
from rths_cli.quantities.datasets import declared_datasets
from rths_cli.quantities.declaration import unit_of_name
from rths_cli.quantities.model_datasets import declared_model_datasets
from rths_cli.quantities.sweep_datasets import SWEEP_DATASETS


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"exp_rths.rms_eror_m_s2": [0.1]}, "exp_rths.rms_eror_m_s2 is declared nowhere"),
        ({"exp_rths.j1_s_true": 0.1}, "exp_rths.j1_s_true is declared nowhere"),
        ({"exp_rths.rms_error_m_s2": 0.1}, "has 0 axes, declared are 1"),
        ({"exp_rths.j2": [0.1, 0.2]}, "has 1 axes, declared are 0"),
    ],
)
def test_a_value_that_is_not_declared_is_not_written(tmp_path: Path, values: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words), ResultWriter(tmp_path / "a.h5", {"rig_kind": "virtual"}) as writer:
        writer.metrics(values)
    assert not list(tmp_path.iterdir())


def test_causes_are_those_of_the_budgets() -> None:
    for group, names in (
        ("check", predicted_error.CAUSES),
        ("budget", [*causes_of_budget.CAUSES, causes_of_budget.LOST, causes_of_budget.DRIFT]),
    ):
        expected = {f"{group}.rms_error_{name}_m_s2" for name in names}
        found = {one.path for one in declared() if one.path.startswith(f"{group}.rms_error_")}
        assert found - {f"{group}.rms_error_m_s2"} == expected


def test_a_path_is_defined_once_and_a_kind_only_where_it_exists() -> None:
    paths = [one.path for one in declared()]
    assert len(paths) == len(set(paths))
    assert metric("exp_rths.j1_s_true") is None and metric("nothing.at_all") is None
    found = metric("exp_rths.rms_error_m_s2_true_full")
    assert kinds_of("exp_rths.rms_error_m_s2")[-1] == found.path and len(kinds_of("exp_rths.j1_s")) == 1
    assert found is not None and found.text.endswith(KINDS["_true_full"]) and found.units == "m/s^2"


@pytest.mark.parametrize(
    ("name", "units"),
    [("command_rate_v_s", "V/s"), ("sensitivity_mv_per_g", "mV/g"), ("stiffness_n_per_m", "N/m"), ("scaling", "1")],
)
def test_the_unit_of_a_name_is_its_longest_ending(name: str, units: str) -> None:
    assert unit_of_name(name) == units


def test_every_dataset_is_declared_once_in_a_declared_group_on_declared_axes() -> None:
    for items, groups in (
        (declared_datasets(), datasets.GROUPS),
        (declared_model_datasets(), model_datasets.GROUPS),
    ):
        found = list(items)
        assert len({one.path for one in found}) == len(found)
        assert {one.group for one in found} == set(groups)
        assert {axis for one in found for axis in one.axes} <= set(AXES)
        assert all(one.units and one.text for one in found)
    assert {one.over for one in METRICS.values()} - {""} <= set(AXES)
    assert {axis for one in SWEEP_DATASETS.values() for axis in one.axes} <= set(AXES)
