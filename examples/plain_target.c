/* A target of the plain link (docs/reference/plain_link.md) in C99, with a simulated table for a PC (POSIX).
 *
 *     cc -std=c99 -O2 -o plain_target plain_target.c
 *     ./plain_target 127.0.0.1:47810 127.0.0.1:47811 runner        the runner has the clock
 *     ./plain_target 127.0.0.1:47810 127.0.0.1:47811 0.001         this target has it, an instant every 1 ms
 *
 * The upper part is the target: no heap, no operating system; all of its state is in one struct. For a table of your
 * own, write read_samples and write_command, and call `attend` for each datagram, `watch` as often as you can, and with
 * a clock of your own `instant` at each of its instants. The lower part is the PC.
 */
#define _POSIX_C_SOURCE 200809L
#include <stdint.h>
#include <string.h>

#define CHANNELS 3
#define COMMAND_BYTES 40
#define SAMPLES_BYTES (COMMAND_BYTES + 8 * CHANNELS)
#ifndef WATCHDOG_S
#define WATCHDOG_S 0.15     /* watchdog_s of the rig file */
#endif
#define RANGE_V 10.0        /* of the output; converters.range_v of the rig file is not larger */
#define FASTEST_V_S 130.0   /* the output moves no faster */
#define MADE_UP_S 0.01      /* longest pause whose movement one command may make up for */
#define COASTS_S 0.05       /* in which the output comes to a stand while no command comes */
#ifndef INTERVAL_S
#define INTERVAL_S 0.001    /* of the runner's clock; a clock of this target states its own */
#endif
#define REST_V_S 10.0       /* of the way to rest: from the whole range it takes 1 s */

enum { ASK, BEGIN, COMMAND, REST };
enum { RUNNING = 1, RESTING, AT_REST };
enum { WATCHDOG = 1, BAD_COMMAND = 8, RATE = 64 };

struct target {
    int of_target;                      /* this target has the clock */
    uint32_t session, last, state, faults;
    uint32_t acting, waiting, instant;  /* numbers of the acting command, of one that waits, of the next instant */
    double output_v, waiting_v, acting_v, step_v; /* step_v: by which the commands move in an interval */
    double interval_s;
    double fed_s, moved_s, latched_s;   /* when a command counted, the output moved, a command was put out last */
    int late;                           /* intervals since then without a command */
    double samples_v[CHANNELS];
};

/* These two are yours. */
static void read_samples(double volts[CHANNELS], double now_s);
static void write_command(double volts, double now_s);

static uint32_t get_u32(const uint8_t *at)
{
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static void put_u32(uint8_t *at, uint32_t value)
{
    for (int i = 0; i < 4; i++)
        at[i] = (uint8_t)(value >> 8 * i);
}

static double get_f64(const uint8_t *at)
{
    uint64_t bits = (uint64_t)get_u32(at) | (uint64_t)get_u32(at + 4) << 32;
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

static double within(double value, double limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

static void start(struct target *t, double interval_s)
{
    memset(t, 0, sizeof *t);
    t->of_target = interval_s > 0.0;
    t->interval_s = t->of_target ? interval_s : INTERVAL_S;
    t->state = AT_REST;
}

static void rest(struct target *t, uint32_t fault, double now_s)
{
    if (t->state == RUNNING) {
        t->state = RESTING;
        t->moved_s = now_s;
        t->faults |= fault;
    }
}

/* Move the output to a voltage, no faster than it may move. */
static void move(struct target *t, double volts, double now_s)
{
    t->output_v += within(volts - t->output_v, FASTEST_V_S * within(now_s - t->moved_s, MADE_UP_S));
    t->moved_s = now_s;
    write_command(t->output_v, now_s);
}

/* Put the waiting command out. */
static void latch(struct target *t, double now_s)
{
    if (t->waiting == 0 || t->state != RUNNING)
        return;
    t->step_v = (t->waiting_v - t->acting_v) / (double)(t->waiting - t->acting);
    t->acting = t->waiting;
    t->acting_v = t->waiting_v;
    t->waiting = 0;
    t->latched_s = now_s;
    t->late = 0;
    move(t, t->acting_v, now_s);
}

/* While the next command is late, go on by the last step, evenly slower. */
static void coast(struct target *t, double now_s)
{
    double most = COASTS_S / t->interval_s, late = ++t->late < most ? t->late : most;
    move(t, within(t->acting_v + t->step_v * (late - late * late / (2.0 * most)), RANGE_V), now_s);
}

static void begin(struct target *t, uint32_t session, double now_s)
{
    t->session = session;
    t->state = RUNNING;
    t->faults &= ~(uint32_t)(WATCHDOG | BAD_COMMAND | RATE);
    t->last = t->acting = t->waiting = t->instant = 0;
    t->output_v = t->acting_v = t->step_v = 0.0;
    t->late = 0;
    t->fed_s = t->moved_s = t->latched_s = now_s;
}

/* Let a well-formed frame count. */
static void count(struct target *t, const uint8_t *frame, double now_s)
{
    uint32_t session = get_u32(frame + 4), number = get_u32(frame + 8), order = get_u32(frame + 16);
    double volts = get_f64(frame + 32);
    if (order == BEGIN && t->state == AT_REST && session == t->session + 1 && number == 0)
        begin(t, session, now_s);
    if ((order != COMMAND && order != REST) || session != t->session || number <= t->last)
        return;
    t->last = number;
    if (t->state != RUNNING)
        return;
    if (order == REST) {
        rest(t, 0, now_s);
    } else if (!(volts <= RANGE_V && volts >= -RANGE_V)) { /* also what is not a number */
        rest(t, BAD_COMMAND, now_s);
    } else {
        t->waiting = number;
        t->waiting_v = volts;
        t->fed_s = now_s;
    }
}

static size_t frame_of(const struct target *t, uint32_t number, uint32_t acting, double output_v, double now_s,
                       uint8_t out[SAMPLES_BYTES])
{
    memcpy(out, "RPS1", 4);
    put_u32(out + 4, t->session);
    put_u32(out + 8, number);
    put_u32(out + 12, acting);
    put_u32(out + 16, t->state);
    put_u32(out + 20, t->faults);
    put_f64(out + 24, now_s);
    put_f64(out + 32, output_v);
    for (int c = 0; c < CHANNELS; c++)
        put_f64(out + COMMAND_BYTES + 8 * c, t->samples_v[c]);
    return SAMPLES_BYTES;
}

/* Take a datagram from the peer; return the size of the answer in `out`, 0 for none. */
static size_t attend(struct target *t, const uint8_t *in, size_t size, double now_s, uint8_t out[SAMPLES_BYTES])
{
    uint32_t acting = t->acting;
    double output_v = t->output_v;
    if (size != COMMAND_BYTES || memcmp(in, "RPC1", 4) != 0 || get_u32(in + 16) > REST)
        return 0;
    if (!t->of_target)
        read_samples(t->samples_v, now_s);
    count(t, in, now_s);
    if (t->of_target)
        return 0;
    if (get_u32(in + 16) == BEGIN) {
        acting = t->acting;
        output_v = t->output_v;
    }
    latch(t, now_s);
    return frame_of(t, t->last, acting, output_v, now_s, out);
}

/* One instant of this target's clock: return the size of the frame to send. */
static size_t instant(struct target *t, double now_s, uint8_t out[SAMPLES_BYTES])
{
    size_t size;
    read_samples(t->samples_v, now_s);
    size = frame_of(t, t->instant, t->acting, t->output_v, now_s, out);
    t->instant++;
    if (t->state == RUNNING && t->waiting == 0 && t->acting > 0)
        coast(t, now_s);
    latch(t, now_s);
    return size;
}

/* The watchdog and the way to rest; call it often, from the task that writes the output. */
static void watch(struct target *t, double now_s)
{
    if (t->state == RUNNING && now_s - t->fed_s > WATCHDOG_S)
        rest(t, WATCHDOG, now_s);
    if (t->state == RUNNING && !t->of_target && t->acting > 0 && now_s - t->latched_s >= (t->late + 1) * t->interval_s)
        coast(t, now_s);
    if (t->state != RESTING)
        return;
    t->output_v -= within(t->output_v, REST_V_S * (now_s - t->moved_s));
    t->moved_s = now_s;
    write_command(t->output_v, now_s);
    if (t->output_v == 0.0)
        t->state = AT_REST;
}

/* From here on: a PC, whose table follows its command with a lag of 20 ms. */
#ifndef NO_PC
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>

static struct { double position_v, command_v, now_s; } table;

static void move_table(double now_s)
{
    double lags = 50.0 * (now_s - table.now_s);
    table.position_v = (table.position_v + lags * table.command_v) / (1.0 + lags);
    table.now_s = now_s;
}

static void read_samples(double volts[CHANNELS], double now_s)
{
    move_table(now_s);
    for (int c = 0; c < CHANNELS; c++)
        volts[c] = table.position_v * (c + 1);
}

static void write_command(double volts, double now_s)
{
    move_table(now_s);
    table.command_v = volts;
}

static double clock_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static int fail(const char *sentence)
{
    fprintf(stderr, "plain_target: %s\n", sentence);
    exit(2);
}

static struct sockaddr_in end_of(const char *text)
{
    struct sockaddr_in end = {.sin_family = AF_INET};
    const char *colon = strchr(text, ':');
    char address[16] = "";
    if (!colon || colon - text > 15)
        fail("an end of the cable is ADDRESS:PORT");
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
    int door = socket(AF_INET, SOCK_DGRAM, 0);
    if (bind(door, (struct sockaddr *)&here, sizeof here) != 0
        || connect(door, (struct sockaddr *)&there, sizeof there) != 0)
        fail("cannot use this end of the cable; choose another port or address");
    getsockname(door, (struct sockaddr *)&here, &length);
    printf("listening at port %d\n", ntohs(here.sin_port));
    fflush(stdout);
    return door;
}

int main(int words, char **word)
{
    static struct target t;
    uint8_t in[COMMAND_BYTES + 1], out[SAMPLES_BYTES];
    if (words != 4)
        fail("usage: plain_target OWN:PORT PEER:PORT runner|INTERVAL_S");
    double interval_s = strcmp(word[3], "runner") == 0 ? 0.0 : atof(word[3]);
    int door = cable(word[1], word[2]);
    start(&t, interval_s);
    table.now_s = clock_s();
    for (double due_s = clock_s();;) {
        struct timespec longest = {.tv_nsec = 200000};
        fd_set doors;
        FD_ZERO(&doors);
        FD_SET(door, &doors);
        pselect(door + 1, &doors, NULL, NULL, &longest, NULL);
        ssize_t got = recv(door, in, sizeof in, MSG_DONTWAIT);
        size_t size = got > 0 ? attend(&t, in, (size_t)got, clock_s(), out) : 0;
        if (size > 0)
            send(door, out, size, 0);
        watch(&t, clock_s());
        for (; t.of_target && due_s <= clock_s(); due_s += interval_s)
            send(door, out, instant(&t, clock_s(), out), 0);
    }
}
#endif
