"""The move from the loop's clock to the record's."""

from types import SimpleNamespace

import numpy as np
import pytest

from rths_cli.control.numerical_substructure import interface
from rths_cli.experiment.run_signals import on_record_clock, whole_building
from rths_cli.loop.block_replay import run_block
from rths_cli.loop.run_log import Signals
from rths_cli.loop.simulated_time_run import Outcome
from rths_cli.structure import build


def outcome(steps: int, done: int) -> Outcome:
    count = np.arange(steps, dtype=float)
    log = Signals(
        command_v=count,
        desired=np.vstack([count, count, count]),
        corrected=np.vstack([count, 10 + count]),
        estimated=np.vstack([count, count, count]),
        base_shear_n=count,
        logged=np.zeros((0, steps)),
        further=np.zeros((0, steps)),
        further_v=np.zeros((0, steps)),
        true_velocity_m_s=np.vstack([count**2, count**2]),
        true_displacement_m=count,
        compute_ns=count,
        samples_v=np.zeros((0, steps)),
        late_ns=np.zeros(0),
        exchange_ns=np.zeros(0),
        lost=np.zeros(0),
        state=np.zeros(0),
    )
    return Outcome(log, done, None, "", 0.0)


def test_what_was_desired_at_step_k_meets_what_is_measured_lead_samples_later() -> None:
    series = on_record_clock(outcome(102, 102), 2, 0.5, 100)
    assert series.desired.shape == (3, 100)
    assert np.array_equal(series.desired[0], np.arange(100.0))
    assert np.array_equal(series.measured[0], np.arange(2.0, 102.0))
    assert np.array_equal(series.command_v, np.arange(2.0, 102.0))
    assert np.array_equal(series.estimated[0], np.arange(2.0, 102.0))
    assert np.array_equal(series.true_disp_m, np.arange(2.0, 102.0))
    assert np.array_equal(series.base_shear_n, np.arange(100.0))


def test_true_acceleration_is_the_mean_over_the_step_around_the_sample() -> None:
    # v in the middle after t_k is k^2: the mean around t_k is (k^2 - (k - 1)^2) / dt
    series = on_record_clock(outcome(50, 50), 1, 0.5, 49)
    k = np.arange(1.0, 50.0)
    assert series.true_accel[0] == pytest.approx((k**2 - (k - 1) ** 2) / 0.5)


def test_true_acceleration_begins_at_rest() -> None:
    whole = outcome(5, 5)
    whole.log.true_velocity_m_s[:] += 3.0
    assert on_record_clock(whole, 0, 0.5, 5).true_accel[1] == pytest.approx(np.array([3.0, 1.0, 3.0, 5.0, 7.0]) / 0.5)
    assert on_record_clock(whole, 1, 0.5, 4).true_accel[1] == pytest.approx(np.array([1.0, 3.0, 5.0, 7.0]) / 0.5)
    assert on_record_clock(outcome(5, 0), 0, 0.5, 5).true_accel.shape == (2, 0)


def test_a_stopped_run_is_shorter() -> None:
    assert on_record_clock(outcome(102, 40), 2, 0.5, 100).desired.shape == (3, 38)
    assert on_record_clock(outcome(102, 1), 2, 0.5, 100).command_v.size == 0


def test_experimental_floors_ride_on_the_interface() -> None:
    spec = SimpleNamespace(
        numerical=SimpleNamespace(masses_kg=[6.0, 7.0], stiffness_n_per_m=[8000.0, 7000.0]),
        experimental=SimpleNamespace(
            masses_kg=[6.5],
            natural_frequencies_hz=None,
            stiffness_n_per_m=[7300.0],
            damping_ratios=[0.04],
            dashpots_n_s_per_m=None,
        ),
        interface_experimental_mass_kg=0.0,
    )
    building = build(spec, SimpleNamespace(first_mode_ratio=None, dashpots_n_s_per_m=[20.0, 20.0]))
    series = on_record_clock(outcome(60, 60), 0, 5e-4, 60)
    disp, vel, accel = whole_building(building, series, np.zeros(60), 5e-4)
    assert disp.shape == vel.shape == accel.shape == (3, 60)
    assert np.allclose(disp[2] - disp[1], series.estimated[0])
    assert np.allclose(vel[2] - vel[1], series.estimated[1])
    assert np.array_equal(accel[1:], series.measured)  # interface and floor as measured
    assert disp[1, -1] > 0.0  # the base shear pushes the interface its own way
    chosen, _, _ = whole_building(building, series, np.zeros(60), 5e-4, "cr")
    block = interface(building.numerical, 5e-4, "cr")
    stepped = run_block(block, np.vstack([np.zeros(60), series.base_shear_n]))
    assert chosen[1] == pytest.approx(stepped[2])  # the displacement that the step computed
    assert np.abs(chosen[1] - disp[1]).max() > 1e-4 * np.abs(disp[1]).max()
