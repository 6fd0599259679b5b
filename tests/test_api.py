"""`import rths_cli`: it gives what the file holds; every snippet of its page and of the page on export is run."""

from __future__ import annotations

import copy
import gc
import importlib.util
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import chdir, nullcontext, suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from docs_running import shortened

import rths_cli
from rths_cli import InputError
from rths_cli.case import load as case_files
from rths_cli.files import result_reader

ROOT = Path(__file__).parents[1]
CASE = "el_centro_low_ff_fb"
OCTAVE = shutil.which("octave-cli") or shutil.which("octave")
HEAVY = ("numpy", "scipy", "numba", "pydantic", "h5py", "matplotlib", "click", "yaml", "rich", "rths_cli.api")
RUNS = ("sim", "exp_rths")
NOTEBOOK = "_repr_html_"  # what notebooks call
HAS_FIGURES = importlib.util.find_spec("rths_cli.report.figures") is not None


def snippets(page: str, kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```", (ROOT / "docs" / page).read_text(), re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a folder whose results/ holds the default case under the first 9 s of its record."""
    folder = tmp_path_factory.mktemp("api")
    lines = (ROOT / "records" / "el_centro.csv").read_text().splitlines()
    values = [line for line in lines if not line.startswith("#")][:450]
    (folder / "short.csv").write_text("\n".join(["# units: cm/s^2", "# dt: 0.02 s", *values]) + "\n")
    rths_cli.run(CASE, settings={"record.file": folder / "short.csv", "runs": RUNS}, output=folder / "results")
    with chdir(folder):
        yield folder


@pytest.fixture(scope="module")
def result(place: Path) -> rths_cli.RunResult:
    return rths_cli.load(place / "results" / f"{CASE}.h5")


def in_fresh_process(code: str) -> str:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    return done.stdout.strip()


def test_the_import_is_lazy_and_every_public_name_is_there() -> None:
    code = f"import sys, rths_cli; print([name for name in {HEAVY!r} if name in sys.modules])"
    assert in_fresh_process(code) == "[]"
    code = "import sys, rths_cli; rths_cli.InputError; print('numpy' in sys.modules, 'rths_cli.api' in sys.modules)"
    assert in_fresh_process(code) == "False False"
    assert all(getattr(rths_cli, name) is not None for name in rths_cli.__all__)
    assert set(rths_cli.__all__) <= set(dir(rths_cli))
    with pytest.raises(AttributeError, match="no attribute 'frobnicate'"):
        rths_cli.frobnicate  # noqa: B018


@pytest.mark.campaign
def test_every_snippet_of_the_python_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's case is one of that name on 8 s of its record."""
    monkeypatch.chdir(tmp_path)
    shortened(ROOT / "records" / "el_centro.csv", tmp_path / "short.csv", 400)
    case = (ROOT / "configs" / f"{CASE}.yaml").read_text(encoding="utf-8")
    (tmp_path / f"{CASE}.yaml").write_text(case.replace("record: el_centro", "record: short.csv"), encoding="utf-8")
    names: dict[str, Any] = {}
    for code in snippets("reference/python.md", "python"):
        if "rths_cli.plot" in code and not HAS_FIGURES:
            continue
        exec(compile(code, "docs/reference/python.md", "exec"), names)
    assert len(names["faults"]) == 2 and names["model"].accepted and (tmp_path / "models" / "mine.h5").exists()
    assert names["verdict"].safe and names["verdict"].units["check.critical_delay_s"] == "s"
    assert names["errors"][0.002] < names["errors"][0.005]
    assert names["command"].shape == (200, 1)
    stated = names["result"].metrics["check.phase_margin_deg_model"]
    assert abs(names["phase_margin"]) == pytest.approx(stated, rel=1e-4)
    at = names["frequency_hz"]
    assert names["late"].response(at)[0, 0] == pytest.approx(np.exp(-2j * np.pi * at * 0.001), rel=1e-12)
    assert names["late"].inputs == ("u[0]",)


@pytest.mark.campaign
def test_every_snippet_of_the_export_page_runs(place: Path, result: rths_cli.RunResult) -> None:
    for form in ("csv", "mat"):
        result.export("exported", to=form, replace=True)
    names: dict[str, Any] = {}
    for code in snippets("howto/reading_results.md", "python") + snippets("howto/export.md", "python"):
        exec(compile(code, "docs/howto/export.md", "exec"), names)
    accel = result.exp_rths.abs_accel_m_s2
    assert np.array_equal(names["storey_3"], accel[2]) and np.array_equal(names["top"].values, accel[2])
    true_error = result.exp_rths.interface_accel_desired_m_s2 - result.exp_rths.truth.table_accel_m_s2
    assert np.array_equal(names["true_error"].values, true_error)
    assert names["table"]["abs_accel_m_s2_storey_3"] == pytest.approx(accel[2], rel=5e-9)  # nine digits in a CSV file


@pytest.mark.skipif(OCTAVE is None, reason="needs Octave")
def test_every_matlab_snippet_runs_in_octave(place: Path, result: rths_cli.RunResult) -> None:
    result.export("exported", to="mat", replace=True)
    (place / "page.m").write_text("\n".join(snippets("howto/export.md", "matlab")))
    done = subprocess.run(
        [str(OCTAVE), "--norc", "--quiet", "page.m"], capture_output=True, text=True, timeout=60, check=False
    )
    said = done.stdout.splitlines()
    assert said[0] == "complete" and CASE in said[1] and "m/s^2" in said[1], done.stderr
    error = result.exp_rths.abs_accel_m_s2[2] - result.sim.abs_accel_m_s2[2]
    assert float(said[2].split()[-1]) == pytest.approx(np.sqrt(np.mean(error**2)), rel=5e-3)
    block = result.controller.feedforward
    x, u = np.zeros(len(block.A)), np.zeros(block.B.shape[1])
    u[0] = 0.1
    for _ in range(200):
        y, x = block.C @ x + block.D @ u, block.A @ x + block.B @ u
    assert said[3] == f"after 0.100 s the command is {y[0]:.4g} V"


@pytest.mark.campaign
def test_blocks_responses_and_loops_go_to_python_control(result: rths_cli.RunResult) -> None:
    for name in ("feedback", "kalman", "numerical", "base_shear"):
        block, there = result.controller[name], rths_cli.to_control(result.controller[name])
        assert np.array_equal(there.A, block.A) and np.array_equal(there.D, block.D)
        assert tuple(there.input_labels) == block.attributes["inputs"] and there.dt == block.attributes["dt_s"]
    measured = rths_cli.to_control(result.identification)
    assert np.array_equal(measured.omega, 2.0 * np.pi * result.identification.frequency_hz)
    assert np.array_equal(measured.frdata[0, 0].imag, result.identification.frf_imag)
    loop = rths_cli.open_loop(CASE)
    closed = np.linalg.eigvals(loop.A - loop.B @ loop.C / (1.0 + loop.D))
    assert np.abs(closed).max() == pytest.approx(result.metrics["check.spectral_radius"], rel=1e-12)
    feedforward_alone = rths_cli.open_loop(CASE, settings={"controller": "FF"})
    assert len(feedforward_alone.A) < len(loop.A)
    at = rths_cli.to_control(loop, [1.0, 9.0])
    assert at.frdata == pytest.approx(loop.response(np.array([1.0, 9.0]))) and at.frdata.shape == (1, 1, 2)
    back = rths_cli.from_control(at)
    assert back.frequency_hz == pytest.approx([1.0, 9.0])  # type: ignore[union-attr]
    with pytest.raises(rths_cli.InputError, match="neither a block nor a frequency response"):
        rths_cli.to_control(result.exp_rths)


def test_an_open_loop_of_a_case_with_faults_says_them() -> None:
    with pytest.raises(rths_cli.InputError, match="scaling"):
        rths_cli.open_loop(CASE, settings={"scaling": -1})


def test_a_result_gives_what_the_file_holds(result: rths_cli.RunResult) -> None:
    with h5py.File(result.path) as file:
        assert set(result.groups) == set(file)
        assert (result.status, result.status_reason) == ("complete", "")
        assert np.array_equal(result.exp_rths.command_v, file["exp_rths/command_v"][:])
        assert np.array_equal(result["exp_rths"]["truth"].table_disp_m, file["exp_rths/truth/table_disp_m"][:])
        assert result.case.yaml == result.case_yaml == file["case/yaml"][()].decode()
        assert set(result.exp_rths) == set(file["exp_rths"]) and "truth" in result.exp_rths
        assert set(result.exp_rths) <= set(dir(result.exp_rths)) and set(result.groups) <= set(dir(result))
        figure = file["metrics/exp_rths/rms_error_m_s2"]
        assert np.array_equal(result.metrics["exp_rths.rms_error_m_s2"], figure[:])
        assert result.units["exp_rths.rms_error_m_s2"] == figure.attrs["units"]
        block = file["controller/feedforward"]
        assert np.array_equal(result.controller.feedforward.A, block["A"][:])
        assert result.controller.feedforward.attributes["inputs"] == tuple(block.attrs["inputs"])
    about = result.exp_rths.about("abs_accel_m_s2")
    assert (about.units, about.dims) == ("m/s^2", ("storey", "time_s"))


def test_arrays_are_the_readers_own(result: rths_cli.RunResult) -> None:
    taken = result.exp_rths.command_v
    taken[:] = 0.0
    assert result.exp_rths.command_v.any()


def test_a_small_array_is_read_once_and_is_the_readers_own(
    result: rths_cli.RunResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop over frequencies asks for a block's matrices thousands of times; each is some ms in the file."""
    reads: list[str] = []
    read = result_reader.read_dataset
    monkeypatch.setattr(result_reader, "read_dataset", lambda path, name: reads.append(name) or read(path, name))
    again = rths_cli.load(result.path)
    taken = again.controller.feedforward.A
    taken[:] = 0.0
    assert again.controller.feedforward.A.any() and again.exp_rths.command_v.size == again.exp_rths.command_v.size
    assert reads == ["controller/feedforward/A", "exp_rths/command_v", "exp_rths/command_v"]


def test_what_is_not_there_is_told_and_is_no_attribute(result: rths_cli.RunResult) -> None:
    with pytest.raises(rths_cli.InputError, match=r"holds no group exp \(status complete\); its groups are case, "):
        result.exp  # noqa: B018
    with pytest.raises(rths_cli.InputError, match="there is no command in exp_rths; it holds "):
        result.exp_rths["command"]
    assert not hasattr(result, "exp") and not hasattr(result.exp_rths, "command") and "exp" not in result
    assert not hasattr(result, "_repr_png_") and repr(result).startswith(f"<{CASE}.h5: complete; case")


def test_a_result_can_be_copied_and_sent_to_another_process(result: rths_cli.RunResult) -> None:
    assert np.array_equal(copy.copy(result).exp_rths.command_v, result.exp_rths.command_v)
    assert pickle.loads(pickle.dumps(result)).status == "complete"


def test_a_file_that_was_replaced_is_not_read_as_the_old_one(place: Path) -> None:
    shutil.copy(place / "results" / f"{CASE}.h5", "twin.h5")
    twin = rths_cli.load("twin.h5")
    shutil.copy("twin.h5", "other.h5")
    os.replace("other.h5", "twin.h5")
    for read in (lambda: twin.exp_rths.command_v, lambda: twin.export("x")):
        with pytest.raises(rths_cli.InputError, match="was replaced or removed since it was loaded; load it again"):
            read()


@pytest.mark.campaign
def test_runs_are_kept_apart_and_go_with_their_results() -> None:
    runs = [rths_cli.run(CASE, settings={"scaling": s, "runs": ["sim"]}) for s in (np.float64(0.1), 0.2)]
    first, second = (one.sim.abs_accel_m_s2 for one in runs)
    assert np.abs(second).max() == pytest.approx(2.0 * np.abs(first).max(), rel=1e-9)
    folders = [one.path.parent for one in runs]
    assert folders[0] != folders[1] and all(folder.exists() for folder in folders)
    del runs
    gc.collect()
    assert not any(folder.exists() for folder in folders)


@pytest.mark.campaign
def test_a_method_and_an_override_reach_the_run(tmp_path: Path) -> None:
    done = rths_cli.run("el_centro_bare_ff_fb", method="paper", settings={"runs": ["exp_rths"]}, output=tmp_path)
    assert (done.attributes["method"], done.path.parent) == ("paper", tmp_path)
    assert done.status == "refused" and "unsafe" in done.status_reason + str(done.attributes["check_verdict"])
    assert "exp_rths" not in done
    assert str(done.attributes["command_line"]).startswith("rths_cli.run el_centro_bare_ff_fb")


@pytest.mark.campaign
def test_a_case_that_is_not_safe_is_judged_so() -> None:
    judged = rths_cli.check(CASE, settings={"scaling": 0.95})
    assert (judged.verdict, judged.safe) == ("unsafe", False) and "displacement" in judged.reasons[0]
    assert judged.metrics["check.peak_displacement_m"] > 0.07 and judged.metrics["check.largest_scaling"] < 0.95
    assert judged.findings[0]["text"] == judged.reasons[0] and judged.findings[0]["values"]


def test_progress_is_told() -> None:
    told: list[str] = []
    rths_cli.run(CASE, settings={"runs": ["sim"]}, progress=told.append)
    assert "SIM" in told and "" not in told


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"scaling": -1, "controler": "FF"}, ("scaling", "controler")),
        ({"scaling": float("nan")}, ("settings: scaling must be finite",)),
        ({"scaling": 1j}, ("settings: scaling must be a number, text, list or mapping, got complex",)),
        ({"": 1}, ("must be key=value",)),
    ],
)
def test_bad_settings_are_told_in_one_sentence_each(settings: dict[str, object], words: tuple[str, ...]) -> None:
    with pytest.raises(rths_cli.InputError) as refused:
        rths_cli.run(CASE, settings=settings)
    assert len(refused.value.faults) == len(words)
    assert all(
        word in fault for word, fault in zip(words, sorted(refused.value.faults, reverse=True), strict=True)
    ) or (all(any(word in fault for fault in refused.value.faults) for word in words))


def test_texts_stay_texts_and_paths_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, ...]] = []

    def load_all(paths: list[str], settings: tuple[str, ...], *_: object) -> None:
        asked.append(settings)
        raise rths_cli.InputError("no further")

    monkeypatch.setattr(case_files, "load_all", load_all)
    given = {"name": "0.30", "identification.model": Path("m.h5"), "identification.seed": np.int64(3), "runs": ("sim",)}
    with pytest.raises(rths_cli.InputError, match="no further"):
        rths_cli.check(CASE, method="paper", settings=given)
    assert asked == [
        ('name="0.30"', 'identification.model="m.h5"', "identification.seed=3", 'runs=["sim"]', 'method="paper"')
    ]


def test_files_that_are_no_results_are_told(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("no")
    with pytest.raises(rths_cli.InputError, match="is not an HDF5 file"):
        rths_cli.load(tmp_path / "text.h5")
    with pytest.raises(rths_cli.InputError, match=r"none\.h5: no such file; check the path"):
        rths_cli.load(tmp_path / "none.h5")


def test_an_unknown_format_is_refused(result: rths_cli.RunResult) -> None:
    with pytest.raises(rths_cli.InputError, match="to: 'xlsx' is no format; give one of csv, mat"):
        result.export("x", to="xlsx")
    with pytest.raises(rths_cli.InputError, match=r"to: netcdf is no longer a format: .* xarray.open_dataset"):
        result.export("x", to="netcdf")


@pytest.mark.skipif(not HAS_FIGURES, reason="needs the package of figures")
def test_a_figure_is_drawn_and_an_unknown_one_refused(result: rths_cli.RunResult) -> None:
    assert rths_cli.plot(result, "tracking").axes
    with pytest.raises(rths_cli.InputError, match="frobnicate"):
        rths_cli.plot(result, "frobnicate")


REAL = {"table": "udp_loopback", "sample_rate_hz": 1000, "runs": ["sim"]}


def test_a_real_rig_needs_a_folder_and_the_main_thread(tmp_path: Path) -> None:
    with pytest.raises(rths_cli.InputError, match="output: rig udp_loopback is real and its result must last"):
        rths_cli.run(CASE, settings=REAL, yes=True)
    caught: list[rths_cli.InputError] = []

    def elsewhere() -> None:
        try:
            rths_cli.run(CASE, settings=REAL, output=tmp_path, yes=True)
        except rths_cli.InputError as error:
            caught.append(error)

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert "call this in the main thread" in caught[0].faults[0]


def test_a_real_rig_moves_by_no_script_that_was_not_permitted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from rths_cli.experiment import real_rig_readiness

    (tmp_path / "key").write_text("0123456789abcdef" * 2)
    (tmp_path / "key").chmod(0o600)
    monkeypatch.setenv("RTHS_KEY_FILE", str(tmp_path / "key"))
    sentence = r"yes=True moves rigs whose file says `unattended: true`, rths run asks for others"
    monkeypatch.setattr(real_rig_readiness.sys, "stdin", type("Terminal", (), {"isatty": staticmethod(lambda: True)}))
    with pytest.raises(rths_cli.InputError, match=sentence):
        rths_cli.identify(CASE, "models/real.h5", settings={"table": "udp_loopback", "sample_rate_hz": 1000})
    with pytest.raises(rths_cli.InputError, match=sentence):
        rths_cli.run(CASE, settings=REAL, output=tmp_path)
    text = (
        (ROOT / "configs" / "rigs" / "udp_loopback.yaml").read_text().replace("unattended: true", "unattended: false")
    )
    (tmp_path / "attended.yaml").write_text(text)
    with pytest.raises(rths_cli.InputError, match="does not say `unattended: true` in a file of its own"):
        rths_cli.run(CASE, settings={**REAL, "table": tmp_path / "attended.yaml"}, output=tmp_path, yes=True)
    assert list(tmp_path.glob("*.h5")) == []
    monkeypatch.setattr(real_rig_readiness.sys, "stdin", None)
    with pytest.raises(rths_cli.InputError, match="nobody can be asked here"):
        rths_cli.identify(CASE, "models/real.h5", settings={"table": "udp_loopback", "sample_rate_hz": 1000})


@pytest.mark.parametrize("swallowed", [False, True])
def test_sigterm_ends_a_run_and_handlers_are_as_before(swallowed: bool) -> None:
    from rths_cli.interrupts import Terminated

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)], sys.unraisablehook

    def end(text: str) -> None:
        if text == "SIM":
            with suppress(Terminated) if swallowed else nullcontext():
                signal.raise_signal(signal.SIGTERM)

    with pytest.raises(Terminated):
        rths_cli.run(CASE, settings={"runs": ["sim"]}, progress=end)
    assert before == ([signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)], sys.unraisablehook)


def test_the_package_says_that_it_is_typed() -> None:
    assert (Path(rths_cli.__file__).parent / "py.typed").is_file()


def test_a_figure_that_is_not_there_names_those_like_it(result: rths_cli.RunResult) -> None:
    with pytest.raises(KeyError, match=r"exp_rths\.rms_eror_m_s2.* did you mean exp_rths\.rms_error_m_s2"):
        result.metrics["exp_rths.rms_eror_m_s2"]
    with pytest.raises(KeyError, match="names all"):
        result.metrics["zzz"]
    assert result.metrics.get("zzz") is None and "zzz" not in result.metrics


def test_the_response_is_that_of_the_series(result: rths_cli.RunResult) -> None:
    found, masses = result.response, np.array([6.93, 6.91, 6.95])
    assert found.run == "exp_rths" and repr(found).startswith("<response of 3 storeys in exp_rths, ")
    disp, accel = result.exp_rths.rel_disp_m, result.exp_rths.abs_accel_m_s2
    for i in range(3):
        drift = disp[i] - (disp[i - 1] if i else 0.0)
        np.testing.assert_allclose(found.inter_storey_drift_m[i], drift, rtol=0.0, atol=2**-32 * np.abs(drift).max())
        shear = -sum(masses[j] * accel[j] for j in range(i, 3))
        np.testing.assert_allclose(found.storey_shear_n[i], shear, rtol=0.0, atol=3e-10 * np.abs(shear).max())
    assert np.abs(found.storey_shear_n[0]).max() == pytest.approx(result.metrics["exp_rths.peak_building_base_shear_n"])
    assert result.response_in("sim").run == "sim"
    with pytest.raises(InputError, match="sim_delay"):
        result.response_in("sim_delay")


def test_series_become_tables_of_other_libraries(result: rths_cli.RunResult, monkeypatch: pytest.MonkeyPatch) -> None:
    """xarray brings pandas; without them one sentence says what to install."""
    held = result.to_xarray("sim")
    assert held["abs_accel_m_s2"].dims == ("storey", "time_s") and held["abs_accel_m_s2"].attrs["units"] == "m/s^2"
    np.testing.assert_array_equal(held["abs_accel_m_s2"].values, result.sim.abs_accel_m_s2)
    np.testing.assert_array_equal(held["time_s"].values, result.sim.time_s)
    frame = result.to_dataframe("exp_rths")
    np.testing.assert_array_equal(frame["abs_accel_m_s2_3"], result.exp_rths.abs_accel_m_s2[2])
    np.testing.assert_array_equal(frame["floor_accel_measured_m_s2_2"], result.exp_rths.floor_accel_measured_m_s2[0])
    np.testing.assert_array_equal(frame.index, result.exp_rths.time_s)
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match="xarray is not installed; pip install xarray"):
        result.to_xarray("sim")


@pytest.mark.campaign
def test_what_a_notebook_shows_is_short(place: Path, result: rths_cli.RunResult) -> None:
    checked = rths_cli.check(CASE, settings={"record.file": place / "short.csv"})
    assert len(repr(checked)) < 100 and repr(checked).startswith("<check: safe; ")
    shown, of_check = (getattr(one, NOTEBOOK)() for one in (result, checked))
    assert shown.startswith("<pre>") and "GOOD" in shown and "safe" in of_check and len(repr(result)) < 200


@pytest.mark.campaign
def test_a_case_may_be_a_mapping(place: Path) -> None:
    keys = {
        "structure": "three_storey", "damping": "low", "record": {"file": place / "short.csv"}, "scaling": 0.3,
        "controller": "FF", "runs": ["sim"],
    }  # fmt: skip
    found = rths_cli.run(keys)
    by_file = rths_cli.run(CASE, settings={"record.file": place / "short.csv", "runs": ["sim"]})
    assert found.path.name == "case.h5" and "{...}" in str(found.attributes["command_line"])
    np.testing.assert_array_equal(found.sim.abs_accel_m_s2, by_file.sim.abs_accel_m_s2)
    assert rths_cli.run({**keys, "name": "mine"}).path.name == "mine.h5"
    assert rths_cli.check({**keys, "runs": ["exp-rths"]}).verdict == "safe"
    with pytest.raises(InputError, match=r"case:\d+:\d+: controler: unknown key; did you mean controller"):
        rths_cli.run({**keys, "controler": "FF"})
    with pytest.raises(InputError, match="holds a value that a case file cannot"):
        rths_cli.run({**keys, "scaling": object()})
