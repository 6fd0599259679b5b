"""The sentences of an identification: channels, table model, specimen, calibration, delay; what changed since."""

from __future__ import annotations

from rths_cli.findings.sentence import Sentence, at, explains, notes, refuses, warns

IN_STEP = "all must be sampled at one instant, and their sensors have the stated corners"

CHANNELS = {
    "at.record": at("record {record}"),
    "channel.missing_samples": refuses(
        "channel {channel}: {missing} of {samples} samples ({share:.2f %}) are missing, the first is number {first}; a "
        "response needs them all, measure again or cut the record"
    ),
    "channel.dead": refuses(
        "channel {channel}: dead, {rms_m_s2:.2g} m/s^2 rms under excitation is less than a bit ({bit_m_s2:.2g}); check "
        "sensor, cable and power[{of_floor:-}, or a storey so soft that this floor hardly moves]"
    ),
    "channel.noise_alone": refuses(
        "channel {channel}: nothing but noise, {rest_m_s2:.2g} m/s^2 rms at rest and {rms_m_s2:.2g} under excitation; "
        "check sensor and cable[{of_floor:-}, or a storey so soft that this floor hardly moves], or take a sensor of "
        "less noise"
    ),
    "channel.impossible": refuses(
        "channel {channel}: reads {peak_m_s2:.4g} m/s^2, {ratio:.3g} times its sensor's range of {range_m_s2:.4g}, "
        "which no sensor shows; check the channel's unit and sensitivity"
    ),
    "channel.clipped": refuses(
        "channel {channel}: clipped, {peak_m_s2:.4g} m/s^2 reaches the sensor's range of {range_m_s2:.4g}; lower "
        "identification.accel_rms_m_s2"
    ),
    "channel.cut_off": refuses(
        "channel {channel}: clipped, {peaks} of its peaks are cut off at {peak_m_s2:.4g} m/s^2; check the range of "
        "amplifier and converter, or lower identification.accel_rms_m_s2"
    ),
    "channel.hum": warns(
        "channel {channel}: {hum_hz:g} Hz hum of {hum_m_s2:.2g} m/s^2 amplitude ({share:.1f %} of the excited rms); "
        "lines at the mains frequency carry little weight, check shielding and ground loops"
    ),
    "channel.loose": refuses(
        "channel {channel}: median coherence {coherence:.2f} in {band} is below {least:g}, its noise at rest and its "
        "bits would leave {by_noise:.2f}; other channels do not share it: look for a loose sensor, cable or contact"
    ),
    "channels.small_motion": refuses(
        "[channel {channel}|channels of table and floors]: median coherence {coherence:.2f} in {band} is below "
        "{least:g}; noise at rest and bits leave {by_noise:.2f}: the motion is too small for these sensors"
    ),
    "channels.disturbed": refuses(
        "[channel {channel}|channels of table and floors]: median coherence {coherence:.2f} in {band} is below "
        "{least:g}, noise at rest and bits would leave {by_noise:.2f}: the recorded command is not all that moves the "
        "table; one of friction, lost samples, a clipped command, hum, a loose part"
    ),
    "channels.skew": refuses(
        "channels: the floors are {late_samples:.2f} samples ({late_s:.3g ms}) {way} against the table; " + IN_STEP
    ),
    "channels.unexplained": refuses(
        "floors: no chain of storeys with the given masses explains the channels (what is left is {misfit:.3g} times "
        "what noise, bits and 0.3 % of unlinearity may leave), and no single fault of a channel, a mass or the floors' "
        "order does; more than one of these, a storey that yields, or a structure that is no chain"
    ),
    "channels.one_of": refuses("one of these, between which the channels do not tell: {suspects:; or }"),
    "command.reversed": refuses(
        "command: every channel moves against it; its polarity is reversed (or that of all sensors)"
    ),
    "command.not_followed": refuses(
        "channels command and {channel}: {looks!w}; table over command goes as f^{slope:.1f} in {band}, where an "
        "acceleration over a displacement's command rises as f^2"
    ),
    "suspect.sign": refuses(
        "channel {channel}: wrong sign, reversed it moves with the others as a chain of storeys does, as it is it does "
        "not; turn the sensor round or reverse the channel's sign"
    ),
    "suspect.gain": refuses(
        "channel {channel}: reads {factor:.3f} times what {by!w}; check the sensitivity[ and the unit: it reads as if "
        "its values were {looks!w}]"
    ),
    "suspect.late": refuses("channel {channel}: {late_samples:.2f} samples {way} against the others; " + IN_STEP),
    "suspect.swap": refuses(
        "channels {channels: and }: they look swapped, exchanged they fit a chain; check the cables"
    ),
    "suspect.order": refuses("channels {channels:, }: they look to be in reverse order, in which they fit a chain"),
    "suspect.mass": refuses(
        "mass of {channel}: {factor:.3f} times the given one fits a chain, the given one does not; weigh it"
    ),
}

MODEL = {
    "model.misfit": refuses(
        "table model: error |fit / FRF - 1|, {quantity} in {low_hz:g}-{high_hz:g} Hz, is {error:.2f %} beyond the "
        "data's scatter, the limit is {limit:.2f %}; {cause}"
    ),
    "model.reach": refuses("table model: fit only up to {reach_hz:.3g} Hz, {needed_hz:g} Hz are needed; {cause}"),
    "model.lag": refuses(
        "table model: a lag of {lag_s:.4g ms} at low frequency cannot be; check the sensors' high-pass corners and the "
        "timing of the channels"
    ),
    "model.unstable_poles": refuses(
        "table model: poles on or right of the imaginary axis, a table that stands is stable"
    ),
    "model.unstable_zeros": refuses(
        "table model: zeros right of the imaginary axis, the inverse is unstable; let an explicit delay stand for what "
        "they describe"
    ),
    "model.no_displacement": refuses(
        "table model: needs two zeros at the origin, because the table follows displacement"
    ),
    "model.unknown_roots": refuses(
        "table model: {roots: and } {count:?is/are} not determined by the data, which leaves the model uncertain by "
        "{error:.2g %} in {band}, the limit is {limit:.2g %}; excite longer or louder, or over a wider band"
    ),
    "model.idle_roots": warns(
        "table model: {roots: and } {count:?is/are} not determined by the data; in {band} it matters by at most "
        "{error:.2g %}, [above {known_hz:.3g} Hz the model says nothing|it matters at no frequency]"
    ),
    "model.held_out": warns(
        "table model: its held-out error is {ratio:.3g} times the data's own scatter; the table has more to it than "
        "any structure that was tried (one of: more modes, a delay shorter than declared, a loose part, lost samples, "
        "nonlinearity)"
    ),
    "model.late": warns(
        "table model: the data ask for a delay of {delay_s:.3g ms}, {declared_s:.3g ms} are declared (latency and half "
        "a sample of hold); check converters.latency_samples and the channels' timing"
    ),
    "model.undetermined_pair": warns("{root} pair at {at_hz:.3g} Hz: not determined by the data"),
    "model.far_pair": warns(
        "{root} pair at {at_hz:.3g} Hz: it resonates far above {end_hz:.3g} Hz, where nothing was measured"
    ),
    "model.cancelling_pairs": warns("poles and zeros at {at_hz:.3g} Hz cancel within their uncertainty"),
    "table.far_gain": refuses(
        "table: moves {gain_m_per_v:.3g (mm)} mm/V, {ratio:.3g} times nominal.gain_m_per_v; a unit (g for m/s^2, mV "
        "for V), the sample rate, a sensor's corner or the data sheet's gain is wrong"
    ),
    "table.gain": warns(
        "table: moves {gain_m_per_v:.3g (mm)} mm/V at low frequency, the data sheet says {declared_m_per_v:.3g (mm)}; "
        "check sensitivity and unit of table and command, or nominal.gain_m_per_v"
    ),
    "root.damping": explains("the damping of {root!w} at {at_hz:.3g} Hz"),
    "root.place": explains("{root!w} {place} the fitted band ({low_hz:.3g}-{high_hz:.3g} Hz)"),
}

LEVELS = {
    "friction.share": refuses(
        "friction: at 1/{level_ratio:.2g} of the level the table answers up to {change:.1f %} differently; without any "
        "it would differ by {without:.1f %} rms in {band} from the model, the limit is {limit:.0f %}; {remedy}"
    ),
    "friction.not_judged": warns(
        "friction: not judged; that takes noise or a multisine, and a low-level record at 2/3 of it or less"
    ),
    "friction.one_level": warns(
        "friction: not judged, the records hold one level only; give another one at a fraction of it as well"
    ),
    "level.change": refuses(
        "level: at 1/{level_ratio:.2g} of the level the table answers {change:.1f %} rms in {band} differently, the "
        "limit is {limit:.0f %}; [{causes:; or }|no single cause explains how]; {remedy}"
    ),
    "cause.level": explains("{causes:; or }; {remedy}"),
    "cause.given_model": explains("it is not a model of this table as it is now: check gain, sign, units and delay"),
    "cause.noise": explains(
        "the channels' noise makes the data scatter by {scatter:.2f %}, excite longer (identification.duration_s)"
        "[ or louder, the limits leave room for a factor of {louder:.2g}]"
    ),
    "cause.unknown": explains(
        "the data do not tell the cause; one of lost samples, a command that is clipped or not the recorded one, a "
        "wrong latency, a loose part, more modes than were tried, friction, or another nonlinearity"
    ),
    "cause.friction": explains("dry friction takes a larger share of small motions"),
    "cause.drag": explains("the table's damping grows with its motion"),
    "cause.hardening": explains("the table's suspension stiffens as its motion grows"),
    "cause.softening": explains(
        "the table's suspension softens as its motion grows, or friction holds small motions like a spring"
    ),
    "cause.compression": explains("the gain falls as the level grows, as of an amplifier or actuator near a limit"),
    "cause.dead_band": explains("the gain grows with the level, as with a dead band"),
    "cause.specimen": explains("the specimen's stiffness depends on its motion (storey {storeys:, })"),
    "remedy.friction": explains(
        "reduce the friction[, or excite louder: the limits leave room for a factor of {louder:.2g}]"
    ),
    "remedy.level": explains(
        "identify at the level of the test, a lower identification.accel_rms_m_s2 where that is less"
    ),
}

EXCITATION = {
    "excitation.whole_periods": notes(
        "excitation of {played_s:g} instead of {wanted_s:g} s: whole periods of {period_s:g} s"
    ),
    "excitation.scaled_down": notes(
        "excitation scaled down from {wanted_m_s2:g} to {allowed_m_s2:.2f} m/s^2 rms: {share:.0f %} of the {limit} "
        "limit"
    ),
    "excitation.louder_probe": notes(
        "probe played at {level_m_s2:.2g} m/s^2 rms, more than {share:.0f %} of the {wanted_m_s2:g} wanted or of what "
        "the limits allow: the converters are coarse"
    ),
    "excitation.lowered": notes(
        "excitation of the identification lowered from {wanted_m_s2:g} to {allowed_m_s2:.2f} m/s^2 rms: {bound}, "
        "{peak:.3g} {units} expected, at most {share:.0f %} of {limit:.3g} {units} is used"
    ),
    "excitation.overdriven": warns(
        "at {level_m_s2:.2g} m/s^2 rms the table no longer follows its command in proportion ({unexplained:.2f %} of "
        "its power is not explained, {in_probe:.2f %} in the probe): an actuator at a limit, perhaps; measured again "
        "at half the level"
    ),
}

VERIFICATION = {
    "verification.unusable": explains("verification: channels unusable"),
    "verification.agrees": explains(
        "verified by a low-level record: table within {change:.1f %} of the model up to {to_hz:g} Hz"
    ),
    "verification.verified": notes("{model}; {comparison}"),
    "verification.changed": refuses("{model}: {reasons}"),
    "verification.table": refuses(
        "the table answers {change:.1f %} differently from the model in {low_hz:g}-{high_hz:g} Hz; it or its specimen "
        "has changed, identify again"
    ),
    "verification.specimen": refuses(
        "specimen mode {mode} is at {now_hz:.3f} Hz with {now_damping_ratio:.2f %}, the model was made with "
        "{before_hz:.3f} Hz and {before_damping_ratio:.2f %}; it has changed, identify again"
    ),
    "model.unequal_orders": notes(
        "{file}: {zeros} zeros and {poles} poles; the inverse of method paper needs as many zeros as poles, so that "
        "method uses a model fitted to the record that judged this one"
    ),
}

SESSION = {
    "session.not_compared": warns(
        "record of this session: not compared with that of the identification, {reason}; drift is not corrected"
    ),
    "session.unexplained": warns(
        "record of this session: table and floors move otherwise than at the identification, {ratio:.3g} times as much "
        "as noise is left unexplained; the drift of sensors is not corrected, identify again"
    ),
    "session.no_gain_drift": refuses(
        "record of this session: gain of {channel} against the table's sensor changed by {change:+.2g %}, which is no "
        "drift: look at sensor and mount, identify again"
    ),
    "session.no_lag_drift": refuses(
        "record of this session: lag of {channel} after the table's channel changed by {late_s:+.0f us}, more than a "
        "sample interval: look at filters and converters, identify again"
    ),
    "session.no_alias_drift": refuses(
        "record of this session: the alias of the held command changed by {change_m_s2_per_v:+.2g} m/s^2 per V, more "
        "than any instant of sampling explains: look at the converters, identify again"
    ),
    "session.gain": notes(
        "record of this session: {channel} reads {change:+.3f (%)} +- {error:.3f %} against the table's sensor since "
        "the identification, more than uncertainty.drift allows; it is corrected"
    ),
    "session.lag": notes(
        "record of this session: {channel} lags by {late_s:+.1f (us)} +- {error_s:.1f us} against the table's channel "
        "since the identification; it is corrected"
    ),
    "session.alias": notes(
        "record of this session: converters act at other instants than at the identification, the alias of the held "
        "command has changed by {change_m_s2_per_v:+.3g} +- {error_m_s2_per_v:.2g} m/s^2 per V; it is corrected"
    ),
    "session.delay": notes(
        "record of this session: the table moves {late_s:+.0f (us)} +- {error_s:.1f us} later after its command than "
        "at the identification; the feedback counters it, the check counts what is left; identify again to have it in "
        "the feedforward"
    ),
}

LOST = {
    "run.lost_samples": warns(
        "{lost} {lost:?step/steps} lost samples, {overrun} {overrun:?step/steps} overrun"
        "[{late:-} because this computer was late], longest gap {longest_gap_s:.3g ms}; what was measured there is "
        "bridged[, in {mixed} {mixed:?step/steps} after that in part]"
    ),
}

SPECIMEN = {
    "specimen.no_chain": warns(
        "specimen: {residual:.2f %} of the floors' motion is not that of a linear chain of storeys with the given "
        "masses and modal damping; read stiffness and damping with care"
    ),
    "specimen.yields": warns(
        "specimen: at low level a chain of storeys explains the channels, at full level it does not: its stiffness or "
        "damping depends on its motion; identify at the level of the test"
    ),
    "specimen.rubs": warns(
        "specimen: a chain of storeys explains the channels if joints stick and slide in it; the model is that of the "
        "level of the identification: identify at the level of the test, or tighten the joints"
    ),
    "free_vibration.short": warns(
        "free vibration: not used; {lasting_s:.2g} s of it stand out of the channels' noise, frequencies and damping "
        "ratios take {needed_s:.2g} s"
    ),
    "free_vibration.weak": warns(
        "free vibration: too weak to be used, {residual:.1f %} of the floors' motion is not explained"
    ),
    "free_vibration.differs": warns(
        "specimen mode {mode}: excitation gives {excited_hz:.3f} Hz and {excited_damping_ratio:.2f %}, free vibration "
        "{free_hz:.3f} Hz and {free_damping_ratio:.2f %}; it is nonlinear, or the free vibration is too weak"
    ),
    "specimen.not_as_declared": warns(
        "specimen, mode {mode}: identified {quantity!w} {identified:.4g}[ {units}] differs from the declared "
        "{declared:.4g}[ {units}] by more than {share:.0f %}; SIM uses the declared one"
    ),
}

CALIBRATION = {
    "calibration.unsettled": warns(
        "calibration: the fit of sensors and masses has not settled, so that gains and masses are less certain than "
        "stated; weigh the floors and compare the sensors"
    ),
    "calibration.corners": warns(
        "calibration: the record contradicts the AC corner of channel {channels: and }, or a sensitivity or mass that "
        "is declared exact is wrong; all corners are taken as declared; state sensitivity_uncertainty of the sensors "
        "and uncertainty.mass of the rig"
    ),
    "calibration.sensors": warns(
        "calibration: the sensors differ more than their uncertainty explains (channel {channel} by {change:+.2g %} "
        "from what is declared, sensitivity_uncertainty is {declared:.2g %}); compare the sensors (rths calibrate), or "
        "state a larger uncertainty"
    ),
    "calibration.masses": warns(
        "calibration: the masses differ from what is stated by more than their uncertainty explains (floor {floor} of "
        "the specimen by {change:+.2g %}, uncertainty.mass is {declared:.2g %}); weigh the floors, with all that moves "
        "with them, or state a larger uncertainty"
    ),
    "delay.not_as_declared": warns(
        "delay: the data show {delay_s:.3f (ms)} +- {within_s:.3f ms} from command to table, {declared_s:.3f ms} are "
        "declared (latency, half a sample of hold, transport); check converters.latency_samples and the channels' "
        "timing; a flexible deck beyond the band looks the same"
    ),
}

SENTENCES: dict[str, Sentence] = {
    **CHANNELS, **MODEL, **LEVELS, **EXCITATION, **VERIFICATION, **SESSION, **LOST, **SPECIMEN, **CALIBRATION,
}  # fmt: skip
WORDS = {
    "swapped": "they look swapped",
    "no_acceleration": "one of them is a displacement, or a velocity",
    "every_floor": "every floor says",
    "others": "the other channels say",
    "in_g": "in g",
    "in_m_s2": "m/s^2 and not g",
    "pole": "a real pole",
    "zero": "a real zero",
    "pole_pair": "a pole pair",
    "zero_pair": "a zero pair",
    "natural_frequency": "natural frequency",
    "damping_ratio": "damping ratio",
}
