/* The age of feedback, and the latency of commands. */
#include "wheel_timing.h"

#include <string.h>

#include "../generated/wheel_messages.h"

/* Silence that ends a run, and the greatest age of unread feedback while driving. */
#define LOST_NS INT64_C(250000000)
/* A jump of the robot's clock by this is a reset: no stall of a machine lasts so long with the link intact.
 */
#define LEAP_NS INT64_C(1000000000)

#define FEWEST 9u          /* commands for a median */
#define AGE_AT_MOST_MS 255 /* TICK.command_age_ms is limited to this */
#define MS_NS INT64_C(1000000)

/* Whether the robot's clock jumped since the newest feedback. */
static bool began_anew(const wheel_freshness *f, int64_t robot_ns, int64_t now_ns) {
    const int64_t jump_ns = robot_ns - f->newest_ns - (now_ns - f->received_ns);
    return jump_ns <= -LEAP_NS || jump_ns >= LEAP_NS;
}

static void add_truth(wheel_freshness *f, int64_t robot_ns, int64_t now_ns, int64_t truth_ns) {
    if (f->is_apart || (f->has_stamp && truth_ns < f->truth_stamp_ns - f->stale_ns)) {
        f->ahead_ns = robot_ns - truth_ns;
        f->is_apart = false;
    }
    if (!f->has_stamp || truth_ns != f->truth_stamp_ns) {
        f->has_stamp = true;
        f->truth_stamp_ns = truth_ns;
        f->truth_received_ns = now_ns;
    }
    f->has_truth = true;
    f->truth_ns = truth_ns + f->ahead_ns;
}

uint8_t wheel_freshness_add(wheel_freshness *f, int64_t robot_ns, uint8_t state, int64_t age_ns,
                            int64_t now_ns, bool is_driven, const int64_t *truth_ns) {
    if (!f->has_received || (robot_ns != f->newest_ns && age_ns <= f->stale_ns)) {
        if (!is_driven && f->has_received && began_anew(f, robot_ns, now_ns)) {
            return WHEEL_FRESHNESS_RESET;
        }
        f->has_received = true;
        f->newest_ns = robot_ns;
        f->received_ns = now_ns;
    }
    f->silent_ns = now_ns - f->received_ns;
    if (is_driven && state != WP_STATE_ACTIVE) {
        return WHEEL_FRESHNESS_STATE;
    }
    if (age_ns > (is_driven ? LOST_NS : LEAP_NS)) {
        return WHEEL_FRESHNESS_UNREAD;
    }
    if (age_ns <= f->stale_ns && f->silent_ns > LOST_NS) {
        return WHEEL_FRESHNESS_SILENT;
    }
    if (truth_ns != NULL) {
        add_truth(f, robot_ns, now_ns, *truth_ns);
    }
    f->is_stale = f->silent_ns > f->stale_ns ||
                  (f->has_truth &&
                   (robot_ns - f->truth_ns > f->stale_ns || now_ns - f->truth_received_ns > f->stale_ns));
    return WHEEL_FRESHNESS_GOOD;
}

void wheel_freshness_restart(wheel_freshness *f, bool was_reset) {
    f->has_received = false;
    if (was_reset) {
        f->has_truth = false;
        f->is_apart = true;
    }
}

void wheel_latency_init(wheel_latency *latency, double configured_s, int64_t longest_ns) {
    memset(latency, 0, sizeof *latency);
    latency->median_s = configured_s;
    latency->longest_ns = longest_ns;
}

/* Adds a value to the sorted ones, in the place of one that is among them, or behind the last. */
static void sort_in(wheel_latency *latency, uint32_t place, int64_t value_ns) {
    int64_t *sorted_ns = latency->sorted_ns;
    const uint32_t last =
        latency->count < WHEEL_LATENCY_COMMANDS ? latency->count : WHEEL_LATENCY_COMMANDS - 1u;
    while (place < last && sorted_ns[place + 1u] < value_ns) {
        sorted_ns[place] = sorted_ns[place + 1u];
        place++;
    }
    while (place > 0u && sorted_ns[place - 1u] > value_ns) {
        sorted_ns[place] = sorted_ns[place - 1u];
        place--;
    }
    sorted_ns[place] = value_ns;
}

void wheel_latency_acted(wheel_latency *latency, uint8_t sequence, int64_t robot_ns, uint8_t age_ms) {
    if (!latency->is_sent[sequence] || age_ms >= AGE_AT_MOST_MS) {
        return;
    }
    latency->is_sent[sequence] = false;
    const int64_t latency_ns = robot_ns - age_ms * MS_NS - latency->sampled_ns[sequence];
    if (latency_ns < 0 || latency_ns > latency->longest_ns) {
        return;
    }
    int64_t *oldest_ns = &latency->recent_ns[latency->count % WHEEL_LATENCY_COMMANDS];
    if (latency->count < WHEEL_LATENCY_COMMANDS) {
        sort_in(latency, latency->count, latency_ns);
    } else if (*oldest_ns != latency_ns) {
        uint32_t place = 0;
        while (latency->sorted_ns[place] != *oldest_ns) {
            place++;
        }
        sort_in(latency, place, latency_ns);
    }
    *oldest_ns = latency_ns;
    latency->count++;
    if (latency->count >= FEWEST) {
        const uint32_t known =
            latency->count < WHEEL_LATENCY_COMMANDS ? latency->count : WHEEL_LATENCY_COMMANDS;
        latency->median_s = (double)latency->sorted_ns[(known - 1u) / 2u] * 1e-9;
    }
}

void wheel_latency_sent(wheel_latency *latency, uint8_t sequence, int64_t sampled_ns) {
    latency->sampled_ns[sequence] = sampled_ns;
    latency->is_sent[sequence] = true;
}

void wheel_latency_restart(wheel_latency *latency) {
    memset(latency->is_sent, 0, sizeof latency->is_sent);
}
