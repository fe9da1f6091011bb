/* Fuzzes the age of feedback and the latency of commands: any order of calls with any times, forward or back.
 * What they keep is compared with a plain computation over all that was added. */
#include <stdlib.h>
#include <string.h>

#include "../../../firmware_protocol/client/wheel_timing.h"
#include "check.h"
#include "wire_mutator.h"

#define CALL 6u
#define MOST 128u

const size_t wire_header_size = 0;

uint8_t wire_parameter_check(void) {
    return 0x5Au;
}

static int ascending(const void *one, const void *other) {
    const int64_t a = *(const int64_t *)one;
    const int64_t b = *(const int64_t *)other;
    return (a > b) - (a < b);
}

/* The lower median of the last ones. */
static double median_s(const int64_t *all_ns, size_t count) {
    int64_t last_ns[WHEEL_LATENCY_COMMANDS];
    const size_t used = count < WHEEL_LATENCY_COMMANDS ? count : WHEEL_LATENCY_COMMANDS;
    memcpy(last_ns, all_ns + count - used, used * sizeof *last_ns);
    qsort(last_ns, used, sizeof *last_ns, ascending);
    return (double)last_ns[(used - 1u) / 2u] * 1e-9;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    wheel_freshness freshness = {.stale_ns = 50000000};
    wheel_latency latency;
    int64_t seen_ns[MOST];
    int64_t sampled_ns[256];
    bool is_sent[256] = {false};
    size_t seen = 0;
    wheel_latency_init(&latency, 0.02, 100000000);
    for (size_t at = 0; at + CALL <= size && seen < MOST; at += CALL) {
        const uint8_t *call = data + at;
        /* Near to each other, so that most are possible; or up to 39 hours away. */
        const int64_t far_ns = (call[0] & 1u) != 0u ? (call[4] - INT64_C(128)) * (INT64_C(1) << 40) : 0;
        const int64_t one_ns = call[3] * INT64_C(1000000) + far_ns;
        const int64_t other_ns = call[5] * INT64_C(1000000) + call[4];
        const uint8_t sequence = call[1];
        switch (call[0] / 2u % 6u) {
        case 0: {
            const bool was_truth = freshness.has_truth;
            const uint8_t result =
                wheel_freshness_add(&freshness, one_ns, call[1] % 7u, call[2] * INT64_C(8000000), other_ns,
                                    (call[1] & 8u) != 0u, (call[1] & 16u) != 0u ? &other_ns : NULL);
            CHECK(result <= WHEEL_FRESHNESS_SILENT);
            CHECK(freshness.has_received);
            CHECK(result == WHEEL_FRESHNESS_RESET || freshness.silent_ns == other_ns - freshness.received_ns);
            CHECK(result != WHEEL_FRESHNESS_GOOD ||
                  freshness.has_truth == (was_truth || (call[1] & 16u) != 0u));
            CHECK(result != WHEEL_FRESHNESS_GOOD || freshness.silent_ns <= freshness.stale_ns ||
                  freshness.is_stale);
            break;
        }
        case 1:
            wheel_freshness_restart(&freshness, (call[1] & 1u) != 0u);
            CHECK(!freshness.has_received && !((call[1] & 1u) != 0u && freshness.has_truth));
            break;
        case 2:
            wheel_latency_restart(&latency);
            memset(is_sent, 0, sizeof is_sent);
            break;
        case 3:
            wheel_latency_sent(&latency, sequence, one_ns);
            is_sent[sequence] = true;
            sampled_ns[sequence] = one_ns;
            break;
        default:
            wheel_latency_acted(&latency, sequence, other_ns, call[2]);
            if (is_sent[sequence] && call[2] < 255u) {
                const int64_t took_ns = other_ns - call[2] * INT64_C(1000000) - sampled_ns[sequence];
                is_sent[sequence] = false;
                if (took_ns >= 0 && took_ns <= 100000000) {
                    seen_ns[seen++] = took_ns;
                }
            }
        }
        CHECK(latency.count == seen);
        CHECK(latency.median_s == (seen < 9u ? 0.02 : median_s(seen_ns, seen)));
    }
    return 0;
}
