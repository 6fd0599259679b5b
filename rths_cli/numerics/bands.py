"""Test band of a case, compared band of a table's identification, and what follows from them."""

from __future__ import annotations

from dataclasses import dataclass

TEST_BAND_HZ = 12.0  # default corner of the low pass of the errors
COMPARED_HZ = (0.7, 11.0)  # default band in which a model of the table is compared with its data


def with_test_band(usual_hz: float, test_band_hz: float) -> float:
    """Return a frequency in Hz that has a fixed ratio to the test band; `usual_hz` is its value for 12 Hz."""
    return usual_hz * (test_band_hz / TEST_BAND_HZ)


@dataclass(frozen=True)
class ComparedBand:
    """The band in which a model of the table is compared with its data and must keep its limits.

    Excitation, fits and verdict use further frequencies, each with a fixed ratio to one end of this band. A module
    states their usual values, those for 0.7 to 11 Hz.
    """

    low_hz: float = COMPARED_HZ[0]
    high_hz: float = COMPARED_HZ[1]

    @property
    def hz(self) -> tuple[float, float]:
        """Return both ends in Hz."""
        return self.low_hz, self.high_hz

    @property
    def mid_hz(self) -> tuple[float, float]:
        """Return the middle of the band in Hz, 2 to 10 Hz of the usual one, for which there is a stricter limit."""
        return self.with_low(2.0), self.with_high(10.0)

    @property
    def edges_hz(self) -> tuple[float, ...]:
        """Return the ends (7,) in Hz of the bands in which residuals and levels are compared, above this band, too."""
        return (self.low_hz, self.with_low(2.0), *(self.with_high(hz) for hz in (5.0, 11.0, 20.0, 40.0, 60.0)))

    def with_low(self, usual_hz: float) -> float:
        """Return a frequency in Hz that has a fixed ratio to the lower end; `usual_hz` is its value for 0.7 Hz."""
        return usual_hz * (self.low_hz / COMPARED_HZ[0])

    def with_high(self, usual_hz: float) -> float:
        """Return a frequency in Hz that has a fixed ratio to the upper end; `usual_hz` is its value for 11 Hz."""
        return usual_hz * (self.high_hz / COMPARED_HZ[1])

    def __str__(self) -> str:
        return f"{self.low_hz:g}-{self.high_hz:g} Hz"


USUAL = ComparedBand()
