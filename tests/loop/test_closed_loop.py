"""The sampled hybrid loop against the exact matrix of the same loop, and against the undivided building."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bare_rig import BareRig
from bench import DT_S, LINEAR, held, ideal_info, rig_info, specimen
from hybrid import best_like, closed_loop, ground, open_limits, paper_like, storeys
from portfolio import parametrize_first
from scipy.linalg import expm

from rths_cli.case.virtual_physics_schema import VirtualPhysics
from rths_cli.control import feedback, kalman_filter, numerical_substructure
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import Interface
from rths_cli.control.state_space import static
from rths_cli.loop import simulated_time_run as loop_drive
from rths_cli.loop.simulated_time_run import Outcome, play
from rths_cli.loop.step_arrays import NUMERICAL, RECORD
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo
from rths_cli.rigs.virtual.virtual_rig import VirtualRig, build_plant


def linear_run(info: RigInfo, blocks: Blocks, drive: Array, interface_mass_kg: float = 0.0) -> Outcome:
    plant = build_plant(info, LINEAR, specimen(), 0.0, interface_mass_kg=interface_mass_kg)
    return play(VirtualRig(info, plant, (0,)), info, blocks, NUMERICAL, drive, open_limits(info))


@pytest.mark.parametrize("latency", [0, 1, 2])
@pytest.mark.parametrize("interface_mass", [0.0, 1.2])
@pytest.mark.parametrize("make", [paper_like, best_like])
def test_the_linear_loop_is_the_exact_matrix(make: object, interface_mass: float, latency: int) -> None:
    """Every logged signal of 3 s, to 1e-9 of its peak."""
    info, drive = ideal_info(latency_samples=latency), ground(6000)
    blocks = make(info, interface_mass)
    outcome = linear_run(info, blocks, drive, interface_mass)
    assert outcome.steps == 6000
    assert outcome.stopped_by_limit == ""
    exact = closed_loop(info, blocks, interface_mass).run(drive)
    for name, wanted in exact.items():
        found = np.atleast_2d(getattr(outcome.log, name))
        assert np.abs(found - wanted).max() <= 1e-9 * np.abs(wanted).max(), name
        assert np.abs(wanted).max() > 1e-6


@pytest.mark.parametrize(("latency", "diverges"), [(1, False), (24, True)])
def test_the_spectral_radius_forecasts_divergence(latency: int, diverges: bool) -> None:
    """Blocks designed for one sample of latency on a table with 1 or 24: 12 ms is beyond the critical delay."""
    blocks = replace(paper_like(ideal_info(latency_samples=1)), latency_samples=latency)
    info = ideal_info(latency_samples=latency, range_v=1e9)
    radius = closed_loop(info, blocks).spectral_radius
    assert (radius > 1.0 + 1e-9) == diverges
    drive = 1e-6 * ground(18000)
    drive[2000:] = 0.0
    place = linear_run(info, blocks, drive).log.true_displacement_m
    early, late = np.abs(place[8000:10000]).max(), np.abs(place[16000:18000]).max()
    assert (late > early) == diverges
    if diverges:
        assert np.log(late / early) / 8000 == pytest.approx(np.log(radius), rel=0.05)


@parametrize_first(1, "source", [RECORD, NUMERICAL])
def test_the_compiled_run_equals_the_exchanging_one_byte_for_byte(source: int) -> None:
    info = rig_info()
    rig = VirtualRig(info, build_plant(info, VirtualPhysics(), specimen(), 3e-4), (1, 3))
    blocks, drive = replace(best_like(info), shaping_step_v=info.converters.step_v), ground(5000)
    wrapped = BareRig(rig)
    compiled, exchanged = (play(r, info, blocks, source, drive, open_limits(info)) for r in (rig, wrapped))
    assert wrapped.calls == ["open", "arm", "rest", "close"]
    assert compiled.steps == exchanged.steps == 5000
    for name in ("command_v", "desired", "corrected", "estimated", "base_shear_n"):
        one, other = getattr(compiled.log, name), getattr(exchanged.log, name)
        if not (source == RECORD and name == "base_shear_n"):
            assert np.isfinite(one).all()
        assert one.tobytes() == other.tobytes(), name
    assert exchanged.log.true_velocity_m_s.size == 0
    for log in (compiled.log, exchanged.log):
        assert (log.compute_ns > 0).all()


class IdealTable:
    """A table whose acceleration is the command, held; the specimen on it is exact."""

    def __init__(self, info: RigInfo) -> None:
        self.info, parts = info, specimen()
        inverse = 1.0 / parts.masses_kg[:, None]
        rate = np.hstack([-inverse * parts.K, -inverse * parts.C])
        a = np.vstack([np.hstack([np.zeros((2, 2)), np.eye(2)]), rate])
        self.rate, (self.step, self.drive) = rate, held(a, np.array([0.0, 0.0, -1.0, -1.0]), info.dt_s)

    def open(self) -> None: ...

    def arm(self) -> Array:
        self.state = np.zeros(4)
        return np.zeros(3)

    def exchange(self, command_v: float) -> Array:
        self.state = self.step @ self.state + self.drive * command_v
        return np.concatenate([[command_v], self.rate @ self.state])

    def rest(self) -> None: ...

    def close(self) -> None: ...


def hybrid_on_ideal_table(dt_s: float, ground_accel: Array) -> Array:
    """Return the interface acceleration of a staggered test: base shear of the floors' last samples."""
    info = replace(ideal_info(latency_samples=0, dt_s=dt_s), dt_s=dt_s)
    shear = kalman_filter.measured_shear(specimen(), 0.0)
    pick = np.vstack([np.zeros((4, 3)), [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]])
    blocks = Blocks(
        static(np.eye(3), dt_s, "sensor_correction", (), ()),
        static(pick, dt_s, "kalman", (), ()),
        numerical_substructure.interface(storeys(), dt_s),
        static(np.array([[1.0, 0.0, 0.0]]), dt_s, "feedforward", (), ()),
        feedback.none(dt_s),
        Interface(shear),
        latency_samples=0,
    )
    drive = np.column_stack([ground_accel, np.zeros((len(ground_accel), 2))])
    return play(IdealTable(info), info, blocks, NUMERICAL, drive, open_limits(info)).log.desired[0]


def undivided(dt_s: float, ground_accel: Array) -> Array:
    """Return storey 1's absolute acceleration of the whole building, exact for straight lines between samples."""
    parts, below = specimen(), storeys()
    stiffness, dashpots = np.zeros((3, 3)), np.zeros((3, 3))
    into = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    for whole, own, first in ((stiffness, parts.K, below.K), (dashpots, parts.C, below.C)):
        whole += into.T @ own @ into
        whole[0, 0] += first[0, 0]
    inverse = np.diag(1.0 / np.concatenate([below.masses_kg, parts.masses_kg]))
    rate = np.hstack([-inverse @ stiffness, -inverse @ dashpots])
    augmented = np.zeros((8, 8))
    augmented[:6, :6] = np.vstack([np.hstack([np.zeros((3, 3)), np.eye(3)]), rate])
    augmented[3:6, 6], augmented[6, 7] = -1.0, 1.0
    step = expm(augmented * dt_s)
    state, accel = np.zeros(6), np.zeros(len(ground_accel))
    for k in range(len(ground_accel) - 1):
        accel[k] = rate[0] @ state
        slope = (ground_accel[k + 1] - ground_accel[k]) / dt_s
        state = step[:6, :6] @ state + step[:6, 6] * ground_accel[k] + step[:6, 7] * slope
    return accel[:-1]


@pytest.mark.campaign
def test_the_staggered_loop_converges_to_the_undivided_building_with_first_order() -> None:
    errors = []
    for dt_s in (1e-3, 5e-4, 2.5e-4):
        time = np.arange(round(3.0 / dt_s)) * dt_s
        accel = np.sin(2.0 * np.pi * 1.5 * time) * np.sin(np.pi * time / 3.0) ** 2
        exact = undivided(dt_s, accel)
        errors.append(np.abs(hybrid_on_ideal_table(dt_s, accel)[:-1] - exact).max() / np.abs(exact).max())
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx([1.0, 1.0], abs=0.15)
    assert errors[-1] < 0.05


def test_every_size_of_structure_runs_the_same_compiled_code() -> None:
    compiled = []
    for floors, numerical_storeys in ((1, 1), (2, 3), (3, 1)):
        stiffness = (7331.56, 7376.40, 7000.0)[:floors]
        info, parts = rig_info(floors=floors), specimen(stiffness)
        shear = kalman_filter.predicted_shear(parts, 0.0, 2, DT_S)
        gain = np.array([[0.0, 0.0, 1.0 / info.gain_m_per_v]])
        blocks = replace(
            best_like(rig_info(), numerical_storeys=numerical_storeys),
            correction=static(np.eye(1 + floors) * 9.80665, DT_S, "sensor_correction", (), ()),
            open_loop=kalman_filter.open_loop(parts, DT_S),
            estimator=kalman_filter.kalman_block(parts, 1e3, 1.0, DT_S, knows_table=True),
            feedforward=static(gain, DT_S, "feedforward", (), ()),
            interface=Interface(shear),
        )
        rig = VirtualRig(info, build_plant(info, VirtualPhysics(), parts, 0.0), (0,))
        by_rows = np.asfortranarray(ground(50))  # whatever its layout
        outcome = play(rig, info, blocks, NUMERICAL, by_rows, open_limits(info))
        assert outcome.steps == 50
        assert np.isfinite(outcome.log.estimated).all()
        compiled.append(len(loop_drive.run_virtual.dispatcher.overloads))
    assert len(set(compiled)) == 1  # tests before this one may have compiled others
