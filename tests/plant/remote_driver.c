/* Both ends of a remote plant's pipes under the sanitizers, one of them a child that answers in pieces, lies
 * and goes away; exits with 0 when all went as it should. */
#define _POSIX_C_SOURCE 200809L
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "remote.h"

#define CHECK(condition)                                                                                     \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition);                                          \
            return 1;                                                                                        \
        }                                                                                                    \
    } while (0)

enum { REFUSED_TICK = 20, FAILED_TICK = 40 };

static volatile sig_atomic_t interruptions;

static void interrupt(int number) {
    (void)number;
    interruptions++;
}

static void write_in_pieces(int end, const void *from, size_t size) {
    const char *const bytes = from;
    const struct timespec pause = {.tv_nsec = 200000};
    for (size_t done = 0; done < size;) {
        const size_t piece = size - done < 97 ? size - done : 97;
        if (write(end, bytes + done, piece) != (ssize_t)piece) {
            _exit(1);
        }
        done += piece;
        nanosleep(&pause, NULL);
    }
}

/* Answers each tick with its number; leaves in the middle of a reply. */
static int serve(const remote_pipes *pipes) {
    remote_request request;
    while (remote_next(pipes, &request) == 0) {
        const uint32_t tick = request.drive.tick;
        remote_reply reply = {
            .begin = REMOTE_MARK, .status = REMOTE_DONE, .sense.tick = tick + 1, .time_ns = tick};
        reply.end = REMOTE_MARK;
        memset(reply.text, 'x', sizeof reply.text); /* never ended */
        if (tick == REFUSED_TICK || tick == FAILED_TICK) {
            reply.status = tick == REFUSED_TICK ? REMOTE_REFUSED : REMOTE_FAILED;
        }
        if (request.kind == REMOTE_WIRE) {
            reply.end = 0; /* bytes of somebody else */
        }
        if (request.kind == REMOTE_RESET) {
            write_in_pieces((int)pipes->write_end, &reply, sizeof reply / 2);
            return 0;
        }
        write_in_pieces((int)pipes->write_end, &reply, sizeof reply);
    }
    return 0;
}

static int ask(remote_plant *plant) {
    wheel_drive drive = {0};
    wheel_sense sense = {0};
    for (drive.tick = 0; drive.tick < FAILED_TICK; drive.tick++) {
        const int status = remote_exchange(plant, &drive, &sense);
        CHECK(status == (drive.tick == REFUSED_TICK));
        CHECK(!plant->failed && !plant->lost && plant->asked == plant->answered);
        CHECK(status != 0 || (sense.tick == drive.tick + 1 && plant->newest.time_ns == drive.tick));
    }
    CHECK(interruptions > 0);
    CHECK(remote_exchange(plant, &drive, &sense) == 1);
    CHECK(plant->failed && !plant->lost);
    CHECK(plant->newest.time_ns == FAILED_TICK - 1);
    CHECK(remote_exchange(plant, NULL, &sense) == 1);
    CHECK(plant->asked == FAILED_TICK + 1); /* a plant that failed is not asked again */
    plant->failed = 0;
    const remote_request wire = {.kind = REMOTE_WIRE};
    CHECK(remote_ask(plant, &wire) == 1);
    CHECK(plant->failed && plant->foreign && !plant->lost);
    plant->failed = 0;
    const remote_request reset = {.kind = REMOTE_RESET};
    CHECK(remote_ask(plant, &reset) == 1);
    CHECK(plant->failed && plant->lost && !plant->foreign && plant->asked == plant->answered);
    plant->failed = 0;
    CHECK(remote_ask(plant, &reset) == 1); /* nobody is there to take it */
    CHECK(plant->lost);
    return 0;
}

int main(void) {
    int requests[2], replies[2];
    CHECK(pipe(requests) == 0 && pipe(replies) == 0);
    signal(SIGPIPE, SIG_IGN); /* as Python has it */
    const pid_t child = fork();
    CHECK(child >= 0);
    if (child == 0) {
        close(requests[1]);
        close(replies[0]);
        _exit(serve(&(remote_pipes){.read_end = requests[0], .write_end = replies[1]}));
    }
    close(requests[0]);
    close(replies[1]);
    /* Signals without SA_RESTART, as Python sets them. */
    const struct sigaction action = {.sa_handler = interrupt};
    CHECK(sigaction(SIGALRM, &action, NULL) == 0);
    const struct itimerval often = {.it_interval.tv_usec = 500, .it_value.tv_usec = 500};
    CHECK(setitimer(ITIMER_REAL, &often, NULL) == 0);
    remote_plant plant = {.pipes = {.read_end = replies[0], .write_end = requests[1]}};
    const int status = ask(&plant);
    close(requests[1]);
    while (waitpid(child, NULL, 0) < 0) {
    }
    return status;
}
