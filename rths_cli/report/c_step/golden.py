"""golden.c: inputs of 2,000 steps and what the compiled step of rths made of them, and a main that compares.

Two tests of 1,000 steps each, from the first row of the record on, after a rest and a ramp-up of constant samples. The
first one loses samples and is stopped by its operator; in the second one, the strongest part of the record, the
table's channel saturates. Samples are those that the identified rig shows (DesignedStep.rehearsals), played open loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rths_cli.experiment.designed_step import REHEARSED, DesignedStep, Rehearsal
from rths_cli.loop.recorded_steps import Conducted, Recorded, conduct_over
from rths_cli.numerics.lti import Array
from rths_cli.report.c_step.numbers import numbers

STEPS = REHEARSED  # of each of the two tests
REST_V = 1e-3  # zero of a channel, as a fraction of its range
LOST = (200, *range(300, 303), *range(500, 502))  # instants of the first test without samples
STOP_AT = 850
SATURATED_AT = 900  # of the second test
TOLERATED = 1e-10  # of each signal's peak
SIGNALS = ("command_v", "base_shear_n", "desired_accel_m_s2")


@dataclass(frozen=True)
class Golden:
    """One test: what reached the step from the first row of the record on, and what it made of it."""

    given: Recorded
    made: Conducted
    first: int  # instant of the first row


def golden_tests(step: DesignedStep) -> tuple[Golden, Golden]:
    """Return the two tests of a designed step."""
    return _conducted(step, *_stopped(step)), _conducted(step, *_shaken(step))


def _rest_v(step: DesignedStep) -> Array:
    return np.array([REST_V * min(one.range_v, step.info.converters.range_v) for one in step.info.all_channels])


def _taken(rehearsal: Rehearsal) -> tuple[Array, Array]:
    """Return STEPS rows of ground and samples, zeros behind the end of a rehearsal."""
    lacking = STEPS - len(rehearsal.ground)
    ground, samples = (np.pad(one, ((0, lacking), (0, 0))) for one in (rehearsal.ground, rehearsal.shown_v))
    return ground, samples


def _stopped(step: DesignedStep) -> tuple[Array, Array, Array, Array]:
    ground, samples = _taken(step.rehearsals[0])
    came, stop = np.ones(STEPS, dtype=bool), np.zeros(STEPS, dtype=bool)
    came[list(LOST[: 1 + step.info.limits.lost_samples])] = False
    stop[STOP_AT:] = True
    return ground, samples, came, stop


def _shaken(step: DesignedStep) -> tuple[Array, Array, Array, Array]:
    ground, samples = _taken(step.rehearsals[1])
    samples[SATURATED_AT:, step.blocks.interface.channels[0]] = step.info.converters.range_v
    return ground, samples, np.ones(STEPS, dtype=bool), np.zeros(STEPS, dtype=bool)


def _conducted(step: DesignedStep, ground: Array, samples: Array, came: Array, stop: Array) -> Golden:
    """Return a test that begins with the rest and the ramp-up of constant samples."""
    first, rest_v = step.still_steps + step.ramp_steps, _rest_v(step)
    signs = np.array([one.sign for one in step.info.all_channels])
    whole = np.vstack([np.tile(rest_v, (first, 1)), rest_v + signs * samples])
    before = np.zeros(first, dtype=bool)
    rows = np.zeros((len(step.drive), 3))  # the record is over where it is in C
    rows[: min(STEPS, len(rows))] = ground[: len(rows)]
    given = Recorded(
        whole, np.concatenate([~before, came]), np.concatenate([before, stop]), rows, step.still_steps,
        step.ramp_steps, rest_v,
    )  # fmt: skip
    return Golden(given, conduct_over(step.info, step.blocks, step.limits, given), first)


def golden_text(step: DesignedStep, tests: tuple[Golden, Golden]) -> str:
    """Return golden.c."""
    one = tests[0]
    peaks = numbers(
        max(float(np.nanmax(np.abs(values))) for values in pair) for pair in zip(*map(_made, tests), strict=True)
    )
    rows = ",\n".join(_rows(test) for test in tests)
    ended = ", ".join(f"{{{test.made.reason}, {test.made.channel}}}" for test in tests)
    text = PROGRAM.replace("@STEPS@", str(STEPS)).replace("@TOLERATED@", repr(TOLERATED))
    text = text.replace("@REST@", numbers(one.given.zeros_v)).replace("@PEAKS@", peaks)
    return text.replace("@ENDED@", ended).replace("@ROWS@", rows)


def _made(test: Golden) -> tuple[Array, Array, Array]:
    log, rows = test.made.log, slice(test.first, None)
    return log.command_v[rows], log.base_shear_n[rows], log.desired[0, rows]


def _rows(test: Golden) -> str:
    given, made, state = test.given, _made(test), test.made.log.state.astype(int)
    lines = []
    for i in range(STEPS):
        k = test.first + i
        ground = given.ground[i] if i < len(given.ground) else np.zeros(3)
        flags = f"{int(given.came[k])}, {int(given.stop[k])}, {state[k]}"
        outputs = numbers(np.nan_to_num(values[i]) for values in made)
        lines.append(f"  {{{{{numbers(given.samples_v[k])}}}, {{{numbers(ground)}}}, {flags}, {{{outputs}}}}}")
    return "{\n" + ",\n".join(lines) + "}"


PROGRAM = """\
/* Compares the step in C with what rths made of the same inputs: two tests of @STEPS@ steps, with lost samples, a stop
   by the operator and a saturated channel. Exit code 0: they agree. */

#include "rths_step.h"

#include <math.h>
#include <stdio.h>

enum { STEPS = @STEPS@, TESTS = 2, SIGNALS = 3 };
static const double TOLERATED = @TOLERATED@; /* of each signal's peak */

typedef struct {
  double samples_v[RTHS_CHANNELS], ground[3];
  int came, stop;
  int32_t state;
  double made[SIGNALS]; /* command in V, base shear in N, desired acceleration in m/s^2 */
} golden_step;

static const double rest_v[RTHS_CHANNELS] = {@REST@};
static const double peaks[SIGNALS] = {@PEAKS@};
static const int32_t ended[TESTS][2] = {@ENDED@}; /* reason and channel */
static const golden_step golden[TESTS][STEPS] = {@ROWS@};

/* Arm and ramp up with constant samples, until the record begins. */
static void begin(rths_state *s, rths_outputs *out)
{
  rths_inputs in = {.came = 1, .start = 1};
  rths_reset(s);
  for (int c = 0; c < RTHS_CHANNELS; c++) in.samples_v[c] = rest_v[c];
  do rths_step(s, &in, out);
  while (out->row < 0 && out->state != RTHS_STOPPED);
}

static double largest(double a, double b) { return b > a || isnan(b) ? b : a; }

int main(void)
{
  static rths_state state;
  double apart[SIGNALS] = {0.0, 0.0, 0.0};
  int other_states = 0, other_ends = 0;
  for (int test = 0; test < TESTS; test++) {
    rths_outputs out;
    begin(&state, &out);
    for (int k = 0; k < STEPS; k++) {
      const golden_step *now = &golden[test][k];
      rths_inputs in = {.came = now->came, .start = 0, .stop = now->stop};
      for (int c = 0; c < RTHS_CHANNELS; c++) in.samples_v[c] = now->samples_v[c];
      for (int q = 0; q < 3; q++) in.ground[q] = now->ground[q];
      rths_step(&state, &in, &out);
      const double made[SIGNALS] = {out.command_v, out.base_shear_n, out.desired[0]};
      other_states += out.state != now->state;
      if (out.state == RTHS_STOPPED) continue; /* the step rests then */
      for (int i = 0; i < SIGNALS; i++) apart[i] = largest(apart[i], fabs(made[i] - now->made[i]) / peaks[i]);
    }
    other_ends += out.reason != ended[test][0] || out.channel != ended[test][1];
  }
  printf("%s, case %.12s, model %.12s, by %s\\n", rths_data.case_name, rths_data.case_sha256, rths_data.model_sha256,
         rths_data.made_by);
  printf("%d steps: command %.1e, base shear %.1e, desired acceleration %.1e of their peaks apart\\n", TESTS * STEPS,
         apart[0], apart[1], apart[2]);
  printf("%d steps in another state, %d tests that ended otherwise\\n", other_states, other_ends);
  for (int i = 0; i < SIGNALS; i++)
    if (!(apart[i] <= TOLERATED)) return 1;
  return other_states + other_ends > 0;
}
"""
