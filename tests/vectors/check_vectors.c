/* Runs the C codec and the C framing over the golden vectors; the tests build it with ASan and UBSan.
 *
 *   check_vectors frames.csv rejected.csv
 *
 * Prints one line a failure and a summary; exits 1 when anything failed.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../../firmware_protocol/firmware/framing.h"

#define LINE_MAX_BYTES 512
#define SERIAL_MAX 64
#define FRAMES_MAX 256

typedef struct {
    wheel_frame frame;
    uint8_t sequence;
    uint8_t serial[SERIAL_MAX];
    size_t serial_length;
} vector;

static unsigned failures = 0;

static void check(bool holds, const char *what, const char *where) {
    if (!holds) {
        printf("FAILED %s: %s\n", what, where);
        failures++;
    }
}

static size_t from_hex(const char *hex, uint8_t *bytes, size_t room) {
    const size_t length = strlen(hex) / 2;
    if (length > room) {
        printf("FAILED a vector has %zu bytes, room for %zu\n", length, room);
        exit(1);
    }
    for (size_t i = 0; i < length; i++) {
        const char pair[3] = {hex[2 * i], hex[2 * i + 1], '\0'};
        bytes[i] = (uint8_t)strtoul(pair, NULL, 16);
    }
    return length;
}

/* Splits in place at commas; returns the number of columns. */
static size_t split(char *line, char *columns[], size_t room) {
    size_t count = 0;
    line[strcspn(line, "\r\n")] = '\0';
    for (char *at = line; at != NULL && count < room; count++) {
        columns[count] = at;
        at = strchr(at, ',');
        if (at != NULL) {
            *at++ = '\0';
        }
    }
    return count;
}

static FILE *open_table(const char *path) {
    char header[LINE_MAX_BYTES];
    FILE *file = fopen(path, "r");
    if (file == NULL || fgets(header, sizeof header, file) == NULL) {
        printf("FAILED cannot read %s\n", path);
        exit(1);
    }
    return file;
}

/* Feeds bytes; returns how many frames came out and keeps the last. */
static unsigned feed(wheel_deframer *deframer, const uint8_t *bytes, size_t length, wheel_frame *frame) {
    unsigned count = 0;
    for (size_t i = 0; i < length; i++) {
        count += wheel_deframer_feed(deframer, bytes[i], frame) ? 1u : 0u;
    }
    return count;
}

static bool same(const wheel_frame *a, const wheel_frame *b) {
    return a->id == b->id && a->length == b->length && memcmp(a->payload, b->payload, a->length) == 0;
}

/* Decoding and encoding gives the payload back; any other length is refused. The payload stands in memory of
 * exactly its length, so that the sanitizer sees a read beyond it. */
#define ROUND_TRIP(NAME, name)                                                                               \
    case WP_##NAME##_ID: {                                                                                   \
        wp_##name message;                                                                                   \
        decoded = wp_##name##_decode(payload, length, &message);                                             \
        refused = !wp_##name##_decode(payload, length - 1, &message) &&                                      \
                  !wp_##name##_decode(payload, length + 1, &message);                                        \
        encoded = wp_##name##_encode(&message, again);                                                       \
        break;                                                                                               \
    }

static void check_codec(const vector *v, const char *name) {
    const size_t length = v->frame.length;
    uint8_t *payload = malloc(length);
    uint8_t *again = malloc(length);
    bool decoded = false;
    bool encoded = false;
    bool refused = false;
    if (payload == NULL || again == NULL) {
        exit(1);
    }
    memcpy(payload, v->frame.payload, length);
    switch (v->frame.id) {
        WP_MESSAGES(ROUND_TRIP)
    default:
        break;
    }
    check(decoded && encoded && memcmp(payload, again, length) == 0, "decode and encode", name);
    check(refused, "a wrong length is refused", name);
    free(payload);
    free(again);
}

static void check_framing(const vector *v, const char *name) {
    uint8_t out[WHEEL_FRAME_MAX];
    const size_t written = wheel_frame_encode(&v->frame, v->sequence, out);
    check(written == v->serial_length && memcmp(out, v->serial, written) == 0, "frame encode", name);

    wheel_deframer deframer;
    wheel_frame frame;
    wheel_deframer_init(&deframer);
    const unsigned count = feed(&deframer, v->serial, v->serial_length, &frame);
    check(count == 1 && same(&frame, &v->frame) && deframer.frames == 1, "frame decode", name);
}

/* With any one or two bits wrong, its zero included, a frame as sent on the wire is dropped. The frame behind
 * it comes out unchanged; it is lost only where the zero between them was hit. Returns how many were tried.
 */
static unsigned long check_bit_errors(const vector *v, const vector *next, const char *name) {
    const size_t bits = 8 * v->serial_length;
    unsigned long tried = 0;
    for (size_t i = 0; i < bits; i++) {
        for (size_t j = i; j < bits; j++) {
            uint8_t wire[SERIAL_MAX];
            memcpy(wire, v->serial, v->serial_length);
            wire[i / 8] ^= (uint8_t)(1u << (i % 8));
            if (j != i) {
                wire[j / 8] ^= (uint8_t)(1u << (j % 8));
            }
            wheel_deframer deframer;
            wheel_frame frame;
            wheel_deframer_init(&deframer);
            check(feed(&deframer, wire, v->serial_length, &frame) == 0, "bit errors are noticed", name);
            const bool ended = wire[v->serial_length - 1] == 0;
            const unsigned count = feed(&deframer, next->serial, next->serial_length, &frame);
            check(count == 1 || (count == 0 && !ended), "the next frame comes", name);
            check(count == 0 || same(&frame, &next->frame), "the next frame is unchanged", name);
            tried++;
        }
    }
    return tried;
}

static size_t read_frames(const char *path, vector vectors[FRAMES_MAX], char names[FRAMES_MAX][32]) {
    char line[LINE_MAX_BYTES];
    FILE *file = open_table(path);
    size_t count = 0;
    while (fgets(line, sizeof line, file) != NULL) {
        char *column[6];
        if (count == FRAMES_MAX || split(line, column, 6) != 6) {
            printf("FAILED %s: line %zu\n", path, count + 2);
            exit(1);
        }
        vector *v = &vectors[count];
        snprintf(names[count], sizeof names[count], "%.20s %.3s", column[0], column[2]);
        v->frame.id = (uint16_t)strtoul(column[1], NULL, 16);
        v->sequence = (uint8_t)strtoul(column[2], NULL, 10);
        v->frame.length = (uint8_t)from_hex(column[4], v->frame.payload, sizeof v->frame.payload);
        v->serial_length = from_hex(column[5], v->serial, sizeof v->serial);
        count++;
    }
    fclose(file);
    return count;
}

static size_t check_rejected(const char *path) {
    char line[LINE_MAX_BYTES];
    FILE *file = open_table(path);
    size_t rows = 0;
    while (fgets(line, sizeof line, file) != NULL) {
        char *column[2];
        uint8_t wire[SERIAL_MAX];
        wheel_deframer d;
        wheel_frame frame;
        if (split(line, column, 2) != 2) {
            printf("FAILED %s: line %zu\n", path, rows + 2);
            exit(1);
        }
        wheel_deframer_init(&d);
        const unsigned count = feed(&d, wire, from_hex(column[1], wire, sizeof wire), &frame);
        const struct {
            const char *cause;
            uint32_t counted;
        } causes[] = {{"cobs", d.cobs},
                      {"crc", d.crc},
                      {"length", d.length_errors},
                      {"unknown_id", d.unknown_id},
                      {"overrun", d.overruns}};
        check(count == 0 && d.frames == 0, "nothing is accepted", column[1]);
        for (size_t i = 0; i < sizeof causes / sizeof causes[0]; i++) {
            const uint32_t expected = strcmp(column[0], causes[i].cause) == 0 ? 1u : 0u;
            check(causes[i].counted == expected, causes[i].cause, column[1]);
        }
        rows++;
    }
    fclose(file);
    return rows;
}

int main(int argc, char **argv) {
    static vector vectors[FRAMES_MAX];
    static char names[FRAMES_MAX][32];
    if (argc != 3) {
        printf("usage: check_vectors frames.csv rejected.csv\n");
        return 2;
    }
    const size_t frames = read_frames(argv[1], vectors, names);
    unsigned long tried = 0;
    for (size_t i = 0; i < frames; i++) {
        check_codec(&vectors[i], names[i]);
        check_framing(&vectors[i], names[i]);
        tried += check_bit_errors(&vectors[i], &vectors[(i + 1) % frames], names[i]);
    }
    const size_t rejected = check_rejected(argv[2]);
    printf("%zu frames, %lu bit errors, %zu rejected, %u failures\n", frames, tried, rejected, failures);
    return failures == 0 && frames > 0 && rejected > 0 ? 0 : 1;
}
