"""Cases with another test band from their file to pages and figures: a stiff small building, a soft large one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.signal import butter, sosfiltfilt

from rths_cli.analysis.metrics import high_passed
from rths_cli.analysis.stability_check import required
from rths_cli.case.load import load_cases
from rths_cli.cli import cli
from rths_cli.errors import InputError
from rths_cli.experiment.check import judge
from rths_cli.experiment.design import DEFAULT, design_blocks
from rths_cli.experiment.model_choice import Memory
from rths_cli.experiment.model_files import load, save
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.result_reader import Result, read_result
from rths_cli.identification.results import Identification
from rths_cli.numerics.bands import ComparedBand
from rths_cli.numerics.lti import Array
from rths_cli.report.figures.figure_data import Source
from rths_cli.report.page import histories
from rths_cli.report.result_tables import tables

ROOT = Path(__file__).parents[2]
BUILDINGS = {  # test band in Hz, storey stiffnesses in N/m, scaling
    "stiff": (30.0, 60_000.0, 50_000.0, 0.3, "FF"),
    "soft": (4.0, 700.0, 900.0, 0.15, "FF+FB"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with both cases and the first 12 s of a record."""
    folder = tmp_path_factory.mktemp("bands")
    lines = (ROOT / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in lines if not line.startswith("#")][:600]
    (folder / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    for name, (band_hz, computed, tested, scaling, controller) in BUILDINGS.items():
        (folder / f"{name}.yaml").write_text(f"""
structure:
  numerical: {{masses_kg: [12.0], stiffness_n_per_m: [{computed}]}}
  experimental: {{masses_kg: [4.0, 4.0], stiffness_n_per_m: [{tested}, {tested}], damping_ratios: [0.03, 0.03]}}
damping: {{first_mode_ratio: 0.03}}
record: {{file: short.csv}}
scaling: {scaling}
controller: {controller}
test_band_hz: {band_hz}
delay_s: 0.001
""")
    return folder


@pytest.fixture(scope="module")
def printed(folder: Path) -> dict[str, str]:
    """Return what `rths run` and `rths check` print, by case."""
    found = {}
    for name in BUILDINGS:
        words = [str(folder / f"{name}.yaml"), "--set", "identification.duration_s=60"]
        ran = CliRunner().invoke(cli, ["run", "--full", *words, "--output", str(folder / "results")])
        checked = CliRunner().invoke(cli, ["check", *words])
        assert (ran.exit_code, checked.exit_code) == (0, 0), ran.output + checked.output
        found[name] = ran.output + checked.output
    return found


def result_of(folder: Path, name: str) -> Result:
    return read_result(folder / "results" / f"{name}.h5")


def rms_below(error: Array, band_hz: float) -> Array:
    """Return the RMS (n_storeys,) of errors (n_storeys, n) at 2 kHz through the test band's low pass."""
    low = butter(4, band_hz, fs=2000.0, output="sos")
    return np.sqrt(np.mean(sosfiltfilt(low, error) ** 2, axis=-1))


@pytest.mark.campaign
@pytest.mark.parametrize("name", BUILDINGS)
def test_metrics_are_those_of_the_stated_band(folder: Path, printed: dict[str, str], name: str) -> None:
    """Of EXP-RTHS and SIM-DELAY, against filters of scipy; the usual band would give another figure."""
    assert name in printed
    result, band_hz = result_of(folder, name), BUILDINGS[name][0]
    with h5py.File(result.path, "r") as file:
        series = {run: np.asarray(file[f"{run}/abs_accel_m_s2"]) for run in ("sim", "sim_delay", "exp_rths")}
    for run in ("sim_delay", "exp_rths"):
        high_pass_hz = float(result.metrics[f"{run}.high_pass_hz"])
        error = high_passed(series["sim"] - series[run], high_pass_hz, 5e-4)
        told = result.metrics[f"{run}.rms_error_m_s2"]
        assert told == pytest.approx(rms_below(error, band_hz), rel=1e-6)
        share = 100.0 * told / rms_below(high_passed(series["sim"], high_pass_hz, 5e-4), band_hz)
        assert result.metrics[f"{run}.nrmse_percent"] == pytest.approx(share, rel=1e-6)
        assert np.abs(told / rms_below(error, 12.0) - 1.0).max() > 1e-3


@pytest.mark.campaign
@pytest.mark.parametrize("name", BUILDINGS)
def test_what_is_printed_names_the_band_in_force(folder: Path, printed: dict[str, str], name: str) -> None:
    band_hz = BUILDINGS[name][0]
    assert f"through a 4th-order {band_hz:g} Hz low pass" in " ".join(printed[name].split())
    assert f"up to {11.0 / 12.0 * band_hz:.3g} Hz" in printed[name]
    assert "12 Hz low pass" not in printed[name] and "up to 11 Hz" not in printed[name]


@pytest.mark.campaign
def test_figures_and_page_take_the_band_from_the_file(folder: Path, printed: dict[str, str]) -> None:
    """A file that states none is of before the choice: it was judged in the usual bands."""
    assert printed
    result = result_of(folder, "stiff")
    assert result.compared.hz == pytest.approx((1.75, 27.5))
    assert Source(result).band == "errors in the test band, below 30 Hz"
    assert {view.charts[1].title.split(", ")[1] for view in histories.tables(result)} == {"30 Hz test band"}
    old = {key: value for key, value in result.attributes.items() if "band" not in key and "compared" not in key}
    before = replace(result, attributes=old)
    assert (before.test_band_hz, before.compared.hz) == (12.0, (0.7, 11.0))
    assert "4th-order 12 or 30 Hz low pass" in " ".join(
        tables([result, replace(before, attributes=old | {"case_name": "other", "scaling": 0.2})]).split()
    )


@pytest.fixture(scope="module")
def soft(folder: Path) -> tuple[Setup, Identification]:
    settings = ("identification.duration_s=60", "controller=FF")
    setup = make_setup(load_cases([folder / "soft.yaml"], settings)[0])
    return setup, Memory().identify(setup, lambda _: None)


@pytest.mark.campaign
def test_the_check_follows_the_compared_band(soft: tuple[Setup, Identification]) -> None:
    """Highest line, smallest tolerated error and the error that must be tolerated."""
    setup, identified = soft
    band = setup.compared
    assert identified.compared == band and band.hz == pytest.approx((7.0 / 30.0, 11.0 / 3.0))
    judged = judge(setup, identified, design_blocks(setup, identified))
    assert judged.known is not None
    assert judged.known.lines.highest_hz == pytest.approx(40.0 / 3.0) and judged.known.compared == band
    stability = judged.preflight.stability
    assert stability.compared == band and stability.in_band_hz <= band.high_hz
    f, calm = np.array([3.0, 5.0]), np.zeros(2)
    narrow, usual = (required(f, (0.1, 5.0), calm, identified.levels, compared=each) for each in (band, ComparedBand()))
    assert narrow[1] - usual[1] > 0.04  # beyond the compared band nothing is verified to one percent
    assert DEFAULT.for_test_band(setup.case.test_band_hz).disturbance_hz == pytest.approx((1.0 / 3.0, 4.0))


@pytest.mark.campaign
def test_a_model_compared_in_another_band_is_refused(soft: tuple[Setup, Identification], tmp_path: Path) -> None:
    setup, identified = soft
    save(tmp_path / "m.h5", setup, identified, "made for this test", "0" * 64)
    assert load(tmp_path / "m.h5", setup).found.compared == setup.compared
    case = setup.case
    options = case.identification.model_copy(update={"compared_hz": (0.7, 11.0)})
    other = replace(setup, case=case.model_copy(update={"identification": options}))
    with pytest.raises(InputError) as refused:
        load(tmp_path / "m.h5", other)
    assert refused.value.exit_code == 2
    (fault,) = refused.value.faults
    assert "compared with its data in 0.233333-3.66667 Hz, the case needs 0.7-11 Hz; identify again" in fault


def test_a_test_band_beyond_the_sample_rate_ends_with_code_2(folder: Path) -> None:
    ended = CliRunner().invoke(cli, ["run", str(folder / "soft.yaml"), "--set", "test_band_hz=90"])
    refused = ended.exception
    assert isinstance(refused, InputError) and refused.exit_code == 2
    assert len(refused.faults) == 1 and "must be <= 80" in refused.faults[0]
