/* Sectors 6 and 7 (RM0090, table 5 and section 3.6). */
#include "flash_memory.h"

#include "registers/core.h"
#include "registers/flash.h"

#define FIRST_SECTOR 6u
#define FIRST_ADDRESS 0x08040000u

static volatile uint32_t *words_of(unsigned sector) {
    return (volatile uint32_t *)(FIRST_ADDRESS + sector * FLASH_SECTOR_WORDS * 4u);
}

const volatile uint32_t *flash_sector(unsigned sector) {
    return words_of(sector);
}

static void wait(void) {
    while ((FLASH->SR & FLASH_SR_BSY) != 0u) {
    }
}

static void begin(uint32_t operation) {
    FLASH->KEYR = FLASH_KEY1;
    FLASH->KEYR = FLASH_KEY2;
    wait();
    FLASH->SR = FLASH_SR_ERRORS;
    FLASH->CR = operation | FLASH_CR_PSIZE_32;
}

static void end(void) {
    wait();
    FLASH->CR = FLASH_CR_LOCK;
    /* The data cache may hold what was there before (RM0090, 3.5.2). */
    const uint32_t access = FLASH->ACR;
    FLASH->ACR = access & ~FLASH_ACR_DCEN;
    FLASH->ACR = (access & ~FLASH_ACR_DCEN) | FLASH_ACR_DCRST;
    FLASH->ACR = access;
}

void flash_erase(unsigned sector) {
    begin(FLASH_CR_SER | FLASH_CR_SNB(FIRST_SECTOR + sector));
    FLASH->CR |= FLASH_CR_STRT;
    end();
}

bool flash_program(unsigned sector, size_t at, const uint32_t *words, size_t count) {
    volatile uint32_t *to = words_of(sector) + at;
    bool good = true;
    begin(FLASH_CR_PG);
    for (size_t i = 0; i < count; i++) {
        to[i] = words[i];
        barrier();
        wait();
    }
    end();
    for (size_t i = 0; i < count; i++) {
        good = good && to[i] == words[i];
    }
    return good;
}
