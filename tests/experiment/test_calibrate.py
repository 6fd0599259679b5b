"""`rths calibrate`: from the comparison of one sensor and the weighing of one floor to a smaller error of the test."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from rths_cli import api
from rths_cli.case.load import load_cases
from rths_cli.errors import InputError
from rths_cli.experiment.real_rig_readiness import open_virtual
from rths_cli.experiment.setup import Setup, make_setup
from rths_cli.laboratory.calibrate import CalibrateRequest, CalibrationMade, Question, calibrate_rig

GAIN, WEIGHED_WRONG = (0.015, -0.008, 0.006, 0.013), (0.0005, -0.002)  # hidden; the last gain: displacement sensor
SENSOR = """\
channels:
  - {kind: displacement, position: table, unit: mm, sensitivity_v_per_unit: 0.1, range: 95,
     sensitivity_uncertainty: 0.02}
"""
RIG = f"""\
extends: aps400_virtual
sensors: {{sensitivity_uncertainty: 0.01}}
uncertainty: {{corner: 0.1, skew_s: 25e-6, mass: 0.003, drift: 0.0005}}
{SENSOR}imperfections:
  channels: {{gain_error: {list(GAIN)}}}
  masses: {{weighing_error: {list(WEIGHED_WRONG)}}}
"""
CASE = """\
structure: three_storey
damping: low
record: el_centro
scaling: 0.3
controller: FF+FB
table: bench
"""
V_PER_M_S2 = 1.0 / 9.80665
QUICK = {"identification.duration_s": 40}


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """Return a folder with a rig bench.yaml and a case quake.yaml."""
    (tmp_path / "bench.yaml").write_text(RIG)
    (tmp_path / "quake.yaml").write_text(CASE)
    return tmp_path


def asked(lab: Path, *sensitivities: str, masses: tuple[str, ...] = (), model: Path | None = None) -> CalibrateRequest:
    return CalibrateRequest(
        str(lab / "quake.yaml"),
        lab / "lab.yaml",
        model,
        sensitivities,
        masses,
        "Z. Sun",
        ("identification.model=null",),
    )


def named(lab: Path, text: str = RIG) -> Setup:
    """Return the setup of the case where the rig names the calibration."""
    (lab / "bench.yaml").write_text(f"{text}calibration: lab.yaml\n")
    return make_setup(load_cases([lab / "quake.yaml"])[0])


def truth() -> np.ndarray:
    """Return true sensitivities, those of the accelerometers first, and true masses."""
    declared = np.array([*[V_PER_M_S2] * 3, 100.0, 6.91, 6.95])
    return np.asarray(declared * (1.0 + np.array([*GAIN, *WEIGHED_WRONG])))


@pytest.mark.campaign
def test_one_comparison_and_one_weighing_calibrate_all_and_lower_the_bound(lab: Path) -> None:
    model = lab / "m.h5"
    api.identify(lab / "quake.yaml", model, settings=QUICK)
    with_model = {**QUICK, "identification.model": str(model)}
    checked = api.check(lab / "quake.yaml", settings=with_model)
    advice = next(note for note in checked.warnings if "would lower the bound of the true error" in note)
    assert advice.endswith(" takes it")
    command, option, output = advice.removesuffix(" takes it").split("rths calibrate ")[1].split(" --")
    assert command.endswith("quake.yaml") and option in {"mass floor_2=KG+-0.1%", "mass floor_3=KG+-0.1%"}
    assert output == "output FILE"
    before = checked.metrics["check.true_error_bound_m_s2"]
    compared = f"table={1e3 * 1.015 * 1.001:.2f} mV/g +- 0.2 %"  # 0.1 % off itself
    weighed = (f"floor_2={6.91 * 1.0005 * 0.9996:.5f}+-0.1%",)
    made = calibrate_rig(asked(lab, compared, masses=weighed, model=model), None)

    found, stated = (np.array([getattr(row, key) for row in made.rows]) for key in ("found", "after"))
    assert [row.name for row in made.rows] == [
        "table",
        "floor_2",
        "floor_3",
        "table_displacement",
        "floor_2",
        "floor_3",
    ]
    assert np.all(np.abs(found / truth() - 1.0) < 2.5 * stated)
    assert np.all(stated[:4] < 0.0035) and np.all(stated < [row.before for row in made.rows])

    setup = named(lab)
    assert [c.sensitivity_v_per_unit for c in setup.rig.all_channels] == pytest.approx(found[:4], rel=1e-6)
    with pytest.raises(InputError, match=r"m\.h5: identified on rig bench, .* its file or calibration has changed"):
        api.check(lab / "quake.yaml", settings=with_model)
    api.identify(lab / "quake.yaml", lab / "again.h5", settings=QUICK)
    after = api.check(lab / "quake.yaml", settings={**QUICK, "identification.model": str(lab / "again.h5")})
    assert np.all(np.asarray(after.metrics["check.true_error_bound_m_s2"]) < 0.8 * np.asarray(before))


def test_without_a_model_the_file_has_what_was_measured_and_the_rest_as_declared(lab: Path) -> None:
    made = calibrate_rig(asked(lab, "table=1020mV/g+-1%", "table_displacement = 0.1010+-0.0005 V/mm"), None)
    written = yaml.safe_load((lab / "lab.yaml").read_text())
    assert (written["rig"], written["by"], "model" in written, "masses" in written) == ("bench", "Z. Sun", False, False)
    by_name = {one["name"]: one for one in written["channels"]}
    table, sensor = by_name["table"], by_name["table_displacement"]
    half = np.exp(0.5 * np.log(1.02))  # declared and measured are as good as each other
    assert table["sensitivity_v_per_unit"] == pytest.approx(half * V_PER_M_S2, rel=1e-6)
    assert table["sensitivity_uncertainty"] == pytest.approx(0.01 / np.sqrt(2.0), rel=1e-3)
    assert sensor["declared_v_per_unit"] == pytest.approx(100.0)
    assert sensor["sensitivity_uncertainty"] == pytest.approx((0.02**-2 + (0.0005 / 0.101) ** -2) ** -0.5, rel=1e-3)
    assert by_name["floor_2"]["sensitivity_v_per_unit"] == pytest.approx(V_PER_M_S2, rel=1e-7)
    assert made.calibration.told.endswith(" by Z. Sun")


def test_a_second_calibration_counts_what_the_first_one_found(lab: Path) -> None:
    calibrate_rig(asked(lab, "table=1020mV/g+-1%", masses=("floor_2=6.91+-0.1%",)), None)
    named(lab)
    again = CalibrateRequest(str(lab / "quake.yaml"), lab / "two.yaml", None, ("table=1020mV/g+-1%",), (), "", ())
    made = calibrate_rig(again, None)
    assert made.rows[0].declared == pytest.approx(V_PER_M_S2)
    assert made.rows[0].found == pytest.approx(V_PER_M_S2 * 1.02 ** (2.0 / 3.0), rel=1e-6)
    assert made.rows[0].alone == pytest.approx(0.01 / np.sqrt(3.0), rel=1e-3)
    assert [one.floor for one in made.calibration.masses] == ["floor_2"]


def test_a_weighed_mass_that_the_structure_does_not_state_is_told_and_then_refused(lab: Path) -> None:
    made = calibrate_rig(asked(lab, masses=("floor_3=7.0+-0.007",)), None)
    assert (
        made.notes[0].startswith("state 6.99498 kg for ")
        and "floor_3 in structure three_storey, which has 6.95" in made.notes[0]
    )
    with pytest.raises(
        InputError, match=r"floor_3 weighs 6\.99498 kg .* the structure states 6\.95; correct masses_kg"
    ):
        named(lab)


def test_masses_of_another_structure_do_not_count(lab: Path) -> None:
    calibrate_rig(asked(lab, masses=("floor_2=6.916+-0.1%",)), None)
    assert named(lab).rig.uncertainty.masses
    (lab / "other.yaml").write_text("extends: three_storey\nname: other\nexperimental: {masses_kg: [5.0, 4.0]}\n")
    (lab / "quake.yaml").write_text(CASE.replace("three_storey", "other.yaml"))
    assert named(lab).rig.uncertainty.masses == ()
    again = replace(asked(lab, masses=("floor_3=4.001+-0.1%",)), output=lab / "second.yaml", settings=())
    assert calibrate_rig(again, None).notes[0].startswith("masses of three_storey in the calibration before are left")
    (lab / "other.yaml").write_text("extends: three_storey\nname: other\n")
    assert named(lab).rig.uncertainty.masses[0] < 0.002  # the same specimen under another name
    (lab / "other.yaml").write_text("extends: three_storey\nname: other\nexperimental: {masses_kg: [5.0, 4.0]}\n")
    (lab / "lab.yaml").write_text((lab / "lab.yaml").read_text().replace("specimen: three_storey\n", ""))
    with pytest.raises(InputError, match=r"floor_2 weighs 6\.9154 kg .* the structure states 5"):
        named(lab)


def test_what_a_structure_states_within_the_uncertainty_counts_as_off_by_the_difference(lab: Path) -> None:
    calibrate_rig(asked(lab, masses=("floor_2=6.916+-0.1%",)), None)
    weighed = yaml.safe_load((lab / "lab.yaml").read_text())["masses"][0]
    off = np.log(6.91 / weighed["mass_kg"])
    masses = named(lab).rig.uncertainty.masses
    assert masses == pytest.approx((np.hypot(weighed["mass_uncertainty"], off), 0.003))


WRONG = {
    "table=0.102": "state value and standard uncertainty in V per m/s^2, such as table=0.10197+-0.2%",
    "table=0.102+-0": "the standard uncertainty must be 0.0001 to 50 % of the value, got 0 %",
    "table=0.102+-1": "got 980 %",
    "table=-0.102+-1%": "must be finite and > 0 V per m/s^2; a sign belongs to the rig file (sign: -1)",
    "table=1e400+-1%": "must be finite and > 0",
    "table=0.1 V/mm+-1%": "the unit must be one of V/m/s^2, V/g, mV/m/s^2, mV/g (none: V per m/s^2)",
    "table=1 V/g+-2 mV/g": "value and uncertainty have two units; state both in one, or the uncertainty in %",
    "table=1 V/g+-2 V": "the unit must be one of",
    "table=0,102+-1%": "write a decimal point and no comma",
    "table=0.102+-0,5%": "write a decimal point and no comma",
    "table=1020+-1%": "standard uncertainties from what is known of it, 0.10197, more than 5; check value and unit",
    "tabel=0.102+-1%": "there is no 'tabel', only table, floor_2, floor_3, table_displacement",
    "=0.102+-1%": "there is no '', only table",
    f"table={'9' * 5000}": "state value and standard uncertainty in V per m/s^2",  # not searched for minutes
    f"{'t' * 5000}=1": "there is no 'tttt",
}


@pytest.mark.campaign
@pytest.mark.parametrize("text", WRONG)
def test_what_is_no_measurement_is_refused_and_nothing_is_written(lab: Path, text: str) -> None:
    with pytest.raises(InputError) as caught:
        calibrate_rig(asked(lab, text, "floor_2=0.102+-1%"), None)
    (fault,) = caught.value.faults
    assert WRONG[text] in fault and len(fault) < 700 and not (lab / "lab.yaml").exists()


def test_a_mass_has_no_sign(lab: Path) -> None:
    with pytest.raises(InputError, match=r"must be finite and > 0 kg; weigh again$"):
        calibrate_rig(asked(lab, masses=("floor_2=-6.9+-1%",)), None)


def test_faults_of_all_measurements_are_told_at_once(lab: Path) -> None:
    with pytest.raises(InputError) as caught:
        calibrate_rig(asked(lab, "table=1", "table=0.1+-1%", "table=0.1+-1%", masses=("floor_9=7+-1%",)), None)
    assert len(caught.value.faults) == 3 and "table is given before" in caught.value.faults[1]


def test_an_output_that_exists_or_has_no_folder_is_refused_before_anybody_is_asked(lab: Path) -> None:
    (lab / "lab.yaml").write_text("mine")
    with pytest.raises(InputError, match="exists; a calibration is never replaced"):
        calibrate_rig(asked(lab, "table=0.102+-1%"), Answers())
    nowhere = CalibrateRequest(str(lab / "quake.yaml"), lab / "no" / "lab.yaml", None, (), (), "", ())
    with pytest.raises(InputError, match="there is no folder"):
        calibrate_rig(nowhere, Answers())
    assert (lab / "lab.yaml").read_text() == "mine"


def test_a_name_of_two_lines_is_refused(lab: Path) -> None:
    with pytest.raises(InputError, match="--by: must be one line of at most 200"):
        calibrate_rig(CalibrateRequest(str(lab / "quake.yaml"), lab / "lab.yaml", None, (), (), "a\nb", ()), None)


def test_a_rig_that_declares_all_as_exact_is_told_what_to_state(lab: Path) -> None:
    (lab / "bench.yaml").write_text("extends: aps400_virtual\n")
    with pytest.raises(InputError, match=r"declares all sensors and masses as exact; state sensors\.sens"):
        calibrate_rig(asked(lab, "table=0.102+-1%"), None)


class Answers:
    """A person who types these answers, one after the other, and keeps the questions; beyond them Ctrl-C."""

    def __init__(self, *texts: str) -> None:
        self.questions: list[Question] = []
        self._texts: Iterator[str] = iter(texts)

    def __call__(self, question: Question) -> str:
        self.questions.append(question)
        try:
            return next(self._texts)
        except StopIteration:
            raise KeyboardInterrupt from None


def test_a_person_is_asked_for_what_was_not_given_and_again_where_the_answer_is_none(lab: Path) -> None:
    person = Answers("", "1018 mV/g", "1018 mV/g+-1%", " ", "6.91+-7", "6910+-7 g", "")
    made = calibrate_rig(asked(lab, "table=1020mV/g+-1%"), person)
    sensors = ("floor_2", "floor_3", "floor_3", "table_displacement")
    masses = ("floor_2", "floor_2", "floor_3")
    told = [*(f"sensitivity of {name}" for name in sensors), *(f"mass of {name}" for name in masses)]
    assert [question.what for question in person.questions] == told
    assert person.questions[0].declared == "0.101972 V per m/s^2 (1000 mV/g)"
    refused = [question.refused for question in person.questions]
    assert "state value and standard uncertainty" in refused[2] and "50 % of the value" in refused[5]
    assert [row.name for row in made.rows if row.measured] == ["table", "floor_3", "floor_2"]


def test_a_person_who_gives_up_leaves_no_file(lab: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        calibrate_rig(asked(lab, "table=1020mV/g+-1%"), Answers("1018 mV/g+-1%"))
    assert sorted(path.name for path in lab.iterdir()) == ["bench.yaml", "quake.yaml"]


def test_who_measured_nothing_writes_nothing(lab: Path) -> None:
    with pytest.raises(InputError, match="nothing was measured; give --sensitivity"):
        calibrate_rig(asked(lab), Answers(*[""] * 6))
    assert not (lab / "lab.yaml").exists()


def made_of(lab: Path) -> CalibrationMade:
    return calibrate_rig(asked(lab, "table=1020mV/g+-1%"), None)


def test_a_calibration_of_another_rig_or_of_other_declared_sensors_is_refused(lab: Path) -> None:
    made_of(lab)
    with pytest.raises(InputError, match=r"table\.calibration: was made when .* \(table 0\.101972, now 0\.0509858;"):
        named(lab, RIG.replace("sensors: {", "sensors: {sensitivity_mv_per_g: 500, "))
    (lab / "other.yaml").write_text("extends: bench\n")
    with pytest.raises(InputError, match=r"lab\.yaml:3:1: .*: belongs to rig bench, this one is other; calib"):
        make_setup(load_cases([lab / "quake.yaml"], [f"table={lab}/other.yaml"])[0])
    (lab / "other.yaml").write_text("extends: bench\ncalibration: null\n")
    assert make_setup(load_cases([lab / "quake.yaml"], [f"table={lab}/other.yaml"])[0]).case.table.calibration is None


def test_a_calibration_with_channels_or_floors_that_the_case_has_not_is_refused(lab: Path) -> None:
    made_of(lab)
    with pytest.raises(InputError, match=r"holds channel table_displacement, the rig has table, floor_2, floor_3;"):
        named(lab, RIG.replace(SENSOR, ""))
    text = (lab / "lab.yaml").read_text()
    (lab / "lab.yaml").write_text(f"{text}masses:\n- {{floor: floor_9, mass_kg: 7.0, mass_uncertainty: 0.001}}\n")
    with pytest.raises(InputError, match=r"holds the mass of floor_9, on the table stand floor_2, floor_3"):
        named(lab)


def test_the_file_is_found_beside_the_rig_file_and_not_beside_the_case(lab: Path) -> None:
    made_of(lab)
    named(lab)
    (lab / "below").mkdir()
    (lab / "below" / "quake.yaml").write_text(CASE.replace("bench", "../bench.yaml"))
    assert make_setup(load_cases([lab / "below" / "quake.yaml"])[0]).case.table.calibration is not None
    (lab / "bench.yaml").write_text(f"{RIG}calibration: below/lab.yaml\n")
    with pytest.raises(InputError, match=r"bench\.yaml:\d+:14: table\.calibration: no such file: .*below/lab\.yaml"):
        load_cases([lab / "quake.yaml"])


def test_the_hidden_rig_stays_as_declared(lab: Path) -> None:
    def shown(setup: Setup) -> np.ndarray:
        rig = open_virtual(setup, (1,), 0)
        rig.open()
        samples = [np.array(rig.exchange(np.array([0.5]))) for _ in range(200)]
        rig.close()
        return np.array(samples)

    before = shown(make_setup(load_cases([lab / "quake.yaml"])[0]))
    made_of(lab)
    assert np.array_equal(shown(named(lab)), before)
