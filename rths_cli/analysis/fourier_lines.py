"""Records, SIM and SIM-DELAY as their low Fourier lines, on which a linear loop is solved without stepping in time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rths_cli.analysis.metrics import BAND_ORDER, SLOW_ORDER, high_passed, low_lines, rms
from rths_cli.analysis.sim import state_equation
from rths_cli.control.numerical_substructure import state_space
from rths_cli.control.state_space import discretise
from rths_cli.numerics.bands import TEST_BAND_HZ, with_test_band
from rths_cli.numerics.lti import Array, ComplexArray, StateSpace
from rths_cli.structure import Building

HIGHEST_HZ = 40.0  # with a test band of 12 Hz, whose filter leaves 3e-5 there; of another band 10/3 as well
_FALLING = np.array([[1, 1, 1, 1, 1, 1], [0, 1, 2, 3, 4, 5], [0, 0, 2, 6, 12, 20]], dtype=float)  # at 1: value, slope


@dataclass(frozen=True)
class Lines:
    """Fourier lines of time series from zero frequency to the highest one that counts in the test band."""

    samples: int  # of the record
    padded: int  # samples with the padding in which vibrations decay
    dt_s: float
    high_pass_hz: float = 0.0  # errors are evaluated above this frequency
    test_band_hz: float = TEST_BAND_HZ  # and below this one

    @property
    def highest_hz(self) -> float:
        """Return the end of the lines in Hz."""
        return with_test_band(HIGHEST_HZ, self.test_band_hz)

    @property
    def count(self) -> int:
        """Return the number of lines, zero frequency included."""
        return min(int(self.highest_hz * self.padded * self.dt_s), self.padded // 2 - 1) + 1

    @property
    def frequency_hz(self) -> Array:
        """Return the lines' frequencies (m,) in Hz, the first one zero."""
        return np.arange(self.count) / (self.padded * self.dt_s)

    @property
    def z(self) -> ComplexArray:
        """Return exp(j w dt), (m,)."""
        return np.exp(2j * np.pi * self.frequency_hz * self.dt_s)

    @property
    def reduced(self) -> int:
        """Return the number of samples of a padded series at the reduced rate."""
        return 2 * self.count

    @property
    def reduced_dt_s(self) -> float:
        """Return the sample interval at the reduced rate in s."""
        return self.padded * self.dt_s / self.reduced

    def of(self, series: Array) -> ComplexArray:
        """Return the lines (..., m) of series (..., n); one that does not end at zero is faded out after its end."""
        return low_lines(series, self.count, self.padded) + series[..., -1:] * _fade(self)

    def of_motion(self, accel: Array, velocity: Array, displacement: Array) -> ComplexArray:
        """Return the lines (3, m) of a motion with acceleration, velocity and displacement (n,).

        After its end the motion comes to rest at zero. The displacement follows a quintic there, so that velocity and
        acceleration stay its derivatives.
        """
        rest = self.padded - self.samples
        lasts = 0.5 * rest * self.dt_s
        share = np.minimum(np.arange(1, rest // 2 + 1) * self.dt_s / lasts, 1.0)
        ends = np.array([displacement[-1], velocity[-1] * lasts, 0.5 * accel[-1] * lasts**2])
        back = np.linalg.solve(_FALLING[:, 3:], -_FALLING[:, :3] @ ends)
        path = np.polynomial.Polynomial(np.concatenate([ends, back]))
        after = [path.deriv(2)(share) / lasts**2, path.deriv(1)(share) / lasts, path(share)]
        whole = [np.concatenate(pair) for pair in zip((accel, velocity, displacement), after, strict=True)]
        return low_lines(np.array(whole), self.count, self.padded)

    def series(self, lines: ComplexArray, finer: int = 1) -> Array:
        """Return the series (..., n) of lines (..., m) over the record, at `finer` times the reduced rate."""
        both = np.concatenate([lines, np.zeros((*lines.shape[:-1], 1))], axis=-1)
        count = finer * self.reduced
        whole = np.fft.irfft(both, count) * (count / self.padded)
        return whole[..., : int(np.ceil(self.samples * self.dt_s / self.reduced_dt_s * finer))]

    def test_band(self) -> Array:
        """Return the gain (m,) of the test band's low pass, applied forward and backward, on each line."""
        return _test_band(self)

    def evaluated(self, lines: ComplexArray, cut_s: float = 0.0) -> Array:
        """Return errors (..., n) in the form in which they are evaluated, from lines (..., m), at the reduced rate.

        They are in the test band and above the lowest reliable frequency, over the record without the last `cut_s`.
        """
        series = self.series(lines * self.test_band())
        whole = series.shape[-1] - int(cut_s / self.reduced_dt_s)
        return high_passed(series[..., :whole], self.high_pass_hz, self.reduced_dt_s)

    def above_slow(self) -> Array:
        """Return the gain (m,) of the errors' high pass on each line."""
        from scipy.signal import butter, sosfreqz

        if self.high_pass_hz <= 0.0:
            return np.ones(self.count)
        sections = butter(SLOW_ORDER, self.high_pass_hz, "high", fs=1.0 / self.dt_s, output="sos")
        return np.asarray(np.abs(sosfreqz(sections, self.frequency_hz, fs=1.0 / self.dt_s)[1]) ** 2)


@lru_cache(maxsize=8)
def _fade(lines: Lines) -> ComplexArray:
    """Return the lines (m,) of half a cosine from one to zero, over half of the padding."""
    rest = lines.padded - lines.samples
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, rest // 2 + 1) / (0.5 * rest))
    late = lines.z ** -float(lines.samples)
    return np.asarray(low_lines(fade, lines.count, lines.padded) * late)


@lru_cache(maxsize=8)
def _test_band(lines: Lines) -> Array:
    from scipy.signal import butter, sosfreqz

    sections = butter(BAND_ORDER, lines.test_band_hz, fs=1.0 / lines.dt_s, output="sos")
    band = np.asarray(np.abs(sosfreqz(sections, lines.frequency_hz, fs=1.0 / lines.dt_s)[1]) ** 2)
    band.flags.writeable = False
    return band


def lines_for(
    samples: int, dt_s: float, ring_s: float, high_pass_hz: float = 0.0, test_band_hz: float = TEST_BAND_HZ
) -> Lines:
    """Return the lines for a record with padding of `ring_s`, at least one and at most three times its length."""
    from scipy.fft import next_fast_len

    rest = min(max(round(ring_s / dt_s), samples), 3 * samples)
    return Lines(samples, int(next_fast_len(samples + rest, real=True)), dt_s, high_pass_hz, test_band_hz)


def sim_lines(building: Building, lines: Lines, ground: ComplexArray) -> ComplexArray:
    """Return the absolute accelerations (n_storeys, m) in m/s^2 for lines (m,) of the ground acceleration (Eq. 2.1).

    A reduced frame counts with all of its degrees of freedom. The ground acceleration is linear between samples. The
    building continues to vibrate after the record, like the lines of the hybrid test. If only one of the two broke off
    there, the test band's filter would spread their difference into the record's last tenth of a second.
    """
    whole, rows = building.unreduced, building.rows_of_unreduced
    n = len(whole.M)
    a, b = state_equation(whole.M, whole.C, whole.K, whole.influence)
    block = discretise(StateSpace(a, b, a[n:][rows], np.zeros((len(rows), 1))), lines.dt_s, "foh", "sim", (), ())
    return np.asarray(block.response(lines.frequency_hz)[:, 0] * ground)


def delayed_rms(
    lines: Lines, building: Building, floors: ComplexArray, ground: ComplexArray, sim: ComplexArray, delay_s: float
) -> Array:
    """Return the RMS errors (n_storeys,) in m/s^2, test band, of a building whose base shear comes `delay_s` late.

    `floors` (1 + n, m): accelerations of table (one) and floors per table acceleration; `ground` (m,) acceleration and
    `sim` (n_storeys, m) on lines. Numerical part: Eq. 2.3, base shear: Eq. 2.6. The delay must be below the critical.
    """
    p = len(building.numerical.masses_kg)
    masses = np.concatenate([[building.interface_experimental_mass_kg], building.specimen.masses_kg])
    late = -(masses @ floors) * np.exp(-2j * np.pi * lines.frequency_hz * delay_s)  # base shear per interface's accel
    system = state_space(building.numerical)
    accels = StateSpace(system.A, system.B, system.C[2 * p :], system.D[2 * p :]).response(lines.frequency_hz)
    interface = accels[-1, 0] * ground / (1.0 - accels[-1, 1] * late)
    storeys = accels[:, 0] * ground + accels[:, 1] * late * interface
    whole = np.vstack([storeys, floors[1:] * interface])
    return rms(lines.evaluated(sim - whole))
