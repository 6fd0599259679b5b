"""The grid of a sweep: which runs it has, in which order, and every fault of what was asked in one go."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rths_cli.case.resolve import read_settings
from rths_cli.case.yaml_reader import plain
from rths_cli.errors import InputError
from rths_cli.studies.plan import Axis, Plan
from rths_cli.studies.study_plan import Asked, read_plan


def read_grid(vary: list[str], seeds: str | None) -> Plan:
    return read_plan(Asked("el_centro_low_ff_fb", (), tuple(vary), seeds)).plan


def test_the_last_key_varies_fastest_and_every_combination_is_there() -> None:
    grid = read_grid(["scaling=0.2,0.3", "controller=FF,FF+FB,none"], "3")
    assert (grid.points, grid.variants, list(grid.seeds)) == (6, 18, [0, 1, 2])
    wanted = list(itertools.product((0.2, 0.3), ("FF", "FF+FB", "none")))
    assert [grid.values(point) for point in range(6)] == wanted
    assert [text.split() for text in grid.settings(1)] == [["scaling=0.2"], ["controller=FF+FB"]]
    assert grid.label(5) == "scaling=0.3, controller=none"


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("k=1:5:5", (1, 2, 3, 4, 5)),
        ("k=0:1:3", (0.0, 0.5, 1.0)),
        ("k=-1:-3:3", (-1, -2, -3)),
        ("k=1e-3:2e-3:2", (1e-3, 2e-3)),
        ("k=0.1:0.7:4", (0.1, 0.3, 0.5, 0.7)),
        ("k=1e-3", (0.001,)),
        ("k=a, b", ("a", "b")),
        ("k='a,b',c", ("a,b", "c")),
        ("k=[1, 2],[3, 4]", ((1, 2), (3, 4))),
        ("k={kind: FF+FB, max_sensitivity: 1.4},FF", ({"kind": "FF+FB", "max_sensitivity": 1.4}, "FF")),
        ("k=true,false", (True, False)),
        ("a.b.c=./x.csv,./y.csv", ("./x.csv", "./y.csv")),
    ],
)
def test_values_are_read_as_a_case_file_would(text: str, values: tuple[object, ...]) -> None:
    (axis,) = read_grid([text], None).axes
    assert axis.values == (pytest.approx(values, rel=1e-15) if isinstance(values[0], float) else values)
    assert [type(value) for value in axis.values] == [type(value) for value in values]


def test_a_range_ends_exactly_where_it_is_told_to() -> None:
    (axis,) = read_grid(["k=0.1:0.9:7"], None).axes
    assert (axis.values[0], axis.values[-1], len(axis.values)) == (0.1, 0.9, 7)


SCALARS = st.one_of(
    st.integers(-(10**9), 10**9),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc"))),
    st.booleans(),
)


@given(st.one_of(SCALARS, st.lists(SCALARS, max_size=3).map(tuple), st.dictionaries(st.text("abc"), SCALARS)))
def test_a_setting_of_a_point_reads_back_as_the_value(value: object) -> None:
    (setting,) = Plan(((Axis("k", (value,)),),), range(1)).settings(0)
    ((keys, node),), faults = read_settings([setting])
    assert faults == [] and keys == ("k",)
    assert plain(node) == value and type(plain(node)) is type(value)


@pytest.mark.parametrize(("seeds", "wanted"), [("1", [0]), ("4", [0, 1, 2, 3]), ("5:7", [5, 6, 7]), ("3:3", [3])])
def test_seeds(seeds: str, wanted: list[int]) -> None:
    assert list(read_grid([], seeds).seeds) == wanted


@pytest.mark.parametrize(
    ("vary", "seeds", "words"),
    [
        (["scaling"], None, "KEY=VALUE"),
        (["=3"], None, "KEY=VALUE"),
        (["a..b=3"], None, "KEY=VALUE"),
        (["scaling="], None, "value is missing"),
        (["scaling=1,,2"], None, "YAML"),
        (["scaling=null,2"], None, "value is missing"),
        (["scaling=[1"], None, "YAML"),
        (["scaling=0.3,0.30"], None, "0.3 twice"),
        (["scaling=1:2:1"], None, "count"),
        (["scaling=2:2:5"], None, "two different ends"),
        (["scaling=0:1e999:5"], None, "finite"),
        (["scaling=1,2", "scaling=3"], None, "given twice"),
        (["table=a,b", "table.physics.coulomb_n=3"], None, "table.physics.coulomb_n, which is varied too"),
        (["seed=1,2"], None, "--seeds"),
        (["runs=[sim]"], None, "EXP-RTHS alone"),
        ([], "0", "at least 1"),
        ([], "5:3", "backwards"),
        ([], "-3", "number of seeds"),
        ([], "1:2:3", "number of seeds"),
        ([], "0:9007199254740992", "largest seed"),
        (["scaling=0:1:1001"], "1000", "1001000 runs"),
        (["scale.mass=4,9"], None, "--vary scale.mass: changes no figure, for a sweep has them in model scale"),
        (["report_in=model,prototype"], None, "--vary report_in: changes no figure"),
        (["scaling=0:1:1000001"], None, "1000000"),
    ],
)
def test_what_cannot_be_a_grid_is_one_sentence(vary: list[str], seeds: str | None, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_grid(vary, seeds)
    assert len(caught.value.faults) == 1 and words in caught.value.faults[0], caught.value.faults


def test_all_faults_are_told_at_once() -> None:
    with pytest.raises(InputError) as caught:
        read_grid(["scaling=", "seed=3", "method"], "9:1")
    assert len(caught.value.faults) == 4


def test_a_million_runs_are_allowed() -> None:
    assert read_grid(["scaling=0:1:1000"], "1000").variants == 1_000_000
