#include "parameter_log.h"

#include <string.h>

#include "flash_memory.h"

#define RECORD_WORDS 32u
#define DATA_WORDS ((WHEEL_STORED_SIZE + 3u) / 4u)
#define SEQUENCE_WORD 30u /* and its complement in the next */
#define RECORDS (FLASH_SECTOR_WORDS / RECORD_WORDS)
#define BLANK 0xFFFFFFFFu

_Static_assert(DATA_WORDS <= SEQUENCE_WORD, "a record holds what the core stores");

static struct {
    unsigned sector; /* that is being filled */
    size_t next;     /* record to be written there */
    uint32_t sequence;
    bool has_spare; /* the other sector is blank */
} state;

static const volatile uint32_t *record_at(unsigned sector, size_t index) {
    return flash_sector(sector) + index * RECORD_WORDS;
}

static bool is_whole(const volatile uint32_t *record) {
    return record[SEQUENCE_WORD] == ~record[SEQUENCE_WORD + 1u];
}

static bool is_blank(const volatile uint32_t *words, size_t count) {
    bool blank = true;
    for (size_t i = 0; i < count && blank; i++) {
        blank = words[i] == BLANK;
    }
    return blank;
}

static const volatile uint32_t *find_newest(void) {
    const volatile uint32_t *newest = NULL;
    for (unsigned sector = 0; sector < FLASH_SECTORS; sector++) {
        for (size_t i = 0; i < RECORDS; i++) {
            const volatile uint32_t *record = record_at(sector, i);
            if (is_whole(record) && (newest == NULL || record[SEQUENCE_WORD] > newest[SEQUENCE_WORD])) {
                newest = record;
                state.sector = sector;
            }
        }
    }
    return newest;
}

static void make_blank(unsigned sector) {
    if (!is_blank(flash_sector(sector), FLASH_SECTOR_WORDS)) {
        flash_erase(sector);
    }
}

const uint8_t *parameter_log_open(void) {
    memset(&state, 0, sizeof state);
    const volatile uint32_t *newest = find_newest();
    if (newest == NULL) {
        make_blank(state.sector);
    }
    make_blank(1u - state.sector);
    state.has_spare = true;
    state.next = RECORDS;
    while (state.next > 0u && is_blank(record_at(state.sector, state.next - 1u), RECORD_WORDS)) {
        state.next--;
    }
    state.sequence = newest == NULL ? 0u : newest[SEQUENCE_WORD] + 1u;
    return (const uint8_t *)newest;
}

bool parameter_log_append(const uint8_t bytes[WHEEL_STORED_SIZE]) {
    uint32_t data[DATA_WORDS] = {0};
    const uint32_t mark[2] = {state.sequence, ~state.sequence};
    if (state.next == RECORDS) {
        if (!state.has_spare) {
            return false;
        }
        state.sector = 1u - state.sector;
        state.next = 0;
        state.has_spare = false;
    }
    const size_t at = state.next * RECORD_WORDS;
    state.next++; /* a record that failed is not tried again */
    memcpy(data, bytes, WHEEL_STORED_SIZE);
    if (!flash_program(state.sector, at, data, DATA_WORDS) ||
        !flash_program(state.sector, at + SEQUENCE_WORD, mark, 2)) {
        return false;
    }
    state.sequence++;
    return true;
}
