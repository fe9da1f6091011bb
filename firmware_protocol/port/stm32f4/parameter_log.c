#include "parameter_log.h"

#include <string.h>

#include "../../firmware/crc.h"
#include "flash_memory.h"
#include "watchdog.h"

#define RECORD_WORDS 32u
#define DATA_WORDS ((WHEEL_STORED_SIZE + 3u) / 4u)
#define CHECK_WORD 29u
#define SEQUENCE_WORD 30u /* and its complement in the next */
#define RECORDS (FLASH_SECTOR_WORDS / RECORD_WORDS)
#define BLANK 0xFFFFFFFFu

_Static_assert(DATA_WORDS <= CHECK_WORD, "a record holds what the core stores");

static struct {
    unsigned sector; /* that is being filled */
    size_t next;     /* record to be written there */
    uint32_t sequence;
    bool has_spare; /* the other sector is blank */
    uint8_t newest[WHEEL_STORED_SIZE];
} state;

static const volatile uint32_t *record_at(unsigned sector, size_t index) {
    return flash_sector(sector) + index * RECORD_WORDS;
}

/* Word by word: who has no access by `volatile` may be given what was there before an erasure. */
static void read_record(const volatile uint32_t *record, uint8_t bytes[WHEEL_STORED_SIZE]) {
    uint32_t words[DATA_WORDS];
    for (size_t i = 0; i < DATA_WORDS; i++) {
        words[i] = record[i];
    }
    memcpy(bytes, words, WHEEL_STORED_SIZE);
}

/* The check sees what an erasure that was cut short left of a record with its mark. */
static bool is_whole(const volatile uint32_t *record) {
    uint8_t bytes[WHEEL_STORED_SIZE];
    if (record[SEQUENCE_WORD] != ~record[SEQUENCE_WORD + 1u]) {
        return false;
    }
    read_record(record, bytes);
    return record[CHECK_WORD] == wheel_crc16(bytes, WHEEL_STORED_SIZE);
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

static bool make_blank(unsigned sector) {
    const volatile uint32_t *words = flash_sector(sector);
    if (is_blank(words, FLASH_SECTOR_WORDS)) {
        return true;
    }
    watchdog_feed(); /* whose limit is for one erasure */
    flash_erase(sector);
    return is_blank(words, FLASH_SECTOR_WORDS);
}

const uint8_t *parameter_log_open(void) {
    memset(&state, 0, sizeof state);
    const volatile uint32_t *newest = find_newest();
    if (newest == NULL) {
        (void)make_blank(state.sector);
    }
    state.has_spare = make_blank(1u - state.sector);
    state.next = RECORDS;
    while (state.next > 0u && is_blank(record_at(state.sector, state.next - 1u), RECORD_WORDS)) {
        state.next--;
    }
    state.sequence = newest == NULL ? 0u : newest[SEQUENCE_WORD] + 1u;
    if (newest == NULL) {
        return NULL;
    }
    read_record(newest, state.newest);
    return state.newest;
}

bool parameter_log_is_full(void) {
    return state.next == RECORDS && !state.has_spare;
}

bool parameter_log_append(const uint8_t bytes[WHEEL_STORED_SIZE]) {
    uint32_t data[DATA_WORDS] = {0};
    const uint32_t end[3] = {wheel_crc16(bytes, WHEEL_STORED_SIZE), state.sequence, ~state.sequence};
    if (state.next == RECORDS) {
        if (!state.has_spare && !make_blank(1u - state.sector)) {
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
        !flash_program(state.sector, at + CHECK_WORD, end, 3)) {
        return false;
    }
    state.sequence++;
    return true;
}
