"""Rigs of packages that simulate a table: a counted clock asks for no real time, and their truth is stored."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest
import yaml
from bench import rig_info, specimen
from hybrid import best_like, ground, open_limits
from scipy.signal import butter, sosfiltfilt

import rths_cli
from rths_cli.case import plugin_rig_names
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import InputError, RigError
from rths_cli.experiment import real_rig_readiness
from rths_cli.experiment.doctor_request import DoctorRequest, examine_request
from rths_cli.loop import realtime_run
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array
from rths_cli.rigs.interface import COUNTED_CLOCK, SESSIONS, TRUTH, Rig, RigInfo, counts_time, truthful
from rths_cli.rigs.plugin_rigs import open_plugin
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant

Plug = Callable[[Any], None]
INFO = replace(rig_info(dt_s=1e-3), kind="simulated", name="lab")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="a rig of a package needs Linux")


class Simulated:
    """The virtual table as a package would bring one; `sessions` are the names that it was told."""

    offers = (COUNTED_CLOCK, TRUTH, SESSIONS)

    def __init__(self, info: RigInfo) -> None:
        self.info = replace(info, driver_verified="fake")
        self.inner = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (0, 1))
        self.sessions: list[str] = []
        self._truth = np.zeros(3), 0.0

    def session(self, name: str) -> None:
        self.sessions.append(name)

    def truth(self) -> tuple[Array, float]:
        return self._truth

    def open(self) -> None: ...

    def arm(self) -> Array:
        self._truth = np.zeros(3), 0.0
        return self.inner.arm()

    def exchange(self, command_v: float) -> Array:
        samples = self.inner.exchange(command_v)
        self._truth = self.inner.state.middle_velocity.copy(), float(self.inner.state.state[0])
        return samples

    def rest(self) -> None:
        self.inner.rest()

    def close(self) -> None: ...


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    """Install a package whose kind `simulated` is made by a class."""

    def install(kind: Any) -> None:
        module = ModuleType("simulated_package")
        module.make = lambda info, options: kind(info)  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "simulated_package", module)
        points = [EntryPoint("simulated", "simulated_package:make", plugin_rig_names.GROUP)]
        monkeypatch.setattr(plugin_rig_names, "entry_points", lambda group: points)

    return install


def test_the_truth_of_a_package_s_rig_is_logged_as_the_virtual_rig_s(plug: Plug) -> None:
    plug(Simulated)
    rig, drive = open_plugin(INFO, {}), ground(400)
    assert counts_time(rig) and truthful(rig) is not None
    run = realtime_run.prepare(INFO, best_like(INFO), NUMERICAL, drive, open_limits(INFO), ramp_s=0.05)
    rig.open()
    assert realtime_run.perform(rig, run) == ""
    velocity, place = run.truth["true_velocity_m_s"], run.truth["true_displacement_m"]
    steps = int(run.log.done[0])
    other = VirtualRig(INFO, build_plant(INFO, VirtualPhysics(), specimen(), 3e-4), (0, 1))
    other.arm()
    columns = realtime_run.signals(run.log, realtime_run.sizes_of(run.step))
    for k in range(steps):
        assert place[k] == other.state.state[0]
        other.exchange(float(columns.command_v[k]))
        assert np.array_equal(velocity[:, k], other.state.middle_velocity)
    assert np.abs(velocity[:, :steps]).max() > 1e-3


def test_an_offer_that_is_none_or_is_not_kept_is_refused(plug: Plug) -> None:
    plug(type("Other", (Simulated,), {"offers": ("speed",)}))
    with pytest.raises(RigError, match=r"offers 'speed'; a package's rig may offer missed edges, counted clock, truth"):
        open_plugin(INFO, {})
    plug(type("Untold", (Simulated,), {"truth": property()}))
    with pytest.raises(RigError, match="without truth, which it offers"):
        open_plugin(INFO, {})
    plug(type("Short", (Simulated,), {"truth": lambda self: (np.zeros(2), 0.0)}))
    rig: Any = open_plugin(INFO, {})
    with pytest.raises(RigError, match="truth of plug-in simulated must return 3 velocities, of table and floors, got"):
        rig.truth()


def test_a_counted_clock_asks_for_no_rate(plug: Plug, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a rehearsal nor a measured rate: both would refuse this setup, which has none."""
    plug(Simulated)
    blocks, setup = best_like(INFO), _NotASetup()
    real_rig_readiness.check_rate(setup, open_plugin(INFO, {}), blocks, NUMERICAL)  # type: ignore[arg-type]
    plug(type("Timed", (Simulated,), {"offers": ()}))
    monkeypatch.setattr(real_rig_readiness, "rehearsed", lambda *given: None)
    with pytest.raises(InputError, match="was not measured with rig lab"):
        real_rig_readiness.check_rate(setup, open_plugin(INFO, {}), blocks, NUMERICAL)  # type: ignore[arg-type]


class _NotASetup:
    rig = INFO


TABLE = {
    "kind": "simulated",
    "unattended": True,
    "sensors": {"sensitivity_mv_per_g": 1000, "range_g": 5, "high_pass_hz": 0.024, "low_pass_hz": 1549},
    "converters": {"bits": 16, "range_v": 10},
    "limits": {"stroke_m": 0.079, "velocity_m_s": 1.0, "acceleration_m_s2": 45, "force_n": 445},
    "nominal": {"gain_m_per_v": 0.0079, "moving_mass_kg": 7.0, "payload_kg": 23},
}


def test_doctor_is_content_with_a_counted_clock(plug: Plug, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Simulated] = []

    def make(info: RigInfo) -> Rig:
        made.append(Simulated(info))
        return made[-1]

    plug(make)
    (tmp_path / "table.yaml").write_text(yaml.safe_dump(TABLE))
    monkeypatch.chdir(tmp_path)
    found = examine_request(DoctorRequest(None, "table.yaml", (), 1.0, ()), lambda what: None)
    assert (found.exit_code, found.counted, found.rates, found.rig) == (0, "table", (), None)
    assert made[0].sessions == ["listening"]


def test_a_run_on_it_keeps_its_truth_and_states_true_errors(
    plug: Plug, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Identified and run without real time; the stated true error is that of the stored truth against SIM."""
    told: list[list[str]] = []

    def make(info: RigInfo) -> Rig:
        rig = Simulated(info)
        told.append(rig.sessions)
        return rig

    plug(make)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "table.yaml").write_text(yaml.safe_dump(TABLE))
    time_s = np.arange(0.0, 6.0, 0.01)
    pulse = np.sin(9.0 * time_s) * np.exp(-(((time_s - 1.5) / 0.5) ** 2))
    columns = np.column_stack([time_s, pulse])
    np.savetxt("pulse.csv", columns, delimiter=",", header="time_s,accel_m_s2", comments="")
    case = {
        "structure": "three_storey", "damping": "low", "record": "pulse.csv", "scaling": 1.0, "controller": "FF+FB",
        "table": "table.yaml", "sample_rate_hz": 1000, "identification": {"duration_s": 40},
    }  # fmt: skip
    Path("pulse.yaml").write_text(yaml.safe_dump(case))
    rths_cli.identify("pulse.yaml", "model.h5", yes=True)
    sessions = [name for one in told for name in one]
    assert sessions == ["listening", "probe", "listening", "identification"]
    told.clear()
    result = rths_cli.run("pulse.yaml", settings={"identification.model": "model.h5"}, output=tmp_path, yes=True)
    assert result.status == "complete"
    asked = ["listening", "listening", "verification", "listening", "exp_rths"]
    assert [name for one in told for name in one] == asked
    with h5py.File(result.path) as file:
        truth, sim = file["exp_rths/truth"], file["sim/abs_accel_m_s2"][()]
        accel = np.vstack([truth["table_accel_m_s2"][()], truth["floor_accel_m_s2"][()]])
        error = sosfiltfilt(butter(4, 12.0, fs=1000.0, output="sos"), accel - sim)
        stated = file["metrics/exp_rths/rms_error_m_s2_true"][()]
        assert "exp_rths/true_reference_rms_error_m_s2" not in file["metrics"]
    assert np.sqrt(np.mean(error**2, axis=1)) == pytest.approx(stated, rel=0.02)
    assert stated.max() < 0.05 * np.abs(sim).max()
