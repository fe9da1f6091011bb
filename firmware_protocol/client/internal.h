/* What the files of the client share. */
#ifndef WHEEL_CLIENT_INTERNAL_H
#define WHEEL_CLIENT_INTERNAL_H

#include "wheel_client.h"

/* Adds a packed frame to a log, which has room for it; returns how many bytes were added: none without a
 * log. */
size_t wheel_log_add(wheel_client *client, wheel_log *log, const uint8_t *packed, size_t size);

static inline bool wheel_log_has_room(const wheel_client *client, const wheel_log *log, size_t size) {
    return log->bytes == NULL || log->used + size <= client->log_capacity;
}

/* Forgets half a snapshot, and the numbers and the clock of a robot that may have been reset. */
void wheel_feedback_restart(wheel_client *client);

#endif
