"""Where the time goes between the table's motion and the command that answers it."""

from __future__ import annotations

import numpy as np

from rths_cli.control.estimator import Shear, specimen_state_space
from rths_cli.lti import Array, Block
from rths_cli.rig_info import RigInfo
from rths_cli.structure import Specimen

FREQUENCIES_HZ = np.array([1.0, 3.0, 5.0, 10.0, 20.0, 100.0])


def converter_s(rig: RigInfo) -> float:
    """Return the wait between samples and the hold they command."""
    return rig.latency_samples * rig.dt_s


def hold_s(rig: RigInfo) -> float:
    """Return the mean age of a held command, half a sample."""
    return 0.5 * rig.dt_s


def sensor_s(rig: RigInfo) -> float:
    """Return the low-frequency lag of the accelerometers' low pass, which the correction takes out."""
    corner = rig.channels[0].low_pass_hz
    return 1.0 / (2.0 * np.pi * corner) if corner > 0.0 else 0.0


def shear_response(kalman: Block, shear: Shear, specimen: Specimen, frequency_hz: Array) -> tuple[Array, Array]:
    """Return lag in s and noise gain (n_frequencies,) of the base shear the filter estimates at the same instant.

    Lag: phase of estimated over true base shear, both answering the table's acceleration through `specimen`.
    Noise gain: noise of the estimate over that of Eq. 2.6 from the raw floor samples, equal noise on each floor.
    """
    frequency = np.asarray(frequency_hz, dtype=float)
    response = np.einsum("e,ecf->cf", shear.estimate, kalman.response(frequency))
    floors = specimen_state_space(specimen).response(frequency)[:, 0]
    true = -specimen.masses_kg @ floors
    estimated = response[0] + np.sum(response[1:] * floors, axis=0)
    lag = -np.angle(estimated / true) / (2.0 * np.pi * frequency)
    noise = np.linalg.norm(response[1:], axis=0) / np.linalg.norm(specimen.masses_kg)
    return lag, noise
