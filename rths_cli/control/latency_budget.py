"""The latency budget of the loop: delay of every sensor, filter, converter and hold, and what compensates it.

The loop runs from the table's motion through sensors, filter and numerical part to the command, and through converter,
hold and table back to the motion. Every delay, hold and filter of it is one item of the budget.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rths_cli.control.designed_blocks import Blocks
from rths_cli.control.interface import InterfaceForce
from rths_cli.control.kalman_filter import specimen_state_space
from rths_cli.control.numerical_substructure import amplitude_and_lag
from rths_cli.control.sensor_correction import correction
from rths_cli.numerics.bands import with_test_band
from rths_cli.numerics.lti import Array, Block, ComplexArray, Model
from rths_cli.rigs.description import Channel, RigInfo
from rths_cli.structure import Numerical, Specimen

FREQUENCIES_HZ = np.array([1.0, 3.0, 5.0, 10.0, 20.0, 100.0])  # with the usual test band
PREDICTION, INVERSE, CORRECTION, NOTHING = "prediction", "inverse", "sensor correction", "nothing"
GRID_HZ = np.linspace(0.05, 100.0, 2000)  # along which phases are unwrapped; stretched for higher frequencies


@dataclass(frozen=True)
class Delay:
    """One item of the budget: lag in s (n,), what takes it out, and what is left in s (n,); negative is early."""

    name: str
    delay_s: Array
    taken_out_by: str
    left_s: Array


@dataclass(frozen=True)
class LatencyBudget:
    """Every latency of the loop at `frequency_hz` (n,)."""

    frequency_hz: Array
    items: tuple[Delay, ...]

    @property
    def total_s(self) -> Array:
        """Return the sum of all items in s, (n,)."""
        return np.sum([item.delay_s for item in self.items], axis=0)

    @property
    def left_s(self) -> Array:
        """Return what is left of all items in s, (n,)."""
        return np.sum([item.left_s for item in self.items], axis=0)

    @property
    def compensated_s(self) -> Array:
        """Return what is taken out in s, (n,)."""
        return self.total_s - self.left_s


@dataclass(frozen=True)
class Loop:
    """What a budget is made of: rig, blocks of the step, table model, both substructures (the specimen as identified),
    the base shear's weights at the instant of the samples, whether the sensors' corners are corrected, and whether an
    inverse drives the table."""

    rig: RigInfo
    blocks: Blocks
    model: Model
    numerical: Numerical
    specimen: Specimen
    shear_now: InterfaceForce
    removes_sensors: bool
    has_inverse: bool


def frequencies_hz(test_band_hz: float) -> Array:
    """Return the frequencies (6,) in Hz, two digits each, at which the latencies of a case are stated."""
    return np.array([float(f"{with_test_band(hz, test_band_hz):.2g}") for hz in FREQUENCIES_HZ])


def budget(loop: Loop, frequency_hz: Array = FREQUENCIES_HZ) -> LatencyBudget:
    """Return every latency of a loop at `frequency_hz` (n,), computed from rig and settings."""
    items = (*_command_side(loop, frequency_hz), _integration(loop, frequency_hz), *_sensors(loop, frequency_hz),
             _kalman(loop, frequency_hz))  # fmt: skip
    return LatencyBudget(frequency_hz, items)


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


def declared_s(rig: RigInfo) -> float:
    """Return the delay from command to table that a rig declares: converter, hold and transport."""
    return converter_s(rig) + hold_s(rig) + rig.transport_s


def _command_side(loop: Loop, frequency_hz: Array) -> tuple[Delay, ...]:
    """Return converter, hold, transport, and what inverse and table add to them.

    An explicit delay of the model is predicted: the hybrid clock runs ahead by the lead, the inverse lags by what of
    it the delay does not fill. A delay in the model's roots is inverted with them.
    """
    rig, lead_s = loop.rig, loop.blocks.lead_samples * loop.rig.dt_s
    by = PREDICTION if lead_s > 0.0 else INVERSE if loop.has_inverse else NOTHING
    none = np.zeros(len(frequency_hz))
    pure = (("converter", converter_s(rig)), ("hold", hold_s(rig)), ("transport", rig.transport_s))
    items = [Delay(name, none + s, by if s else NOTHING, none + (s if by == NOTHING else 0.0)) for name, s in pure]
    lag = tracking_lag_s(loop.blocks.feedforward.linearised(), loop.model, frequency_hz)
    elsewhere = 0.0 if by == INVERSE else declared_s(rig)
    left = lag - (elsewhere if by == NOTHING else lead_s)
    return (*items, Delay("inverse", lag - elsewhere, PREDICTION if lead_s else NOTHING, left))


def tracking_lag_s(feedforward: Block, model: Model, frequency_hz: Array) -> Array:
    """Return how late the identified table follows the desired acceleration through the feedforward, (n,).

    The phase is counted from low frequency on, so that lags beyond half a period are right.
    """
    way = GRID_HZ * max(frequency_hz.max() / GRID_HZ[-1], 1.0)
    grid = np.unique(np.concatenate([way[: np.searchsorted(way, frequency_hz.max())], frequency_hz]))
    s = 2j * np.pi * grid
    command = np.einsum("cf,cf->f", feedforward.response(grid)[0, :3], np.array([s**0, 1.0 / s, 1.0 / s**2]))
    lag = -np.unwrap(np.angle(command * model.response(grid))) / (2.0 * np.pi * grid)
    return lag[np.searchsorted(grid, frequency_hz)]


def _integration(loop: Loop, frequency_hz: Array) -> Delay:
    _, lag = amplitude_and_lag(loop.numerical, loop.blocks.numerical.linearised(), frequency_hz)
    return Delay("integration", lag, NOTHING, lag)


def _sensors(loop: Loop, frequency_hz: Array) -> tuple[Delay, Delay]:
    """Return low pass and AC coupling of the accelerometers, each with what its own correction leaves."""
    channel = loop.rig.channels[0]
    parts = (("sensor", replace(channel, high_pass_hz=0.0)), ("coupling", replace(channel, low_pass_hz=0.0)))
    return tuple(_sensor(loop, name, part, frequency_hz) for name, part in parts)  # type: ignore[return-value]


def _sensor(loop: Loop, name: str, channel: Channel, frequency_hz: Array) -> Delay:
    response = sensor_response(channel, frequency_hz)
    lag = _lag_s(response, frequency_hz)
    if not np.any(lag):
        return Delay(name, lag, NOTHING, lag)
    if not loop.removes_sensors:  # the model has them in its roots, the floors have them like the table
        return Delay(name, lag, INVERSE, 0.0 * lag) if loop.has_inverse else Delay(name, lag, NOTHING, lag)
    corrected = correction((channel,), loop.rig.dt_s).response(frequency_hz)[0, 0]
    return Delay(name, lag, CORRECTION, _lag_s(response * corrected, frequency_hz))


def sensor_response(channel: Channel, frequency_hz: Array) -> ComplexArray:
    """Return an accelerometer's response in V per m/s^2, (n,), its two first-order corners."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
    value = channel.sensitivity_v_per_unit * s / (s + 2.0 * np.pi * channel.high_pass_hz)
    return value / (1.0 + s / (2.0 * np.pi * channel.low_pass_hz)) if channel.low_pass_hz > 0.0 else value


def _kalman(loop: Loop, frequency_hz: Array) -> Delay:
    """Return the lag of the estimated base shear, and of the one the step uses, which is a lead ahead."""
    blocks = loop.blocks
    now, _ = shear_response(blocks.estimator, loop.shear_now, loop.specimen, frequency_hz)
    used = ahead_lag_s(blocks.estimator, blocks.interface.force, loop.specimen, frequency_hz)
    return Delay("kalman", now, PREDICTION if blocks.lead_samples else NOTHING, used)


def ahead_lag_s(kalman: Block, shear: InterfaceForce, specimen: Specimen, frequency_hz: Array) -> Array:
    """Return by how much the base shear (Eq. 2.6) that the step uses for k + n_p is late, in s, (n,), on a table that
    does what was desired."""
    estimate, recent, measured, desired = shear.of_one()
    interface_mass_kg = -float(measured[0])
    z = np.exp(2j * np.pi * frequency_hz * kalman.dt_s)
    floors = specimen_state_space(specimen).response(frequency_hz)[:, 0]
    samples = np.vstack([np.ones(len(frequency_hz)), floors])
    estimates = np.einsum("ecf,cf->ef", kalman.response(frequency_hz), samples)
    count = len(recent)
    found = estimate @ estimates + measured @ samples + desired * z**count
    found += sum((weight * z**j for j, weight in enumerate(recent)), np.zeros_like(found))
    true = (-specimen.masses_kg @ floors - interface_mass_kg) * z**count
    return _lag_s(found / true, frequency_hz)


def shear_response(
    kalman: Block, shear: InterfaceForce, specimen: Specimen, frequency_hz: Array
) -> tuple[Array, Array]:
    """Return lag in s and noise gain (n_frequencies,) of the base shear the filter estimates at the same instant.

    Lag: phase of estimated over true base shear, both answering the table's acceleration through `specimen`.
    Noise gain: noise of the estimate over that of Eq. 2.6 from the raw floor samples, equal noise on each floor.
    """
    frequency = np.asarray(frequency_hz, dtype=float)
    response = np.einsum("e,ecf->cf", shear.of_one()[0], kalman.response(frequency))
    floors = specimen_state_space(specimen).response(frequency)[:, 0]
    true = -specimen.masses_kg @ floors
    estimated = response[0] + np.sum(response[1:] * floors, axis=0)
    noise = np.linalg.norm(response[1:], axis=0) / np.linalg.norm(specimen.masses_kg)
    return _lag_s(estimated / true, frequency), noise


def _lag_s(response: ComplexArray, frequency_hz: Array) -> Array:
    return -np.angle(response) / (2.0 * np.pi * frequency_hz)
