"""The numerical part of a test with an actuator: on an ideal actuator it is the whole structure; its loop with the
identified actuator is that of python-control."""

from __future__ import annotations

from typing import TYPE_CHECKING

import control
import numpy as np
import pytest

from rths_cli.analysis.closed_loop import closed_loop_matrix, spectral_radius
from rths_cli.analysis.identified_rig_block import identified_actuator
from rths_cli.analysis.references import reference_of
from rths_cli.control import feedback, feedforward, sensor_correction
from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.displacement_interface import lead_of_inverse, measured_force, storeys_of_actuator
from rths_cli.control.state_space import static
from rths_cli.numerics.lti import Model
from rths_cli.rigs.description import Channel, Converters, Limits, RigInfo
from rths_cli.structure import Building, Numerical, Specimen, assemble, storey_matrix

if TYPE_CHECKING:
    from rths_cli.numerics.lti import Array

SPRING = Specimen(np.array([30.0]), np.array([[1.2e6]]), np.array([[110.0]]), attached=True)
FLOORS = Numerical(np.array([2000.0, 1970.0]), storey_matrix([1.2e7, 1.1e7]), storey_matrix([4e4, 3e4]))
WHOLE = Building(FLOORS, SPRING, 30.0, *assemble(FLOORS, SPRING, 30.0))
POLES = np.array([-182.0 + 230.0j, -182.0 - 230.0j, -48.0, -9.0 + 421.0j, -9.0 - 421.0j])


def _ground(dt_s: float) -> Array:
    time = dt_s * np.arange(round(2.0 / dt_s))
    return 2.0 * np.sin(2.0 * np.pi * 3.0 * time) * np.exp(-((time - 1.0) ** 2) / 0.08)


def _ideal(dt_s: float, lead: int) -> tuple[Array, Array]:
    """Return the interface's displacement and the felt force where F is that of the desired motion `lead` ago."""
    storeys = storeys_of_actuator(FLOORS, SPRING, dt_s, lead)
    block, force = storeys.block, storeys.force
    felt = np.array([30.0, 110.0, 1.2e6])
    state, shown, rows = np.zeros(len(block.A)), [0.0] * (lead + 1), []
    for now in _ground(dt_s):
        given = np.array([now, -shown[-lead]])
        motion = block.C @ state + block.D @ given
        rows.append((motion[2], (force.C @ state + force.D @ given)[0]))
        shown.append(float(felt @ motion))
        state = block.A @ state + block.B @ given
    place, f = np.array(rows).T
    return place, f


@pytest.mark.parametrize("lead", [1, 3])
def test_on_an_ideal_actuator_it_converges_to_the_whole_structure(lead: int) -> None:
    """SIM shares no code with it; the hold of the force between samples is of second order."""
    errors = []
    for dt_s in (2e-3, 1e-3):
        sim = reference_of(WHOLE).sim(WHOLE, dt_s, _ground(dt_s))
        place, force = _ideal(dt_s, lead)
        errors.append(np.abs(place - sim.rel_disp_m[-1]).max() / np.abs(sim.rel_disp_m[-1]).max())
        assert np.abs(force - sim.base_shear_n).max() < 4e-3 * np.abs(sim.base_shear_n).max()
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_the_loop_with_the_identified_actuator_is_that_of_python_control() -> None:
    dt_s, gain = 1e-3, 0.005
    model = Model(
        np.zeros(2, complex), POLES, gain * float(np.real(np.prod(-POLES))), 1.5 * dt_s, (0.3, 60.0), 0.0, 1, dt_s
    )
    channels = (
        Channel("displacement", 200.0, 0.05, 0.0, 0.0, kind="displacement"),
        Channel("force", 1e-3, 1e4, 0.0, 0.0, kind="force"),
    )
    info = RigInfo("rig", "virtual", dt_s, channels, Converters(0, 10.0), 1, Limits(0.04, 1.0, 50.0, 8e3), gain, 5.0,
                   30.0, interface="displacement")  # fmt: skip
    rig, lead = identified_actuator(model, SPRING, info), lead_of_inverse(model, dt_s)
    frequency = np.array([0.5, 5.0, 20.0])
    s = 2j * np.pi * frequency
    shown = rig.plant.response(frequency)[:, 0] / np.array([[200.0], [1e-3]])
    assert shown[0] == pytest.approx(model.response(frequency) / s**2, rel=1e-3)
    assert shown[1] / shown[0] == pytest.approx(1.2e6 + 110.0 * s + 30.0 * s**2, rel=2e-3)
    storeys = storeys_of_actuator(FLOORS, SPRING, dt_s, lead)
    inverse = feedforward.lagged_inverse(model, dt_s, lead)
    blocks = Blocks(
        sensor_correction.correction(channels, dt_s, corners=False), static(np.zeros((1, 2)), dt_s, "kalman", (), ()),
        storeys, inverse, feedback.none(dt_s), measured_force(lead),
    )  # fmt: skip
    plant, numerical, forward = rig.plant, storeys.block, inverse
    chain = (
        control.ss(forward.A, forward.B, forward.C, forward.D, dt_s)
        * control.ss(numerical.A, numerical.B[:, 1:], numerical.C, numerical.D[:, 1:], dt_s)
        * control.ss(plant.A, plant.B, -plant.C[1:] / 1e-3, -plant.D[1:] / 1e-3, dt_s)
    )
    poles = control.feedback(chain, 1, 1).poles()
    own = np.linalg.eigvals(closed_loop_matrix(rig, blocks))
    assert spectral_radius(closed_loop_matrix(rig, blocks)) == pytest.approx(float(np.abs(poles).max()), abs=1e-9)
    for pole in poles[np.abs(poles) > 0.9]:
        assert np.abs(own - pole).min() < 1e-6
