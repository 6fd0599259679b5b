/* The designed step of one real-time hybrid simulation in C99.

   rths_sizes.h and rths_data.c hold the numbers of one case; this file and rths_step.c are the same for all cases.
   Call rths_reset once, then rths_step once per sample interval, always from the same thread. Nothing here allocates,
   blocks, prints or keeps anything outside of rths_state. Units are SI; signals of the converters are in V. */

#ifndef RTHS_STEP_H
#define RTHS_STEP_H

#include <stdint.h>

#include "rths_sizes.h"

#define RTHS_PLACES(count) ((count) > 0 ? (count) : 1) /* C knows no arrays of no elements */
#define RTHS_TILES(rows) (((rows) + 3) / 4)            /* matrices are stored in tiles of four rows */

#define RTHS_CHANNELS (RTHS_ACCELEROMETERS + RTHS_FURTHER)
#define RTHS_STATES (2 * RTHS_PAIRS)                       /* of the computed storeys */
#define RTHS_COLUMNS (RTHS_STATES + 2 + RTHS_LAW_STOREYS)  /* their states, then ground, forces of laws, base shear */
#define RTHS_PUSHES (2 + RTHS_LAW_STOREYS)
#define RTHS_OBSERVED (RTHS_OBSERVER_STATES + RTHS_ESTIMATES + 1)
#define RTHS_OBSERVER_COLUMNS (RTHS_OBSERVER_STATES + RTHS_OBSERVER_INPUTS)
#define RTHS_FORWARD_COLUMNS (RTHS_FORWARD_STATES + 3 + RTHS_REACTION_INPUTS)
#define RTHS_BACK_COLUMNS (RTHS_BACK_STATES + 1)
#define RTHS_FLOOR_COLUMNS (RTHS_FLOOR_STATES + 1)
#define RTHS_LAW_NUMBERS 16
#define RTHS_LAW_MEMORY 32
#define RTHS_TERMS 7          /* of a polynomial */
#define RTHS_TABLE_COLUMNS 56 /* RTHS_TERMS times eight */

typedef enum {
  RTHS_IDLE,      /* the command is 0 V; `start` arms */
  RTHS_ARMED,     /* the command is 0 V while the zeros are measured; then `start` begins */
  RTHS_RAMP_UP,   /* at rest, then the share of the command that is sent grows from zero to one */
  RTHS_RUNNING,   /* the record */
  RTHS_RAMP_DOWN, /* the guard brakes and returns to 0 V */
  RTHS_STOPPED    /* the command is 0 V until rths_reset */
} rths_test_state;

/* why a test ended; the numbers are those of rths */
typedef enum {
  RTHS_NONE = 0,
  RTHS_STROKE = 1,
  RTHS_VELOCITY = 2,
  RTHS_ACCELERATION = 3,
  RTHS_FORCE = 4,
  RTHS_COMMAND = 5,
  RTHS_TRACKING = 6,
  RTHS_NOT_A_NUMBER = 7,
  RTHS_SATURATED = 8,
  RTHS_STUCK = 9,
  RTHS_RATE = 10,
  RTHS_ENERGY = 11,
  RTHS_LOST = 12,
  RTHS_OPERATOR = 15, /* the input `stop` */
  RTHS_END = 20,      /* the end of the record */
  RTHS_MEASURED_STROKE = 21,
  RTHS_LEVEL = 22,
  RTHS_DISAGREES = 23,
  RTHS_PLANNED_REACH = 24,
  RTHS_DEVIATION = 25,
  RTHS_ZERO_TOO_LARGE = 100, /* while armed: a channel does not rest near 0 V */
  RTHS_NOISE_TOO_LARGE = 101 /* while armed: a channel does not rest */
} rths_reason;

typedef struct {
  double samples_v[RTHS_CHANNELS]; /* of this instant, in V; not looked at unless `came` */
  double ground[3]; /* row `row` of the record: acceleration m/s^2, velocity m/s, displacement m */
  int came;         /* 1: there are samples of this instant, 0: they were lost or late */
  int start;        /* 1: arm; once the zeros are measured: begin */
  int stop;         /* 1: bring the table to rest */
} rths_inputs;

typedef struct {
  double command_v;    /* to be written to the converter now */
  int32_t state;       /* rths_test_state of this step */
  int32_t reason;      /* rths_reason why the test ended */
  int32_t channel;     /* which the reason concerns, -1: none */
  int32_t row;         /* of the record that the next call needs as `ground`, -1: none */
  int32_t lost;        /* 0: measured samples, 1: substituted ones, 3: a mix of both after a gap */
  double seen;         /* the value that exceeded its limit, in the limit's unit */
  double share;        /* of the command that is sent: 0 at rest, growing in the ramp-up, then 1 */
  double desired[3];   /* interface at k + n_p: acceleration m/s^2, velocity m/s, displacement m, absolute */
  double corrected[RTHS_CHANNELS]; /* each channel in its unit, as the step used it */
  double zeros_v[RTHS_CHANNELS];   /* mean of each channel at rest */
  double estimated[RTHS_ESTIMATES]; /* of the Kalman filter */
  double base_shear_n;  /* of the specimen on the interface, at k + n_p */
  double forward_v;     /* the feedforward's part of the command */
  double back_v;        /* the feedback's part */
  double tracking_error_m_s2; /* desired minus measured, of t_k */
  double law_force_n[RTHS_PLACES(RTHS_LAW_STOREYS)]; /* of the laws of each such storey, beside its spring */
  double case_number, model_number; /* first 48 bits of the checksums, for a log of doubles */
} rths_outputs;

/* What the guard checks; an infinite limit is off. */
typedef struct {
  double stroke_m, velocity_m_s, acceleration_m_s2, force_n, command_v, tracking_error, gain_m_per_v;
  double command_rate_v_s, energy_ratio, energy_floor_j, reach_m, deviation_m;
  double force_weights[RTHS_ACCELEROMETERS]; /* N per m/s^2 */
  double saturation_v[RTHS_CHANNELS];
  double stuck[RTHS_ACCELEROMETERS]; /* m/s^2 that a channel must have missed to be stuck */
  double abort[RTHS_CHANNELS];
  int32_t duty[RTHS_PLACES(RTHS_FURTHER)]; /* 0 unwatched, 1 watched, 2 displacement of the table, 3 load cell */
  double tolerated[RTHS_PLACES(RTHS_FURTHER)];
  double reads[RTHS_PLACES(RTHS_FURTHER)][RTHS_ACCELEROMETERS]; /* N per m/s^2 of a load cell */
  double zero_limit_v[RTHS_CHANNELS], noise_limit_v[RTHS_CHANNELS]; /* at rest */
} rths_limits;

/* A storey law's tables: powers as curves of polynomials, and what degrades with the dissipated energy. */
typedef struct {
  int32_t code, storey; /* which law; which of the storeys that have laws */
  double gives;         /* fall of the drift's rate in m/s per N */
  double numbers[RTHS_LAW_NUMBERS];
  int64_t curve_begin, table_begin, table_last;
  int32_t curve_shift, table_shift;
  int32_t degrades;
  double curve[RTHS_PLACES(RTHS_CURVE_ROWS) * 8];
  double table[RTHS_PLACES(RTHS_TABLE_ROWS) * RTHS_TABLE_COLUMNS];
} rths_law;

typedef struct {
  char case_name[128], case_sha256[65], model_sha256[65], made_by[64];
  double case_number, model_number;
  double dt_s;
  int32_t zero_steps, still_steps, ramp_steps, record_steps, lost_samples, longest_return;
  double signs[RTHS_CHANNELS];
  double correction[RTHS_CHANNELS][16]; /* channel, column by column: three states and the sample, rows likewise */
  double ripple_m_s2_per_v, ripple_sum_m_s2_per_v;
  double observer[RTHS_TILES(RTHS_OBSERVED) * RTHS_OBSERVER_COLUMNS * 4];
  double force_recent[RTHS_PLACES(RTHS_LEAD)]; /* N per m/s^2 of the desired accelerations at k .. k + n_p - 1 */
  double force_returned;                       /* N per m/s^2, the mutual dependence solved */
  double direct;                               /* acceleration of the interface per force of the same instant */
  double turn[4][RTHS_PAIRS];
  double push[RTHS_TILES(RTHS_STATES) * RTHS_PUSHES * 4];
  double drifts[RTHS_PLACES(RTHS_TILES(RTHS_DRIFT_ROWS) * RTHS_COLUMNS * 4)];
  double interface_motion[RTHS_COLUMNS * 4];
  double forward[RTHS_TILES(RTHS_FORWARD_STATES + 1) * RTHS_FORWARD_COLUMNS * 4];
  double friction_v, per_scale, linear_s_per_m, lead_s;
  double back[RTHS_TILES(RTHS_BACK_STATES + 1) * RTHS_BACK_COLUMNS * 4];
  double shortfall[RTHS_PLACES(RTHS_BACK_STATES)];
  double command_limit_v, feedback_limit_v;
  double bit_v, bits_per_v; /* 0: the step does not round */
  double floors[RTHS_PLACES(RTHS_TILES(RTHS_FLOOR_STATES + RTHS_EXPECTED_FLOORS) * RTHS_FLOOR_COLUMNS * 4)];
  double cell_reads[RTHS_ACCELEROMETERS];
  rths_limits limits;
  rths_law laws[RTHS_PLACES(RTHS_LAWS)];
  double bell[RTHS_PLACES(RTHS_BELL_ROWS) * 8];
} rths_numbers;

extern const rths_numbers rths_data;

/* All that the step remembers; its caller owns it. */
typedef struct {
  int32_t state, step, zeros_taken, lost_in_a_row;
  double zeros_v[RTHS_CHANNELS], squares_v2[RTHS_CHANNELS], saturation_v[RTHS_CHANNELS];
  /* samples, and their return after a gap */
  double samples[RTHS_CHANNELS];
  double correction[RTHS_CHANNELS][4];
  int32_t gap_missed, gap_returned, gap_now;
  double came[RTHS_CHANNELS], came_corrected[RTHS_CHANNELS], came_correction[RTHS_CHANNELS][4];
  /* the step */
  double observer[RTHS_OBSERVER_STATES + RTHS_CHANNELS]; /* states, then the corrected channels */
  double observed[RTHS_TILES(RTHS_OBSERVED) * 4];        /* next states, estimates, known force */
  double recent[RTHS_LEAD + 1];                          /* desired accelerations at k .. k + n_p */
  double columns[RTHS_COLUMNS];
  double motion[3], free_motion[4];
  double force, error, command, forward_v, back_v, share;
  double forward[RTHS_FORWARD_COLUMNS], back[RTHS_BACK_COLUMNS];
  double floors[2][RTHS_FLOOR_COLUMNS];
  double expected[2][RTHS_ACCELEROMETERS];
  double carried;
  double sent[RTHS_SENT]; /* commands in V, the latest first */
  double shear[2];        /* base shear of the last instant and of the one before */
  double law_memory[RTHS_PLACES(RTHS_LAWS)][RTHS_LAW_MEMORY], law_force[RTHS_PLACES(RTHS_LAWS)];
  /* the guard */
  int32_t phase, reason, channel;
  double place_m, velocity_m_s; /* of the command */
  double codes[RTHS_ACCELEROMETERS], expected_at[2][RTHS_ACCELEROMETERS], moved[2][RTHS_ACCELEROMETERS];
  int64_t same[RTHS_ACCELEROMETERS];
  double slip_m_s, added_j, exchanged_j, seen;
  double compared[RTHS_PLACES(RTHS_FURTHER)][8];
} rths_state;

/* Bring a state to RTHS_IDLE. */
void rths_reset(rths_state *s);

/* Compute one step; `out->command_v` is always finite and always the guard's. */
void rths_step(rths_state *s, const rths_inputs *in, rths_outputs *out);

#endif
