/* Arms a robot on a serial line, drives it forward for a second, and stops it. In firmware_protocol/:
 *     cc -I. ../docs/examples/drive.c client/[a-z]*.c firmware/{framing,cobs,crc}.c generated/[a-z]*.c -lm
 *     hil device paper_circle --link serial:pty --mode realtime     and, with the port that it prints:
 *     ./a.out /dev/pts/5 */
#include "client/wheel_client.h"
#include "client/wheel_line.h"
#include <fcntl.h>
#include <stdio.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>
#define PERIOD_NS 10000000
static const double forward[4] = {4, 4, 4, 4}, nothing[4] = {0, 0, 0, 0}; /* rad/s, N.m */
static wheel_client client;
static wheel_line line;
static void receive(int port, int64_t now_ns) {
    uint8_t bytes[1024], packed[sizeof bytes + WHEEL_LINE_OPEN];
    size_t used = 0;
    const ssize_t count = read(port, bytes, sizeof bytes);
    wheel_line_feed(&line, bytes, count > 0 ? (size_t)count : 0u, packed, &used);
    for (size_t at = 0; at < used;)
        at = wheel_client_take(&client, packed, at, used, now_ns);
}

int main(int count, char **words) {
    uint8_t bytes[WHEEL_LINE_GROWTH * WHEEL_CLIENT_OUT];
    struct termios settings;
    const int port = count == 2 ? open(words[1], O_RDWR | O_NOCTTY | O_NONBLOCK) : -1;
    if (port < 0 || tcgetattr(port, &settings) != 0)
        return fprintf(stderr, "usage: drive PORT, a serial port that can be opened\n"), 2;
    cfmakeraw(&settings), cfsetspeed(&settings, B921600), tcsetattr(port, TCSANOW, &settings);
    wheel_line_init(&line), wheel_client_init(&client, WP_MODE_SPEED, 0, 0);
    uint16_t nonce = (uint16_t)time(NULL); /* one that the robot has not seen */
    wheel_client_begin(&client, nonce);
    int driven = -1; /* periods since the robot was ACTIVE */
    for (int64_t now_ns = 0; now_ns < 500LL * PERIOD_NS; now_ns += PERIOD_NS) {
        receive(port, now_ns);
        wheel_client_expect(&client, (uint8_t)client.robot.parameters.parameter_hash); /* whatever it has */
        wheel_client_poll(&client, now_ns);
        if (driven < 0) {
            const uint8_t step = wheel_client_arm(&client, now_ns);
            driven = step == WHEEL_ARMING_DONE ? 0 : -1;
            if (step == WHEEL_ARMING_NEW_NONCE)
                wheel_client_renew(&client, ++nonce);
        } else if (driven++ < 100) {
            wheel_client_command(&client, forward, nothing, now_ns);
        } else if (client.view.request != WP_REQUEST_IDLE) {
            printf("%.2f rad/s\n", (double)client.view.speed_rad_s[0]);
            wheel_client_request(&client, WP_REQUEST_IDLE, now_ns);
        } else if (client.view.state == WP_STATE_IDLE) {
            return puts("at rest"), 0;
        }
        const size_t size = wheel_line_encode(&line, wheel_client_out(&client), client.view.out_bytes, bytes);
        wheel_client_sent(&client);
        if (write(port, bytes, size) != (ssize_t)size)
            break;
        nanosleep(&(struct timespec){.tv_nsec = PERIOD_NS}, NULL);
    }
    return fprintf(stderr, "the robot did not answer, or did not come to rest\n"), 3;
}
