/* udp_target.c on a PC (POSIX) with a simulated table, which follows its command with a lag of 20 ms.
 *
 * cc -std=c99 -O2 -o udp_target udp_target_pc.c && ./udp_target 47800 KEYFILE [ADDRESS]
 */
#define _POSIX_C_SOURCE 200809L
#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/select.h>
#include <sys/socket.h>
#include <time.h>

#include "udp_target.c"

static struct { double position_v, command_v; int64_t now_ns; } table;

static void move_table(int64_t now_ns)
{
    double lags = 50e-9 * (double)(now_ns - table.now_ns);
    table.position_v = (table.position_v + lags * table.command_v) / (1.0 + lags);
    table.now_ns = now_ns;
}

void read_samples(double volts[CHANNELS], int64_t now_ns)
{
    move_table(now_ns);
    for (int c = 0; c < CHANNELS; c++)
        volts[c] = table.position_v * (c + 1);
}

void write_command(double volts, int64_t now_ns)
{
    move_table(now_ns);
    table.command_v = volts;
}

static int fail(const char *sentence)
{
    fprintf(stderr, "udp_target: %s\n", sentence);
    exit(2);
}

void random_bytes(uint8_t *bytes, size_t count)
{
    FILE *file = fopen("/dev/urandom", "rb");
    if (!file || fread(bytes, 1, count, file) != count)
        fail("no random numbers from /dev/urandom");
    fclose(file);
}

int64_t clock_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

static void read_secret(const char *path, uint8_t secret[16])
{
    FILE *file = fopen(path, "r");
    int different = 0;
    for (int i = 0; i < 16; i++) {
        if (!file || fscanf(file, "%2hhx", &secret[i]) != 1)
            fail("the key file must hold 32 hexadecimal digits");
        different |= secret[i] ^ secret[0];
    }
    fclose(file);
    if (!different)
        fail("the key file holds one byte 16 times, which anybody may guess; make another");
}

static int listen_at(const char *address, int port)
{
    struct sockaddr_in own = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    socklen_t length = sizeof own;
    int door = socket(AF_INET, SOCK_DGRAM, 0);
    if (inet_pton(AF_INET, address, &own.sin_addr) != 1 || bind(door, (struct sockaddr *)&own, sizeof own) != 0)
        fail("cannot listen there; choose another port or address");
    getsockname(door, (struct sockaddr *)&own, &length);
    printf("listening at %s:%d\n", address, ntohs(own.sin_port));
    fflush(stdout);
    return door;
}

static void wait_for_packet(int door, int64_t longest_ns)
{
    struct timespec longest = {.tv_nsec = (long)longest_ns};
    fd_set doors;
    FD_ZERO(&doors);
    FD_SET(door, &doors);
    pselect(door + 1, &doors, NULL, NULL, &longest, NULL);
}

int main(int count, char **words)
{
    static struct target target;
    uint8_t in[MOST + 1], out[MOST];
    struct sockaddr_in peer;
    if (count < 3)
        fail("usage: udp_target PORT KEYFILE [ADDRESS]");
    read_secret(words[2], target.secret);
    int door = listen_at(count > 3 ? words[3] : "127.0.0.1", atoi(words[1]));
    for (;;) {
        socklen_t length = sizeof peer;
        wait_for_packet(door, target.state == ARMED && target.interval_ns < 4000000 ? target.interval_ns / 4 : 1000000);
        ssize_t got = recvfrom(door, in, sizeof in, MSG_DONTWAIT, (struct sockaddr *)&peer, &length);
        size_t size = got > 0 ? handle(&target, in, (size_t)got, out) : 0;
        if (size > 0)
            sendto(door, out, size, 0, (struct sockaddr *)&peer, length);
        watch(&target);
    }
}
