/* Two sectors of NOR flash as the chip has them: erasing sets all bits, programming only clears some, and the
 * supply may fail at any word or in the middle of it. Behind the real parameter log (parameter_log.c). */
#include <setjmp.h>
#include <stdlib.h>
#include <string.h>

#include "flash_memory.h"
#include "parameter_log.h"
#include "watchdog.h"

/* cffi: begin */
enum { MODEL_NEVER = -1 };
void model_reset(void);
/* Opens the log, as after a reset; copies the stored bytes, or returns false when there are none. */
bool model_open(uint8_t *bytes);
/* Appends, with the supply failing after so many words, the last one programmed as far as `mask` says: its
 * bits that are 1 stay unprogrammed. Returns 1 for kept, 0 for not kept, -1 for a power cut. */
int model_append(const uint8_t *bytes, int words_to_live, uint32_t mask);
void model_break_word(unsigned sector, unsigned at);
uint32_t model_word(unsigned sector, unsigned at);
void model_set_word(unsigned sector, unsigned at, uint32_t word);
/* Opens the log, with the supply failing in the next erasure: each bit of the sector is then set or as it
 * was. `chance` in 256 is that it is set. Returns false when there was nothing to erase. */
bool model_tear_erasure(uint32_t seed, uint32_t chance);
/* The same, but in the erasure that a STORE of these bytes needs. */
bool model_tear_append(const uint8_t *bytes, uint32_t seed, uint32_t chance);
bool model_is_full(void);
/* Erasures from now on leave a word as it was. */
void model_keep_word(unsigned sector, unsigned at);
extern int model_erasures;
extern int model_most_erasures_unfed; /* between two feeds of the watchdog */
/* cffi: end */

static uint32_t words[FLASH_SECTORS][FLASH_SECTOR_WORDS];
static jmp_buf power;
static int to_live = MODEL_NEVER;
static uint32_t last_mask;
static unsigned broken_sector = FLASH_SECTORS, broken_at;
static unsigned kept_sector = FLASH_SECTORS, kept_at;
static bool erasure_tears;
static uint32_t tear_seed, tear_chance;
static int erasures_unfed;
int model_erasures, model_most_erasures_unfed;

const volatile uint32_t *flash_sector(unsigned sector) {
    return words[sector];
}

void watchdog_feed(void) {
    erasures_unfed = 0;
}

static uint32_t torn(uint32_t word) {
    for (unsigned bit = 0; bit < 32u; bit++) {
        tear_seed = tear_seed * 1664525u + 1013904223u;
        word |= (uint32_t)(tear_seed >> 24 < tear_chance) << bit;
    }
    return word;
}

void flash_erase(unsigned sector) {
    const uint32_t kept = kept_sector == sector ? words[sector][kept_at] : 0xFFFFFFFFu;
    for (size_t i = 0; i < FLASH_SECTOR_WORDS; i++) {
        words[sector][i] = erasure_tears ? torn(words[sector][i]) : 0xFFFFFFFFu;
    }
    if (erasure_tears) {
        longjmp(power, 1);
    }
    if (kept_sector == sector) {
        words[sector][kept_at] = kept;
    }
    model_erasures++;
    erasures_unfed++;
    if (erasures_unfed > model_most_erasures_unfed) {
        model_most_erasures_unfed = erasures_unfed;
    }
}

bool flash_program(unsigned sector, size_t at, const uint32_t *data, size_t count) {
    bool good = true;
    for (size_t i = 0; i < count; i++) {
        if (to_live == 0) {
            words[sector][at + i] &= data[i] | last_mask;
            longjmp(power, 1);
        }
        if (to_live > 0) {
            to_live--;
        }
        const bool broken = sector == broken_sector && at + i == broken_at;
        words[sector][at + i] &= broken ? 0u : data[i];
        good = good && words[sector][at + i] == data[i];
    }
    return good;
}

void model_reset(void) {
    memset(words, 0xFF, sizeof words);
    broken_sector = FLASH_SECTORS;
    kept_sector = FLASH_SECTORS;
    model_erasures = 0;
    erasures_unfed = 0;
    model_most_erasures_unfed = 0;
}

bool model_open(uint8_t *bytes) {
    const uint8_t *stored = parameter_log_open();
    if (stored != NULL) {
        memcpy(bytes, stored, WHEEL_STORED_SIZE);
    }
    return stored != NULL;
}

int model_append(const uint8_t *bytes, int words_to_live, uint32_t mask) {
    to_live = words_to_live;
    last_mask = mask;
    if (setjmp(power) != 0) {
        to_live = MODEL_NEVER;
        return -1;
    }
    const bool kept = parameter_log_append(bytes);
    to_live = MODEL_NEVER;
    return kept ? 1 : 0;
}

void model_break_word(unsigned sector, unsigned at) {
    broken_sector = sector;
    broken_at = at;
}

uint32_t model_word(unsigned sector, unsigned at) {
    return words[sector][at];
}

void model_set_word(unsigned sector, unsigned at, uint32_t word) {
    words[sector][at] = word;
}

static bool tear(const uint8_t *bytes, uint32_t seed, uint32_t chance) {
    erasure_tears = true;
    tear_seed = seed;
    tear_chance = chance;
    const bool was_torn = setjmp(power) != 0;
    if (!was_torn && bytes != NULL) {
        (void)parameter_log_append(bytes);
    } else if (!was_torn) {
        (void)parameter_log_open();
    }
    erasure_tears = false;
    return was_torn;
}

bool model_tear_erasure(uint32_t seed, uint32_t chance) {
    return tear(NULL, seed, chance);
}

bool model_tear_append(const uint8_t *bytes, uint32_t seed, uint32_t chance) {
    return tear(bytes, seed, chance);
}

bool model_is_full(void) {
    return parameter_log_is_full();
}

void model_keep_word(unsigned sector, unsigned at) {
    kept_sector = sector;
    kept_at = at;
}
