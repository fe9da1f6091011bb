/* Fuzzes the host's end of a serial line: any bytes in two pieces. */
#include <stdlib.h>
#include <string.h>

#include "../../../firmware_protocol/client/wheel_line.h"
#include "check.h"
#include "wire_mutator.h"

const size_t wire_header_size = 0;

uint8_t wire_parameter_check(void) {
    return 0u;
}

static void *room(size_t size) {
    void *memory = calloc(1, size + (size == 0u));
    CHECK(memory != NULL);
    return memory;
}

/* As many frames as the packed bytes hold, each of the length of its id, and each encoded to what is read
 * again. */
static size_t check_packed(const uint8_t *packed, size_t used) {
    wheel_line *line = room(wheel_line_size());
    wheel_line_init(line);
    size_t count = 0;
    for (size_t at = 0; at < used; count++) {
        const uint16_t id = (uint16_t)(packed[at] | (packed[at + 1u] << 8));
        const size_t length = packed[at + 2u];
        CHECK((int)length == wp_payload_length(id) && at + 3u + length <= used);
        uint8_t out[WHEEL_LINE_GROWTH * 11u];
        uint8_t again[WHEEL_LINE_GROWTH * 11u + WHEEL_LINE_OPEN];
        size_t written = 0;
        CHECK(wheel_line_encode(line, packed + at, 3u + length - 1u, out) == 0u);
        const size_t encoded = wheel_line_encode(line, packed + at, 3u + length, out);
        CHECK(encoded == length + (id == WP_ESTOP_ID ? 8u : 7u)); /* an ESTOP begins with a zero */
        CHECK(wheel_line_feed(line, out, encoded, again, &written) == 1u);
        CHECK(written == 3u + length && memcmp(again, packed + at, written) == 0);
        at += 3u + length;
    }
    uint8_t *whole = room(WHEEL_LINE_GROWTH * used);
    CHECK((wheel_line_encode(line, packed, used, whole) > 0u) == (used > 0u));
    free(whole);
    free(line);
    return count;
}

/* Both groups have all the bytes, each its own ids. */
static void check_split(const uint8_t *packed, size_t used, uint16_t limit) {
    uint8_t *out = room(used);
    size_t written = 0;
    const size_t begin = wheel_packed_split(packed, used, limit, out, &written);
    CHECK(written == used && begin <= used);
    for (size_t at = 0; at < used; at += 3u + out[at + 2u]) {
        CHECK(((out[at] | (out[at + 1u] << 8)) < limit) == (at < begin));
    }
    free(out);
    uint8_t *any = room(used); /* from any byte on it is something else, or cut */
    CHECK(used == 0u || wheel_packed_split(packed + 1u, used - 1u, limit, any, &written) <= written);
    CHECK(used == 0u || written <= used - 1u);
    free(any);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    wheel_line *line = room(wheel_line_size());
    wheel_line_init(line);
    const size_t cut = size == 0u ? 0u : data[size - 1u] % size;
    const size_t sizes[2] = {cut, size - cut};
    size_t all_used = 0;
    size_t frames = 0;
    for (size_t i = 0; i < 2u; i++) {
        uint8_t *piece = exactly(data + (i == 0u ? 0u : cut), sizes[i]);
        uint8_t *packed = room(sizes[i] + WHEEL_LINE_OPEN);
        size_t used = 0;
        const size_t count = wheel_line_feed(line, piece, sizes[i], packed, &used);
        CHECK(used <= sizes[i] + WHEEL_LINE_OPEN && all_used + used <= size);
        CHECK(check_packed(packed, used) == count);
        check_split(packed, used, size == 0u ? 0u : (uint16_t)(data[size - 1u] * 8u));
        all_used += used;
        frames += count;
        free(packed);
        free(piece);
    }
    wheel_line_counts counts;
    wheel_line_count(line, &counts);
    CHECK(counts.frames == frames);
    free(line);
    return 0;
}
