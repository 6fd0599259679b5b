"""Section of the identified table: measured and modelled frequency response as a chart, numbers as tables."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rths_cli.files.result_reader import Result, read_series
from rths_cli.numerics.lti import Array, ComplexArray, Model
from rths_cli.report.numbers import percent, rounded, significant
from rths_cli.report.page.decimated_series import pack_floats
from rths_cli.report.page.html import Html, element, join, table
from rths_cli.report.page.summary import facts

GROUP = "identification"


def response(result: Result) -> dict[str, str] | None:
    """Return measured and modelled response of the table for JSON: Hz, m/s²/V, degrees; None if none is stored."""
    if GROUP not in result.groups:
        return None
    frequency = _read(result, "frequency_hz")
    measured = _read(result, "frf_real") + 1j * _read(result, "frf_imag")
    modelled = model(result).sampled_response(frequency)
    phase, of_model = phases(measured, modelled)
    series = {
        "frequency": frequency,
        "measured": np.abs(measured),
        "modelled": np.abs(modelled),
        "phase": phase,
        "modelled_phase": of_model,
        "coherence": _read(result, "coherence"),
    }
    return {name: pack_floats(values) for name, values in series.items()}


def phases(measured: ComplexArray, modelled: ComplexArray) -> tuple[Array, Array]:
    """Return the phases (n,) in degrees: the model's unwrapped, the measured one nearest to it."""
    unwrapped = np.unwrap(np.angle(modelled))
    unwrapped += 2.0 * np.pi * (unwrapped[:1] < -0.5 * np.pi)  # near 0 Hz an acceleration is 180 deg before its cause
    return np.degrees(unwrapped + np.angle(measured / modelled)), np.degrees(unwrapped)


def model(result: Result) -> Model:
    """Return the table model that the controllers of a result used."""
    return Model(
        zeros=_read(result, "zeros_real") + 1j * _read(result, "zeros_imag"),
        poles=_read(result, "poles_real") + 1j * _read(result, "poles_imag"),
        gain=_number(result, "gain"),
        delay_s=_number(result, "delay_s"),
        band_hz=(0.0, 0.0),
        ripple_m_s2_per_v=_number(result, "ripple_m_s2_per_v"),
        latency_samples=facts(result).latency_samples,
        dt_s=1.0 / result.sample_rate_hz,
        coupling_hz=_number(result, "coupling_hz"),
    )


def identification(result: Result) -> Html:
    """Return tables of the identification: fit, delay, specimen, roots; "" without an identification."""
    if GROUP not in result.groups:
        return Html("")
    return join([table([["Identified", "value"]], _numbers(result)), table([_ROOT_HEAD], _roots(result), "figures")])


_ROOT_HEAD = ["Root of the table model", "frequency (Hz)", "damping ratio (%)"]


def _numbers(result: Result) -> Iterator[list[str]]:
    used = model(result)
    yield ["source of the model", str(result.attributes.get("model_source") or "-")]
    yield ["poles, zeros", f"{len(used.poles)}, {len(used.zeros)}"]
    yield ["gain at low frequency", f"{significant(1e3 * used.low_frequency_gain_m_per_v, 4)} mm/V"]
    yield ["delay told to the fit", f"{rounded(1e3 * used.delay_s)} ms"]
    errors = [percent(_number(result, f"fit_error_{kind}")) for kind in ("rms", "max")]
    yield [f"|fit / FRF - 1|, {result.compared}", f"RMS {errors[0]} %, largest {errors[1]} %"]
    ratios = _read(result, "damping_ratio")
    for mode, (hz, ratio) in enumerate(zip(_read(result, "natural_frequency_hz"), ratios, strict=True), 1):
        yield [f"specimen, mode {mode}", f"{significant(hz, 4)} Hz, damping {percent(ratio)} %"]


def _roots(result: Result) -> Iterator[list[str]]:
    """Yield a row for each root or pair of roots that is not at the origin."""
    used = model(result)
    for kind, roots in (("pole", used.poles), ("zero", used.zeros)):
        for root in sorted((r for r in roots if r.imag >= 0.0 and abs(r) > 1e-9), key=abs):
            real = "real" if root.imag == 0.0 else percent(-root.real / abs(root))
            yield [f"{kind}{'' if root.imag == 0.0 else ' pair'}", significant(abs(root) / (2.0 * np.pi), 4), real]


def heading(virtual: bool) -> Html:
    """Return the heading of the plots."""
    what = "Identified virtual table" if virtual else "Identified table"
    return element("h3", f"{what}: frequency response and model")


def _read(result: Result, name: str) -> Array:
    return np.asarray(read_series(result.path, f"{GROUP}/{name}"), dtype=float)


def _number(result: Result, name: str) -> float:
    return float(_read(result, name))
