/* A target that steps the test itself: the host (rths run, a rig of kind target) sends record and start and fetches the
   log; the page is docs/reference/stepping_target.md of rths. POSIX; link with rths_step.c, rths_data.c and -lm.

       cc -std=c99 -O2 -o udp_target udp_target.c rths_step.c rths_data.c -lm
       ./udp_target 127.0.0.1:47810 127.0.0.1:47811

   read_samples and write_command at the end are yours; here they are a simulated table. */

#define _POSIX_C_SOURCE 200809L

#include "rths_step.h"

#include <arpa/inet.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>

#ifndef WATCHDOG_S
#define WATCHDOG_S 0.5 /* watchdog_s of the rig file: the host is silent for so long */
#endif
#ifndef COUNTED_CLOCK
#define COUNTED_CLOCK 0 /* 1: a late instant is no lost sample, as of a simulated table */
#endif
#define REST_S 3.0     /* logged at rest after a whole record */
#define LOG_ROWS 16384 /* the newest ones are kept */

enum { HEAD = 40, ABOUT = 64, MOST_DATA = 1400, MOST_RECORD = (MOST_DATA - HEAD) / 24 };
enum { COLUMNS = 2 * RTHS_CHANNELS + 3 + 1 + 1 + RTHS_ESTIMATES + RTHS_LAW_STOREYS + 5 };
enum { MOST_LOG = (MOST_DATA - HEAD - ABOUT) / (8 * COLUMNS) };
enum { ASK, BEGIN, RECORD, REST };

static struct {
  rths_state step;
  rths_outputs out;
  uint32_t session, held, faults; /* held: rows of the record */
  int32_t made, resting;          /* rows of the log; rows after the end */
  int begun, stop;
  double heard_s; /* when the host was heard last */
  double record[RTHS_RECORD][3];
  double log[LOG_ROWS][COLUMNS];
} target;

static void read_samples(double samples_v[RTHS_CHANNELS]);
static void write_command(double volts);

/* All numbers of a frame are little-endian. */
static uint32_t get_u32(const uint8_t *at)
{
  return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static void put_u32(uint8_t *at, uint32_t value)
{
  for (int i = 0; i < 4; i++) at[i] = (uint8_t)(value >> 8 * i);
}

static double get_f64(const uint8_t *at)
{
  const uint64_t bits = (uint64_t)get_u32(at) | (uint64_t)get_u32(at + 4) << 32;
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

static void put_f64(uint8_t *at, double value)
{
  uint64_t bits;
  memcpy(&bits, &value, sizeof bits);
  put_u32(at, (uint32_t)bits);
  put_u32(at + 4, (uint32_t)(bits >> 32));
}

/* Whether a test is under way, its log included. */
static int moves(void) { return target.begun; }

static int32_t told_state(void)
{
  return target.begun && target.out.state == RTHS_STOPPED ? RTHS_RAMP_DOWN : target.out.state;
}

static void take_record(const uint8_t *rows, uint32_t first, uint32_t count)
{
  if (first > RTHS_RECORD || count > RTHS_RECORD - first || (first > target.held && first > 0)) return;
  for (uint32_t i = 0; i < 3 * count; i++) {
    const double value = get_f64(rows + 8 * i);
    if (!isfinite(value)) return;
    target.record[first + i / 3][i % 3] = value;
  }
  target.held = first + count;
}

static void begin(uint32_t session)
{
  rths_reset(&target.step);
  memset(&target.out, 0, sizeof target.out);
  target.out.row = -1;
  target.out.state = RTHS_ARMED;
  target.out.case_number = rths_data.case_number;
  target.session = session;
  target.faults = 0;
  target.made = target.resting = 0;
  target.stop = 0;
  target.begun = 1;
}

/* Let a datagram of the host count; return the size of the answer, 0 for none. */
static size_t attend(const uint8_t *in, size_t size, double now_s, uint8_t *out)
{
  if (size < HEAD || size > MOST_DATA || memcmp(in, "RTC1", 4) != 0 || (size - HEAD) % 24) return 0;
  const uint32_t session = get_u32(in + 4), number = get_u32(in + 8), order = get_u32(in + 16);
  const uint32_t rows = (uint32_t)((size - HEAD) / 24);
  if (order > REST || (rows > 0) != (order == RECORD)) return 0;
  if (session == target.session) {
    target.heard_s = now_s;
    if (order == REST) target.stop = 1;
  } else if (session == target.session + 1 && !moves()) {
    if (order == RECORD) take_record(in + HEAD, number, rows);
    if (order == BEGIN && target.held == RTHS_RECORD) {
      begin(session);
      target.heard_s = now_s;
    }
  }
  const int32_t oldest = target.made > LOG_ROWS ? target.made - LOG_ROWS : 0;
  const int32_t wanted = number < INT32_MAX ? (int32_t)number : INT32_MAX, first = wanted > oldest ? wanted : oldest;
  int32_t count = order == ASK || order == REST ? target.made - first : 0;
  count = count < 0 ? 0 : count > MOST_LOG ? MOST_LOG : count;
  const double about[8] = {rths_data.case_number, rths_data.model_number, rths_data.dt_s, COLUMNS,
                           target.made, target.out.reason, target.out.channel, target.out.seen};
  memcpy(out, "RTS1", 4);
  put_u32(out + 4, target.session);
  put_u32(out + 8, (uint32_t)first);
  put_u32(out + 12, target.held);
  put_u32(out + 16, (uint32_t)told_state());
  put_u32(out + 20, target.faults);
  put_f64(out + 24, now_s);
  put_f64(out + 32, target.out.command_v);
  for (int i = 0; i < 8; i++) put_f64(out + HEAD + 8 * i, about[i]);
  uint8_t *at = out + HEAD + ABOUT;
  for (int32_t k = first; k < first + count; k++)
    for (int i = 0; i < COLUMNS; i++, at += 8) put_f64(at, target.log[k % LOG_ROWS][i]);
  return (size_t)(at - out);
}

static double *put_all(double *to, const double *from, int count)
{
  memcpy(to, from, (size_t)count * sizeof *to);
  return to + count;
}

/* Log a step: the columns of a raw log of rths, in their order. */
static void note(const rths_inputs *in, double compute_ns)
{
  const rths_outputs *out = &target.out;
  double *to = target.log[target.made % LOG_ROWS];
  to = put_all(to, out->corrected, RTHS_CHANNELS);
  to = put_all(to, out->desired, 3);
  *to++ = out->command_v;
  *to++ = out->base_shear_n;
  to = put_all(to, out->estimated, RTHS_ESTIMATES);
  to = put_all(to, out->law_force_n, RTHS_LAW_STOREYS);
  to = put_all(to, in->samples_v, RTHS_CHANNELS);
  *to++ = 0.0;
  *to++ = 0.0;
  *to++ = out->lost;
  *to++ = out->state;
  *to = compute_ns;
  target.made++;
}

static double clock_s(void)
{
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* One instant of the test; `came` is 0 where it is late by an interval. */
static void instant(int came, double now_s)
{
  rths_inputs in = {.came = came, .start = 1};
  const int logged = target.step.state >= RTHS_RAMP_UP;
  if (now_s - target.heard_s > WATCHDOG_S) {
    target.faults |= 1;
    target.stop = 1;
  }
  in.stop = target.stop && target.step.state >= RTHS_ARMED;
  read_samples(in.samples_v);
  if (target.out.row >= 0) memcpy(in.ground, target.record[target.out.row], sizeof in.ground);
  const double begun_s = clock_s();
  rths_step(&target.step, &in, &target.out);
  write_command(target.out.command_v);
  if (logged) note(&in, 1e9 * (clock_s() - begun_s));
  if (target.out.state != RTHS_STOPPED) return;
  target.resting++;
  if (target.out.reason != RTHS_END || target.stop || target.resting * rths_data.dt_s > REST_S) {
    target.begun = 0;
    target.held = 0;
    printf("session %lu ended with reason %ld after %ld steps\n", (unsigned long)target.session, (long)target.out.reason,
           (long)target.made);
    fflush(stdout);
  }
}

static int fail(const char *sentence)
{
  fprintf(stderr, "udp_target: %s\n", sentence);
  exit(2);
}

static struct sockaddr_in end_of(const char *text)
{
  struct sockaddr_in end = {.sin_family = AF_INET};
  const char *colon = strchr(text, ':');
  char address[16] = "";
  if (!colon || colon - text > 15) fail("an end of the cable is ADDRESS:PORT");
  memcpy(address, text, (size_t)(colon - text));
  end.sin_port = htons((uint16_t)atoi(colon + 1));
  if (inet_pton(AF_INET, address, &end.sin_addr) != 1 || end.sin_addr.s_addr == 0)
    fail("an end of the cable is one IPv4 address in numbers");
  return end;
}

static int cable(const char *own, const char *peer)
{
  struct sockaddr_in here = end_of(own), there = end_of(peer);
  socklen_t length = sizeof here;
  const int door = socket(AF_INET, SOCK_DGRAM, 0);
  if (bind(door, (struct sockaddr *)&here, sizeof here) != 0 ||
      connect(door, (struct sockaddr *)&there, sizeof there) != 0)
    fail("cannot use this end of the cable; choose another port or address");
  getsockname(door, (struct sockaddr *)&here, &length);
  printf("case %.12s, model %.12s, listening at port %d\n", rths_data.case_sha256, rths_data.model_sha256,
         ntohs(here.sin_port));
  fflush(stdout);
  return door;
}

int main(int words, char **word)
{
  uint8_t in[MOST_DATA + 1], out[MOST_DATA];
  if (words != 3) fail("usage: udp_target OWN:PORT PEER:PORT");
  const int door = cable(word[1], word[2]);
  rths_reset(&target.step);
  target.out.row = -1;
  for (double due_s = clock_s();;) {
    double left_s = moves() ? due_s - clock_s() : 0.02;
    left_s = left_s < 0.0 ? 0.0 : left_s;
    struct timespec longest = {.tv_nsec = (long)(1e9 * (left_s < 0.02 ? left_s : 0.02))};
    fd_set doors;
    FD_ZERO(&doors);
    FD_SET(door, &doors);
    if (pselect(door + 1, &doors, NULL, NULL, &longest, NULL) > 0) {
      const ssize_t got = recv(door, in, sizeof in, MSG_DONTWAIT);
      const size_t size = got > 0 ? attend(in, (size_t)got, clock_s(), out) : 0;
      if (size > 0) (void)send(door, out, size, 0);
    }
    const double now_s = clock_s();
    if (!moves()) {
      due_s = now_s;
    } else if (now_s >= due_s) {
      instant(COUNTED_CLOCK || now_s < due_s + rths_data.dt_s, now_s);
      due_s += rths_data.dt_s;
    }
  }
}

/* From here on: a simulated table of 14 Hz with a rigid specimen, instead of your converters. */

static struct { double command_v, place_m, velocity_m_s; } table;

static void read_samples(double samples_v[RTHS_CHANNELS])
{
  const double w = 88.0, volts_per_m_s2 = 0.102, dt_s = rths_data.dt_s;
  const double aim_m = rths_data.limits.gain_m_per_v * table.command_v;
  const double acceleration = w * w * (aim_m - table.place_m) - 1.4 * w * table.velocity_m_s;
  table.velocity_m_s += acceleration * dt_s;
  table.place_m += table.velocity_m_s * dt_s;
  for (int c = 0; c < RTHS_CHANNELS; c++) samples_v[c] = volts_per_m_s2 * acceleration;
}

static void write_command(double volts) { table.command_v = volts; }
