"""A run that was made elsewhere is judged as it was: a virtual EXP-RTHS, written into the files of other programs by
writers of the tests' own, has the metrics of its own result."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from declared_contents import declaration_faults
from nptdms import ChannelObject, TdmsWriter
from numpy.typing import NDArray
from portfolio import parametrize_first
from scipy.interpolate import CubicSpline
from scipy.io import savemat

from rths_cli.analysis.metrics import frequency_evaluation
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.errors import InputError
from rths_cli.experiment.check_command import check_cases
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.recorded_run import rounding, rounding_told, with_recordings
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import make_setup
from rths_cli.files.measured_data import Recording, RunChannels
from rths_cli.files.result_reader import Result, read_result

Array = NDArray[np.float64]
Series = dict[str, Array]
KEYS: dict[str, Any] = {
    "name": "made", "structure": "three_storey", "damping": "low", "record": "./short.csv", "scaling": 0.3,
    "controller": "FF+FB",
}  # fmt: skip
UNITS = {
    "ground": "m/s^2", "desired": "m/s^2", "command": "V", "table": "m/s^2", "floor 2": "m/s^2", "floor 3": "m/s^2",
    "base shear": "N",
}  # fmt: skip
DT_S = 1.0 / 2000.0
EQUAL = (
    "max_error_m_s2", "rms_error_m_s2", "max_error_m_s2_full", "rms_error_m_s2_full", "nrmse_percent",
    "nrmse_percent_full", "peak_error_percent", "peak_error_percent_full", "tracking_max_m_s2", "tracking_rms_m_s2",
    "tracking_max_m_s2_full", "tracking_rms_m_s2_full", "tracking_delay_s", "fei_amplitude", "fei_delay_s",
    "tracking_indicator_m2_s4", "energy_error_j", "energy_error_ratio", "peak_abs_accel_m_s2", "peak_storey_shear_n",
    "peak_building_base_shear_n", "building_base_shear_ratio", "high_pass_hz", *(f"j{n}" for n in range(2, 10)), "j1_s",
)  # fmt: skip
"""Metrics of EXP-RTHS that need no signal which only a rig of rths has: no true motions, no zeros, no filter states."""


@dataclass(frozen=True)
class Made:
    """The folder of a case, its virtual run's result, and that run's signals by channel."""

    folder: Path
    result: Result
    series: Series


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, memory: Memory) -> Made:
    folder = tmp_path_factory.mktemp("made")
    rng, time_s = np.random.default_rng(3), np.arange(0.0, 12.0, 0.01)
    waves = sum(np.sin(2 * np.pi * f * time_s + p) for f, p in rng.uniform((0.5, 0), (9.0, 6.28), (40, 2)))
    accel = 0.7 * waves * np.sin(np.pi * time_s / 12.0) ** 2
    (folder / "short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{a:.6f}" for a in accel))
    path = folder / "virtual.h5"
    setup = make_setup(load_cases([written(folder)])[0])
    assert run_case(setup, path, memory, "test", lambda _: None).exit_code == 0
    with h5py.File(path) as file:
        test = file["exp_rths"]
        floors = test["floor_accel_measured_m_s2"][()]
        series = {
            "ground": file["record/ground_accel_m_s2"][()],
            "desired": test["interface_accel_desired_m_s2"][()],
            "command": test["command_v"][()],
            "table": test["interface_accel_measured_m_s2"][()],
            "floor 2": floors[0],
            "floor 3": floors[1],
            "base shear": test["base_shear_n"][()],
        }
    return Made(folder, read_result(path), series)


def written(folder: Path, **keys: Any) -> dict[str, Any]:
    return {**KEYS, "record": str(folder / "short.csv"), **keys}


def evaluate(made: Made, path: Path, memory: Memory, channels: Mapping[str, Any] | None = None, **keys: Any) -> Result:
    """Judge a recording and return its result."""
    ended, out = judge(made, path, memory, channels, **keys)
    assert ended.exit_code == 0, ended.reason
    return read_result(out)


def judge(
    made: Made, path: Path, memory: Memory, channels: Mapping[str, Any] | None = None, **keys: Any
) -> tuple[Ended, Path]:
    spec = {"recording": str(path), "channels": channels or {}, **keys.pop("spec", {})}
    case = load_cases([written(made.folder, **{keys.pop("kind", "exp_rths"): spec, **keys})])[0]
    out = path.with_suffix(".h5")
    return run_case(with_recordings(make_setup(case)), out, memory, "test", lambda _: None), out


def refusal(made: Made, path: Path, channels: Mapping[str, Any] | None = None, **keys: Any) -> str:
    with pytest.raises(InputError) as caught:
        judge(made, path, Memory(), channels, **keys)
    assert all("\n" not in fault and path.name in fault for fault in caught.value.faults)
    return "\n".join(caught.value.faults)


def control_desk(path: Path, series: Series, time_s: Array) -> None:
    y = [{"Name": name, "Data": row, "Unit": UNITS[name], "XIndex": 1} for name, row in series.items()]
    savemat(path, {"rec_1": {"X": {"Name": "Time", "Data": time_s, "Unit": "s"}, "Y": y}})


def simulink(path: Path, series: Series, time_s: Array) -> None:
    signals = [{"values": row[:, None], "label": f"{name} ({UNITS[name]})"} for name, row in series.items()]
    savemat(path, {"Scope": {"time": time_s[:, None], "signals": signals, "blockName": "m/S"}})


def labview(path: Path, series: Series, time_s: Array) -> None:
    count, size = len(series), time_s.size
    head = ["LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t.", "X_Columns\tNo", "***End_of_Header***", ""]
    head += [f"Channels\t{count}", "\t".join(["Samples", *[str(size)] * count])]
    head += ["\t".join(["Y_Unit_Label", *(UNITS[name] for name in series)])]
    head += ["\t".join(["X0", *["0.0"] * count]), "\t".join(["Delta_X", *[f"{DT_S:.17g}"] * count])]
    head += ["***End_of_Header***", "\t".join(["X_Value", *series, "Comment"])]
    rows = ["\t".join(["", *(f"{value:.17g}" for value in values)]) for values in zip(*series.values(), strict=True)]
    path.write_text("\n".join([*head, *rows, ""]))


def tdms(path: Path, series: Series, time_s: Array) -> None:
    about = {"wf_increment": DT_S, "wf_start_offset": 0.0}
    channels = [
        ChannelObject("run", name, row, properties={"unit_string": UNITS[name], **about})
        for name, row in series.items()
    ]
    with TdmsWriter(path) as writer:
        writer.write_segment(channels)


def csv(path: Path, series: Series, time_s: Array, digits: int = 17) -> None:
    head = ",".join(["time (s)", *(f"{name} ({UNITS[name]})" for name in series)])
    columns = zip(time_s, *series.values(), strict=True)
    rows = (",".join([f"{t:.10g}", *(f"{value:.{digits}g}" for value in values)]) for t, *values in columns)
    path.write_text("\n".join([head, *rows, ""]))


WRITERS: dict[str, Callable[[Path, Series, Array], None]] = {
    "desk.mat": control_desk, "scope.mat": simulink, "run.lvm": labview, "run.tdms": tdms, "run.csv": csv,
}  # fmt: skip


def clock(series: Series) -> Array:
    return np.arange(series["table"].size) * DT_S


def saved(path: Path, series: Series, rate_hz: float = 2000.0) -> dict[str, list[str]]:
    """Write an .npz and return the channels of a case that reads it."""
    np.savez(path, fs=rate_hz, **series)
    return {role: [name, UNITS[name]] for name in series if (role := name.replace(" ", "_"))}


def compare(found: Result, made: Made, rtol: float, names: Sequence[str] = EQUAL, atol: float = 1e-18) -> None:
    for group, wanted in (("exp_rths", names), ("sim_delay", ("rms_error_m_s2", "nrmse_percent"))):
        for name in wanted:
            own, other = (np.asarray(one.metrics[f"{group}.{name}"]) for one in (made.result, found))
            np.testing.assert_allclose(other, own, rtol=rtol, atol=atol, err_msg=name)


@parametrize_first(2, "name", WRITERS)
def test_a_run_in_the_file_of_another_program_has_the_metrics_of_its_result(
    name: str, made: Made, tmp_path: Path, memory: Memory
) -> None:
    path = tmp_path / name
    WRITERS[name](path, made.series, clock(made.series))
    found = evaluate(made, path, memory)
    compare(found, made, 1e-9)
    about = found.attributes
    assert (about["controller"], about["rig_kind"]) == ("own (recorded)", "recorded")
    assert str(about["exp_rths_recording"]).startswith(f"{name}, SHA-256 ")
    assert "identified model" in str(about["no_true_error_bound"])
    assert found.metrics["exp_rths.recording_interpolated"] == 0.0
    assert declaration_faults(path.with_suffix(".h5")) == []


def test_what_the_rounding_of_a_file_alone_does_is_told() -> None:
    """Forty roundings of a motion and of the same late by 0.2 us: the spread of the delays is the stated one."""
    rng, time_s = np.random.default_rng(7), np.arange(8000) * DT_S
    waves, late_s = rng.uniform((0.5, 0.0, 0.3), (8.0, 6.28, 1.0), (20, 3)), 2e-7
    apart: list[float] = []
    for scale in rng.uniform(1.0, 10.0, 40):
        motions = (sum(a * np.sin(2 * np.pi * f * (time_s - d) + p) for f, p, a in waves) for d in (0.0, late_s))
        desired, table = (np.array([float(f"{value:.6g}") for value in scale * motion]) for motion in motions)
        apart.append(frequency_evaluation(desired, table, DT_S).delay_s - late_s)
    figures, error = rounding(table)
    assert figures == "6 digits" and rounding(time_s)[0] == "4 decimals" and rounding(np.sin(time_s)) == ("", 0.0)
    series = {"desired": desired, "table": table}
    recording = Recording(Path("a"), "", DT_S, ("desired", "table"), ("g", "g"), np.array([desired, table]))
    channels = RunChannels(series, {}, {"desired": "desired", "table": "table"})
    (told,) = rounding_told(recording, channels, series, DT_S)
    assert f"desired to 6 digits and table to 6 digits: that alone is {np.sqrt(2.0) * error:.2g} m/s^2" in told
    stated_s = 1e-6 * float(told.partition("+- ")[2].split()[0])
    assert 0.2 * stated_s < np.std(apart) < 0.5 * stated_s  # a third


@pytest.mark.campaign
def test_six_digits_and_another_order_change_nothing_that_counts(made: Made, tmp_path: Path, memory: Memory) -> None:
    turned = dict(reversed(list(made.series.items())))
    csv(tmp_path / "run.csv", turned, clock(turned), digits=6)
    found = evaluate(made, tmp_path / "run.csv", memory)
    large = [name for name in EQUAL if "rms_error" in name or "nrmse" in name]
    compare(found, made, 1e-4, large)
    compare(found, made, 1e-2, [name for name in EQUAL if name not in large])  # rounded samples are 1 % of these
    assert "the file rounds desired to 6 digits and table to 6 digits" in str(found.attributes["warnings"])


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("before", "rate_hz"), [(1234, 2000.0), (1234, 2060.0)], ids=["foreign start", "stated rate 3 % wrong"]
)
def test_a_foreign_start_is_taken_off_by_whole_samples(
    before: int, rate_hz: float, made: Made, tmp_path: Path, memory: Memory
) -> None:
    late = {name: np.concatenate([np.zeros(before), row, np.zeros(300)]) for name, row in made.series.items()}
    found = evaluate(made, tmp_path / "a.npz", memory, saved(tmp_path / "a.npz", late, rate_hz))
    compare(found, made, 1e-9)
    assert float(np.asarray(found.metrics["exp_rths.recording_start_s"])) == pytest.approx(before / rate_hz)
    said = str(found.attributes["warnings"])
    assert "moved by whole samples" in said and ("3 % wrong" in said or "2.91 % wrong" in said) == (rate_hz != 2000.0)


@pytest.mark.campaign
def test_a_clock_that_is_20_ppm_fast_is_found_and_taken_off(made: Made, tmp_path: Path, memory: Memory) -> None:
    count, places = made.series["table"].size, -100.4 + (1.0 - 20e-6) * np.arange(made.series["table"].size + 300)

    def taken(row: Array) -> Array:
        inside = np.clip(places, 0, count - 1)
        return np.where(places < 0, 0.0, CubicSpline(np.arange(count), row)(inside))

    moved = {name: taken(row) for name, row in made.series.items()}
    found = evaluate(made, tmp_path / "a.npz", memory, saved(tmp_path / "a.npz", moved))
    assert float(np.asarray(found.metrics["exp_rths.recording_clock_fast"])) == pytest.approx(20e-6, abs=1e-7)
    assert float(np.asarray(found.metrics["exp_rths.recording_start_s"])) == pytest.approx(100.402 * DT_S, abs=1e-6)
    assert "20 +- " in str(found.attributes["warnings"]) and "ppm fast" in str(found.attributes["warnings"])
    for name in ("peak_abs_accel_m_s2", "tracking_rms_m_s2", "rms_error_m_s2"):
        own, other = (np.asarray(one.metrics[f"exp_rths.{name}"]) for one in (made.result, found))
        np.testing.assert_allclose(other, own, rtol=0.05, err_msg=name)
    with h5py.File(tmp_path / "a.h5") as file:
        left = file["exp_rths/interface_accel_desired_m_s2"][: count - 100] - made.series["desired"][: count - 100]
    assert np.abs(left).max() < 1e-3 * np.abs(made.series["desired"]).max()


@pytest.mark.campaign
def test_lost_samples_are_told_and_the_part_before_them_is_judged(made: Made, tmp_path: Path, memory: Memory) -> None:
    path, at = tmp_path / "a.npz", 14_000
    cut = {name: np.concatenate([row[:at], row[at + 150 :]]) for name, row in made.series.items()}
    channels = saved(path, cut)
    said = refusal(made, path, channels)
    assert "150 samples (0.075 s) are lost after sample 140" in said and "--until 6.99" in said
    found = evaluate(made, path, memory, channels, spec={"until_s": 6.9})
    assert found.attributes["exp_rths_status"] == "complete" and "judged up to 6.9000 s" in str(
        found.attributes["warnings"]
    )
    with h5py.File(path.with_suffix(".h5")) as file, h5py.File(made.folder / "virtual.h5") as own:
        count = file["exp_rths/command_v"].size
        assert count == file["record/time_s"].size == 13_801
        assert np.array_equal(file["exp_rths/command_v"][()], own["exp_rths/command_v"][:count])
        np.testing.assert_allclose(file["sim/abs_accel_m_s2"][()], own["sim/abs_accel_m_s2"][:, :count], atol=1e-9)
    gap = {name: np.where((np.arange(row.size) // 150) == 93, np.nan, row) for name, row in made.series.items()}
    said = refusal(made, path, saved(path, gap))
    assert "150 samples (0.075 s) are missing in ground, desired" in said and "--until 6.97" in said


@pytest.mark.parametrize(
    ("change", "keys", "told"),
    [
        ({"ground": -1.0}, {}, "the ground motion of the recording has the opposite sign of the record's"),
        ({"table": -1.0}, {}, "table has the opposite sign of the desired motion"),
        ({"floor 3": -1.0}, {}, "floor_3 moves as the case's specimen on the measured table with the opposite sign"),
        ({"base shear": -1.0}, {}, "base_shear has the opposite sign of minus the masses times the measured"),
        ({"table": 1.0 / 9.80665}, {}, "table is 0.102 times the desired motion; correct its unit"),
        ({"floor 2": 1e3}, {}, "floor_2 is 1e+03 times the motion that the case's specimen has"),
        ({}, {"scaling": 0.2}, "is 1.5 times that of the case; the test was scaled by 0.3, the case says 0.2"),
        ({}, {"record": "el_centro"}, "is not the record el_centro of the case"),
        ({}, {"record_filter": {"corner_hz": 1.0}}, "another component, baseline, record_filter or scale was played"),
    ],
)
def test_what_is_wrong_is_told_by_its_cause(
    change: dict[str, float], keys: dict[str, Any], told: str, made: Made, tmp_path: Path
) -> None:
    series = {name: change.get(name, 1.0) * row for name, row in made.series.items()}
    said = refusal(made, tmp_path / "a.npz", saved(tmp_path / "a.npz", series), **keys)
    assert told in said and len(said.splitlines()) == 1


@pytest.mark.campaign
def test_exchanged_floors_are_told_and_a_minus_turns_a_sign(made: Made, tmp_path: Path, memory: Memory) -> None:
    path = tmp_path / "a.npz"
    swapped = made.series | {"floor 2": made.series["floor 3"], "floor 3": made.series["floor 2"]}
    assert "floor_2 and floor_3 are exchanged" in refusal(made, path, saved(path, swapped))
    turned = made.series | {"table": -made.series["table"]}
    channels = saved(path, turned) | {"table": ["table", "-m/s^2"]}
    compare(evaluate(made, path, memory, channels), made, 1e-9)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"damping": "high"}, "times the damping"),
        ({"structure": {"extends": "three_storey", "numerical": {"masses_kg": [6.0]}}}, "times the mass"),
    ],
)
def test_another_building_is_told_and_not_graded(
    keys: dict[str, Any], told: str, made: Made, tmp_path: Path, memory: Memory
) -> None:
    path = tmp_path / "a.npz"
    ended, out = judge(made, path, memory, saved(path, made.series), **keys)
    why = str(read_result(out).attributes["no_true_error_bound"])
    assert ended.exit_code == 1 and why == ended.reason
    assert "is not what the computed storeys of the case do" in why and told in why


def test_another_specimen_is_found_with_its_stiffness(made: Made, tmp_path: Path, memory: Memory) -> None:
    path = tmp_path / "a.npz"
    other = {"stiffness_n_per_m": [7000.0, 7700.0], "masses_kg": [6.91, 6.95], "damping_ratios": [0.043, 0.039]}
    numerical = {"masses_kg": [6.93], "stiffness_n_per_m": [7353.98]}
    structure = {"numerical": numerical, "experimental": other, "damping_levels": {"low": {"first_mode_ratio": 0.026}}}
    _, out = judge(made, path, memory, saved(path, made.series), structure=structure)
    over = np.asarray(read_result(out).metrics["exp_rths.stiffness_over_declared"])
    np.testing.assert_allclose(over[1:], [7331.56 / 7000.0, 7376.40 / 7700.0], rtol=0.003)


@pytest.mark.campaign
def test_what_is_missing_is_named_with_its_cost(made: Made, tmp_path: Path, memory: Memory) -> None:
    path = tmp_path / "a.npz"
    least = {name: made.series[name] for name in ("ground", "table", "floor 2", "floor 3")}
    found = evaluate(made, path, memory, saved(path, least))
    said = str(found.attributes["warnings"])
    for role in ("desired", "command", "base_shear", "displacements"):
        assert f"no {role}: " in said
    for name in ("rms_error_m_s2", "nrmse_percent", "peak_abs_accel_m_s2"):  # which need none of them
        own, other = (np.asarray(one.metrics[f"exp_rths.{name}"]) for one in (made.result, found))
        np.testing.assert_allclose(other, own, rtol=1e-9)
    blind = {name: row for name, row in made.series.items() if name != "ground"}
    compare(evaluate(made, path, memory, saved(path, blind)), made, 1e-9)
    neither = {name: row for name, row in blind.items() if name != "desired"}
    assert "has neither the ground motion nor the desired motion" in refusal(made, path, saved(path, neither))
    one = {name: row for name, row in made.series.items() if name != "floor 3"}
    assert "floor_3: no channel has such a name" in refusal(made, path, saved(path, one))


@pytest.mark.campaign
def test_another_interpolation_of_the_record_is_the_ground_motion_of_sim(
    made: Made, tmp_path: Path, memory: Memory
) -> None:
    path = tmp_path / "a.npz"
    noise = np.random.default_rng(2).normal(size=made.series["ground"].size)
    other = made.series["ground"] + 0.05 * made.series["ground"].std() * noise
    found = evaluate(made, path, memory, saved(path, made.series | {"ground": other}))
    assert "SIM and SIM-DELAY take the recorded one" in str(found.attributes["warnings"])
    with h5py.File(path.with_suffix(".h5")) as file:
        assert np.array_equal(file["record/ground_accel_m_s2"][()], other)


def test_a_recorded_shake_table_test_is_judged_too(made: Made, tmp_path: Path, memory: Memory) -> None:
    with h5py.File(made.folder / "virtual.h5") as file:
        test = file["shake_table"]
        series = {"ground": made.series["ground"], "table": test["interface_accel_measured_m_s2"][()]}
    path = tmp_path / "a.npz"
    found = evaluate(made, path, memory, saved(path, series), kind="shake_table")
    for name in ("tracking_rms_m_s2", "tracking_max_m_s2_full", "fei_delay_s", "j2"):
        own, other = (np.asarray(one.metrics[f"shake_table.{name}"]) for one in (made.result, found))
        np.testing.assert_allclose(other, own, rtol=1e-9)
    assert "exp_rths_status" not in found.attributes


def test_the_stored_case_is_read_again_and_nothing_is_checked_before_a_recorded_run(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    spec = {"recording": str(path), "channels": saved(path, made.series)}
    case = load_cases([written(made.folder, exp_rths=spec)])[0]
    assert case.runs == ("sim", "sim_delay", "exp_rths")
    (tmp_path / "again.yaml").write_text(resolved_yaml(case))
    again = load_cases([tmp_path / "again.yaml"])[0]
    assert again.recorded == case.recorded
    with pytest.raises(InputError, match="is a run that was made; nothing is to be checked"):
        check_cases([case], (), lambda _: None)
    with pytest.raises(InputError, match="shake_table has no recording and the case has one"):
        load_cases([written(made.folder, exp_rths=spec, runs=["sim", "shake_table", "exp_rths"])])
    with pytest.raises(InputError, match="is the recording of a run that runs does not name"):
        load_cases([written(made.folder, exp_rths=spec, runs=["sim"])])
