"""The sentences of the check: the loop, the table's limits, the record, the true error, the guard's limits in a run."""

from __future__ import annotations

from rths_cli.findings.sentence import Sentence, at, notes, refuses

PLACES = {
    "at.run": at("{run}"),
    "at.samples": at("in {count} of {of} {of:?sample/samples} of the identified model[ (the {quoted} is told)]"),
    "at.specimen": at("with the specimen at {stiffness_ratio:.3g %} of its stiffness"),
    "at.tangent": at("with {tangent}[ (and {more} more)]"),
}

LOOP = {
    "loop.unstable": refuses(
        "the sampled closed loop is unstable: its spectral radius is {spectral_radius:.6f}, motions grow by a factor "
        "{growth:.3g} over the record; {advice}"
    ),
    "loop.measured_response": refuses(
        "the table's measured response differs so much from its model that the model's stability says nothing of the "
        "table's; {advice}"
    ),
    "loop.table_error": refuses(
        "[with {gain:.3g} times the table's gain ]the loop tolerates only {tolerated:.2f %} error of the table at "
        "{at_hz:.3g} Hz, {required:.2f %} is required; {advice}"
    ),
    "loop.beyond_the_band": refuses(
        "beyond the identified band masses and specimen move the table otherwise than its model does, and the loop is "
        "unstable there; {advice}"
    ),
    "loop.feedback_beyond_the_band": refuses(
        "the feedback by itself tolerates only {tolerated:.3g %} error of the table at {at_hz:.3g} Hz, beyond the "
        "identified band, {required:.3g %} is required; lower feedback_bandwidth_hz, use controller FF, or identify "
        "[to {needed_hz:g} Hz|to a higher frequency] (identification.high_hz)"
    ),
    "loop.delay": refuses(
        "the loop tolerates only {tolerated_s:.3g ms} of further delay, {required_s:.3g ms} are required; {advice}"
    ),
    "loop.adaptive_point": refuses(
        "the law adapts, and within the bounds of its parameters the loop is unstable: its spectral radius is "
        "{spectral_radius:.6f} at {point!w}; narrow the bounds in its options"
    ),
    "loop.adaptive_switching": refuses(
        "the law adapts, and with parameters that move within their bounds at their largest rate the simulated loop "
        "is unstable (free motions grow {growth:.3g} times); narrow the bounds or lower the rates in its options"
    ),
    "loop.transition": refuses(
        "structure.numerical.rate_hz: asked at this rate, the program leaves the mode at {mode_hz:.3g} Hz {left:.2f %} "
        "damping of {own:.2f %} ({where!w}); raise rate_hz, or lower compute_time_s if the program answers sooner"
    ),
    "loop.simulated_stop": refuses(
        "the test simulated on the identified rig does not reach its end: at {at_s:.3f} s {stopped_by}"
    ),
    "loop.simulated_error": refuses(
        "in the test simulated on the identified rig storey {storey} is {error:.0%} of its own motion away from SIM, "
        "{permitted:.0%} are permitted; lower scaling, or choose another controller"
    ),
}

TABLE = {
    "table.limit": refuses(
        "{quantity!w}: {peak:.4g} {units} is predicted, the limit is {limit:.4g} {units}[ ({key})] and a tenth of it "
        "is kept in reserve[; {fixed:.3g} {units} of it {cause!w}: {advice}]"
        "[; the largest safe scaling is {largest_scaling:g}]"
    ),
}

RECORD = {
    "record.above_the_check": refuses(
        "{share:.0f %} of the interface floor's peak acceleration lies above {highest_hz:g} Hz, where the check does "
        "not look; filter the record, or soften the computed storeys that shake there"
    ),
    "record.beyond_by_baseline": refuses(
        "with this baseline the record exceeds the limit of {quantities!w: and }; check again without it"
    ),
}

MODEL = {
    "model.rejected": refuses("identified model rejected: {reasons}; {advice}"),
}

TRUE_ERROR = {
    "true_error.bound": notes(
        "true error: with 95 % below {bound:.2g %} of {reference!w} (storey {storey}), below {median:.2g %} with 50 %, "
        "{calibration:.2g %} by sensors and masses as far as the identification did not calibrate them"
        "[, {pitch:.2g %} by pitch of the specimen's base]"
    ),
    "true_error.compare_sensor": notes(
        "a comparison of the sensor of {channel} to {to:.2g %} would lower the bound of the true error from "
        "{bound:.2g (%)} to {lowered:.2g %} of {reference!w} (storey {storey}): rths calibrate {case} --sensitivity "
        "{channel}=VALUE+-{to:.2g (%)}% --output FILE takes it"
    ),
    "true_error.weigh_floor": notes(
        "weighing {channel} to {to:.2g %} would lower the bound of the true error from {bound:.2g (%)} to "
        "{lowered:.2g %} of {reference!w} (storey {storey}): rths calibrate {case} --mass {channel}=KG+-{to:.2g (%)}% "
        "--output FILE takes it"
    ),
}

GUARD = {
    "guard.unplanned": notes(
        "nothing is known of its motion before it moves, its guard has the limits of the rig file"
    ),
    "guard.not_predicted": notes("the guard's limits are set to {source}"),
    "guard.idle_limits": notes("limits of the rig file that cannot trip in it, because its own are lower: {limits:, }"),
}

SENTENCES: dict[str, Sentence] = {**PLACES, **LOOP, **TABLE, **RECORD, **MODEL, **TRUE_ERROR, **GUARD}
WORDS = {
    "displacement_m": "displacement (with room to brake)",
    "velocity_m_s": "velocity",
    "acceleration_m_s2": "acceleration",
    "sensor_m_s2": "accelerometers' range",
    "force_n": "actuator force",
    "command_v": "command",
    "rounding": "by noise and rounding of samples and command, from one sample to the next",
    "zeros": "because a channel's zero is known to a part of a bit only",
    "sim_delay_error": "SIM-DELAY's error",
    "sim_rms": "SIM's RMS",
}

ADVICE = {
    "another_controller": "choose another controller",
    "more_damping": "more damping",
    "less_mass": "less mass on the table",
    "add_damping": "add damping",
    "damp_structure": "add damping to the structure",
    "damp_structure_or_cut_higher": "add damping to the structure or cut the building higher up",
    "cut_higher": "cut the building higher up",
    "use_ff": "use controller FF",
    "use_ff_fb": "use FF+FB",
    "lower_bandwidth": "lower feedback_bandwidth_hz",
    "put_less_mass": "put less of the interface floor's mass on the table",
    "identify_again": "identify again",
    "identify_higher": "identify to a higher frequency",
    "identify_higher_hz": "identify to a higher frequency (identification.high_hz)",
    "finer_converters": "use converters with more bits or a smaller range",
    "slower_feedback": "a slower feedback",
    "controller_ff": "controller FF",
    "improve_or_override": "improve the identification, or add --override model",
}
"""The clauses of advice by code; several are joined as `a, b, or c`."""
