/* Fuzzes the host's end of a serial line: any bytes in two pieces, and the frames of them to snapshots. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../../firmware_protocol/port/host/line.h"
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

/* Reads packed frames, or what is none, to the end; what no snapshot has is stepped over. */
static void read_packed(const uint8_t *bytes, size_t size) {
    uint8_t *packed = exactly(bytes, size);
    wheel_reader *reader = room(wheel_reader_size());
    wheel_reader_init(reader);
    const wheel_snapshot *s = wheel_reader_snapshot(reader);
    size_t at = 0;
    bool restarted = false;
    while (at < size) {
        const wheel_snapshot before = *s;
        const size_t end = wheel_reader_take(reader, packed, at, size);
        CHECK(end >= at && end <= size);
        CHECK((end == at) == (s->frames == before.frames));
        CHECK(s->completed - before.completed <= s->frames - before.frames);
        CHECK(s->steps_done - before.steps_done <= 1u);
        CHECK(s->completed == before.completed || s->robot_time_us >= before.robot_time_us || restarted ||
              before.completed == 0u);
        CHECK(s->state <= 6u);
        CHECK(s->slow > 0u || (isnan(s->yaw_rate_rad_s) && isnan(s->current_a[0])));
        CHECK(s->ticks - before.ticks <= sizeof s->sequences);
        if (at == 0u && size % 3u == 0u) {
            wheel_reader_restart(reader);
            restarted = true;
        }
        at = end;
        if (s->steps_done == before.steps_done && at < size) {
            at +=
                size - at < 3u ? size - at : 3u + (size_t)packed[at + 2u]; /* over the frame of no snapshot */
        }
    }
    free(reader);
    free(packed);
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
        uint8_t out[WHEEL_LINE_LONGEST];
        uint8_t again[WHEEL_LINE_LONGEST + WHEEL_LINE_OPEN];
        size_t written = 0;
        const size_t encoded = wheel_line_encode(line, id, packed + at + 3u, length, out);
        CHECK(encoded == length + (id == WP_ESTOP_ID ? 8u : 7u)); /* an ESTOP begins with a zero */
        CHECK(wheel_line_encode(line, id, packed + at + 3u, length + 1u, out) == 0u);
        CHECK(wheel_line_encode(line, id, packed + at + 3u, 200u, out) == 0u);
        CHECK(wheel_line_feed(line, out, encoded, again, &written) == 1u);
        CHECK(written == 3u + length && memcmp(again, packed + at, written) == 0);
        at += 3u + length;
    }
    free(line);
    return count;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    wheel_line *line = room(wheel_line_size());
    wheel_line_init(line);
    const size_t cut = size == 0u ? 0u : data[size - 1u] % size;
    const size_t sizes[2] = {cut, size - cut};
    uint8_t *all = room(size);
    size_t all_used = 0;
    size_t frames = 0;
    for (size_t i = 0; i < 2u; i++) {
        uint8_t *piece = exactly(data + (i == 0u ? 0u : cut), sizes[i]);
        uint8_t *packed = room(sizes[i] + WHEEL_LINE_OPEN);
        size_t used = 0;
        const size_t count = wheel_line_feed(line, piece, sizes[i], packed, &used);
        CHECK(used <= sizes[i] + WHEEL_LINE_OPEN && all_used + used <= size);
        CHECK(check_packed(packed, used) == count);
        memcpy(all + all_used, packed, used);
        all_used += used;
        frames += count;
        free(packed);
        free(piece);
    }
    wheel_line_counts counts;
    wheel_line_count(line, &counts);
    CHECK(counts.frames == frames);
    read_packed(all, all_used);
    read_packed(data, size);
    free(all);
    free(line);
    return 0;
}
