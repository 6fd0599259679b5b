/* The step, block by block and in the order of its blocks: sense, numerical substructure, compensation, guard; and the
   states of a test around it. See rths_step.h. */

#include "rths_step.h"

#include <math.h>
#include <string.h>

#define PI 3.141592653589793

/* ---- the guard's constants ---- */

enum { GUARD_RUNNING, GUARD_BRAKING, GUARD_RETURNING, GUARD_STOPPED };
enum { UNWATCHED, WATCHED, STROKE_SENSOR, CELL };
enum { LOW_1, LOW_2, OWN_1, OWN_2, DIFFERENCE, SIZE, PLACE, SPEED };

static const double BRAKE_SHARE = 0.45;       /* of the acceleration limit */
static const double RETURN_RATE = 7.5;        /* rad/s */
static const double AT_REST_M = 1e-6;
static const double STUCK_S = 0.5;
static const double FORGET_HZ = 0.5;          /* below it an error of velocity is a sensor's offset */
static const double REACTION_S = 20e-3;
static const double VELOCITY_S = 5e-3;
static const double COMPARED_S = 1.0, COMPARED_HZ = 2.0, DIFFERS = 0.5;
static const int SLOWLY = 8;                  /* samples return over this many times the length of the gap */
static const int REMEMBERED = 2;              /* earlier samples that the correction of a sensor needs */
static const int ROUNDS = 12;                 /* of the fixed point by which floors are substituted */

static double least(double a, double b) { return a < b ? a : b; }
static double most(double a, double b) { return a > b ? a : b; }
static double within(double value, double bound) { return least(most(value, -bound), bound); }

/* made = matrix @ given; tiles of four rows, column by column. Even and odd columns are summed apart, so that a sum
   waits for the one before it half as often. */
static void product(int tiles, int columns, const double *matrix, const double *given, double *made)
{
  for (int tile = 0; tile < tiles; tile++) {
    double even[4] = {0.0, 0.0, 0.0, 0.0}, odd[4] = {0.0, 0.0, 0.0, 0.0};
    int j = 0;
    for (; j + 2 <= columns; j += 2) {
      const double *column = matrix + 4 * (tile * columns + j);
      for (int i = 0; i < 4; i++) even[i] += column[i] * given[j];
      for (int i = 0; i < 4; i++) odd[i] += column[4 + i] * given[j + 1];
    }
    if (j < columns) {
      const double *column = matrix + 4 * (tile * columns + j);
      for (int i = 0; i < 4; i++) even[i] += column[i] * given[j];
    }
    for (int i = 0; i < 4; i++) made[4 * tile + i] = even[i] + odd[i];
  }
}

static double *corrected_of(rths_state *s) { return s->observer + RTHS_OBSERVER_STATES; }

/* ---- sense ---- */

/* Correct one sample in V for its sensor: up to three states, then the sample; return its value in its unit. */
static double correct(const double *matrix, double *given, double sample)
{
  double sum[4] = {0.0, 0.0, 0.0, 0.0};
  given[3] = sample;
  for (int j = 0; j < 4; j++)
    for (int i = 0; i < 4; i++) sum[i] += matrix[4 * j + i] * given[j];
  given[0] = sum[0];
  given[1] = sum[1];
  given[2] = sum[2];
  return sum[3];
}

/* The alias of the held command in the table's sample of this instant, in m/s^2. */
static double staircase(const rths_state *s)
{
  const double now = s->sent[RTHS_SENT - 2], before = s->sent[RTHS_SENT - 1];
  return rths_data.ripple_m_s2_per_v * (now - before) + rths_data.ripple_sum_m_s2_per_v * (now + before);
}

static void observe(rths_state *s)
{
  product(RTHS_TILES(RTHS_OBSERVED), RTHS_OBSERVER_COLUMNS, rths_data.observer, s->observer, s->observed);
}

/* Correct the samples for sensors and for the held commands' alias, and estimate the specimen's motion. */
static void sense(rths_state *s)
{
  double *corrected = corrected_of(s);
  for (int c = 0; c < RTHS_CHANNELS; c++)
    corrected[c] = correct(rths_data.correction[c], s->correction[c], s->samples[c]);
  corrected[RTHS_MEASURED_BY] -= staircase(s);
#if RTHS_CELL >= 0
  corrected[RTHS_CELL] -= rths_data.cell_reads[0] * staircase(s);
#endif
  observe(s);
  for (int i = 0; i < RTHS_OBSERVER_STATES; i++) s->observer[i] = s->observed[i];
  s->force = s->observed[RTHS_OBSERVER_STATES + RTHS_ESTIMATES];
}

/* ---- storey laws ---- */

#if RTHS_LAWS > 0

enum { BILINEAR, CLOUGH, GAP, CUBIC, VISCOUS, MAXWELL, BOUC_WEN, OWN, SOFTENING };
enum { MOST_PIECES = 8, CORNERS = 6 };
enum { TABLE_FROM, TABLE_TO, TABLE_SCALE, TABLE_PINCHES = 8, TABLE_REACH = 9 };
enum { M_SIDE = 3, M_SLOPE, M_BEND, M_NARROW, M_MOST, M_WAY, M_AHEAD, M_E_AHEAD, M_POWER, M_OFF, M_BESIDE };
enum { M_STRENGTH = 16, M_PINCHING = 24, PER_LIMIT = RTHS_LAW_NUMBERS - 1 };
enum { BELL_PER_ONE = 16 };
static const double BELL_FAR = 6.25;
static const double SHORT = 0.05, POWER_IS_NOTHING = 1e-7;

static int64_t bits_of(double value)
{
  int64_t bits;
  memcpy(&bits, &value, sizeof bits);
  return bits;
}

/* The value of a law's curve, odd in its argument: force in N at a rate in m/s, or a power. */
static double on_curve(const rths_law *law, double rate)
{
  const double *curve = law->curve, size = fabs(rate);
  if (!(size < curve[1])) return copysign(curve[2] + curve[3] * (size - curve[1]), rate);
  const int64_t row = size > curve[0] ? 1 + (bits_of(size) >> law->curve_shift) - law->curve_begin : 1;
  const double *piece = curve + 8 * row, x = size - piece[0];
  double value = piece[RTHS_TERMS];
  for (int i = RTHS_TERMS - 1; i > 0; i--) value = value * x + piece[i];
  return copysign(value, rate);
}

/* abs(y)^(n - 1) */
static double power_of(const rths_law *law, double size)
{
  const double n = law->numbers[3];
  return n == 1.0 ? 1.0 : n == 2.0 ? size : on_curve(law, size);
}

/* What the slope of Bouc and Wen's variable lacks of one, without degradation and pinching. */
static double bends(const rths_law *law, double y)
{
  return (law->numbers[5] * fabs(y) + law->numbers[4] * y) * power_of(law, fabs(y));
}

static int expands(double far, double size, double bound)
{
  const double ratio = far * far, fourth = size * size;
  return 3.0 * far < size || (far < 4.0 * size && bound * ratio * ratio < POWER_IS_NOTHING * fourth * fourth);
}

/* Bouc and Wen's variable after a piece of the way, of the yield drift; y is positive where the drift goes. A series of
   order four where it is short, else a Runge-Kutta step. */
static double undegraded(const rths_law *law, double y, double way)
{
  const double *numbers = law->numbers, n = numbers[3], size = fabs(y), power = size * power_of(law, size);
  const double w = (numbers[5] + copysign(numbers[4], y)) * power, f = 1.0 - w;
  if (expands(n * way * most(1.0, f), size, (fabs(numbers[5]) + numbers[4]) * power)) {
    const double k = way / y, first = n * w * f, more = (n - 1.0) * f - n * w;
    const double last = more * (more - f) - (2.0 * n - 1.0) * first;
    return y + way * (f - first * k * (1.0 / 2.0 + k * (1.0 / 6.0 * more + 1.0 / 24.0 * k * last)));
  }
  const double y1 = way * f;
  const double y2 = way * (1.0 - bends(law, y + 0.5 * y1));
  const double y3 = way * (1.0 - bends(law, y + 0.5 * y2));
  const double y4 = way * (1.0 - bends(law, y + y3));
  return y + (y1 + 2.0 * y2 + 2.0 * y3 + y4) * (1.0 / 6.0);
}

/* Into how many pieces a way over the yield drift is cut. */
static int pieces_of(const rths_law *law, double way)
{
  const double wanted = 2.0 * fabs(way) * (1.0 + law->numbers[3]);
  return wanted < MOST_PIECES - 1 ? 1 + (int)wanted : MOST_PIECES;
}

/* exp(-x^2), read from a table of polynomials; zero where it counts for nothing. */
static double bell(double x)
{
  const double size = fabs(x);
  if (!(size < BELL_FAR)) return 0.0;
  const double *piece = rths_data.bell + 8 * (int)(size * BELL_PER_ONE), d = size - piece[0];
  double value = piece[RTHS_TERMS];
  for (int i = RTHS_TERMS - 1; i > 0; i--) value = value * d + piece[i];
  return value;
}

/* The row of a law's table for a dissipated energy. */
static int64_t piece_of(const rths_law *law, double energy)
{
  const int64_t bits = bits_of(1.0 + law->table[TABLE_SCALE] * energy);
  const int64_t piece = bits < 0 ? 0 : (bits >> law->table_shift) - law->table_begin;
  return 1 + (piece < 0 ? 0 : piece > law->table_last ? law->table_last : piece);
}

/* Four functions of the energy, then their slopes over TABLE_SCALE. */
static void read_four(const rths_law *law, int64_t row, double energy, int four, double *values)
{
  const double *piece = law->table + RTHS_TABLE_COLUMNS * row;
  const double d = 1.0 + law->table[TABLE_SCALE] * energy - piece[7];
  for (int f = 0; f < 4; f++) {
    const double *coefficient = piece + four + f;
    double value = coefficient[8 * (RTHS_TERMS - 1)], slope = value;
    for (int i = RTHS_TERMS - 2; i >= 0; i--) {
      value = value * d + coefficient[8 * i];
      if (i > 0) slope = slope * d + value;
    }
    values[f] = value;
    values[4 + f] = slope;
  }
}

/* Look up the power of the predicted y, what the predicted e makes of the law, and the bell of pinching. */
static void looks_up(const rths_law *law, double *memory)
{
  const double y = memory[M_AHEAD], e = memory[M_E_AHEAD];
  const int64_t row = piece_of(law, e);
  memory[M_POWER] = power_of(law, fabs(y));
  read_four(law, row, e, 0, memory + M_STRENGTH);
  if (law->table[TABLE_PINCHES] > 0.0) {
    read_four(law, row, e, 4, memory + M_PINCHING);
    memory[M_OFF] = y * memory[M_PINCHING + 1] - memory[M_PINCHING + 2];
    memory[M_BESIDE] = bell(memory[M_OFF]);
  }
}

/* f = dy/ds, df/ds and the derivative of f over y at the prediction, from what was looked up. */
static double slope_of(const rths_law *law, double *memory, double *bend, double *f_y)
{
  const double *numbers = law->numbers, y = memory[M_AHEAD], n = numbers[3], power = memory[M_POWER], size = fabs(y);
  const double turns = (numbers[5] + copysign(numbers[4], y)) * power, w = turns * size;
  const double per_eta = memory[M_STRENGTH + 1];
  double f = memory[M_STRENGTH] - per_eta * w, f_e = memory[M_STRENGTH + 4] - memory[M_STRENGTH + 5] * w;
  memory[M_MOST] = per_eta * (fabs(numbers[5]) + numbers[4]) * power * size;
  *f_y = -(per_eta * n) * copysign(turns, turns * y);
  if (numbers[9] > 0.0) {
    const double narrow = memory[M_PINCHING + 1], beside = memory[M_BESIDE], lost = memory[M_PINCHING] * beside;
    const double steep = 2.0 * memory[M_OFF] * lost;
    const double lost_e = memory[M_PINCHING + 4] * beside
                          - steep * (y * memory[M_PINCHING + 5] - memory[M_PINCHING + 6]);
    *f_y = *f_y * (1.0 - lost) + f * (steep * narrow);
    f_e = f_e * (1.0 - lost) - f * lost_e;
    f = f * (1.0 - lost);
    memory[M_NARROW] = fabs(narrow);
  }
  *bend = *f_y * f + f_e * (law->table[TABLE_SCALE] * (1.0 - numbers[2]) * y);
  return f;
}

/* The change of Bouc and Wen's variable and of the dissipated energy over a way, of the yield drift. */
static double bent(const rths_law *law, double y, double e, double way, double *e_change)
{
  const double *numbers = law->numbers, n = numbers[3], beta = numbers[4], gamma = numbers[5];
  const double nu = 1.0 + numbers[7] * e;
  const double size = n == 1.0 ? fabs(y) : n == 2.0 ? y * y : fabs(y) * on_curve(law, fabs(y));
  const double turns = gamma + (y * way > 0.0 ? beta : -beta);
  double change = ((1.0 - numbers[6] * e) - nu * size * turns) * way / (1.0 + numbers[8] * e);
  if (numbers[9] > 0.0) {
    const double zeta = numbers[9] * (1.0 - exp(-numbers[10] * e));
    const double width = (numbers[12] + numbers[13] * e) * (numbers[14] + zeta);
    const double bound = nu * (beta + gamma);
    const double strength = n == 1.0 ? 1.0 / bound : n == 2.0 ? 1.0 / sqrt(bound) : pow(bound, -1.0 / n);
    const double off = (copysign(1.0, way) * y - numbers[11] * strength) / width;
    if (zeta != 0.0) change *= 1.0 - zeta * exp(-off * off);
  }
  *e_change = (1.0 - numbers[2]) * y * way;
  return change;
}

/* Go a whole way, over the yield drift, with a law that degrades, by Runge and Kutta's method. */
static void with_kinks(const rths_law *law, double *memory, double whole)
{
  const int pieces = pieces_of(law, whole);
  const double way = whole / pieces;
  for (int i = 0; i < pieces; i++) {
    const double y = memory[0], e = memory[1];
    double e1, e2, e3, e4;
    const double y1 = bent(law, y, e, way, &e1);
    const double y2 = bent(law, y + 0.5 * y1, e + 0.5 * e1, way, &e2);
    const double y3 = bent(law, y + 0.5 * y2, e + 0.5 * e2, way, &e3);
    const double y4 = bent(law, y + y3, e + e3, way, &e4);
    memory[0] = y + (y1 + 2.0 * y2 + 2.0 * y3 + y4) / 6.0;
    memory[1] = e + (e1 + 2.0 * e2 + 2.0 * e3 + e4) / 6.0;
  }
  memory[M_SIDE] = 0.0;
  if (law->table[TABLE_FROM] <= memory[1] && memory[1] <= law->table[TABLE_TO]) {
    const double side = copysign(1.0, way);
    double f_y;
    memory[M_AHEAD] = side * memory[0];
    memory[M_E_AHEAD] = memory[1];
    looks_up(law, memory);
    memory[M_SLOPE] = slope_of(law, memory, &memory[M_BEND], &f_y);
    memory[M_SIDE] = side;
  }
}

/* Follow the drift to u with a law that degrades: predict y and e there, where no kink is on the way. */
static void begins(const rths_law *law, double *memory, double u)
{
  const double *numbers = law->numbers, *table = law->table;
  const double way = (u - memory[2]) * numbers[PER_LIMIT], h = fabs(way), side = copysign(1.0, way);
  const double e = memory[1], c = 1.0 - numbers[2], y = side * memory[0], f = memory[M_SLOPE], bend = memory[M_BEND];
  const double far = h * most(1.0, f), ahead = y + h * (f + 0.5 * h * bend);
  const double e_ahead = e + c * h * (y + h * (0.5 * f + (1.0 / 6.0) * h * bend));
  const int near = far * memory[M_NARROW] < SHORT && 2.0 * h * (1.0 + numbers[3]) < 1.0;
  const int inside = table[TABLE_FROM] <= e_ahead && e_ahead <= table[TABLE_TO];
  const int slow = table[TABLE_SCALE] * fabs(e_ahead - e) < SHORT * (1.0 + table[TABLE_SCALE] * e);
  const int smooth = table[TABLE_REACH] * far < fabs(y) || expands(numbers[3] * far, fabs(y), memory[M_MOST]);
  memory[2] = u;
  if (memory[M_SIDE] == side && near && inside && slow && smooth) {
    memory[M_WAY] = h;
    memory[M_AHEAD] = ahead;
    memory[M_E_AHEAD] = e_ahead;
  } else {
    memory[M_WAY] = -1.0;
    with_kinks(law, memory, way);
  }
}

/* Correct the prediction and return the force. */
static double ends(const rths_law *law, double *memory)
{
  const double *numbers = law->numbers, h = memory[M_WAY];
  if (h >= 0.0) {
    const double f = memory[M_SLOPE], bend = memory[M_BEND];
    double bend_ahead, f_y;
    const double f_ahead = slope_of(law, memory, &bend_ahead, &f_y), x = 0.5 * h * f_y;
    const double lacks = h * (0.5 * (f_ahead - f) - (1.0 / 12.0) * h * (5.0 * bend + bend_ahead))
                         * (1.0 + x * (1.0 + x));
    memory[0] = memory[M_SIDE] * (memory[M_AHEAD] + lacks);
    memory[1] = memory[M_E_AHEAD] + 0.25 * h * (1.0 - numbers[2]) * lacks;
    memory[M_SLOPE] = f_ahead + f_y * lacks;
    memory[M_BEND] = bend_ahead;
  }
  return numbers[0] * (memory[0] * numbers[1] - memory[2]);
}

/* Follow the drift to u with Bouc and Wen's law; return the force. Memory: y, e, the drift, and what `begins` keeps. */
static double hysteresis(const rths_law *law, double *memory, double u)
{
  if (law->degrades) {
    begins(law, memory, u);
    looks_up(law, memory);
    return ends(law, memory);
  }
  const double way = (u - memory[2]) * law->numbers[PER_LIMIT], side = copysign(1.0, way);
  const int pieces = pieces_of(law, way);
  double y = side * memory[0];
  memory[2] = u;
  for (int i = 0; i < pieces; i++) y = undegraded(law, y, fabs(way) / pieces);
  memory[0] = side * y;
  return law->numbers[0] * (memory[0] * law->numbers[1] - u);
}

/* Follow the drift to u with Clough's law; return the force. Memory: drift, force, branch, side; drift and force
   farthest to the positive, then to the negative side; foot and slope of the line of reloading; where unloading began,
   the branch before it, and the slope of unloading. */
static double clough(const rths_law *law, double *memory, double u)
{
  enum { ELASTIC, BACKBONE, UNLOADING, RELOADING };
  const double k = law->numbers[0], limit = law->numbers[1], after = law->numbers[2];
  if (memory[2] == ELASTIC) {
    if (fabs(u) <= limit) {
      memory[0] = u;
      memory[1] = k * u;
      return 0.0;
    }
    memory[2] = BACKBONE;
    memory[3] = copysign(1.0, u);
    memory[4] = limit;
    memory[5] = k * limit;
    memory[6] = -limit;
    memory[7] = -k * limit;
  }
  for (int corner = 0; corner < CORNERS; corner++) {
    const double side = memory[3];
    const int ahead = side > 0.0 ? 4 : 6, behind = side > 0.0 ? 6 : 4;
    if (memory[2] != UNLOADING && (u - memory[0]) * side < 0.0) {
      if (memory[2] == BACKBONE) {
        memory[ahead] = memory[0];
        memory[ahead + 1] = memory[1];
      }
      memory[10] = memory[0];
      memory[11] = memory[2];
      memory[2] = UNLOADING;
      memory[12] = most(k * pow(limit / fabs(memory[ahead]), law->numbers[3]), memory[ahead + 1] / memory[ahead]);
    }
    if (memory[2] == BACKBONE) {
      memory[0] = u;
      memory[1] = side * k * limit + after * k * (u - side * limit);
      break;
    }
    if (memory[2] == RELOADING) {
      if ((u - memory[ahead]) * side <= 0.0) {
        memory[0] = u;
        memory[1] = memory[9] * (u - memory[8]);
        break;
      }
      memory[0] = memory[ahead];
      memory[1] = memory[ahead + 1];
      memory[2] = BACKBONE;
      continue;
    }
    const double slope = memory[12], foot = memory[0] - memory[1] / slope;
    if ((u - memory[10]) * side > 0.0) { /* beyond where unloading began */
      memory[1] += slope * (memory[10] - memory[0]);
      memory[0] = memory[10];
      memory[2] = memory[11];
    } else if ((u - foot) * side >= 0.0) {
      memory[1] += slope * (u - memory[0]);
      memory[0] = u;
      break;
    } else {
      const double reach = memory[behind] - foot;
      memory[8] = foot;
      memory[9] = reach * side < 0.0 ? memory[behind + 1] / reach : k;
      memory[0] = foot;
      memory[1] = 0.0;
      memory[2] = RELOADING;
      memory[3] = -side;
    }
  }
  return memory[1] - k * u;
}

/* The force of a law beyond the spring at rest, in N, at a drift in m; `rate` in m/s is that of the drift with the law's
   last force `before`. */
static double law_force(const rths_law *law, double *memory, double u, double rate, double before)
{
  const double *numbers = law->numbers;
  switch (law->code) {
  case BILINEAR:
    memory[0] = least(most(memory[0], u - numbers[1]), u + numbers[1]);
    return -numbers[0] * memory[0];
  case BOUC_WEN: return hysteresis(law, memory, u);
  case CLOUGH: return clough(law, memory, u);
  case GAP: return numbers[0] * (u - within(u, numbers[1]));
  case CUBIC: return numbers[0] * u * u * u;
  case SOFTENING: return -numbers[0] * u * fabs(u) / (fabs(u) + numbers[1]);
  case MAXWELL:
    memory[0] = numbers[0] * memory[0] + numbers[1] * (u - memory[1]);
    memory[1] = u;
    return memory[0];
  default: return on_curve(law, rate + law->gives * before); /* VISCOUS */
  }
}

/* Follow the laws to this instant; the base shear is extrapolated from the last two. */
static void follow_laws(rths_state *s)
{
  double made[4 * RTHS_TILES(2 * RTHS_LAW_STOREYS)] = {0.0}; /* drifts, then rates where a law needs them */
  double *forces = s->columns + RTHS_STATES + 1;
  s->columns[RTHS_COLUMNS - 1] = 2.0 * s->shear[0] - s->shear[1];
  product(RTHS_TILES(RTHS_DRIFT_ROWS), RTHS_COLUMNS, rths_data.drifts, s->columns, made);
  for (int j = 0; j < RTHS_LAW_STOREYS; j++) forces[j] = 0.0;
  for (int i = 0; i < RTHS_LAWS; i++) {
    const rths_law *law = &rths_data.laws[i];
    const double u = made[law->storey], rate = made[RTHS_LAW_STOREYS + law->storey];
    s->law_force[i] = law_force(law, s->law_memory[i], u, rate, s->law_force[i]);
    forces[law->storey] += s->law_force[i];
  }
}

#endif

/* ---- numerical substructure ---- */

/* The interface's acceleration without base shear. */
static double free_storeys(rths_state *s, double ground)
{
  s->columns[RTHS_STATES] = ground;
#if RTHS_LAWS > 0
  follow_laws(s);
#endif
  product(1, RTHS_COLUMNS - 1, rths_data.interface_motion, s->columns, s->free_motion);
  return s->free_motion[0];
}

/* The interface's absolute motion with base shear; the storeys go on by one instant. */
static void advance_storeys(rths_state *s, const double *ground)
{
  double pushed[4 * RTHS_TILES(RTHS_STATES)];
  double *states = s->columns;
  for (int row = 0; row < 3; row++) {
    const double value = s->free_motion[row] + rths_data.interface_motion[4 * (RTHS_COLUMNS - 1) + row] * s->force;
    s->motion[row] = row == 0 ? value : value + ground[row];
  }
  s->columns[RTHS_COLUMNS - 1] = s->force;
  product(RTHS_TILES(RTHS_STATES), RTHS_PUSHES, rths_data.push, s->columns + RTHS_STATES, pushed);
  for (int i = 0; i < RTHS_PAIRS; i++) {
    const double first = states[i], second = states[RTHS_PAIRS + i];
    states[i] = rths_data.turn[0][i] * first + rths_data.turn[1][i] * second + pushed[i];
    states[RTHS_PAIRS + i] = rths_data.turn[2][i] * first + rths_data.turn[3][i] * second + pushed[RTHS_PAIRS + i];
  }
  s->shear[1] = s->shear[0];
  s->shear[0] = s->force;
}

/* Advance the numerical substructure to k + n_p: interface force and absolute interface motion. Desired acceleration
   and force of the same instant depend on each other by linear equations, which are solved here. */
static void advance_numerical(rths_state *s, const double *ground)
{
  for (int k = 0; k < RTHS_LEAD; k++) s->force += rths_data.force_recent[k] * s->recent[k];
  const double free_accel = free_storeys(s, ground[0]) + rths_data.direct * s->force;
  s->force += rths_data.force_returned * free_accel;
  advance_storeys(s, ground);
}

/* ---- tracking ---- */

/* What the accelerometers must show by the desired and by the measured motion of the table. */
static void expect(rths_state *s, double desired, double measured)
{
  for (int by = 0; by < 2; by++) {
#if RTHS_EXPECTED_FLOORS > 0
    double made[4 * RTHS_TILES(RTHS_FLOOR_STATES + RTHS_EXPECTED_FLOORS)];
    double *given = s->floors[by];
    given[RTHS_FLOOR_STATES] = by == 0 ? desired : measured;
    product(RTHS_TILES(RTHS_FLOOR_STATES + RTHS_EXPECTED_FLOORS), RTHS_FLOOR_COLUMNS, rths_data.floors, given, made);
    for (int i = 0; i < RTHS_FLOOR_STATES; i++) given[i] = made[i];
    for (int c = 1; c <= RTHS_EXPECTED_FLOORS; c++) s->expected[by][c] = made[RTHS_FLOOR_STATES + c - 1];
#else
    (void)desired;
    (void)measured;
    for (int c = 1; c < RTHS_ACCELEROMETERS; c++) s->expected[by][c] = s->motion[0];
#endif
    s->expected[by][0] = s->motion[0];
    s->expected[by][RTHS_MEASURED_BY] = s->motion[0];
  }
}

/* Store the desired motion of k + n_p, and write the tracking error of t_k and what the channels must show. */
static void track(rths_state *s)
{
  const double *corrected = corrected_of(s);
  s->recent[RTHS_LEAD] = s->motion[0];
  s->error = s->recent[0] - corrected[RTHS_MEASURED_BY];
  expect(s, s->recent[0], corrected[0]);
}

/* ---- compensation ---- */

/* What counters dry friction at the velocity to come, in V. */
static double against_friction(const double *motion)
{
  const double velocity = motion[1] + rths_data.lead_s * motion[0];
  if (rths_data.friction_v == 0.0) return 0.0;
  return rths_data.friction_v * (tanh(velocity * rths_data.per_scale) - rths_data.linear_s_per_m * velocity);
}

/* The command of the desired motion, in V, with what counters the specimen's reaction and friction. */
static double feed_forward(rths_state *s)
{
  double made[4 * RTHS_TILES(RTHS_FORWARD_STATES + 1)];
  double *given = s->forward + RTHS_FORWARD_STATES;
  for (int q = 0; q < 3; q++) given[q] = s->motion[q];
  for (int c = 0; c < RTHS_REACTION_INPUTS; c++) given[3 + c] = corrected_of(s)[c];
  product(RTHS_TILES(RTHS_FORWARD_STATES + 1), RTHS_FORWARD_COLUMNS, rths_data.forward, s->forward, made);
  for (int i = 0; i < RTHS_FORWARD_STATES; i++) s->forward[i] = made[i];
  return made[RTHS_FORWARD_STATES] + against_friction(s->motion);
}

/* The feedback's part of the command within its limits, in V, and what the block must know of them (anti-windup). */
static double feed_back(rths_state *s, double lowest, double highest)
{
  double made[4 * RTHS_TILES(RTHS_BACK_STATES + 1)];
  s->back[RTHS_BACK_STATES] = s->error;
  product(RTHS_TILES(RTHS_BACK_STATES + 1), RTHS_BACK_COLUMNS, rths_data.back, s->back, made);
  const double wanted = made[RTHS_BACK_STATES];
  const double applied = wanted > highest ? highest : wanted < lowest ? lowest : wanted;
  for (int i = 0; i < RTHS_BACK_STATES; i++) {
    s->back[i] = made[i];
    if (applied != wanted) s->back[i] += rths_data.shortfall[i] * (applied - wanted);
  }
  return applied;
}

/* Round to the converter's bits, carrying each rounding error over to the next sample. */
static double shape(rths_state *s, double command)
{
  if (rths_data.bit_v == 0.0 || !isfinite(command)) return command;
  const double wanted = command + s->carried;
  const double rounded = floor(wanted * rths_data.bits_per_v + 0.5) * rths_data.bit_v;
  s->carried = wanted - rounded;
  return rounded;
}

static void compensate(rths_state *s)
{
  const double limit = rths_data.feedback_limit_v, room = rths_data.command_limit_v;
  s->forward_v = feed_forward(s);
  const double lowest = most(-limit, least(-room - s->forward_v, 0.0));
  const double highest = least(limit, most(room - s->forward_v, 0.0));
  s->back_v = feed_back(s, lowest, highest);
  s->command = shape(s, s->forward_v + s->back_v);
}

/* The whole step: the command in V for the samples, before the guard. */
static void step(rths_state *s, const double *ground)
{
  sense(s);
  advance_numerical(s, ground);
  track(s);
  compensate(s);
  for (int k = 0; k < RTHS_LEAD; k++) s->recent[k] = s->recent[k + 1];
}

static void note_sent(rths_state *s)
{
  for (int i = RTHS_SENT - 1; i > 0; i--) s->sent[i] = s->sent[i - 1];
  s->sent[0] = s->command;
}

/* ---- lost samples ---- */

enum { BRIDGES = RTHS_LEAD > 0 && RTHS_ESTIMATES >= 3 * (RTHS_ACCELEROMETERS - 1) };

/* Write the samples in V whose correction by `sense` gives the values in `corrected`. */
static void show(rths_state *s)
{
  double *corrected = corrected_of(s);
  corrected[RTHS_MEASURED_BY] += staircase(s);
#if RTHS_CELL >= 0
  corrected[RTHS_CELL] += rths_data.cell_reads[0] * staircase(s);
#endif
  for (int c = 0; c < RTHS_CHANNELS; c++) {
    const double *matrix = rths_data.correction[c];
    double wanted = corrected[c];
    for (int j = 0; j < 3; j++) wanted -= matrix[4 * j + 3] * s->correction[c][j];
    s->samples[c] = wanted / matrix[15];
  }
}

/* Write the samples that the identified model expects: the table as desired, the floors as the observer expects them.
   Without lead the last samples are kept. */
static void bridge(rths_state *s)
{
  double *corrected = corrected_of(s);
  if (!BRIDGES) return;
  corrected[0] = s->recent[0];
  corrected[RTHS_MEASURED_BY] = s->recent[0];
  for (int round = 0; round < ROUNDS; round++) {
    observe(s);
    for (int i = 0; i < RTHS_ACCELEROMETERS - 1; i++)
      corrected[1 + i] = s->observed[RTHS_OBSERVER_STATES + 2 * (RTHS_ACCELEROMETERS - 1) + i];
  }
#if RTHS_CELL >= 0
  corrected[RTHS_CELL] = 0.0;
  for (int c = 0; c < RTHS_ACCELEROMETERS; c++) corrected[RTHS_CELL] += rths_data.cell_reads[c] * corrected[c];
#endif
  show(s);
}

/* The weight of a sample that came, 0 to 1: it grows over SLOWLY times the length of the gap before it. */
static double share_of_measured(rths_state *s)
{
  if (s->gap_now > 0) {
    if (s->gap_returned == 0) {
      s->gap_missed = s->gap_now;
    } else if (s->gap_now > 1) {
      const int32_t left = s->gap_missed - s->gap_returned / SLOWLY;
      s->gap_missed = s->gap_now > left ? s->gap_now : left;
      s->gap_returned = 0;
    }
    s->gap_now = 0;
  }
  if (s->gap_missed == 0) return 1.0;
  s->gap_returned++;
  const int32_t slowly = SLOWLY * (s->gap_missed - 1);
  const int32_t over = 1 + (slowly < rths_data.longest_return ? slowly : rths_data.longest_return);
  if (s->gap_returned >= over) {
    s->gap_missed = 0;
    s->gap_returned = 0;
    return 1.0;
  }
  const double way = (double)s->gap_returned / (double)over;
  return way * way * (3.0 - 2.0 * way);
}

/* Keep the measured samples and their corrected values; after a gap the correction starts as if the earlier samples had
   equalled the first ones that came. */
static void hear(rths_state *s, int after_gap)
{
  for (int c = 0; c < RTHS_CHANNELS; c++) {
    const double *matrix = rths_data.correction[c];
    double *given = s->came_correction[c];
    s->came[c] = s->samples[c];
    if (after_gap) {
      for (int j = 0; j < 4; j++) given[j] = s->correction[c][j];
      for (int i = 0; i < REMEMBERED; i++) (void)correct(matrix, given, s->came[c]);
    }
    s->came_corrected[c] = correct(matrix, given, s->came[c]);
  }
  s->came_corrected[RTHS_MEASURED_BY] -= staircase(s);
#if RTHS_CELL >= 0
  s->came_corrected[RTHS_CELL] -= rths_data.cell_reads[0] * staircase(s);
#endif
}

/* Replace the samples by those that the step uses after a gap; return whether they are a mix. */
static int give_back(rths_state *s)
{
  const int after_gap = s->gap_now > 0;
  const double share = share_of_measured(s);
  if (share == 1.0 || !BRIDGES) return 0;
  hear(s, after_gap);
  bridge(s);
  for (int c = 0; c < RTHS_CHANNELS; c++) s->samples[c] += share * (s->came[c] - s->samples[c]);
  return 1;
}

/* Write the step's samples; return 0: measured, 1: substituted, 3: a mix. */
static int32_t take_or_bridge(rths_state *s, const rths_inputs *in)
{
  if (!in->came) {
    s->gap_now++;
    bridge(s);
    return 1;
  }
  for (int c = 0; c < RTHS_CHANNELS; c++) s->samples[c] = rths_data.signs[c] * (in->samples_v[c] - s->zeros_v[c]);
  return give_back(s) ? 3 : 0;
}

/* ---- the guard ---- */

static int32_t beyond(rths_state *s, double value, int32_t reason)
{
  s->seen = value;
  return reason;
}

static void take_over(rths_state *s, int32_t reason, double value)
{
  if (s->phase != GUARD_RUNNING) return;
  s->phase = GUARD_BRAKING;
  s->reason = reason;
  s->channel = -1;
  s->seen = value;
}

/* For how long a channel has shown this sample, and how far it should have moved meanwhile. */
static void note_code(rths_state *s, int c, double sample)
{
  const int changed = sample != s->codes[c];
  s->codes[c] = sample;
  s->same[c] = changed ? 0 : s->same[c] + 1;
  for (int by = 0; by < 2; by++) {
    const double now = s->expected[by][c];
    if (changed) {
      s->expected_at[by][c] = now;
      s->moved[by][c] = 0.0;
    }
    s->moved[by][c] = most(s->moved[by][c], fabs(now - s->expected_at[by][c]));
  }
}

static double must_have_moved(const rths_state *s, int c) { return least(s->moved[0][c], s->moved[1][c]); }

static int is_stuck(const rths_state *s, int c)
{
  return (double)s->same[c] * rths_data.dt_s >= STUCK_S && must_have_moved(s, c) > rths_data.limits.stuck[c];
}

static double braking_distance(double velocity)
{
  return velocity * fabs(velocity) * (0.5 / (BRAKE_SHARE * rths_data.limits.acceleration_m_s2));
}

/* Whether a further channel has shown something else than it must for some time. */
static int differs(double *state, double must, double shown, double keeps, double tolerated)
{
  const double share = rths_data.dt_s / COMPARED_S;
  state[LOW_1] = must + keeps * (state[LOW_1] - must);
  state[LOW_2] = state[LOW_1] + keeps * (state[LOW_2] - state[LOW_1]);
  state[OWN_1] = shown + keeps * (state[OWN_1] - shown);
  state[OWN_2] = state[OWN_1] + keeps * (state[OWN_2] - state[OWN_1]);
  const double off = state[OWN_2] - state[LOW_2];
  state[DIFFERENCE] += share * (off * off - state[DIFFERENCE]);
  state[SIZE] += share * (state[LOW_2] * state[LOW_2] - state[SIZE]);
  return state[DIFFERENCE] > DIFFERS * DIFFERS * state[SIZE] + tolerated * tolerated;
}

/* How far a table gets that is braked now, in m, from its measured displacement. */
static double measured_reach(double *state, double place)
{
  const double limit = rths_data.limits.velocity_m_s, dt_s = rths_data.dt_s;
  const double changed = within((place - state[PLACE]) * (1.0 / dt_s), limit);
  state[SPEED] += (changed - state[SPEED]) * dt_s / (VELOCITY_S + dt_s);
  state[PLACE] = place;
  return most(fabs(place), fabs(place + state[SPEED] * REACTION_S + braking_distance(state[SPEED])));
}

/* The channels beside the accelerometers. */
static int32_t check_further(rths_state *s, const double *samples, const double *values)
{
  const rths_limits *limits = &rths_data.limits;
  for (int j = 0; j < RTHS_FURTHER; j++) {
    const int c = RTHS_ACCELEROMETERS + j;
    double *compared = s->compared[j];
    if (limits->duty[j] == UNWATCHED) continue;
    s->channel = c;
    if (!isfinite(samples[c])) return RTHS_NOT_A_NUMBER;
    if (fabs(samples[c]) >= s->saturation_v[c]) return beyond(s, fabs(samples[c]), RTHS_SATURATED);
    if (fabs(values[c]) > limits->abort[c]) return beyond(s, fabs(values[c]), RTHS_LEVEL);
    if (limits->duty[j] == STROKE_SENSOR) {
      const double reached = measured_reach(compared, values[c]);
      const double keeps = 1.0 / (1.0 + 2.0 * PI * COMPARED_HZ * rths_data.dt_s);
      if (reached > limits->stroke_m) return beyond(s, reached, RTHS_MEASURED_STROKE);
      if (differs(compared, s->place_m, values[c], keeps, limits->tolerated[j]))
        return beyond(s, sqrt(compared[DIFFERENCE]), RTHS_DISAGREES);
    } else if (limits->duty[j] == CELL) {
      double shown = 0.0;
      for (int i = 0; i < RTHS_ACCELEROMETERS; i++) shown += limits->reads[j][i] * values[i];
      if (differs(compared, shown, values[c], 0.0, limits->tolerated[j]))
        return beyond(s, sqrt(compared[DIFFERENCE]), RTHS_DISAGREES);
    }
  }
  return RTHS_NONE;
}

static int32_t check_samples(rths_state *s, const double *samples, const double *values)
{
  const rths_limits *limits = &rths_data.limits;
  double force = 0.0;
  for (int c = 0; c < RTHS_ACCELEROMETERS; c++) {
    note_code(s, c, samples[c]);
    force += limits->force_weights[c] * values[c];
  }
  for (int c = 0; c < RTHS_ACCELEROMETERS; c++) {
    s->channel = c;
    if (!isfinite(samples[c])) return RTHS_NOT_A_NUMBER;
    if (fabs(samples[c]) >= s->saturation_v[c]) return beyond(s, fabs(samples[c]), RTHS_SATURATED);
    if (fabs(values[c]) > limits->abort[c]) return beyond(s, fabs(values[c]), RTHS_ACCELERATION);
    if (is_stuck(s, c)) return beyond(s, must_have_moved(s, c), RTHS_STUCK);
  }
  const int32_t reason = check_further(s, samples, values);
  if (reason != RTHS_NONE) return reason;
  s->channel = -1;
  return fabs(force) > limits->force_n ? beyond(s, fabs(force), RTHS_FORCE) : RTHS_NONE;
}

/* The largest displacement in m that stroke limit and command range permit. */
static double farthest(void)
{
  return least(rths_data.limits.stroke_m, rths_data.limits.gain_m_per_v * rths_data.limits.command_v);
}

static int32_t check_command(rths_state *s, double command, double desired_m)
{
  const rths_limits *limits = &rths_data.limits;
  if (!isfinite(command)) return RTHS_NOT_A_NUMBER;
  if (fabs(command) > limits->command_v) return beyond(s, fabs(command), RTHS_COMMAND);
  const double place = limits->gain_m_per_v * command, velocity = (place - s->place_m) * (1.0 / rths_data.dt_s);
  if (fabs(velocity) > limits->velocity_m_s) return beyond(s, fabs(velocity), RTHS_VELOCITY);
  if (fabs(velocity) > limits->gain_m_per_v * limits->command_rate_v_s)
    return beyond(s, fabs(velocity) / limits->gain_m_per_v, RTHS_RATE);
  const double reached = most(fabs(place), fabs(place + braking_distance(velocity)));
  if (reached > farthest()) return beyond(s, reached, RTHS_STROKE);
  if (reached > limits->reach_m) return beyond(s, reached, RTHS_PLANNED_REACH);
  if (fabs(place - desired_m) > limits->deviation_m) return beyond(s, fabs(place - desired_m), RTHS_DEVIATION);
  return RTHS_NONE;
}

static int32_t check_error(rths_state *s)
{
  if (!isfinite(s->error)) return RTHS_NOT_A_NUMBER;
  return fabs(s->error) > rths_data.limits.tracking_error ? beyond(s, fabs(s->error), RTHS_TRACKING) : RTHS_NONE;
}

/* The energy that the table's errors have added to the structure, over that exchanged at the interface. */
static int32_t check_energy(rths_state *s)
{
  const double dt_s = rths_data.dt_s;
  if (isinf(rths_data.limits.energy_ratio)) return RTHS_NONE;
  s->slip_m_s += (s->error - 2.0 * PI * FORGET_HZ * s->slip_m_s) * dt_s;
  s->added_j += s->force * s->slip_m_s * dt_s;
  s->exchanged_j += fabs(s->force * s->motion[1]) * dt_s;
  const double exchanged = s->exchanged_j + rths_data.limits.energy_floor_j;
  if (s->added_j <= rths_data.limits.energy_ratio * exchanged) return RTHS_NONE;
  return beyond(s, exchanged > 0.0 ? s->added_j / exchanged : (double)INFINITY, RTHS_ENERGY);
}

/* The rate in rad/s of the critically damped return to zero within the limits. */
static double return_rate(void)
{
  const rths_limits *limits = &rths_data.limits;
  const double fastest = least(limits->velocity_m_s, limits->gain_m_per_v * limits->command_rate_v_s);
  const double by_velocity = exp(1.0) * fastest / farthest();
  const double by_acceleration = sqrt(BRAKE_SHARE * limits->acceleration_m_s2 / farthest());
  return least(RETURN_RATE, least(by_velocity, by_acceleration));
}

/* Advance the commanded motion by one step on its way to rest: it brakes, then it returns. */
static void ramp_down(rths_state *s)
{
  const double rate = return_rate(), dt_s = rths_data.dt_s;
  double place = s->place_m, velocity = s->velocity_m_s;
  int ready = 1;
  if (s->phase == GUARD_BRAKING) {
    const double less = BRAKE_SHARE * rths_data.limits.acceleration_m_s2 * dt_s;
    velocity = copysign(most(fabs(velocity) - less, 0.0), velocity);
    place += velocity * dt_s;
    ready = velocity == 0.0;
  } else if (s->phase == GUARD_RETURNING) {
    const double slope = (velocity + rate * place) * dt_s, decay = exp(-rate * dt_s);
    place = (place + slope) * decay;
    velocity = (velocity - rate * slope) * decay;
    ready = fabs(place) < AT_REST_M && fabs(velocity) < AT_REST_M * rate;
    if (ready) place = velocity = 0.0;
  }
  s->place_m = place;
  s->velocity_m_s = velocity;
  if (ready && s->phase < GUARD_STOPPED) s->phase++;
}

/* Leave the command as it is, or write the one that may be sent instead; samples that did not come are not judged. */
static void guard(rths_state *s, int came, const double *samples, const double *values)
{
  if (s->phase == GUARD_RUNNING) {
    int32_t reason = came ? check_samples(s, samples, values) : RTHS_NONE;
    if (reason == RTHS_NONE) reason = check_command(s, s->command, s->motion[2]);
    if (reason == RTHS_NONE) reason = check_error(s);
    if (reason == RTHS_NONE) reason = check_energy(s);
    if (reason == RTHS_NONE) {
      const double place = rths_data.limits.gain_m_per_v * s->command;
      s->velocity_m_s = (place - s->place_m) * (1.0 / rths_data.dt_s);
      s->place_m = place;
      return;
    }
    s->phase = GUARD_BRAKING;
    s->reason = reason;
  }
  ramp_down(s);
  s->command = s->place_m / rths_data.limits.gain_m_per_v;
}

/* ---- the test ---- */

static int32_t record_begins(void) { return rths_data.still_steps + rths_data.ramp_steps; }

/* The factor on the command: 0 at rest, rising in the ramp-up, then 1. */
static double share_of(int32_t k)
{
  if (k < rths_data.still_steps) return 0.0;
  if (k >= record_begins()) return 1.0;
  return (double)(k + 1 - rths_data.still_steps) / (double)(rths_data.ramp_steps + 1);
}

static void stop_at_rest(rths_state *s, int32_t reason, int32_t channel, double seen)
{
  s->state = RTHS_STOPPED;
  s->reason = reason;
  s->channel = channel;
  s->seen = seen;
}

/* Count lost samples in a row; return whether they are too many. */
static int lost_too_many(rths_state *s, const rths_inputs *in)
{
  s->lost_in_a_row = in->came ? 0 : s->lost_in_a_row + 1;
  return s->lost_in_a_row > rths_data.lost_samples;
}

/* Mean and noise of every channel at rest; a channel that does not rest stops the test before anything moves. */
static void measure_zeros(rths_state *s, const rths_inputs *in)
{
  if (!in->came || s->zeros_taken >= rths_data.zero_steps) return;
  s->zeros_taken++;
  for (int c = 0; c < RTHS_CHANNELS; c++) {
    if (!isfinite(in->samples_v[c])) {
      stop_at_rest(s, RTHS_NOT_A_NUMBER, c, in->samples_v[c]);
      return;
    }
    const double off = in->samples_v[c] - s->zeros_v[c];
    s->zeros_v[c] += off / (double)s->zeros_taken;
    s->squares_v2[c] += off * (in->samples_v[c] - s->zeros_v[c]);
  }
  if (s->zeros_taken < rths_data.zero_steps) return;
  for (int c = 0; c < RTHS_CHANNELS; c++) {
    const double noise = sqrt(s->squares_v2[c] / (double)s->zeros_taken), zero = fabs(s->zeros_v[c]);
    s->saturation_v[c] = rths_data.limits.saturation_v[c] - zero;
    if (zero > rths_data.limits.zero_limit_v[c]) {
      stop_at_rest(s, RTHS_ZERO_TOO_LARGE, c, zero);
      return;
    }
    if (noise > rths_data.limits.noise_limit_v[c]) {
      stop_at_rest(s, RTHS_NOISE_TOO_LARGE, c, noise);
      return;
    }
  }
}

static void armed(rths_state *s, const rths_inputs *in)
{
  if (in->stop) {
    stop_at_rest(s, RTHS_OPERATOR, -1, (double)NAN);
  } else if (lost_too_many(s, in)) {
    stop_at_rest(s, RTHS_LOST, -1, (double)s->lost_in_a_row);
  } else {
    const int ready = s->zeros_taken >= rths_data.zero_steps;
    measure_zeros(s, in);
    if (ready && in->start && in->came) s->state = RTHS_RAMP_UP;
  }
}

/* One step of a test that was begun; return how its samples came. */
static int32_t conduct(rths_state *s, const rths_inputs *in)
{
  static const double at_rest[3] = {0.0, 0.0, 0.0};
  const int32_t k = s->step, row = k - record_begins();
  if (lost_too_many(s, in)) take_over(s, RTHS_LOST, (double)s->lost_in_a_row);
  const int32_t lost = take_or_bridge(s, in);
  const double *corrected = corrected_of(s);
  if (in->stop) take_over(s, RTHS_OPERATOR, (double)NAN);
  if (row >= rths_data.record_steps) take_over(s, RTHS_END, (double)NAN);
  step(s, row >= 0 && row < rths_data.record_steps ? in->ground : at_rest);
  s->share = share_of(k);
  s->command *= s->share;
  const double *samples = lost == 3 ? s->came : s->samples, *values = lost == 3 ? s->came_corrected : corrected;
  s->error += corrected[RTHS_MEASURED_BY] - values[RTHS_MEASURED_BY];
  guard(s, lost != 1, samples, values);
  note_sent(s);
  s->step = k + 1;
  if (s->phase == GUARD_STOPPED) s->state = RTHS_STOPPED;
  else if (s->phase != GUARD_RUNNING) s->state = RTHS_RAMP_DOWN;
  else s->state = row >= 0 ? RTHS_RUNNING : RTHS_RAMP_UP;
  return lost;
}

/* Write the outputs of this step. */
static void tell(rths_state *s, int32_t lost, rths_outputs *out)
{
  const int32_t next = s->step - record_begins();
  const int begun = s->state == RTHS_RAMP_UP || s->state == RTHS_RUNNING || s->state == RTHS_RAMP_DOWN;
  out->command_v = s->command;
  out->state = s->state;
  out->reason = s->reason;
  out->channel = s->channel;
  out->seen = s->seen;
  out->row = begun && next >= 0 && next < rths_data.record_steps ? next : -1;
  out->lost = lost;
  out->share = s->share;
  out->base_shear_n = s->force;
  out->forward_v = s->forward_v;
  out->back_v = s->back_v;
  out->tracking_error_m_s2 = s->error;
  out->case_number = rths_data.case_number;
  out->model_number = rths_data.model_number;
  memcpy(out->desired, s->motion, sizeof out->desired);
  memcpy(out->corrected, corrected_of(s), sizeof out->corrected);
  memcpy(out->zeros_v, s->zeros_v, sizeof out->zeros_v);
  memcpy(out->estimated, s->observed + RTHS_OBSERVER_STATES, sizeof out->estimated);
#if RTHS_LAWS > 0
  memcpy(out->law_force_n, s->columns + RTHS_STATES + 1, sizeof out->law_force_n);
#else
  out->law_force_n[0] = 0.0;
#endif
}

void rths_reset(rths_state *s)
{
  memset(s, 0, sizeof *s);
  s->channel = -1;
  s->seen = (double)NAN;
  for (int c = 0; c < RTHS_ACCELEROMETERS; c++) s->codes[c] = (double)NAN;
}

void rths_step(rths_state *s, const rths_inputs *in, rths_outputs *out)
{
  int32_t lost = in->came ? 0 : 1;
  if (s->state == RTHS_IDLE) {
    if (in->start && !in->stop) s->state = RTHS_ARMED;
  } else if (s->state == RTHS_ARMED) {
    armed(s, in);
  } else if (s->state != RTHS_STOPPED) {
    lost = conduct(s, in);
  }
  if (s->state == RTHS_IDLE || s->state == RTHS_ARMED || s->state == RTHS_STOPPED) s->command = 0.0;
  tell(s, lost, out);
}
