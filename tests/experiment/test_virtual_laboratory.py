"""Laboratories of a case: which one it is in, what its model, its sweeps, its truth and its server make of that."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from rths_cli.case.load import load_cases
from rths_cli.case.virtual_imperfections_schema import VirtualImperfections
from rths_cli.errors import InputError
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import differences, identity, key
from rths_cli.experiment.run_case import run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.laboratory.serve import describe, make_table
from rths_cli.rigs.from_case import (
    laboratory_follows_seed,
    laboratory_number,
    true_building,
    true_values,
    true_values_of_run,
    virtual_driver,
)
from rths_cli.rigs.virtual.imperfect.plant import ImperfectPlant
from rths_cli.structure.storey_laws import BILINEAR, SOFTENING
from rths_cli.studies.grid_points import check_points
from rths_cli.studies.study_plan import Asked
from rths_cli.studies.sweep_runs import Shared

LABORATORY, PINNED = "table=aps400_laboratory", "table.imperfections.laboratory=7"


def setup_of(*settings: str) -> Setup:
    return make_setup(load_cases(["el_centro_low_ff_fb"], settings)[0])


def test_the_seed_is_the_laboratory_unless_the_rig_states_one() -> None:
    exact = setup_of("seed=3").case
    drawn, pinned = setup_of(LABORATORY, "seed=3").case, setup_of(LABORATORY, PINNED, "seed=3").case
    assert (laboratory_number(exact), laboratory_number(drawn), laboratory_number(pinned)) == (None, 3, 7)
    assert [laboratory_follows_seed(case) for case in (exact, drawn, pinned)] == [False, True, False]


def test_identification_and_test_are_in_one_laboratory_but_for_the_drift_between_them() -> None:
    setup = setup_of(LABORATORY, "seed=3")
    values, other = true_values(setup.case, setup.rig), setup_of(LABORATORY, "seed=4")
    assert np.abs(values["channels.gain_error"] - true_values(other.case, other.rig)["channels.gain_error"]).min() > 0.0
    runs = [true_values_of_run(setup.case, setup.rig, (3, stream)) for stream in (1, 3, 3)]
    changes = [run["channels.gain_change_between_runs"] for run in runs]
    assert np.abs(changes[0] - changes[1]).min() > 0.0 and np.array_equal(changes[1], changes[2])
    assert true_values(setup_of().case, setup.rig) == {}


def test_a_model_of_another_laboratory_is_refused() -> None:
    here, there = setup_of(LABORATORY, "seed=3"), setup_of(LABORATORY, "seed=4")
    again, same = setup_of(LABORATORY, "seed=3", "scaling=0.2"), setup_of(LABORATORY, "seed=9", PINNED)
    assert key(here) != key(there) and key(here) == key(again)
    assert differences(identity(here), identity(again)) == []
    told = differences(identity(here), identity(there))
    assert len(told) == 1 and told[0].startswith(
        "identified in laboratory 3, the case is in laboratory 4, whose sensors"
    )
    in_seven = setup_of(LABORATORY, "seed=7")
    assert differences(identity(in_seven), identity(same)) == []
    assert "laboratory" not in identity(setup_of())


def test_seeds_of_a_sweep_need_one_laboratory() -> None:
    settings = (LABORATORY, "runs=[sim, exp_rths]")
    asked = Asked("el_centro_low_ff_fb", settings, ("scaling=0.1,0.2",), "3")
    with pytest.raises(InputError, match=r"seeds: another seed is another laboratory of rig aps400_laboratory"):
        check_points(asked, Shared((), lambda _: None), lambda _: None)
    pinned = Asked("el_centro_low_ff_fb", (*settings, PINNED), ("scaling=0.1,0.2",), "3")
    assert len(check_points(pinned, Shared((), lambda _: None), lambda _: None).plan.seeds) == 3


def test_the_true_building_has_true_masses_and_the_laws_of_its_storeys() -> None:
    setup = setup_of(LABORATORY, "seed=3")
    building, values = true_building(setup.case, setup.building), true_values(setup.case, setup.rig)
    assert building is not None
    masses = setup.building.specimen.masses_kg * (1.0 + values["masses.weighing_error"])
    assert np.array_equal(building.specimen.masses_kg, masses)
    assert np.array_equal(np.diag(building.M)[1:], masses)
    assert building.laws.storey.tolist() == [1, 1, 2, 2]
    assert building.laws.code.tolist() == [SOFTENING, BILINEAR, SOFTENING, BILINEAR]
    softening = building.laws.numbers[0, 0] / setup.building.specimen.K.sum()
    assert softening == pytest.approx(values["specimen.softening"][0], rel=1e-3)


def test_a_list_of_another_length_is_told_with_its_place() -> None:
    with pytest.raises(InputError, match=r"imperfections.masses.weighing_error: 3 entries for 2 floors on the table"):
        setup_of("table.imperfections.masses.weighing_error=[0.01, 0.0, 0.0]")


def test_a_laboratory_can_be_served() -> None:
    served = describe("aps400_laboratory", "three_storey", ("sample_rate_hz=1000",), 5)
    table = make_table(served, 1_000_000)
    assert isinstance(table.plant, ImperfectPlant) and table.plant.lead_s == 0.0
    gains = true_values(setup_of(LABORATORY, "seed=5").case, served.setup.rig)["channels.gain_error"]
    assert np.abs(table.plant.sensing.gain - 1.0 - gains).max() < 0.005  # but for the drift between runs
    assert table.noise.shape[1] == 8


@pytest.mark.campaign
def test_a_laboratory_with_all_imperfections_at_zero_has_the_bytes_of_the_exact_one(tmp_path: Path) -> None:
    """What only shapes an imperfection is stated all the same, the number of the laboratory too."""
    time_s = np.arange(0.0, 6.0, 0.01)
    columns = np.column_stack([time_s, np.sin(9.0 * time_s) * np.exp(-(((time_s - 1.5) / 0.5) ** 2))])
    np.savetxt(tmp_path / "pulse.csv", columns, delimiter=",", header="time_s,accel_m_s2", comments="")
    written: dict[str, dict[str, float]] = {}
    for part, one in VirtualImperfections().parts():
        shaping = {
            name: 0.9 * getattr(one, name)
            for name in type(one).model_fields
            if name not in one.switches() and isinstance(getattr(one, name), float)
        }
        written[part] = {**dict.fromkeys(one.switches(), 0.0), **shaping}
    stated = f"{{extends: aps400_virtual, imperfections: {json.dumps({'laboratory': 3, **written})}}}"
    case = (f"record={tmp_path / 'pulse.csv'}", "identification.duration_s=40", "runs=[sim, exp_rths]")
    found = []
    for number, table in enumerate(("aps400_virtual", stated)):
        setup = make_setup(load_cases(["el_centro_low_ff_fb"], (*case, f"table={table}"))[0], ("check", "model"))
        path = tmp_path / f"{number}.h5"
        assert run_case(setup, path, Memory(), "test", lambda _: None).status == "complete"
        found.append(contents(path))
    assert found[0] == found[1] and "exp_rths/truth/table_disp_m" in found[0]


def contents(path: Path) -> dict[str, bytes]:
    """Return the bytes of the datasets of a result, but for what was measured of the run and the case as written."""
    read: dict[str, bytes] = {}

    def collect(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and "timing" not in name and not name.startswith("case"):
            read[name] = np.asarray(node[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(collect)
    return read


BESIDE = """[{kind: displacement, position: table, unit: mm, sensitivity_v_per_unit: 0.1, range: 95, use: guard},
  {kind: force, position: table, unit: N, sensitivity_v_per_unit: 0.02, range: 450, use: log,
   sensitivity_uncertainty: 0.003}]"""


@pytest.mark.campaign
def test_further_channels_have_values_of_their_own() -> None:
    """A list has an entry for each of them, too; drawn gains have the uncertainty that their channel declares."""
    table = f"table={{extends: aps400_laboratory, channels: {BESIDE}}}"
    gains = "[0.01, 0.0, -0.01, 0.02, 0.005]"
    listed = setup_of(table, f"table.imperfections.channels.gain_error={gains}", "seed=3")
    values = true_values(listed.case, listed.rig)
    assert values["channels.gain_error"].tolist() == [0.01, 0.0, -0.01, 0.02, 0.005]
    assert true_building(listed.case, listed.building) is not None
    rig = virtual_driver(listed.case, listed.rig, listed.building, (3, 1), True)
    assert isinstance(rig.plant, ImperfectPlant)
    change = true_values_of_run(listed.case, listed.rig, (3, 1))["channels.gain_change_between_runs"]
    assert np.array_equal(rig.plant.sensing.gain, 1.0 + values["channels.gain_error"] + change)
    with pytest.raises(InputError, match=r"channels.gain_error: 3 entries for 5 channels"):
        setup_of(table, "table.imperfections.channels.gain_error=[0.01, 0.0, 0.0]")
    first, alone, drawn = setup_of(table).case, [], []
    for seed in range(300):
        case = first.model_copy(update={"seed": seed})
        drawn.append(true_values(case, listed.rig)["channels.gain_error"])
        alone.append(true_values(case, replace(listed.rig, further=()))["channels.gain_error"])
    assert np.array_equal(np.array(drawn)[:, :3], alone)
    spread = np.array([0.01, 0.01, 0.01, 0.01, 0.003])
    assert np.abs(np.std(drawn, axis=0) / spread - 1.0).max() < 4.0 / np.sqrt(600)
