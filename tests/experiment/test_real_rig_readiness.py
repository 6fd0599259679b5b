"""A case on a rig behind UDP, the served table in a thread: what is left of runs that end, are stopped, or fail."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path

import h5py
import numpy as np
import pytest
from declared_contents import declaration_faults
from python_models import Inverse
from serving_bench import Running, leave_out_punctuality

from rths_cli.case import plugin_interface
from rths_cli.case.load import load_cases
from rths_cli.control.interface import Logged
from rths_cli.control.python_parts import PythonFeedforward
from rths_cli.experiment import real_rig_readiness, real_stage
from rths_cli.experiment.identify_on_rig import identify
from rths_cli.experiment.model_choice import IdentifiedModel, Memory
from rths_cli.experiment.model_files import key
from rths_cli.experiment.one_table_run import AFTER_S, BEFORE_S
from rths_cli.experiment.real_rig_readiness import EXP_RTHS, open_rig
from rths_cli.experiment.real_stage import RealStage
from rths_cli.experiment.run_case import Ended, run_case
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.files.raw_log import RawHeader, RawLogWriter
from rths_cli.files.result_reader import read_result, read_series
from rths_cli.laboratory.recover import recover
from rths_cli.laboratory.serve import describe
from rths_cli.loop.live_view import View
from rths_cli.loop.realtime_run import RAMP_UP_S
from rths_cli.numerics.lti import Block
from rths_cli.quantities import ATTRIBUTES, DATASETS
from rths_cli.quantities.attributes import LINKED, REAL
from rths_cli.rigs.udp.session import make_secret
from rths_cli.rigs.virtual.virtual_rig import VirtualRig

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="real time is Linux only"),
    pytest.mark.real_time,
]
CASE = """
structure: three_storey
damping: low
record: ./short.csv
scaling: 0.3
controller: FF+FB
sample_rate_hz: 500
record_filter: {corner_hz: 0}
runs: [sim, exp_rths]
identification: {duration_s: 60}
"""
RECORD_S = 1.5
CLEAN_S = 0.2
PATIENCE_S = 2.0  # for which a busy machine may stop both sides
ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Bench:
    """A server, the case's setup on it, and a memory that knows the model."""

    running: Running
    setup: Setup
    memory: Memory


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("real")
    time_s = np.arange(0.0, RECORD_S, 0.01)
    accel = 2.0 * np.sin(6 * np.pi * time_s) * np.sin(np.pi * time_s / RECORD_S) ** 2
    (folder / "short.csv").write_text("# dt: 0.01 s\n# units: m/s^2\n" + "\n".join(f"{x:.6g}" for x in accel) + "\n")
    (folder / "a.yaml").write_text(CASE)
    make_secret(folder / "key")
    virtual = make_setup(load_cases([str(folder / "a.yaml")])[0])
    found = identify(virtual, lambda _: None)
    served = describe("aps400_virtual", "three_storey", ("sample_rate_hz=500",), 0)
    running = Running(served, folder / "key", watchdog_s=PATIENCE_S)
    udp = f"{{port: {running.port}, key_file: {folder / 'key'}}}"
    rig = folder / f"udp_{os.getpid()}.yaml"  # a rig is locked by its name, and each process has its own
    limits = f"limits: {{lost_samples: {round(450 * PATIENCE_S)}}}\nwatchdog_s: {PATIENCE_S}"
    rig.write_text(f"extends: udp_loopback\n{limits}\nudp: {udp}\n")
    try:
        setup = make_setup(load_cases([str(folder / "a.yaml")], (f"table={rig}",))[0], ("check", "model"))
        memory = Memory(known={key(setup): IdentifiedModel(found, "made for a test")})
        yield Bench(running, setup, memory)
    finally:
        running.end()


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out punctuality and most of the listening."""
    leave_out_punctuality(monkeypatch)
    monkeypatch.setattr(real_rig_readiness, "LISTENING_S", 0.05)


def ran(bench: Bench, path: Path, show: Callable[[str, View], bool] = lambda label, view: False) -> Ended:
    """Run the case on the served table."""
    stage = RealStage(show)
    try:
        return run_case(bench.setup, path, bench.memory, "rths run a.yaml", lambda _: None, stage=stage)
    finally:
        stage.close()


def once_running(act: Callable[[], object]) -> Callable[[str, View], bool]:
    """Return a live view that does something, once, in the middle of the record."""
    return once(lambda view: view.time_s > 0.2, act)


def once(when: Callable[[View], bool], act: Callable[[], object]) -> Callable[[str, View], bool]:
    """Return a live view that does something, once."""
    done: list[bool] = []

    def show(label: str, view: View) -> bool:
        if not done and when(view):
            done.append(True)
            return bool(act())
        return False

    return show


def status(path: Path) -> tuple[str, str]:
    attributes = read_result(path).attributes
    return str(attributes["status"]), str(attributes["status_reason"])


@pytest.mark.campaign
def test_a_signal_ends_as_interrupted_with_the_samples_and_the_table_at_rest(bench: Bench, tmp_path: Path) -> None:
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        ended = ran(bench, tmp_path / "a.h5", once_running(lambda: os.kill(os.getpid(), signal.SIGTERM)))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert (ended.status, ended.exit_code) == ("interrupted", 143), ended.reason
    assert status(tmp_path / "a.h5") == (ended.status, ended.reason)
    assert ended.reason.startswith("EXP-RTHS: terminated at ") and ended.reason.endswith("the table was led to rest")
    command = read_series(tmp_path / "a.h5", "exp_rths/command_v")
    assert np.isfinite(command).all() and np.abs(command).max() > 0.01
    assert bench.running.server.ended[-1].ended_by in ("the runner had the table rest", "the runner closed it")
    assert os.listdir(tmp_path) == ["a.h5"]


@pytest.mark.campaign
def test_a_result_says_what_was_behind_the_rig_that_ran(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The example plug-in is a fake, which its rig file does not know; the served table is on this machine."""
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "plugin_rig" / "src"))
    points = [EntryPoint("slow_table", "rths_slow_table:make", plugin_interface.GROUP)]
    monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points)
    monkeypatch.setattr(real_rig_readiness, "check_measured", lambda info: None)
    plugged = make_setup(load_cases([str(bench.setup.case.path)], ("table=plugin_example",))[0], bench.setup.overrides)
    memory = Memory(known={key(plugged): bench.memory.known(bench.setup, lambda _: None)})
    for name, tried in (("udp", bench), ("plugged", Bench(bench.running, plugged, memory))):
        ran(tried, tmp_path / f"{name}.h5")
    verified = {path.stem: read_result(path).attributes["driver_verified"] for path in tmp_path.glob("*.h5")}
    assert verified == {"udp": "loopback", "plugged": "fake"}


@pytest.mark.campaign
def test_a_raw_log_names_what_parts_of_ones_own_log(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without it a run that is recovered would hold numbers that nobody can name."""
    headers: list[RawHeader] = []

    def kept(path: Path, header: RawHeader) -> RawLogWriter:
        headers.append(header)
        return RawLogWriter(path, header)

    class Logging(Inverse):
        logged = np.array([3.0])

    def own(designed: Block) -> PythonFeedforward:
        return PythonFeedforward("inverse", lambda: Logging(designed), designed, (Logged("gain", "m/V"),))

    monkeypatch.setattr(real_stage, "RawLogWriter", kept)
    ran(replace(bench, setup=replace(bench.setup, parts={"feedforward": own})), tmp_path / "a.h5")
    (header,) = headers
    assert header.logs == (("gain", "m/V", False),) and header.names.count("logged_0") == 1


@pytest.mark.campaign
def test_a_log_that_cannot_be_written_any_more_stops_the_test_and_nothing_is_lost(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = threading.Event()
    append = RawLogWriter.append

    def refuse(self: RawLogWriter, first: int, columns: np.ndarray) -> None:
        if broken.is_set():
            raise OSError(5, "Input/output error")
        append(self, first, columns)

    monkeypatch.setattr(RawLogWriter, "append", refuse)
    ended = ran(bench, tmp_path / "a.h5", once_running(broken.set))
    assert (ended.status, ended.exit_code) == ("failed", 4), ended.reason
    assert "cannot write the raw log: Input/output error" in ended.reason
    assert status(tmp_path / "a.h5") == (ended.status, ended.reason)
    assert read_series(tmp_path / "a.h5", "exp_rths/command_v").size > 40


@pytest.mark.campaign
def test_a_live_view_that_fails_is_our_bug_and_the_run_is_in_its_file(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def fail() -> None:
        raise BrokenPipeError

    ended = ran(bench, tmp_path / "a.h5", once_running(fail))
    assert (ended.status, ended.exit_code) == ("failed", 5), ended.reason
    assert "the live view failed (BrokenPipeError, details in " in ended.reason
    assert "exp_rths" in read_result(tmp_path / "a.h5").groups


@pytest.mark.campaign
def test_a_target_that_ends_by_itself_is_told_with_what_it_did_not_confirm(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def end_stop() -> None:
        bench.running.server.table.state.state[0] = 0.09

    ended = ran(bench, tmp_path / "a.h5", once_running(end_stop))
    assert (ended.status, ended.exit_code) == ("failed", 4), ended.reason
    assert "the table is at its end stop" in ended.reason
    assert status(tmp_path / "a.h5") == (ended.status, ended.reason)


def test_a_crash_of_the_driver_leaves_a_result_and_a_log_that_recover_reads(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(rig: object, run: real_rig_readiness.Performance) -> str:
        run.log.columns[:] = 0.0
        run.log.done[0] = run.course.ramp + 100
        raise ZeroDivisionError("in a driver")

    bench.memory.known(bench.setup, lambda _: None)  # verifies the model on the rig, once, if no test before did
    monkeypatch.setattr("rths_cli.loop.realtime_run.perform", crash)
    with pytest.raises(ZeroDivisionError):
        ran(bench, tmp_path / "a.h5")
    assert status(tmp_path / "a.h5") == ("failed", "in a driver")
    (recovered,) = recover(list(tmp_path.glob("*.rthslog")))
    assert recovered.samples == round((BEFORE_S + RAMP_UP_S) / bench.setup.rig.dt_s) + 100
    assert "exp_rths" in read_result(tmp_path / "a.h5").groups


def resting(view: View) -> bool:
    """Tell whether the record is over and the table at rest."""
    return view.state == "stopped"


def resting_undisturbed() -> Callable[[View], bool]:
    """Return what tells whether the table has been at rest for CLEAN_S without a lost sample.

    After a loss the step mixes samples with what it put in their place for a while, and such samples are not kept.
    """
    since: list[View] = []

    def undisturbed(view: View) -> bool:
        if not resting(view) or (since and view.lost > since[0].lost):
            since.clear()
        if resting(view) and not since:
            since.append(view)
        return bool(since) and view.time_s - since[0].time_s >= CLEAN_S

    return undisturbed


@pytest.mark.campaign
@pytest.mark.parametrize("how", ["dies", "faults"])
def test_a_target_that_ends_in_the_rest_after_the_record_leaves_a_complete_run(
    bench: Bench, tmp_path: Path, how: str
) -> None:
    server = bench.running.server

    def end() -> None:
        if how == "dies":
            server.door.key[:] = 0  # it takes nothing for genuine any more; its watchdog rests the table
        else:
            server.table.state.state[0] = 0.09

    ended = ran(bench, tmp_path / "a.h5", once(resting_undisturbed(), end))
    assert (ended.status, ended.exit_code) == ("complete", 4), ended.reason
    result = read_result(tmp_path / "a.h5")
    assert "the record was played whole; after it: " in ended.reason and " s of 3 s, " in ended.reason
    assert ended.reason in str(result.attributes["warnings"]) and status(tmp_path / "a.h5")[0] == "complete"
    assert "exp_rths.rms_error_m_s2" in result.metrics
    lost = read_series(tmp_path / "a.h5", "exp_rths/timing/lost")  # on a busy machine, too many to tell an offset
    assert "exp_rths.sensor_offset_v" in result.metrics or lost.any()
    shown = read_series(tmp_path / "a.h5", "exp_rths/rest/samples_v")
    before, rest = round(BEFORE_S / bench.setup.rig.dt_s), round(AFTER_S / bench.setup.rig.dt_s)
    assert before < shown.shape[1] < before + rest and np.isfinite(shown[:, -1]).all()
    assert os.listdir(tmp_path) == ["a.h5"]
    assert declaration_faults(tmp_path / "a.h5") == []
    with h5py.File(tmp_path / "a.h5") as file:
        real = {path for path, one in DATASETS.items() if one.present in (REAL, LINKED) and path.startswith("exp_rths")}
        assert len(real) > 10 and all(path in file for path in real) and "exp_rths/truth" not in file
        told = {
            name for name, one in ATTRIBUTES.items() if one.present in (REAL, LINKED) and name.startswith("exp_rths")
        }
        assert len(told) > 5 and told <= set(file.attrs)


@pytest.mark.campaign
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (None, 3)])
def test_who_stops_the_rest_after_the_record_keeps_a_complete_run(
    bench: Bench, tmp_path: Path, number: int | None, code: int
) -> None:
    """None: the stop key."""

    def stop() -> bool:
        if number is not None:
            os.kill(os.getpid(), number)
        return number is None

    before = signal.signal(number, signal.default_int_handler) if number is not None else None
    try:
        ended = ran(bench, tmp_path / "a.h5", once(resting, stop))
    finally:
        if number is not None:
            signal.signal(number, before)
    assert (ended.status, ended.exit_code) == ("complete", code), ended.reason
    assert "the record was played whole; after it: " in ended.reason and " s of 3 s, " in ended.reason
    assert "exp_rths.rms_error_m_s2" in read_result(tmp_path / "a.h5").metrics


@pytest.mark.campaign
def test_a_signal_in_the_rest_before_the_run_says_that_nothing_moved(bench: Bench, tmp_path: Path) -> None:
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    at_rest = once(lambda view: True, lambda: os.kill(os.getpid(), signal.SIGTERM))
    try:
        ended = ran(bench, tmp_path / "a.h5", at_rest)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert (ended.status, ended.exit_code) == ("interrupted", 143), ended.reason
    assert ended.reason == "EXP-RTHS: terminated at rest, before the table moved"
    assert status(tmp_path / "a.h5") == (ended.status, ended.reason) and os.listdir(tmp_path) == ["a.h5"]


NOISE_V = 3e-4 * 0.102


class Replayed:
    """The served table without a network and without a clock, one of its floors drifting: each run is the same."""

    def __init__(self, rig: VirtualRig, offset_v: float, drift_v: float) -> None:
        self._rig, self._offset_v, self._drift_v, self._count = rig, offset_v, drift_v, 0
        self.info = replace(rig.info, name=f"replayed_{os.getpid()}")  # locked by its name: each process has its own
        self._noise = np.random.default_rng(1)

    def open(self) -> None:
        self._rig.open()

    def arm(self) -> np.ndarray:
        self._count = 0
        return self._shown(self._rig.arm())

    def exchange(self, command_v: float) -> np.ndarray:
        return self._shown(self._rig.exchange(command_v))

    def _shown(self, samples: np.ndarray) -> np.ndarray:
        self._count += 1
        drifts = np.array([0.0, 0.0, self._offset_v + self._drift_v * self._count])
        return np.asarray(samples + drifts + NOISE_V * self._noise.standard_normal(3))

    def rest(self) -> None:
        self._rig.rest()

    def close(self) -> None:
        self._rig.close()


@pytest.mark.campaign
def test_a_drifting_sensor_is_named_and_taken_out_of_a_finished_run_and_of_its_recovered_log(
    bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """5 mV and 5 mV/min, which the loop's zeros do not see (they are taken with the table's noise alone)."""
    rig = Replayed(open_rig(bench.running.served.setup, (EXP_RTHS,), 0), 5e-3, 5e-3 / 60.0 / 500.0)
    monkeypatch.setattr("rths_cli.experiment.real_stage.open_rig", lambda *_: rig)
    zeros = real_rig_readiness.AtRest(np.zeros(3), np.zeros(3))
    monkeypatch.setattr(real_rig_readiness, "listened", lambda setup, rig: zeros)
    monkeypatch.setattr(RealStage, "written", lambda self: None)  # keep the log
    ended = ran(bench, tmp_path / "a.h5")
    assert ended.status == "complete", ended.reason
    (said,) = [line for line in ended.warnings if "channel floor_3" in line]
    result = read_result(tmp_path / "a.h5")
    rate, uncertain = (result.metrics[f"exp_rths.sensor_drift{part}_v_per_min"] for part in ("", "_uncertainty"))
    assert abs(rate[2] - 5e-3) < 3.0 * uncertain[2]
    taken = read_series(tmp_path / "a.h5", "exp_rths/sensor_drift_m_s2")
    assert declaration_faults(tmp_path / "a.h5") == []
    (tmp_path / "a.h5").rename(tmp_path / "finished.h5")
    (recovered,) = recover([tmp_path / "a.exp_rths.rthslog"])
    assert "500 of the rest before it" in recovered.note and "of the rest after it" in recovered.note
    again = read_result(tmp_path / "a.h5")
    assert said in str(again.attributes["warnings"]).splitlines()
    whole, recovered_too = (str(one.attributes["warnings"]).splitlines() for one in (result, again))
    of_check = "measured and expected error differ"  # a log alone does not hold what the check expected
    assert set(recovered_too) == {line for line in whole if not line.startswith(of_check)}
    assert {"exp_rths.rms_error_m_s2", "exp_rths.sensor_drift_v_per_min"} <= set(again.metrics)
    for name, value in again.metrics.items():
        assert value == pytest.approx(result.metrics[name], rel=1e-9, abs=1e-12), name
    assert read_series(tmp_path / "a.h5", "exp_rths/sensor_drift_m_s2") == pytest.approx(taken, rel=1e-9, abs=1e-12)
    for name in ("abs_accel_m_s2", "rel_disp_m"):
        first, second = (read_series(tmp_path / file, f"exp_rths/{name}") for file in ("finished.h5", "a.h5"))
        assert second == pytest.approx(first, rel=1e-9, abs=1e-12)
