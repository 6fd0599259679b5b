"""A table in another compared band: the same samples taken as a faster table give the same model, only faster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_records import Excited, excite, make_info, make_specimen

from rths_cli.errors import InputError
from rths_cli.identification import excitation
from rths_cli.identification.excitation import ExcitationSettings, plan
from rths_cli.identification.identify import identify
from rths_cli.identification.inputs import IdentificationSettings
from rths_cli.identification.record_parts import Record
from rths_cli.identification.results import FitError, Identification
from rths_cli.identification.verdict import LIMITS, judge
from rths_cli.numerics.bands import ComparedBand

FASTER = 2.5
BAND = ComparedBand(0.7 * FASTER, 11.0 * FASTER)
SETTINGS = IdentificationSettings(
    band_hz=(0.5 * FASTER, 60.0 * FASTER),
    paper_band_hz=(0.5 * FASTER, 12.0 * FASTER),
    segment_s=20.0 / FASTER,
    compared=BAND,
    excited_hz=0.5 * FASTER,
)


@pytest.fixture(scope="module")
def excited() -> Excited:
    return excite(make_specimen(), 1, coulomb_n=0.0)


@pytest.fixture(scope="module")
def both(excited: Excited) -> tuple[Identification, Identification]:
    """Return the identification of a record, and that of the same samples at FASTER times the rate."""
    quiet = Record(0.2 * excited.command_v, 0.2 * excited.corrected, excited.plan.parts)
    info = excited.info
    channels = tuple(
        replace(each, high_pass_hz=FASTER * each.high_pass_hz, low_pass_hz=FASTER * each.low_pass_hz)
        for each in info.channels
    )
    faster = replace(info, dt_s=info.dt_s / FASTER, channels=channels, gain_m_per_v=info.gain_m_per_v / FASTER**2)
    given = ([excited.record], excited.specimen.masses_kg)
    usual = identify(given[0], info, given[1], IdentificationSettings(), quiet)
    return usual, identify(given[0], faster, given[1], SETTINGS, quiet)


@pytest.mark.campaign
def test_the_model_is_the_same_only_faster(both: tuple[Identification, Identification]) -> None:
    usual, fast = both
    for one, other in ((usual.best, fast.best), (usual.paper, fast.paper)):
        assert other.poles == pytest.approx(FASTER * one.poles, rel=1e-6)
        assert other.zeros == pytest.approx(FASTER * one.zeros, rel=1e-6)
    assert [each.name for each in fast.candidates] == [each.name for each in usual.candidates]


@pytest.mark.campaign
def test_it_is_judged_in_the_compared_band(both: tuple[Identification, Identification]) -> None:
    usual, fast = both
    assert usual.accepted and fast.accepted and fast.compared == BAND
    for one, other in ((usual.best_error, fast.best_error), (usual.paper_error, fast.paper_error)):
        assert (other.rms, other.largest, other.rms_mid) == pytest.approx((one.rms, one.largest, one.rms_mid), rel=1e-6)
    assert fast.verdict.feedforward_hz == pytest.approx([FASTER * hz for hz in usual.verdict.feedforward_hz])
    assert [each.coherence for each in fast.channels] == pytest.approx([each.coherence for each in usual.channels])
    for several in ("residuals", "levels"):
        pairs = list(zip(getattr(usual, several), getattr(fast, several), strict=True))
        assert len(pairs) >= 6
        for one, other in pairs:
            assert (other.low_hz, other.high_hz) == pytest.approx((FASTER * one.low_hz, FASTER * one.high_hz))


def test_a_single_line_off_in_the_compared_band_ends_the_use_of_a_model(
    both: tuple[Identification, Identification],
) -> None:
    """In the usual band nothing is needed at 20 Hz, and single lines are not judged there."""
    fast = both[1]
    frf, line = fast.frfs[0], int(np.abs(fast.frfs[0].frequency_hz - 20.0).argmin())
    response = fast.best.sampled_response(frf.frequency_hz)
    response[line] *= 1.1
    off = replace(frf, response=response, relative_error=np.full(len(response), 1e-3))
    for band, told in ((BAND, "fit only up to 19.8 Hz, 27.5 Hz are needed"), (ComparedBand(), "")):
        found = judge(fast.best, FitError(0.0, 0.0, 0.0), off, LIMITS, [], compared=band)
        assert found.accepted == (not told) and told in "; ".join(found.reasons)


def test_the_excitation_follows_the_band() -> None:
    """The spectrum is flat to the band's start and turns at 12/11 of its end; the bands of the settings follow."""
    f = np.array([0.5, 1.75, 3.5, 30.0, 60.0, 15.0])
    shape = excitation.amplitude(f, BAND)
    assert shape[:2] == pytest.approx(1.0) and shape[2] == pytest.approx(2.0**-1.5)
    assert shape[4] / shape[3] == pytest.approx(2.0**-3.5) and shape[3] / shape[5] == pytest.approx(2.0**-1.5)
    info = make_info(make_specimen())
    settings = ExcitationSettings(40.0, 2.0, 0.75, 150.0, compared=BAND)
    made = plan(info, settings, 0)
    power = np.abs(np.fft.rfft(made.command_v[made.parts.noise])) ** 2
    lines = np.fft.rfftfreq(len(made.command_v[made.parts.noise]), info.dt_s)
    inside = power[(lines > 0.8) & (lines < 1.7)].mean(), power[(lines > 3.2) & (lines < 3.8)].mean()
    assert inside[1] / inside[0] == pytest.approx(2.0**-3, rel=0.3)
    with pytest.raises(InputError) as refused:
        plan(info, replace(settings, low_hz=0.3 / 5.0, high_hz=50.0), 0)
    assert "between 0.125 and 2.5 Hz to identify the table in 1.75-27.5 Hz" in refused.value.faults[0]
    assert "must be between 60 Hz and 400 Hz" in refused.value.faults[1]
