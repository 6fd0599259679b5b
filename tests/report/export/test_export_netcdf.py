"""netCDF: xarray reads the file, its numbers are the result's, its attributes what CF asks for."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray
from made_result import STOPPED, N, contents, make

from rths_cli.report.export.export_command import ExportRequest, export
from rths_cli.report.export.netcdf_file import udunits


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = make(tmp_path_factory.mktemp("netcdf") / "demo.h5")
    export(ExportRequest((path,), "netcdf", path.parent))
    return path


def test_the_result_itself_opens_by_group_and_as_a_tree(result: Path) -> None:
    with xarray.open_datatree(result, engine="h5netcdf") as tree:
        assert tree["exp_rths"].abs_accel_m_s2.sizes == {"storey": 3, "time_s": N}
    with xarray.open_dataset(result, group="exp_rths", engine="h5netcdf") as run:
        assert float(run.abs_accel_m_s2.sel(storey=2)[4]) == contents(result)["exp_rths/abs_accel_m_s2"][1, 4]


def test_xarray_reads_every_number_of_the_copy(result: Path) -> None:
    held = {path: data for path, data in contents(result).items() if np.size(data)}
    compared = 0
    with xarray.open_datatree(result.with_suffix(".nc"), engine="h5netcdf") as tree:
        for path, numbers in held.items():
            group, _, name = path.rpartition("/")
            if group.startswith("case") or name not in tree[group].variables:
                continue
            assert np.array_equal(tree[group][name].values, numbers, equal_nan=True), path
            compared += 1
        assert tree["exp_rths"].abs_accel_m_s2.dims == ("storey", "time_s")
    assert compared > 30


def test_only_scales_that_nothing_needs_are_left_out(result: Path) -> None:
    held, copied = contents(result), contents(result.with_suffix(".nc"))
    left = {path for path in held if path not in copied and np.size(held[path])}
    assert {path.rpartition("/")[2] for path in left} <= {"storey", "floor", "state", "input", "output", "next_state"}
    assert set(copied) <= set(held)


def test_the_file_says_what_cf_asks_for(result: Path) -> None:
    with h5py.File(result.with_suffix(".nc")) as file:
        assert file.attrs["Conventions"] == "CF-1.11"
        assert (
            file.attrs["title"] == "Real-time hybrid simulation demo, method best, virtual shake table aps400_virtual"
        )
        assert "2026-11-21T12:00:00Z rths run demo" in file.attrs["history"]
        assert (file.attrs["status"], file.attrs["seed"]) == ("complete", 3)
        assert "format" not in file.attrs
        assert file["metrics/check/phase_margin_deg"].attrs["units"] == "degree"
        gain = file["identification/gain"]
        assert "units" not in gain.attrs and gain.attrs["comment"] == "units: as zeros and poles"
        assert list(file["controller/feedforward"].attrs["inputs"]) == ["accel_m_s2", "vel_m_s", "disp_m"]
        assert file["exp_rths/abs_accel_m_s2"].attrs["source"] == "measured"


def test_every_array_has_a_scale_for_every_axis_and_none_is_empty(result: Path) -> None:
    faults = []

    def look(name: str, node: object) -> None:
        if isinstance(node, h5py.Dataset) and not node.is_scale:
            faults.extend(name for axis in node.dims if not len(axis))
            faults.extend(name for length in node.shape if length == 0)

    with h5py.File(result.with_suffix(".nc")) as file:
        file.visititems(look)
    assert faults == []


@pytest.mark.parametrize(
    ("units", "spelt"),
    [
        ("m/s^2", "m/s^2"), ("m/s^2/V", "m/s^2/V"), ("N*s/m", "N*s/m"), ("m^2/s^4", "m^2/s^4"), ("1", "1"),
        ("deg", "degree"), ("as inputs and outputs", None), ("as zeros and poles", None), ("bananas", None), ("", None),
    ],
)  # fmt: skip
def test_units_are_udunits(units: str, spelt: str | None) -> None:
    assert udunits(units) == spelt


def test_udunits_itself_knows_them() -> None:
    cf_units = pytest.importorskip("cf_units")
    for units in ("m", "s", "m/s", "m/s^2", "m^2/s^4", "N", "V", "Hz", "rad/s", "J", "m/s^2/V", "N*s/m", "deg", "1"):
        assert not cf_units.Unit(udunits(units)).is_unknown()


def test_the_c_library_reads_it(result: Path) -> None:
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(result.with_suffix(".nc")) as file:
        assert file["exp_rths/command_v"].dimensions == ("time_s",)
        assert np.array_equal(file["exp_rths/command_v"][:], contents(result)["exp_rths/command_v"])


def test_a_stopped_run_goes_as_far_as_it_went_and_says_so(tmp_path: Path) -> None:
    export(ExportRequest((make(tmp_path / "cut.h5", "aborted"),), "netcdf", tmp_path))
    with xarray.open_datatree(tmp_path / "cut.nc", engine="h5netcdf") as tree:
        assert tree["exp_rths"].sizes["time_s"] == STOPPED and tree["record"].sizes["time_s"] == N
        assert tree.attrs["status"] == "aborted"
