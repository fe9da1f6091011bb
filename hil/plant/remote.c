#include "remote.h"

#include <stdio.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>

/* Returns the bytes moved, or 0 at the end of the pipe. */
static size_t read_some(intptr_t end, void *to, size_t size) {
    DWORD moved = 0;
    return ReadFile((HANDLE)end, to, (DWORD)size, &moved, NULL) ? moved : 0;
}

static size_t write_some(intptr_t end, const void *from, size_t size) {
    DWORD moved = 0;
    return WriteFile((HANDLE)end, from, (DWORD)size, &moved, NULL) ? moved : 0;
}
#else
#include <errno.h>
#include <unistd.h>

/* Returns the bytes moved, or 0 at the end of the pipe. A signal does not end the wait. */
static size_t read_some(intptr_t end, void *to, size_t size) {
    ssize_t moved;
    do {
        moved = read((int)end, to, size);
    } while (moved < 0 && errno == EINTR);
    return moved > 0 ? (size_t)moved : 0;
}

static size_t write_some(intptr_t end, const void *from, size_t size) {
    ssize_t moved;
    do {
        moved = write((int)end, from, size);
    } while (moved < 0 && errno == EINTR);
    return moved > 0 ? (size_t)moved : 0;
}
#endif

static int read_whole(intptr_t end, void *to, size_t size) {
    char *const bytes = to;
    for (size_t done = 0; done < size;) {
        const size_t moved = read_some(end, bytes + done, size - done);
        if (moved == 0) {
            return 1;
        }
        done += moved;
    }
    return 0;
}

static int write_whole(intptr_t end, const void *from, size_t size) {
    const char *const bytes = from;
    for (size_t done = 0; done < size;) {
        const size_t moved = write_some(end, bytes + done, size - done);
        if (moved == 0) {
            return 1;
        }
        done += moved;
    }
    return 0;
}

int remote_ask(remote_plant *plant, const remote_request *request) {
    if (plant->failed) {
        return 1;
    }
    plant->asked++;
    plant->lost = write_whole(plant->pipes.write_end, request, sizeof *request) != 0 ||
                  read_whole(plant->pipes.read_end, &plant->reply, sizeof plant->reply) != 0;
    plant->answered++;
    plant->foreign = !plant->lost && (plant->reply.begin != REMOTE_MARK || plant->reply.end != REMOTE_MARK);
    if (plant->foreign) {
        plant->failed = 1;
        return 1;
    }
    if (plant->lost || plant->reply.status != REMOTE_DONE) {
        plant->failed = plant->lost || plant->reply.status != REMOTE_REFUSED;
        return 1;
    }
    plant->newest = plant->reply;
    return 0;
}

int remote_exchange(void *context, const wheel_drive *drive, wheel_sense *sense) {
    remote_plant *const plant = context;
    remote_request request = {.kind = REMOTE_SAMPLE};
    if (drive != NULL) {
        request.kind = REMOTE_TICK;
        request.drive = *drive;
    }
    if (remote_ask(plant, &request) != 0) {
        return 1;
    }
    *sense = plant->newest.sense;
    return 0;
}

int remote_set(void *context, size_t place, double value) {
    const remote_request request = {.kind = REMOTE_SET, .place = place, .value = value};
    return remote_ask(context, &request);
}

int remote_next(const remote_pipes *pipes, remote_request *request) {
    return read_whole(pipes->read_end, request, sizeof *request);
}

int remote_answer(const remote_pipes *pipes, remote_reply *reply) {
    reply->begin = reply->end = REMOTE_MARK;
    return write_whole(pipes->write_end, reply, sizeof *reply);
}

void remote_flush_lines(void) {
#ifdef _WIN32
    setvbuf(stdout, NULL, _IONBF, 0); /* it takes _IOLBF for a full buffer */
#else
    setvbuf(stdout, NULL, _IOLBF, BUFSIZ);
#endif
}
