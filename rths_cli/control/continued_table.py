"""The table's response beyond the identified band, continued by what a laboratory knows: masses, specimen and drive.

A drive pushes the table with a force in proportion to its command, less what displacement and velocity of the table
hold back, perhaps late by a lag of first order; the force moves the table's mass and the specimen. With the
specimen's apparent mass A(s) at its base, and command over acceleration

    u / a = (p_0 + p_1 s) (m + A(s)) + p_2 + p_3 / s + p_4 / s^2,

the five numbers p are linear, and the measured response of the identified band shows them. Modes of the specimen beyond
the band are in A(s), so that their pairs of poles and zeros stand where table and specimen together have them. A model
of the table that was fitted in the band alone has its poles there by chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eigh

from rths_cli.numerics.lti import Array, ComplexArray, Frf, Model, hold_size
from rths_cli.structure import Specimen

MOST_LINE_ERROR = 0.1  # relative standard error of a line that is used
LEAST_LINES = 20
MOST_MISFIT = 0.05  # rms of the relative difference in the band, up to which the drive is of this kind
LEAST_SHIFT = 0.05  # relative: frequencies of a real specimen's higher modes against those of its chain of storeys
SHIFTS, DAMPINGS = 9, (0.5, 1.0)  # frequencies in between; damping over the identified one, at least
MOST_UNKNOWN = 3.0  # largest relative error of the continued response


@dataclass(frozen=True)
class ContinuedTable:
    """The response of table and specimen beyond `end_hz`, the end of the identified band.

    `shift`: by how much the specimen's frequencies may be off, relative. `loudest_m_s2_per_v`: the largest response in
    the upper half of the band, to which the envelope falls back where the drive is not of this kind.
    """

    model: Model
    numbers: Array  # (5,) p, in powers of s / (2 pi end_hz)
    moving_mass_kg: float
    frequency_hz: Array  # (n,) of the specimen on a fixed base
    damping_ratio: Array  # (n,)
    modal_mass_kg: Array  # (n,) effective in translation of the base
    end_hz: float
    shift: float
    misfit: float  # rms of the relative difference from the measured response in the band, without its scatter
    loudest_m_s2_per_v: float

    @property
    def shown(self) -> bool:
        """Return whether the measured response is that of a drive of this kind."""
        return bool(self.misfit <= MOST_MISFIT and self.numbers[0] > 0.0)

    @property
    def modes_beyond_hz(self) -> Array:
        """Return the specimen's frequencies (m,) beyond the band."""
        return self.frequency_hz[self.frequency_hz > self.end_hz]

    def response(self, frequency_hz: Array, shift: float = 0.0, damping: float = 1.0) -> ComplexArray:
        """Return command to acceleration (n,) in m/s^2 per V, without delay, with the specimen's frequencies changed by
        a relative `shift` and its damping by a factor."""
        s = _s(frequency_hz)
        columns = _columns(s, self.end_hz, self.moving_mass_kg + self._apparent_kg(s, shift, damping))
        return np.asarray(hold_size(frequency_hz, self.model.dt_s) / (columns @ self.numbers), dtype=complex)

    def largest(self, frequency_hz: Array) -> Array:
        """Return the largest response (n,) in m/s^2 per V that specimen and drive allow: with every shift of the
        specimen's frequencies and half of its damping, and not below the model's."""
        found = np.abs(self.model.response(frequency_hz))
        if not self.shown:
            found = np.maximum(found, self.loudest_m_s2_per_v)
        if self.numbers[0] > 0.0:
            for each in self.variants(frequency_hz):
                found = np.maximum(found, np.abs(each))
        return found

    def variants(self, frequency_hz: Array) -> Iterator[ComplexArray]:
        """Yield the responses (n,), the delay included, with every shift of the specimen's frequencies and less
        damping; the identified one alone where no mode lies near the end of the band or beyond."""
        late = np.exp(-2j * np.pi * frequency_hz * self.late_s)
        moves = self.frequency_hz.max() * (1.0 + 4.0 * self.shift) > self.end_hz
        for shift in np.linspace(-self.shift, self.shift, SHIFTS) if moves else (0.0,):
            for damping in DAMPINGS if moves else (1.0,):
                yield self.response(frequency_hz, shift, damping) * late

    @property
    def late_s(self) -> float:
        """Return the delay from command to acceleration in s, half a sample of the hold included."""
        return max(self.model.delay_s, (self.model.latency_samples + 0.5) * self.model.dt_s)

    def with_specimen(self, there: Specimen) -> ContinuedTable:
        """Return the table with another specimen on it."""
        hz, ratio, mass = _fixed_base(there)
        return replace(self, frequency_hz=hz, damping_ratio=ratio, modal_mass_kg=mass)

    def unknown(self, frequency_hz: Array) -> Array:
        """Return the relative error (n,) of the continued response by modes of the table that nobody has seen: one at
        twice the end of the band adds (f / 2 f_end)^2, at most MOST_UNKNOWN; 0 within the band."""
        return unknown(frequency_hz, self.end_hz)

    def permitted(self, frequency_hz: Array) -> Array:
        """Return the largest gain (n,) of a feedback in V per m/s^2 whose loop is below one whatever phase the
        continued response has; infinite within the band."""
        return np.where(
            frequency_hz > self.end_hz,
            1.0 / ((1.0 + self.unknown(frequency_hz)) * self.largest(frequency_hz)),
            np.inf,
        )

    def _apparent_kg(self, s: ComplexArray, shift: float, damping: float) -> ComplexArray:
        omega = 2.0 * np.pi * (1.0 + shift) * self.frequency_hz[:, None]
        carried = 2.0 * damping * self.damping_ratio[:, None] * omega * s + omega**2
        return np.asarray(self.modal_mass_kg @ (carried / (s**2 + carried)))


def unknown(frequency_hz: Array, end_hz: float) -> Array:
    """Return the relative error (n,) by unseen modes of the table beyond the end of the identified band."""
    return np.minimum((frequency_hz / (2.0 * end_hz)) ** 2, MOST_UNKNOWN) * (frequency_hz > end_hz)


def continued_table(
    model: Model, measured: Frf, specimen: Specimen, moving_mass_kg: float, end_hz: float, shift: float = 0.0
) -> ContinuedTable:
    """Return the table continued beyond `end_hz` from its measured response.

    `specimen`: as identified; `shift`: relative uncertainty of its frequencies, at least LEAST_SHIFT counts. Where too
    few lines are good, or no drive of this kind explains them, the envelope rests on model and loudest response.
    """
    hz, ratio, mass = _fixed_base(specimen)
    good = (measured.relative_error <= MOST_LINE_ERROR) & (measured.frequency_hz >= model.band_hz[0])
    good &= measured.frequency_hz <= end_hz
    frequency = measured.frequency_hz[good]
    scatter = measured.relative_error[good]
    if len(frequency) < LEAST_LINES:
        scatter = np.zeros(5 * LEAST_LINES)
        frequency = np.geomspace(max(model.band_hz[0], 0.05 * end_hz), end_hz, 5 * LEAST_LINES)
        response = model.response(frequency)
    else:
        response = measured.response[good] - model.alias(frequency)
    upper = np.abs(response[frequency >= 0.5 * end_hz])
    loudest = float(max(upper.max(initial=0.0), np.abs(model.response(np.array([end_hz])))[0]))
    bare = ContinuedTable(
        model, np.zeros(5), moving_mass_kg, hz, ratio, mass, end_hz, max(shift, LEAST_SHIFT), np.inf, loudest
    )
    s = _s(frequency)
    inverse = hold_size(frequency, model.dt_s) / (response * np.exp(s * bare.late_s))
    columns = _columns(s, end_hz, moving_mass_kg + bare._apparent_kg(s, 0.0, 1.0)) / inverse[:, None]
    numbers = np.zeros(5)
    for kept in (np.arange(5), np.array([0, 2, 3, 4])):  # a lag below zero is one that the record does not show
        rows = np.vstack([columns[:, kept].real, columns[:, kept].imag])
        size = np.linalg.norm(rows, axis=0)
        numbers[:] = 0.0
        wanted = np.repeat([1.0, 0.0], len(frequency))
        numbers[kept] = np.linalg.lstsq(rows / size, wanted, rcond=None)[0] / size
        if numbers[1] >= 0.0:
            break
    differs = np.mean(np.abs(columns @ numbers - 1.0) ** 2 - 2.0 * scatter**2)  # scatter: real and imaginary part
    misfit = max(float(differs), 0.0) ** 0.5
    return ContinuedTable(
        model, numbers, moving_mass_kg, hz, ratio, mass, end_hz, max(shift, LEAST_SHIFT), misfit, loudest
    )


def _s(frequency_hz: Array) -> ComplexArray:
    return np.asarray(2j * np.pi * frequency_hz, dtype=complex)


def _columns(s: ComplexArray, end_hz: float, moved_kg: ComplexArray) -> ComplexArray:
    """Return what the five numbers are factors of, (n, 5)."""
    unit = s / (2.0 * np.pi * end_hz)
    return np.stack([moved_kg, unit * moved_kg, np.ones_like(s), 1.0 / unit, unit**-2.0], axis=1)


def _fixed_base(specimen: Specimen) -> tuple[Array, Array, Array]:
    """Return frequencies in Hz, damping ratios and effective modal masses in kg (n,) of a specimen on a fixed base."""
    square, shapes = eigh(specimen.K, np.diag(specimen.masses_kg))
    omega = np.sqrt(np.maximum(square, np.finfo(float).tiny))
    ratio = np.einsum("im,ij,jm->m", shapes, specimen.C, shapes) / (2.0 * omega)
    return omega / (2.0 * np.pi), ratio, (specimen.masses_kg @ shapes) ** 2
