"""Bands of a case that follow its test band, and test bands that cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest

from rths_cli.case.case_schema import Case
from rths_cli.case.load import load_cases, resolved_yaml
from rths_cli.errors import InputError

CASE = "el_centro_low_ff_fb"


def case_of(*settings: str) -> Case:
    return load_cases([CASE], settings)[0]


def test_the_usual_band_is_the_default() -> None:
    stated, unstated = case_of("test_band_hz=12"), case_of()
    about = ("yaml_text", "stated", "places")
    assert stated == unstated.model_copy(update={key: getattr(stated, key) for key in about})
    options = unstated.identification
    assert (unstated.test_band_hz, options.compared_hz) == (12.0, (0.7, 11.0))
    assert (options.low_hz, options.high_hz, unstated.kalman.residual_hz) == (0.3, 60.0, 40.0)


def test_the_other_bands_follow_where_they_are_not_stated(tmp_path: Path) -> None:
    case = case_of("test_band_hz=30", "identification.seed=3")
    options = case.identification
    assert options.compared_hz == pytest.approx((1.75, 27.5)) and options.seed == 3
    assert (options.low_hz, options.high_hz, case.kalman.residual_hz) == pytest.approx((0.75, 150.0, 100.0))
    own = case_of("test_band_hz=30", "identification.compared_hz=[0.7, 27]", "kalman.residual_hz=50")
    assert own.identification.compared_hz == (0.7, 27.0) and own.kalman.residual_hz == 50.0
    assert own.identification.high_hz == pytest.approx(150.0)
    (tmp_path / "again.yaml").write_text(resolved_yaml(case))
    assert load_cases([tmp_path / "again.yaml"])[0].identification == options


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (("test_band_hz=100",), "must be <= 80, because a table is identified up to 5 times the test band"),
        (("test_band_hz=1000",), "must be <= 80"),
        (("test_band_hz=1500",), "must be >= 2 and <= 1000"),
        (("test_band_hz=0",), "must be >= 2 and <= 1000"),
        (("test_band_hz=.nan",), "must be a finite number"),
        (("test_band_hz=wide",), "must be a number"),
        (("test_band_hz=600", "sample_rate_hz=1000", "identification.high_hz=100"), "must be < 500, half the sample"),
        (("identification.compared_hz=[11, 0.7]",), "three octaves or more, its lower end first, got 11 to 0.7 Hz"),
        (("identification.compared_hz=[2, 12]",), "three octaves or more"),
        (("identification.compared_hz=[2]",), "must be the two ends of a band in Hz, such as [0.7, 11], got 1 entries"),
        (("identification.compared_hz=[2, 1200]",), "must be < 1000, half the sample rate, got 1200"),
    ],
)
def test_a_band_that_cannot_be_is_refused_in_one_sentence(settings: tuple[str, ...], told: str) -> None:
    with pytest.raises(InputError) as refused:
        case_of(*settings)
    (fault,) = refused.value.faults
    assert told in fault and refused.value.exit_code == 2
