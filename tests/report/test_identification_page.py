"""The page of an identification, read back and compared with what it was made from; and its document."""

import json
import math
import re
from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_up_identification import ABOUT, MODEL, NAN, PAPER, identification, specimen

from rths_cli.experiment.identify_command import About
from rths_cli.findings import stated
from rths_cli.identification.results import Candidate, ChannelReport, LevelBand, LevelCauses, Verdict
from rths_cli.identification.verdict import agree, roots_given
from rths_cli.report.identification_page import as_document, page, rejected_document, rejected_page
from rths_cli.report.numbers import significant, with_uncertainty

SECTIONS = [
    "verdict", "Identification", "data", "channels", "table model", "fit error", "roots, best", "residual, best",
    "amplitude dependence", "specimen", "mode shapes", "warning",
]  # fmt: skip


def section(text, name):
    """Return the lines of a section."""
    lines = text.splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(name))
    end = next((i for i, line in enumerate(lines[start:], start) if not line), len(lines))
    return lines[start:end]


def cells(text, name, heading):
    """Return the table below a heading of a section, as rows of texts."""
    lines = section(text, name)
    start = next(i for i, line in enumerate(lines) if line.strip().startswith(heading))
    return [re.split(r"\s{2,}", line.strip()) for line in lines[start + 1 :] if not line.startswith(" " * 10)]


def close(text, value, digits=3):
    """Tell whether a text is a value rounded to so many digits."""
    return abs(float(text) - value) <= 0.5001 * 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)


def spread(text, value, standard):
    """Tell whether a text is value +- two standard uncertainties, both to the second digit of the latter."""
    shown, uncertainty = text.split(" +- ")
    exponent = math.floor(math.log10(2.0 * standard)) - 1
    assert Decimal(uncertainty).as_tuple().exponent == Decimal(shown).as_tuple().exponent == min(exponent, 0)
    half = 0.5001 * 10.0**exponent
    return abs(float(shown) - value) <= half and abs(float(uncertainty) - 2.0 * standard) <= half


def test_the_page_answers_in_the_order_of_the_questions_after_the_verdict():
    text = page(identification(warnings=("channel floor_2: 50 Hz hum",)), ABOUT)
    starts = [line for line in text.splitlines() if line and not line.startswith(" ")]
    found = [name for line in starts for name in SECTIONS if line.startswith(name)]
    assert found == SECTIONS
    assert text.endswith("warning                 channel floor_2: 50 Hz hum\n")
    assert section(text, "verdict") == [
        "verdict                 accepted: fit for feedforward from 0.7 to 58.7 Hz, transport delay 0.75 ms,",
        "                        lag 14.5 ms at low frequency",
        "Identification of the virtual table aps400_virtual, from its channels only",
        "data                    " + ABOUT.source,
        "excitation              noise, 0.3-55 Hz, 2 m/s^2 rms",
        "model file              table.h5, 3 days old",
    ]


def test_channels():
    table, floor_2, floor_3 = cells(page(identification(), ABOUT), "channels", "channel ")
    assert table == ["table", "2.11", "7.64", "below a bit", "0.99987", "none"]
    assert floor_2 == ["floor_2", "2.88", "10.7", "0.00308", "0.99761", "0.0217 at 50 Hz"]
    assert floor_3 == ["floor_3", "3.62", "13.5", "-", "0.99834", "none"]


def test_structure_delay_lag_gain_and_fit_errors():
    found = identification()
    text = page(found, ABOUT)
    tried = cells(text, "table model", "structure")
    assert tried[0][:3] == ["no lag", "6", "4"] and close(tried[0][3], 10.979) and len(tried[0]) == 4
    assert tried[1][:3] == ["one lag", "7", "4"] and close(tried[1][3], 0.935) and tried[1][4] == "chosen"
    rest = "\n".join(section(text, "table model"))
    low_hz = 1e-3
    gain = abs(MODEL.response(np.array([low_hz]))[0]) / (2.0 * np.pi * low_hz) ** 2
    assert re.search(r"transport delay +0\.75 ms", rest) and re.search(r"lag, low frequency +14\.5 ms", rest)
    assert close(re.search(r"gain, low frequency +(\S+) mm/V", rest)[1], 1e3 * gain, 4)
    assert re.search(r"keeps its limits +0\.7 to 58\.7 Hz \(1 % rms, 3 % largest, beyond the data's scatter\)", rest)
    rows = cells(text, "fit error", "model")
    for row, model, error in zip(rows, (MODEL, PAPER), (found.best_error, found.paper_error), strict=True):
        assert row[1:3] == [str(len(model.poles)), str(len(model.zeros))]
        assert [float(value) for value in row[3].split("-")] == list(model.band_hz)
        wanted = (error.rms, error.largest, error.rms_mid)
        assert all(close(value, 100.0 * share) for value, share in zip(row[4:], wanted, strict=True))


def test_roots_with_what_is_known_of_them():
    pair, real, unknown = cells(page(identification(), ABOUT), "roots, best", "frequency (Hz)")
    assert pair[0] == "pole" and spread(pair[1], 3.14936, 0.00025) and spread(pair[2], 4.48, 0.0078)
    assert real[0] == "pole" and spread(real[1], 16.388, 0.0062) and real[2] == "real"
    assert unknown == ["zero", "3.2001 +- -", "4.3000 +- -"]


def test_residual_by_band():
    found = identification()
    rows = cells(page(found, ABOUT), "residual, best", "band")
    for row, band in zip(rows, found.residuals, strict=True):
        assert [float(value) for value in row[0].split("-")] == [band.low_hz, band.high_hz]
        assert all(close(t, 100 * v) for t, v in zip(row[1:4], (band.rms, band.largest, band.scatter), strict=True))
        assert float(row[4]) == band.coherence


def test_amplitude_dependence():
    found = identification()
    text = page(found, ABOUT)
    for row, level in zip(cells(text, "amplitude", "band"), found.levels, strict=True):
        size, phase = abs(level.ratio), math.atan2(level.ratio.imag, level.ratio.real)
        centre = math.sqrt(level.low_hz * level.high_hz)
        assert spread(row[1], 100.0 * (size - 1.0), 100.0 * level.error)
        assert spread(row[2], math.degrees(phase), math.degrees(level.error / size))
        assert spread(row[3], -1e3 * phase / (2 * math.pi * centre), 1e3 * level.error / size / (2 * math.pi * centre))
        assert phase < 0.0 and float(row[3].split()[0]) > 0.0, "a table that follows later has a positive delay"
    assert not re.search("amplitude dependence", page(identification(levels=()), ABOUT))


@pytest.mark.parametrize(
    ("ratio", "causes", "sentence"),
    [
        (0.97 - 0.02j, ("friction",), "differs by up to 3.61 % (2-5 Hz): dry friction takes a larger share of small"),
        (1.03 - 0.01j, ("hardening",), "differs by up to 3.16 % (2-5 Hz): the table's suspension stiffens as its"),
        (1.0 - 0.02j, (), "differs by up to 2.00 % (2-5 Hz): no single cause"),
        (1.0005 - 0.0005j, ("friction",), "no difference beyond the scatter"),
    ],
)
def test_what_amplitude_dependence_means(ratio, causes, sentence):
    """Bands above 11 Hz do not decide, and a difference within three standard errors is none."""
    levels = (LevelBand(2.0, 5.0, ratio, 0.001), LevelBand(20.0, 40.0, 0.5 + 0.0j, 0.001))
    text = " ".join(page(identification(levels=levels, causes=LevelCauses(causes)), ABOUT).split())
    assert sentence in text


def test_specimen_by_excitation_and_by_free_vibration():
    found = identification()
    rows = cells(page(found, ABOUT), "specimen", "excitation")
    for column, fit in ((1, found.specimen), (3, found.free_vibration)):
        for mode in range(2):
            frequency, damping = rows[2 * mode], rows[2 * mode + 1]
            assert spread(frequency[column], fit.natural_frequency_hz[mode], fit.frequency_error_hz[mode])
            assert spread(damping[column], 100.0 * fit.damping_ratio[mode], 100.0 * fit.damping_error[mode])
            assert close(frequency[column + 1], fit.frequency_scatter_hz[mode], 2)
            assert close(damping[column + 1], 100.0 * fit.damping_scatter[mode], 2)
        for floor in range(2):
            at = 1 + column // 2
            value, error = fit.stiffness_n_per_m[floor], fit.stiffness_error_n_per_m[floor]
            shown, uncertainty = (float(text) for text in rows[4 + floor][at].split(" +- "))
            step = 10.0 ** (math.floor(math.log10(2.0 * error)) - 1)
            assert abs(shown - value) <= 0.5001 * step and abs(uncertainty - 2.0 * error) <= 0.5001 * step
            assert close(rows[6 + floor][at], fit.dashpots_n_s_per_m[floor], 4)
        assert close(rows[8][1 + column // 2], 100.0 * fit.residual)
    verdicts = [rows[2 * mode][5] for mode in range(2)]
    assert verdicts == ["yes" if agree(found.specimen, found.free_vibration, mode) else "no" for mode in range(2)]
    assert sorted(verdicts) == ["no", "yes"]


def test_mode_shapes():
    free = replace(specimen(), mode_shapes=np.array([[0.6151, 1.0], [1.0, -0.6255]]))
    text = page(identification(free_vibration=free), ABOUT)
    assert cells(text, "mode shapes", "mode 1") == [["floor_2", "0.6191", "1.0000"], ["floor_3", "1.0000", "-0.6155"]]
    assert "differs by 0.010 at most" in " ".join(text.split())


def test_a_rejection_gives_each_reason_a_line_of_its_own():
    text = page(identification(reasons=("rms is 2 %", "zeros on the right")), ABOUT)
    lines = ["verdict                 rejected: rms is 2 %", " " * 24 + "rejected: zeros on the right"]
    assert text.splitlines()[:2] == lines
    assert "accepted" not in text


def test_data_that_allow_no_model():
    channels = (ChannelReport("table", 0.0, 0.0, None, NAN), ChannelReport("floor_2", 2.9, 11.3, 0.003, 0.99))
    text = rejected_page(channels, ("channel table: dead, check the cable", "channel floor_2: clipped"), ABOUT)
    assert cells(text, "channels", "channel ")[0] == ["table", "0.00", "0.00", "-", "-", "none"]
    assert text.splitlines()[:2] == [
        "verdict                 rejected: channel table: dead, check the cable",
        " " * 24 + "rejected: channel floor_2: clipped",
    ]
    document = json.loads(json.dumps(rejected_document(channels, (stated("a"), stated("b")), ABOUT), allow_nan=False))
    assert document["accepted"] is False and document["reasons"] == ["a", "b"]
    assert document["channels"][0]["coherence"] is None and document["channels"][1]["rms_m_s2"] == 2.9


def unknown():
    """Return an identification of which as little is known as can be."""
    fit = specimen()
    nothing = np.full(2, NAN)
    fit = replace(fit, frequency_error_hz=nothing, damping_error=nothing, stiffness_error_n_per_m=nothing,
                  frequency_scatter_hz=nothing, damping_scatter=nothing, residual=NAN)  # fmt: skip
    return identification(
        specimen=fit,
        free_vibration=None,
        levels=(LevelBand(2.0, 5.0, complex(NAN, NAN), NAN),),
        candidates=(Candidate("one lag", 7, 4, NAN, chosen=True),),
        roots=roots_given(MODEL),
        channels=(ChannelReport("table", 2.0, 7.0, None, NAN), *identification().channels[1:]),
        verdict=Verdict(False, (0.0, 0.0), 0.00075, NAN, (stated("too short"),), ()),
    )


def test_what_is_not_known_is_a_dash_and_never_nan():
    text = page(unknown(), ABOUT)
    assert not re.search(r"\b(nan|None|inf)\b", text)
    assert cells(text, "specimen", "excitation")[0] == ["mode 1 (Hz)", "3.2000 +- -", "-", "-", "-", "-"]
    assert "keeps its limits      nowhere" in text
    assert cells(text, "roots, best", "frequency (Hz)")[-1] == ["zero", "3.2020 +- -", "4.3243 +- -"]
    document = json.loads(json.dumps(as_document(unknown(), ABOUT), allow_nan=False))
    assert document["specimen"]["frequency_error_hz"] == [None, None] and document["free_vibration"] is None
    assert document["candidates"][0]["held_out"] is None and document["agree"] is None


def test_a_rig_without_floors_and_a_model_brought_along():
    found = identification()
    bare = identification(
        frfs=found.frfs[:1], channels=found.channels[:1], specimen=None, free_vibration=None, candidates=()
    )
    text = page(bare, ABOUT)
    assert "specimen                none" in text and "structure             as given" in text
    assert "mode shapes" not in text


@pytest.mark.parametrize("name", ["floor_2", "a channel whose name somebody thought about for a long time", "x" * 150])
def test_no_line_is_wider_than_a_hundred_columns(name):
    channels = tuple(replace(channel, name=f"{name}{i}") for i, channel in enumerate(identification().channels))
    about = About("r" * 120, "virtual", "a source " * 30, (("label", "text " * 50), ("l" * 40, "y" * 130)))
    found = identification(channels=channels, reasons=("because " * 40,), warnings=("note " * 60,))
    for text in (page(found, about), page(unknown(), about), rejected_page(channels, ("why " * 60,), about)):
        assert max(len(line) for line in text.splitlines()) <= 100


def test_five_storeys_fit_the_page():
    shape = np.arange(25.0).reshape(5, 5) / 25.0 - 0.5
    fit = replace(
        specimen(),
        natural_frequency_hz=np.array([12.1, 14.2, 16.3, 18.4, 19.5]),
        mode_shapes=shape,
        **{name: np.full(5, 0.0123456) for name in ("damping_ratio", "damping_error", "damping_scatter")},
        **{name: np.full(5, 0.000123456) for name in ("frequency_error_hz", "frequency_scatter_hz")},
        **{name: np.full(5, 98765.4) for name in ("stiffness_n_per_m", "dashpots_n_s_per_m")},
        stiffness_error_n_per_m=np.full(5, 1.23),
    )
    channels = tuple(ChannelReport(f"floor_{i}", 1.0, 2.0, None, 0.99) for i in range(6))
    text = page(identification(specimen=fit, free_vibration=fit, channels=channels), ABOUT)
    rows = cells(text, "specimen", "excitation")
    assert len(rows) == 21 and {len(row) for row in rows[:10:2]} == {6}, "no row of the table is broken"
    shapes = cells(text, "mode shapes", "mode 1")
    assert [[float(value) for value in row[1:]] for row in shapes] == shape.round(4).tolist()


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e3))
def test_value_and_uncertainty_are_rounded_alike(value, standard):
    shown, uncertainty = with_uncertainty(value, standard).split(" +- ")
    places = [len(text.partition(".")[2]) for text in (shown, uncertainty)]
    step = 10.0 ** (math.floor(math.log10(2.0 * standard)) - 1)
    assert places[0] == places[1]
    assert abs(float(shown) - value) <= 5.001 * max(step, 1e-7)
    assert abs(float(uncertainty) - 2.0 * standard) <= 0.5001 * max(step, 1e-6)
    assert float(uncertainty) > 0.0 and len(uncertainty.replace(".", "").strip("0")) <= 2


def test_spelling_of_numbers():
    assert [significant(v) for v in (0.0, 0.000123, 1.0, 123.456, -4.5678, NAN)] == [
        "0.00", "0.000123", "1.00", "123", "-4.57", "-",
    ]  # fmt: skip
    assert with_uncertainty(3.2, 0.000065) == "3.20000 +- 0.00013"
    assert with_uncertainty(9.999, 0.0499) == "10.00 +- 0.10"
    assert with_uncertainty(7376.42, 131.0) == "7380 +- 260"
    assert with_uncertainty(3.2, 0.0) == "3.200000 +- <0.000001"
    assert with_uncertainty(0.043, 0.0001, 100.0) == "4.300 +- 0.020"
    assert with_uncertainty(NAN, 1.0) == "-"


def test_the_document_holds_every_number_of_the_page():
    found = identification(warnings=("w",))
    document = json.loads(json.dumps(as_document(found, ABOUT), allow_nan=False))
    assert document["accepted"] is True and document["reasons"] == [] and document["warnings"] == ["w"]
    assert document["verdict"]["feedforward_hz"] == [0.7, 58.7] and document["verdict"]["lag_s"] == 0.0145
    assert document["rig"] == "aps400_virtual" and document["rig_kind"] == "virtual"
    assert document["about"][1] == {"label": "model file", "text": "table.h5, 3 days old"}
    for name, model, error in (("best", MODEL, found.best_error), ("paper", PAPER, found.paper_error)):
        assert [complex(*root) for root in document[name]["poles"]] == model.poles.tolist()
        assert [complex(*root) for root in document[name]["zeros"]] == model.zeros.tolist()
        assert document[name]["gain"] == model.gain and document[name]["delay_s"] == model.delay_s
        assert document[name]["ripple_m_s2_per_v"] == model.ripple_m_s2_per_v
        assert document[name]["fit_error_rms"] == error.rms and document[name]["fit_error_max"] == error.largest
        assert document[name]["fit_error_mid"] == error.rms_mid
    assert document["agree"] == [True, False]
    assert document["roots"][1] == {
        "kind": "pole", "frequency_hz": 16.388, "damping_ratio": None, "frequency_error_hz": 0.0062,
        "damping_error": None, "determined": True,
    }  # fmt: skip
    vague = (replace(found.roots[0], damping_error=found.roots[0].damping_ratio), *found.roots[1:])
    told = as_document(replace(found, roots=vague), ABOUT)["roots"]
    assert [root["determined"] for root in told] == [False, True, True]
    assert document["residuals"][1]["scatter"] == 0.00094 and document["candidates"][1]["chosen"] is True
    level = document["levels"][0]
    assert complex(level["ratio_real"], level["ratio_imag"]) == found.levels[0].ratio
    assert level["late_s"] == pytest.approx(0.0213 / (2 * np.pi * np.sqrt(0.7 * 2.0)))
    for key, fit in (("specimen", found.specimen), ("free_vibration", found.free_vibration)):
        for name in set(document[key]) - {"masses_kg"}:
            assert document[key][name] == np.asarray(getattr(fit, name)).tolist()
