"""Oracles: names as laboratories write them, factors of units from their definitions."""

from pathlib import Path

import numpy as np
import pytest

from rths_cli.errors import InputError
from rths_cli.files.measured_data import Recording, choose
from rths_cli.files.measured_data.units import FACTORS, canonical_unit, is_time, role_of, time_factor, unit_of

ROLES = ("command", "table", "floor_2", "floor_3")
SAMPLES = np.arange(20.0).reshape(5, 4) + 1.0
NAMES = ("cmd (V)", "Shake table [g]", "Floor 2 accel (mg)", "floor_3_v", "spare")
UNITS = ("V", "g", "mg", "V", "")


def recording(names: tuple[str, ...] = NAMES, units: tuple[str, ...] = UNITS) -> Recording:
    return Recording(Path("made.csv"), "", 0.001, names, units, SAMPLES[: len(names)])


def faults(made: Recording, choices: dict[str, tuple[str, str]] | None = None) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        choose(made, ROLES, choices or {})
    assert all(fault.startswith("made.csv: ") and "\n" not in fault for fault in caught.value.faults)
    return tuple(fault.removeprefix("made.csv: ") for fault in caught.value.faults)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("V", "V"),
        ("v", "V"),
        ("Volts", "V"),
        ("mV", "mV"),
        ("mv", "mV"),
        ("MV", ""),
        ("m/s^2", "m/s^2"),
        ("[m/s2]", "m/s^2"),
        ("m/s²", "m/s^2"),
        ("m_s2", "m/s^2"),
        ("m s^-2", "m/s^2"),
        ("m·s⁻²", "m/s^2"),
        ("M/SEC/SEC", "m/s^2"),
        ("cm/s2", "cm/s^2"),
        ("mm/s**2", "mm/s^2"),
        ("Gal", "gal"),
        ("g", "g"),
        ("(G)", "g"),
        ("mg", "mg"),
        ("MG", ""),
        ("mG", ""),
        ("m/s", ""),
        ("kg", ""),
        ("counts", ""),
        ("", ""),
        ("g (gal)", ""),
    ],
)
def test_spellings_of_units(text: str, unit: str) -> None:
    assert canonical_unit(text) == unit


@pytest.mark.parametrize(
    ("unit", "value", "si"),
    [
        ("V", 1.0, "V"),
        ("mV", 1e-3, "V"),
        ("m/s^2", 1.0, "m/s^2"),
        ("cm/s^2", 1e-2, "m/s^2"),
        ("mm/s^2", 1e-3, "m/s^2"),
        ("gal", 1e-2, "m/s^2"),
        ("g", 9.80665, "m/s^2"),
        ("mg", 9.80665e-3, "m/s^2"),
        ("in/s^2", 0.0254, "m/s^2"),
    ],
)
def test_factors(unit: str, value: float, si: str) -> None:
    assert FACTORS[unit][0] == pytest.approx(value, rel=1e-15)
    assert FACTORS[unit][1] == si


@pytest.mark.parametrize(
    ("name", "stated", "unit", "doubt"),
    [
        ("table (g)", "", "g", ""),
        ("table_accel_m_s2", "", "m/s^2", ""),
        ("acc_mm_s2", "mm/s²", "mm/s^2", ""),
        ("command_v", "", "V", ""),
        ("Floor 2 mg", "", "mg", ""),
        ("table", "G", "g", ""),
        ("table", "", "", ""),
        ("g", "", "", ""),
        ("table_g", "V", "", "channel 'table_g': its name says g, its unit is stated as V; neither is taken"),
        ("table", "counts", "", "channel 'table': the unit 'counts' is not known"),
        ("table_g", "counts", "", "channel 'table_g': the unit 'counts' is not known"),
        ("acc(:,2)", "g", "g", ""),
    ],
)
def test_units_of_channels(name: str, stated: str, unit: str, doubt: str) -> None:
    assert unit_of(name, stated) == (unit, doubt)


@pytest.mark.parametrize(
    ("role", "names"),
    [
        ("command", ["cmd", "Command (V)", "drive", "u", "U_v", "Drive signal [mV]", "command_v"]),
        (
            "table",
            [
                "table",
                "base",
                "Shake table (g)",
                "shake_table_accel",
                "TABLE ACC",
                "tableAccel",
                "table_abs_accel_m_s2",
            ],
        ),
        (
            "floor_2",
            ["floor_2", "Floor 2 accel (g)", "floor2", "FLOOR-02", "Floor2Acceleration", "storey 2", "story_2_g"],
        ),
        ("floor_12", ["floor 12"]),
    ],
)
def test_names_that_speak_of_a_role(role: str, names: list[str]) -> None:
    assert [role_of(name) for name in names] == [role] * len(names)


@pytest.mark.parametrize("name", ["desired table accel", "table disp", "table velocity", "floor", "commanded", "2"])
def test_names_that_speak_of_none(name: str) -> None:
    assert role_of(name) not in ("command", "table", "floor_2")


def test_names_of_time() -> None:
    assert all(
        map(is_time, ["t", "Time", "time_s", "Time (sec)", "TIME [ms]", "time stamp", "X_Value", "elapsed_time_s"])
    )
    assert not any(map(is_time, ["table", "u", "time delay", "ts", "temperature", "T (degC)", "T [°C]"]))
    assert [time_factor(*pair) for pair in [("t", ""), ("time_ms", ""), ("t (us)", ""), ("t", "h"), ("t", "ms")]] == [
        1.0,
        1e-3,
        1e-6,
        None,
        1e-3,
    ]


def test_roles_are_found_and_converted() -> None:
    chosen = choose(recording(), ROLES, {})
    np.testing.assert_array_equal(chosen.command_v, [1, 2, 3, 4])
    np.testing.assert_allclose(chosen.accel[0], np.array([5, 6, 7, 8]) * 9.80665, rtol=1e-15)
    np.testing.assert_allclose(chosen.accel[1], np.array([9, 10, 11, 12]) * 9.80665e-3, rtol=1e-15)
    np.testing.assert_array_equal(chosen.accel[2], [13, 14, 15, 16])
    assert chosen.units == ("m/s^2", "m/s^2", "V")
    assert (chosen.command_name, *chosen.names) == NAMES[:4]
    assert chosen.notes[1] == "table: channel 'Shake table [g]', read in g"


@pytest.mark.parametrize("name", ["spare", "SPARE", "spare (gal)"])
def test_the_users_choice_comes_first(name: str) -> None:
    chosen = choose(recording(), ROLES, {"table": (name, "gal")})
    np.testing.assert_allclose(chosen.accel[0], np.array([17, 18, 19, 20]) * 0.01, rtol=1e-15)
    assert chosen.names[0] == "spare"


def test_an_equal_unit_in_another_spelling_agrees() -> None:
    made = recording(units=("V", "gal", "mg", "V", ""))
    assert choose(made, ROLES, {"table": ("Shake table [g]", "cm/s^2")}).units[0] == "m/s^2"


def test_a_command_in_millivolts() -> None:
    chosen = choose(recording(units=("mV", "g", "mg", "V", "")), ROLES, {})
    np.testing.assert_allclose(chosen.command_v, np.array([1, 2, 3, 4]) / 1000, rtol=1e-15)


TABLE = "table: channel "


@pytest.mark.parametrize(
    ("names", "units", "choices", "expected"),
    [
        (("u", "a", *NAMES[2:4]), UNITS[:4], {}, "table: no channel has such a name; the file has u, a, Floor 2"),
        (
            ("u", "base", "table", *NAMES[2:4]),
            ("V", "g", *UNITS[1:4]),
            {},
            "table: the names of 2 channels fit: base, table",
        ),
        (
            NAMES,
            UNITS,
            {"table": ("spare", "")},
            TABLE + "'spare': its unit is missing or unknown; give --channel 'table=spare:g'",
        ),
        (NAMES, UNITS, {"table": ("spare", "feet")}, TABLE + "'spare': 'feet' is not one of the units V, mV"),
        (NAMES, UNITS, {"table": ("Shake table", "V")}, TABLE + "'Shake table [g]': the file states the unit g, --ch"),
        (NAMES, UNITS, {"table": ("absent", "g")}, "table: there is no channel 'absent'; the file has cmd (V), Shake"),
        (NAMES, UNITS, {"roof": ("spare", "g")}, "--channel roof=...: there is no such role; roles are command, table"),
        (NAMES, UNITS, {"table": ("cmd (V)", "")}, "channel 'cmd (V)' is taken for command and table; give"),
        (NAMES, ("g", *UNITS[1:]), {}, "command: channel 'cmd (V)': a command is in V or mV, not g"),
        (
            ("u", "A", "a", *NAMES[2:4]),
            ("V", "g", *UNITS[1:4]),
            {"table": ("a (V)", "")},
            "table: 'a (V)' names 2 channels",
        ),
    ],
)
def test_each_fault_is_one_sentence(
    names: tuple[str, ...], units: tuple[str, ...], choices: dict[str, tuple[str, str]], expected: str
) -> None:
    found = faults(recording(names, units), choices)
    assert len(found) == 1
    assert found[0].startswith(expected)


def test_all_faults_come_at_once_and_list_a_dozen_names() -> None:
    names = tuple(f"channel {k}" for k in range(15))
    made = Recording(Path("made.csv"), "", 0.001, names, ("",) * 15, np.ones((15, 3)))
    found = faults(made)
    assert [fault.partition(":")[0] for fault in found] == list(ROLES)
    assert "channel 11 and 3 more; give --channel command=NAME" in found[0]


def test_what_no_channel_shows_is_missing(recwarn: pytest.WarningsRecorder) -> None:
    """Damaged bytes make vast numbers and signalling NaN: arithmetic with either prints a warning of numpy."""
    samples = SAMPLES.copy()
    samples[1, 2], samples[1, 3] = 1e308, np.array([0x7FF0000000000001], np.uint64).view(float)[0]
    chosen = choose(Recording(Path("made.csv"), "", 0.001, NAMES, UNITS, samples), ROLES, {"floor_3": ("spare", "g")})
    assert np.isfinite(chosen.command_v).all()
    assert np.isnan(chosen.accel[0]).tolist() == [False, False, True, True]
    assert not recwarn.list
