/* A target for rths over UDP (docs/reference/udp.md): C99, no memory allocation, no operating system.
 *
 * Give the four hooks below, set `secret` of a target that is zero otherwise, call handle() with each packet received
 * and send back what it returns, and call watch() some times in every sample interval: it moves a late command on.
 * udp_target_pc.c does that on a PC.
 *
 * The watchdog here is no safety function: a real table needs an independent emergency stop.
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define PERIOD_NS INT64_C(10000000000) /* an ARM is taken in the period of its WELCOME and in the next one */
enum { CHANNELS = 3, RANGE_V = 10, FASTEST_V_PER_S = 127, REST_V_PER_S = 6 };
/* How fast this table closes a distance that a stall left: its acceleration limit over twice the angular frequency of
 * its loop, 45 m/s^2 / (2 * 2 pi 14 Hz), with 7.9 mm/V. */
enum { CLOSING_V_PER_S = 32 };
enum { SHORTEST_NS = 200000, LONGEST_WATCHDOG_NS = 1000000000 };
enum { HELLO = 1, WELCOME, REFUSAL, ARM, COMMAND, SAMPLES, REST, CLOSE };
enum { IDLE, ARMED, RESTING, RESTED };
enum { WATCHDOG = 1, BAD_COMMAND = 8 };
enum { NO_VERSION = 1, BUSY, OTHER_CHANNELS, TOO_FAST };
enum { VERSION = 3, HEAD = 40, MOST = 544, POINTS = 14, LONGEST_SPACING = 1000, FARTHEST_V = 1000000 };

struct target {
    uint8_t secret[16], key[16], boot[16]; /* shared with the runner; of the session; ours alone, drawn at the start */
    int started, state;
    uint64_t armed; /* sessions since then */
    uint32_t faults, lost;
    int64_t sequence, watchdog_ns, interval_ns, heard_ns, moved_ns;
    double command_v, step_v; /* at the output, and how far it went there */
    int late; /* the output is not where it should be yet, as a command came late, or we ourselves */
    double way_v[1 + POINTS]; /* the last command, then the points it goes on to while no other comes */
    int points;
    int64_t spacing, intervals; /* sample intervals from one point to the next, and since the last command */
};

/* Hooks: what the rig is made of. */
void read_samples(double volts[CHANNELS], int64_t now_ns);
void write_command(double volts, int64_t now_ns);
void random_bytes(uint8_t *bytes, size_t count); /* unpredictable, from a hardware generator */
int64_t clock_ns(void);                          /* monotonic */

/* --- packets ------------------------------------------------------------------------------------------------- */

static uint64_t get(const uint8_t *from, int bytes)
{
    uint64_t value = 0;
    while (bytes-- > 0)
        value = value << 8 | from[bytes];
    return value;
}

static void put(uint8_t *to, uint64_t value, int bytes)
{
    for (; bytes-- > 0; value >>= 8)
        *to++ = (uint8_t)value;
}

static double get_real(const uint8_t *from)
{
    uint64_t bits = get(from, 8);
    double value;
    memcpy(&value, &bits, 8);
    return value;
}

static void put_real(uint8_t *to, double value)
{
    uint64_t bits;
    memcpy(&bits, &value, 8);
    put(to, bits, 8);
}

static uint64_t rotated(uint64_t word, int by)
{
    return word << by | word >> (64 - by);
}

static void sip_rounds(uint64_t v[4], int count)
{
    while (count-- > 0) {
        v[0] += v[1], v[2] += v[3];
        v[1] = rotated(v[1], 13) ^ v[0], v[3] = rotated(v[3], 16) ^ v[2];
        v[0] = rotated(v[0], 32);
        v[2] += v[1], v[0] += v[3];
        v[1] = rotated(v[1], 17) ^ v[2], v[3] = rotated(v[3], 21) ^ v[0];
        v[2] = rotated(v[2], 32);
    }
}

/* SipHash-2-4 of whole words of 8 bytes: all that is hashed here is a multiple of 8 long. */
static uint64_t siphash(const uint8_t *data, size_t size, const uint8_t key[16])
{
    uint64_t k0 = get(key, 8), k1 = get(key + 8, 8), word;
    uint64_t v[4] = {k0 ^ 0x736f6d6570736575, k1 ^ 0x646f72616e646f6d, k0 ^ 0x6c7967656e657261, k1 ^ 0x7465646279746573};
    for (size_t i = 0; i <= size; i += 8) {
        word = i < size ? get(data + i, 8) : (uint64_t)(size & 255) << 56;
        v[3] ^= word;
        sip_rounds(v, 2);
        v[0] ^= word;
    }
    v[2] ^= 255;
    sip_rounds(v, 4);
    return v[0] ^ v[1] ^ v[2] ^ v[3];
}

static int is_genuine(const uint8_t *packet, size_t size, const uint8_t key[16])
{
    return size >= HEAD + 8 && size <= MOST && size % 8 == 0 && memcmp(packet, "RTHS", 4) == 0
        && (packet[4] != VERSION || size == HEAD + 8 * (size_t)packet[6] + 8)
        && get(packet + size - 8, 8) == siphash(packet, size - 8, key);
}

static size_t seal(uint8_t *packet, int kind, int count, const uint8_t key[16])
{
    size_t end = HEAD + 8 * (size_t)count;
    memcpy(packet, "RTHS", 4);
    packet[4] = VERSION, packet[5] = (uint8_t)kind, packet[6] = (uint8_t)count;
    put(packet + end, siphash(packet, end, key), 8);
    return end + 8;
}

/* --- the way on ------------------------------------------------------------------------------------------------ */

static double size_of(double value)
{
    return value < 0.0 ? -value : value;
}

static double within(double value, double limit)
{
    return value > limit ? limit : value < -limit ? -limit : value;
}

/* Keep the words of a command: the command, the spacing, the points. A bad one among them, and it is held. */
static void take_way(struct target *t, const uint8_t *words, int count)
{
    t->way_v[0] = get_real(words);
    t->points = count > 2 ? count - 2 : 0;
    t->spacing = t->points ? (int64_t)get(words + 8, 8) : 1;
    if (t->spacing < 1 || t->spacing > LONGEST_SPACING)
        t->points = 0;
    for (int i = 1; i <= t->points; i++) {
        t->way_v[i] = get_real(words + 8 + 8 * i);
        if (!(t->way_v[i] >= -FARTHEST_V && t->way_v[i] <= FARTHEST_V)) /* not a number is neither */
            t->points = 0;
    }
    t->intervals = 0;
}

/* Where the last command has gone on to: smoothly from point to point, then it is held. */
static double place(const struct target *t)
{
    int64_t behind = t->points ? t->intervals / t->spacing : 0;
    if (behind >= t->points)
        return t->way_v[t->points];
    const double *p = t->way_v + behind;
    double after = behind + 2 <= t->points ? p[2] : p[0];
    double before = behind > 0 ? p[-1] : 3.0 * (p[0] - p[1]) + after;
    double x = (double)(t->intervals - behind * t->spacing) / (double)t->spacing;
    double bend = 2.0 * before - 5.0 * p[0] + 4.0 * p[1] - after, twist = after - before + 3.0 * (p[0] - p[1]);
    return p[0] + 0.5 * x * (p[1] - before + x * (bend + x * twist));
}

/* Go where the output should be, which moved there by `moves_v` in the last interval. After a stall, in which it may
 * have stood still, it must not jump: it closes the distance, and no faster than time really passes. */
static void follow(struct target *t, double volts, double moves_v, double most_v, int64_t now_ns)
{
    double share = (double)(now_ns - t->moved_ns) / (double)t->interval_ns, before = t->command_v;
    double closing_v = CLOSING_V_PER_S * 1e-9 * (double)t->interval_ns;
    if (t->late)
        most_v = (share < 1.0 ? share : 1.0) * within(moves_v + closing_v, FASTEST_V_PER_S * 1e-9 * (double)t->interval_ns);
    t->command_v = within(before + within(volts - before, most_v), RANGE_V);
    t->step_v = t->command_v - before;
    t->moved_ns = now_ns;
    if (t->command_v != before)
        write_command(t->command_v, now_ns);
}

/* Move on at each instant at which the next command was due, within the limits of this rig. */
static void go_on(struct target *t, int64_t now_ns)
{
    int64_t due = (now_ns - t->heard_ns) / t->interval_ns;
    double before;
    if (due <= t->intervals)
        return;
    t->late = t->late || due > t->intervals + 1;
    t->intervals = due - 1, before = place(t);
    t->intervals = due;
    follow(t, place(t), size_of(place(t) - before), FASTEST_V_PER_S * 1e-9 * (double)t->interval_ns, now_ns);
}

/* Take a command: at once where it came in time, else by approaching it; an output that went on may go on as fast. */
static void take_command(struct target *t, double volts, int64_t now_ns)
{
    int64_t passed = (now_ns - t->heard_ns) / t->interval_ns;
    double moves = size_of(volts - t->way_v[0]) / (double)(passed > 1 ? passed : 1);
    if (passed > 1) {
        t->late = 1;
        if (now_ns - t->moved_ns < 2 * t->interval_ns && size_of(t->step_v) > moves)
            moves = size_of(t->step_v);
    }
    follow(t, volts, moves, 2.0 * RANGE_V, now_ns);
    if (t->command_v == volts && passed < 2 && 2 * (now_ns - t->heard_ns) >= t->interval_ns)
        t->late = 0; /* not before commands come one by one again: those that waited may come together */
    t->heard_ns = now_ns;
}

/* --- session ------------------------------------------------------------------------------------------------- */

/* Our nonce for a runner's nonce, computed from what we drew at the start, how many sessions were armed since, and the
 * period of the clock: nothing needs to be remembered of a HELLO. */
static void make_nonce(const struct target *t, const uint8_t runner_nonce[16], int64_t period, uint8_t nonce[16])
{
    uint8_t message[40] = {0};
    put(message + 8, t->armed, 8);
    put(message + 16, (uint64_t)period, 8);
    memcpy(message + 24, runner_nonce, 16);
    for (int i = 0; i < 2; i++) {
        message[0] = (uint8_t)i;
        put(nonce + 8 * i, siphash(message, 40, t->boot), 8);
    }
}

static void make_key(const struct target *t, const uint8_t nonces[32], uint8_t key[16])
{
    uint8_t message[48] = "rths-key";
    memcpy(message + 16, nonces, 32);
    for (int i = 0; i < 2; i++) {
        message[8] = (uint8_t)i;
        put(key + 8 * i, siphash(message, 48, t->secret), 8);
    }
}

static int64_t granted_watchdog(int64_t wanted_ns)
{
    return wanted_ns > 0 && wanted_ns < LONGEST_WATCHDOG_NS ? wanted_ns : LONGEST_WATCHDOG_NS;
}

static size_t refuse(struct target *t, int reason, int64_t detail, uint8_t *out)
{
    put(out + HEAD + 16, (uint64_t)reason, 8);
    put(out + HEAD + 24, (uint64_t)detail, 8);
    return seal(out, REFUSAL, 4, t->secret);
}

/* Answer a HELLO; it changes nothing but the random bytes that the first one makes us draw. */
static size_t greet(struct target *t, const uint8_t *in, int64_t now_ns, uint8_t *out)
{
    int64_t channels = (int64_t)get(in + HEAD + 16, 8), interval = (int64_t)get(in + HEAD + 24, 8);
    memcpy(out + HEAD, in + HEAD, 16);
    if (in[4] != VERSION)
        return refuse(t, NO_VERSION, VERSION, out);
    if (in[6] != 7)
        return 0;
    if (t->state == ARMED || t->state == RESTING)
        return refuse(t, BUSY, 0, out);
    if (channels != CHANNELS)
        return refuse(t, OTHER_CHANNELS, CHANNELS, out);
    if (interval < SHORTEST_NS)
        return refuse(t, TOO_FAST, SHORTEST_NS, out);
    if (!t->started)
        random_bytes(t->boot, 16), t->started = 1;
    make_nonce(t, in + HEAD, now_ns / PERIOD_NS, out + HEAD + 16);
    memcpy(out + HEAD + 32, in + HEAD + 16, 16);
    put(out + HEAD + 48, (uint64_t)granted_watchdog((int64_t)get(in + HEAD + 32, 8)), 8);
    return seal(out, WELCOME, 7, t->secret);
}

/* Take the first ARM of a session, made from a WELCOME of this period or the one before; it replaces the last session,
 * whose table is at rest, and no ARM made from an earlier WELCOME is taken any more. */
static int begin_session(struct target *t, const uint8_t *in, size_t size, int64_t now_ns)
{
    uint8_t nonces[32], key[16];
    int64_t interval = (int64_t)get(in + HEAD + 24, 8), watchdog = (int64_t)get(in + HEAD + 32, 8);
    if (!t->started || t->state == ARMED || t->state == RESTING || in[5] != ARM || in[6] != 5)
        return 0;
    memcpy(nonces, in + HEAD, 16);
    for (int ago = 0; ago < 2; ago++) {
        make_nonce(t, in + HEAD, now_ns / PERIOD_NS - ago, nonces + 16);
        make_key(t, nonces, key);
        if (!is_genuine(in, size, key) || in[4] != VERSION)
            continue;
        if (get(in + HEAD + 16, 8) != CHANNELS || interval < SHORTEST_NS || granted_watchdog(watchdog) != watchdog)
            return 0;
        memcpy(t->key, key, 16);
        t->armed++, t->interval_ns = interval, t->watchdog_ns = watchdog;
        t->state = IDLE, t->faults = t->lost = 0, t->sequence = -1;
        return 1;
    }
    return 0;
}

static void obey(struct target *t, int kind, const uint8_t *words, int count, int64_t now_ns)
{
    double volts = kind == COMMAND ? get_real(words) : 0.0;
    if (kind == ARM && t->state == IDLE)
        t->state = ARMED, t->heard_ns = t->moved_ns = now_ns, t->way_v[0] = t->command_v, t->points = 0,
        t->intervals = 0, t->late = 0;
    if ((kind == REST || kind == CLOSE) && t->state == ARMED)
        t->state = RESTING, t->moved_ns = now_ns;
    if (kind != COMMAND || t->state != ARMED)
        return;
    if (volts >= -RANGE_V && volts <= RANGE_V) { /* not a number is neither */
        take_command(t, volts, now_ns);
        take_way(t, words, count);
    } else
        t->faults |= BAD_COMMAND, t->state = RESTING, t->moved_ns = now_ns;
}

/* Whether a packet from a runner may have as many words as it says. */
static int is_whole(int kind, int count)
{
    if (kind == COMMAND)
        return count != 0 && count != 2;
    return kind == ARM ? count == 5 : (kind == REST || kind == CLOSE) && count == 0;
}

/* Answer one received packet: return the size of the answer in `out` (MOST bytes), 0 for none. */
size_t handle(struct target *t, const uint8_t *in, size_t size, uint8_t *out)
{
    int64_t now_ns = clock_ns(), sequence;
    double volts[CHANNELS];
    memset(out, 0, MOST);
    if (size >= HEAD + 24 && size <= MOST && in[5] == HELLO)
        return is_genuine(in, size, t->secret) ? greet(t, in, now_ns, out) : 0;
    if (!(t->armed && is_genuine(in, size, t->key)) && !(size == HEAD + 48 && begin_session(t, in, size, now_ns)))
        return 0;
    sequence = (int64_t)get(in + 16, 8);
    if (in[4] != VERSION || sequence <= t->sequence || !is_whole(in[5], in[6]))
        return 0; /* doubled, reordered, or nothing for us */
    t->lost += (uint32_t)(sequence - t->sequence - 1);
    t->sequence = sequence;
    read_samples(volts, now_ns); /* first sample, then latch */
    obey(t, in[5], in + HEAD, in[6], now_ns);
    out[7] = (uint8_t)t->state;
    put(out + 8, t->faults, 4);
    put(out + 12, t->lost, 4);
    put(out + 16, (uint64_t)sequence, 8);
    put(out + 24, (uint64_t)clock_ns(), 8);
    put(out + 32, (uint64_t)now_ns, 8);
    for (int c = 0; c < CHANNELS; c++)
        put_real(out + HEAD + 8 * c, volts[c]);
    return seal(out, SAMPLES, CHANNELS, t->key);
}

/* Go on while a command is late, rest the table when none came for too long; while it rests, lead it to zero (shape
 * this as your table needs). */
void watch(struct target *t)
{
    int64_t now_ns = clock_ns();
    if (t->state == ARMED && now_ns - t->heard_ns > t->watchdog_ns)
        t->faults |= WATCHDOG, t->state = RESTING, t->moved_ns = now_ns;
    if (t->state == ARMED)
        go_on(t, now_ns);
    if (t->state != RESTING)
        return;
    int64_t passed = now_ns - t->moved_ns < t->interval_ns ? now_ns - t->moved_ns : t->interval_ns; /* or we stalled */
    double step = REST_V_PER_S * 1e-9 * (double)passed, u = t->command_v;
    t->moved_ns = now_ns;
    t->command_v = u > step ? u - step : u < -step ? u + step : 0.0;
    write_command(t->command_v, now_ns);
    if (t->command_v == 0.0)
        t->state = RESTED;
}
