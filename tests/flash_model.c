/* Two sectors of NOR flash as the chip has them: erasing sets all bits, programming only clears some, and the
 * supply may fail at any word or in the middle of it. Behind the real parameter log (parameter_log.c). */
#include <setjmp.h>
#include <stdlib.h>
#include <string.h>

#include "flash_memory.h"
#include "parameter_log.h"

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
extern int model_erasures;
/* cffi: end */

static uint32_t words[FLASH_SECTORS][FLASH_SECTOR_WORDS];
static jmp_buf power;
static int to_live = MODEL_NEVER;
static uint32_t last_mask;
static unsigned broken_sector = FLASH_SECTORS, broken_at;
int model_erasures;

const volatile uint32_t *flash_sector(unsigned sector) {
    return words[sector];
}

void flash_erase(unsigned sector) {
    memset(words[sector], 0xFF, sizeof words[sector]);
    model_erasures++;
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
    model_erasures = 0;
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
