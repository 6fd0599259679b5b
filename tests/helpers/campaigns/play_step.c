/* Plays the exported step over recorded samples: the rest that measures the zeros, then n steps from the ramp-up on. */

#include "rths_step.h"

#include <time.h>

enum { WIDTH = 12 + RTHS_CHANNELS + RTHS_ESTIMATES };

const int64_t width = WIDTH;

static rths_state state;

static void arm(const double *rest_v)
{
  rths_inputs in = {.came = 1, .start = 1};
  rths_outputs out;
  rths_reset(&state);
  for (int c = 0; c < RTHS_CHANNELS; c++) in.samples_v[c] = rest_v[c];
  do rths_step(&state, &in, &out);
  while (out.state == RTHS_IDLE || out.state == RTHS_ARMED);
}

/* Returns the time of all steps in s. `made` (n, WIDTH) holds the signals of each. */
double play(int64_t n, const double *rest_v, const double *samples_v, const double *ground, int64_t rows,
            const int32_t *came, const int32_t *stop, double *made)
{
  struct timespec before, after;
  rths_outputs out = {.row = -1};
  arm(rest_v);
  clock_gettime(CLOCK_MONOTONIC, &before);
  for (int64_t k = 0; k < n; k++, made += WIDTH) {
    rths_inputs in = {.came = came[k], .stop = stop[k]};
    for (int c = 0; c < RTHS_CHANNELS; c++) in.samples_v[c] = samples_v[k * RTHS_CHANNELS + c];
    for (int q = 0; q < 3; q++) in.ground[q] = out.row >= 0 && out.row < rows ? ground[3 * out.row + q] : 0.0;
    rths_step(&state, &in, &out);
    made[0] = out.command_v;
    made[1] = out.base_shear_n;
    for (int q = 0; q < 3; q++) made[2 + q] = out.desired[q];
    made[5] = out.state;
    made[6] = out.reason;
    made[7] = out.channel;
    made[8] = out.seen;
    made[9] = out.lost;
    made[10] = out.row;
    made[11] = out.law_force_n[0];
    for (int c = 0; c < RTHS_CHANNELS; c++) made[12 + c] = out.corrected[c];
    for (int e = 0; e < RTHS_ESTIMATES; e++) made[12 + RTHS_CHANNELS + e] = out.estimated[e];
  }
  clock_gettime(CLOCK_MONOTONIC, &after);
  return (double)(after.tv_sec - before.tv_sec) + 1e-9 * (double)(after.tv_nsec - before.tv_nsec);
}
