"""One case from file to result file: contents, determinism, stops, limits of acceptance."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from declared_contents import declaration_faults
from made_up_check import OF_LAWS
from numpy.testing import assert_allclose

from rths_cli.analysis.metrics import error_figures
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.case_warnings import differences
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.one_table_run import drive_of
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.result_reader import read_result
from rths_cli.findings import from_json, stated
from rths_cli.quantities import metrics_of

CASE = "el_centro_low_ff_fb"


def run(path: Path, memory: Memory, *settings: str, case: str = CASE, overrides: tuple[str, ...] = ()) -> Ended:
    return run_case(make_setup(load_cases([case], settings)[0], overrides), path, memory, "test", lambda _: None)


def datasets(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}

    def collect(name: str, node: h5py.Group | h5py.Dataset) -> None:
        if isinstance(node, h5py.Dataset) and "timing" not in name and not name.startswith("case"):
            found[name] = np.asarray(node[()]).tobytes()

    with h5py.File(path) as file:
        file.visititems(collect)
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, memory: Memory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "whole.h5"
    assert run(path, memory).exit_code == 0
    return path


def test_the_file_holds_what_is_declared_and_nothing_else(whole: Path) -> None:
    assert declaration_faults(whole) == []


def test_the_file_keeps_the_contract(whole: Path) -> None:
    with h5py.File(whole) as file:
        assert file.attrs["format"] == "rths-result" and file.attrs["status"] == "complete"
        assert file.attrs["rig_kind"] == "virtual" and len(file.attrs["model_sha256"]) == 64
        n = file["record/time_s"].size
        for name, shape in {
            "sim/abs_accel_m_s2": (3, n),
            "sim_delay/base_shear_n": (n,),
            "exp_rths/rel_disp_m": (3, n),
            "exp_rths/interface_accel_desired_m_s2": (n,),
            "exp_rths/floor_accel_measured_m_s2": (2, n),
            "exp_rths/floor_accel_estimated_m_s2": (2, n),
            "exp_rths/truth/table_disp_m": (n,),
            "exp_rths/truth/floor_accel_m_s2": (2, n),
            "exp_rths/timing/compute_s": (n,),
            "shake_table/command_v": (n,),
        }.items():
            assert file[name].shape == shape, name
            assert file[name].attrs["units"] and file[name].attrs["long_name"] and file[name].attrs["source"]
        assert {"kalman", "feedforward", "feedback", "numerical", "sensor_correction"} <= set(file["controller"])
        assert file["identification/poles_real"].shape == (7,)
    assert whole.stat().st_size <= 50e6


def test_each_error_is_that_of_the_series_in_the_file(whole: Path) -> None:
    metrics, pairs = read_result(whole).metrics, {}
    with h5py.File(whole) as file:
        for name in ("shake_table", "exp_rths"):
            desired, measured = (file[f"{name}/interface_accel_{which}_m_s2"][()] for which in ("desired", "measured"))
            pairs[f"{name}.tracking_{{}}_m_s2"] = desired, measured
            pairs[f"{name}.tracking_{{}}_m_s2_true"] = desired, file[f"{name}/truth/table_accel_m_s2"][()]
        sim, truth = file["sim/abs_accel_m_s2"][()], file["exp_rths/truth"]
        pairs["exp_rths.{}_error_m_s2"] = sim, file["exp_rths/abs_accel_m_s2"][()]
        pairs["exp_rths.{}_error_m_s2_true"] = sim, np.vstack([truth["table_accel_m_s2"], truth["floor_accel_m_s2"]])
    for path, (reference, value) in pairs.items():
        found = error_figures(reference, value, 1 / 2000, float(metrics["exp_rths.high_pass_hz"]))
        for which, band, expected in (
            ("max", "", found.maximum),
            ("rms", "", found.rms),
            ("max", "_full", found.maximum_full),
            ("rms", "_full", found.rms_full),
        ):
            assert metrics[path.format(which) + band] == pytest.approx(expected, rel=1e-12), path


@pytest.mark.campaign
def test_every_group_opens_in_xarray(whole: Path) -> None:
    import xarray as xr

    tree = xr.open_datatree(whole, engine="h5netcdf")
    assert tree["exp_rths"]["abs_accel_m_s2"].dims == ("storey", "time_s")
    assert tree["exp_rths"]["floor_accel_measured_m_s2"].dims == ("floor", "time_s")
    assert list(tree["exp_rths"]["floor"].values) == [2, 3]


def test_the_same_seed_gives_the_same_bytes_and_dropping_a_run_changes_no_other(
    whole: Path, tmp_path: Path, memory: Memory
) -> None:
    run(tmp_path / "again.h5", memory, "runs=[exp-rths]", "name=again")
    first, again = datasets(whole), datasets(tmp_path / "again.h5")
    shared = {name for name in again if name in first}
    assert len([name for name in shared if name.startswith("exp_rths/")]) > 10
    assert [name for name in sorted(shared) if first[name] != again[name]] == []
    run(tmp_path / "other.h5", memory, "runs=[exp-rths]", "name=other", "seed=1")
    other = datasets(tmp_path / "other.h5")
    assert other["exp_rths/command_v"] != again["exp_rths/command_v"]


@pytest.mark.campaign
def test_a_limit_stops_the_run_and_the_file_says_so(tmp_path: Path, memory: Memory) -> None:
    ended = run(tmp_path / "s.h5", memory, "scaling=3", "runs=[sim, shake_table, exp_rths]", overrides=("check",))
    assert (ended.exit_code, ended.status) == (3, "aborted")
    assert "stroke" in ended.reason and "shake-table test" in ended.reason
    result = read_result(tmp_path / "s.h5")
    assert result.attributes["status"] == "aborted"
    stop = next(one for one in from_json(str(result.attributes["findings"])) if one.code.startswith("stop."))
    assert stop.code == "stop.displacement" and stop.values["units"] == "m" and str(stop) in ended.reason
    assert stop.values["seen"] > stop.values["limit"] == pytest.approx(0.079, rel=1e-2)
    assert not any(path.startswith("exp_rths.") for path in result.metrics)
    with h5py.File(tmp_path / "s.h5") as file:
        short = file["exp_rths/command_v"][()]
        assert 0 < short.size < file["record/time_s"].size
        assert np.abs(short * 0.0079).max() <= 0.079
        assert short[-1] == pytest.approx(0.0, abs=1e-3)  # back at rest


@pytest.mark.campaign
def test_the_table_as_delivered_is_stopped_by_a_limit_because_the_loop_is_unstable(
    tmp_path: Path, memory: Memory
) -> None:
    ended = run(tmp_path / "n.h5", memory, "controller=none", "runs=[exp_rths]", overrides=("check",))
    assert (ended.exit_code, ended.status) == (3, "aborted")


@pytest.mark.campaign
def test_accept_limits_judge_the_figures_by_their_path(tmp_path: Path, memory: Memory) -> None:
    fine = run(tmp_path / "a.h5", memory, "runs=[sim_delay]", "accept={'sim_delay.rms_error_m_s2[3]': 0.2}")
    assert (fine.exit_code, fine.reason) == (0, "")
    short = run(tmp_path / "b.h5", memory, "runs=[sim_delay]", "accept={'sim_delay.rms_error_m_s2[3]': 0.1}")
    assert short.exit_code == 1 and "sim_delay.rms_error_m_s2[3]" in short.reason
    assert read_result(tmp_path / "b.h5").attributes["status"] == "complete"


@pytest.mark.campaign
def test_interface_mass_on_the_table_is_carried_through(tmp_path: Path, memory: Memory) -> None:
    ended = run(tmp_path / "m.h5", memory, "structure.interface_experimental_mass_kg=1.7", "runs=[sim_delay, exp_rths]")
    assert ended.exit_code == 0, ended.reason
    metrics = read_result(tmp_path / "m.h5").metrics
    ratio = np.asarray(metrics["exp_rths.rms_error_m_s2"]) / np.asarray(metrics["sim_delay.rms_error_m_s2"])
    assert np.all(ratio < 0.02), ratio


@pytest.mark.campaign
def test_a_specimen_that_differs_from_the_declared_one_is_named(tmp_path: Path, memory: Memory) -> None:
    assert not any("differs" in warning for warning in run(tmp_path / "w.h5", memory, "runs=[exp_rths]").warnings)
    setup = make_setup(load_cases([CASE])[0])
    identified = memory.identify(setup, lambda _: None)
    other = make_setup(load_cases([CASE], ("structure.experimental.natural_frequencies_hz=[3.3, 8.4]",))[0])
    sentences = differences(other, identified)
    assert len(sentences) == 1 and "mode 1" in sentences[0] and "3.3" in sentences[0]


@pytest.mark.campaign
def test_a_rejected_model_moves_no_table_unless_overridden(tmp_path: Path, memory: Memory) -> None:
    setup = make_setup(load_cases([CASE], ("runs=[sim, exp_rths]",))[0])
    found = memory.identify(setup, lambda _: None)
    rejected = replace(found, verdict=replace(found.verdict, accepted=False, refusals=(stated("made up"),)))
    known = SimpleNamespace(known=lambda *_: IdentifiedModel(rejected, "made up"))
    ended = run_case(setup, tmp_path / "r.h5", known, "test", lambda _: None)  # type: ignore[arg-type]
    assert (ended.exit_code, ended.status) == (1, "refused") and "made up" in ended.reason
    with h5py.File(tmp_path / "r.h5") as file:
        assert "exp_rths" not in file and "sim" in file
    insisted = replace(setup, overrides=("model",))
    ended = run_case(insisted, tmp_path / "o.h5", known, "test", lambda _: None)  # type: ignore[arg-type]
    assert ended.exit_code == 0
    assert read_result(tmp_path / "o.h5").attributes["overrides"] == "model"


def test_a_specimen_too_heavy_for_the_table_is_refused() -> None:
    case = load_cases([CASE], ("table.nominal.payload_kg=13",))[0]
    with pytest.raises(InputError, match=r"13\.86 kg.*at most 13 kg"):
        make_setup(case)


def test_the_figures_known_beforehand_are_those_a_run_has(whole: Path) -> None:
    runs = ("sim", "sim_delay", "shake_table", "exp_rths", "check")
    metrics = {path: np.ndim(value) > 0 for path, value in read_result(whole).metrics.items()}
    written = {path: per_storey for path, per_storey in metrics.items() if path.split(".")[0] in runs}
    known = metrics_of(*runs)
    real_rigs = ("_steps", ".longest_gap_s")
    of_actuator = {path for path, one in known.items() if "where a displacement is commanded" in one.text}
    computed = {path for path in known if not path.endswith(real_rigs) and not path.startswith(OF_LAWS)} - of_actuator
    # of what was lost, of runs made elsewhere, of storeys that are a program
    elsewhere = ("_lost_", ".recording_", ".following_", ".computing_", ".program_")
    missing = {path for path in computed - set(written) if not any(one in path for one in elsewhere)}
    assert set(written) <= computed
    of_others = ("peak_drift_ratio", "ductility", "residual_drift_m", "restoring_work_j")  # with heights, or laws
    others = ("residual_drift_change_m", "residual_drift_uncertainty_m", "base_shear_uncertainty")
    solved = ("sim", "sim_delay", "exp_rths")
    assert missing == {
        "sim_delay.diverged_at_s",
        "check.pitch_error_m_s2",  # no base pitches
        *(f"{run}.{figure}" for run in solved for figure in of_others),
        *(f"exp_rths.{figure}" for figure in others),
    }
    assert all((known[path].over != "") == several for path, several in written.items())


@pytest.mark.parametrize(
    ("path", "word"),
    [("exp_rths.tracking_rms_m_s2[2]", "one number"), ("exp_rths.rms_eror_m_s2", "did you mean")],
)
def test_an_accepted_figure_that_cannot_be_is_refused_before_the_run(path: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        make_setup(load_cases([CASE], (f"accept={{'{path}': 1}}",))[0])


@pytest.mark.campaign
def test_a_storey_that_a_figure_does_not_have_fails_the_limit_not_the_run(tmp_path: Path, memory: Memory) -> None:
    ended = run(tmp_path / "x.h5", memory, "runs=[exp_rths]", "accept={'identification.damping_ratio[3]': 1}")
    assert ended.exit_code == 1 and "2 values" in ended.reason
    assert read_result(tmp_path / "x.h5").attributes["status"] == "complete"


def test_the_stored_blocks_reproduce_the_base_shear(whole: Path) -> None:
    with h5py.File(whole) as file:
        block = file["controller/base_shear"]
        gain, names = block["D"][()][0], list(block.attrs["inputs"])
        run_group = file["exp_rths"]
        desired, measured = run_group["interface_accel_desired_m_s2"][()], run_group["abs_accel_m_s2"][()]
        shear, estimated = run_group["base_shear_n"][()], run_group["floor_accel_estimated_m_s2"][()]
        rel = [run_group["rel_disp_m"][1:] - run_group["rel_disp_m"][0], run_group["rel_vel_m_s"][1:]]
        rel[1] = rel[1] - run_group["rel_vel_m_s"][0]
        unexplained = run_group["base_shear_unexplained_n"][()]
    assert len(gain) == len(names) == 7 + 2 + 3 + 1
    # at step k the estimates are those of clock k - 2, the desired those of clocks k - 2, k - 1 and k
    inputs = np.vstack([rel[0][:, :-2], rel[1][:, :-2], estimated[:, :-2], unexplained[:-2]])
    inputs = np.vstack([inputs, desired[:-2], desired[1:-1]])
    inputs = np.vstack([inputs, measured[:, :-2], desired[2:]])
    assert_allclose(gain @ inputs, shear[2:], rtol=0, atol=1e-9 * np.abs(shear).max())


@pytest.mark.campaign
def test_a_feedback_slower_than_asked_is_named(tmp_path: Path, memory: Memory) -> None:
    ended = run(tmp_path / "f.h5", memory, "runs=[exp_rths]", "controller={kind: FF+FB, feedback_bandwidth_hz: 900}")
    assert any("900 Hz asked" in warning for warning in ended.warnings)


def test_estimated_floors_are_near_the_measured_ones(whole: Path) -> None:
    with h5py.File(whole) as file:
        for run_name in ("shake_table", "exp_rths"):
            measured = file[f"{run_name}/floor_accel_measured_m_s2"][()]
            estimated = file[f"{run_name}/floor_accel_estimated_m_s2"][()]
            assert np.std(estimated - measured, axis=1) == pytest.approx([0.0, 0.0], abs=0.02 * measured.std())


@pytest.mark.campaign
def test_what_changes_after_identification_changes_the_shake_table_test_too(tmp_path: Path, memory: Memory) -> None:
    run(tmp_path / "0.h5", memory, "runs=[shake_table]")
    run(tmp_path / "1.h5", memory, "runs=[shake_table]", "table.after_identification.coulomb_factor=3")
    before, after = (read_result(tmp_path / f"{k}.h5").metrics["shake_table.tracking_rms_m_s2"] for k in (0, 1))
    assert after > 1.5 * before


def test_after_the_record_the_ground_goes_on_as_one_motion() -> None:
    """A record that ends in motion: its acceleration stays, velocity and displacement follow from that."""
    dt_s, accel, lead = 0.001, -3.0, 7
    t = dt_s * np.arange(200)
    motion = SimpleNamespace(
        accel_m_s2=np.full(200, accel), velocity_m_s=0.4 + accel * t, displacement_m=0.01 + 0.4 * t + 0.5 * accel * t**2
    )
    design = SimpleNamespace(blocks=SimpleNamespace(lead_samples=lead))
    found = drive_of(SimpleNamespace(motion=motion, rig=SimpleNamespace(dt_s=dt_s)), design)
    later = dt_s * np.arange(200 + lead)
    wanted = [np.full(200 + lead, accel), 0.4 + accel * later, 0.01 + 0.4 * later + 0.5 * accel * later**2]
    assert found == pytest.approx(np.column_stack(wanted), rel=1e-12)


def test_the_structural_response_is_that_of_the_series_in_the_file(whole: Path) -> None:
    """Written once more with loops over storeys: peaks of drifts and shears, and errors in percent."""
    masses = np.array([6.93, 6.91, 6.95])
    values = read_result(whole).metrics
    with h5py.File(whole) as file:
        reference = file["sim/abs_accel_m_s2"][()]
        for run in ("sim", "sim_delay", "exp_rths"):
            disp, accel = file[f"{run}/rel_disp_m"][()], file[f"{run}/abs_accel_m_s2"][()]
            for i in range(3):
                drift = disp[i] - (disp[i - 1] if i else 0.0)
                shear = -sum(masses[j] * accel[j] for j in range(i, 3))
                found = [values[f"{run}.peak_{name}"][i] for name in PEAKS]
                series = (accel[i], disp[i], drift, shear)
                assert_allclose(found, [np.abs(one).max() for one in series], rtol=1e-12)
            assert values[f"{run}.peak_building_base_shear_n"] == values[f"{run}.peak_storey_shear_n"][0]
            weight = 9.80665 * masses.sum()
            assert_allclose(
                values[f"{run}.building_base_shear_ratio"],
                values[f"{run}.peak_building_base_shear_n"] / weight,
                rtol=1e-12,
            )
            if run != "sim":
                errors = error_figures(reference, np.zeros_like(reference), 1 / 2000.0, values[f"{run}.high_pass_hz"])
                percent = 100.0 * values[f"{run}.rms_error_m_s2"] / errors.rms
                assert_allclose(values[f"{run}.nrmse_percent"], percent, rtol=1e-9)
                largest = 100.0 * values[f"{run}.max_error_m_s2_full"] / errors.maximum_full
                assert_allclose(values[f"{run}.peak_error_percent_full"], largest, rtol=1e-9)
    assert values["sim_delay.psi"] == pytest.approx(np.log10(1e3 * values["sim_delay.critical_delay_s"]))
    assert 0.01 < values["exp_rths.nrmse_percent"].max() < 2.0


PEAKS = ("abs_accel_m_s2", "rel_disp_m", "inter_storey_drift_m", "storey_shear_n")


@pytest.mark.campaign
def test_heights_give_drift_ratios_and_must_be_of_every_storey(tmp_path: Path, memory: Memory) -> None:
    ended = run(tmp_path / "one.h5", memory, "structure.heights_m=[3.0, 2.5, 2.0]", "runs=[sim]")
    values = read_result(tmp_path / "one.h5").metrics
    assert ended.exit_code == 0
    drift = values["sim.peak_inter_storey_drift_m"]
    assert_allclose(values["sim.peak_drift_ratio"], drift / np.array([3.0, 2.5, 2.0]), rtol=1e-12)
    with pytest.raises(InputError, match=r"heights_m: must have one entry per storey, 3 in all"):
        load_cases([CASE], ("structure.heights_m=[3.0, 2.5]",))
