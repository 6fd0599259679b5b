"""The sentences on a case and its runs: doubtful units, record, scale, what the design chose, refusal, sensors."""

from __future__ import annotations

from rths_cli.findings.sentence import Sentence, at, explains, notes, refuses, warns

CASE = {
    "at.place": at("{place}"),
    "units.doubt": warns(
        "{key}: [{quantity}, ]{value:.6g}[ {units}] is {ratio:.3g} times {against}[ ({others:, })], {expected:.3g}[ "
        "{units}]; usual is [{low:.3g} to {high:.3g} times][at most {at_most:.3g} times][at least {at_least:.3g} "
        "times][; {suspect} disagrees with others, too][; likely a factor of {slip}][, {would_fit:.4g} {units} would "
        "fit][, {fitting_ratio:.4g} would fit]: {question}"
    ),
    "units.unusual": warns(
        "{key}: [{quantity}, ]{value:.6g}[ {units}]; usual is [{low:.3g} to {high:.3g}][at most {at_most:.3g}]"
        "[at least {at_least:.3g}][ {units}][; {suspect} disagrees with others, too][; likely a factor of {slip}]"
        "[, {would_fit:.4g} {units} would fit][, {fitting_ratio:.4g} would fit]: {question}"
    ),
    "units.unknown_consent": warns(
        "plausible: {key} is no key of this case and permits nothing; [did you mean {near}?|name the key as the doubt "
        "names it, or leave it out]"
    ),
    "case.without_effect": warns("without effect here: {keys}"),
    "case.mode_above_test_band": warns(
        "test_band_hz: errors up to {band_hz:g} Hz leave out the building's first mode, {mode_hz:.3g} Hz; raise it, or "
        "check the units of structure.experimental.{springs}"
    ),
    "specimen.attached_stiffness": warns(
        "the specimen's identified stiffness is {identified:.4g} N/m, declared are {declared:.4g} N/m: more than "
        "{share:.0f %} apart; SIM is that of the declared one, correct structure.experimental.stiffness_n_per_m"
    ),
    "case.mode_above_compared_band": warns(
        "identification.compared_hz: the model is compared up to {band_hz:.3g} Hz, below the specimen's first mode, "
        "{mode_hz:.3g} Hz; raise it, or test_band_hz"
    ),
    "case.sensor_coupling": warns(
        "identification.sensor_dynamics: kept leaves the accelerometers' AC coupling ({corner_hz:g} Hz) in the base "
        "shear, which costs a fifth of SIM-DELAY's error on the default rig; the check does not count it; use removed"
    ),
    "record.baseline": warns(
        "record: {record} has [{shape!w}|a baseline that steps by {step_m_s2:.3g} m/s^2 at {step_s:.4g} s]; [state "
        "baseline: {mended_by} to remove it (record: {{file: {file}, baseline: {mended_by}}}), none to keep it|no "
        "straight line mends that: correct the file piece by piece, or state record.baseline: none to keep it]; first "
        "sample {first_m_s2:g} m/s^2, mean {mean_m_s2:g}, drift {drift_m_s2:g} over {duration_s:.4g} s; [the high "
        "pass of {corner_hz:g} Hz turns|without a high pass integration turns] it into {added_m:.3g (mm)} mm of "
        "ground displacement, beside {own_m:.3g (mm)} mm of its motion"
    ),
    "record.spikes": warns(
        "record: {record} has {count} {count:?spike/spikes}, the largest {accel_m_s2:.3g} m/s^2 at {at_s:.4g} s: a "
        "sample far from the line through its neighbours; correct the file"
    ),
    "record.clipped": warns(
        "record: {record} stays at its extreme of {accel_m_s2:.4g} m/s^2 for {count} samples, the first at {at_s:.4g} "
        "s: its sensor or recorder was clipped; take another record, the peaks of this one are lost"
    ),
    "record.held": warns(
        "record: {record} holds {accel_m_s2:.4g} m/s^2 for {count} samples from {at_s:.4g} s on, within its motion: "
        "samples were lost there; mend the file, or cut the record"
    ),
    "record.cut": warns(
        "record: {record} ends, at {at_s:.4g} s, with {accel_m_s2:.3g} m/s^2, {share:.0f %} of its peak: within a "
        "motion; give it to its end, or state record.baseline.taper_s"
    ),
    "scale.larger_model": warns(
        "scale.length: {length:g} makes the model larger than its prototype; factors are prototype over model, write "
        "{inverse:.4g} for a model that is smaller"
    ),
    "scale.record_above_band": warns(
        "scale: the record, compressed in time by {factor:.4g}, has {share:.0f %} of its power above the test band, "
        "{band_hz:g} Hz, where errors are not judged; raise test_band_hz if the table reaches higher, or build a "
        "larger model"
    ),
}

DESIGN = {
    "parts.no_building": notes(
        "the numerical substructure is the caller's own and declares no building: SIM, SIM-DELAY and errors are those "
        "of the case's building, and the storeys below the interface are not known (NaN)"
    ),
    "parts.own_building": notes(
        "the numerical substructure is the caller's own: SIM, SIM-DELAY and errors are those of the building that it "
        "declares[{nonlinear:-}; the storeys below the interface are not known (NaN)]"
    ),
    "assumption.compensator": notes(
        "controller: {name} is not linear; the check judges the block that it declares, which holds for small motions "
        "at most, and not the law itself"
    ),
    "assumption.adaptive": notes(
        "controller: {name} adapts {parameters!w}: {told!w}; the expected error is that of its start"
    ),
    "assumption.step_times": notes(
        "structure.numerical: an answer of the program takes {half_s:.3g ms} here, {most_s:.3g ms} at most in 99 of "
        "100, {longest_s:.3g ms} at most; {missed:.2g %} of them would miss the {stated_s:.3g ms} of the case on the "
        "clock. In simulated time each takes what the case states"
    ),
    "assumption.program": notes(
        "structure.numerical: the error budget of a run is that of the program's linear part; its total is measured"
    ),
    "assumption.laws": notes(
        "structure.numerical.law: the verdicts at rest and at tangents of the laws are indications (a loop that is "
        "stable at every frozen tangent may still diverge); the evidence is the test with the laws, simulated on the "
        "rig as identified"
    ),
    "assumption.specimen_range": notes(
        "check.specimen_range: the loop is judged at both ends of the specimen's stiffness, with the table's response "
        "as identified; a specimen that changes in the test is not simulated"
    ),
    "assumption.reaction_range": notes(
        "controller.reaction_feedforward: the loop is judged at both ends of the specimen's stiffness ({least:g} and "
        "{most:g} of the identified one), with a table that moves as the changed reaction makes it; a specimen that "
        "changes in the test is not simulated"
    ),
    "design.slower_feedback": notes(
        "controller.feedback_bandwidth_hz: {asked_hz:g} Hz asked, {designed_hz:.3g} Hz designed: the most that the "
        "identified band and max_sensitivity permit"
    ),
    "design.feedback": notes(
        "controller: the usual feedback [{of_use:-}would leave the loop without the margins that the check asks for|is "
        "of no use on this table]; chosen instead: disturbance_hz: [[{low_hz:g}, {high_hz:g}]], command_weight: "
        "{command_weight:g}, max_sensitivity: {max_sensitivity:g}; state disturbance_hz or command_weight to choose "
        "yourself"
    ),
    "design.filter": notes(
        "kalman: noise and rounding of the samples would be most of the error, so the base shear is taken from the "
        "identified specimen more than from the measured floors: q: {q:g}, residual_hz: {residual_hz:.3g}; a specimen "
        "that changes between identification and test costs more so, and the loop is judged down to 85 % of it only; "
        "state q, residual_hz or kalman.choice: stated if it may lose more"
    ),
    "friction.not_countered": notes(
        "controller.friction_compensation is off: [the identified friction removes {removed:.0f %} of what the model "
        "leaves of the low-level record, {needed:.0f %} are needed|the identification holds no low-level record on "
        "which it could be tried]"
    ),
    "reaction.not_countered": notes("controller.reaction_feedforward: automatic leaves it off: {cause}"),
    "reaction.not_shown": explains("the identified table does not show how the specimen's reaction moves it"),
    "reaction.not_safe": explains("the test would not be safe with it: {reason}"),
}

RUN = {
    "run.refused": refuses(
        "[{run} refused, ]{why}; rths check {case} with the same options tells more, --override check runs it all the "
        "same"
    ),
    "run.unsafe": explains("{verdict}: {reasons}"),
    "run.more_reasons": refuses("{count} more {count:?reason/reasons}, which a wrong unit would explain"),
    "run.overridden": warns("the check of {run} is overridden, it says {verdict}: {reasons}"),
    "sensor.drift": warns(
        "channel {channel} has an offset of {offset_v:.3g (mV)} mV and drifts by {drift_v_per_min:.3g (mV)} mV/min "
        "(+-{within_v_per_min:.2g (mV)}); taken out of its samples after the run, the loop had them"
    ),
    "sensor.jump": warns(
        "channel {channel} jumps by {jump_v:.3g (mV)} mV at {at_s:.3f} s; taken out of its samples after the run, the "
        "loop had it; check cable and connector"
    ),
    "sensor.unusable": warns(
        "channel {channel} is not usable from {from_s:.2f} s on: it shows what neither motion nor drift explains; "
        "check cable, connector and mounting"
    ),
    "run.late_answers": warns(
        "the program answered late {late} {late:?time/times}, by {latest_s:.3g ms} at most; {slow} "
        "{slow:?request was/requests were} left out and its force was extrapolated {extrapolated} "
        "{extrapolated:?time/times}"
    ),
    "run.not_as_expected": warns(
        "measured and expected error differ: {error_m_s2:.3g (mm/s^2)} mm/s^2 at storey {storey} is {ratio:.2g} "
        "times what the check expected; [{larger:-}look at the causes of the error (rths report RESULT), and for "
        "what changed since the identification: sensors, specimen, level of motion|the check was more careful than "
        "this test needed]"
    ),
}

SENTENCES: dict[str, Sentence] = {**CASE, **DESIGN, **RUN}
WORDS = {
    "offset": "an offset",
    "drifting": "a baseline that drifts",
    "no_line": "a baseline that is no line",
}
