"""Figures of the building's response: profiles, hysteresis and histories hold the file's values."""

import h5py
import numpy as np
import pytest
from made_up_results import RATE, masses_kg, write_result
from scipy.signal import butter, sosfiltfilt

from rths_cli.files.result_reader import read_result
from rths_cli.report.figures import NotDrawn, draw
from rths_cli.report.result_scale import in_prototype_scale

BLACK, BLUE, VERMILLION = "#000000", "#0072B2", "#D55E00"
RUNS = {"sim": BLACK, "sim_delay": VERMILLION, "exp_rths": BLUE}
HEIGHTS = (0.5, 0.3, 0.2)


def peaks(values):
    return np.abs(values).max(axis=1)


def expected(data, run):
    """Return the peaks of a run in the units of the figure, by definition: drifts below each floor, inertia above."""
    disp, accel = data[f"{run}/rel_disp_m"], data[f"{run}/abs_accel_m_s2"]
    below = np.vstack([np.zeros(disp.shape[1]), disp[:-1]])
    above = [sum(m * a for m, a in zip(masses_kg(len(accel))[i:], accel[i:], strict=True)) for i in range(len(accel))]
    return {
        "acceleration": peaks(accel),
        "displacement": 1e3 * peaks(disp),
        "drift": 1e3 * peaks(disp - below),
        "storey shear": peaks(np.array(above)),
    }


def titled(figure):
    return {ax.get_title(loc="left").partition(") ")[2]: ax for ax in figure.axes if ax.get_visible()}


@pytest.mark.parametrize("width", ["one", "two"])
def test_profiles_show_the_peaks_of_each_run_over_the_floors(made_up, data, line_of, width):
    axes = titled(draw("profiles", made_up, width))
    assert list(axes) == ["acceleration", "displacement", "drift", "storey shear", "error to SIM"]
    assert [ax.get_xlabel() for ax in axes.values()] == [
        "peak (m/s²)", "peak (mm)", "peak (mm)", "peak (N)", "RMS (mm/s²)"
    ]  # fmt: skip
    assert axes["acceleration"].get_ylabel() == "floor"
    ground = {"acceleration": np.abs(data["record/ground_accel_m_s2"]).max(), "displacement": 0.0}
    for run, color in RUNS.items():
        for name, values in expected(data, run).items():
            x, y = line_of(axes[name], color)
            if name in ground:
                assert x == pytest.approx([ground[name], *values]) and y.tolist() == [0, 1, 2, 3]
            else:  # the same in the whole storey
                assert x == pytest.approx(np.repeat(values, 2)) and y.tolist() == [0, 1, 1, 2, 2, 3]
        if run != "sim":
            x, y = line_of(axes["error to SIM"], color)
            assert x == pytest.approx(1e3 * data[f"metrics/{run}/rms_error_m_s2"]) and y.tolist() == [1, 2, 3]
    interface = [line.get_ydata()[0] for line in axes["drift"].lines if len(line.get_xdata()) == 2]
    assert interface == [1]


def test_heights_are_the_axis_and_make_drift_ratios_where_the_case_states_them(tmp_path, line_of):
    result = read_result(write_result(tmp_path / "high.h5", heights_m=HEIGHTS))
    axes = titled(draw("profiles", result))
    with h5py.File(result.path) as file:
        drift = peaks(np.diff(file["sim/rel_disp_m"][()], axis=0, prepend=0.0))
    assert axes["acceleration"].get_ylabel() == "height (m)" and axes["drift"].get_xlabel() == "peak / height (%)"
    x, y = line_of(axes["drift"], BLACK)
    assert x == pytest.approx(np.repeat(100.0 * drift / HEIGHTS, 2)) and y == pytest.approx([0, 0.5, 0.5, 0.8, 0.8, 1])


def test_hysteresis_is_shear_over_drift_around_the_largest_drift(made_up, data):
    figure = draw("hysteresis", made_up, "one")
    axes = titled(figure)
    assert list(axes) == ["storey 3", "storey 2", "storey 1"]
    assert "6 s around the largest drift" in figure.get_suptitle().replace("\n", " ")
    for storey, ax in zip((3, 2, 1), axes.values(), strict=True):
        assert ax.get_xlabel() == "drift (mm)" and len(ax.lines) == 2
        for run, line in zip(("sim", "exp_rths"), ax.lines, strict=True):
            disp, accel = data[f"{run}/rel_disp_m"], data[f"{run}/abs_accel_m_s2"]
            drift = disp[storey - 1] - (disp[storey - 2] if storey > 1 else 0.0)
            shear = -(masses_kg(3)[storey - 1 :, None] * accel[storey - 1 :]).sum(axis=0)
            x, y = (np.asarray(values, float) for values in line.get_data())
            places = np.argmin(np.abs(1e3 * drift[:, None] - x), axis=0)
            assert x == pytest.approx(1e3 * drift[places]) and y == pytest.approx(shear[places], rel=1e-6)
            assert np.ptp(places) <= 6.0 * RATE + 2 and abs(places.mean() - np.abs(drift).argmax()) <= 3.1 * RATE
            assert np.abs(x).max() == pytest.approx(1e3 * np.abs(drift).max(), rel=0.02)


@pytest.mark.parametrize("width", ["one", "two"])
def test_sim_and_exp_rths_with_their_error_below_the_roof_first(made_up, data, line_of, width):
    axes = draw("against_sim", made_up, width).axes
    step = 2 if width == "one" else 4
    assert len(axes) == 3 * step
    for storey, upper, lower in zip((3, 2, 1), axes[::step], axes[1::step], strict=True):
        assert upper.get_title(loc="left").split("storey ")[1].startswith(str(storey))
        error = data["sim/abs_accel_m_s2"][storey - 1] - data["exp_rths/abs_accel_m_s2"][storey - 1]
        banded = 1e3 * sosfiltfilt(butter(4, 12.0, fs=RATE, output="sos"), error)
        t, v = line_of(lower, BLUE)
        assert v == pytest.approx(banded[np.round(t * RATE).astype(int)], abs=1e-6)
        assert np.abs(v).max() == pytest.approx(np.abs(banded).max())
        for run in ("sim", "exp_rths"):
            t, v = line_of(upper, RUNS[run])
            assert np.array_equal(v, data[f"{run}/abs_accel_m_s2"][storey - 1][np.round(t * RATE).astype(int)])
        assert (upper.get_ylabel(), lower.get_ylabel()) == ("acceleration\n(m/s²)", "error\n(mm/s²)")
        assert upper.get_title(loc="right") == f"RMS error {['0.600', '1.20', '1.80'][storey - 1]} mm/s²"
        assert upper.get_xlim() == lower.get_xlim()


def test_stored_drifts_and_shears_are_drawn_as_they_are(tmp_path, line_of):
    path = write_result(tmp_path / "stored.h5", runs=("sim",))
    with h5py.File(path, "a") as file:
        for name, units, factor in (("inter_storey_drift_m", "m", 0.001), ("storey_shear_n", "N", 2.0)):
            values = file.create_dataset(f"sim/{name}", data=factor * np.arange(3 * 1600.0).reshape(3, 1600))
            values.attrs.update({"units": units, "long_name": name, "source": "computed"})
            for axis, scale in enumerate(("storey", "time_s")):
                values.dims[axis].attach_scale(file[f"sim/{scale}"])
    axes = titled(draw("profiles", read_result(path)))
    assert line_of(axes["drift"], BLACK)[0] == pytest.approx(np.repeat([1599.0, 3199.0, 4799.0], 2))
    assert line_of(axes["storey shear"], BLACK)[0] == pytest.approx(np.repeat([3198.0, 6398.0, 9598.0], 2))


def test_storeys_with_laws_have_loops_of_spring_and_laws_where_all_runs_know_them(tmp_path):
    """The storey on the table, whose force EXP-RTHS does not know, keeps its shear in both."""
    path = write_result(tmp_path / "laws.h5")
    with h5py.File(path, "a") as file:
        for run, known in (("sim", 3), ("exp_rths", 1)):
            force = np.arange(3.0)[:, None] + np.zeros((3, file[f"{run}/time_s"].size))
            force[known:] = np.nan
            values = file.create_dataset(f"{run}/restoring_force_n", data=force)
            values.attrs.update({"units": "N", "long_name": "force", "source": "computed"})
            for axis, scale in enumerate(("storey", "time_s")):
                values.dims[axis].attach_scale(file[f"{run}/{scale}"])
    axes = titled(draw("hysteresis", read_result(path), "one"))
    words = {"storey 3": "storey shear (N)", "storey 2": "storey shear (N)", "storey 1": "spring and laws (N)"}
    assert {name: ax.get_ylabel() for name, ax in axes.items()} == words
    for line in axes["storey 1"].lines:
        assert not np.asarray(line.get_ydata()).any()  # the made-up force of storey 1
    assert all(np.ptp(line.get_ydata()) > 0.0 for line in axes["storey 2"].lines)


def test_a_file_without_displacements_has_the_profiles_that_it_can(tmp_path):
    path = write_result(tmp_path / "old.h5", runs=("sim",))
    with h5py.File(path, "a") as file:
        del file["sim/rel_disp_m"]
        del file["case/resolved"]
        file["case/resolved"] = "scaling: 1.0\n"
    result = read_result(path)
    assert list(titled(draw("profiles", result))) == ["acceleration"]
    with pytest.raises(NotDrawn, match="no displacements, or no masses of the floors, in the result"):
        draw("hysteresis", result)
    with pytest.raises(NotDrawn, match="no exp_rths in the result"):
        draw("against_sim", result)


def test_a_prototype_has_its_own_heights_and_shears(tmp_path, data, line_of):
    """Lengths four times, accelerations 0.5 times, masses 32 times those of the model: shears 16 times."""
    path = write_result(tmp_path / "model.h5", heights_m=HEIGHTS)
    with h5py.File(path, "r+") as file:
        file.attrs.update({"scale_length": 4.0, "scale_acceleration": 0.5, "scale_mass": 32.0})
    axes = titled(draw("profiles", in_prototype_scale(read_result(path)), "two"))
    wanted = expected(data, "sim")
    x, y = line_of(axes["storey shear"], BLACK)
    assert x == pytest.approx(16.0 * np.repeat(wanted["storey shear"], 2))
    assert y[-1] == pytest.approx(4.0 * sum(HEIGHTS))
    x, _ = line_of(axes["drift"], BLACK)  # of the height: the same in both scales
    assert x == pytest.approx(np.repeat(0.1 * wanted["drift"] / HEIGHTS, 2))


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("times", "at_s", "told"),
    [
        (5.0, None, ""),
        (10.5, None, "SIM-DELAY is 10.5 times SIM: not drawn"),
        (1.0, 3.21, "SIM-DELAY diverged at 3.21 s: not drawn"),
    ],
)
def test_a_sim_delay_far_from_sim_does_not_set_the_axes_and_the_figure_says_so(tmp_path, times, at_s, told):
    path = write_result(tmp_path / "delayed.h5")
    with h5py.File(path, "a") as file:
        exact = file["sim/abs_accel_m_s2"][()]
        file["sim_delay/abs_accel_m_s2"][...] = 0.9 * exact
        file["sim_delay/abs_accel_m_s2"][1] = times * exact[1]
        if at_s is not None:
            end = file["metrics/sim_delay"].create_dataset("diverged_at_s", data=at_s)
            end.attrs.update({"units": "s", "definition": "instant", "better": "none"})
    for name, width in (("profiles", "one"), ("profiles", "two"), ("responses", "one")):
        figure = draw(name, read_result(path), width)
        drawn = [line for ax in figure.axes for line in ax.lines if line.get_color() == VERMILLION]
        words = [text.get_text() for text in figure.legends[0].get_texts()]
        assert bool(drawn) == (told == "") == ("SIM-DELAY" in words)
        assert told == "" or words[-1] == told
        if told and name == "profiles":
            largest = 1.0 * np.abs(exact).max()
            assert titled(figure)["acceleration"].get_xlim()[1] < 1.3 * largest
