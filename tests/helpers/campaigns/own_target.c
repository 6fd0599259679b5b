/* A target for rths over UDP with a table and a specimen of its own, in which one thing fails at a given instant.
 *
 *     cc -std=c99 -O2 -o own_target own_target.c -lm && ./own_target KEYFILE [WHAT VALUE CHANNELS LAST AT]
 *
 * Written from docs/reference/udp.md; no code is shared with rths, examples/ or the rest of tests/. Time is counted, not measured: the table
 * moves on by one sample interval from one sequence number to the next, so that what it does hangs on the commands
 * alone and not on the load of this computer. Only watchdog, late answers and freezes use the clock.
 * With `-` and a rate in Hz instead of the key file no time passes: it writes samples and reads commands, line by line.
 *
 * WHAT fails in the interval AT after ARM, for LAST intervals (0: for ever), with a VALUE; CHANNELS is a bit mask. See
 * `enum fault` and its words in main().
 */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <math.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>

#define PI 3.14159265358979323846

/* --- SipHash-2-4, after the paper ---------------------------------------------------------------------------------- */

static uint64_t load64(const unsigned char *p)
{
    uint64_t w = 0;
    for (int i = 0; i < 8; i++)
        w |= (uint64_t)p[i] << (8 * i);
    return w;
}

static void store64(unsigned char *p, uint64_t w)
{
    for (int i = 0; i < 8; i++)
        p[i] = (unsigned char)(w >> (8 * i));
}

static void store32(unsigned char *p, uint32_t w)
{
    for (int i = 0; i < 4; i++)
        p[i] = (unsigned char)(w >> (8 * i));
}

static double load_double(const unsigned char *p)
{
    uint64_t w = load64(p);
    double v;
    memcpy(&v, &w, sizeof v);
    return v;
}

static void store_double(unsigned char *p, double v)
{
    uint64_t w;
    memcpy(&w, &v, sizeof w);
    store64(p, w);
}

#define ROTL(x, b) (((x) << (b)) | ((x) >> (64 - (b))))
#define SIPROUND                                                                                     \
    do {                                                                                             \
        v0 += v1; v1 = ROTL(v1, 13); v1 ^= v0; v0 = ROTL(v0, 32); v2 += v3; v3 = ROTL(v3, 16);       \
        v3 ^= v2; v0 += v3; v3 = ROTL(v3, 21); v3 ^= v0; v2 += v1; v1 = ROTL(v1, 17); v1 ^= v2;      \
        v2 = ROTL(v2, 32);                                                                           \
    } while (0)

static uint64_t siphash24(const unsigned char *m, size_t n, const unsigned char key[16])
{
    uint64_t k0 = load64(key), k1 = load64(key + 8);
    uint64_t v0 = k0 ^ 0x736f6d6570736575u, v1 = k1 ^ 0x646f72616e646f6du;
    uint64_t v2 = k0 ^ 0x6c7967656e657261u, v3 = k1 ^ 0x7465646279746573u, last = (uint64_t)(n & 0xff) << 56;
    size_t i;
    for (i = 0; i + 8 <= n; i += 8) {
        uint64_t w = load64(m + i);
        v3 ^= w; SIPROUND; SIPROUND; v0 ^= w;
    }
    for (size_t j = i; j < n; j++)
        last |= (uint64_t)m[j] << (8 * (j - i));
    v3 ^= last; SIPROUND; SIPROUND; v0 ^= last;
    v2 ^= 0xff; SIPROUND; SIPROUND; SIPROUND; SIPROUND;
    return v0 ^ v1 ^ v2 ^ v3;
}

/* --- table and specimen --------------------------------------------------------------------------------------------
 * A servo (spring, dashpot) pulls the table to the place that the amplifier, a first-order lag, was told; two storeys
 * stand on the table. States: place and velocity of table, floor 1, floor 2; the amplifier's place. Runge-Kutta 4.
 */
enum { FLOORS = 2, CHANNELS = 3, STATES = 7, SUBSTEPS = 8 };

static struct {
    double gain_m_per_v, lag_s, table_kg, servo_hz, servo_ratio, coulomb_n, force_n, mass_kg[FLOORS], k[FLOORS], c[FLOORS];
    double x[STATES], coupled[CHANNELS], corner_hz, told_v[4096];
    long intervals;
} rig = {0.0085, 2e-3, 9.0, 12.0, 0.8, 0.2, 1e9, {6.2, 5.4}, {9500.0, 7800.0}, {16.0, 11.0},
         {0}, {0}, 0.03, {0}, 0};

static void derivative(const double *x, double place_m, double *dx)
{
    double total = rig.table_kg + rig.mass_kg[0] + rig.mass_kg[1], w = 2.0 * PI * rig.servo_hz;
    double drift1 = x[1] - x[0], drift2 = x[2] - x[1], rate1 = x[4] - x[3], rate2 = x[5] - x[4];
    double storey1 = rig.k[0] * drift1 + rig.c[0] * rate1, storey2 = rig.k[1] * drift2 + rig.c[1] * rate2;
    double pull = total * (w * w * (x[6] - x[0]) - 2.0 * rig.servo_ratio * w * x[3]);
    pull = fmax(-rig.force_n, fmin(rig.force_n, pull));
    dx[0] = x[3], dx[1] = x[4], dx[2] = x[5];
    dx[3] = (pull - rig.coulomb_n * tanh(x[3] / 2e-3) + storey1) / rig.table_kg;
    dx[4] = (storey2 - storey1) / rig.mass_kg[0];
    dx[5] = -storey2 / rig.mass_kg[1];
    dx[6] = (place_m - x[6]) / rig.lag_s;
}

static void move_for(double seconds, double volts)
{
    double h = seconds / SUBSTEPS, place = rig.gain_m_per_v * volts, y[STATES], d[4][STATES];
    static const double ahead[4] = {0.0, 0.5, 0.5, 1.0};
    for (int step = 0; step < SUBSTEPS; step++) {
        for (int s = 0; s < 4; s++) {
            for (int i = 0; i < STATES; i++)
                y[i] = rig.x[i] + (s ? ahead[s] * h * d[s - 1][i] : 0.0);
            derivative(y, place, d[s]);
        }
        for (int i = 0; i < STATES; i++)
            rig.x[i] += h / 6.0 * (d[0][i] + 2.0 * d[1][i] + 2.0 * d[2][i] + d[3][i]);
        derivative(rig.x, place, y);
        for (int c = 0; c < CHANNELS; c++) /* AC coupling: what it takes off follows the acceleration slowly */
            rig.coupled[c] += h * 2.0 * PI * rig.corner_hz * (y[3 + c] - rig.coupled[c]);
    }
}

static double random_normal(void)
{
    static uint64_t word = 0x9E3779B97F4A7C15u;
    double sum = -6.0;
    for (int i = 0; i < 12; i++) {
        word ^= word << 13, word ^= word >> 7, word ^= word << 17;
        sum += (double)(word >> 11) / 9007199254740992.0;
    }
    return sum;
}

/* --- what fails ----------------------------------------------------------------------------------------------------- */

enum fault {
    NOTHING, STUCK, GAIN, OFFSET, DRIFT, NOISE, SPIKE, NOT_A_NUMBER, SATURATED, HUM, LOOSE, SWAPPED, /* sensors */
    WIRE_GAIN, WIRE_OFFSET, WIRE_HOLDS, WIRE_DELAY, WIRE_DELAY_GROWS,                               /* command */
    FRICTION, SERVO_SOFT, WEAK, STOREY_SOFT,                                                        /* table */
    ANSWERS_LOST, COMMANDS_LOST, ANSWERS_LATE, REORDERED, FREEZES, DIES, RESTARTS, FAULT_BITS       /* target, link */
};
static const char *const WORDS[] = {
    "nothing", "stuck", "gain", "offset", "drift", "noise", "spike", "nan", "saturated", "hum", "loose", "swapped",
    "wire-gain", "wire-offset", "wire-holds", "wire-delay", "wire-delay-grows", "friction", "servo-soft", "weak",
    "storey-soft", "answers-lost", "commands-lost", "answers-late", "reordered", "freezes", "dies", "restarts",
    "fault-bits"};
static struct { enum fault what; double value; int channels; long last, at; } fault;

static int failing(enum fault what, long k)
{
    return fault.what == what && k >= fault.at && (fault.last == 0 || k < fault.at + fault.last);
}

static void sample(long k, double volts[CHANNELS])
{
    static double kept[CHANNELS];
    double dx[STATES], good[CHANNELS];
    derivative(rig.x, rig.gain_m_per_v * rig.told_v[rig.intervals % 4096], dx);
    for (int c = 0; c < CHANNELS; c++)
        volts[c] = 0.1 * (dx[3 + c] - rig.coupled[c]) + 1e-4 * random_normal();
    memcpy(good, volts, sizeof good);
    for (int c = 0; c < CHANNELS; c++) {
        if (!(fault.channels >> c & 1))
            continue;
        if (failing(STUCK, k)) volts[c] = kept[c];
        if (failing(GAIN, k)) volts[c] *= fault.value;
        if (failing(OFFSET, k) || failing(SPIKE, k)) volts[c] += fault.value;
        if (failing(DRIFT, k)) volts[c] += fault.value * (double)(k - fault.at) / 1000.0;
        if (failing(NOISE, k)) volts[c] += fault.value * random_normal();
        if (failing(NOT_A_NUMBER, k)) volts[c] = NAN;
        if (failing(SATURATED, k)) volts[c] = 10.0;
        if (failing(HUM, k)) volts[c] = fault.value * sin(0.63 * (double)k);
        if (failing(LOOSE, k) && random_normal() > 1.2) volts[c] = 0.0;
        if (failing(SWAPPED, k)) volts[c] = good[fault.channels == 3 ? 1 - c : fault.channels == 6 ? 3 - c : 2 - c];
    }
    for (int c = 0; c < CHANNELS; c++) {
        if (!failing(STUCK, k)) kept[c] = good[c];
        volts[c] = fmax(-10.0, fmin(10.0, floor(volts[c] * 3276.8 + 0.5) / 3276.8)) + (volts[c] - volts[c]);
    }
}

/* Return what reaches the amplifier in an interval, and change what fails in the table. */
static double through_cable(long k, double volts)
{
    static double held;
    rig.told_v[k % 4096] = volts;
    long late = 0;
    if (failing(WIRE_DELAY, k)) late = (long)fault.value;
    if (failing(WIRE_DELAY_GROWS, k)) late = (long)(fault.value * (double)(k - fault.at));
    if (late > 0) volts = rig.told_v[(k - (late < k ? late : k)) % 4096];
    if (failing(WIRE_GAIN, k)) volts *= fault.value;
    if (failing(WIRE_OFFSET, k)) volts += fault.value;
    if (failing(WIRE_HOLDS, k)) volts = held; else held = volts;
    if (k == fault.at && fault.what == FRICTION) rig.coulomb_n = fault.value;
    if (k == fault.at && fault.what == SERVO_SOFT) rig.servo_hz *= fault.value;
    if (k == fault.at && fault.what == WEAK) rig.force_n = fault.value;
    if (k == fault.at && fault.what == STOREY_SOFT) rig.k[0] *= fault.value;
    return fmax(-10.0, fmin(10.0, volts));
}

/* --- packets and session ------------------------------------------------------------------------------------------- */

enum kind { HELLO = 1, WELCOME, REFUSAL, ARM, COMMAND, SAMPLES, REST, CLOSE };
enum state { IDLE, ARMED, RESTING, RESTED };
enum { WORDS_AT = 40, LARGEST = 544, LATE_ANSWERS = 4096 };

static unsigned char secret[16], session_key[16], own_nonce[16];
static uint64_t sessions;
static enum state state;
static uint32_t fault_bits, lost;
static int64_t last_sequence, arm_sequence, interval_ns, watchdog_ns, heard_ns;
static double way[15], command_v;
static long way_points, way_spacing, way_from;
static int door;
static struct sockaddr_in peer;
static struct { int64_t due_ns; size_t size; unsigned char bytes[LARGEST]; } late_answer[LATE_ANSWERS];
static int first_late, after_late;

static int64_t now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void send_now(const unsigned char *packet, size_t size)
{
    sendto(door, packet, size, 0, (struct sockaddr *)&peer, sizeof peer);
}

static void begin(unsigned char *packet, enum kind kind, int words)
{
    memset(packet, 0, LARGEST);
    memcpy(packet, "RTHS", 4);
    packet[4] = 3, packet[5] = (unsigned char)kind, packet[6] = (unsigned char)words;
}

static size_t tagged(unsigned char *packet, const unsigned char key[16])
{
    size_t end = WORDS_AT + 8 * (size_t)packet[6];
    store64(packet + end, siphash24(packet, end, key));
    return end + 8;
}

static int tag_fits(const unsigned char *packet, size_t size, const unsigned char key[16])
{
    return siphash24(packet, size - 8, key) == load64(packet + size - 8);
}

/* Where the last command has gone on to, so many intervals after it. */
static double along_way(long since)
{
    long i = way_points ? since / way_spacing : 0;
    if (i >= way_points)
        return way[way_points];
    double p1 = way[i], p2 = way[i + 1], p3 = i + 2 <= way_points ? way[i + 2] : p1;
    double p0 = i > 0 ? way[i - 1] : 3.0 * (p1 - p2) + p3, x = (double)(since - i * way_spacing) / (double)way_spacing;
    return p1 + x / 2.0 * (p2 - p0 + x * (2.0 * p0 - 5.0 * p1 + 4.0 * p2 - p3 + x * (3.0 * p1 - 3.0 * p2 + p3 - p0)));
}

/* Move the table on to an instant; where no command came, along the way that the last one told, or holding it. */
static void move_to(long k, int holds)
{
    for (; rig.intervals < k; rig.intervals++) {
        if (state == ARMED && !holds && rig.intervals > way_from)
            command_v = fmax(-10.0, fmin(10.0, along_way(rig.intervals - way_from)));
        move_for(1e-9 * (double)interval_ns, through_cable(rig.intervals, command_v));
    }
}

static void lead_to_rest(void)
{
    if (state == ARMED)
        state = RESTING;
}

static void answer(long k, int64_t sequence, int silent)
{
    unsigned char packet[LARGEST];
    double volts[CHANNELS];
    sample(k, volts);
    begin(packet, SAMPLES, CHANNELS);
    packet[7] = (unsigned char)state;
    store32(packet + 8, fault_bits);
    store32(packet + 12, lost);
    store64(packet + 16, (uint64_t)sequence);
    store64(packet + 24, (uint64_t)now_ns());
    store64(packet + 32, (uint64_t)now_ns());
    for (int c = 0; c < CHANNELS; c++)
        store_double(packet + WORDS_AT + 8 * c, volts[c]);
    size_t size = tagged(packet, session_key);
    if (silent || failing(ANSWERS_LOST, k))
        return;
    if (failing(ANSWERS_LATE, k) || (failing(REORDERED, k) && k % 7 == 0)) {
        late_answer[after_late].due_ns = now_ns() + (int64_t)(fault.value * (double)interval_ns);
        late_answer[after_late].size = size;
        memcpy(late_answer[after_late].bytes, packet, size);
        after_late = (after_late + 1) % LATE_ANSWERS;
    } else
        send_now(packet, size);
}

static void greet(const unsigned char *in)
{
    unsigned char out[LARGEST];
    int64_t asked = (int64_t)load64(in + WORDS_AT + 32);
    if (state == ARMED || state == RESTING || load64(in + WORDS_AT + 16) != CHANNELS) {
        begin(out, REFUSAL, 4);
        memcpy(out + WORDS_AT, in + WORDS_AT, 16);
        store64(out + WORDS_AT + 16, state == ARMED || state == RESTING ? 2 : 3);
        store64(out + WORDS_AT + 24, CHANNELS);
    } else {
        begin(out, WELCOME, 7);
        memcpy(out + WORDS_AT, in + WORDS_AT, 16);
        memcpy(out + WORDS_AT + 16, own_nonce, 16);
        store64(out + WORDS_AT + 16, load64(own_nonce) ^ sessions);
        memcpy(out + WORDS_AT + 32, in + WORDS_AT + 16, 16);
        store64(out + WORDS_AT + 48, (uint64_t)(asked > 0 && asked < 1000000000 ? asked : 1000000000));
    }
    send_now(out, tagged(out, secret));
}

static int arms(const unsigned char *in, size_t size)
{
    unsigned char message[48] = "rths-key", key[16];
    if (state == ARMED || state == RESTING || in[5] != ARM || size != 88)
        return 0;
    memcpy(message + 16, in + WORDS_AT, 16);
    memcpy(message + 32, own_nonce, 16);
    store64(message + 32, load64(own_nonce) ^ sessions);
    for (unsigned i = 0; i < 2; i++) {
        store64(message + 8, i);
        store64(key + 8 * i, siphash24(message, sizeof message, secret));
    }
    if (!tag_fits(in, size, key))
        return 0;
    memcpy(session_key, key, 16);
    sessions++, state = ARMED, fault_bits = lost = 0, last_sequence = -1;
    interval_ns = (int64_t)load64(in + WORDS_AT + 24), watchdog_ns = (int64_t)load64(in + WORDS_AT + 32);
    memset(rig.x, 0, sizeof rig.x), memset(rig.coupled, 0, sizeof rig.coupled), memset(rig.told_v, 0, sizeof rig.told_v);
    rig.intervals = 0, command_v = 0.0, way_points = way_from = 0, way[0] = 0.0;
    return 1;
}

/* Take a packet; `frozen`: it came while this target stood still, which held its command and latches none of these. */
static void take(const unsigned char *in, size_t size, int frozen)
{
    if (size < 48 || size > LARGEST || size != 48 + 8 * (size_t)in[6] || memcmp(in, "RTHS", 4) || in[4] != 3)
        return;
    if (in[5] == HELLO && in[6] == 7) {
        if (tag_fits(in, size, secret))
            greet(in);
        return;
    }
    if (!(sessions && tag_fits(in, size, session_key)) && !arms(in, size))
        return;
    int64_t sequence = (int64_t)load64(in + 16);
    if (sequence <= last_sequence || (in[5] == COMMAND && (in[6] == 0 || in[6] == 2)))
        return;
    if (in[5] == ARM)
        arm_sequence = sequence;
    long k = (long)(sequence - arm_sequence);
    if (failing(COMMANDS_LOST, k) && in[5] == COMMAND)
        return;
    lost += (uint32_t)(sequence - last_sequence - 1);
    last_sequence = sequence, heard_ns = now_ns();
    if (k == fault.at && fault.what == DIES && in[5] == COMMAND)
        exit(0);
    if (failing(FAULT_BITS, k) && state == ARMED)
        fault_bits = (uint32_t)fault.value, lead_to_rest();
    if (in[5] == COMMAND) {
        move_to(k, frozen);
        answer(k, sequence, 0);
        if (state == ARMED && !frozen) {
            command_v = way[0] = load_double(in + WORDS_AT);
            way_points = in[6] > 2 ? in[6] - 2 : 0, way_spacing = way_points ? (long)load64(in + WORDS_AT + 8) : 1;
            for (long i = 1; i <= way_points; i++)
                way[i] = load_double(in + WORDS_AT + 8 + 8 * i);
            way_from = k;
            if (!(fabs(command_v) <= 10.0))
                fault_bits |= 8, lead_to_rest();
        } else if (!frozen)
            command_v *= 0.99;
    } else if (in[5] == ARM) {
        answer(0, sequence, 0);
    } else {
        lead_to_rest();
        command_v = 0.0, state = RESTED; /* its table is as good as at rest: nobody can be hurt by this one */
        answer(rig.intervals, sequence, 0);
    }
}

static void receive(int frozen)
{
    unsigned char in[LARGEST + 1];
    socklen_t length = sizeof peer;
    ssize_t got;
    while ((got = recvfrom(door, in, sizeof in, MSG_DONTWAIT, (struct sockaddr *)&peer, &length)) >= 0)
        take(in, (size_t)got, frozen);
}

static void wait_for_packet(int64_t ns)
{
    struct timespec longest = {.tv_nsec = (long)ns};
    fd_set doors;
    FD_ZERO(&doors);
    FD_SET(door, &doors);
    pselect(door + 1, &doors, NULL, NULL, &longest, NULL);
}

static void freeze_or_restart(int *done)
{
    if (*done || state != ARMED || rig.intervals < fault.at)
        return;
    if (fault.what == FREEZES) {
        struct timespec pause = {(time_t)(fault.value / 1000), (long)(1e6 * fmod(fault.value, 1000.0))};
        nanosleep(&pause, NULL);
        receive(1);
        *done = 1;
    } else if (fault.what == RESTARTS) {
        memset(session_key, 0, sizeof session_key);
        sessions = 0, state = IDLE, own_nonce[8] ^= 1, *done = 1;
    }
}

/* Write what the channels show, read a command in V, move on; a command acts one interval after the samples it answers.
 */
static int simulate(double rate_hz)
{
    double command, before = 0.0, volts[CHANNELS];
    interval_ns = (int64_t)(1e9 / rate_hz);
    for (long k = 0;; k++) {
        sample(k, volts);
        printf("%.9g,%.9g,%.9g\n", volts[0], volts[1], volts[2]);
        fflush(stdout);
        if (scanf("%lf", &command) != 1)
            return 0;
        move_for(1.0 / rate_hz, through_cable(k, before));
        rig.intervals++;
        before = floor(command * 3276.8 + 0.5) / 3276.8;
    }
}

/* Take the words of a fault; return whether there is such a one. */
static int take_fault(int count, char **words)
{
    for (int i = 0; count > 4 && i < (int)(sizeof WORDS / sizeof *WORDS); i++)
        if (!strcmp(words[0], WORDS[i])) {
            fault.what = (enum fault)i, fault.value = atof(words[1]), fault.channels = atoi(words[2]);
            fault.last = atol(words[3]), fault.at = atol(words[4]);
            return 1;
        }
    return count == 0;
}

int main(int count, char **words)
{
    struct sockaddr_in own = {.sin_family = AF_INET};
    socklen_t length = sizeof own;
    int counted = count > 2 && !strcmp(words[1], "-"), first = counted ? 3 : 2, done = 0;
    if (count < 2 || !take_fault(count - first, words + first))
        return fprintf(stderr, "own_target KEYFILE | - RATE [WHAT VALUE CHANNELS LAST AT]\n"), 2;
    if (counted)
        return simulate(atof(words[2]));
    FILE *file = fopen(words[1], "r"), *dice = fopen("/dev/urandom", "rb");
    for (int i = 0; i < 16; i++)
        if (!file || fscanf(file, "%2hhx", &secret[i]) != 1)
            return fprintf(stderr, "own_target: the key file must hold 32 hexadecimal digits\n"), 2;
    if (!dice || fread(own_nonce, 1, 16, dice) != 16)
        return 2;
    door = socket(AF_INET, SOCK_DGRAM, 0);
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (bind(door, (struct sockaddr *)&own, sizeof own) || getsockname(door, (struct sockaddr *)&own, &length))
        return 2;
    sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = 50}); /* where that is permitted */
    printf("%d\n", ntohs(own.sin_port));
    fflush(stdout);
    for (;;) {
        wait_for_packet(first_late != after_late ? 100000 : 2000000);
        receive(0);
        for (; first_late != after_late && late_answer[first_late].due_ns <= now_ns(); first_late = (first_late + 1) % LATE_ANSWERS)
            send_now(late_answer[first_late].bytes, late_answer[first_late].size);
        if (state == ARMED && now_ns() - heard_ns > watchdog_ns)
            fault_bits |= 1, lead_to_rest();
        if (state == RESTING && now_ns() - heard_ns > 2 * watchdog_ns)
            state = RESTED;
        freeze_or_restart(&done);
    }
}
