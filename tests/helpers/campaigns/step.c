/* One EXP-RTHS on the virtual table in C: what rths_cli/loop/simulated_time_run.py run_virtual does, block by block, on its arrays.

   The structures mirror the NamedTuples of Python field by field (step_in_c.py hands them over). Sizes are known at run
   time only, as there. */

#include <math.h>
#include <stdint.h>
#include <time.h>

#define INLINE static inline __attribute__((always_inline))

typedef double v4 __attribute__((vector_size(32), aligned(8)));
typedef struct { double *at; int64_t shape[4]; } Array;
typedef struct { int64_t *at; int64_t shape[4]; } Integers;

enum { AXES = 1, ACTUATORS = 1 }; /* degrees of freedom of the interface and commands, known when the step is compiled, as there */

typedef struct { Array matrix, given, made; int64_t states; } Linear;
typedef struct { Array matrix, given; } Channels;
typedef struct { Array matrix, given, made; int64_t states, floors; } OpenLoop; /* given and made twice, row by row */
typedef struct { Linear block; Array corrected, estimated; int64_t axes[AXES], floors; } KalmanFilter;
typedef struct { Array turn, drive, outputs, through, direct, state, made, logged; int64_t axes[AXES]; } Modal;
typedef struct { Linear block; Array logged; int64_t axes[AXES], actuators[ACTUATORS]; double friction_v, per_scale, linear_s_per_m, lead_s; } LinearFeedforward;
typedef struct { Linear block; Array shortfall, logged; int64_t axes[AXES], actuators[ACTUATORS]; } LinearFeedback;
typedef struct {
  int64_t source;
  Array state;
  int64_t deciding;
  Channels correction;
  KalmanFilter observer;
  Modal numerical;
  LinearFeedforward feedforward;
  LinearFeedback feedback;
  OpenLoop open_loop;
  Array force_recent, force_returned;
  int64_t commanded;
  int64_t measured_by[AXES], actuators[ACTUATORS];
  Array recent, recent_commanded, samples, corrected, accel, estimated, force, free_accel, motion, error, command, forward, back, back_limits;
  Array command_limit_v, feedback_limit_v, carried;
  double bit_v, bits_per_v, ripple_m_s2_per_v, ripple_sum_m_s2_per_v;
  Array sent;
  int64_t logged;
  Array expected;
  int64_t accelerometers, cell;
  Array cell_reads;
} Step;

typedef struct { Integers duty; Array saturation_v, abort, tolerated, reads; } FurtherLimits; /* none here */
typedef struct {
  double stroke_m, velocity_m_s, acceleration_m_s2, force_n, command_v, tracking_error, gain_m_per_v, dt_s;
  Array force_weights, saturation_v, stuck, abort;
  double command_rate_v_s, energy_ratio, energy_floor_j;
  FurtherLimits further;
  double reach_m, deviation_m;
} GuardLimits;
typedef struct { Integers flags; Array motion, codes, expected_at, moved; Integers same; Array slip, energy, seen; int64_t actuators[ACTUATORS], axes[AXES]; Array compared; } GuardState;

typedef struct { int64_t storeys; } NoLaws;
typedef struct { Array states, friction, accelerations, range, noise_rms, v_per_unit; } FurtherOutputs; /* none here */
typedef struct {
  Array push, filters, nodes, feed, start, accel_rows, accel_friction;
  double steps_cubed, bend, reference_per_velocity;
  int64_t mechanical, forces, has_low_pass;
  double dt_s, per_friction_velocity, force_limit_n, stroke_m, command_range_v, command_step_v, command_steps_per_v;
  double sensor_range_m_s2, sensor_v_per_m_s2, sensor_range_v, sensor_step_v, sensor_steps_per_v, noise_rms_m_s2;
  int64_t refine;
  NoLaws laws;
  FurtherOutputs further;
} Plant;
typedef struct { Array state, state_tiles, low, coupled, made, made_tiles, begin, offsets, queue, middle_velocity; Integers fault; Array law_memory, law_free, further; } PlantState;

typedef struct { Array columns; Integers done; int64_t truths, lean; } Log;

enum { EXCITATION, RECORD, NUMERICAL };
enum { STAMPED = 16 }; /* steps per look at the time */
enum { RUNNING, BRAKING, RETURNING, STOPPED };
enum { NONE, STROKE, VELOCITY, ACCELERATION, FORCE, COMMAND, TRACKING, NOT_A_NUMBER, SATURATED, STUCK, RATE, ENERGY, PLANNED_REACH = 24, DEVIATION };

/* in the order of step_in_c.py: a change of a NamedTuple must not go unseen */
const int64_t sizes[] = {sizeof(Plant), sizeof(PlantState), sizeof(Step), sizeof(GuardLimits), sizeof(GuardState), sizeof(Log)};

INLINE double least(double a, double b) { return a < b ? a : b; }
INLINE double most(double a, double b) { return a > b ? a : b; }
INLINE double within(double value, double bound) { return least(most(value, -bound), bound); }

/* made = matrix @ given, tiles of four rows (count, stride, 4), their first columns only */
INLINE void product(const double *restrict tiles, int64_t count, int64_t stride, int64_t columns,
                    const double *restrict given, double *restrict made) {
  for (int64_t t = 0; t < count; t++) {
    const double *tile = tiles + 4 * stride * t;
    v4 a = {0, 0, 0, 0}, b = a;
    int64_t j = 0;
    for (; j + 2 <= columns; j += 2) {
      a += *(const v4 *)(tile + 4 * j) * given[j];
      b += *(const v4 *)(tile + 4 * j + 4) * given[j + 1];
    }
    if (j < columns) a += *(const v4 *)(tile + 4 * j) * given[j];
    *(v4 *)(made + 4 * t) = a + b;
  }
}

/* ---- the step ---- */

INLINE void apply(const Linear *b) {
  product(b->matrix.at, b->matrix.shape[0], b->matrix.shape[1], b->given.shape[0], b->given.at, b->made.at);
  for (int64_t i = 0; i < b->states; i++) b->given.at[i] = b->made.at[i];
}

INLINE void sense(const Step *s) {
  const int64_t channels = s->samples.shape[0];
  for (int64_t c = 0; c < channels; c++) {
    const double *matrix = s->correction.matrix.at + 16 * c;
    double *given = s->correction.given.at + 4 * c;
    v4 sum = *(const v4 *)matrix * given[0] + *(const v4 *)(matrix + 4) * given[1] + *(const v4 *)(matrix + 8) * given[2]
             + *(const v4 *)(matrix + 12) * s->samples.at[c];
    *(v4 *)given = sum;
    given[3] = s->samples.at[c];
    s->corrected.at[c] = sum[3];
  }
  const int64_t held = s->sent.shape[0], commands = ACTUATORS;
  for (int64_t i = 0; i < AXES; i++) {
    const double now = s->sent.at[(held - 2) * commands + i], before = s->sent.at[(held - 1) * commands + i];
    s->corrected.at[s->measured_by[i]] -= s->ripple_m_s2_per_v * (now - before) + s->ripple_sum_m_s2_per_v * (now + before);
  }
  const Linear *b = &s->observer.block;
  apply(b);
  for (int64_t i = 0; i < AXES; i++) s->force.at[i] = b->made.at[b->states + s->estimated.shape[0] + i];
}

INLINE void advance_numerical(const Step *s, const double *drive) {
  const Modal *b = &s->numerical;
  const int64_t m = b->turn.shape[1], lead = s->force_recent.shape[1], n = AXES, wide = 1 + n;
  double *force = s->force.at, *free_accel = s->free_accel.at;
  for (int64_t i = 0; i < n; i++)
    for (int64_t k = 0; k < lead; k++)
      for (int64_t j = 0; j < n; j++) force[i] += s->force_recent.at[(i * lead + k) * n + j] * s->recent.at[n * k + j];
  product(b->outputs.at, b->outputs.shape[0], b->outputs.shape[1], b->state.shape[0], b->state.at, b->made.at);
  const double *through = b->through.at, ground = drive[0];
  for (int64_t i = 0; i < n; i++) {
    free_accel[i] = b->made.at[i] + through[i * wide] * ground;
    for (int64_t j = 0; j < n; j++) free_accel[i] += b->direct.at[i * n + j] * force[j];
  }
  for (int64_t i = 0; i < n; i++)
    for (int64_t j = 0; j < n; j++) force[i] += s->force_returned.at[i * n + j] * free_accel[j];
  for (int64_t row = 0; row < 3 * n; row++) {
    double value = b->made.at[row] + through[row * wide] * ground;
    for (int64_t j = 0; j < n; j++) value += through[row * wide + 1 + j] * force[j];
    s->motion.at[row] = row < n ? value : value + drive[row / n];
  }
  double *restrict first = b->state.at, *restrict second = b->state.at + m;
  const double *restrict turn = b->turn.at, *restrict into = b->drive.at;
  for (int64_t i = 0; i < m; i++) {
    const double one = first[i], two = second[i];
    first[i] = turn[i] * one + turn[m + i] * two + (into[i] * ground + into[2 * m + i] * force[0]);
    second[i] = turn[2 * m + i] * one + turn[3 * m + i] * two + (into[m + i] * ground + into[3 * m + i] * force[0]);
  }
  for (int64_t j = 1; j < n; j++)
    for (int64_t i = 0; i < 2 * m; i++) b->state.at[i] += into[2 * m * (1 + j) + i] * force[j];
}

INLINE double shape(const Step *s, int64_t a, double command) {
  if (s->bit_v == 0.0 || !isfinite(command)) return command;
  const double wanted = command + s->carried.at[a], rounded = floor(wanted * s->bits_per_v + 0.5) * s->bit_v;
  s->carried.at[a] = wanted - rounded;
  return rounded;
}

/* what counters dry friction at the velocity to come */
INLINE double against_friction(const LinearFeedforward *f, const double *motion) {
  const double velocity = motion[AXES] + f->lead_s * motion[0];
  return f->friction_v * (tanh(velocity * f->per_scale) - f->linear_s_per_m * velocity);
}

INLINE void compensate(const Step *s) {
  const Linear *f = &s->feedforward.block, *b = &s->feedback.block;
  const int64_t motions = 3 * AXES, commands = ACTUATORS, told = f->given.shape[0] - f->states - motions;
  for (int64_t i = 0; i < motions; i++) f->given.at[f->states + i] = s->motion.at[i];
  for (int64_t c = 0; c < told; c++) f->given.at[f->states + motions + c] = s->corrected.at[c]; /* the specimen's reaction */
  apply(f);
  f->made.at[f->states] += against_friction(&s->feedforward, s->motion.at);
  for (int64_t i = 0; i < AXES; i++) b->given.at[b->states + i] = s->error.at[i];
  apply(b);
  for (int64_t a = 0; a < commands; a++) {
    const double forward = f->made.at[f->states + a], wanted = b->made.at[b->states + a];
    const double limit = s->feedback_limit_v.at[a], room = s->command_limit_v.at[a];
    const double highest = least(limit, most(room - forward, 0.0)), lowest = most(-limit, least(-room - forward, 0.0));
    const double applied = wanted > highest ? highest : wanted < lowest ? lowest : wanted;
    if (applied != wanted && s->feedback.shortfall.shape[0] > 0)
      for (int64_t i = 0; i < b->states; i++)
        b->given.at[i] += s->feedback.shortfall.at[a * b->states + i] * (applied - wanted);
    s->command.at[a] = shape(s, a, forward + applied);
  }
}

INLINE void expect(const Step *s) {
  const OpenLoop *b = &s->open_loop;
  const int64_t channels = s->samples.shape[0], wide = b->given.shape[1], known = b->made.shape[1] > 0;
  const int64_t last = known ? b->floors + 1 : channels;
  const double desired = s->motion.at[0];
  for (int i = 0; i < 2; i++) {
    double *given = b->given.at + i * wide, *made = b->made.at + i * b->made.shape[1], *at = s->expected.at + i * channels;
    given[b->states] = i ? s->corrected.at[0] : s->recent.at[0];
    product(b->matrix.at, b->matrix.shape[0], b->matrix.shape[1], wide, given, made);
    for (int64_t j = 0; j < b->states; j++) given[j] = made[j];
    for (int64_t c = 1; c < last; c++) at[c] = known ? made[b->states + c - 1] : desired;
    at[0] = desired;
    for (int64_t j = 0; j < AXES; j++) at[s->measured_by[j]] = s->motion.at[s->commanded * AXES + j];
  }
}

INLINE void step(const Step *s, const double *drive) {
  const int64_t n = AXES, lead = s->recent.shape[0] - 1;
  sense(s);
  if (s->source == EXCITATION) {
    for (int64_t a = 0; a < ACTUATORS; a++) s->command.at[a] = drive[a];
    return;
  }
  if (s->source == NUMERICAL) advance_numerical(s, drive);
  else for (int64_t i = 0; i < 3 * n; i++) s->motion.at[i] = drive[i / n];
  double *recent = s->recent.at, *other = s->recent_commanded.at;
  for (int64_t i = 0; i < n; i++) {
    recent[n * lead + i] = s->motion.at[i];
    if (s->commanded != 0) other[n * lead + i] = s->motion.at[s->commanded * n + i];
    s->error.at[i] = other[i] - s->corrected.at[s->measured_by[i]];
  }
  expect(s);
  compensate(s);
  for (int64_t i = 0; i < n * lead; i++) recent[i] = recent[i + n];
  if (s->commanded != 0)
    for (int64_t i = 0; i < n * lead; i++) other[i] = other[i + n];
}

INLINE void note_sent(const Step *s) {
  const int64_t commands = ACTUATORS;
  for (int64_t i = s->sent.shape[0] * commands - 1; i >= commands; i--) s->sent.at[i] = s->sent.at[i - commands];
  for (int64_t a = 0; a < commands; a++) s->sent.at[a] = s->command.at[a];
}

/* ---- the guard; BRAKE_SHARE, RETURN_RATE, ... as in rths_cli/loop/guard.py ---- */

static const double brake_share = 0.45, return_rate_rad_s = 7.5, at_rest_m = 1e-6, stuck_s = 0.5;
static const double forget_hz = 0.5;

INLINE double must_have_moved(const GuardState *g, int64_t c) {
  return least(g->moved.at[c], g->moved.at[g->same.shape[0] + c]);
}

INLINE void note_code(const GuardState *g, int64_t c, double sample, const double *expected) {
  const int64_t channels = g->same.shape[0];
  const int changed = sample != g->codes.at[c];
  g->codes.at[c] = sample;
  g->same.at[c] = changed ? 0 : g->same.at[c] + 1;
  for (int64_t i = c; i < 2 * channels; i += channels) {
    if (changed) {
      g->expected_at.at[i] = expected[i];
      g->moved.at[i] = 0.0;
    } else g->moved.at[i] = most(g->moved.at[i], fabs(expected[i] - g->expected_at.at[i]));
  }
}

INLINE int is_stuck(const GuardLimits *lim, const GuardState *g, int64_t c) {
  return g->same.at[c] * lim->dt_s >= stuck_s && must_have_moved(g, c) > lim->stuck.at[c];
}

INLINE int beyond(const GuardState *g, double value, int reason) {
  g->seen.at[0] = value;
  return reason;
}

INLINE int check_samples(const GuardLimits *lim, const GuardState *g, const Step *s) {
  const double *accel = s->corrected.at;
  const int64_t channels = s->samples.shape[0];
  double force = 0.0;
  for (int64_t c = 0; c < channels; c++) note_code(g, c, s->samples.at[c], s->expected.at);
  for (int64_t c = 0; c < channels; c++) {
    const double sample = s->samples.at[c];
    g->flags.at[2] = c;
    if (!isfinite(sample)) return NOT_A_NUMBER;
    if (fabs(sample) >= lim->saturation_v.at[c]) return beyond(g, fabs(sample), SATURATED);
    if (fabs(accel[c]) > lim->abort.at[c]) return beyond(g, fabs(accel[c]), ACCELERATION);
    if (is_stuck(lim, g, c)) return beyond(g, must_have_moved(g, c), STUCK);
    force += lim->force_weights.at[c] * accel[c];
  }
  g->flags.at[2] = -1;
  return fabs(force) > lim->force_n ? beyond(g, fabs(force), FORCE) : NONE;
}

INLINE double farthest(const GuardLimits *lim) { return least(lim->stroke_m, lim->gain_m_per_v * lim->command_v); }

INLINE int check_command(const GuardLimits *lim, const GuardState *g, int64_t a, double command, double desired_m) {
  if (!isfinite(command)) return NOT_A_NUMBER;
  if (fabs(command) > lim->command_v) return beyond(g, fabs(command), COMMAND);
  const double place = lim->gain_m_per_v * command, velocity = (place - g->motion.at[a]) / lim->dt_s;
  if (fabs(velocity) > lim->velocity_m_s) return beyond(g, fabs(velocity), VELOCITY);
  if (fabs(velocity) > lim->gain_m_per_v * lim->command_rate_v_s) return beyond(g, fabs(velocity) / lim->gain_m_per_v, RATE);
  const double braked = place + 0.5 * velocity * fabs(velocity) / (brake_share * lim->acceleration_m_s2);
  const double reached = most(fabs(place), fabs(braked));
  if (reached > farthest(lim)) return beyond(g, reached, STROKE);
  if (reached > lim->reach_m) return beyond(g, reached, PLANNED_REACH);
  return fabs(place - desired_m) > lim->deviation_m ? beyond(g, fabs(place - desired_m), DEVIATION) : NONE;
}

INLINE int check_errors(const GuardLimits *lim, const GuardState *g, const double *error) {
  for (int64_t i = 0; i < AXES; i++) {
    if (!isfinite(error[i])) return NOT_A_NUMBER;
    if (fabs(error[i]) > lim->tracking_error) return beyond(g, fabs(error[i]), TRACKING);
  }
  return NONE;
}

INLINE int check_energy(const GuardLimits *lim, const GuardState *g, const Step *s) {
  if (isinf(lim->energy_ratio)) return NONE;
  double *energy = g->energy.at;
  for (int64_t i = 0; i < AXES; i++) {
    double *slip = g->slip.at + i, *last = slip + AXES;
    const double force = s->force.at[i], error = s->error.at[i];
    if (s->commanded == 0) *slip += (error - 2.0 * M_PI * forget_hz * *slip) * lim->dt_s;
    else {
      *slip = (error - *last) / lim->dt_s;
      *last = error;
    }
    energy[0] += force * *slip * lim->dt_s;
    energy[1] += fabs(force * s->motion.at[AXES + i]) * lim->dt_s;
  }
  const double exchanged = energy[1] + lim->energy_floor_j;
  if (energy[0] <= lim->energy_ratio * exchanged) return NONE;
  return beyond(g, exchanged > 0.0 ? energy[0] / exchanged : INFINITY, ENERGY);
}

static __attribute__((noinline)) void ramp_down(const GuardLimits *lim, const GuardState *g) {
  const double fastest = least(lim->velocity_m_s, lim->gain_m_per_v * lim->command_rate_v_s);
  const double by_velocity = M_E * fastest / farthest(lim);
  const double by_acceleration = sqrt(brake_share * lim->acceleration_m_s2 / farthest(lim));
  const double rate = least(return_rate_rad_s, least(by_velocity, by_acceleration));
  const int64_t count = ACTUATORS, phase = g->flags.at[0];
  int ready = 1;
  for (int64_t a = 0; a < count; a++) {
    double place = g->motion.at[a], velocity = g->motion.at[count + a];
    if (phase == BRAKING) {
      velocity = copysign(most(fabs(velocity) - brake_share * lim->acceleration_m_s2 * lim->dt_s, 0.0), velocity);
      place += velocity * lim->dt_s;
      ready = ready && velocity == 0.0;
    } else if (phase == RETURNING) {
      const double slope = (velocity + rate * place) * lim->dt_s, decay = exp(-rate * lim->dt_s);
      place = (place + slope) * decay;
      velocity = (velocity - rate * slope) * decay;
      if (fabs(place) < at_rest_m && fabs(velocity) < at_rest_m * rate) place = velocity = 0.0;
      else ready = 0;
    }
    g->motion.at[a] = place;
    g->motion.at[count + a] = velocity;
  }
  if (ready && phase == BRAKING) g->flags.at[0] = RETURNING;
  else if (ready && phase == RETURNING) g->flags.at[0] = STOPPED;
}

INLINE void guard(const GuardLimits *lim, const GuardState *g, const Step *s) {
  const int64_t commands = ACTUATORS;
  double *command = s->command.at;
  if (g->flags.at[0] == RUNNING) {
    int reason = check_samples(lim, g, s);
    for (int64_t a = 0; a < commands; a++)
      if (reason == NONE) reason = check_command(lim, g, a, command[a], a < AXES ? s->motion.at[2 * AXES + a] : 0.0);
    if (reason == NONE) reason = check_errors(lim, g, s->error.at);
    if (reason == NONE) reason = check_energy(lim, g, s);
    if (reason == NONE) {
      for (int64_t a = 0; a < commands; a++) {
        const double place = lim->gain_m_per_v * command[a];
        g->motion.at[commands + a] = (place - g->motion.at[a]) / lim->dt_s;
        g->motion.at[a] = place;
      }
      g->flags.at[3]++;
      return;
    }
    g->flags.at[0] = BRAKING;
    g->flags.at[1] = reason;
  }
  ramp_down(lim, g);
  for (int64_t a = 0; a < commands; a++) command[a] = g->motion.at[a] / lim->gain_m_per_v;
}

/* ---- the virtual table ---- */

static const double saturated = 10.0, solved = 1e-9;
enum { CLIPPED_LEVEL = 4, CROSSING_LEVEL = 9 };

INLINE double convert(double value, double size, double per_unit, double bound) {
  if (size > 0.0) value = floor(value * per_unit + 0.5) * size;
  return least(most(value, -bound), bound - size);
}

INLINE double tanh_exactly(double value) { return 1.0 - 2.0 / (exp(2.0 * value) + 1.0); }

INLINE double tanh_after(double begun, double ratio, double moved) {
  if (fabs(moved) > 1.0 || fabs(ratio) > saturated) return tanh_exactly(ratio + moved);
  const double square = moved * moved;
  const double over = moved * (135135.0 + square * (17325.0 + square * (378.0 + square)));
  const double under = 135135.0 + square * (62370.0 + square * (3150.0 + square * 28.0));
  return (begun * under + over) / (under + begun * over);
}

INLINE double follow(double begun, double moved) {
  return within(begun + (1.0 - begun * begun) * moved * (1.0 - begun * moved), 1.0);
}

INLINE double clipped(double reference, const Plant *p) { return within(reference, p->force_limit_n) - reference; }

/* tiles of one level in an array (levels, tiles, columns, 4) */
INLINE const double *level_of(const Array *a, int64_t level) {
  return a->at + level * a->shape[1] * a->shape[2] * a->shape[3];
}

/* feed (levels, 2, 2, 2, 3): node, argument, nonlinearity, place; the last size is not handed over, it is 3 */
INLINE const double *feed_of(const Plant *p, int64_t level, int node, int which) {
  return p->feed.at + 24 * level + 12 * node + 6 * which;
}

INLINE int64_t choose_level(const Plant *p, const PlantState *s, int *active) {
  const int64_t n = p->mechanical;
  product(p->start.at, p->start.shape[0], p->start.shape[1], n + 1, s->state.at, s->begin.at);
  const double *begin = s->begin.at;
  const double velocity = s->state.at[1] * p->per_friction_velocity;
  const double friction_accel = p->accel_friction.at[0] * s->state.at[p->forces + 2];
  const double change = (fabs(begin[0] + friction_accel) + fabs(begin[3])) * p->dt_s * p->per_friction_velocity;
  const double nearest = most(fabs(velocity) - 1.5 * change, 0.0);
  int64_t level = 0;
  *active = nearest > saturated ? 0 : 1;
  double cubed = p->steps_cubed * change * (change * change + p->bend);
  if (cubed > 1.0)
    for (cubed *= exp(-2.0 * nearest); cubed > 1.0; cubed *= 0.125) level++;
  const double wanted = fabs(begin[1]);
  const double swing = 1.5 * fabs(begin[2] + p->reference_per_velocity * friction_accel) * p->dt_s;
  if (wanted + swing > p->force_limit_n) {
    const int64_t fine = wanted - swing > p->force_limit_n ? CLIPPED_LEVEL : CROSSING_LEVEL;
    level = level > fine ? level : fine;
    *active = 2;
  }
  level += p->refine;
  return level < p->push.shape[0] - 1 ? level : p->push.shape[0] - 1;
}

INLINE void solve_friction(const Plant *p, const PlantState *s, int64_t level) {
  double *state = s->state.at + p->forces;
  const double *at_middle = feed_of(p, level, 0, 0), *at_end = feed_of(p, level, 1, 0);
  const double begun = state[2], ratio = s->state.at[1] * p->per_friction_velocity;
  const double m1 = at_middle[1], m2 = at_middle[2], e1 = at_end[1], e2 = at_end[2];
  const double middle_free = s->offsets.at[0] + at_middle[0] * begun - ratio;
  const double end_free = s->offsets.at[1] + at_end[0] * begun - ratio;
  double middle = follow(begun, middle_free + (m1 + m2) * begun), end = follow(begun, end_free + (e1 + e2) * begun);
  state[0] = begun;
  for (int i = 0; i < 20; i++) {
    const double middle_is = tanh_after(begun, ratio, middle_free + m1 * middle + m2 * end);
    const double end_is = tanh_after(begun, ratio, end_free + e1 * middle + e2 * end);
    const double middle_slope = 1.0 - middle_is * middle_is, end_slope = 1.0 - end_is * end_is;
    const double a = 1.0 - middle_slope * m1, b = -middle_slope * m2, c = -end_slope * e1, d = 1.0 - end_slope * e2;
    const double scale = 1.0 / (a * d - b * c);
    const double by_middle = scale * (d * (middle_is - middle) - b * (end_is - end));
    const double by_end = scale * (a * (end_is - end) - c * (middle_is - middle));
    middle += by_middle;
    end += by_end;
    const double moved = most(fabs(m1 * by_middle + m2 * by_end), fabs(e1 * by_middle + e2 * by_end));
    if (moved * moved < solved) break;
  }
  state[1] = middle;
  state[2] = end;
}

INLINE double argument(const Plant *p, const PlantState *s, int64_t level, int node, int which) {
  const double *feed = feed_of(p, level, node, which), *acting = s->state.at + p->forces;
  double value = s->offsets.at[2 * which + node];
  for (int j = 0; j < 3; j++) value += feed[j] * acting[j] + feed[3 + j] * acting[4 + j];
  return value;
}

static __attribute__((noinline)) void solve_both(const Plant *p, const PlantState *s, int64_t level) {
  double *state = s->state.at + p->forces;
  product(p->start.at, 1, p->start.shape[1], p->mechanical + 1, s->state.at, s->begin.at);
  state[0] = state[1] = state[2];
  state[4] = state[5] = state[6] = clipped(s->begin.at[1], p);
  for (int i = 0; i < 20; i++) {
    double change = 0.0;
    for (int node = 0; node < 2; node++) {
      const double friction = tanh_exactly(argument(p, s, level, node, 0));
      const double clip = clipped(argument(p, s, level, node, 1), p);
      change = most(change, most(fabs(friction - state[1 + node]), fabs(clip - state[5 + node])));
      state[1 + node] = friction;
      state[5 + node] = clip;
    }
    if (change < 1e-10) return;
  }
}

INLINE void solve(const Plant *p, const PlantState *s, int64_t level, int active) {
  const int64_t n = p->mechanical;
  if (active == 0) {
    const double sign = copysign(1.0, s->state.at[1]);
    s->state.at[p->forces] = s->state.at[p->forces + 1] = s->state.at[p->forces + 2] = sign;
    return;
  }
  if (level > 0)
    product(level_of(&p->nodes, level), p->nodes.shape[1], p->nodes.shape[2], n + 1, s->state.at, s->offsets.at);
  if (active == 1) solve_friction(p, s, level);
  else solve_both(p, s, level);
}

static __attribute__((noinline)) void sense_directly(const Plant *p, const PlantState *s) {
  const int64_t n = p->mechanical;
  for (int64_t c = 0; c < s->low.shape[0]; c++) {
    double value = p->accel_friction.at[c] * s->state.at[p->forces + 2];
    for (int64_t i = 0; i < n; i++) value += p->accel_rows.at[n * c + i] * s->state.at[i];
    s->low.at[c] = value;
  }
}

INLINE void take(const Plant *p, const PlantState *s, int64_t level, int64_t columns) {
  const int64_t n = p->mechanical, channels = s->low.shape[0];
  product(level_of(&p->push, level), p->push.shape[1], 4 * p->push.shape[2], columns, s->state.at, s->made.at);
  const double *restrict made = s->made.at, *filter = p->filters.at + 3 * level;
  double *restrict state = s->state.at, *restrict low = s->low.at, *restrict coupled = s->coupled.at;
  for (int64_t i = 0; i < n; i++) state[i] = made[i];
  const double keeps = filter[0], couples = filter[1], takes = filter[2];
  for (int64_t c = 0; c < channels; c++) {
    coupled[c] = made[n + channels + c] + couples * coupled[c] + takes * low[c];
    low[c] = made[n + c] + keeps * low[c];
  }
  if (!p->has_low_pass) sense_directly(p, s);
}

INLINE void note_velocity(const PlantState *s, int64_t mechanical) {
  const int64_t floors = s->middle_velocity.shape[0] - 1;
  s->middle_velocity.at[0] = s->state.at[1];
  for (int64_t f = 0; f < floors; f++)
    s->middle_velocity.at[1 + f] = s->state.at[1] + s->state.at[mechanical - floors + f];
}

INLINE void hold(const Plant *p, const PlantState *s, double command) {
  const int64_t last = s->queue.shape[0] - 1, n = p->mechanical, channels = s->low.shape[0];
  for (int64_t i = 0; i < last; i++) s->queue.at[i] = s->queue.at[i + 1];
  s->queue.at[last] = convert(command, p->command_step_v, p->command_steps_per_v, p->command_range_v);
  s->state.at[n] = s->queue.at[0];
  int active;
  const int64_t level = choose_level(p, s, &active), columns = p->forces + (active == 2 ? 8 : 4);
  const int64_t steps = (int64_t)1 << level, half = steps >> 1;
  for (int64_t i = 0; i < steps; i++) {
    if (half > 0 && i == half) note_velocity(s, n);
    solve(p, s, level, active);
    take(p, s, level, columns);
  }
  if (half == 0)
    for (int64_t c = 0; c < channels; c++) s->middle_velocity.at[c] = s->made.at[n + 2 * channels + c];
  const double ratio = s->state.at[1] * p->per_friction_velocity;
  s->state.at[p->forces + 2] = fabs(ratio) > saturated ? copysign(1.0, ratio) : tanh_exactly(ratio);
  if (fabs(s->state.at[0]) > p->stroke_m) s->fault.at[0] = 1;
}

INLINE void read(const Plant *p, const PlantState *s, const double *noise, const Array *samples) {
  for (int64_t c = 0; c < samples->shape[0]; c++) {
    const double accel = within(s->low.at[c] - s->coupled.at[c] + p->noise_rms_m_s2 * noise[c], p->sensor_range_m_s2);
    samples->at[c] = convert(accel * p->sensor_v_per_m_s2, p->sensor_step_v, p->sensor_steps_per_v, p->sensor_range_v);
  }
}

/* ---- the run ---- */

INLINE double *note(const Step *s, const Log *log, int64_t k) {
  const int64_t n = log->columns.shape[1], channels = s->corrected.shape[0], estimates = s->estimated.shape[0];
  double *to = log->columns.at + n * log->truths + k;
  for (int64_t i = 0; i < channels; i++, to += n) *to = s->corrected.at[i];
  for (int64_t i = 0; i < 3 * AXES; i++, to += n) *to = s->motion.at[i];
  for (int64_t i = 0; i < ACTUATORS; i++, to += n) *to = s->command.at[i];
  for (int64_t i = 0; i < AXES; i++, to += n) *to = s->force.at[i];
  for (int64_t i = 0; i < estimates; i++, to += n) *to = s->estimated.at[i];
  return to;
}

INLINE void stamp(const Log *log, int64_t steps, int64_t count, int64_t before, int64_t now) {
  double *last = log->columns.at + log->columns.shape[1] * (log->columns.shape[0] - 1) + steps - 1;
  for (int64_t i = 0; i < count; i++) last[-i] = (double)(now - before) / count;
}

INLINE int64_t monotonic_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1000000000 + now.tv_nsec;
}

int64_t run(const Plant *plant_, const PlantState *table_, const Step *step_, const GuardLimits *limits_,
            const GuardState *guard_, const double *restrict drive, const double *restrict noise, const Log *log_, int64_t n) {
  /* copies of our own: no store through an array can change a size, a pointer or a constant */
  const Plant plant = *plant_;
  const PlantState table = *table_;
  const Step s = *step_;
  const GuardLimits limits = *limits_;
  const GuardState g = *guard_;
  const Log log = *log_;
  const int64_t channels = s.samples.shape[0];
  int64_t before = monotonic_ns(), steps = 0;
  while (steps < n && table.fault.at[0] == 0 && g.flags.at[0] != STOPPED) {
    read(&plant, &table, noise + channels * steps, &s.samples);
    const double displacement = table.state.at[0];
    step(&s, drive + 3 * steps);
    guard(&limits, &g, &s);
    note_sent(&s);
    *note(&s, &log, steps) = displacement;
    hold(&plant, &table, s.command.at[0]);
    for (int64_t c = 0; c < channels; c++) log.columns.at[n * c + steps] = table.middle_velocity.at[c];
    steps++;
    if (steps % STAMPED == 0) {
      const int64_t now = monotonic_ns();
      stamp(&log, steps, STAMPED, before, now);
      before = now;
    }
  }
  stamp(&log, steps, steps % STAMPED, before, monotonic_ns());
  log.done.at[0] = steps;
  return steps;
}
