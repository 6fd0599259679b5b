"""Rigs of packages that simulate a table: a counted clock asks for no real time, and their truth is stored."""

from __future__ import annotations

import re
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
from adaptive_storeys import adaptive
from bench import rig_info, specimen
from hybrid import best_like, ground, open_limits
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

import rths_cli
from rths_cli.case import plugin_interface
from rths_cli.case.load import load_cases
from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.errors import InputError, RigError
from rths_cli.experiment import real_rig_readiness
from rths_cli.experiment.setup import make_setup
from rths_cli.laboratory.doctor_request import DoctorRequest, channels_request, examine_request
from rths_cli.loop import realtime_run
from rths_cli.loop.step_arrays import NUMERICAL
from rths_cli.numerics.lti import Array
from rths_cli.rigs.from_case import told_building
from rths_cli.rigs.interface import COUNTED_CLOCK, SESSIONS, SPECIMEN, TRUTH, Rig, RigInfo, counts_time, truthful
from rths_cli.rigs.plugin_rigs import open_plugin
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant
from rths_cli.structure import Specimen

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
        points = [EntryPoint("simulated", "simulated_package:make", plugin_interface.GROUP)]
        monkeypatch.setattr(plugin_interface, "entry_points", lambda group: points)

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


@pytest.mark.campaign
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
    request = DoctorRequest(None, "table.yaml", (), 0.5, ())
    looked = channels_request(request, True, None, lambda what: None)
    assert looked.exit_code == 0 and len(looked.comparisons) == 3
    assert [name for one in made[1:] for name in one.sessions] == ["doctor", "listening", "probe"]


SOFTENING = {"kind": "softening", "share": 0.02, "half_drift_m": 0.001}


class Softening(Simulated):
    """A laboratory whose specimen is a little heavier than declared and softens, and which tells so."""

    offers = (COUNTED_CLOCK, TRUTH, SPECIMEN, SESSIONS)

    def __init__(self, info: RigInfo) -> None:
        super().__init__(info)
        there = specimen()
        self.standing = Specimen(1.003 * there.masses_kg, there.K, there.C)
        physics = VirtualPhysics.model_validate({"specimen_laws": [SOFTENING, None]})
        self.inner = VirtualRig(info, build_plant(info, physics, self.standing, 3e-4), (0, 1))

    def specimen(self) -> Any:
        there = self.standing
        return {
            "masses_kg": list(there.masses_kg), "stiffness_n_per_m": there.K, "damping_n_s_per_m": there.C,
            "laws": [SOFTENING, None],
        }  # fmt: skip


@pytest.fixture
def laboratory(plug: Plug, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], list[str]]:
    """Enter a folder with a rig file of the package, a pulse and a case; return what installs another class of rig, and
    gives the list of the sessions that its rigs are told."""
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

    def bring(kind: Any) -> list[str]:
        told: list[str] = []

        def make(info: RigInfo) -> Rig:
            rig: Simulated = kind(info)
            rig.sessions = told
            return rig

        plug(make)
        return told

    return bring


def banded(series: Array) -> Array:
    return np.asarray(sosfiltfilt(butter(4, 12.0, fs=1000.0, output="sos"), series))


def rms(series: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(series**2, axis=1)))


def by_another_program(ground_m_s2: Array) -> Array:
    """Return the absolute accelerations (3, n) of the declared storey below the specimen of `Softening`."""
    declared = make_setup(load_cases(["pulse.yaml"], ("identification.model=model.h5",))[0]).building.numerical
    there, every = specimen(), 5
    masses = 1.003 * there.masses_kg
    M, K, C = np.diag([declared.masses_kg[0], *masses]), np.zeros((3, 3)), np.zeros((3, 3))
    relative = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    for total, below, above in ((K, declared.K, there.K), (C, declared.C, there.C)):
        total += relative.T @ above @ relative
        total[0, 0] += below[0, 0]
    knots = 1e-3 * np.arange(0, ground_m_s2.size, every)
    springs = [declared.K[0, 0], there.K.sum(), -there.K[0, 1]]
    laws: list[list[dict[str, Any]]] = [[], [SOFTENING], []]
    accel = adaptive((M, C, K), springs, laws, knots, ground_m_s2[::every], knots)[2]
    return np.asarray(CubicSpline(knots, accel, axis=1)(1e-3 * np.arange(ground_m_s2.size)))


@pytest.mark.campaign
def test_a_run_on_it_keeps_its_truth_and_states_true_errors(
    laboratory: Callable[[Any], list[str]], tmp_path: Path
) -> None:
    """Identified and run without real time; the stated true errors are those of the stored truth, against SIM, and,
    where the rig tells its specimen, against another program's solution of it."""
    sessions = laboratory(Simulated)
    rths_cli.identify("pulse.yaml", "model.h5", yes=True)
    assert sessions == ["listening", "probe", "listening", "identification"]
    sessions.clear()
    model = {"identification.model": "model.h5"}
    result = rths_cli.run("pulse.yaml", settings=model, output=tmp_path, yes=True)
    assert result.status == "complete"
    assert sessions == ["listening", "listening", "verification", "listening", "exp_rths"]
    with h5py.File(result.path) as file:
        truth, sim = file["exp_rths/truth"], file["sim/abs_accel_m_s2"][()]
        accel = np.vstack([truth["table_accel_m_s2"][()], truth["floor_accel_m_s2"][()]])
        stated = file["metrics/exp_rths/rms_error_m_s2_true"][()]
        assert "exp_rths/true_reference_rms_error_m_s2" not in file["metrics"] and "truth" not in file
    assert rms(banded(accel - sim)) == pytest.approx(stated, rel=0.02)
    assert stated.max() < 0.05 * np.abs(sim).max()

    laboratory(Softening)
    result = rths_cli.run("pulse.yaml", settings=model, output=tmp_path / "as_it_is", yes=True, overrides=["model"])
    assert result.status == "complete"
    with h5py.File(result.path) as file:
        truth, metrics = file["exp_rths/truth"], file["metrics/exp_rths"]
        accel = np.vstack([truth["table_accel_m_s2"][()], truth["floor_accel_m_s2"][()]])
        stated, declared = metrics["true_reference_rms_error_m_s2"][()], metrics["rms_error_m_s2_true"][()]
        ground, late = file["record/ground_accel_m_s2"][()], file["metrics/sim_delay"]
        assert np.array_equal(metrics["true_reference_ratio"], stated / late["true_reference_rms_error_m_s2"][()])
        assert file["truth/specimen_masses_kg"][()] == pytest.approx(1.003 * specimen().masses_kg)
        assert (metrics["true_error_rank"][()] >= 0.0).all()
    wanted = rms(banded(accel - by_another_program(ground)))
    assert wanted == pytest.approx(stated, rel=0.03)
    assert (stated < 0.5 * declared).all()


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        ({"damping_n_s_per_m": None, "damping": [[1.0, 0.0], [0.0, 1.0]]}, "must return a mapping of masses_kg, stiff"),
        ({"masses_kg": [1.0]}, "must return finite masses_kg of shape (2,), got shape (1,)"),
        ({"masses_kg": [0.0, 1.0]}, "must return masses_kg > 0, got [0.0, 1.0]"),
        ({"damping_n_s_per_m": [[1.0, 0.0], [0.0, np.nan]]}, "must return finite damping_n_s_per_m of shape (2, 2)"),
        ({"laws": [{"kind": "soft"}, None]}, "returned laws.0.0.kind: no law is called 'soft'"),
        ({"laws": [SOFTENING]}, "laws of its specimen: table.physics.specimen_laws: 1 entries for 2 storeys"),
    ],
)
def test_a_told_specimen_that_does_not_fit_is_a_sentence(plug: Plug, told: Any, sentence: str) -> None:
    plug(type("Other", (Softening,), {"specimen": lambda rig: {**Softening.specimen(rig), **told}}))
    rig = open_plugin(INFO, {})
    with pytest.raises(RigError, match=re.escape(sentence)):
        told_building(rig, make_setup(load_cases(["el_centro_low_ff_fb"], ())[0]).building)
