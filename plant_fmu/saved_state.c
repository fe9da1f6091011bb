#include "saved_state.h"

#include <stdlib.h>
#include <string.h>

static const char HEADER[] = "plant " MECANUM_GUID;

static bool keep(plant_instance *plant, const plant_snapshot *snapshot, void **state) {
    if (*state == NULL) {
        *state = malloc(sizeof *snapshot);
    }
    if (*state == NULL) {
        return plant_fail(plant, "out of memory for a saved state");
    }
    memcpy(*state, snapshot, sizeof *snapshot);
    return true;
}

bool plant_save(plant_instance *plant, void **state) {
    return keep(plant, &plant->now, state);
}

bool plant_restore(plant_instance *plant, const void *state) {
    if (state == NULL) {
        return plant_fail(plant, "no saved state given");
    }
    memcpy(&plant->now, state, sizeof plant->now);
    return true;
}

void plant_forget(void **state) {
    if (state != NULL) {
        free(*state);
        *state = NULL;
    }
}

/* FNV-1a: tells a damaged state from a good one. */
static uint64_t checksum(const char *bytes, size_t size) {
    uint64_t hash = UINT64_C(14695981039346656037);
    for (size_t i = 0; i < size; i++) {
        hash = (hash ^ (unsigned char)bytes[i]) * UINT64_C(1099511628211);
    }
    return hash;
}

size_t plant_serialized_size(void) {
    return sizeof HEADER + sizeof(plant_snapshot) + sizeof(uint64_t);
}

bool plant_serialize(plant_instance *plant, const void *state, void *bytes, size_t size) {
    if (state == NULL || size < plant_serialized_size()) {
        return plant_fail(plant, "room for %zu bytes of a saved state; expected a state and %zu", size,
                          plant_serialized_size());
    }
    const size_t body = sizeof HEADER + sizeof(plant_snapshot);
    char *const place = bytes;
    memcpy(place, HEADER, sizeof HEADER);
    memcpy(place + sizeof HEADER, state, sizeof(plant_snapshot));
    const uint64_t sum = checksum(place, body);
    memcpy(place + body, &sum, sizeof sum);
    return true;
}

bool plant_deserialize(plant_instance *plant, const void *bytes, size_t size, void **state) {
    const size_t body = sizeof HEADER + sizeof(plant_snapshot);
    const char *const place = bytes;
    uint64_t sum = 0;
    if (size == plant_serialized_size()) {
        memcpy(&sum, place + body, sizeof sum);
    }
    if (size != plant_serialized_size() || memcmp(place, HEADER, sizeof HEADER) != 0 ||
        sum != checksum(place, body)) {
        return plant_fail(plant, "these %zu bytes are not a saved state of this model", size);
    }
    plant_snapshot snapshot;
    memcpy(&snapshot, place + sizeof HEADER, sizeof snapshot);
    return keep(plant, &snapshot, state);
}
