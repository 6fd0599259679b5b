"""Sensitivities and masses from what an identified model shows of them and what a person measured.

Parameters are the logarithms of all sensitivities, accelerometers and further channels, and of the masses of the floors
on the table, each over its declared value. Before anybody measured they are normal: independent with the declared
uncertainties, or with the posterior of a calibration by identification, in which the ratios of gains and masses are
known far better than their sizes. The gain of a displacement sensor or load cell that the identification has taken up
follows from those of accelerometers and masses, because all of them tell the same. A comparison with a standard and a
weighing are observations of one parameter each, with their own uncertainties: in a linear Gaussian problem one
comparison moves every sensor.

Two uncertainties are returned of each. The joint one is that of this posterior. The one of the parameter by itself is
what is known of it without the ratios, as the identification widened it where sensors or masses differ more than
declared: the prior for an identification that shows the ratios anew, and by then no longer the differences. Joint
uncertainties would count the ratios twice there: several sensors that all follow from one comparison would pass for as
many comparisons.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.identification.absolute_scale import demand_of, taken_up
from rths_cli.identification.results import Calibration
from rths_cli.numerics.lti import Array
from rths_cli.rigs.description import RigInfo


@dataclass(frozen=True)
class Belief:
    """What is known of log sensitivities and log masses (p,) over their declared values: accelerometers, further
    channels, floors upwards. `alone` (p,) is the standard uncertainty of each without regard to the others."""

    mean: Array
    covariance: Array  # (p, p)
    alone: Array

    @property
    def joint(self) -> Array:
        """Return the standard uncertainties (p,) of the posterior."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True)
class Measured:
    """log(measured over declared) of one parameter, with its standard uncertainty."""

    place: int
    value: float
    error: float


def before(info: RigInfo, masses_kg: Array, found: Calibration | None) -> Belief:
    """Return what is known before anybody measured; `found`: the calibration of a model identified on this rig.

    `masses_kg` (n,) are those of the structure.
    """
    channels, further, floors = len(info.channels), len(info.further), len(masses_kg)
    declared = [*(one.uncertainty for one in info.all_channels), *info.uncertainty.of_masses(floors)]
    alone = np.array(declared, dtype=float)
    if found is None:
        return Belief(np.zeros(alone.size), np.diag(alone**2), alone)
    masses = slice(channels + further, None)
    for places, widening in ((slice(0, channels), found.gain_widening), (masses, found.mass_widening)):
        alone[places] *= widening if widening.size else 1.0
    demand = np.zeros((alone.size, 3 * channels + floors))
    demand[:channels, :channels], demand[masses, 3 * channels :] = np.eye(channels), np.eye(floors)
    mean, rest = np.zeros(alone.size), np.zeros(alone.size)
    mean[:channels], mean[masses] = np.log(found.gain), np.log(found.mass)
    for i, channel in enumerate(info.further):
        gain = float(found.further_gain[i]) if i < len(found.further_gain) else 1.0
        mean[channels + i] = np.log(gain)
        if gain == 1.0:
            rest[channels + i] = channel.uncertainty
        else:
            demand[channels + i] = -demand_of(channel, masses_kg, channels)
    return Belief(mean, demand @ found.covariance @ demand.T + np.diag(rest**2), alone)


def after(belief: Belief, one: Measured) -> Belief:
    """Return what is known after a measurement; that of a parameter which is declared as exact changes nothing."""
    if belief.alone[one.place] == 0.0:
        return belief
    weights, alone = np.zeros(belief.mean.size), belief.alone.copy()
    weights[one.place] = 1.0
    mean, spread = taken_up(belief.mean, belief.covariance, weights, one.value, one.error)
    alone[one.place] = (alone[one.place] ** -2 + one.error**-2) ** -0.5
    return Belief(mean, spread, alone)


def contradiction(belief: Belief, one: Measured) -> float:
    """Return by how many standard uncertainties a measurement differs from what is known before it."""
    total = float(belief.covariance[one.place, one.place]) + one.error**2
    return abs(one.value - float(belief.mean[one.place])) / float(np.sqrt(total))
