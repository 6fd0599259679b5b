"""The page holds what the files hold: every kind of result, its data, its verdicts, and no way out to a network."""

from __future__ import annotations

import base64
import hashlib
import math
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import page_reader
import page_results
import pytest
from scipy.signal import butter, freqs_zpk, sosfiltfilt

from rths_cli.errors import InputError
from rths_cli.files.result_reader import Result, read_result
from rths_cli.report.answer import verdict
from rths_cli.report.page import page, write_page
from rths_cli.report.page.document import SCRIPTS, STYLES, asset

ROOT = Path(__file__).parents[3]
COMMAND = "rths report results --format html --output page.html"
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"' onload='x"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Result:
    """Return a complete result with figures."""
    path = tmp_path_factory.mktemp("page") / "made_up.h5"
    metrics = {
        "exp_rths.rms_error_m_s2": np.array([0.01, 0.02, 0.03]),
        "exp_rths.tracking_max_m_s2": 0.5,
    }
    limits = 'accept: {"exp_rths.rms_error_m_s2[3]": 0.025, exp_rths.rms_error_m_s2: 0.03, exp_rths.j2: 1.0}\n'
    notes = "notes: by hand\n"
    return page_results.write(path, resolved=page_results.RESOLVED + limits + notes, metrics=metrics)


@pytest.fixture(scope="module")
def text(whole: Result) -> str:
    """Return the page of the complete result."""
    return page([whole], COMMAND)


def shown(text: str, kind: str, view: int, chart: int, trace: int) -> tuple[np.ndarray, np.ndarray]:
    """Return places and values of a trace of the first result."""
    found = page_reader.data(text)
    one = found["results"][0][kind][view]["charts"][chart]["traces"][trace]
    places, values = page_reader.series(found["series"][one["series"]])
    return np.array(places), np.array(values)


def test_the_page_is_well_formed_and_needs_no_network(text: str) -> None:
    found = page_reader.read(text)
    assert not found.wrong and not found.open_
    links = [v for _, a in found.elements for name, v in a.items() if name in ("src", "href", "action", "data")]
    assert links and all(link.startswith("#") or link == "data:," for link in links)
    ids = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(ids) == len(set(ids)) and {link[1:] for link in links if link.startswith("#")} <= set(ids)
    assert not re.search(r"@import|url\(", "".join(asset(name) for name in STYLES))


def test_only_the_embedded_scripts_may_run(text: str) -> None:
    found = page_reader.read(text)
    policy = next(a["content"] for a in found.all("meta") if a.get("http-equiv") == "Content-Security-Policy")
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert len(scripts) == len(SCRIPTS) == len(found.all("script")) - 1
    hashes = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    allowed = " ".join(f"'sha256-{one}'" for one in hashes)
    assert f"script-src {allowed};" in policy
    assert "default-src 'none'" in policy


def test_the_library_is_the_one_that_its_note_names() -> None:
    assert asset("uPlot.iife.min.js").startswith("/*! https://github.com/leeoniya/uPlot (v1.6.32) */")
    assert "1.6.32" in (ROOT / "docs" / "reference" / "report_page.md").read_text()
    assert "Copyright (c) 2022 Leon Sorokin" in asset("uPlot.LICENSE")


def test_what_is_plotted_of_a_storey_is_what_the_file_holds(whole: Result, text: str) -> None:
    with h5py.File(whole.path) as file:
        for storey in range(3):
            for trace, run in enumerate(("sim", "sim_delay", "exp_rths")):
                values = file[f"{run}/abs_accel_m_s2"][storey]
                places, read = shown(text, "storeys", 2 - storey, 0, trace)  # the roof first
                assert np.abs(read - values[places]).max() <= np.abs(values).max() / 65534 * (1 + 1e-9)
                assert read.max() == pytest.approx(values.max(), abs=np.abs(values).max() / 65534)
                assert np.abs(read).max() == pytest.approx(np.abs(values).max(), rel=1e-12)


def test_errors_are_plotted_in_the_test_band_with_their_peaks(whole: Result, text: str) -> None:
    sections = butter(4, 12.0, fs=page_results.RATE_HZ, output="sos")
    with h5py.File(whole.path) as file:
        sim, exp = file["sim/abs_accel_m_s2"][1], file["exp_rths/abs_accel_m_s2"][1]
        table = [file[f"shake_table/interface_accel_{name}_m_s2"][:] for name in ("desired", "measured")]
    for kind, view, trace, error in (("storeys", 1, 1, sim - exp), ("runs", 1, 0, table[0] - table[1])):
        expected = 1e3 * sosfiltfilt(sections, error)  # mm/s^2
        places, read = shown(text, kind, view, 1, trace)
        assert np.abs(read - expected[places]).max() < 1e-4 * np.abs(expected).max()
        assert np.abs(read).max() == pytest.approx(np.abs(expected).max(), rel=1e-9)


def test_the_first_section_shows_verdict_building_and_record(tmp_path: Path) -> None:
    metrics = {
        "exp_rths.nrmse_percent": np.array([0.5, 3.1, 0.2]),
        "exp_rths.true_error_bound_percent": np.array([0.7, 3.4, 0.3]),
        "exp_rths.true_error_median_percent": np.array([0.4, 1.8, 0.2]),
        "exp_rths.rms_error_m_s2": np.array([0.001, 0.002, 0.003]),
        "exp_rths.peak_abs_accel_m_s2": np.array([1.5, 2.25, 3.125]),
        "exp_rths.peak_inter_storey_drift_m": np.array([0.004, 0.003, 0.002]),
    }
    heights = page_results.RESOLVED.replace("structure: {", "structure: {heights_m: [0.5, 0.25, 0.25], ")
    result = page_results.write(tmp_path / "x.h5", metrics=metrics, samples=900, resolved=heights)
    text = page([result], COMMAND)
    found = page_reader.read(text)
    words = " ".join(found.words().split())
    assert verdict(result) in words and verdict(result).startswith(
        "USABLE: true error below 3.40 % of SIM (95 %), likely 1.80 %, storey 2, virtual rig"
    )
    assert words.index(verdict(result)) < words.index("Response by storey") < words.index("Status and limits")
    assert (
        "peaks in EXP-RTHS RMS error of acceleration storey abs. accel drift EXP-RTHS EXP-RTHS m/s² mm mm/s² % of SIM"
        in words
    )
    assert "3 roof 3.12 2.00 3.00 0.200" in words and "1 interface 1.50 4.00 1.00 0.500" in words
    assert words.index("3 roof 3.12") < words.index("1 interface 1.50")
    (sketch,) = found.all("svg")
    assert sketch["aria-label"] == "Building of 3 storeys: 1 to 1 computed, 2 to 3 on the table"
    floors = [line for line in found.all("line") if line["class"].startswith("floor")]
    assert [line["class"] for line in floors] == ["floor computed", "floor tested", "floor tested"]
    (cut,) = [line for line in found.all("line") if line["class"] == "cut"]
    (ground,) = [line for line in found.all("line") if line["class"] == "ground"]
    rise = [float(ground["y1"]) - float(line["y1"]) for line in floors]
    assert np.array(rise) / rise[-1] == pytest.approx([0.5, 0.75, 1.0], abs=1e-3) and cut["y1"] == floors[0]["y1"]
    for label in ("3 roof, 5 kg", "2, 6 kg", "1 interface, 7 kg", "1 m high"):
        assert label in words
    record = page_reader.data(text)["results"][0]["record"]
    _, values = page_reader.series(page_reader.data(text)["series"][record["traces"][0]["series"]])
    with h5py.File(result.path) as file:
        assert np.abs(values).max() == pytest.approx(np.abs(file["record/ground_accel_m_s2"][:]).max())
    assert (record["title"], record["unit"]) == ("Ground acceleration", "m/s²")


def test_charts_name_their_units_and_the_error_of_exp_rths_is_not_hidden(text: str) -> None:
    (first, *_), (table, *_) = (page_reader.data(text)["results"][0][kind] for kind in ("storeys", "runs"))
    assert first["name"] == "3 (roof)"
    assert [chart["unit"] for chart in (*first["charts"], *table["charts"])] == ["m/s²", "mm/s²", "m/s²", "mm/s²"]
    errors = {trace["name"]: trace["shown"] for trace in first["charts"][1]["traces"]}
    assert errors == {"SIM - SIM-DELAY": False, "SIM - EXP-RTHS": True}


def test_the_verdict_and_the_building_of_every_result_are_there_and_one_is_shown(tmp_path: Path) -> None:
    results = [
        page_results.write(tmp_path / "a.h5", samples=100, case_name="a", status="aborted", reason="too fast"),
        page_results.write(tmp_path / "b.h5", samples=100, case_name="b", runs=("sim",), resolved="runs: [sim]\n"),
    ]
    found = page_reader.read(page(results, COMMAND))
    parts = [attributes for _, attributes in found.elements if "data-result" in attributes]
    assert [(part["data-result"], "hidden" in part) for part in parts] == [("0", False), ("1", True)] * 2
    kinds = [attributes["class"] for attributes in found.all("p") if attributes.get("class", "").startswith("verdict")]
    assert kinds == ["verdict bad", "verdict open"] and "ABORTED: too fast" in found.words()
    said = " ".join(found.words().split())
    assert said.count("ABORTED: too fast") == 2 and said.count("NO HYBRID TEST: the case asks for SIM alone.") == 2
    assert "Response by storey" not in said and "#response" not in [link.get("href") for link in found.all("a")]
    assert len(found.all("svg")) == 1, "the second case has lost its building"


def test_time_is_that_of_the_file(text: str) -> None:
    for one in page_reader.data(text)["series"]:
        assert (one["t0"], one["dt"], one["n"]) == (0.0, 1.0 / page_results.RATE_HZ, 40_000)


def test_the_response_is_that_of_file_and_model(whole: Result, text: str) -> None:
    (found,) = page_reader.data(text)["responses"]
    with h5py.File(whole.path) as file:
        hz = file["identification/frequency_hz"][:]
        frf = file["identification/frf_real"][:] + 1j * file["identification/frf_imag"][:]
        coherence = file["identification/coherence"][:]
    _, analog = freqs_zpk(page_results.ZEROS, page_results.POLES, 1e3, 2 * np.pi * hz)
    dt = 1.0 / page_results.RATE_HZ
    late = np.exp(-2j * np.pi * hz * dt)
    integral = np.pi * 0.1 * dt
    model = analog * np.exp(-2j * np.pi * hz * 0.001) * np.sin(np.pi * hz * dt) / (np.pi * hz * dt)
    model += 0.4 * late**2 * (1 - late + integral * (1 + late))  # the case says latency_samples: 2
    assert page_reader.floats(found["frequency"]) == pytest.approx(hz, rel=1e-6)
    assert page_reader.floats(found["measured"]) == pytest.approx(np.abs(frf), rel=1e-6)
    assert page_reader.floats(found["modelled"]) == pytest.approx(np.abs(model), rel=1e-5)
    assert page_reader.floats(found["coherence"]) == pytest.approx(coherence, rel=1e-6)
    for name, response in (("phase", frf), ("modelled_phase", model)):
        turned = np.radians(page_reader.floats(found[name])) - np.angle(response)
        assert np.abs(np.exp(1j * turned) - 1.0).max() < 1e-4


def test_the_words_say_what_the_file_says(whole: Result, text: str) -> None:
    words = page_reader.read(text).words()
    assert "virtual: no table moved" in words and "shake table aps400_virtual" in words
    for key in ("rths_version", "git_commit", "record_sha256", "model_sha256", "platform", "command_line"):
        assert str(page_results.ABOUT[key]) in words
    assert "python 3.11.7, numpy 2.0.0" in words
    assert COMMAND in words and "Notes of the case: by hand" in words
    assert "scaling: 0.3\n" in words and whole.resolved_yaml in words
    assert "RMS of SIM - absolute acceleration of each storey" in words and "0.01  0.02  0.03" in words


def test_limits_are_judged_as_the_run_judges_them(text: str) -> None:
    words = " ".join(page_reader.read(text).words().split())
    assert "not met exp_rths.rms_error_m_s2[3]: 0.03, limit 0.025" in words
    assert " met exp_rths.rms_error_m_s2: 0.03, limit 0.03" in words
    assert "not met exp_rths.j2: not computed, limit 1" in words
    assert "accept limits: 2 not met, 1 met" in words


def test_the_command_can_be_copied(text: str) -> None:
    found = page_reader.read(text)
    codes = [attributes["id"] for attributes in found.all("code")]
    assert [button["data-copy"] for button in found.all("button")] == codes and len(codes) == 2


@pytest.mark.campaign
def test_the_same_results_give_the_same_bytes(whole: Result, tmp_path: Path) -> None:
    first, second = tmp_path / "a.html", tmp_path / "b.html"
    write_page([whole], first, COMMAND)
    write_page([whole], second, COMMAND)
    assert first.read_bytes() == second.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "b.html"]


def test_hostile_names_stay_words(tmp_path: Path) -> None:
    names = dict.fromkeys(
        ("case_name", "rig", "method", "controller", "status_reason", "warnings", "command_line", "git_commit"), HOSTILE
    )
    case = f"notes: '{HOSTILE.replace(chr(39), chr(39) * 2)}'\n"
    result = page_results.write(
        tmp_path / "x.h5", samples=100, resolved=case, status="aborted", reason=HOSTILE, **names
    )
    with h5py.File(result.path, "r+") as file:  # as another program might write it
        node = file.create_dataset("metrics/a/<b>", data=1.0)
        node.attrs.update({"units": HOSTILE, "definition": HOSTILE, "long_name": HOSTILE, "source": "computed"})
    result = read_result(result.path)
    text = page([result], HOSTILE)
    found = page_reader.read(text)
    assert len(found.all("script")) == 1 + len(SCRIPTS) and not found.all("img")
    assert not any(name.startswith("on") for _, attributes in found.elements for name in attributes)
    assert HOSTILE in found.words()
    assert page_reader.data(text)["results"][0]["name"].startswith(HOSTILE)


def test_a_stopped_run_shows_what_it_has_and_why_it_ended(tmp_path: Path) -> None:
    limits = page_results.RESOLVED + "accept: {exp_rths.j2: 1.0}\n"
    result = page_results.write(
        tmp_path / "x.h5", stopped=9_000, resolved=limits, status="aborted", reason="EXP-RTHS: stroke beyond its limit"
    )
    text = page([result], COMMAND)
    words = page_reader.read(text).words()
    assert "1 aborted; accept limits: 1 not judged" in words
    assert "aborted" in words and "EXP-RTHS: stroke beyond its limit" in words
    assert page_reader.data(text)["results"][0]["remark"].endswith("; aborted: EXP-RTHS: stroke beyond its limit")
    places, _ = shown(text, "storeys", 0, 1, 1)
    assert places[-1] == 8_999
    places, _ = shown(text, "storeys", 0, 0, 0)
    assert places[-1] == 39_999


@pytest.mark.parametrize("status", ["interrupted", "refused", "failed"])
def test_runs_that_are_not_there_are_said_to_be_missing(tmp_path: Path, status: str) -> None:
    result = page_results.write(tmp_path / "x.h5", runs=("sim", "sim_delay"), samples=500, status=status)
    text = page([result], COMMAND)
    assert "missing: shake table test, EXP-RTHS" in page_reader.read(text).words()
    (found,) = page_reader.data(text)["results"]
    assert found["runs"] == [] and found["response"] is None
    assert [trace["name"] for trace in found["storeys"][0]["charts"][0]["traces"]] == ["SIM", "SIM-DELAY"]


def test_a_case_of_sim_alone_has_no_table_of_dashes(tmp_path: Path) -> None:
    metrics = {"sim.peak_abs_accel_m_s2": np.array([1.0, 2.0, 3.0])}
    result = page_results.write(tmp_path / "x.h5", runs=("sim",), metrics=metrics, resolved="runs: [sim]\n")
    words = " ".join(page_reader.read(page([result], COMMAND)).words().split())
    assert "No run on virtual shake table aps400_virtual has errors." in words and "Tracking error of" not in words
    assert "NO HYBRID TEST: the case asks for SIM alone." in words and "peaks in SIM storey abs. accel m/s²" in words


def test_a_result_without_any_run_has_a_page(tmp_path: Path) -> None:
    result = page_results.write(tmp_path / "x.h5", runs=(), resolved="", status="failed", reason="disk full")
    text = page([result], "")
    assert "disk full" in page_reader.read(text).words()
    assert page_reader.data(text)["results"][0]["storeys"] == []


def test_a_run_stopped_before_its_first_sample_has_a_page(tmp_path: Path) -> None:
    result = page_results.write(
        tmp_path / "x.h5", stopped=0, samples=300, status="interrupted", runs=("sim", "exp_rths")
    )
    charts = page_reader.data(page([result], ""))["results"][0]["runs"][0]["charts"]
    assert [chart["traces"] for chart in charts] == [[], []]


def test_a_series_that_was_cut_is_plotted_up_to_there(tmp_path: Path) -> None:
    result = page_results.write(tmp_path / "x.h5", cut=700, samples=2_000)
    text = page([result], COMMAND)
    places, values = shown(text, "storeys", 0, 0, 1)
    assert np.isfinite(values[places < 700]).all() and np.isnan(values[places >= 700]).all()
    accel, error = page_reader.data(text)["results"][0]["storeys"][0]["charts"]
    assert [trace["shown"] for trace in accel["traces"]] == [True, False, True]
    assert [trace["name"] for trace in error["traces"]] == ["SIM - EXP-RTHS"]


@pytest.mark.campaign
def test_thirty_storeys_can_be_chosen_and_fit(tmp_path: Path) -> None:
    result = page_results.write(tmp_path / "x.h5", storeys=30, samples=20_000)
    text = page([result], COMMAND)
    names = [view["name"] for view in page_reader.data(text)["results"][0]["storeys"]]
    assert len(names) == 30 and names[:3] == ["30 (roof)", "29", "28 (interface)"]
    assert len(text) < 5_000_000


def test_a_real_rig_shows_its_timing_and_is_not_called_virtual(tmp_path: Path) -> None:
    result = page_results.write(
        tmp_path / "x.h5", rig="aps400", rig_kind="udp", driver_verified="hardware", exp_rths_overruns=3, samples=20_001
    )
    text = page([result], COMMAND)
    found = page_reader.read(text)
    words = " ".join(found.words().split())
    assert "virtual" not in words.replace(page_results.ABOUT["command_line"], "")  # type: ignore[arg-type]
    assert "EXP-RTHS: step and guard 100.0 198.0 199.8 200.0" in words  # of 0 to 200 us, evenly
    assert "EXP-RTHS: steps without samples, of 20001 2" in words and "EXP-RTHS: intervals overrun 3" in words


def test_timing_of_a_virtual_table_is_not_shown(text: str) -> None:
    assert "loop timing" not in page_reader.read(text).words()


@pytest.mark.campaign
def test_results_of_several_cases_share_what_is_the_same(tmp_path: Path) -> None:
    made = [
        page_results.write(
            tmp_path / f"{case}-{method}.h5", case_name=case, method=method, controller=case, samples=5_000
        )
        for case in ("FF", "FF+FB")
        for method in ("paper", "best")
    ]
    text = page(made, COMMAND)
    found = page_reader.data(text)
    assert [one["name"] for one in found["results"]] == ["FF (paper)", "FF (best)", "FF+FB (paper)", "FF+FB (best)"]
    assert len(found["responses"]) == 1 and len(found["series"]) == len(page_reader.data(page(made[:1], ""))["series"])
    words = page_reader.read(text).words()
    assert "4 results of 2 cases" in words and "Table 5.1" in words and "Table 5.2, FF+FB" in words


def test_error_by_cause_is_shown_in_millimetres(tmp_path: Path) -> None:
    parts = {"check": ("coupling", 0.001), "budget": ("coupling", 0.002)}
    metrics = {}
    for kind, (cause, value) in parts.items():
        metrics[f"{kind}.rms_error_{cause}_m_s2"] = np.array([value, 2 * value])
        metrics[f"{kind}.tracking_rms_{cause}_m_s2"] = 3 * value
    result = page_results.write(tmp_path / "x.h5", metrics=metrics, samples=100)
    words = " ".join(page_reader.read(page([result], "")).words().split())
    assert "tracking storey 1 storey 2 pred. meas. pred. meas. pred. meas." in words
    assert "coupling 3.000 6.000 1.000 2.000 2.000 4.000" in words


@pytest.mark.campaign
def test_nothing_is_left_where_the_page_cannot_be_written(whole: Result, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot write the page"):
        write_page([whole], tmp_path / "absent" / "page.html", COMMAND)
    (tmp_path / "page.html").mkdir()
    with pytest.raises(InputError, match="choose another file"):
        write_page([whole], tmp_path / "page.html", COMMAND)
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(InputError, match="no results"):
        page([], COMMAND)


def test_a_figure_that_is_not_finite_is_a_dash(tmp_path: Path) -> None:
    metrics = {"exp_rths.rms_error_m_s2": np.array([math.nan, 0.25])}
    result = page_results.write(tmp_path / "x.h5", metrics=metrics, samples=100)
    assert "-  0.25" in page_reader.read(page([result], "")).words()


def test_the_wheel_holds_what_is_embedded() -> None:
    builders = pytest.importorskip("hatchling.builders.wheel")
    shipped = {file.distribution_path for file in builders.WheelBuilder(str(ROOT)).recurse_included_files()}
    names = (*STYLES, *SCRIPTS, "uPlot.LICENSE")
    assert {f"rths_cli/report/page/assets/{name}" for name in names} <= shipped


def test_nothing_is_imported_before_a_page_is_asked_for() -> None:
    code = "import sys, rths_cli.report; print('rths_cli.report.page' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "False\n"


def test_claims_are_counted_where_they_can_be_judged(tmp_path: Path) -> None:
    def made(name: str, status: str, error: float) -> Result:
        metrics = {
            "sim_delay.rms_error_m_s2": np.array([0.1, 0.2]),
            "exp_rths.rms_error_m_s2": np.array([error, 0.01]),
        }
        return page_results.write(
            tmp_path / f"{name}.h5",
            case_name=name,
            status=status,
            metrics=metrics,
            samples=50,
            record_name=name,
            reference_title="a paper",
        )

    results = [made("a", "complete", 0.01), made("b", "aborted", 0.01), made("c", "complete", 0.3)]
    words = " ".join(page_reader.read(page(results, "")).words().split())
    second = words[words.index("2. EXP-RTHS is better than SIM-DELAY") : words.index("3. EXP-RTHS is better with")]
    assert "best held 1 of 2 (1 not judged)" in second
