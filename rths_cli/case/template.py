"""The case file that `rths new` writes."""

from __future__ import annotations

CASE_TEMPLATE = """\
# A hybrid simulation: five keys name the experiment, everything below them has a default.
# A value is a name that is looked up (beside this file, in configs/ or records/, among the shipped files),
# a path relative to this file, or a mapping. Units stand in the names of the keys.

structure: three_storey        # shear building, cut into numerical and experimental storeys
damping: low                   # a level the structure defines, or {first_mode_ratio: 0.026}
record: el_centro              # or {file: my_record.csv, unit: g, dt_s: 0.01}
scaling: 0.30                  # factor on the record
controller: FF+FB              # FF, FF+FB or none (the table as delivered)

# Remove the "# " in front of a line to change a default.

# table: aps400_virtual          # a rig; {extends: aps400_virtual, physics: {coulomb_n: 0.9}} varies one
# method: best                   # or paper: the control of the paper, as printed
# integration: exact             # of the numerical storeys: exact, cr (Chen-Ricles) or newmark (explicit)
# runs: [sim, sim-delay, shake-table, exp-rths]
# scale: {length: 2.4, acceleration: 1}   # prototype over model: the record is the prototype's and is compressed
# report_in: model               # or prototype: how reports print the building's response, where there is a scale
# sample_rate_hz: 2000
# delay_s: 0.005                 # the delay of sim-delay
# test_band_hz: 12               # errors are judged below it; the identified and checked bands follow
# record_filter: {corner_hz: 0.25, order: 2}   # causal Butterworth high pass; corner_hz: 0 switches it off
# identification: {seed: 0, duration_s: 120, accel_rms_m_s2: 2.0}
# kalman: {q: 1e3, r: 1.0}
# limits: {stroke_m: 0.07}       # may only be stricter than the rig's
# seed: 0                        # of the noise in the runs
# accept: {"exp_rths.rms_error_m_s2[3]": 0.06}   # the command returns 1 when a figure is above its limit
# check: {specimen_range: [0.7, 1.0]}   # stiffness of the specimen over the identified one, judged at both ends
# session_record: automatic      # always or never: the identification's quiet record once more before the table runs
# shear_from: accelerations      # or load_cell, or both, where the rig has one under the specimen
# base_shear_uncertainty: 0.01   # of accelerometers and weighed masses, for the residual drift of storeys with laws
# grade_limits: {good_percent: 2, good_ratio: 0.1, usable_percent: 5}   # bound in % of SIM; over SIM-DELAY
# plausible: [scaling]            # keys whose doubted numbers are right
# reference: zhang2015           # published figures to print beside ours
# notes: what this case is for
"""


def case_template() -> str:
    """Return the text of a commented case file that loads as it is."""
    return CASE_TEMPLATE
